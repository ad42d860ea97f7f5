"""A user's own environment, algorithm or effect, named in a scene as `file.py:Class`. It runs only where allowed.

The file must be a regular file in the folder of the scene itself, once symbolic links are followed. It is run under a
private module name; its folder never becomes a place to import from. The hash of each file that ran belongs to the
configuration, so a log tells with which code it was made.
"""

import hashlib
import importlib.util
import stat
import sys
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any, Final

from canhaptic.errors import ParameterError

_MARK: Final = ".py:"
_LARGEST: Final = 1_000_000  # [bytes]
OWN_CODE_KINDS: Final = ("environment", "passivity algorithm", "effect")
"""What may be a user's own."""


def names_own_code(name: object) -> bool:
    """Returns whether the name of a component is `file.py:Class`."""
    return isinstance(name, str) and _MARK in name


class OwnCode:
    """The files that a scene names, and whether they may run.

    Args:
        folder: Of the scene.
        allowed: Whether the user permitted the scene's code, by `--allow-code` or `allow_code=True`.

    Attributes:
        hashes: File as the scene names it -> SHA-256 of what ran.
    """

    def __init__(self, folder: Path, allowed: bool) -> None:
        self._folder = folder
        self._allowed = allowed
        self.hashes: dict[str, str] = {}

    def load(self, reference: str, kind: str) -> Any:
        """Returns the class that `file.py:Class` names; the file is run once.

        Raises:
            ParameterError: Not allowed, not a file of the scene's folder, or the code fails.
        """
        name, _, attribute = reference.partition(":")
        if kind not in OWN_CODE_KINDS:
            raise ParameterError(f"got {reference!r}, expected a built-in {kind}; own code can be {_listed()}")
        if not self._allowed:
            raise ParameterError(
                f"names the program file {name!r}, which was not run; read it, and if you trust it "
                "repeat the command with --allow-code (from Python: allow_code=True)"
            )
        path = self._checked(name)
        content = _content(path)
        digest = hashlib.sha256(content).hexdigest()
        module = _module(path, digest, content)
        if not isinstance(getattr(module, attribute, None), type):
            classes = [
                key for key, value in vars(module).items() if getattr(value, "__module__", "") == module.__name__
            ]
            raise ParameterError(f"{name}: has no class {attribute!r}, expected one of: {', '.join(classes) or 'none'}")
        self.hashes[name] = digest
        return getattr(module, attribute)

    def _checked(self, name: str) -> Path:
        """Returns the path of a file that lies in the scene's folder itself, and is nothing but a file."""
        folder = self._folder.resolve()
        try:
            path = (folder / name).resolve(strict=True)
            regular = stat.S_ISREG(path.stat().st_mode)
        except (OSError, ValueError) as error:
            raise ParameterError(
                f"{name}: cannot be read ({error}); put the file into the folder of the scene"
            ) from error
        if path.parent != folder:
            raise ParameterError(f"{name}: lies in {path.parent}, expected a file in the scene's folder {folder}")
        if not regular or path.suffix != ".py":
            raise ParameterError(f"{name}: is no regular Python file; expected FILE.py:Class")
        return path


def _listed() -> str:
    return f"{', '.join(OWN_CODE_KINDS[:-1])} or {OWN_CODE_KINDS[-1]}"


def _content(path: Path) -> bytes:
    with path.open("rb") as file:
        content = file.read(_LARGEST + 1)
    if len(content) > _LARGEST:
        raise ParameterError(f"{path.name}: larger than {_LARGEST} bytes; a component has a few hundred lines at most")
    return content


@cache
def _module(path: Path, digest: str, content: bytes) -> ModuleType:
    """Returns the module made of a file; the same content of the same file is run once."""
    name = f"_canhaptic_own_{digest[:16]}"
    spec = importlib.util.spec_from_loader(name, loader=None, origin=str(path))
    if spec is None:
        raise ParameterError(f"{path.name}: no module can be made of it")
    module = importlib.util.module_from_spec(spec)
    module.__file__ = str(path)
    sys.modules[name] = module  # pydantic looks up annotations there
    try:
        exec(compile(content, str(path), "exec"), module.__dict__)
    except Exception as error:
        del sys.modules[name]
        line = error.lineno if isinstance(error, SyntaxError) else _line_in(error, path)
        raise ParameterError(f"{path.name}:{line}: {type(error).__name__}: {error}") from error
    return module


def _line_in(error: Exception, path: Path) -> int:
    """Returns the last line of the file that was running when it raised."""
    line, trace = 0, error.__traceback__
    while trace is not None:
        if trace.tb_frame.f_code.co_filename == str(path):
            line = trace.tb_lineno
        trace = trace.tb_next
    return line
