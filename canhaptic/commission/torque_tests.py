"""First torque: a pulse that grows until something moves, then a sweep that says what moves."""

import math
from typing import Final

import numpy as np

from canhaptic.axis_units import damping_unit, effort_unit
from canhaptic.commission.findings import StepVerdict
from canhaptic.commission.laws import OpenLoop, doublet, sweep
from canhaptic.commission.mass_and_friction import (
    Dynamics,
    FrictionCurve,
    estimate,
    estimate_lateness,
    friction_curve,
    mass_within,
)
from canhaptic.commission.session import Session
from canhaptic.drive.readback_timing import measure_read_back

_FIRST: Final = 0.01  # of the rated torque
_PULSE: Final = 0.04  # [s]
_REST: Final = 0.2  # [s] after a pulse
_SEEN_COUNTS: Final = 20  # of motion in the first part of a pulse: enough to know its sign
_SWEEP: Final = (2.0, 8.0, 4.0)  # [Hz] first and last, [s]
_HALF_BASE: Final = 0.02  # [s] of the weights of the estimate
_SURE: Final = 2.0  # standard deviations
_DERATING: Final = 0.5
"""Certain part of the braking force that was measured: warmth, grease and wear reduce it."""
_RATTLE: Final = 64  # cycles
_SHAKES: Final = 64  # of one sign or the other
_RESOLVED_COUNTS: Final = 20  # of motion in one part of a shake: quantisation then changes the mass by 0.1 %
_RIGID: Final = 0.1
"""Largest relative difference between the masses of a fast and of a slow motion on a stiff axis."""
_SCALE_TOLERANCE: Final = 0.1
_MASS_UNITS: Final = {"m": "kg", "rad": "kg*m^2"}


def _largest_torque(session: Session, axis: int, part: float | None = None) -> float:
    """Returns the torque beyond which commissioning does not go [N or N*m].

    Args:
        session: Its limits.
        axis: Index of the axis.
        part: Of the rated torque, or of the limit where there is none; None: that of the session.
    """
    parameters = session.axes[axis].parameters
    rated = parameters.rated_torque or parameters.torque_limit
    return min((session.limits.torque if part is None else part) * rated, parameters.torque_limit)


def pulse(session: Session, axis: int) -> float | None:
    """Returns a first idea of the mass, or None when nothing more may be tried.

    A motor that turns against its encoder makes every wall push inward: that ends the commissioning of the axis.

    Raises:
        RigError: Drive or link failed.
    """
    parameters = session.axes[axis].parameters
    unit, most = effort_unit(parameters.unit), _largest_torque(session, axis)
    asked = f"{parameters.name}: let go of the handle. Pulses of at most {most:.3g} {unit} and {4 * _PULSE:g} s now?"
    if not session.agreed(asked, "torque sign", [axis]):
        return None
    cycles = session.cycles(_PULSE)
    torque = min(most, _largest_torque(session, axis, _FIRST))
    while True:
        law = session.play(axis, doublet(torque, cycles), 4 * cycles + session.cycles(_REST))
        moved = _first_motion(law, cycles)
        seen = abs(moved) * parameters.counts_per_unit >= _SEEN_COUNTS
        if seen or law.tripped or torque >= most or session.stop_requested():
            break
        torque = min(most, 2.0 * torque)
    if session.stop_requested() and not seen:
        session.not_tried("torque sign", [axis])
        return None
    is_unclear = not seen or (law.has_gap and moved > 0.0)
    if law.tripped and is_unclear:  # a pulse that was cut short asks for no larger torque, and gives no mass
        text = f"{law.tripped}; see to it, then commission again"
        session.found(axis, "torque sign", "+", "broken off", StepVerdict.UNKNOWN, text)
        return None
    if not seen:
        text = "more friction than torque, a brake, or no current; raise --torque with care"
        session.found(axis, "torque sign", "+", f"no motion at {torque:.3g} {unit}", StepVerdict.UNKNOWN, text)
        return None
    right = moved > 0.0
    text = "torque and encoder disagree: every wall would pull in. Swap two motor phases, or 0x607E"
    found = f"{moved:+.3g} {parameters.unit} at {torque:+.3g} {unit}"
    session.judged(axis, "torque sign", "+", found, good=right, text=text, otherwise=StepVerdict.FAILED)
    return torque * (cycles * session.sample_time) ** 2 / (2.0 * moved) if right else None  # as the encoder has it


