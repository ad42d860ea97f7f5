"""User-defined environment, algorithm, effect or hand: `file.py:Class` of the scene's folder, or of a plug-in.

A file runs only where the user allowed it. It must be a regular file in the folder of the scene itself, after symbolic
links are resolved. It is run under a private module name; its folder is never added to the import path. A plug-in
is a package that the user installed and that names its classes as entry points (`canhaptic.environments`, ...); a scene
can choose among them and nothing else. The hash of each file that ran belongs to the configuration, so a log says with
which code it was made.

Commands that run nothing leave user code unread: they neither import it nor check its parameters.
"""

import hashlib
import stat
import sys
import traceback
from collections.abc import Mapping
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import ModuleType
from typing import Any, Final

from canhaptic.errors import InputError, ParameterError
from canhaptic.input_file import read_regular
from canhaptic.own_results import watch
from canhaptic.scene.components import OWN_MODULE, CodeUse

_RETURN_NUMBERS: Final[Mapping[str, tuple[str, ...]]] = {
    "environment": ("potential", "effort", "true_state", "admissible", "stored_energy", "state_of_energy", "relaxed"),
    "passivity algorithm": ("step", "hold"),
}
"""Kind -> methods watched from the start; methods of hands and effects are added where the plant is put together."""
_MARK: Final = ".py:"  # of `file.py:Class`
_LARGEST: Final = 1_000_000  # [bytes]
ENTRY_POINT_GROUPS: Final[Mapping[str, str]] = {
    "environment": "canhaptic.environments",
    "passivity algorithm": "canhaptic.algorithms",
    "effect": "canhaptic.effects",
    "hand": "canhaptic.hands",
}
"""Kind of user-defined part -> group of the entry points of plug-ins."""


def installed(kind: str) -> dict[str, EntryPoint]:
    """Return the classes that installed plug-ins offer as a kind of component, by name; none is imported."""
    group = ENTRY_POINT_GROUPS.get(kind)
    return {} if group is None else {found.name: found for found in entry_points(group=group)}


