"""A command that takes time: its progress, and SIGINT and SIGTERM as the operator's stop.

SIGINT and SIGTERM as the operator's stop: the first requests it, the second does not wait for the ramp.

Progress on standard error, only on a terminal and only for tasks longer than a second.

At real pace the terminal must not delay the cycle: one short line twice a second, and only if it can be written
without waiting. No thread is started.

What a person reads before a real rig applies any torque: limits, check list, and where the walls lie.
"""

import os
import select
import signal
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from types import FrameType, TracebackType
from typing import TYPE_CHECKING, Any, Final, Literal, Self

from canhaptic.axis_units import effort_unit
from canhaptic.cli.output import write_note
from canhaptic.drive.clock import WallClock
from canhaptic.scene.models import CHECK_LIST, AxisScene, CheckItem, Scene

if TYPE_CHECKING:
    from rich.progress import Progress

    from canhaptic.scene.build import Experiment

_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM)
SHELL_OFFSET: Final = 128  # exit status of a process ended by signal n is 128 + n


class StopSignal:
    """Within the block, a signal sets `requested` instead of ending the process; a second one ends it at once.

    Attributes:
        number: The first signal received; 0 while there was none.
    """

    def __init__(self) -> None:
        self.number = 0
        self._before: dict[int, Any] = {}

    def requested(self) -> bool:
        """Return whether to stop."""
        return self.number != 0

    @property
    def exit_status(self) -> int:
        """130 after SIGINT, 143 after SIGTERM, 0 without a signal."""
        return SHELL_OFFSET + self.number if self.number else 0

    def __enter__(self) -> Self:
        self._before = {number: signal.signal(number, self._take) for number in _SIGNALS}
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _take(self, number: int, frame: FrameType | None) -> None:
        if self.number:
            raise SystemExit(self.exit_status)
        self.number = number


_FIRST: Final = 1_000_000_000  # [ns]
_INTERVAL: Final = {"real": 500_000_000, "free": 100_000_000}  # [ns]


_Pace = Literal["real", "free"]


@contextmanager
def run_progress(
    cycles: int | None, sample_time: float, pace: _Pace, every: int = 64
) -> Iterator["RunProgress | None"]:
    """Progress of a run on a terminal; None where standard error is not a terminal.

    The arguments are those of `RunProgress`.
    """
    if not sys.stderr.isatty():
        yield None
        return
    with RunProgress(cycles, sample_time, pace, every) as progress:
        yield progress


class RunProgress:
    """Takes the number of completed cycles and shows it from time to time.

    Args:
        cycles: Total number of cycles; None if unknown.
        sample_time: Sample time [s].
        pace: Pace of the run.
        every: At free pace, number of cycles between updates.
    """

    def __init__(self, cycles: int | None, sample_time: float, pace: _Pace, every: int = 64) -> None:
        self._cycles = cycles
        self._every = every
        self._sample_time = sample_time
        self._pace = pace
        self._clock = WallClock()
        self._next = self._clock.now() + _FIRST
        self._shown = False
        self._bar: Progress | None = None

    def __call__(self, cycles: int) -> None:
        """Take the number of completed cycles; cheap except for a few calls a second."""
        if self._pace == "free" and cycles % self._every:
            return
        now = self._clock.now()
        if now >= self._next:
            self._next = now + _INTERVAL[self._pace]
            self._show(cycles)

    def _show(self, cycles: int) -> None:
        self._shown = True
        if self._pace == "real" or self._cycles is None:
            end = "" if self._cycles is None else f" of {self._cycles * self._sample_time:g} s"
            _write_if_free(f"\r  {cycles * self._sample_time:8.1f} s{end}   {cycles} cycles ")
            return
        if self._bar is None:
            from rich.console import Console
            from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

            columns = (
                TextColumn("  running"),
                BarColumn(),
                TextColumn("{task.percentage:3.0f} %"),
                TimeRemainingColumn(),
            )
            self._bar = Progress(*columns, console=Console(stderr=True), auto_refresh=False, transient=True)
            self._bar.start()
            self._bar.add_task("run", total=self._cycles)
        self._bar.update(self._bar.task_ids[0], completed=cycles, refresh=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()
        elif self._shown:
            _write_if_free("\r\033[K")


def _write_if_free(text: str) -> None:
    """Write to standard error unless that would wait (a terminal stopped with Ctrl-S)."""
    descriptor = sys.stderr.fileno()
    if select.select([], [descriptor], [], 0.0)[1]:
        os.write(descriptor, text.encode())


def notes(scene: Scene) -> Iterator[str]:
    """Notes on axes whose torque is reduced because its scale is not verified, and the check list."""
    for axis in scene.axes:
        given, limit = axis.parameters, axis.loop.torque_limit or 0.0
        if limit < given.torque_limit and given.admittance is None:
            yield (
                f"{given.name}: torque_verified: no: at most {limit:.3g} {effort_unit(given.unit)} are sent, a "
                "hundredth of torque_limit; canhaptic commission verifies the scale"
            )
    if scene.simulation is None:
        yield from check_list(scene.run.confirmed)


def check_list(confirmed: Mapping[CheckItem, str]) -> Iterator[str]:
    """Lines of the check list: what was confirmed and when, and what was not."""
    for key, text in CHECK_LIST.items():
        yield f"{'x' if key in confirmed else ' '} {key}: {text}; {confirmed.get(key, 'not confirmed')}"


def walls_first(experiment: "Experiment", stop_requested: Callable[[], bool]) -> Callable[[], bool]:
    """Return `stop_requested`, which first shows where the walls lie: drives are enabled, and no torque was sent."""
    if all(axis.parameters.position_reference != "at_start" for axis in experiment.scene.axes):
        return stop_requested
    waiting = [experiment]

    def requested() -> bool:
        if waiting:
            for text in _walls(waiting.pop()):
                write_note(f"  {text}")
        return stop_requested()

    return requested


def _walls(experiment: "Experiment") -> Iterator[str]:
    for axis, drive in zip(experiment.scene.axes, experiment.rig.drives, strict=True):
        if axis.parameters.position_reference != "at_start":
            continue
        at, unit = drive.scaling.position(drive.position_counts), axis.parameters.unit
        ways = [f"{key} at {place:.4g} {unit}, {place - at:+.4g} from here" for key, place in _places(axis)]
        where = f"the handle is at {at:.4g} {unit} from where power came on"
        yield f"{axis.parameters.name}: {'; '.join([where, *ways])}"


def _places(axis: AxisScene) -> Iterator[tuple[str, float]]:
    """Walls and limits of an axis, by their keys."""
    for of, keys in (
        (axis.environment.parameters, ("position", "lower_wall", "upper_wall")),
        (axis.parameters.admittance, ("position_low", "position_high")),
    ):
        for key in keys:
            if isinstance(place := getattr(of, key, None), float):
                yield key, place