def time_the_read_back(session: Session) -> None:
    """Finds out whether each drive reports its torque just before or just after the update at a SYNC.

    Raises:
        RigError: Drive or link failed.
    """
    item, axes = "demand reported", range(len(session.axes))
    if any(drive.map.read_back == "none" for drive in session.drives):
        session.not_tried(item, axes)
        return
    amplitude = min(_largest_torque(session, axis) for axis in axes)
    asked = f"all axes: hands off. A rattle of {amplitude:.3g} N or N*m that moves nothing, {_RATTLE} cycles, now?"
    if not session.agreed(asked, item, axes):
        return
    session.rig.start()
    try:
        timings = measure_read_back(session.rig, amplitude, _RATTLE)
    finally:
        session.rig.stop(ramp=False)
    for axis, timing in enumerate(timings):
        configured = session.axes[axis].parameters.demand_reported
        if timing.reported is None:
            session.found(axis, item, configured, "unclear", StepVerdict.UNKNOWN, timing.text)
            continue
        same = timing.reported == configured
        text = "every hold is booked with its neighbour's torque"
        session.judged(axis, item, configured, timing.reported, good=same, text=text)
        if not same:
            session.propose(axis, "demand_reported", timing.reported)


def _first_motion(law: OpenLoop, cycles: int) -> float:
    """Returns the displacement over the first part of a doublet, counted from where the torque began to act."""
    begin = next((k for k, torque in enumerate(law.applied) if torque), len(law.applied)) - 1
    end = min(begin + cycles, len(law.positions) - 1)
    return law.positions[end] - law.positions[begin] if 0 <= begin < end else 0.0


def identify_dynamics(session: Session, axis: int, rough_mass: float) -> None:
    """Sweeps a torque through frequencies and reports mass, friction and the scale of the torque.

    Raises:
        RigError: Drive or link failed.
    """
    parameters = session.axes[axis].parameters
    lowest, highest, duration = _SWEEP
    swing = rough_mass * (2.0 * math.pi * lowest) ** 2 * session.limits.travel / 4.0
    amplitude, limit = min((_largest_torque(session, axis), "--torque"), (swing, "--travel"))
    unit = effort_unit(parameters.unit)
    asked = f"{parameters.name}: hands off. A sweep of {amplitude:.3g} {unit}, {lowest:g} to {highest:g} Hz, now?"
    if not session.agreed(asked, "moving mass", [axis]):
        return
    torques = sweep(amplitude, lowest, highest, duration, session.sample_time)
    law = session.play(axis, torques, len(torques))
    if law.tripped:
        session.found(axis, "moving mass", "", "broken off", StepVerdict.UNKNOWN, f"{law.tripped}; lower --torque")
        return
    positions = np.array(law.positions) / session.encoder_ratios[axis]  # a wrong encoder is not a wrong mass
    record = positions, np.array(law.applied), session.sample_time, max(2, session.cycles(_HALF_BASE))
    found, curve = estimate(*record), friction_curve(*record)
    if found is not None and curve is not None:  # dry friction that turns or falls with speed does not spoil that one
        found = found._replace(mass=curve.mass, mass_error=curve.mass_error)
    if found is None or found.mass <= _SURE * found.mass_error:
        text = f"too little motion to tell it from friction; raise {limit}, which limits the torque of the sweep"
        session.found(axis, "moving mass", "", "unclear", StepVerdict.UNKNOWN, text)
        return
    rigid = _of_rotor(session, axis, found)
    if rigid is not None:
        _report_mass(session, axis, rigid)
    _report_friction(session, axis, found)
    _report_least_friction(session, axis, found, curve)
    _scale(session, axis, found)
    _report_lateness(session, axis, estimate_lateness(*record))


