"""Output of a study's result, to standard output and to the files named by the command."""

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Final

from rich.console import RenderableType

from canhaptic.cli.options import check_page, check_picture, check_place
from canhaptic.cli.output import note_file, write_json
from canhaptic.view.run_lines import make_console

_FILES: Final = {"png": ("picture", check_picture), "html": ("page", check_page), "markdown": ("tables", check_place)}
"""Argument -> kind of file, and the check that it can be written."""


def check_files(arguments: argparse.Namespace) -> None:
    """Check before the study that its files can be written.

    Raises:
        InputError: A file cannot be written.
    """
    for name, (_, check) in _FILES.items():
        if getattr(arguments, name, None) is not None:
            check(getattr(arguments, name), arguments.force)


def write_files(arguments: argparse.Namespace, **writers: Callable[[Path], None]) -> None:
    """Write the requested files; `writers` has a function for each argument that names a file."""
    for name, write in writers.items():
        if getattr(arguments, name) is not None:
            write(getattr(arguments, name))
            note_file(_FILES[name][0], getattr(arguments, name))


def show(arguments: argparse.Namespace, plain: object, report: Callable[[], RenderableType]) -> None:
    """Print a result as JSON if requested, else its report."""
    if arguments.json:
        write_json(plain)
    else:
        make_console().print(report())