class OwnCode:
    """User code that a scene names, and whether it may run.

    Args:
        folder: Folder of the scene.
        use: "run" where the user permitted the scene's files, by `--allow-code` or `allow_code=True`; "left" where
            nothing is built from the scene, files and plug-ins alike.

    Attributes:
        hashes: File as the scene names it, or plug-in -> SHA-256 of the code that ran.
        left: Names of the code left unread.
    """

    def __init__(self, folder: Path, use: CodeUse = "refused") -> None:
        self._folder = folder
        self._use = use
        self.hashes: dict[str, str] = {}
        self.left: list[str] = []

    def is_left(self, reference: str, kind: str) -> bool:
        """Whether a name refers to user code that this scene leaves unread; it is then noted in `left`."""
        if self._use != "left" or not (_MARK in reference or reference in installed(kind)):
            return False
        self.left.append(reference)
        return True

    def find(self, reference: str, kind: str) -> Any:
        """Return the user-defined class that a name refers to; None where it refers to none.

        Raises:
            ParameterError: Not allowed, not a file of the scene's folder, or the code fails.
        """
        if _MARK in reference:
            return self.load(reference, kind)
        found = installed(kind).get(reference)
        return None if found is None else self._plug_in(found, kind)

    def _plug_in(self, found: EntryPoint, kind: str) -> Any:
        package = f"{found.dist.name} {found.dist.version}" if found.dist is not None else found.value
        try:
            chosen = found.load()
            source = Path(str(sys.modules[chosen.__module__].__file__)).read_bytes()
        except Exception as error:  # foreign code may raise anything
            text = f"{found.name}: the plug-in {package} cannot be used ({type(error).__name__}: {error})"
            raise ParameterError(text) from error
        self.hashes[f"{found.name} ({package})"] = hashlib.sha256(source).hexdigest()
        if isinstance(chosen, type):
            watch(chosen, _RETURN_NUMBERS.get(kind, ()))
        return chosen

    def load(self, reference: str, kind: str) -> Any:
        """Return the class that `file.py:Class` names; the file is run once.

        Raises:
            ParameterError: Not allowed, not a file of the scene's folder, or the code fails.
        """
        name, _, attribute = reference.partition(":")
        if kind not in ENTRY_POINT_GROUPS:
            *first, last = ENTRY_POINT_GROUPS
            own = f"own code can be {', '.join(first)} or {last}"
            raise ParameterError(f"got {reference!r}, expected a built-in {kind}; {own}")
        if self._use != "run":
            text = f"names the program file {name!r}, which was not run; read it, and if you trust it repeat the"
            raise ParameterError(f"{text} command with --allow-code (from Python: allow_code=True)")
        path = self._checked(name)
        try:
            content = read_regular(path, _LARGEST)
        except OSError as error:
            raise ParameterError(f"{name}: cannot be read ({error.strerror}); name a file of Python") from error
        digest = hashlib.sha256(content).hexdigest()
        module = _module(path, digest, content)
        chosen = getattr(module, attribute, None)
        if not isinstance(chosen, type):
            names = [key for key, of in vars(module).items() if getattr(of, "__module__", "") == module.__name__]
            raise ParameterError(f"{name}: has no class {attribute!r}, expected one of: {', '.join(names) or 'none'}")
        self.hashes[name] = digest
        watch(chosen, _RETURN_NUMBERS.get(kind, ()))
        return chosen

    def _checked(self, name: str) -> Path:
        """Path of a regular file that lies in the scene's folder itself."""
        folder = self._folder.resolve()
        try:
            path = (folder / name).resolve(strict=True)
            regular = stat.S_ISREG(path.stat().st_mode)
        except (OSError, ValueError) as error:
            text = f"{name}: cannot be read ({error}); put the file into the folder of the scene"
            raise ParameterError(text) from error
        if path.parent != folder:
            raise ParameterError(f"{name}: lies in {path.parent}, expected a file in the scene's folder {folder}")
        if not regular or path.suffix != ".py":
            raise ParameterError(f"{name}: is not a regular Python file; expected FILE.py:Class")
        return path


def require_same_code(ran: Mapping[str, str], recorded: Mapping[str, str], where: str) -> None:
    """Refuse code that differs from the recorded code.

    Args:
        ran: `OwnCode.hashes` of the code that would run now.
        recorded: Hashes of the recorded run.
        where: The record they come from, for the message.

    Raises:
        InputError: A file or a plug-in is another, or is missing.
    """
    for name in {**recorded, **ran}:
        now, then = ran.get(name, "nothing"), recorded.get(name, "nothing")
        if now != then:
            text = f"{name}: is not the code of {where}: SHA-256 {now[:12]} now, {then[:12]} there"
            raise InputError(f"{text}; put that version back")


@cache
def _module(path: Path, digest: str, content: bytes) -> ModuleType:
    """Return the module made of a file; the same content of the same file is run once."""
    name = f"{OWN_MODULE}{digest[:16]}"
    module = ModuleType(name)
    module.__file__ = str(path)
    sys.modules[name] = module  # pydantic looks up annotations there
    try:
        exec(compile(content, str(path), "exec"), module.__dict__)
    except (Exception, SystemExit) as error:  # a file that ends the process would end the command without a word
        del sys.modules[name]
        line = error.lineno or 1 if isinstance(error, SyntaxError) else _line_in(error, path)
        raise ParameterError(f"{path.name}:{line}: {type(error).__name__}: {error}") from error
    return module


def _line_in(error: BaseException, path: Path) -> int:
    """Return the last line of the file that was running when it raised."""
    lines = [line for frame, line in traceback.walk_tb(error.__traceback__) if frame.f_code.co_filename == str(path)]
    return lines[-1] if lines else 0
