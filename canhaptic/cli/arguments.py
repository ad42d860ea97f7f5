"""Arguments that several subcommands share."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Final

from canhaptic.errors import InputError
from canhaptic.host.output_file import require_writable_place
from canhaptic.logs.log_file import CONVERTIBLE

if TYPE_CHECKING:
    from canhaptic.scene.models import Scene

_PICTURES: Final = (".png", ".svg", ".pdf")
"""Suffixes of a picture."""


def add_scene(parser: argparse.ArgumentParser, *, runs: bool = True) -> None:
    """Declare the scene file and its overrides, and for a command that runs the scene `--allow-code`."""
    parser.add_argument("config", metavar="CONFIG", type=Path, help="scene file (YAML)")
    add_overrides(parser)
    if runs:
        add_allow_code(parser)


def add_allow_code(parser: argparse.ArgumentParser) -> None:
    """Declare `--allow-code`."""
    parser.add_argument(
        "--allow-code", action="store_true", help="run the program files that the scene names (type: my_wall.py:MyWall)"
    )


def add_overrides(parser: argparse.ArgumentParser) -> None:
    """Declare `--set`."""
    parser.add_argument(
        "--set",
        dest="overrides",
        metavar="PATH=VALUE",
        action="append",
        default=[],
        help="override a value of the scene, as in axes.0.node_id=5 or environment.stiffness='500 N/m'; repeatable",
    )


def add_json(parser: argparse.ArgumentParser, what: str = "one JSON object instead of tables") -> None:
    """Declare `--json`."""
    parser.add_argument("--json", action="store_true", help=f"print {what}")


def scene_of(arguments: argparse.Namespace, *, beyond_bus: bool = False) -> "Scene":
    """Return the scene that the arguments name; `beyond_bus` as for `load_scene`.

    A command without `--allow-code` runs no scene, and leaves own code unread.

    Raises:
        SceneError: Anything in it is wrong.
    """
    from canhaptic.scene.load import load_scene

    allow_code: bool | None = getattr(arguments, "allow_code", None)
    return load_scene(
        arguments.config,
        arguments.overrides,
        allow_code=bool(allow_code),
        leave_code=allow_code is None,
        beyond_bus=beyond_bus,
    )


def check_picture(path: Path) -> None:
    """Refuse a picture that could not be written, before the run.

    Raises:
        InputError: An unknown suffix, no place for it, or matplotlib is not installed.
    """
    if path.suffix not in _PICTURES:
        raise InputError(f"{path}: expected a name that ends in {', '.join(_PICTURES[:-1])} or {_PICTURES[-1]}")
    check_place(path)
    from canhaptic.view.picture_style import require_matplotlib

    require_matplotlib()


def check_page(path: Path) -> None:
    """Refuse a page that could not be written, before the run.

    Raises:
        InputError: There is no place for it, or matplotlib is not installed.
    """
    from canhaptic.view.picture_style import require_matplotlib

    check_place(path)
    require_matplotlib()


def check_place(path: Path) -> None:
    """Refuse a file that could not be written, before the run.

    Raises:
        InputError: There is no folder for it, or its path is no regular file.
    """
    if not path.absolute().parent.is_dir():
        raise InputError(f"{path}: no such folder {path.absolute().parent}; make it first")
    require_writable_place(path)


def require_new(*logs: Path) -> None:
    """Refuse logs that would overwrite a file, before the run.

    Raises:
        InputError: One of them exists, or the remains of a killed run's log.
    """
    for path in logs:
        unfinished = [path.with_name(f"{path.name}.log")] if path.suffix.lower() in CONVERTIBLE else []
        for taken in filter(Path.exists, [path, *unfinished]):
            raise InputError(f"{taken} already exists; --force replaces it, or name another file")


def seconds(text: str) -> float:
    """Return a duration [s] from `10`, `10 s`, `500 ms` or `2 min`.

    Raises:
        argparse.ArgumentTypeError: It is none, or not above zero.
    """
    return positive_number(text, ("s", "s"), "duration", 1e6)


def number(text: str, units: tuple[str, str]) -> float:
    """Return a number in SI from a text; `units` and errors as for `positive_number`."""
    from canhaptic.units import Unit

    try:
        return float(str(Unit(*units).read(text)))
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"got {text!r}, {error}") from error


def positive_number(text: str, units: tuple[str, str], name: str, most: float) -> float:
    """Return a number above zero, SI, from a text with or without its unit.

    Args:
        text: The text as typed.
        units: Accepted units for linear and for rotary motion.
        name: Name of the quantity, for the message.
        most: Largest accepted value.

    Raises:
        argparse.ArgumentTypeError: It is no number of this dimension, or out of range.
    """
    value = number(text, units)
    if not 0.0 < value <= most:
        shown = " or ".join(dict.fromkeys(units))
        raise argparse.ArgumentTypeError(f"got {text!r}, expected 0 < {name} <= {most:g} [{shown}]")
    return value


def names(text: str) -> list[str]:
    """Return names that commas separate.

    Raises:
        argparse.ArgumentTypeError: There is none.
    """
    found = [name.strip() for name in text.split(",") if name.strip()]
    if not found:
        raise argparse.ArgumentTypeError(f"got {text!r}, expected names with commas")
    return found
