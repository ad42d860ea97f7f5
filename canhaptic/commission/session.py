"""A commissioning session: the rig, the dialogue with the person at the machine, and the report.

Each test runs the rig with torques computed in advance and records the motion. Its findings are rows of the report,
with the values that they propose for the scene.
"""

import dataclasses
import math
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from enum import Enum
from typing import Annotated, Any, Final, NamedTuple, Protocol, cast

import numpy as np
from numpy.typing import NDArray

from canhaptic.axis_units import effort_unit
from canhaptic.control.balance import AT_REST, Branch, Certificate, EnergyBalance
from canhaptic.control.ports import axis_ports
from canhaptic.cycle import Cycle, run
from canhaptic.drive.can.servo_drive import ServoDrive
from canhaptic.drive.profile.drive_objects import settings_of, settings_text
from canhaptic.drive.profile.drive_settings import changed_settings, recorded_settings
from canhaptic.drive.rig import Rig
from canhaptic.errors import ControlError, InputError
from canhaptic.scene.build import Experiment, build
from canhaptic.scene.models import LOOP_KEYS, TO_SET, AxisScene, Scene
from canhaptic.scene.scene_text import Change, is_written
from canhaptic.signals import Truth
from canhaptic.units import Parameters, quantity
from canhaptic.view.table import Cell, Styled, Table


class Dialogue(Protocol):
    """Questions to a person at a terminal; with a simulated drive they can be answered without one.

    `truth` is the answer of the simulated plant, if there is one. It is never shown to a person.
    """

    def tell(self, text: str) -> None:
        """Show a line."""

    def confirm(self, question: str) -> bool:
        """Return whether the person agrees; no answer counts as no."""

    def number(self, question: str, unit: str, truth: float | None) -> float | None:
        """Ask for a number in `unit`; None without an answer."""

    def choose(self, question: str, answers: Sequence[str], truth: str) -> str:
        """Ask for one of the answers; the last one if none is given."""

    def until_ready(self, text: str, cycles: int) -> Callable[[], bool]:
        """Ask the person to act; return a function, called once per cycle, that reports completion.

        Args:
            text: Request to the person.
            cycles: Number of cycles after which an unattended run counts the request as done.
        """


class Unattended:
    """Dialogue that agrees to everything and answers from the truth: for simulated drives only."""

    def __init__(self, tell: Callable[[str], None]) -> None:
        self.tell = tell

    def confirm(self, question: str) -> bool:
        """Agree."""
        self.tell(f"{question} yes")
        return True

    def number(self, question: str, unit: str, truth: float | None) -> float | None:
        """True value of the simulated plant."""
        self.tell(f"{question} {'unknown' if truth is None else f'{truth:.6g} {unit}'}")
        return truth

    def choose(self, question: str, answers: Sequence[str], truth: str) -> str:
        """Return the right answer, which the simulated plant knows."""
        self.tell(f"{question} {truth}")
        return truth

    def until_ready(self, text: str, cycles: int) -> Callable[[], bool]:
        """Wait for a number of cycles."""
        self.tell(text)
        left = iter(range(cycles))
        return lambda: next(left, None) is None


class StepVerdict(Enum):
    """Verdict on one item of the report."""

    AGREES = "agrees"  # measured, and as configured
    DIFFERS = "differs"  # measured, and not as configured: the value found is to be used
    MEASURED = "measured"  # there was nothing to compare it with
    FAILED = "failed"  # do not put a hand on this rig
    UNKNOWN = "not verified"


class StepFinding(NamedTuple):
    """One item that was checked."""

    axis: str
    item: str
    configured: str
    found: str
    verdict: StepVerdict
    text: str = ""  # what it means, or what to do


