"""Motion and force in the continuous environment that a sampled loop is compared with, from SYNC to SYNC.

Plant, hand and a continuous wall are linear in each of at most three modes: outside, in the lower wall, in the upper
wall. A step multiplies the state by exp(F h) of its mode, with h short against the fastest motion. A step that crosses
a surface or reverses near one is repeated from its Taylor series in monotonic pieces, so that no graze is missed: the
end of a piece is bracketed and found by a few safeguarded Newton steps.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf
from typing import Annotated, Final, NamedTuple

from canhaptic.kernels import OFTEN_ZERO, Buffer, Matrix
from canhaptic.lab.batch.closed_loop import Room
from canhaptic.lab.batch.mode_arrays import evaluate
from canhaptic.lab.figures.meter import Meter, compare

OUTSIDE, LOWER, UPPER = 0, 1, 2
TERMS: Final = 14  # of the Taylor series: 0.5^14 / 14! is below 1e-15


@dataclass(frozen=True, slots=True)
class ReferenceSettings:
    """Constants of a continuous environment."""

    exists: Annotated[bool, OFTEN_ZERO] = False  # whether the loop is compared with a continuous environment
    lower: float = -inf  # surface of the wall below [m or rad]
    upper: float = inf  # surface of the wall above [m or rad]
    stiffness: float = 0.0  # [N/m or N*m/rad]
    damping: float = 0.0  # [N*s/m or N*m*s/rad]
    everywhere: bool = False  # whether the damper acts in every mode
    with_force: bool = False  # whether the force is needed
    with_travel: bool = False  # whether the travel is needed
    readings: int = 1  # samples of the force in a hold
    steps: int = 1  # steps between two samples
    step: float = 0.0  # [s]
    last_from: int = 0  # SYNC with which the last part of the run begins


@dataclass(slots=True)
class ReferenceState:
    """State of a run in the continuous environment."""

    mode: int = OUTSIDE
    cycle: int = 0
    torque: float = 0.0  # at the last sample [N or N*m]
    variation: float = 0.0  # total variation of the torque [N or N*m]
    highest: float = -inf  # position at any SYNC [m or rad]
    lowest: float = inf
    last_highest: float = -inf  # the same in the last part
    last_lowest: float = inf


class ReferenceMemory(NamedTuple):
    """Matrices and buffers of a continuous run, y = [states of the plant..., 1] of length k."""

    flows: Sequence[Matrix]  # by mode: y after a step, shape (3, k, k)
    rates: Sequence[Matrix]  # by mode: y' = F y, shape (3, k, k) [1/s]
    state: Buffer  # y
    moved: Buffer  # y after a step
    series: Matrix  # Taylor coefficients of y, shape (TERMS, k)


def follow(settings: ReferenceSettings, reference: ReferenceState, memory: ReferenceMemory, cycle: int) -> float:
    """Advance to a SYNC; return the mean torque in the previous hold [N or N*m]."""
    if cycle:
        return follow_hold(settings, reference, memory)
    begin_reference(settings, reference, memory)
    return 0.0


def begin_reference(settings: ReferenceSettings, reference: ReferenceState, memory: ReferenceMemory) -> None:
    """Initialise a continuous run from the state in `memory.state`, at the first SYNC."""
    position = memory.state[0]
    reference.mode = LOWER if position < settings.lower else UPPER if position > settings.upper else OUTSIDE
    reference.highest = reference.lowest = position
    reference.torque = force(settings, memory)
    reference.variation = abs(reference.torque)


def follow_hold(settings: ReferenceSettings, reference: ReferenceState, memory: ReferenceMemory) -> float:
    """Advance by one hold; return the mean torque in it, by the trapezoidal rule over its samples [N or N*m]."""
    mean = 0.0
    for _ in range(settings.readings):
        for _ in range(settings.steps):
            move_step(settings, reference, memory)
        if settings.with_force:
            torque = force(settings, memory)
            mean += (0.5 / settings.readings) * (torque + reference.torque)
            reference.variation += abs(torque - reference.torque)
            reference.torque = torque
    if not settings.with_travel:
        return mean
    position = memory.state[0]
    reference.cycle += 1
    reference.highest, reference.lowest = max(reference.highest, position), min(reference.lowest, position)
    if reference.cycle >= settings.last_from:
        reference.last_highest = max(reference.last_highest, position)
        reference.last_lowest = min(reference.last_lowest, position)
    return mean


def force(settings: ReferenceSettings, memory: ReferenceMemory) -> float:
    """Return the torque of the environment [N or N*m]."""
    position, velocity = memory.state[0], memory.state[1]
    if settings.everywhere:
        return -settings.damping * velocity
    if position < settings.lower:
        return -settings.stiffness * (position - settings.lower) - settings.damping * velocity
    if position > settings.upper:
        return -settings.stiffness * (position - settings.upper) - settings.damping * velocity
    return 0.0


def move_step(settings: ReferenceSettings, reference: ReferenceState, memory: ReferenceMemory) -> None:
    """Advance by one step; repeat it in pieces where it may contain an event."""
    state, moved, mode = memory.state, memory.moved, reference.mode
    evaluate(memory.flows[mode], state, moved)
    position = moved[0]
    crossed = (position < settings.lower) != (mode == LOWER) or (position > settings.upper) != (mode == UPPER)
    if crossed or state[1] * moved[1] < 0.0:
        reach = (abs(state[1]) + abs(moved[1])) * settings.step
        nearest = min(abs(state[0] - settings.lower), abs(state[0] - settings.upper))
        if nearest <= reach:  # a reversal farther away meets no event
            move_in_pieces(settings, reference, memory)
            return
    for row in range(len(state) - 1):
        state[row] = moved[row]


def move_in_pieces(settings: ReferenceSettings, reference: ReferenceState, memory: ReferenceMemory) -> None:
    """Advance by one step in monotonic pieces; each ends at a surface, at a reversal, or with the step."""
    state, series, left = memory.state, memory.series, settings.step
    for _ in range(64):  # pieces at most
        expand(memory, reference.mode)
        velocity, end = state[1], value_at(series, 1, left)
        turns = velocity * end < 0.0
        until = root(series, 1, velocity, left, end) if turns else left
        ahead = surface_ahead(settings, reference.mode, velocity if turns else velocity + end)
        is_up = (velocity if turns else velocity + end) > 0.0
        beyond = value_at(series, 0, until) - ahead
        crossed = (beyond > 0.0 if is_up else beyond < 0.0) and abs(ahead) < inf
        at = root(series, 0, series[0][0] - ahead, until, beyond) if crossed else until
        for row in range(len(state) - 1):
            state[row] = value_at(series, row, at)
        if crossed:
            state[0] = ahead
            reference.mode = mode_beyond(settings, reference.mode, is_up)
        elif turns:
            state[1] = 0.0
        left -= at
        if not (turns or crossed) or left <= 0.0:
            break


def surface_ahead(settings: ReferenceSettings, mode: int, way: float) -> float:
    """Return the next surface in the direction of the sign of `way` [m or rad]; infinite if there is none."""
    if way > 0.0:
        return settings.lower if mode == LOWER else settings.upper if mode == OUTSIDE else inf
    return settings.upper if mode == UPPER else settings.lower if mode == OUTSIDE else -inf


def mode_beyond(settings: ReferenceSettings, mode: int, is_up: bool) -> int:
    """Return the mode that a motion enters when it leaves this mode upwards or downwards."""
    if mode == OUTSIDE:
        return UPPER if is_up else LOWER
    return LOWER + UPPER - mode if settings.lower == settings.upper else OUTSIDE


def expand(memory: ReferenceMemory, mode: int) -> None:
    """Write the Taylor coefficients of the motion in a mode, from the present state."""
    series, rates, size = memory.series, memory.rates[mode], len(memory.state)
    for row in range(size):
        series[0][row] = memory.state[row]
    for order in range(1, TERMS):
        for row in range(size):
            total = 0.0
            for column in range(size):
                total += rates[row][column] * series[order - 1][column]
            series[order][row] = total / order


def value_at(series: Matrix, row: int, at: float) -> float:
    """Return the value of a row's polynomial at a time [s]."""
    total = series[TERMS - 1][row]
    for order in range(TERMS - 2, -1, -1):
        total = total * at + series[order][row]
    return total


