"""The first torques of an axis: pulses until it moves, a check of the torque scale, and a sweep for mass and friction.

The scale is verified before more than a few per mille of the drive's rated torque are sent. A rated torque from a name
plate, or a forgotten gear, scales every torque by one wrong ratio, `torque_limit` included, and no certificate notices.
The reference must come from outside the drive: a known moved mass, which doublets measure, a known weight on an arm,
which the drive lifts, or a spring balance, against which it pushes.

`checked_holds` reverses the torques before a run (`check_hold`), to see in which hold they act.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from canhaptic.axis_units import damping_unit, effort_unit
from canhaptic.commission import mass_and_friction
from canhaptic.commission.mass_and_friction import (
    SURE,
    Dynamics,
    FrictionCurve,
    Sweep,
    is_dear,
    mass_of_late_torque,
)
from canhaptic.commission.session import (
    TRAVELS,
    CommissioningLimits,
    Guard,
    OpenLoop,
    Session,
    StepVerdict,
    Unattended,
    doublet,
    largest_torque,
    reversals,
    sweep,
)
from canhaptic.commission.torque_sign import Pulse, pulse
from canhaptic.commission.which_hold import as_declared
from canhaptic.drive.clock import WallClock
from canhaptic.errors import StartError
from canhaptic.scene.models import AxisScene, AxisSimulation, Scene
from canhaptic.sim.plant.user import UserParameters

_LOWEST: Final = 2.0  # frequency of a sweep [Hz]
_SPAN: Final = 4.0  # highest over lowest frequency
_DURATION: Final = 4.0  # [s]
_LEVELS: Final = 8.0  # counts of 0x6071 that a sweep should have
_FEWEST_COUNTS: Final = 100.0  # of the encoder within the travel of the tests
_FARTHEST: Final = 5.0  # times the travel where nothing asks for more
_DERATING: Final = 0.5
"""Fraction of the measured braking force that is declared as certain: heat, grease and wear reduce it."""
MASS_UNITS: Final = {"m": "kg", "rad": "kg*m^2"}
_SHAFT: Final = "compliant shaft"
_UNDER: Final = 0.9
_OVER: Final = 2.0
_COMMENTS: Final = {
    "moving_mass": f"{_UNDER:g} of the measured value, less two standard deviations",
    "device_damping_bound": f"{_OVER:g} times the upper confidence limit",
    "device_friction_bound": f"{_OVER:g} times the upper confidence limit",
    "device_damping": f"{_DERATING:g} times the lower confidence limit: grease and temperature change it",
    "device_friction": f"{_DERATING:g} times the lower confidence limit: heat, grease and wear reduce friction",
}
"""Comment of each declared value of the device: its margin to the measured value."""


class _Shaken(NamedTuple):
    """Mass that a fast shake moved: the one that is rigid with the encoder."""

    mass: float  # [kg or kg*m^2]
    error: float
    fastest: float  # frequency of the shake [Hz]

    def is_all_of(self, found: Dynamics) -> bool:
        """Whether it is the mass of a slow motion as well: the axis is stiff."""
        return abs(self.mass / found.mass - 1.0) <= 0.1

    def rigid_part(self, found: Dynamics) -> Dynamics | None:
        """Return the dynamics with the mass that is rigid with the encoder; None where a resonance is near.

        Where the shaken mass is clearly below that of a slow motion, a shaft lies between, and it is the rotor's.
        """
        if self.is_all_of(found):
            return found
        is_rotor = SURE * self.error < self.mass < found.mass
        return found._replace(mass=self.mass, mass_error=self.error) if is_rotor else None


def identify_dynamics(session: Session, axis: int, rough_mass: float) -> None:
    """Sweep a torque through frequencies and report mass and friction.

    Raises:
        RigError: Drive or link failed.
    """
    parameters, most = session.axes[axis].parameters, largest_torque(session, axis)
    lowest = _lowest_frequency(session, axis, rough_mass)
    swing = rough_mass * (2.0 * math.pi * lowest) ** 2 * session.travels[axis] / 4.0
    amplitude, limit = min((most, "--torque"), (swing, "--travel"))
    sent = session.shown(axis, amplitude)
    asked = f"{parameters.name}: hands off. A sweep of {sent}, {lowest:.3g} to {_SPAN * lowest:.3g} Hz. Start now?"
    if not session.agreed(asked, "moving mass", [axis]):
        return
    for times in (1, 2, 4):  # longer where the wall asks for a better estimate
        record = _swept(session, axis, amplitude, lowest, times * _DURATION, rough_mass)
        if record is None:
            return
        known = record.dynamics()
        if known is not None and not _is_dear(session, axis, *known):
            break
        session.dialogue.tell(f"  {parameters.name}: moving mass, friction: not known well enough for the wall")
    if record is None or known is None:
        text = f"too little motion to separate it from friction; raise {limit}, which limits the torque of the sweep"
        return session.found(axis, "moving mass", "", "unclear", StepVerdict.UNKNOWN, text)
    found, curve = known
    shaken = _shaken(session, axis, found)
    rigid = found if shaken is None else shaken.rigid_part(found)
    try:
        if not session.stop_requested():
            values = None if rigid is None else declared_of(rigid, curve)  # without a mass, only the hold is found
            most = largest_torque(session, axis)
            late = mass_and_friction.time_the_torque(session, axis, most, rough_mass, values)
            if late is not None:
                found, curve = record.dynamics(late) or (found, curve)
    finally:  # where the link is lost in between, what was measured before is not
        _report(session, axis, found, curve, shaken)


def _report(session: Session, axis: int, found: Dynamics, curve: FrictionCurve | None, shaken: _Shaken | None) -> None:
    if shaken is not None:
        _report_shaft(session, axis, found, shaken)
    rigid = found if shaken is None else shaken.rigid_part(found)
    if rigid is not None:
        _report_mass(session, axis, rigid)
    _report_friction(session, axis, found)
    _report_weight(session, axis, found)
    _report_least_friction(session, axis, found, curve)
    if rigid is None or session.stop_requested():
        return
    values = declared_of(rigid, curve)
    for key, value in values.items():
        session.propose(axis, f"passivity.{key}", value, _unit_of(session, axis, key), _COMMENTS[key])
    mass_and_friction.propose_allowance(session, axis, values)


def _lowest_frequency(session: Session, axis: int, mass: float) -> float:
    """Lowest frequency of a sweep [Hz]: that at which a light axis swings within its travel, by enough torque."""
    torque = min(largest_torque(session, axis), _LEVELS * session.quanta[axis])
    fastest = 0.1 / (_SPAN * session.sample_time)
    return max(_LOWEST, min(fastest, math.sqrt(4.0 * torque / (mass * session.travels[axis])) / (2.0 * math.pi)))


def ask_for_room(session: Session, axis: int, first: Pulse) -> None:
    """Ask how far the further tests may move an axis, if they need more than its travel and none was given.

    The encoder is to show 100 counts, and a sweep to have eight counts of torque.
    """
    parameters = session.axes[axis].parameters
    torque = min(largest_torque(session, axis), _LEVELS * session.quanta[axis])
    swing = 4.0 * torque / (first.mass * (2.0 * math.pi * _LOWEST) ** 2)
    needed = min(_FARTHEST * TRAVELS[parameters.unit], max(_FEWEST_COUNTS * session.count(axis), swing))
    if session.limits.travel is not None or needed <= session.travels[axis]:
        return
    asked = f"{parameters.name}: how far may the tests move the handle to each side?"
    given = session.dialogue.number(f"{asked} {needed:.2g} {parameters.unit} is enough", parameters.unit, needed)
    if given is not None and given > 0.0:
        session.travels[axis] = given


def _swept(session: Session, axis: int, amplitude: float, lowest: float, duration: float, mass: float) -> Sweep | None:
    """Sweep for a duration [s] and return its record; None where it was aborted, which is reported."""
    highest = _SPAN * lowest
    # Windows of a sixth of the shortest period, or of a third for a coarse encoder: 4 counts by the acceleration
    seen = math.sqrt(4.0 * session.count(axis) * mass / amplitude)
    half_base = max(2, session.cycles(min(0.32, max(0.16, seen * highest)) / highest))

    def torques_of(torque: float) -> list[float]:
        return sweep(torque, lowest, highest, duration, session.sample_time)

    law = session.play_within(axis, "moving mass", torques_of, amplitude)
    if law.tripped or session.stop_requested():
        found = "stopped" if law.tripped else "not tried"
        session.found(axis, "moving mass", "", found, StepVerdict.UNKNOWN, law.tripped)
        return None
    positions = law.regular_positions() / session.encoder_ratios[axis]  # a wrong encoder is not a wrong mass
    booked = np.asarray(as_declared(session, axis, law), dtype=np.float64)
    return Sweep(positions, np.array(law.applied), booked, session.sample_time, half_base)


def declared_of(found: Dynamics, curve: FrictionCurve | None) -> dict[str, float]:
    """Return the values to declare for a device (SI): of each measured interval the end that is safe, with a margin."""
    values = {
        "moving_mass": _UNDER * (found.mass - SURE * found.mass_error),
        "device_damping_bound": _OVER * (max(0.0, found.damping) + SURE * found.damping_error),
        "device_friction_bound": _OVER * (max(0.0, found.friction) + SURE * found.friction_error),
        "device_damping": _DERATING * _sure_damping(found),
    }
    if curve is not None and not curve.falls_at_its_end(SURE):
        values["device_friction"] = _DERATING * curve.least(_sure_damping(found), SURE)
    return {key: value for key, value in values.items() if value > 0.0 or key.endswith("_bound")}


def _is_dear(session: Session, axis: int, found: Dynamics, curve: FrictionCurve | None) -> bool:
    """Whether the uncertainty of a sweep costs too much of the wall, without any lag."""
    exact = found._replace(mass_error=0.0, damping_error=0.0, friction_error=0.0)
    ends = {**declared_of(found, curve), "current_lag": 0.0}
    return is_dear(session.axes[axis], session.speed(axis), {**ends, **declared_of(exact, None)}, ends)


def _shaken(session: Session, axis: int, found: Dynamics) -> _Shaken | None:
    """Shake the axis; None where that was refused or moved too little, which is reported.

    With t the shortest time that the encoder resolves, a resonance far above 1 / (4 t) is not seen.
    """
    parameters, torque = session.axes[axis].parameters, largest_torque(session, axis)
    # 20 counts of motion in one part of a shake: quantisation then changes the mass by 0.1 %
    resolved = 20.0 / parameters.counts_per_unit * found.mass / torque
    holds = max(1, min(session.cycles(1.0), math.ceil(math.sqrt(resolved) / session.sample_time)))
    asked = f"{parameters.name}: hands off. A shake of {session.shown(axis, torque)}, of random sign. Start now?"
    if not session.agreed(asked, _SHAFT, [axis]):
        return None
    signs = np.random.default_rng(1).choice([-1.0, 1.0], 64)

    def shakes(most: float) -> list[float]:
        return [part for sign in signs for part in doublet(float(sign) * most, holds)]

    law = session.play_within(axis, _SHAFT, shakes, torque)
    positions = law.regular_positions() / session.encoder_ratios[axis]
    within = mass_and_friction.mass_within(positions, np.array(law.applied), session.sample_time, holds)
    if within is None or law.tripped:
        text = f"{law.tripped or 'too little motion'}; declare the rotor's mass where a shaft or belt is compliant"
        session.found(axis, _SHAFT, "", "unclear", StepVerdict.UNKNOWN, text)
        return None
    return _Shaken(*within, 0.25 / (holds * session.sample_time))


def _report_shaft(session: Session, axis: int, found: Dynamics, shaken: _Shaken) -> None:
    unit, fastest = MASS_UNITS[session.axes[axis].parameters.unit], shaken.fastest
    seen = f"{shaken.mass:.3g} {unit} at {fastest:.3g} Hz, {found.mass:.3g} {unit} at low frequency"
    if shaken.is_all_of(found):
        text = f"no resonance below {fastest:.3g} Hz"
        return session.found(axis, _SHAFT, "", f"none found: {seen}", StepVerdict.AGREES, text)
    if shaken.rigid_part(found) is not None:
        text = "a shaft lets the rotor move alone; moving_mass is the rotor's"
        return session.found(axis, _SHAFT, "", seen, StepVerdict.MEASURED, text)
    text = "a resonance is near: measure at another rate with a finer encoder, or declare the rotor's mass"
    session.found(axis, _SHAFT, "", f"unclear: {seen}", StepVerdict.DIFFERS, text)


def _report_mass(session: Session, axis: int, found: Dynamics) -> None:
    mass_unit = MASS_UNITS[session.axes[axis].parameters.unit]
    declared = session.axes[axis].loop.moving_mass
    verdict, text = StepVerdict.MEASURED if declared is None else StepVerdict.AGREES, f"+- {found.mass_error:.2g}"
    if declared is not None and declared > found.mass + SURE * found.mass_error:
        verdict = StepVerdict.FAILED
        text = f"{text}; moving_mass must not exceed the real value, or guarded is not passive"
    configured = "" if declared is None else f"{declared:.4g} {mass_unit} (must not exceed the real mass)"
    session.found(axis, "moving mass", configured, f"{found.mass:.4g} {mass_unit}", verdict, text)


def _report_friction(session: Session, axis: int, found: Dynamics) -> None:
    motion = session.axes[axis].parameters.unit
    unit = effort_unit(motion)
    text, seen = f"+- {found.damping_error:.2g}", f"{found.damping:.3g} {damping_unit(motion)}"
    session.found(axis, "viscous friction", "", seen, StepVerdict.MEASURED, text)
    text = f"+- {found.friction_error:.2g}; constant load {found.offset:.2g} {unit}, rest {found.residual:.2g} {unit}"
    session.found(axis, "dry friction", "", f"{found.friction:.3g} {unit}", StepVerdict.MEASURED, text)


def _report_weight(session: Session, axis: int, found: Dynamics) -> None:
    """Report the weight of an axis with a brake, and propose that a stop holds it until the brake does."""
    parameters = session.axes[axis].parameters
    if parameters.brake is None:
        return
    item, unit, declared = "weight", effort_unit(parameters.unit), parameters.brake.holds_weight
    wide = SURE * found.offset_error
    seen, text = f"{found.offset:.3g} {unit}", f"+- {wide:.2g}; what holds the axis where it hangs"
    configured = f"{declared:.4g} {unit}" if declared else ""
    if abs(found.offset - declared) <= wide:
        session.found(axis, item, configured, seen, StepVerdict.AGREES, text)
        return
    verdict = StepVerdict.DIFFERS if declared else StepVerdict.MEASURED
    session.found(axis, item, configured, seen, verdict, f"{text}: holds_weight")
    session.propose(axis, "brake.holds_weight", found.offset, unit, "weight: what a stop holds until the brake does")


def _unit_of(session: Session, axis: int, key: str) -> str:
    motion = session.axes[axis].parameters.unit
    return MASS_UNITS[motion] if "mass" in key else damping_unit(motion) if "damping" in key else effort_unit(motion)


def _sure_damping(found: Dynamics) -> float:
    return max(0.0, found.damping - SURE * found.damping_error)


def _report_least_friction(session: Session, axis: int, found: Dynamics, curve: FrictionCurve | None) -> None:
    """Report the least dry friction over all speeds of the sweep."""
    item, motion = "dry friction, least", session.axes[axis].parameters.unit
    if curve is None or curve.falls_at_its_end(SURE):
        text = "too little motion in both directions" if curve is None else "it falls up to the fastest speed"
        return session.found(axis, item, "", "unclear", StepVerdict.UNKNOWN, f"{text}; raise --torque or --travel")
    least, unit = curve.least(_sure_damping(found), SURE), effort_unit(motion)
    seen = f"at {curve.speeds[0]:.2g} to {curve.speeds[-1]:.2g} {motion}/s, certain to two deviations (98 %)"
    declared = session.axes[axis].loop.device_friction
    configured = "" if declared is None else f"at least {declared:.4g} {unit}"
    verdict = StepVerdict.MEASURED if declared is None else StepVerdict.AGREES
    if declared is not None and declared > least:
        verdict, seen = StepVerdict.FAILED, f"{seen}; device_friction must not exceed the real value"
    session.found(axis, item, configured, f"{least:.3g} {unit}", verdict, seen)


SCALE: Final = "torque scale"
"""Name of the step in the report."""
_SHORTEST: Final = 4  # cycles of their first part
_LONGEST: Final = 0.25  # [s]
_PART: Final = 0.4  # of travel and speed that they may use


class RisingTorque(OpenLoop):
    """A torque that rises count by count; with `lifts` it falls again once the axis has moved, until the axis returns.

    Attributes:
        up: Torque at which the axis was lifted, 0 before [N or N*m].
        down: Torque at which the axis returned, 0 before [N or N*m].
    """

    def __init__(self, quantum: float, most: float, holds: int, guard: Guard, seen: float, *, lifts: bool) -> None:
        self._quantum, self._most, self._holds, self._seen, self._lifts = quantum, most, holds, seen, lifts
        super().__init__((), guard)

    def reset(self) -> None:
        """Clear the record, and begin with one count."""
        super().reset()
        self.up = self.down = self._present = 0.0

    @property
    def has_ended(self) -> bool:
        """Whether the last torque was played."""
        is_over = self._lifts and not self.up and self._present > self._most
        return bool(self.tripped or self.down or is_over)

    def next_torque(self) -> float:
        """Torque of the next hold [N or N*m]."""
        moved = self.positions[-1] - self.positions[0]
        if self._lifts and not self.up and moved >= self._seen:
            self.up = self._present
        elif self.up and max(self.positions) - self.positions[-1] >= self._seen:
            self.down = max(self._present, self._quantum)
        if (len(self.positions) - 1) % self._holds == 0:
            self._present += -self._quantum if self.up else self._quantum
        return 0.0 if self.has_ended else max(0.0, min(self._present, self._most))


def verified_axes(session: Session) -> dict[int, Pulse]:
    """Send the first torque to every axis and verify its scale; return the first pulses of the axes that agree.

    Raises:
        RigError: Drive or link failed.
    """
    firsts: dict[int, Pulse] = {}
    means: dict[int, str] = {}
    with session.rig_of(with_hand=False):
        for axis, scene in enumerate(session.axes):
            first = None if session.stop_requested() else pulse(session, axis)
            if first is None:
                continue
            question = f"{scene.parameters.name}: how is the scale of the torque verified?"
            simulation = scene.simulation  # its mass is known where nothing else moves with it
            truth = "mass" if simulation is None or not simulation.effects else "balance"
            firsts[axis] = first
            ask_for_room(session, axis, first)
            means[axis] = session.dialogue.choose(question, ("weight", "balance", "mass", "no"), truth)
            if means[axis] == "mass":
                _judge_scale(session, axis, "mass", _by_mass(session, axis, first))
    for axis, word in means.items():
        if word == "no":
            text = "no further torque: a wrong scale also makes torque_limit wrong"
            session.found(axis, SCALE, "1", "not compared", StepVerdict.UNKNOWN, text)
        elif word != "mass" and not session.stop_requested():
            hand = _balance if word == "balance" else None
            with session.rig_of(with_hand=True, hand=hand):
                _judge_scale(session, axis, word, _by_force(session, axis, word))
    return {axis: first for axis, first in firsts.items() if axis in session.verified}


def _balance(axis: AxisScene) -> object:
    """Return a simulated hand that holds the handle like a spring balance; None with a real drive."""
    return None if axis.simulation is None else stiff_grip(axis, axis.simulation)


def stiff_grip(axis: AxisScene, simulation: AxisSimulation) -> UserParameters:
    """Return a simulated hand that holds the handle at rest, within a hundredth of the travel of the tests."""
    parameters, plant = axis.parameters, simulation.plant
    most = parameters.rated_torque or parameters.torque_limit
    stiffness = 10.0 * most / TRAVELS[parameters.unit]
    grip = {"stiffness": stiffness, "damping": math.sqrt(stiffness * plant.mass), "push": 0.0, "motion": None}
    return (simulation.user or UserParameters()).model_copy(update={**grip, "rest": plant.initial_position})


def _by_mass(session: Session, axis: int, first: Pulse) -> float | None:
    """Ratio of the true torque to the assumed one, by the known mass and doublets; None where it stays unclear.

    The first doublets have the torque of the first pulse that moved the axis, doubled while the motion is too small.
    """
    scene = session.axes[axis]
    name, simulation = scene.parameters.name, scene.simulation
    truth = None if simulation is None or simulation.effects else simulation.plant.mass
    question = f"{name}: moving mass, weighed or from the drawing?"
    known = session.dialogue.number(question, MASS_UNITS[scene.parameters.unit], truth)
    torque, most = first.torque, largest_torque(session, axis)
    sent = f"{session.shown(axis, torque)}, up to {session.shown(axis, most)}"
    asked = f"{name}: hands off. Doublets of {sent} until it moves enough. Start now?"
    if not known or known <= 0.0 or not session.agreed(asked, SCALE, [axis]):
        return None
    while True:
        session.coast(axis)
        acceleration = torque / first.mass  # an estimate, so that a part of the limits is used
        wanted = math.sqrt(_PART * session.travels[axis] / acceleration), _PART * session.speed(axis) / acceleration
        longest = max(_SHORTEST, session.cycles(min(_LONGEST, *wanted)))
        torques = reversals(torque, longest, 32)
        law = session.play(axis, torques, len(torques) + 2)
        if law.tripped or session.stop_requested():
            return None
        positions = law.regular_positions() / session.encoder_ratios[axis]  # a wrong encoder is not a wrong mass
        found = mass_of_late_torque(positions, np.array(law.applied), session.sample_time, longest)
        # A mass this sharp still verifies a scale
        if found is not None and 0.0 < SURE * found[1] <= 0.05 * found[0]:
            return known / found[0]
        if torque >= most:
            return None
        torque = min(most, 2.0 * torque)


def _by_force(session: Session, axis: int, means: str) -> float | None:
    """Ratio of true to assumed torque, by a lifted weight or a spring balance; None where it stays unclear."""
    parameters = session.axes[axis].parameters
    name, unit, most = parameters.name, effort_unit(parameters.unit), parameters.torque_limit
    lifts, quantum, known = means == "weight", session.quanta[axis], None
    if lifts:
        asked = f"{name}: torque of the weight (mass, times 9.81 m/s^2, times arm)?"
        known = session.dialogue.number(asked, unit, None)
    held = "the weight on its support, so that + lifts it" if lifts else "the handle held at rest by a spring balance"
    range_of = f"from {session.shown(axis, quantum)} to {session.shown(axis, most)}"
    asked = f"{name}: {held}. A torque that rises {range_of}. Start now?"
    if (lifts and not known) or not session.agreed(asked, SCALE, [axis]):
        return None
    holds = session.cycles(0.1)  # for each value of a rising torque
    seen = 20 / parameters.counts_per_unit  # a weight was lifted
    law = RisingTorque(quantum, most, holds, session.guard(axis), seen, lifts=lifts)
    # A simulated balance is read after ten steps
    asked, steps = f"{name}: press Enter when you can read the balance", 10 * holds
    pressed = None if lifts else session.dialogue.until_ready(asked, steps)
    cycles = 2 * holds * (2 + math.ceil(most / quantum))
    session.run_alone(axis, law, cycles, lambda: law.has_ended or (pressed is not None and pressed()))
    sent = 0.5 * (law.up + law.down) if law.up and law.down else 0.0
    if not lifts:
        sent = law.applied[-1] if law.applied and not law.tripped else 0.0
        known = session.dialogue.number(f"{name}: reading of the balance, times its arm?", unit, session.effort(axis))
    if not sent or not known or session.stop_requested():
        session.dialogue.tell(f"  {name}: {SCALE}: {law.tripped or 'nothing was lifted, or read'}")
        return None
    return abs(known / sent)


def _judge_scale(session: Session, axis: int, means: str, ratio: float | None) -> None:
    """Report a ratio of true to assumed torque, and propose the resulting values."""
    parameters = session.axes[axis].parameters
    if ratio is None:
        text = "unclear; use another method, or raise --torque or --travel"
        return session.found(axis, SCALE, "1", "not compared", StepVerdict.UNKNOWN, text)
    same = abs(ratio - 1.0) <= 0.1
    text = "every torque is wrong by this ratio, torque_limit too; correct it, then commission again"
    session.judged(axis, SCALE, "1", f"{ratio:.4g}", good=same, text=text)
    key = "transmission" if parameters.rated_torque is None else "rated_torque"
    if same:
        session.verified.add(axis)
        text = "agrees" + (", but the drive is simulated: not written" if session.scene.simulated else "")
        session.propose(axis, "torque_verified", means, comment=text)
        return session.propose(axis, key, None, comment=f"agrees, by {means}")
    unit = effort_unit(parameters.unit) if key == "rated_torque" else ""
    session.propose(axis, key, getattr(parameters, key) * ratio, unit, f"by {means}")


_ANNOUNCED: Final = 3.0  # [s] before a real drive moves


def checked_holds(scene: Scene, tell: Callable[[str], None], stop_requested: Callable[[], bool]) -> Scene:
    """Check the hold of each axis with `check_hold: each_start`; return the scene with confirmed `hold_checked`.

    Each drive is started, its torque reversed as in `canhaptic commission`, within a tenth of its rated torque, and
    stopped. Where the hold stays unclear, for instance because a hand was on the handle, the axis runs as declared but
    without `hold_checked`: its account says "hold: not checked".

    Args:
        scene: Scene of a run; each such axis declares `moving_mass`.
        tell: Shows a line to the person at the machine.
        stop_requested: The operator's stop.

    Raises:
        StartError: A torque acts in another hold than declared, or is read back for another.
        RigError: Drive or link failed; torque is zero.
    """
    asked = [axis for axis, of in enumerate(scene.axes) if of.parameters.check_hold is not None]
    if not asked:
        return scene
    dialogue = _Announced(tell, stop_requested, scene)
    session = Session(scene, dialogue, CommissioningLimits(), stop_requested, compares=True)
    with session.rig_of(with_hand=False):
        for axis in asked:
            if not stop_requested():
                mass = scene.axes[axis].loop.moving_mass or 1.0
                mass_and_friction.time_the_torque(session, axis, largest_torque(session, axis), mass)
    for row in session.report.findings:
        if row.verdict in (StepVerdict.DIFFERS, StepVerdict.FAILED):
            raise StartError(row.axis, f"check_hold: {row.item}", row.found, row.configured, row.text)
    found = {value.axis: value.value for value in session.report.values if value.key == "hold_checked"}
    axes, overrides = list(scene.axes), list(scene.overrides)
    for axis in asked:
        given = axes[axis].parameters
        known = str(found[given.name]) if given.name in found else None
        axes[axis] = replace(axes[axis], parameters=given.model_copy(update={"hold_checked": known}))
        overrides.append(f"axes.{axis}.hold_checked={known or 'null'}")
    return replace(scene, axes=tuple(axes), overrides=tuple(overrides))


class _Announced(Unattended):
    """Dialogue that announces each test, and gives a person at a real drive time to let go or to stop."""

    def __init__(self, tell: Callable[[str], None], stop_requested: Callable[[], bool], scene: Scene) -> None:
        super().__init__(tell)
        self._stop_requested, self._waits = stop_requested, not scene.simulated

    def confirm(self, question: str) -> bool:
        """Announce the test; return whether the operator lets it go on."""
        begin = f" in {_ANNOUNCED:g} s" if self._waits else ", now"
        self.tell(question.replace("Reversals", "check_hold: reversals").replace(". Start now?", begin))
        clock = WallClock()
        end = clock.now() + round(_ANNOUNCED * 1e9)
        while self._waits and clock.now() < end and not self._stop_requested():
            clock.wait_until(clock.now() + 50_000_000)  # [ns] between two looks at the stop
        return not self._stop_requested()