class Value(NamedTuple):
    """A value proposed for a key of the scene."""

    axis: str
    key: str  # path in the axis, as `counts_per_unit` or `passivity.moving_mass`
    value: float | int | str | None  # SI; None: the one that the scene has is right
    unit: str
    comment: str = ""
    least: float | None = None  # lower end of a range; None: no range

    @property
    def text(self) -> str | None:
        """The value as written in a scene; None: the key keeps its present value."""
        factor, unit = _SHOWN_IN.get(self.unit, (1.0, self.unit))
        if not isinstance(self.value, float):  # whole where the drive has it
            return None if self.value is None else str(self.value)
        largest = f"{self.value * factor:.6g} {unit}".rstrip()
        return largest if self.least is None else f"[{self.least * factor:.6g} {unit}, {largest}]"


_SHOWN_IN: Final = {"s": (1e6, "us"), "1": (100.0, "%")}
"""SI unit -> factor and name of the unit in which small values are written."""
_MENDED: Final = ("moving mass", "dry friction, least")
"""Items of wrong declarations that the measured values replace."""
_COLOURS: Final = {
    StepVerdict.AGREES: "green",
    StepVerdict.DIFFERS: "yellow",
    StepVerdict.FAILED: "bold red",
    StepVerdict.MEASURED: "cyan",
    StepVerdict.UNKNOWN: "dim",
}


class Report:
    """Findings and values, added step by step so that earlier findings survive a later error."""

    def __init__(self) -> None:
        self.findings: list[StepFinding] = []
        self.values: list[Value] = []

    @property
    def failed(self) -> bool:
        """Whether any finding forbids the use of this rig."""
        return any(finding.verdict is StepVerdict.FAILED for finding in self.findings)

    @property
    def differs(self) -> bool:
        """Whether the configuration is to be corrected."""
        return any(finding.verdict is StepVerdict.DIFFERS for finding in self.findings)

    def changes(self, scene: Scene) -> list[Change]:
        """Return the values as changes of a scene; for a key that all axes of a group share, the largest.

        A simulated drive says nothing of a real one: each value it gave is marked for real drives, and none of them
        verifies the scale of the torque or confirms what was written.
        """
        values: dict[tuple[str, ...], Value] = {}
        for value in self.values:
            path = _path(scene, value)
            before = values.get(path)
            if before is None or not isinstance(before.value, float) or before.value < cast(float, value.value):
                values[path] = value
        if not scene.simulated:
            return [Change(path, value.text, value.comment or None) for path, value in values.items()]
        return [
            Change(path, value.text, f"{TO_SET}: {value.comment or 'measured'}, by a simulated drive")
            for path, value in values.items()
            if value.text is not None and value.key != "torque_verified"
        ]

    def unfinished(self, axes: Collection[str], items: Collection[str]) -> list[str]:
        """Reasons why a scene with these values is not ready to run; empty if all is verified.

        Args:
            axes: Names of all axes.
            items: Items that must be verified for each axis.
        """
        seen = {(row.axis, row.item) for row in self.findings if row.verdict is not StepVerdict.UNKNOWN}
        missing = [f"{axis}: {item}: not verified" for axis in axes for item in items if (axis, item) not in seen]
        failed = [row for row in self.findings if row.verdict is StepVerdict.FAILED and row.item not in _MENDED]
        return missing + [f"{row.axis}: {row.item}: {row.found}" for row in failed]

    def as_json(self) -> dict[str, Any]:
        """Return the report as plain values."""
        return {
            "status": "failed" if self.failed else "differs" if self.differs else "ok",
            "findings": [{**row._asdict(), "verdict": row.verdict.value} for row in self.findings],
            "values": [{**value._asdict(), "text": value.text} for value in self.values],
        }

    def next_step(self, items: Collection[str]) -> str:
        """Return the first thing that keeps a scene from being ready, and what to do about it.

        Args:
            items: Items that must be verified for each axis.
        """
        rows = [row for row in self.findings if row.item in items]
        is_open = [row for row in rows if row.verdict is StepVerdict.UNKNOWN]
        failed = [row for row in self.findings if row.verdict is StepVerdict.FAILED and row.item not in _MENDED]
        differing = [row for row in rows if row.verdict is StepVerdict.DIFFERS]  # as a scale, which ends the torques
        for axis, item, _, found, _, text in [*failed, *is_open, *differing]:
            return f"{axis}: {item}: {found}{f'; {text}' if text else ''}"
        return ""

    def table(self) -> Table:
        """Return the rows as a table for a terminal; the axis has a column where there are several."""
        rows: list[list[Cell]] = []
        for axis, item, configured, found, verdict, text in self.findings:
            of = f" (configured: {configured})" if configured and verdict is not StepVerdict.AGREES else ""
            seen = f"{found}{of}{f'; {text}' if text else ''}"
            rows.append([axis, item.replace("_", " "), seen, Styled(verdict.value, _COLOURS[verdict])])
        return _without_one_axis("commissioning", ("axis", "what", "found", "verdict"), rows)

    def values_table(self, written: str) -> Table:
        """Return the values, and where they were written, as a table for a terminal."""
        rows: list[list[Cell]] = [
            [value.axis, value.key, value.text or "unchanged", value.comment] for value in self.values
        ]
        return _without_one_axis(written, ("axis", "key", "value", ""), rows)