def root(series: Matrix, row: int, constant: float, until: float, end: float) -> float:
    """Return the root of a monotonic polynomial between 0 and `until` [s].

    Args:
        series: Coefficients; the constant one is replaced by `constant`.
        row: Row of the polynomial.
        constant: Constant coefficient; 0, or opposite in sign to `end`.
        until: End of the bracket [s].
        end: Value of the polynomial at `until`.
    """
    low, high = 0.0, until
    at = until * constant / (constant - end)
    for _ in range(8):  # Newton steps
        rising = slope = 0.0
        for order in range(TERMS - 1, 0, -1):
            rising = rising * at + series[order][row]
            slope = slope * at + order * series[order][row]
        value = rising * at + constant
        if (value > 0.0) == (end > 0.0):
            high = at
        else:
            low = at
        newton = at - value / slope if slope != 0.0 else low - 1.0
        better = newton if low <= newton <= high else 0.5 * (low + high)
        found = abs(better - at) <= 1e-12 * until  # the step after it would be below rounding
        at = better
        if found:
            break
    return at


class Continuous(NamedTuple):
    """Continuous environment that the loop of an axis is compared with, if it exists."""

    settings: ReferenceSettings
    state: ReferenceState  # before it begins
    memory: ReferenceMemory  # at the start


def watch_continuous(watched: Continuous, room: Room, meter: Meter, cycle: int) -> None:
    """Replace `watch`: compare an axis with its continuous environment."""
    if watched.settings.exists:
        mean = follow(watched.settings, watched.state, watched.memory, cycle)
        compare(meter, room.true[0], room.held[0], watched.memory.state[0], mean)