def _of_rotor(session: Session, axis: int, found: Dynamics) -> Dynamics | None:
    """Returns the dynamics with the mass that moves within the shortest time that the encoder resolves.

    Where that is clearly less than what a slow sweep moves, a shaft lies between: what is rigid with the encoder is the
    rotor (`mass_within`). Where it is neither, a resonance is near, and no mass is reported (None). A resonance far
    above a quarter of 1 / (that time) is not seen.
    """
    parameters, torque = session.axes[axis].parameters, _largest_torque(session, axis)
    item, unit = "mass on a shaft", _MASS_UNITS[parameters.unit]
    resolved = _RESOLVED_COUNTS / parameters.counts_per_unit * found.mass / torque
    holds = max(1, math.ceil(math.sqrt(resolved) / session.sample_time))
    asked = f"{parameters.name}: hands off. A shake of {torque:.3g} {effort_unit(parameters.unit)}, now?"
    if not session.agreed(asked, item, [axis]):
        return found
    signs = np.random.default_rng(1).choice([-torque, torque], _SHAKES)
    torques = [part for sign in signs for part in doublet(float(sign), holds)]
    law = session.play(axis, torques, len(torques))
    positions = np.array(law.positions) / session.encoder_ratios[axis]
    within = mass_within(positions, np.array(law.applied), session.sample_time, holds)
    if within is None or law.tripped:
        text = f"{law.tripped or 'too little motion'}; declare the rotor's mass where a shaft or belt is compliant"
        session.found(axis, item, "", "unclear", StepVerdict.UNKNOWN, text)
        return found
    (mass, error), fastest = within, 0.25 / (holds * session.sample_time)
    seen = f"{mass:.3g} {unit} at {fastest:.3g} Hz, {found.mass:.3g} slowly"
    if abs(mass / found.mass - 1.0) <= _RIGID:
        session.found(axis, item, "", f"none: {seen}", StepVerdict.AGREES, f"no resonance below {fastest:.3g} Hz")
        return found
    if _SURE * error < mass < found.mass:
        text = "a shaft lets the rotor move alone; moving_mass is the rotor's"
        session.found(axis, item, "", seen, StepVerdict.MEASURED, text)
        return found._replace(mass=mass, mass_error=error)
    text = "a resonance is near: measure at another rate with a finer encoder, or declare the rotor's mass"
    session.found(axis, item, "", f"unclear: {seen}", StepVerdict.DIFFERS, text)
    return None


def _report_lateness(session: Session, axis: int, late: tuple[float, float] | None) -> None:
    """Reports how late the torque acts, and proposes what it is at most."""
    item = "torque lag"
    if late is None or late[1] > session.sample_time:
        session.found(axis, item, "", "unclear", StepVerdict.UNKNOWN, "too little motion; raise --travel")
        return
    most = max(0.0, late[0]) + _SURE * late[1]
    declared = (session.axes[axis].loop.torque_window or 0.0) + (session.axes[axis].loop.current_lag or 0.0)
    good = max(0.0, late[0]) - _SURE * late[1] <= declared
    text = f"+- {late[1] * 1e6:.2g} us" if good else "declare more, or guarded is not passive (see demand reported too)"
    verdict = StepVerdict.AGREES if good else StepVerdict.DIFFERS
    session.found(axis, item, f"at most {declared * 1e6:.3g} us", f"{late[0] * 1e6:.3g} us", verdict, text)
    window = session.axes[axis].loop.torque_window if session.rig.bus.rpdo == "event" else 0.0
    session.propose(axis, "passivity.torque_window", (window or 0.0) * 1e6, "us", "by the bus; the rest is in the lag")
    session.propose(axis, "passivity.current_lag", 1.5 * most * 1e6, "us", "1.5 of what was measured at most")


def _report_mass(session: Session, axis: int, found: Dynamics) -> None:
    mass_unit = _MASS_UNITS[session.axes[axis].parameters.unit]
    least = found.mass - _SURE * found.mass_error
    declared = session.axes[axis].loop.moving_mass
    text = f"+- {found.mass_error:.2g}"
    if declared is None:
        verdict = StepVerdict.MEASURED
    elif declared <= found.mass + _SURE * found.mass_error:
        verdict = StepVerdict.AGREES
    else:
        verdict, text = (
            StepVerdict.FAILED,
            f"{text}; moving_mass must be an under-estimate: guarded would not be passive",
        )
    configured = "" if declared is None else f"at most {declared:.4g} {mass_unit}"
    session.found(axis, "moving mass", configured, f"{found.mass:.4g} {mass_unit}", verdict, text)
    session.propose(axis, "passivity.moving_mass", 0.9 * least, mass_unit, f"0.9 of {least:.4g}, two deviations below")


