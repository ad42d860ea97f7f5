"""Progress of many scenes on standard error: how many, how many a second, how long it will still take."""

from types import TracebackType
from typing import Self

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from canhaptic.drive.clock import WallClock
from canhaptic.study.sweep.sweep import Progress as Scenes


class SceneProgress:
    """Told how far a sweep is; shows it from the first time on, so that a long first chunk is no silence.

    Args:
        what: Is counted, in one word.
    """

    def __init__(self, what: str = "scenes") -> None:
        self._what = what
        self._clock = WallClock()
        self._begin = self._clock.now()
        self._bar: Progress | None = None

    def __call__(self, scenes: Scenes) -> None:
        """Takes how far it is."""
        elapsed = self._clock.now() - self._begin
        if self._bar is None:
            columns = (
                TextColumn(f"  {self._what}"),
                BarColumn(),
                MofNCompleteColumn(),
                TextColumn("{task.fields[rate]} /s"),
                TimeRemainingColumn(elapsed_when_finished=True),
            )
            self._bar = Progress(*columns, console=Console(stderr=True), transient=True, refresh_per_second=4)
            self._bar.start()
            self._bar.add_task("sweep", total=scenes.total, completed=scenes.begun, rate="")
        rate = (scenes.done - scenes.begun) / max(elapsed * 1e-9, 1e-9)
        self._bar.update(self._bar.task_ids[0], completed=scenes.done, rate=f"{rate:.3g}")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()
