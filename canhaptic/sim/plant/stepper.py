"""The stepper of piecewise-affine plants, as pure functions on tables: interpreted, or compiled by numba in `lab`.

A hold is taken in the largest steps that the mode allows. When a guard is below zero at the end of a step, or the
strict bound of `assembly.py` does not exclude that it was inside, the step is halved, down to one tick, at which the
mode changes. After an accepted step longer ones are tried, up to the whole hold. The flow is exact and the bound strict
at every length, so that only guards keep a step short, never a fast mode at rest, and neither a root finder nor an
error estimate is needed. The stepper stops at a number of events, or of products, that the caller sets.

Only the first six functions work on arrays. Interpreted, a table holds bound products of NumPy (`flow.dot`: half the
cost of `numpy.dot`); compiled, it holds arrays, and these six are replaced.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np

from canhaptic.kernels import Indices
from canhaptic.sim.plant import LEVELS
from canhaptic.sim.plant.propagator import TICKS, Array

_ROUNDING: Final = 1e-14  # a guard is broken when it is below zero by more than this part of its largest term
_CHAIN: Final = 16  # switches without time between them
NONE: Final = -1  # every guard holds
_DOUBTFUL: Final = -2  # a guard may have dipped below zero inside the step

MODE: Final = 0  # places in `counts`: the mode the machine is in,
EVENTS: Final = 1  # mode changes since the start,
PRODUCTS: Final = 2  # steps tried since the start,
LIMIT: Final = 3  # events at which it stops,
MISSING: Final = 4  # guard that leads to a mode not compiled yet, or NONE: the caller compiles it and runs on
COUNTS: Final = 5


class ModeTables(NamedTuple):
    """All modes as data; the first index of each table is the mode. Lists when interpreted, arrays when compiled."""

    flows: Any  # by level: z -> z after T / 2^level
    works: Any  # by level: z -> what `book` needs
    guards: Any  # values of the guards, their rates, and the scaled rates of the state as rows
    guard_counts: Any
    slack: Any  # these four as in `guard_bounds.GuardBounds`
    chord: Any
    bend: Any
    spread: Any
    targets: Any  # by guard: the mode it leads to, or NONE when that is not compiled yet
    jumps: Any  # by guard: whether the state jumps there
    resets: Any  # by guard: z -> z after the jump
    losses: Any  # by guard: the work that takes the energy lost in the jump
    storage: Any  # P with z'Pz the stored energy


class StepperSettings(NamedTuple):
    """Constants of a plant that its stepper needs."""

    max_events: int  # in one hold
    event_level: int
    tick_time: float  # [s]
    max_products: int  # in one call


@dataclass(frozen=True, slots=True)  # read at every step: half the cost of the fields of a NamedTuple
class StepBuffers:
    """Buffers for the work of one step; two of them take turns, so that booking is two products and no sum.

    The first product writes `rows`: for each work [Q y, unit row], then y, the state with the hand's deflection. In the
    same memory y is followed by the totals, and the second product, [Q y, unit row] . [y, totals], is y'Qy + total.
    """

    moved: Array  # state after the step when one product gives it together with the rows, shape (n,)
    rows: Array  # all but the totals, shape (works * (n + works) + n,)
    contract: Any  # [y, totals] -> totals after the step
    vector: Array  # [y, totals], shape (n + works,)
    totals: Array  # a view of the vector, shape (works,)
    totals_after: Array  # the totals in the other buffer, shape (works,)
    flat: tuple[Any, ...]  # moved; it and the rows, one behind the other; contract, vector, totals_after; moved.item


def two_buffers(size: int, works: int) -> list[StepBuffers]:
    """Return the two buffers for a state of `size` and a number of works."""
    length = works * (size + works)
    this, other = np.zeros(length + 2 * size + works), np.zeros(length + 2 * size + works)

    def books(buffer: Array, after: Array) -> StepBuffers:
        both, vector = buffer[: length + 2 * size], buffer[size + length :]
        contract = buffer[size : size + length].reshape(works, size + works).dot
        moved, sums_after = both[:size], after[length + 2 * size :]
        flat = (moved, both, contract, vector, sums_after, moved.item)
        return StepBuffers(moved, both[size:], contract, vector, vector[size:], sums_after, flat)

    return [books(this, other), books(other, this)]


def move(product: Callable[[Array, Array], object], state: Array, moved: Array) -> None:
    """Write the product of a matrix and the state to `moved`."""
    product(state, moved)


def evaluate(guards: Any, state: Array, values: Any) -> Any:
    """Return all guard rows times the state; `values` is a buffer for the result."""
    return guards.dot(state).tolist()


def pace(values: Any, first: int) -> float:
    """Return the length of the scaled rates of the state, the values from `first` on."""
    return math.hypot(*values[first:])


def largest_term(guards: Any, guard: int, state: Array) -> float:
    """Return the largest magnitude of the terms that sum to a guard, a function whose zero is an event."""
    return float(np.abs(guards[guard] * state).max())


def stored(storage: Any, state: Array) -> float:
    """Return the kinetic and elastic energy [J]."""
    return float(storage.dot(state).dot(state))


def book(works: Any, state: Array, books: Any) -> None:
    """Book the work of a step that begins at `state`."""
    this = books[0]
    works(state, this.rows)
    this.contract(this.vector, this.totals_after)
    books[0], books[1] = books[1], this


def first_broken(guards: Any, count: int, values: Any, state: Array) -> int:
    """Return the first guard (condition of an event) that `state` has crossed, or NONE."""
    for i in range(count):
        if values[i] < 0.0 and values[i] < -_ROUNDING * largest_term(guards, i, state):
            return i
    return NONE


def may_dip(
    tables: ModeTables, mode: int, level: int, before: Any, after: Any, guard: int, step: float, rounding: float
) -> bool:
    """Return True if the bounds do not exclude that a guard was below `rounding` inside the step.

    With `low` a lower bound of its second derivative, the guard less low t^2 / 2 is convex: it lies above its tangents
    at both ends, and so does the guard above the two parabolas of curvature `low`.
    """
    count = tables.guard_counts[mode]
    chord, spread, bend = tables.chord[mode][level][guard], tables.spread[mode][level][guard], tables.bend[mode][guard]
    off, low = 0.0, 0.0
    for j in range(len(bend)):
        rate = before[2 * count + j]
        size = abs(rate)
        off += size * chord[j]
        low += rate * bend[j] - size * spread[j]
    begin, end, falling, rising = before[guard], after[guard], before[count + guard], after[count + guard]
    if min(begin, end) - off >= rounding:
        return False
    turning = rising - falling - low * step
    meeting = 0.5 * step
    if turning > 0.0:
        meeting = min(step, max(0.0, (begin - end + (rising - 0.5 * low * step) * step) / turning))
    return bool(min(least(begin, falling, low, meeting), least(end, -rising, low, step - meeting)) < rounding)


def least(value: float, rate: float, curvature: float, length: float) -> float:
    """Return the least value of a parabola on [0, length]."""
    if curvature > 0.0 and -curvature * length < rate < 0.0:
        return value - 0.5 * rate * rate / curvature
    return min(value, value + (rate + 0.5 * curvature * length) * length)


def leave(
    tables: ModeTables, state: Array, moved: Array, books: Any, counts: Indices, guard: int
) -> tuple[Array, Array]:
    """Change the mode through a guard, with its jump; return the state and the unused buffer."""
    mode = counts[MODE]
    after = tables.targets[mode][guard]
    counts[EVENTS] += 1
    counts[MODE] = after
    if tables.jumps[mode][guard]:
        move(tables.resets[mode][guard], state, moved)
        lost = stored(tables.storage[mode], state) - stored(tables.storage[after], moved)
        books[0].totals[tables.losses[mode][guard]] += lost
        return moved, state
    return state, moved


def settle(
    tables: ModeTables, state: Array, moved: Array, books: Any, counts: Indices, values: Any
) -> tuple[Array, Array, Any]:
    """Leave every mode whose guards are violated at this state; return state, unused buffer and the guards' values."""
    for _ in range(_CHAIN):
        mode = counts[MODE]
        guards = tables.guards[mode]
        values = evaluate(guards, state, values)
        guard = first_broken(guards, tables.guard_counts[mode], values, state)
        if guard == NONE or counts[EVENTS] >= counts[LIMIT]:
            return state, moved, values
        if tables.targets[mode][guard] < 0:
            counts[MISSING] = guard
            return state, moved, values
        state, moved = leave(tables, state, moved, books, counts, guard)
    values = evaluate(tables.guards[counts[MODE]], state, values)
    return state, moved, values


