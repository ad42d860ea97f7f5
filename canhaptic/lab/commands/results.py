"""The result of a study on standard output, and in the files that its command names."""

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Final

from rich.console import RenderableType

from canhaptic.cli.options import check_page, check_picture, check_place
from canhaptic.cli.output import note_file, write_json
from canhaptic.view.run_lines import make_console

_FILES: Final = {"png": ("picture", check_picture), "html": ("page", check_page), "markdown": ("tables", check_place)}
"""Argument -> what the file is, and what refuses one that could not be written."""


def check_files(arguments: argparse.Namespace) -> None:
    """Refuse files that could not be written, before the study.

    Raises:
        InputError: One could not.
    """
    for name, (_, check) in _FILES.items():
        if getattr(arguments, name, None) is not None:
            check(getattr(arguments, name), arguments.force)


def write_files(arguments: argparse.Namespace, **writers: Callable[[Path], None]) -> None:
    """Write the files that are asked for: argument -> what writes it."""
    for name, write in writers.items():
        if getattr(arguments, name) is not None:
            write(getattr(arguments, name))
            note_file(_FILES[name][0], getattr(arguments, name))


def show(arguments: argparse.Namespace, plain: object, report: Callable[[], RenderableType]) -> None:
    """Write a result as JSON where that is asked for, else its report."""
    if arguments.json:
        write_json(plain)
    else:
        make_console().print(report())
