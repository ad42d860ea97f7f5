"""The one stepper: a piecewise-affine machine that moves by dyadic steps and brackets its events to one tick.

A hold is taken in the largest steps that the mode allows. When a guard is below zero at the end of a step, or may have
dipped below it inside (its rate changed sign and the two tangents meet below zero), the step is halved, down to one
tick; there the mode changes. No root finder and no adaptive step; at most `max_events` events a hold, the excess is
counted, and the rest of that hold runs on without guards.
"""

import math
from typing import Final, NamedTuple

import numpy as np

from canhaptic.sim.assembly import Scene
from canhaptic.sim.compiler import Mode, Product, compile_mode, first_key, initial_state
from canhaptic.sim.propagator import LEVELS, TICKS, Array

_ROUNDING: Final = 1e-14  # a guard is broken when it is below zero by more than this part of its largest term
_CHAIN: Final = 16  # switches without time between them


class Books(NamedTuple):
    """Buffers for the work of one step; two of them take turns, so that booking is two products and no sum.

    The first product writes `rows`: for each work [Q y, unit row], then y, the state with the hand's deflection. In the
    same memory y is followed by the totals, and the second product, [Q y, unit row] . [y, totals], is y'Qy + total.
    """

    rows: Array  # all but the totals, shape (works * (n + works) + n,)
    contract: Product  # [y, totals] -> totals after the step
    vector: Array  # [y, totals], shape (n + works,)
    totals_after: Array  # the totals in the other buffer, shape (works,)


def _two_books(size: int, works: int) -> tuple[Books, Books]:
    length = works * (size + works)
    this, other = np.zeros(length + size + works), np.zeros(length + size + works)

    def books(buffer: Array, after: Array) -> Books:
        contract = buffer[:length].reshape(works, size + works).dot
        return Books(buffer[: length + size], contract, buffer[length:], after[length + size :])

    return books(this, other), books(other, this)


class Snapshot(NamedTuple):
    """Everything that a hold changes."""

    state: Array
    mode: Mode
    totals: Array
    events: int
    capped: int