def _report_friction(session: Session, axis: int, found: Dynamics) -> None:
    motion = session.axes[axis].parameters.unit
    unit, sure_damping = effort_unit(motion), _sure_damping(found)
    text = f"+- {found.damping_error:.2g}"
    session.found(
        axis, "viscous friction", "", f"{found.damping:.3g} {damping_unit(motion)}", StepVerdict.MEASURED, text
    )
    text = f"+- {found.friction_error:.2g}; constant load {found.offset:.2g} {unit}, rest {found.residual:.2g} {unit}"
    session.found(axis, "dry friction", "", f"{found.friction:.3g} {unit}", StepVerdict.MEASURED, text)
    most = max(0.0, found.damping) + _SURE * found.damping_error
    comment = "twice what was measured at most: an over-estimate is safe"
    session.propose(axis, "passivity.device_damping_bound", 2.0 * most, damping_unit(motion), comment)
    most = max(0.0, found.friction) + _SURE * found.friction_error
    session.propose(axis, "passivity.device_friction_bound", 2.0 * most, unit, comment)
    if sure_damping > 0.0:
        comment = "certain to two deviations here and now; grease and temperature change it"
        session.propose(axis, "passivity.device_damping", _DERATING * sure_damping, damping_unit(motion), comment)


def _sure_damping(found: Dynamics) -> float:
    return max(0.0, found.damping - _SURE * found.damping_error)


def _report_least_friction(session: Session, axis: int, found: Dynamics, curve: FrictionCurve | None) -> None:
    """Reports what dry friction is at least at every speed that was seen."""
    item, motion = "dry friction, least", session.axes[axis].parameters.unit
    if curve is None or curve.falls_at_its_end(_SURE):
        text = "too little motion both ways" if curve is None else "it still falls at the fastest speed that was seen"
        session.found(axis, item, "", "unclear", StepVerdict.UNKNOWN, f"{text}; raise --torque or --travel")
        return
    least, unit = curve.least(_sure_damping(found), _SURE), effort_unit(motion)
    seen = f"at {curve.speeds[0]:.2g} to {curve.speeds[-1]:.2g} {motion}/s, certain to two deviations (98 %)"
    declared = session.axes[axis].loop.device_friction
    configured = "" if declared is None else f"at least {declared:.4g} {unit}"
    verdict = StepVerdict.MEASURED if declared is None else StepVerdict.AGREES
    if declared is not None and declared > least:
        verdict, seen = StepVerdict.FAILED, f"{seen}; device_friction must be an under-estimate"
    session.found(axis, item, configured, f"{least:.3g} {unit}", verdict, seen)
    if least > 0.0:
        comment = f"{_DERATING:g} of {least:.4g} {seen}; warmth, grease and wear take friction away"
        session.propose(axis, "passivity.device_friction", _DERATING * least, unit, comment)


def _scale(session: Session, axis: int, found: Dynamics) -> None:
    """Compares the mass found with one that was weighed: the same ratio is wrong in every torque."""
    axis_scene = session.axes[axis]
    parameters, simulation = axis_scene.parameters, axis_scene.simulation
    unit, mass_unit = effort_unit(parameters.unit), _MASS_UNITS[parameters.unit]
    truth = None if simulation is None or simulation.effects else simulation.plant.mass
    question = f"{parameters.name}: moving mass from a scale or a drawing (Enter when unknown)?"
    known = session.dialogue.number(question, mass_unit, truth)
    if not known or known <= 0.0 or parameters.rated_torque is None:
        text = "hang a known weight or use a force gauge: rated_torque is as wrong as this is"
        session.found(axis, "torque scale", "1", "not compared", StepVerdict.UNKNOWN, text)
        return
    ratio = found.mass / known
    same = abs(ratio - 1.0) <= _SCALE_TOLERANCE
    text = "torques are not what they say"
    session.judged(axis, "torque scale", "1", f"{1.0 / ratio:.4g}", good=same, text=text)
    if not same:
        session.propose(axis, "rated_torque", parameters.rated_torque / ratio, unit, "by the mass that you gave")