def judge(
    tables: ModeTables, mode: int, level: int, before: Any, after: Any, state: Array, moved: Array, step: float
) -> int:
    """Return the guard that was crossed in a step, NONE, or _DOUBTFUL; a step of 0 is never halved."""
    count, guards = tables.guard_counts[mode], tables.guards[mode]
    broken = first_broken(guards, count, after, moved)
    if broken == NONE and step > 0.0:
        for i in range(count):
            rounding = -_ROUNDING * max(largest_term(guards, i, state), largest_term(guards, i, moved))
            if may_dip(tables, mode, level, before, after, i, step, rounding):
                return _DOUBTFUL
    return broken


def run_free(
    tables: ModeTables, state: Array, moved: Array, books: Any, counts: Indices, ticks: int
) -> tuple[Array, Array]:
    """Move by `ticks`, ignoring guards: whole sample times, then one step per bit; return state and unused buffer."""
    mode = counts[MODE]
    flows, works = tables.flows[mode], tables.works[mode]
    for _ in range(ticks >> LEVELS):
        move(flows[0], state, moved)
        book(works[0], state, books)
        state, moved = moved, state
        counts[PRODUCTS] += 1
    rest, level = ticks & (TICKS - 1), 0
    while rest:
        level += 1
        if rest & (TICKS >> level):
            rest -= TICKS >> level
            move(flows[level], state, moved)
            book(works[level], state, books)
            state, moved = moved, state
            counts[PRODUCTS] += 1
    return state, moved


