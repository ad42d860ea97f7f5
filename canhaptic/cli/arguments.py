"""Arguments that several subcommands share."""

import argparse
from pathlib import Path
from typing import Final

from canhaptic.errors import InputError
from canhaptic.parameters import Unit
from canhaptic.scene.load import load_scene
from canhaptic.scene.models import Scene

PICTURES: Final = (".png", ".svg", ".pdf")
"""Suffixes of a picture."""


def add_scene(parser: argparse.ArgumentParser) -> None:
    """Declares the scene file and its overrides."""
    parser.add_argument("config", metavar="CONFIG", type=Path, help="scene file (YAML)")
    parser.add_argument(
        "--set",
        dest="overrides",
        metavar="PATH=VALUE",
        action="append",
        default=[],
        help="lay a value over the scene, as in axes.0.node_id=5 or environment.stiffness='500 N/m'; repeatable",
    )


def add_json(parser: argparse.ArgumentParser) -> None:
    """Declares `--json`."""
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of tables")


def scene_of(arguments: argparse.Namespace) -> Scene:
    """Returns the scene that the arguments name.

    Raises:
        SceneError: Anything in it is wrong.
    """
    return load_scene(arguments.config, arguments.overrides)


def check_picture(path: Path) -> None:
    """Refuses a picture that could not be written, before anything runs.

    Raises:
        InputError: An unknown suffix, or a folder that is not there.
    """
    if path.suffix not in PICTURES:
        raise InputError(f"{path}: expected a name that ends in {', '.join(PICTURES[:-1])} or {PICTURES[-1]}")
    if not path.absolute().parent.is_dir():
        raise InputError(f"{path}: no such folder {path.absolute().parent}; make it first")


def seconds(text: str) -> float:
    """Returns a duration [s] from `10`, `10 s`, `500 ms` or `2 min`.

    Raises:
        argparse.ArgumentTypeError: It is none, or not above zero.
    """
    try:
        value = float(str(Unit("s", "s").read(text)))
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"got {text!r}: {error}") from error
    if not 0.0 < value <= 1e6:
        raise argparse.ArgumentTypeError(f"got {text!r}, expected 0 < duration <= 1e6 [s]")
    return value
