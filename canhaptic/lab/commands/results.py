"""Output of a study: progress on standard error, the result on standard output and in files that the command names."""

import argparse
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from rich.console import Console, RenderableType
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from canhaptic.cli.options import check_page, check_picture, check_place
from canhaptic.drive.clock import WallClock
from canhaptic.lab.studies.runner import Progress as Scenes
from canhaptic.view.run_lines import make_console
from canhaptic.view.terminal import note_file, write_json

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


_NOTE: Final = "compiling the loop, once for this kind of scene, about 10 s"


@contextmanager
def scene_progress(what: str = "scenes") -> Iterator[Callable[[Scenes], None]]:
    """Yield a function that shows the progress of a sweep on a terminal.

    Args:
        what: Name of the counted items, one or two words.
    """
    columns = (
        TextColumn(f"  {what}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]} /s"),
        TimeRemainingColumn(elapsed_when_finished=True),
        TextColumn("{task.fields[note]}"),
    )
    clock = WallClock()
    begin, unseen = clock.now(), not sys.stderr.isatty()
    with Progress(*columns, console=Console(stderr=True), transient=True, refresh_per_second=4, disable=unseen) as bar:

        def show(scenes: Scenes) -> None:
            if not bar.tasks:
                bar.add_task(what, total=scenes.total, completed=scenes.begun, rate="", note="")
            rate = (scenes.done - scenes.begun) / max((clock.now() - begin) * 1e-9, 1e-9)
            bar.update(
                bar.task_ids[0], completed=scenes.done, rate=f"{rate:.3g}", note=_NOTE if scenes.compiles else ""
            )

        yield show