def _without_one_axis(title: str, columns: Sequence[str], rows: list[list[Cell]]) -> Table:
    """Return a table whose first column is left out where it names one axis only."""
    first = 0 if len({row[0] for row in rows}) > 1 else 1
    return Table(title, columns[first:], [row[first:] for row in rows])


def _path(scene: Scene, value: Value) -> tuple[str, ...]:
    """Path of a value in a scene, whether the scene has that key yet or not."""
    index = [axis.parameters.name for axis in scene.axes].index(value.axis)
    own, group = ("axes", str(index), *value.key.split(".")), scene.axes[index].group
    head, _, key = value.key.rpartition(".")
    if head != "passivity" or is_written(scene.text, own):
        return own
    if group and key not in LOOP_KEYS:
        return ("groups", group, head, key)
    return own if group or len(scene.axes) > 1 or is_written(scene.text, own[:3]) else (head, key)


class CommissioningLimits(Parameters):
    """Limits of commissioning."""

    torque: Annotated[float, quantity("1", gt=0.0, le=0.3)] = 0.1
    """Largest torque, as a part of the rated torque; never beyond `torque_limit` of the axis."""
    travel: Annotated[float, quantity("m", "rad", gt=0.0)] | None = None
    """Distance from the start of a step beyond which its torque is removed; None: what the tests need, asked for."""
    speed: Annotated[float, quantity("m/s", "rad/s", gt=0.0)] | None = None
    """Speed beyond which the torque of a step is removed; None: 0.5 m/s or 5 rad/s."""


FAR_COUNTS: Final = 32
"""Fewest counts of the encoder within which a travel can be limited."""
_FAST_COUNTS: Final = 4
"""Fewest counts over which a speed is judged: one count is no speed."""
_LONGEST_LOOK: Final = 0.1
"""Longest time over which a speed is judged [s]."""
TRAVELS: Final = {"m": 0.02, "rad": 0.2}
"""Travel of the tests where no larger one is needed: of a hand, and of a handle with an arm of 0.1 m."""
_SPEEDS: Final = {"m": 0.5, "rad": 5.0}


class Guard(NamedTuple):
    """Where a test ends: too far from its first position, or too fast over some samples."""

    travel: float = math.inf  # [m or rad]
    step: float = math.inf  # largest span of the positions of `samples` successive holds [m or rad]
    samples: int = 1
    far: str = ""  # the limits in words
    fast: str = ""


UNGUARDED: Final = Guard()
LOST: Final = "a TPDO was lost"
"""Reason why a torque was removed after which the same torque is tried again."""


