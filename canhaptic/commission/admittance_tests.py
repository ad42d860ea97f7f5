"""Measurements of an admittance display: its sensor at rest, its drive while a hand pushes and a chirp moves it.

With r the commanded velocity, v the handle's velocity and F the force, the velocity loop is

    F = M v' + c (v - r) - k lead + friction sgn(v) + F_0

Each term is averaged under a triangular weight some milliseconds long. The mean of v' is then a difference of three
positions, and no position is differentiated twice from SYNC to SYNC. Least squares give M, c and k. The hand is needed:
on a free handle the force only follows the motion, which shows no more than the ratio of M to c. The latency of the
force is the one with the least residual.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from canhaptic.commission.mass_and_friction import SURE
from canhaptic.commission.session import OpenLoop, Session, StepVerdict, sweep
from canhaptic.control.admittance.velocity_loop import GuardedAdmittanceParameters
from canhaptic.errors import InputError

_AMPLITUDE: Final = 0.02  # of the chirp [m/s or rad/s], if the limits allow it
_LATEST: Final = 4  # latest a force may be [samples]
REQUIRED: Final = ("force at rest", "mass of the drive", "gain of the velocity loop")
"""Items that must be verified on every display before its scene may run."""
_SAFE: Final = 1.1  # over what was measured, for what is to be declared over
Array = NDArray[np.float64]


class _Fit(NamedTuple):
    """Parameters of the velocity loop, identified by least squares."""

    mass: float
    gain: float
    integral: float
    friction: float  # dry, at most, with half the damping of the bearings at the speed of the chirp [N or N*m]
    doubt: float  # larger standard deviation of mass and gain, as a part of them
    square: float  # mean square of the residual [N^2 or N^2*m^2]
    latency: int


def commission_displays(session: Session) -> None:
    """Run every step for a scene of admittance displays; the findings are in `session.report`.

    Raises:
        InputError: Some axes are impedance displays.
        RigError: Drive or link failed; the velocity is zero, every drive that answers is disabled.
    """
    if len({axis.parameters.causality.kind for axis in session.axes}) > 1:
        text = "has impedance and admittance displays; commission each kind in a scene of its own"
        raise InputError(f"{session.scene.source}: {text}")
    names = ", ".join(axis.parameters.name for axis in session.axes)
    asked = f"{names}: hands off, clear of the machine. Enable the drives at velocity zero?"
    if not session.agreed(asked, "sensor", [0]):
        return
    with session.rig_of(with_hand=False):
        for axis in range(len(session.axes)):
            session.note_objects(axis)
            _rest(session, axis)
    with session.rig_of(with_hand=True):
        for axis, of in enumerate(session.axes):
            asked = f"{of.parameters.name}: hold the handle, and push and pull while it shakes slightly. Start?"
            if session.stop_requested() or not session.agreed(asked, "velocity loop", [axis]):
                return
            _loop(session, axis)


def _rest(session: Session, axis: int) -> None:
    """Measure offset and noise of an unloaded sensor."""
    law = session.play(axis, (), session.cycles(1.0))  # [s] without a hand
    force = -np.array(law.applied[1:])
    given = session.axes[axis].parameters.admittance
    if given is None or not len(force):
        return
    declared, unit = given.force, "N" if session.axes[axis].parameters.unit == "m" else "N*m"
    offset, largest = float(force.mean()), float(abs(force).max())
    good = largest <= declared.error
    text = "offset_counts is wrong, or force.error too small"
    found = f"{offset:.4g} {unit} on average, {largest:.4g} {unit} at most"
    session.judged(axis, "force at rest", f"error {declared.error:g} {unit}", found, good=good, text=text)
    if not good and declared.sampling != "impulse":
        counts = declared.offset_counts + offset / declared.per_count
        session.propose(axis, "admittance.force.offset_counts", counts, "", "tare: nothing pushed on the sensor")
        largest = float(abs(force - offset).max())
    if largest > declared.error:
        session.propose(axis, "admittance.force.error", _SAFE * largest, unit, "1.1 times the residual at rest")


def _loop(session: Session, axis: int) -> None:
    """Measure mass and gains of a drive, sign and latency of its sensor."""
    given, bus = session.axes[axis].parameters, session.scene.bus
    lowest, highest, seconds = 2.0, 40.0, 8.0
    amplitude = min(_AMPLITUDE, 0.5 * (given.speed_limit or _AMPLITUDE), session.speed(axis))
    speeds = sweep(amplitude, lowest, min(highest, 0.1 / session.sample_time), seconds, session.sample_time)
    law = session.play(axis, speeds, len(speeds) + 2, travels=3.0)  # it is the hand that pushes the drive away
    if session.stop_requested():
        return session.not_tried("velocity loop", [axis])
    if law.tripped:
        text = "push less, or raise --travel"
        return session.found(axis, "velocity loop", "", law.tripped, StepVerdict.UNKNOWN, text)
    commands = np.concatenate([np.zeros(1 + bus.delay), speeds])[: len(law.positions)]
    is_mean = given.admittance is not None and given.admittance.force.sampling != "point"
    fit = _fitted(law, commands, session.sample_time, is_mean=is_mean)
    _judge(session, axis, fit)


def _fitted(law: OpenLoop, commands: Array, time: float, *, is_mean: bool) -> _Fit:
    """Return the best fit over all latencies; `commands[k]` acts in the hold that ends at SYNC k."""
    position, force = np.array(law.positions), -np.array(law.applied)
    acted, half = commands[1 : len(position)], max(1, round(5e-3 / time))  # half the width of the hat [s]
    holds = np.minimum(np.arange(2 * half) + 0.5, 2 * half - 0.5 - np.arange(2 * half)) / half**2
    syncs = np.minimum(np.arange(2 * half + 1), 2 * half - np.arange(2 * half + 1)) / half**2
    way = np.diff(position)
    speed, lead = _weighted(way / time, holds), np.concatenate([[0.0], np.cumsum(acted * time - way)])
    change = (position[2 * half :] - 2.0 * position[half:-half] + position[: -2 * half]) / (half * time) ** 2
    lag, lead = speed - _weighted(acted, holds), -_weighted(lead, syncs)
    rows = np.stack([change, lag, lead, np.sign(speed), np.ones(len(speed))], 1)
    pushed = _weighted(force[1:], holds) if is_mean else _weighted(force, syncs)
    fits: list[_Fit] = []
    for latency in range(_LATEST + 1):
        shown = pushed[latency:]
        part = rows[: len(shown)]
        found, _, _, _ = np.linalg.lstsq(part, shown, rcond=None)
        rest = shown - part @ found
        square = float(rest @ rest) / max(1, len(shown) - len(found))
        alike = 2.0 * half  # rows that share samples count once
        spread = np.sqrt(np.diag(np.linalg.inv(part.T @ part)) * square * alike)
        doubt = max(abs(spread[:2] / found[:2]).tolist())
        mass, gain, integral, friction = found[:4].tolist()
        friction = abs(friction) + SURE * spread.item(3)
        fits.append(_Fit(mass, gain, integral, friction, doubt, square, latency))
    return min(fits, key=lambda fit: fit.square)


def _weighted(values: Array, weights: Array) -> Array:
    """Return the mean of each stretch of values under weights, shape (n - len(weights) + 1,)."""
    return np.convolve(values, weights[::-1], mode="valid")


def _judge(session: Session, axis: int, fit: _Fit) -> None:
    linear, given = session.axes[axis].parameters.unit == "m", session.axes[axis].parameters.admittance
    mass_unit, gain_unit = ("kg", "N*s/m") if linear else ("kg*m^2", "N*m*s/rad")
    if given is None:
        return
    if fit.doubt > 0.1:  # of M and c
        text = "push and pull harder and more slowly while it shakes: the hand's forces separate mass from gain"
        return session.found(axis, "velocity loop", "", f"uncertain by {fit.doubt:.0%}", StepVerdict.UNKNOWN, text)
    right = fit.gain > 0.0
    text, found = "per_count: the display would push against the hand", "as configured" if right else "the other way"
    stated = f"{given.force.per_count:g}"
    session.judged(axis, "sign of the force", stated, found, good=right, text=text, fatal=True)
    if not right:
        return session.propose(axis, "admittance.force.per_count", -given.force.per_count, "N" if linear else "N*m")
    late, text = given.force.latency, "the force would be booked with the motion of another hold"
    found = f"{fit.latency} samples"
    session.judged(axis, "latency of the force", f"{late} samples", found, good=late == fit.latency, text=text)
    if late != fit.latency:
        session.propose(axis, "admittance.force.latency", fit.latency)
    _judge_drive(session, axis, fit, mass_unit, gain_unit)


def _judge_drive(session: Session, axis: int, fit: _Fit, mass_unit: str, gain_unit: str) -> None:
    """Judge mass, gains and friction against the declarations of the axis, or of its group."""
    port = session.scene.port_of(session.axes[axis])
    known = port.passivity.parameters
    of_group = f"; in the group {port.name}, the largest of its axes" if len(port.axes) > 1 else ""
    declared = known if isinstance(known, GuardedAdmittanceParameters) else None
    has_friction = declared is not None and declared.drive_friction is not None
    ranged = ("loop_gain", "drive_mass") if has_friction else ("loop_gain",)
    _judge_friction(session, axis, fit.friction, declared)
    for item, value, key, unit in (
        ("mass of the drive", fit.mass, "drive_mass", mass_unit),
        ("gain of the velocity loop", fit.gain, "loop_gain", gain_unit),
        ("integral gain", fit.integral, "integral_gain", gain_unit.replace("*s", "")),
    ):
        # Less than 2 / s counts as no integral
        if key == "integral_gain" and fit.integral < 2.0 * fit.gain and not getattr(declared, key, 0.0):
            continue
        stated = None if declared is None else float(getattr(declared, key))
        least = 0.0 if declared is None or key not in ranged else (1.0 - declared.spread) * (stated or 0.0)
        good = stated is not None and least <= value <= stated
        configured = "" if stated is None else f"{stated:.4g} {unit}, an over-estimate"
        session.judged(axis, item, configured, f"{value:.4g} {unit}", good=good, text="not an over-estimate")
        if not good:
            times = max(_SAFE, 1.0 + SURE * fit.doubt)
            comment = f"{times:.3g} times the measured value{of_group}"
            session.propose(axis, f"passivity.{key}", times * value, unit, comment)


def _judge_friction(session: Session, axis: int, found: float, declared: GuardedAdmittanceParameters | None) -> None:
    """Report the drive's friction, and whether the declared friction, if any, covers it."""
    unit, item = "N" if session.axes[axis].parameters.unit == "m" else "N*m", "friction of the drive"
    value = f"{found:.3g} {unit}"
    if declared is None or declared.drive_friction is None:
        text = "with drive_friction, an over-estimate, force and motion are compared in every run"
        return session.found(axis, item, "", value, StepVerdict.MEASURED, text)
    good = found <= declared.drive_friction
    stated = f"{declared.drive_friction:.3g} {unit}, an over-estimate"
    session.judged(axis, item, stated, value, good=good, text="not an over-estimate")
    if not good:
        session.propose(axis, "passivity.drive_friction", 1.3 * found, unit, "1.3 times: friction at rest")
