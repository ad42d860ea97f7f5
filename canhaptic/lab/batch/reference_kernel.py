"""The continuous environment of one loop, from SYNC to SYNC: a kernel.

Plant, hand and a continuous wall are linear in each of at most three modes: outside, in the lower wall, in the upper
wall. A step is exp(F h) of the mode, h short against the fastest motion of the scene. Where a step crosses a surface or
turns round, and only there, it is done again from its Taylor series in pieces that move one way, so that no graze is
missed: the end of a piece is bracketed and found by a few safeguarded Newton steps. Nothing is kept but the state.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf
from typing import Final, NamedTuple

from canhaptic.kernels import Buffer, Matrix

OUTSIDE, LOWER, UPPER = 0, 1, 2
TERMS: Final = 14  # of the series: 0.5^14 / 14! is below 1e-15
_NEWTON: Final = 8
_CLOSE: Final = 1e-12
"""Part of a piece within which a Newton step ends the search: the step after it would be below rounding."""
_MOST_PIECES: Final = 64


@dataclass(frozen=True, slots=True)
class ReferenceSettings:
    """A continuous environment."""

    exists: bool = False  # whether the loop has one that can be followed
    lower: float = -inf  # solid below [m or rad]
    upper: float = inf  # solid above [m or rad]
    stiffness: float = 0.0  # [N/m or N*m/rad]
    damping: float = 0.0  # [N*s/m or N*m*s/rad]
    everywhere: bool = False  # whether the damper acts in every mode
    with_force: bool = False  # whether the force is asked for
    with_travel: bool = False  # whether it is asked how far it goes
    readings: int = 1  # of the force in a hold
    steps: int = 1  # between two readings
    step: float = 0.0  # [s]
    last_from: int = 0  # SYNC with which the last part of the run begins


@dataclass(slots=True)
class ReferenceState:
    """State of a continuous run."""

    mode: int = OUTSIDE
    cycle: int = 0
    torque: float = 0.0  # at the last reading [N or N*m]
    variation: float = 0.0  # of the torque [N or N*m]
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
    """Go to a SYNC; return the mean torque in the hold before it [N or N*m]."""
    if cycle:
        return follow_hold(settings, reference, memory)
    begin_reference(settings, reference, memory)
    return 0.0


def begin_reference(settings: ReferenceSettings, reference: ReferenceState, memory: ReferenceMemory) -> None:
    """Take the first SYNC, with the start in `memory.state`."""
    position = memory.state[0]
    reference.mode = LOWER if position < settings.lower else UPPER if position > settings.upper else OUTSIDE
    reference.highest = reference.lowest = position
    reference.torque = force(settings, memory)
    reference.variation = abs(reference.torque)


def follow_hold(settings: ReferenceSettings, reference: ReferenceState, memory: ReferenceMemory) -> float:
    """Move by one hold; return the mean torque in it, by the trapezoids between readings [N or N*m]."""
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


def length_of(state: Buffer) -> int:
    """Return the length k of y; compiled it is a constant, so that loops over it are unrolled."""
    return len(state)


def move_step(settings: ReferenceSettings, reference: ReferenceState, memory: ReferenceMemory) -> None:
    """Move by one step, and again in pieces where an event may lie in it."""
    state, moved, mode = memory.state, memory.moved, reference.mode
    size, flow = length_of(state), memory.flows[mode]
    for row in range(size - 1):
        factors, total = flow[row], 0.0
        for column in range(size):
            total += factors[column] * state[column]
        moved[row] = total
    position = moved[0]
    crossed = (position < settings.lower) != (mode == LOWER) or (position > settings.upper) != (mode == UPPER)
    if crossed or state[1] * moved[1] < 0.0:
        reach = (abs(state[1]) + abs(moved[1])) * settings.step
        nearest = min(abs(state[0] - settings.lower), abs(state[0] - settings.upper))
        if nearest <= reach:  # what turns round elsewhere meets no event
            move_in_pieces(settings, reference, memory)
            return
    for row in range(size - 1):
        state[row] = moved[row]


def move_in_pieces(settings: ReferenceSettings, reference: ReferenceState, memory: ReferenceMemory) -> None:
    """Move by one step, piece by piece: each ends at a surface, at a turning point, or at the end."""
    state, series, left = memory.state, memory.series, settings.step
    for _ in range(_MOST_PIECES):
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
    """Surface that a motion along `way` meets next [m or rad], infinite if there is none."""
    if way > 0.0:
        return settings.lower if mode == LOWER else settings.upper if mode == OUTSIDE else inf
    return settings.upper if mode == UPPER else settings.lower if mode == OUTSIDE else -inf


def mode_beyond(settings: ReferenceSettings, mode: int, is_up: bool) -> int:
    """Return the mode on the other side of a surface."""
    if mode == OUTSIDE:
        return UPPER if is_up else LOWER
    return LOWER + UPPER - mode if settings.lower == settings.upper else OUTSIDE


def expand(memory: ReferenceMemory, mode: int) -> None:
    """Write the Taylor coefficients of the state in a mode."""
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
    """Return a polynomial at a time [s]."""
    total = series[TERMS - 1][row]
    for order in range(TERMS - 2, -1, -1):
        total = total * at + series[order][row]
    return total


def root(series: Matrix, row: int, constant: float, until: float, end: float) -> float:
    """Root before `until` [s] of a monotonic polynomial.

    Args:
        series: Coefficients; the first is not used.
        row: Row of the polynomial.
        constant: First coefficient; 0 or of the sign opposite to `end`.
        until: End of the bracket [s].
        end: Value of the polynomial there.
    """
    low, high = 0.0, until
    at = until * constant / (constant - end)
    for _ in range(_NEWTON):
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
        found = abs(better - at) <= _CLOSE * until
        at = better
        if found:
            break
    return at
