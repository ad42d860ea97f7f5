"""Measurement of the torque's lateness: reversals while the axis is fastest, timed against the commands."""

import math
from collections.abc import Mapping
from functools import partial
from typing import Final

import numpy as np

from canhaptic.axis_units import effort_unit
from canhaptic.commission.findings import StepVerdict
from canhaptic.commission.laws import OpenLoop, reversals
from canhaptic.commission.mass_and_friction import estimate_lateness
from canhaptic.commission.session import Session
from canhaptic.commission.wall_trial import SURE, is_dear, needed_allowance

_ITEM: Final = "torque lag"
_SHORTEST: Final = 24  # cycles of the first part of the longest doublet
_LONGEST: Final = 60
_DOUBLETS: Final = (32, 64, 128, 256)
"""Lengths of the tests, one after the other until the wall can be judged; 45 s at 1 kHz in all."""
_OVER: Final = 1.1
_EARLY: Final = 3.0  # standard deviations below 0 from which on a torque acts before its SYNC


def time_the_torque(session: Session, axis: int, most: float, mass: float, known: Mapping[str, float]) -> None:
    """Measure the lateness of the torque, and propose its upper bounds.

    The test is repeated, longer each time, while its uncertainty costs too much of the wall.

    Args:
        session: The rig.
        axis: Its index.
        most: Largest torque [N or N*m].
        mass: First estimate of the mass, in the units of the encoder as configured [kg or kg*m^2].
        known: Measured values of `passivity`, SI.

    Raises:
        RigError: Drive or link failed.
    """
    torque, longest = _reversal(session, axis, most, mass)
    name, unit = session.axes[axis].parameters.name, effort_unit(session.axes[axis].parameters.unit)
    if not session.agreed(f"{name}: hands off. Reversals of {torque:.3g} {unit}, now?", _ITEM, [axis]):
        return
    for count in _DOUBLETS:
        law = session.play_within(axis, _ITEM, partial(reversals, longest=longest, count=count), torque)
        if session.stop_requested():
            session.not_tried(_ITEM, [axis])
            return
        late = None if law.tripped else _lateness(session, axis, law, longest // 3)
        if late is None:
            text = f"{law.tripped or 'too little motion'}; raise --travel or --torque"
            session.found(axis, _ITEM, "", "unclear", StepVerdict.UNKNOWN, text)
            return
        if count == _DOUBLETS[-1] or _is_resolved(session, axis, late, known):
            declared = session.axes[axis].loop.current_lag or 0.0
            is_kept = late[0] <= SURE * late[1] and _at_most(late) <= declared
            is_kept = is_kept and not _is_lost(session, axis, declared, known)
            _report(session, axis, late, "configured value kept" if is_kept else "")
            if late[0] >= -_EARLY * late[1]:
                _propose(session, axis, None if is_kept else _at_most(late), known)
            return
        session.dialogue.tell(f"  {name}: {_ITEM}: +- {SURE * late[1] * 1e6:.2g} us costs too much of the wall")


def _at_most(late: tuple[float, float]) -> float:
    """Lag to declare, from a measured one and its standard deviation [s]."""
    return _OVER * (max(0.0, late[0]) + SURE * late[1])


def _is_resolved(session: Session, axis: int, late: tuple[float, float], known: Mapping[str, float]) -> bool:
    """Whether the wall is kept with the bound to declare, or lost even with the least measured lag."""
    least = max(0.0, late[0] - SURE * late[1])
    return not _is_lost(session, axis, _at_most(late), known) or _is_lost(session, axis, least, known)


def _is_lost(session: Session, axis: int, lag: float, known: Mapping[str, float]) -> bool:
    """Return whether a lag [s] costs more of the wall than it may."""
    without, lagging = ({**known, "current_lag": value} for value in (0.0, lag))
    return is_dear(session.axes[axis], session.limits.speed, without, lagging)


def _reversal(session: Session, axis: int, most: float, mass: float) -> tuple[float, int]:
    """Return the torque of the test [N or N*m], and the cycles of its longest part, within half of the limits."""
    travel, speed, time = 0.25 * session.limits.travel, 0.5 * session.limits.speed, session.sample_time
    wanted = min(math.sqrt(travel * mass / most), speed * mass / most) / time
    cycles = max(_SHORTEST, min(_LONGEST, round(wanted)))
    allowed = mass * min(travel / (cycles * time) ** 2, speed / (cycles * time))
    quantum = session.drives[axis].scaling.torque_quantum
    return max(1, math.floor(min(most, allowed) / quantum)) * quantum, cycles


def _lateness(session: Session, axis: int, law: OpenLoop, half_base: int) -> tuple[float, float] | None:
    """Return lateness and standard deviation [s], against the torques sent: a measured one is late itself."""
    parameters, ahead = session.axes[axis].parameters, 1 + session.axes[axis].loop.delay
    acted = np.concatenate([np.zeros(ahead), law.sent])[: len(law.positions)]
    if parameters.torque_rate_limit or parameters.power_limit:  # which alter the commands
        acted = np.array(law.applied)
    positions = np.array(law.positions) / session.encoder_ratios[axis]
    return estimate_lateness(positions, acted, session.sample_time, half_base)


def _report(session: Session, axis: int, late: tuple[float, float], kept: str) -> None:
    """Report the lateness against the declared values, and whether these are `kept`."""
    declared = (session.axes[axis].loop.torque_window or 0.0) + (session.axes[axis].loop.current_lag or 0.0)
    value, error = late[0], SURE * late[1]
    configured, found = f"at most {declared * 1e6:.3g} us", f"{value * 1e6:.3g} +- {error * 1e6:.2g} us"
    if value < -_EARLY * late[1]:
        text = "acts before its SYNC: declare rpdo: event, and commission again"
        session.found(axis, _ITEM, configured, found, StepVerdict.FAILED, text)
    elif value <= error:
        found = f"below what this test resolves (+- {error * 1e6:.2g} us)"
        session.found(axis, _ITEM, configured, found, StepVerdict.AGREES, kept)
    else:
        text = "declare more, or guarded is not passive"
        session.judged(axis, _ITEM, configured, found, good=value - error <= declared, text=text)


def _propose(session: Session, axis: int, lag: float | None, known: Mapping[str, float]) -> None:
    """Propose window and lag, and the allowance that keeps the wall where they would cost too much of it.

    Args:
        session: The rig.
        axis: Its index.
        lag: Lag to declare [s]; None: the configured one is right.
        known: Measured values of `passivity`, SI.
    """
    scene = session.axes[axis]
    window = scene.loop.torque_window or 0.0
    session.propose(axis, "passivity.torque_window", window, "s", "by the bus; the rest is in the lag")
    comment = f"{_OVER:g} times the measured upper end" if lag is not None else "more than this test resolves"
    session.propose(axis, "passivity.current_lag", lag, "s", comment)
    if lag is None or not _is_lost(session, axis, lag, known):
        return
    without, lagging = ({**known, "current_lag": value} for value in (0.0, lag))
    allowance = needed_allowance(scene, session.limits.speed, without, lagging)
    text = f"current_lag {lag * 1e6:.3g} us leaves no energy to start a contact"
    if allowance is None:
        session.found(axis, "wall", "", "not rendered", StepVerdict.DIFFERS, f"{text}; render a softer one")
        return
    session.found(axis, "wall", "", f"needs energy_allowance {allowance:.3g} J", StepVerdict.MEASURED, text)
    session.propose(axis, "passivity.energy_allowance", allowance, "J", f"{text}; this much may be given out")