class Machine:
    """State, mode and energies of one scene.

    Attributes:
        state: z, shape (n,); the torque is the last but one component.
        events: Mode changes since the start.
        capped: Holds in which the cap on events was reached.
        tick_time: T / 2^24 [s].
        products: Matrix-vector products of flows taken, a machine-independent price.
    """

    def __init__(self, scene: Scene, max_events: int, event_bits: int) -> None:
        self.scene = scene
        self.max_events = max_events
        self._event_level = event_bits
        self.tick_time = scene.sample_time / TICKS
        self._modes: dict[tuple[str, ...], Mode] = {}
        self._part_index = {part.name: i for i, part in enumerate(scene.parts)}
        names = scene.names
        sines = [name for name in names if name.endswith("_sine")]
        self._oscillators = [(names.index(name), names.index(name[:-4] + "cosine")) for name in sines]
        size, works = len(names), len(scene.works)
        self._size = size
        self._books, self._spare_books = _two_books(size, works)
        self.reset()

    def reset(self) -> None:
        """Returns to the initial state and mode, with no energy booked."""
        self.state = initial_state(self.scene)
        self._moved = self.state.copy()
        self.totals.fill(0.0)
        self._sums, self._carries = self.totals.copy(), self.totals.copy()
        self.events = self.capped = self.products = 0
        self.mode = self._mode_of(first_key(self.scene))
        self._settle()  # a body that starts beyond a stop starts with the stop's energy
        self.totals.fill(0.0)
        self.events = 0

    @property
    def first_mode(self) -> Mode:
        """The mode the scene starts in."""
        return self._mode_of(first_key(self.scene))

    def save(self) -> Snapshot:
        """Returns a copy of everything that a hold changes."""
        return Snapshot(self.state.copy(), self.mode, self.totals.copy(), self.events, self.capped)

    def restore(self, saved: Snapshot) -> None:
        """Goes back to a copy."""
        np.copyto(self.state, saved.state)
        np.copyto(self.totals, saved.totals)
        self.mode, self.events, self.capped = saved.mode, saved.events, saved.capped

    @property
    def totals(self) -> Array:
        """Work booked since the last `tidy`, in the order of `scene.works` [J]; a view."""
        return self._books.vector[self._size :]

    def works(self) -> Array:
        """Returns the work booked since the start, in the order of `scene.works` [J]."""
        return self._sums + (self._carries + self.totals)

    def tidy(self) -> None:
        """Keeps rounding from growing with the length of a run; called at fixed times, never by who reads.

        Folds the totals into compensated sums and brings the hand's oscillators back to unit amplitude.
        """
        sums = self._sums + self.totals
        part = sums - self._sums
        self._carries += (self._sums - (sums - part)) + (self.totals - part)
        self._sums = sums
        self.totals.fill(0.0)
        for sine, cosine in self._oscillators:
            norm = math.hypot(self.state[sine], self.state[cosine])
            self.state[sine] /= norm
            self.state[cosine] /= norm

    def stored(self) -> float:
        """Returns the kinetic and elastic energy [J]."""
        return float(self.mode.storage.dot(self.state).dot(self.state))

    def set_part_mode(self, part: str, mode: str) -> None:
        """Puts one part into another mode, at a time that the scene fixed beforehand."""
        self._enter(self._part_index[part], mode)

    def period(self, torque: float) -> float:
        """Takes one whole sample time in one step, for scenes without guards; returns the position after it.

        The same as `run_free`, written flat: this is the whole plant of most scenes, at every SYNC.
        """
        state, moved, mode = self.state, self._moved, self.mode
        state[-2] = torque
        rows, contract, vector, totals_after = books = self._books
        mode.works[0](state, rows)
        contract(vector, totals_after)
        self._books, self._spare_books = self._spare_books, books
        mode.flows[0](state, moved)
        self.state, self._moved = moved, state
        self.products += 1
        return moved.item(0)

    def run_free(self, ticks: int) -> None:
        """Moves by `ticks` ignoring guards: whole sample times, then one step per bit."""
        mode = self.mode
        for _ in range(ticks >> LEVELS):
            self._commit(mode, 0)
        for level in range(1, LEVELS + 1):
            if ticks & (TICKS >> level):
                self._commit(mode, level)
        self.products += (ticks >> LEVELS) + (ticks & (TICKS - 1)).bit_count()

    def run(self, ticks: int) -> None:
        """Moves by `ticks` under constant inputs, through every event on the way."""
        limit = self.events + self.max_events
        values = self._settle()
        mode, level, window = self.mode, self.mode.base, -1
        while ticks:
            while TICKS >> level > ticks:
                level += 1
            broken, after = self._try(mode, level, values)
            if broken != _NONE and level < self._event_level:
                window, level = ticks - (TICKS >> level), level + 1
                continue
            self._book_and_swap(mode, level)
            ticks -= TICKS >> level
            if broken >= 0:
                if self.events >= limit:
                    self.capped += 1
                    self.run_free(ticks)
                    return
                self._leave(broken)
                values = self._settle()
                mode, level, window = self.mode, self.mode.base, -1
                continue
            values = after
            if ticks <= window:
                level, window = mode.base, -1

    def _try(self, mode: Mode, level: int, before: list[float]) -> tuple[int, list[float]]:
        """Steps into the spare state; returns the guard that broke (or _NONE, _DOUBTFUL) and the guards' values."""
        self.products += 1
        mode.flows[level](self.state, self._moved)
        after: list[float] = mode.guards.dot(self._moved).tolist()
        count = len(mode.exits)
        for i in range(count):
            if after[i] < 0.0 and self._is_broken(mode, i, after[i], self._moved):
                return i, after
        if level < self._event_level:
            step = self.tick_time * (TICKS >> level)
            for i in range(count):
                if before[count + i] < 0.0 < after[count + i] and _dips(before, after, i, count, step):
                    return _DOUBTFUL, after
        return _NONE, after

    def _settle(self) -> list[float]:
        """Leaves every mode whose guards do not hold at this very state; returns the guards' values."""
        for _ in range(_CHAIN):
            mode = self.mode
            values: list[float] = mode.guards.dot(self.state).tolist()
            for i in range(len(mode.exits)):
                if values[i] < 0.0 and self._is_broken(mode, i, values[i], self.state):
                    self._leave(i)
                    break
            else:
                return values
        return values

    def _is_broken(self, mode: Mode, guard: int, value: float, state: Array) -> bool:
        largest = float(np.abs(mode.guards[guard] * state).max())
        return value < -_ROUNDING * largest

    def _leave(self, guard: int) -> None:
        leaving = self.mode.exits[guard]
        self.events += 1
        before = self.stored() if leaving.resets else 0.0
        for state, value in [(i, float(row @ self.state)) for i, row in leaving.resets]:
            self.state[state] = value
        self._enter(leaving.part, leaving.mode)
        if leaving.resets:
            self.totals[leaving.work] += before - self.stored()

    def _enter(self, part: int, mode: str) -> None:
        key = self.mode.key
        self.mode = self._mode_of((*key[:part], mode, *key[part + 1 :]))

    def _mode_of(self, key: tuple[str, ...]) -> Mode:
        if key not in self._modes:
            self._modes[key] = compile_mode(self.scene, key)
        return self._modes[key]

    def _commit(self, mode: Mode, level: int) -> None:
        mode.flows[level](self.state, self._moved)
        self._book_and_swap(mode, level)

    def _book_and_swap(self, mode: Mode, level: int) -> None:
        """Books the work of a step from `state` and makes the spare state, already moved, the state."""
        state = self.state
        books = self._books
        mode.works[level](state, books.rows)
        books.contract(books.vector, books.totals_after)
        self._books, self._spare_books = self._spare_books, books
        self.state, self._moved = self._moved, state


_NONE: Final = -1  # every guard holds
_DOUBTFUL: Final = -2  # a guard may have dipped below zero inside the step


def _dips(before: list[float], after: list[float], guard: int, count: int, step: float) -> bool:
    """True when the tangents at both ends of the step meet below zero: a bound for a convex guard."""
    falling, rising = before[count + guard], after[count + guard]
    meeting = (after[guard] - before[guard] - rising * step) / (falling - rising)
    return before[guard] + falling * meeting < 0.0
