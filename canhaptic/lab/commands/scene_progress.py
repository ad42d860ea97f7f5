"""Progress of many scenes on standard error: count, rate, remaining time."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from canhaptic.drive.clock import WallClock
from canhaptic.lab.studies.runner import Progress as Scenes

_NOTE: Final = "compiling the loop, once for this kind of scene, about 15 s"


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
