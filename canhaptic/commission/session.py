"""The rig under commissioning: one experiment, run again and again with torques computed in advance."""

import dataclasses
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Final

from canhaptic.axis_units import effort_unit
from canhaptic.commission.dialogue import Dialogue
from canhaptic.commission.findings import Report, StepFinding, StepVerdict, Value
from canhaptic.commission.laws import NO_TORQUE, CommissioningLimits, OpenLoop
from canhaptic.cycle import Cycle, run
from canhaptic.drive.can.display_drive import DisplayDrive
from canhaptic.drive.can.servo_drive import ServoDrive
from canhaptic.drive.rig import Rig
from canhaptic.errors import InputError
from canhaptic.scene.build import Experiment, build
from canhaptic.scene.models import AxisScene, Scene
from canhaptic.signals import Truth

_AT_REST: Final = 0.1  # [s] in which an axis at rest moves by no more than some counts
_STILL_COUNTS: Final = 2
_DRIFT: Final = 0.005  # of the travel in that time: what is left of a motion then takes no test beyond it
_COAST: Final = 20.0  # [s] until it comes to rest
_HALVINGS: Final = 5  # amplitudes that are tried, each half of the one before


class Session:
    """Scene, rig and limits, shared by all steps.

    Args:
        scene: Axes on one or several buses; axes joined by a simulated mechanism cannot be tried one by one.
        dialogue: Dialogue with the person.
        limits: Limits of torque, travel and the like.
        stop_requested: The operator's stop.

    Attributes:
        report: Findings so far.
        encoder_ratios: Displacement by the configured encoder, as a part of the measured one, per axis.
    """

    def __init__(
        self, scene: Scene, dialogue: Dialogue, limits: CommissioningLimits, stop_requested: Callable[[], bool]
    ) -> None:
        self.scene = scene
        self.dialogue = dialogue
        self.limits = limits
        self.report = Report()
        self.stop_requested = stop_requested
        self.sample_time = scene.bus.sample_time
        self.encoder_ratios = [1.0] * len(scene.axes)
        self._experiment: Experiment | None = None
        self.truths: Sequence[Truth] = ()

    @contextmanager
    def rig_of(self, *, with_hand: bool) -> Iterator[None]:
        """Build the rig for the steps inside; nothing is sent before one of them does.

        Args:
            with_hand: Whether the simulated hand is on the handle; a person was asked to hold it, or to let go.
        """
        scene = self.scene if with_hand else _without_hand(self.scene)
        try:
            with build(scene) as self._experiment:
                for drive in self.drives:
                    if isinstance(drive, DisplayDrive):
                        drive.checks_rest = False  # the offset is to be measured
                yield
        finally:
            self._experiment = None

    @property
    def experiment(self) -> Experiment:
        """The rig as built.

        Raises:
            InputError: Asked for outside `rig_of`.
        """
        if self._experiment is None:
            raise InputError("commissioning: no rig is built; use `rig_of`")
        return self._experiment

    @property
    def rig(self) -> Rig:
        """The rig of the experiment."""
        return self.experiment.rig

    @property
    def drives(self) -> Sequence[ServoDrive]:
        """One per axis."""
        return self.rig.drives

    @property
    def axes(self) -> Sequence[AxisScene]:
        """One per axis."""
        return self.scene.axes

    def coast(self, axis: int) -> None:
        """Wait without torque until an axis is at rest, as long as a nearly frictionless bearing may take.

        Raises:
            RigError: Drive or link failed; torque is zero.
        """
        law, watched = OpenLoop(NO_TORQUE), self.cycles(_AT_REST)
        still = max(_STILL_COUNTS / self.axes[axis].parameters.counts_per_unit, _DRIFT * self.limits.travel)

        def at_rest() -> bool:
            last = law.positions[-watched:]
            return len(last) == watched and max(last) - min(last) <= still

        self.run(
            [law if n == axis else OpenLoop(NO_TORQUE) for n in range(len(self.axes))], self.cycles(_COAST), at_rest
        )

    def play_within(
        self, axis: int, item: str, torques_of: Callable[[float], Sequence[float]], torque: float
    ) -> OpenLoop:
        """Play torques of an amplitude as `play` does; where the axis goes too far or too fast, again with half of it.

        Args:
            axis: Its index.
            item: Measured quantity.
            torques_of: Torques of an amplitude, one per cycle [N or N*m].
            torque: Amplitude [N or N*m].

        Raises:
            RigError: Drive or link failed; torque is zero.
        """
        name, unit = self.axes[axis].parameters.name, effort_unit(self.axes[axis].parameters.unit)
        for left in reversed(range(_HALVINGS)):
            self.coast(axis)
            torques = torques_of(torque)
            law = self.play(axis, torques, len(torques) + 2)  # the last one ends as well, or the axis moves on
            if not law.tripped or law.has_gap or self.stop_requested() or not left:
                break
            torque *= 0.5
            self.dialogue.tell(f"  {name}: {item}: stopped, handle {law.tripped}; repeating with {torque:.3g} {unit}")
        return law

    def play(
        self,
        axis: int,
        torques: Sequence[float],
        cycles: int,
        ready: Callable[[], bool] = lambda: False,
        limits: CommissioningLimits | None = None,
    ) -> OpenLoop:
        """Run the rig with torques on one axis and none on the others, stop it, and return the motion of that axis.

        Args:
            axis: Its index.
            torques: One per cycle [N or N*m].
            cycles: Largest number of cycles.
            ready: Ends it earlier when true.
            limits: Limits in place of those of the session.

        Raises:
            RigError: Drive or link failed; torque is zero.
        """
        limits = limits or self.limits
        largest_step = limits.speed * self.sample_time
        laws = [
            OpenLoop(torques, limits.travel, largest_step) if n == axis and torques else OpenLoop(NO_TORQUE)
            for n in range(len(self.axes))
        ]
        self.run(laws, cycles, ready)
        return laws[axis]

    def run(self, laws: Sequence[OpenLoop], cycles: int, ready: Callable[[], bool] = lambda: False) -> Cycle:
        """Run the rig with one law per axis and stop it; return the cycle with its timing.

        Raises:
            RigError: Drive or link failed; torque is zero.
        """
        far_side = self.experiment.far_side

        def read() -> Sequence[Truth]:
            self.truths = [drive.truth() for drive in far_side.drives] if far_side is not None else []
            return self.truths

        cycle = Cycle(self.rig, laws, None, read if far_side is not None else None)
        run(cycle, cycles, lambda: self.stop_requested() or ready())
        return cycle

    def truth(self, axis: int) -> float | None:
        """Return the true position of a simulated axis at the last SYNC of the last run; None with a real one."""
        return self.truths[axis].position if self.truths else None

    def cycles(self, seconds: float) -> int:
        """Number of cycles in a time."""
        return max(1, round(seconds / self.sample_time))

    def found(self, axis: int, item: str, configured: str, found: str, verdict: StepVerdict, text: str = "") -> None:
        """Add a row to the report and print it."""
        name = self.axes[axis].parameters.name
        self.report.add(StepFinding(name, item, configured, found, verdict, text))
        self.dialogue.tell(f"  {name}: {item}: {found} ({verdict.value})")

    def judged(
        self,
        axis: int,
        item: str,
        configured: str,
        found: str,
        *,
        good: bool,
        text: str,
        otherwise: StepVerdict = StepVerdict.DIFFERS,
    ) -> None:
        """Add a row that agrees, or has another verdict and a remedy."""
        self.found(axis, item, configured, found, StepVerdict.AGREES if good else otherwise, "" if good else text)

    def agreed(self, question: str, item: str, axes: Iterable[int], text: str = "") -> bool:
        """Whether the person agrees to a trial; otherwise the report records it for these axes."""
        if self.dialogue.confirm(question):
            return True
        self.not_tried(item, axes, text)
        return False

    def not_tried(self, item: str, axes: Iterable[int], text: str = "") -> None:
        """Add a row per axis for a trial that was left out."""
        for axis in axes:
            self.found(axis, item, "", "not tried", StepVerdict.UNKNOWN, text)

    def propose(self, axis: int, key: str, value: float | int | str | None, unit: str = "", comment: str = "") -> None:
        """Propose a value for the scene; None: its present value is right."""
        self.report.propose(Value(self.axes[axis].parameters.name, key, value, unit, comment))


def _without_hand(scene: Scene) -> Scene:
    """Return the scene without a hand at its simulated handles."""
    axes = [
        dataclasses.replace(axis, simulation=axis.simulation and dataclasses.replace(axis.simulation, user=None))
        for axis in scene.axes
    ]
    return dataclasses.replace(scene, axes=tuple(axes))
