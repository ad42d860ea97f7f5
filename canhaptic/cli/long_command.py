"""A command that takes time.

SIGINT and SIGTERM as the operator's stop: the first requests it, the second does not wait for the ramp.

Information shown before a real rig applies any torque: limits, check list and positions of the walls.
"""

import signal
from collections.abc import Callable, Iterator, Mapping
from types import FrameType, TracebackType
from typing import TYPE_CHECKING, Any, Final, Self

from canhaptic.axis_units import effort_unit
from canhaptic.cli.output import write_note
from canhaptic.scene.models import CHECK_LIST, AxisScene, CheckItem, Scene

if TYPE_CHECKING:
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


def notes(scene: Scene) -> Iterator[str]:
    """Notes on axes whose torque is reduced because its scale is not verified, the check list, and slow plants."""
    for axis in scene.axes:
        given, limit = axis.parameters, axis.loop.torque_limit or 0.0
        if limit < given.torque_limit and given.admittance is None:
            text = f"{given.name}: torque_verified: no: at most {limit:.3g} {effort_unit(given.unit)} are sent, a"
            yield f"{text} hundredth of torque_limit; canhaptic commission verifies the scale"
    if scene.simulation is None:
        yield from check_list(scene.run.confirmed)
    if scene.simulated:  # real drives load nothing of it
        from canhaptic.scene.method import dear_holds

        yield from dear_holds(scene)


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