def run(
    tables: ModeTables, settings: StepperSettings, state: Array, moved: Array, books: Any, counts: Indices, values: Any,
    ticks: int,
) -> tuple[Array, Array, int]:  # fmt: skip
    """Move by `ticks` under constant inputs, through every event on the way.

    Returns:
        State, unused buffer, and the ticks left: above zero with counts[MISSING] set or at a limit only.
    """
    state, moved, before = settle(tables, state, moved, books, counts, values[0])
    mode, after = counts[MODE], values[1]
    flows, guards, count = tables.flows[mode], tables.guards[mode], tables.guard_counts[mode]
    level, climb, window, known, event_level, tried = 0, 1, -1, -1, settings.event_level, 0
    most = settings.max_products
    while ticks and tried < most and counts[MISSING] == NONE and counts[EVENTS] < counts[LIMIT]:
        while TICKS >> level > ticks or (ticks - (TICKS >> level) == known and level < event_level):
            level += 1
        tried += 1
        move(flows[level], state, moved)
        after = evaluate(guards, moved, after)
        slack, speed, broken = tables.slack[mode][level], pace(before, 2 * count), NONE
        for i in range(count):
            near = slack[i] * speed
            if after[i] < near or before[i] < near:
                step = settings.tick_time * (TICKS >> level) if level < event_level else 0.0
                broken = judge(tables, mode, level, before, after, state, moved, step)
                break
        if broken != NONE and level < event_level:
            window = ticks - (TICKS >> level)
            known = known if broken == _DOUBTFUL else window  # a guard is below zero there, however one comes to it
            level, climb = level + 1, 1
            continue
        book(tables.works[mode][level], state, books)
        state, moved = moved, state
        ticks -= TICKS >> level
        before, after = after, before
        if broken != NONE:
            state, moved, before = settle(tables, state, moved, books, counts, before)
            mode = counts[MODE]
            flows, guards, count = tables.flows[mode], tables.guards[mode], tables.guard_counts[mode]
            level, climb, window, known = 0, 1, -1, -1
        elif ticks <= window or window < 0:
            level, climb, window = max(0, level - climb), min(2 * climb, LEVELS), -1
    counts[PRODUCTS] += tried
    return state, moved, ticks