class OpenLoop:
    """A controller that renders nothing: it plays torques, one per cycle, and drops to zero when the axis goes too far.

    On an axis that hangs from its brake they come on top of its declared weight.

    These torques are not passive: the account books the energy that they generate as deficit.

    Args:
        torques: One torque per cycle [N or N*m]; zero after the last.
        guard: Limits beyond which the torque is removed.

    Attributes:
        weight: Torque that holds the axis where it hangs [N or N*m]; `Session.run` takes it from the scene.
        positions: Position at every SYNC since `reset` [m or rad].
        applied: Torque of the hold that ended at every SYNC [N or N*m].
        sent: Torque returned at every SYNC; after `Session.play`, the torque that the limits let pass [N or N*m].
        tripped: Reason why the torque was removed; "" if it was not.
        has_gap: Whether a sample was lost: the positions then do not belong to consecutive SYNCs.
        skipped: SYNCs before which others were skipped, after `Session.play`.
    """

    def __init__(self, torques: Sequence[float] = (), guard: Guard = UNGUARDED) -> None:
        self._torques, self._guard, self.weight = tuple(torques), guard, 0.0
        self.reset()

    def reset(self) -> None:
        """Clear the record, and begin with the first torque."""
        self.positions: list[float] = []
        self.applied: list[float] = []
        self.sent: list[float] = []
        self.tripped = ""
        self.has_gap = False
        self.skipped: list[int] = []
        self._rest = iter(self._torques)
        self._last = AT_REST

    def regular_positions(self, later: int = 0) -> NDArray[np.float64]:
        """Return the positions, not a number at a SYNC after skipped ones: the hold before it was longer than a sample.

        Args:
            later: SYNCs after such a one that are left out too, for a torque sent before it that acts later.
        """
        positions = np.array(self.positions, dtype=np.float64)
        for sync in self.skipped:
            positions[sync : sync + later + 1] = np.nan
        return positions

    def sample_lost(self) -> EnergyBalance:
        """Send no further torque: a measurement with a missing sample is useless."""
        self.tripped, self.has_gap = self.tripped or LOST, True
        weight = self.weight if self.tripped == LOST else 0.0  # where it moved too far or too fast it may be why
        self._last = self._last._replace(torque=weight, h_i=0.0, h_m=0.0, deficit=0.0, branch=Branch.HELD.value)
        return self._last

    def step(self, position: float, torque_applied: float) -> EnergyBalance:
        """Record the hold that ended and return the next torque.

        Raises:
            ControlError: The position or torque is not finite.
        """
        if not math.isfinite(position + torque_applied):
            raise ControlError(f"got position {position} and torque {torque_applied}, expected finite values")
        displacement = position - self.positions[-1] if self.positions else 0.0
        self.positions.append(position)
        self.applied.append(torque_applied)
        guard = self._guard
        recent = self.positions[-guard.samples - 1 :]
        if abs(position - self.positions[0]) > guard.travel:
            self.tripped = self.tripped or f"moved further than {guard.far}"
        elif max(recent) - min(recent) > guard.step:
            self.tripped = self.tripped or f"moved faster than {guard.fast}"
        torque = 0.0 if self.tripped else self.next_torque()
        torque += self.weight if self.tripped in ("", LOST) else 0.0
        self.sent.append(torque)
        h_i = -torque_applied * displacement
        self._last = AT_REST._replace(
            torque=torque,
            h_i=h_i,
            h_m=h_i,
            deficit=-h_i,
            h_dis=self._last.h_dis - h_i,
            branch=Branch.DEPLETED.value if h_i else Branch.FREE.value,
            certificate=Certificate.NONE.value,
        )
        return self._last

    def next_torque(self) -> float:
        """Torque of the next hold [N or N*m]."""
        return next(self._rest, 0.0)


def doublet(torque: float, cycles: int) -> list[float]:
    """Return a torque with signs +, -, -, +, `cycles` each: a free mass returns to its initial position and speed."""
    return [torque] * cycles + [-torque] * (2 * cycles) + [torque] * cycles


