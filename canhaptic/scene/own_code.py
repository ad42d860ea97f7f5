"""User-defined environments, algorithms, effects and hands: `file.py:Class` in the scene's folder, or a plug-in.

A file runs only if the user allows it. It must be a regular file in the folder of the scene itself, after symbolic
links are resolved. It runs under a private module name; its folder is never added to the import path. A plug-in is an
installed package that names its classes as entry points (`canhaptic.environments`, ...); a scene can use no other class
of it. The hash of each file that ran is part of the configuration, so that a log identifies the code.

Commands that run nothing leave user code unread: they neither import it nor check its parameters.
"""

import hashlib
import sys
import traceback
from collections.abc import Mapping
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import ModuleType
from typing import Any, Final

from pydantic_core import PydanticCustomError

from canhaptic.errors import InputError, ParameterError
from canhaptic.files import read_regular
from canhaptic.own_results import watch
from canhaptic.scene.components import OWN_MODULE, READY, CodeUse, SceneContext
from canhaptic.scene.document import MarkedMapping
from canhaptic.units import Parameters, shown

_RETURN_NUMBERS: Final[Mapping[str, tuple[str, ...]]] = {
    "environment": ("potential", "effort", "true_state", "admissible", "stored_energy", "state_of_energy", "relaxed"),
    "passivity algorithm": ("step", "hold"),
}
"""Kind -> methods whose results are checked; the plant adds the methods of hands and effects."""
_MARK: Final = ".py:"  # of `file.py:Class`
_LARGEST: Final = 1_000_000  # [bytes]
ENTRY_POINT_GROUPS: Final[Mapping[str, str]] = {
    "environment": "canhaptic.environments",
    "passivity algorithm": "canhaptic.algorithms",
    "effect": "canhaptic.effects",
    "hand": "canhaptic.hands",
}
"""Kind of user-defined part -> entry point group of its plug-ins."""


def own_model(section: MarkedMapping, reading: SceneContext, model: type[Parameters], kind: str) -> object:
    """Return the parameters of a section whose `type` names a user-defined subclass.

    Args:
        section: Section of the scene.
        reading: Context of the validation.
        model: Built-in model of the section.
        kind: Kind of model, for messages and plug-ins.

    Raises:
        ValueError: The name is no text, or names no subclass of the model.
        PydanticCustomError: The code must not run, or fails.
    """
    name, code = section["type"], reading.code
    if not isinstance(name, str):
        raise ValueError(f"type: got {shown(name)}, expected FILE.py:Class")
    if code.is_left(name, kind):
        return model()
    try:
        own = code.find(name, kind)
    except ParameterError as error:
        raise PydanticCustomError(READY, "{text}", {"text": str(error)}) from error
    if not (isinstance(own, type) and issubclass(own, model)):
        seen = "which is unknown" if own is None else f"which is no {model.__name__}"
        raise ValueError(f"type: got {name!r}, {seen}; expected FILE.py:Class, a subclass of {model.__name__}")
    return own.of_section(section.without("type"), reading)


def installed(kind: str) -> dict[str, EntryPoint]:
    """Return the entry points of installed plug-ins for a kind of component, by name, without importing them."""
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
        """Whether a name refers to user code that is left unread; if so, add it to `left`."""
        if self._use != "left" or not (_MARK in reference or reference in installed(kind)):
            return False
        self.left.append(reference)
        return True

    def find(self, reference: str, kind: str) -> Any:
        """Return the user-defined class that a name refers to; None for any other name.

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
        path, content = self._read(name)
        digest = hashlib.sha256(content).hexdigest()
        module = _module(path, digest, content)
        chosen = getattr(module, attribute, None)
        if not isinstance(chosen, type):
            names = [key for key, of in vars(module).items() if getattr(of, "__module__", "") == module.__name__]
            raise ParameterError(f"{name}: has no class {attribute!r}, expected one of: {', '.join(names) or 'none'}")
        self.hashes[name] = digest
        watch(chosen, _RETURN_NUMBERS.get(kind, ()))
        return chosen

    def _read(self, name: str) -> tuple[Path, bytes]:
        """Return path and content of a regular file in the scene's folder itself."""
        folder = self._folder.resolve()
        try:
            path = (folder / name).resolve(strict=True)
            content = read_regular(path, _LARGEST) if path.parent == folder else b""
        except (OSError, ValueError) as error:
            text = f"{name}: cannot be read ({error}); put the file into the folder of the scene, {folder}"
            raise ParameterError(text) from error
        if path.parent != folder or path.suffix != ".py":
            raise ParameterError(f"{name}: lies in {path.parent}, expected a .py file in the scene's folder {folder}")
        return path, content


def require_same_code(ran: Mapping[str, str], recorded: Mapping[str, str], where: str) -> None:
    """Refuse user code that differs from the recorded code.

    Args:
        ran: `OwnCode.hashes` of the code that would run now.
        recorded: Hashes of the recorded run.
        where: Name of the record, for the message.

    Raises:
        InputError: A file or a plug-in differs or is missing.
    """
    for name in {**recorded, **ran}:
        now, then = ran.get(name, "nothing"), recorded.get(name, "nothing")
        if now != then:
            text = f"{name}: is not the code of {where}: SHA-256 {now[:12]} now, {then[:12]} there"
            raise InputError(f"{text}; put that version back")


@cache
def _module(path: Path, digest: str, content: bytes) -> ModuleType:
    """Run a file as a module, once for the same content, and return the module."""
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
