"""Arguments of every subcommand, as `options.toml` lists them, and the parsers of their values.

The code of a subcommand is imported only after its arguments are parsed.
"""

import argparse
import re
import tomllib
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from canhaptic.errors import InputError
from canhaptic.files import CONVERTIBLE, require_writable_place

if TYPE_CHECKING:
    from canhaptic.scene.models import Scene

_PICTURES: Final = (".png", ".svg", ".pdf")
"""Suffixes of a picture."""
_MADE_ANEW: Final = (*_PICTURES, ".html", ".htm")
"""Suffixes of what may be written again without `--force`: the recording that it is made from is kept."""


@cache
def table() -> dict[str, Any]:
    """Return the subcommands and their arguments, as `options.toml` lists them."""
    listed = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
    shared = listed.pop("shared")
    for command in listed.values():
        given = command.setdefault("arguments", {})
        command["arguments"] = {name: shared[name] if of is True else of for name, of in given.items()}
    return listed


def add_arguments(name: str, parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of a subcommand."""
    chosen: dict[str, Any] = {"": parser}
    for argument, given in table()[name]["arguments"].items():
        said = {"action": "store_true", "help": given} if isinstance(given, str) else dict(given)
        if (one_of := said.pop("one_of", "")) not in chosen:
            chosen[one_of] = parser.add_mutually_exclusive_group()
        if "limits" in said:
            said["type"] = _whole(*said.pop("limits"))
        elif "type" in said:
            said["type"] = _READERS[said["type"]]
        if isinstance(said.get("metavar"), list):
            said["metavar"] = tuple(said["metavar"])
        chosen[one_of].add_argument(argument, **said)


def scene_of(arguments: argparse.Namespace, *, beyond_bus: bool = False) -> "Scene":
    """Load the scene that the arguments name; `beyond_bus` as for `load_scene`.

    User code is left unread for a command without `--allow-code`, since such a command runs no scene.

    Raises:
        SceneError: The scene has a fault.
    """
    from canhaptic.scene.load import load_scene

    allow_code: bool | None = getattr(arguments, "allow_code", None)
    code = {"allow_code": bool(allow_code), "leave_code": allow_code is None}
    return load_scene(arguments.config, arguments.overrides, beyond_bus=beyond_bus, **code)


def check_picture(path: Path, force: bool) -> None:
    """Refuse a picture file that could not be written, before the run.

    Args:
        path: File to write.
        force: Whether it may replace an existing file.

    Raises:
        InputError: The suffix is unknown, the folder is missing, or matplotlib is not installed.
    """
    if path.suffix not in _PICTURES:
        raise InputError(f"{path}: expected a name that ends in {', '.join(_PICTURES[:-1])} or {_PICTURES[-1]}")
    check_page(path, force)


def check_page(path: Path, force: bool) -> None:
    """Refuse a page or picture file that could not be written, before the run.

    Args:
        path: File to write.
        force: Whether it may replace an existing file.

    Raises:
        InputError: The folder is missing, a file exists that is no page or picture, or matplotlib is not installed.
    """
    from canhaptic.view.picture_style import require_matplotlib

    check_place(path, force or path.suffix.lower() in _MADE_ANEW)
    require_matplotlib()


def check_place(path: Path, force: bool) -> None:
    """Refuse an output file that could not be written, before the run.

    Args:
        path: File to write.
        force: Whether it may replace an existing file.

    Raises:
        InputError: The folder is missing, the file exists, or the path is not a regular file.
    """
    if not path.absolute().parent.is_dir():
        raise InputError(f"{path}: no such folder {path.absolute().parent}; make it first")
    require_writable_place(path)
    if not force:
        require_new(path)


def is_of_line(path: Path) -> bool:
    """Return whether a file is named as that of an EtherCAT drive: an ESI or the content of an EEPROM."""
    return path.name.lower().removesuffix(".gz").endswith((".xml", ".bin"))


def require_new(*files: Path) -> None:
    """Refuse to overwrite files, before the run.

    Raises:
        InputError: One of the files exists, or the unfinished log of a killed run.
    """
    for path in files:
        unfinished = [path.with_name(f"{path.name}.log")] if path.suffix.lower() in CONVERTIBLE else []
        for taken in filter(Path.exists, [path, *unfinished]):
            raise InputError(f"{taken} already exists; --force replaces it, or name another file")


def seconds(text: str) -> float:
    """Return a duration [s] from `10`, `10 s`, `500 ms` or `2 min`.

    Raises:
        argparse.ArgumentTypeError: The text is not a duration above zero.
    """
    return _positive_number(text, ("s", "s"), "duration", 1e6)


def _number(text: str, units: tuple[str, str]) -> float:
    """Return a number in SI units from a text; `units` and errors as for `_positive_number`."""
    from canhaptic.units import Unit

    try:
        return float(str(Unit(*units).read(text)))
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"got {text!r}, {error}") from error


def _positive_number(text: str, units: tuple[str, str], name: str, most: float) -> float:
    """Return a number above zero in SI units from a text with or without its unit.

    Args:
        text: Text as typed.
        units: Accepted units for linear and for rotary motion.
        name: Name of the quantity, for the message.
        most: Largest accepted value.

    Raises:
        argparse.ArgumentTypeError: The text is not a number of this dimension, or the number is out of range.
    """
    value = _number(text, units)
    if not 0.0 < value <= most:
        shown = " or ".join(dict.fromkeys(units))
        raise argparse.ArgumentTypeError(f"got {text!r}, expected 0 < {name} <= {most:g} [{shown}]")
    return value


def _names(text: str) -> list[str]:
    """Return the names of a comma-separated list.

    Raises:
        argparse.ArgumentTypeError: The list is empty.
    """
    found = [name.strip() for name in text.split(",") if name.strip()]
    if not found:
        raise argparse.ArgumentTypeError(f"got {text!r}, expected names separated by commas")
    return found


_DIGITS: Final = re.compile(r"[0-9]{1,12}")


def _delays(text: str) -> list[int]:
    """Return the delays of a comma-separated list, 0 or 1 sample time, without repetition."""
    given = list(dict.fromkeys(_names(text)))
    if not set(given) <= {"0", "1"}:
        raise argparse.ArgumentTypeError(f"got {text!r}, expected 0 (event), 1 (synchronous) or 0,1")
    return [int(one) for one in given]


def _whole(least: int, most: int) -> Callable[[str], int]:
    def read(text: str) -> int:
        if not _DIGITS.fullmatch(text) or not least <= int(text) <= most:
            raise argparse.ArgumentTypeError(f"got {text!r}, expected a whole number from {least} to {most}")
        return int(text)

    return read


_rate: Final = partial(_positive_number, units=("Hz", "Hz"), name="rate", most=1e6)
_READERS: Final[dict[str, Callable[[str], object]]] = {
    "path": Path,
    "word": str,
    "float": float,
    "int": int,
    "integer": partial(int, base=0),
    "names": _names,
    "seconds": seconds,
    "moment": partial(_number, units=("s", "s")),
    "budget": lambda text: 0.0 if text.strip() == "0" else seconds(text),
    "length": partial(_positive_number, units=("m", "rad"), name="tolerance", most=1.0),
    "rate": _rate,
    "rates": lambda text: list(dict.fromkeys(_rate(one) for one in _names(text))),
    "delays": _delays,
}
"""`type` of an argument in `options.toml` -> parser of its text."""


def read(kind: str, value: object, name: str) -> Any:
    """Return what the command line makes of a text; a value that is no text as it is.

    Args:
        kind: Key of `_READERS`.
        value: Text, such as "10 s" or "guarded,unprotected", or a value.
        name: Name of the argument, for the message.

    Raises:
        InputError: The text has another form.
    """
    if not isinstance(value, str):
        return value
    try:
        return _READERS[kind](value)
    except (argparse.ArgumentTypeError, ValueError) as error:
        raise InputError(f"{name}: {error}") from error