def reversals(torque: float, longest: int, count: int) -> list[float]:
    """Return doublets of a torque [N or N*m], of both signs and many lengths; equal for every call.

    Args:
        torque: Size of the torque [N or N*m].
        longest: First part of the longest doublet [cycles]; the shortest is half as long.
        count: Number of doublets.
    """
    drawn = np.random.default_rng(1)
    lengths, signs = drawn.integers(longest // 2, longest + 1, count), drawn.choice([-1.0, 1.0], count)
    sizes = signs * drawn.uniform(0.6, 1.0, count)  # equal motions would repeat the errors of an encoder
    pairs = zip(lengths, sizes, strict=True)
    return [part for length, size in pairs for part in doublet(float(size * torque), int(length))]


def sweep(amplitude: float, lowest: float, highest: float, duration: float, sample_time: float) -> list[float]:
    """Return a cosine of rising frequency: a free mass swings about its initial position, and ends at rest.

    Args:
        amplitude: Size of the torque [N or N*m].
        lowest: First frequency [Hz].
        highest: Last frequency [Hz].
        duration: Length of the sweep [s].
        sample_time: Sample time [s].
    """
    rate = math.log(highest / lowest) / duration
    phases = 2.0 * np.pi * lowest * np.expm1(rate * np.arange(round(duration / sample_time)) * sample_time) / rate
    torques = amplitude * np.cos(phases)
    turns = np.flatnonzero(np.diff(np.signbit(np.cumsum(torques))))
    return [float(torque) for torque in torques[: turns[-1] + 1 if len(turns) else None]]


class Session:
    """Scene, rig and limits, shared by all steps.

    Args:
        scene: Axes on one or several buses; axes coupled by a simulated mechanism cannot be tested one by one.
        dialogue: Dialogue with the person.
        limits: Limits of torque, travel and speed.
        stop_requested: The operator's stop.
        compares: Whether a drive set otherwise than at the last commissioning is refused, as in a run.

    Attributes:
        axes: Axes of the scene.
        report: Findings so far.
        encoder_ratios: Displacement by the configured encoder over the measured one, per axis.
        travels: How far the tests may move each axis from its place [m or rad].
        quanta: Torque of one count of 0x6071 in the master's scaling, per axis; 0 until a drive reports it [N or N*m].
        verified: Axes whose torque scale is verified.
    """

    def __init__(
        self, scene: Scene, dialogue: Dialogue, limits: CommissioningLimits, stop_requested: Callable[[], bool],
        *, compares: bool = False,
    ) -> None:  # fmt: skip
        self._settings_before = [axis.parameters.settings_checked for axis in scene.axes]
        loops = [axis.loop.model_copy(update={"torque_limit": axis.parameters.torque_limit}) for axis in scene.axes]
        forget = {} if compares else {"settings_checked": None}
        known = [axis.parameters.model_copy(update=forget) for axis in scene.axes]
        parts = zip(scene.axes, loops, known, strict=True)
        self.axes = tuple(dataclasses.replace(axis, loop=loop, parameters=of) for axis, loop, of in parts)
        # A torque that is not verified is bounded by each step. A lost sample ends its torque (`OpenLoop`), and a drive
        # that shows another torque than the commanded one is to be found, not to be taken for a bad link
        bus = scene.bus.model_copy(update={"loss_limit": 1.0})
        self.scene = dataclasses.replace(scene, axes=self.axes, bus=bus)
        self.dialogue, self.limits, self.stop_requested = dialogue, limits, stop_requested
        self.report = Report()
        self.sample_time = scene.bus.sample_time
        self.encoder_ratios = [1.0] * len(scene.axes)
        self.travels = [limits.travel or TRAVELS[axis.parameters.unit] for axis in scene.axes]
        self.quanta: Sequence[float] = [axis.loop.torque_quantum or 0.0 for axis in scene.axes]
        self.verified: set[int] = set()
        self._experiment: Experiment | None = None
        self.truths: Sequence[Truth] = ()
        self._efforts: Sequence[float] = ()
        self._holds_of_stop = 0

    @contextmanager
    def rig_of(self, *, with_hand: bool, hand: Callable[[AxisScene], object] | None = None) -> Iterator[None]:
        """Build the rig for the steps inside the block; nothing is sent before one of them runs.

        Args:
            with_hand: Whether the simulated hand is on the handle; a person is asked to hold it, or to let go.
            hand: Simulated hand of the axis, replacing the scene's.
        """
        replaced = hand or (None if with_hand else lambda _: None)
        scene = self.scene if replaced is None else _with_hands(self.scene, replaced)
        try:
            with build(scene) as self._experiment:
                for drive in self.drives:
                    drive.checks_rest = False  # an offset is to be measured
                yield
        finally:
            self._experiment = None

    @property
    def experiment(self) -> Experiment:
        """The rig as built.

        Raises:
            InputError: No rig is built: this is outside `rig_of`.
        """
        if self._experiment is None:
            raise InputError("commissioning: the rig has not been built yet; build it with `rig_of`")
        return self._experiment

    @property
    def rig(self) -> Rig:
        """The rig of the experiment."""
        return self.experiment.rig

    @property
    def drives(self) -> Sequence[ServoDrive]:
        """Drives, one per axis."""
        return self.rig.drives

    def coast(self, axis: int, longest: float = 20.0) -> None:
        """Wait without torque, or with the declared weight, until an axis is at rest, for at most `longest` seconds.

        Raises:
            RigError: Drive or link failed; torque is zero.
        """
        law = OpenLoop((), self.guard(axis) if self.weight(axis) else UNGUARDED)  # a false weight lets it sink
        watched = self.cycles(0.1)
        # What is left of a motion then takes no test beyond it
        still = max(2.0 * self.count(axis), 0.005 * self.travels[axis])

        def at_rest() -> bool:
            last = law.positions[-watched:]
            return law.tripped not in ("", LOST) or (len(last) == watched and max(last) - min(last) <= still)

        self.run_alone(axis, law, self.cycles(longest), at_rest)

    def play_within(
        self, axis: int, item: str, torques_of: Callable[[float], Sequence[float]], torque: float
    ) -> OpenLoop:
        """Play torques of an amplitude as `play` does; where the axis goes too far or too fast, repeat with half of it.

        Where a TPDO was lost, the same amplitude is repeated.

        Args:
            axis: Index of the axis.
            item: Measured quantity.
            torques_of: Function from amplitude to torques, one per cycle [N or N*m].
            torque: Amplitude [N or N*m].

        Raises:
            RigError: Drive or link failed; torque is zero.
        """
        name, unit = self.axes[axis].parameters.name, effort_unit(self.axes[axis].parameters.unit)
        for left in reversed(range(5)):
            self.coast(axis)
            torques = torques_of(torque)
            law = self.play(axis, torques, len(torques) + 2)  # the last one ends as well, or the axis moves on
            if not law.tripped or self.stop_requested() or not left:
                break
            is_lost = law.tripped == LOST  # and not too fast or too far before
            torque *= 1.0 if is_lost else 0.5
            cause = law.tripped if is_lost else f"handle {law.tripped}"
            self.dialogue.tell(f"  {name}: {item}: stopped, {cause}; repeating with {torque:.3g} {unit}")
        return law

    def play(
        self, axis: int, torques: Sequence[float], cycles: int, ready: Callable[[], bool] = bool, travels: float = 1.0
    ) -> OpenLoop:
        """Run the rig with torques on one axis and none on the others, stop it, and return the motion of that axis.

        Args:
            axis: Index of the axis.
            torques: One torque per cycle [N or N*m].
            cycles: Largest number of cycles.
            ready: Function that ends the run early by returning true; None: the run has its full length.
            travels: Multiple of the travel of the axis.

        Raises:
            RigError: Drive or link failed; torque is zero.
        """
        sent, law = list[float](), OpenLoop(torques, self.guard(axis, travels) if torques else UNGUARDED)

        def note(holds_of_stop: int = 0) -> bool:
            if len(self.rig.records) > holds_of_stop:
                if self.rig.periods > 1:
                    law.skipped.append(len(sent))
                last = self.rig.records[-1 - holds_of_stop].torques_per_mille[axis]
                sent.append(self.drives[axis].scaling.torque(last))
            return ready() or law.tripped not in ("", LOST)

        self.run_alone(axis, law, cycles, note)
        note(self._holds_of_stop)
        law.sent = sent
        return law

    def count(self, axis: int) -> float:
        """Distance of one count of the encoder as configured [m or rad]."""
        return 1.0 / self.axes[axis].parameters.counts_per_unit

    def speed(self, axis: int) -> float:
        """Speed that the tests may give an axis [m/s or rad/s]."""
        parameters = self.axes[axis].parameters
        return min(self.limits.speed or _SPEEDS[parameters.unit], 0.5 * (parameters.speed_limit or math.inf))

    def weight(self, axis: int) -> float:
        """Torque that holds an axis that hangs from its brake, as declared; else 0 [N or N*m]."""
        brake = self.axes[axis].parameters.brake
        return 0.0 if brake is None else brake.holds_weight

    def guard(self, axis: int, travels: float = 1.0) -> Guard:
        """Return the limits of a test: of each the physical value, or a number of counts if that is larger.

        Args:
            axis: Index of the axis.
            travels: Multiple of the travel of the axis.
        """
        count, unit, period = self.count(axis), self.axes[axis].parameters.unit, self.sample_time
        travel, speed = travels * self.travels[axis], self.speed(axis)
        samples = max(1, min(self.cycles(_LONGEST_LOOK), math.ceil(_FAST_COUNTS * count / (speed * period))))
        far, step = max(travel, FAR_COUNTS * count), max(speed * samples * period, _FAST_COUNTS * count)
        counts = f" ({FAR_COUNTS} counts)" if far > travel else ""
        over = f", over {1e3 * samples * period:.3g} ms" if samples > 1 else ""
        fast = f"{step / (samples * period):.3g} {unit}/s{over}"
        return Guard(far, step, samples, f"{far:.3g} {unit}{counts}", fast)

    def run_alone(self, axis: int, law: OpenLoop, cycles: int, ready: Callable[[], bool]) -> None:
        """Run the rig with a control law on one axis and none but weights on the others; raises the errors of `run`.

        Positions and torques of the stop are left out.
        """
        self.run([law if n == axis else OpenLoop() for n in range(len(self.axes))], cycles, ready)
        for seen in (law.positions, law.applied):
            del seen[len(seen) - self._holds_of_stop :]

    def run(self, laws: Sequence[OpenLoop], cycles: int, ready: Callable[[], bool] = lambda: False) -> Cycle:
        """Run the rig with one control law per axis and stop it; return the cycle with its timing.

        Raises:
            RigError: Drive or link failed; torque is zero.
        """
        far_side = self.experiment.far_side
        for axis, law in enumerate(laws):
            law.weight = self.weight(axis)

        def read() -> Sequence[Truth]:
            drives = () if far_side is None else far_side.drives
            self.truths = [drive.truth() for drive in drives]
            self._efforts = self._efforts if cycle.holds_of_stop else [drive.torque for drive in drives]
            return self.truths

        cycle = Cycle(self.rig, axis_ports(laws), None, read if far_side is not None else None)
        run(cycle, cycles, lambda: self.stop_requested() or ready())
        self._holds_of_stop = cycle.holds_of_stop
        self.quanta = [drive.scaling.torque_quantum for drive in self.drives]
        return cycle

    def truth(self, axis: int) -> float | None:
        """Return the true position of a simulated axis at the last SYNC of the last run; None for a real axis."""
        return self.truths[axis].position if self.truths else None

    def effort(self, axis: int) -> float | None:
        """Return the torque that acts on a simulated axis at the last SYNC of the last run; None for a real axis."""
        return self._efforts[axis] if self._efforts else None

    def shown(self, axis: int, torque: float) -> str:
        """Torque [N or N*m] as text, in its unit and in per mille of the drive's own rated torque."""
        parameters = self.axes[axis].parameters
        per_mille = 1000.0 * self.drives[axis].quirks.torque_resolution * torque / self.quanta[axis]
        return f"{torque:.3g} {effort_unit(parameters.unit)} ({per_mille:.3g} per mille)"

    def cycles(self, seconds: float) -> int:
        """Number of cycles in a duration."""
        return max(1, round(seconds / self.sample_time))

    def found(self, axis: int, item: str, configured: str, found: str, verdict: StepVerdict, text: str = "") -> None:
        """Add a row to the report and print it."""
        name = self.axes[axis].parameters.name
        self.report.findings.append(StepFinding(name, item, configured, found, verdict, text))
        self.dialogue.tell(f"  {name}: {item}: {found} ({verdict.value})")

    def judged(
        self, axis: int, item: str, configured: str, found: str, *, good: bool, text: str, fatal: bool = False
    ) -> None:
        """Add a row with the verdict of a check, and a remedy where it does not agree."""
        otherwise = StepVerdict.FAILED if fatal else StepVerdict.DIFFERS
        self.found(axis, item, configured, found, StepVerdict.AGREES if good else otherwise, "" if good else text)

    def note_objects(self, axis: int) -> None:
        """Add a row for each limit, ramp and reaction stored in the drive of an axis, and keep its settings.

        Raises:
            SdoError: The drive does not answer.
        """
        for name, fitness, text in self.rig.read_objects(axis):
            value, _, meaning = text.partition(": ")
            verdict = StepVerdict.MEASURED if fitness is fitness.FIT else StepVerdict.DIFFERS
            self.found(axis, name, "", value, verdict, meaning)
        self._keep_settings(axis)

    def _keep_settings(self, axis: int) -> None:
        """Propose scale, sign and limits of the drive as they are now, for later starts; say what changed."""
        drive, before = self.drives[axis], self._settings_before[axis]
        if before is not None:
            changed, _ = changed_settings(drive, settings_of(before))
            found = "; ".join(changed) or "the same"
            self.judged(axis, "scale, sign, limits", "the last ones", found, good=not changed, text="kept anew")
        if self.axes[axis].parameters.settings_accepted is not None:
            self.propose(axis, "settings_accepted", "null", comment="part of settings_checked now")
        kept = settings_text(recorded_settings(drive))
        self.propose(axis, "settings_checked", kept or None, comment="scale, sign, limits: compared at each start")

    def agreed(self, question: str, item: str, axes: Iterable[int], text: str = "") -> bool:
        """Whether the person agrees to a test; otherwise the report records the refusal for these axes."""
        if self.dialogue.confirm(question):
            return True
        self.not_tried(item, axes, text)
        return False

    def not_tried(self, item: str, axes: Iterable[int], text: str = "") -> None:
        """Add a row per axis for a test that was left out."""
        for axis in axes:
            self.found(axis, item, "", "not tried", StepVerdict.UNKNOWN, text)

    def propose(
        self, axis: int, key: str, value: float | int | str | None, unit: str = "", comment: str = "",
        least: float | None = None,
    ) -> None:  # fmt: skip
        """Propose a value for a key of the scene, with its lower end; None: the key keeps its present value."""
        self.report.values.append(Value(self.axes[axis].parameters.name, key, value, unit, comment, least))


def largest_torque(session: Session, axis: int) -> float:
    """Largest torque of commissioning [N or N*m]: a fraction of the rated torque or, without one, of the limit."""
    parameters = session.axes[axis].parameters
    rated = parameters.rated_torque or parameters.torque_limit
    return min(session.limits.torque * rated, parameters.torque_limit)


def _with_hands(scene: Scene, hand: Callable[[AxisScene], Any]) -> Scene:
    """Return the scene with other simulated hands; an axis left without a hand loses the effects of one."""
    axes = []
    for axis in scene.axes:
        if (simulation := axis.simulation) is not None:
            user, effects = hand(axis), simulation.effects
            if user is None:
                effects = tuple(effect for effect in effects if effect.name not in ("tremor", "grasp_change"))
            simulation = dataclasses.replace(simulation, user=user, effects=effects)
        axes.append(dataclasses.replace(axis, simulation=simulation))
    return dataclasses.replace(scene, axes=tuple(axes))
