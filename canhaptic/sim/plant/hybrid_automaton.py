"""The hybrid automaton of one scene: its state, mode and energies, moved by the functions of `stepper.py`.

Modes are compiled when they are first entered; a scene that never slides backward does not pay for that mode.

`GuardHorizon` gives a number of whole sample times in which no torque within a limit can reach a guard of the mode.
With z = [x, u, 1] at the start of a hold, w = z without the torque, Phi the flow over T with the torque taken out and b
the change of x over T per unit torque, the starts of the holds are

    w(k) = Phi^k w(0) + sum over j < k of Phi^(k-1-j) b u(j),   |u| <= U.

So a guard c is at least c Phi^k w(0) - U (sum over j < k of |c Phi^j b| + |c_u|) at both ends of a hold, with c_u its
factor of the torque. Inside the hold it is at most slack * |y| below the lower end, with y the scaled rates of the
state (`assembly.py`), and |y| has a bound of the same form. If the guard remains positive, the hold has no event and
may be taken in one step. The bound is strict up to rounding, for which a part of the largest value is subtracted.

`Timetable` changes modes and states at scheduled times instead of by a guard, between two steps.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from operator import add
from typing import Any, Final

import numpy as np

from canhaptic.errors import EventLimitError
from canhaptic.sim.plant import stepper
from canhaptic.sim.plant.assembly import Exit, Mode, PlantModel, compile_mode
from canhaptic.sim.plant.propagator import TICKS, Array, SampleClock
from canhaptic.sim.plant.stepper import NONE, ModeTables, StepperSettings

HOLDS: Final = 64
"""Number of sample times of the look-ahead."""
_ROUNDING: Final = 1e-12  # of the largest row times the state


class GuardHorizon:
    """Bounds on the guards of one mode over the next sample times; see the module.

    Args:
        guards: Rows of the guards, shape (c, n).
        scaled: Rows of the scaled rates, shape (m, n).
        slack: Largest distance of a guard from its chord over T, per unit length of the scaled rates, shape (c,).
        flow: Flow over T, in which the torque, the last component but one, is constant, shape (n, n).
    """

    def __init__(self, guards: Array, scaled: Array, slack: Array, flow: Array) -> None:
        free, push = flow.copy(), flow[:, -2].copy()
        free[-2], free[:, -2], push[-2] = 0.0, 0.0, 0.0
        rows, count = np.concatenate([guards, scaled]), len(guards)
        at_once, rows = np.abs(rows[:, -2]), rows.copy()
        rows[:, -2] = 0.0
        powers, reach = [rows], [at_once]
        for _ in range(HOLDS):
            reach.append(reach[-1] + np.abs(powers[-1] @ push))
            powers.append(powers[-1] @ free)
        all_powers, all_reach = np.array(powers), np.array(reach)
        norms = np.linalg.norm(all_powers[:, :count], axis=2).max(axis=0, initial=0.0)
        self._count, self._slack, self._rounding = count, slack, _ROUNDING * norms
        self._values = all_powers[:, :count].reshape(-1, rows.shape[1])
        self._rates = all_powers[:-1, count:].reshape(-1, rows.shape[1])
        self._reach = all_reach[1:, :count]
        self._speed = np.linalg.norm(all_reach[:-1, count:], axis=1)

    def holds(self, state: Array, largest: float) -> int:
        """Number of sample times after `state`, at most `HOLDS`, without an event at any torque within +-`largest`."""
        values = self._values.dot(state).reshape(HOLDS + 1, self._count)
        rates = self._rates.dot(state).reshape(HOLDS, -1)
        pace = np.sqrt((rates * rates).sum(axis=1)) + largest * self._speed
        lost = largest * self._reach + pace[:, None] * self._slack + self._rounding * float(np.linalg.norm(state))
        sure = (np.minimum(values[:-1], values[1:]) > lost).all(axis=1)
        return HOLDS if sure.all() else int(sure.argmin())


_PRODUCTS_EACH: Final = 512
"""Matrix products allowed per allowed event in one sample time: four times those of the most expensive event."""
ACCOUNTS: Final = ("motor", "user", "dissipated")


class HybridAutomaton:
    """State, mode and energies of one scene.

    Attributes:
        state: z, shape (n,); the torque is the last but one component.
        tick_time: T / 2^24 [s].
        settings: Settings of the stepper.
        modes: Compiled modes, by number.
        targets: Number of the mode that each guard of each mode leads to; NONE while that mode is not compiled.
    """

    def __init__(self, scene: PlantModel, max_events: int, event_bits: int) -> None:
        self.scene = scene
        self.tick_time = scene.sample_time / TICKS
        self.settings = StepperSettings(max_events, event_bits, self.tick_time, _PRODUCTS_EACH * max_events)
        self.modes: list[Mode] = []
        self._stored: list[Callable[[Array], float]] = []  # by mode
        self._index: dict[tuple[str, ...], int] = {}
        self._tables = ModeTables(*([] for _ in ModeTables._fields))
        self.targets: list[list[int]] = self._tables.targets
        self._part_index = {part.name: i for i, part in enumerate(scene.parts)}
        booked = list(scene.works.values())
        self._sums_of = np.array([[of == account for of in booked] for account in ACCOUNTS], dtype=float)
        self._pairs = _pairs(booked)
        names = scene.names
        sines = [name for name in names if name.endswith("_sine")]
        self._oscillators = [(names.index(name), names.index(name[:-4] + "cosine")) for name in sines]
        self._books: list[Any] = list(stepper.two_buffers(len(names), len(booked)))
        self._counts = [0] * stepper.COUNTS
        self._values: Any = [None, None]
        self._first = self._mode_of(scene.first_key())
        self._whole = self._whole_of(self.first_mode)
        self._horizons: dict[int, tuple[GuardHorizon, Any]] = {}  # by mode, with its `_whole`
        self.reset()

    def reset(self) -> None:
        """Return to the initial state and mode, with no energy booked."""
        self.state = self.scene.initial_state()
        self._moved = self.state.copy()
        self.totals.fill(0.0)
        self._sums, self._carries = self.totals.tolist(), self.totals.tolist()
        counts = self._counts
        counts[stepper.MODE], counts[stepper.MISSING], counts[stepper.EVENTS] = self._first, NONE, 0
        self.allow_events(0, TICKS)
        self.run(0)  # a body that starts beyond a stop starts with the stop's energy
        self.totals.fill(0.0)
        counts[stepper.EVENTS] = counts[stepper.PRODUCTS] = self._periods = 0

    @property
    def mode(self) -> Mode:
        """The mode in which the plant is now."""
        return self.modes[self._counts[stepper.MODE]]

    @property
    def first_mode(self) -> Mode:
        """Initial mode of the scene."""
        return self.modes[self._first]

    @property
    def events(self) -> int:
        """Mode changes since the start."""
        return self._counts[stepper.EVENTS]

    @property
    def products(self) -> int:
        """Number of flow steps tried since the start, a machine-independent cost."""
        return self._counts[stepper.PRODUCTS] + self._periods

    def save(self) -> tuple[Array, Array, int, int]:
        """Return a copy of everything that a hold changes."""
        return self.state.copy(), self.totals.copy(), self._counts[stepper.MODE], self._counts[stepper.EVENTS]

    def restore(self, saved: tuple[Array, Array, int, int]) -> None:
        """Return to a saved copy."""
        self.state[:], self.totals[:], self._counts[stepper.MODE], self._counts[stepper.EVENTS] = saved

    @property
    def totals(self) -> Array:
        """Work booked since the last `tidy`, in the order of `scene.works` [J]; a view."""
        totals: Array = self._books[0].totals
        return totals

    def works(self) -> list[float]:
        """Return the work booked since the start, in the order of `scene.works` [J]."""
        totals = self._books[0].totals.tolist()  # floats: an operation on so short an array costs ten on them
        sums, carries = self._sums, self._carries
        return list(map(add, sums, map(add, carries, totals)))

    def accounts(self) -> list[float]:
        """Work of the motor, of the user, and dissipation, since the start [J]."""
        works = self.works()
        if self._pairs is None:
            summed: list[float] = self._sums_of.dot(works).tolist()
            return summed
        works.append(0.0)
        a, b, c, d, e, f = self._pairs
        return [works[a] + works[b], works[c] + works[d], works[e] + works[f]]

    def tidy(self) -> None:
        """Bound the growth of rounding errors over a run; called at fixed times, never by a reader.

        It adds the totals to compensated sums and restores the hand's oscillators to unit amplitude.
        """
        before, totals = np.array(self._sums), self.totals
        sums = before + totals
        part = sums - before
        carries = np.array(self._carries) + ((before - (sums - part)) + (totals - part))
        self._sums, self._carries = sums.tolist(), carries.tolist()
        self.totals.fill(0.0)
        state = self.state
        for sine, cosine in self._oscillators:
            norm = math.hypot(state[sine], state[cosine])
            state[sine] /= norm
            state[cosine] /= norm
        self.state = state

    def stored(self) -> float:
        """Return the kinetic and elastic energy [J]."""
        stored: Callable[[Array], float] = self._stored[self._counts[stepper.MODE]]
        return stored(self.state)

    def value(self, place: int) -> float:
        """Return one component of the state."""
        return self.state.item(place)

    def set_states(self, values: Mapping[str, float]) -> None:
        """Set states by their names, between two steps."""
        state = self.state
        for name, value in values.items():
            state[self.scene.names.index(name)] = value
        self.state = state

    def set_part_mode(self, part: str, mode: str) -> None:
        """Switch one part to another mode, between two steps."""
        self._counts[stepper.MODE] = self.number_with(self._counts[stepper.MODE], part, mode)

    @staticmethod
    def _whole_of(mode: Mode) -> Any:
        """Matrix product that gives the state after T and the rows of the works."""
        return np.concatenate([matrix_of(mode.flows[0]), matrix_of(mode.works[0])]).dot

    def holds_without_events(self, largest: float) -> int:
        """Number of sample times from now on, at most `HOLDS`, without an event at any torque within +-`largest`.

        They may be taken by `period`, until anything else moves the plant.
        """
        place = self._counts[stepper.MODE]
        if place not in self._horizons:
            mode = self.modes[place]
            count = len(mode.exits)
            bounds = mode.guards[:count], mode.guards[2 * count :], mode.bounds.slack[0]
            self._horizons[place] = GuardHorizon(*bounds, matrix_of(mode.flows[0])), self._whole_of(mode)
        horizon, self._whole = self._horizons[place]
        return horizon.holds(self.state, largest)

    def period(self, torque: float) -> float:
        """Take one whole sample time, known to be free of events, in one step; return the position after it.

        The result is that of `run_free`; motion and work take one product, because in most scenes this is all that the
        plant computes at a SYNC.
        """
        state, books = self.state, self._books
        moved, both, contract, vector, totals_after, item = books[0].flat
        if state is moved:
            state = state.copy()
        state[-2] = torque
        self._whole(state, both)
        contract(vector, totals_after)
        books.reverse()
        self.state, self._moved = moved, state
        self._periods += 1
        position: float = item(0)
        return position

    def mover(self) -> Callable[[float], float]:
        """Return the function that takes one whole sample time under a torque, as `period`."""
        return self.period

    def hold(self, ticks: int, torque: float) -> None:
        """Move by `ticks` under a torque, ignoring guards."""
        self.state[-2] = torque
        self.run_free(ticks)

    def run_free(self, ticks: int) -> None:
        """Move by `ticks` ignoring guards."""
        self.state, self._moved = stepper.run_free(
            self._tables, self.state, self._moved, self._books, self._counts, ticks
        )

    def allow_events(self, begin: int, end: int) -> None:
        """Allow `max_events` per sample time that begins in [begin, end) [ticks]; without any, keep the limit."""
        begun = -(-end // TICKS) - -(-begin // TICKS)
        if begun:
            self._most = self._counts[stepper.EVENTS] + self.settings.max_events * begun

    def run(self, ticks: int) -> int:
        """Move by `ticks` under constant inputs, through every event on the way; return the ticks left, always 0.

        Raises:
            EventLimitError: There are more events than `allow_events` allowed.
        """
        self._counts[stepper.LIMIT] = self._most + 1
        self.check_limit(self._run_on(ticks))
        return 0

    def run_to_event(self, ticks: int) -> int:
        """Move by `ticks` at most, through the first event; return the ticks left."""
        self._counts[stepper.LIMIT] = self._counts[stepper.EVENTS] + 1
        return self._run_on(ticks)

    def check_limit(self, left: int) -> None:
        """Refuse to continue a hold that has had too many events.

        Raises:
            EventLimitError: Ticks are `left`, and there have been more events than allowed.
        """
        if left and self.events > self._most:
            raise self._limit_error(0)

    def _limit_error(self, products: int) -> EventLimitError:
        state = self.described(self._counts[stepper.MODE], self.state.tolist())
        return EventLimitError(self.settings.max_events, state, products=products)

    def described(self, mode: int, state: Sequence[float]) -> str:
        """Text with the parts and their modes, and with the states.

        Args:
            mode: Number of the mode.
            state: z, shape (n,).
        """
        modes = [f"{part.name} {of_part}" for part, of_part in zip(self.scene.parts, self.modes[mode].key, strict=True)
                 if len(part.modes) > 1]  # fmt: skip
        states = [f"{name} {value:.6g}" for name, value in zip(self.scene.names[:-1], state, strict=False)]
        return f"{', '.join(modes)}; {', '.join(states)}"

    def _run_on(self, ticks: int) -> int:
        counts = self._counts
        while True:
            self.state, self._moved, ticks = stepper.run(
                self._tables, self.settings, self.state, self._moved, self._books, counts, self._values, ticks
            )
            if counts[stepper.MISSING] == NONE:
                if ticks and counts[stepper.EVENTS] < counts[stepper.LIMIT]:  # the products are used up
                    raise self._limit_error(self.settings.max_products)
                return ticks
            missing, counts[stepper.MISSING] = counts[stepper.MISSING], NONE
            self.connect(counts[stepper.MODE], missing)  # so that the stepper can pass the guard at which it waits

    def connect(self, mode: int, guard: int) -> None:
        """Compile the mode that a guard of a mode leads to, and enter it in the tables."""
        through = self.modes[mode].exits[guard]
        self.targets[mode][guard] = self.number_with(mode, self.scene.parts[through.part].name, through.mode)

    def number_with(self, mode: int, part: str, part_mode: str) -> int:
        """Return the number of the mode with one part in another mode, compiled if need be."""
        key, place = self.modes[mode].key, self._part_index[part]
        return self._mode_of((*key[:place], part_mode, *key[place + 1 :]))

    def _mode_of(self, key: tuple[str, ...]) -> int:
        """Return the number of a mode, compiled and appended to the tables if need be."""
        if key in self._index:
            return self._index[key]
        self._index[key] = len(self.modes)
        mode = compile_mode(self.scene, key)
        self.modes.append(mode)
        self._stored.append(_stored_by(mode.storage))
        resets = [reset_matrix(leaving, len(self.scene.names)).dot for leaving in mode.exits]
        bounds = mode.bounds
        row = ModeTables(
            mode.flows, mode.works, mode.guards, len(mode.exits),
            bounds.slack.tolist(), bounds.chord.tolist(), bounds.bend.tolist(), bounds.spread.tolist(),
            [NONE] * len(mode.exits), [bool(leaving.resets) for leaving in mode.exits], resets,
            [leaving.work for leaving in mode.exits],
            mode.storage,
        )  # fmt: skip
        for table, entry in zip(self._tables, row, strict=True):
            table.append(entry)
        return self._index[key]


class AutomatonClock(SampleClock):
    """Base of plants whose state an automaton holds; the clock counts ticks."""

    _machine: HybridAutomaton

    @property
    def state(self) -> Array:
        """A copy of the state of the automaton, in the order of its names."""
        return self._machine.state.copy()

    @property
    def events(self) -> int:
        """Number of mode changes (sticking, contact, ...) since the start."""
        return self._machine.events

    def whole_flow(self) -> Array:
        """Return the flow of the first mode over one sample time, shape (n, n)."""
        return matrix_of(self._machine.first_mode.flows[0]).copy()


def _stored_by(storage: Array) -> Callable[[Array], float]:
    """Function of a state that gives its kinetic and elastic energy [J].

    The energy of a single body depends on one state, its speed; the general product gives the same bits at twenty times
    the cost.

    Args:
        storage: P with z'Pz the stored energy, shape (n, n).
    """
    rows, columns = storage.nonzero()
    if len(rows) == 1 and rows[0] == columns[0]:
        place, factor = int(rows[0]), float(storage[rows[0], rows[0]])

        def of_one(state: Array) -> float:
            value = state.item(place)
            return factor * value * value

        return of_one
    product = storage.dot
    return lambda state: float(product(state).dot(state))


def matrix_of(product: Any) -> Array:
    """Return the matrix of a bound product, such as `matrix.dot`."""
    matrix: Array = product.__self__
    return matrix


def reset_matrix(leaving: Exit, size: int) -> Array:
    """Matrix of the jump at a guard of a mode."""
    matrix = np.eye(size)
    for state, row in leaving.resets:
        matrix[state] = row
    return matrix


def _pairs(accounts: Sequence[str]) -> tuple[int, ...] | None:
    """Return the indices of two works for each account; missing works get the index behind the last work, a zero.

    None if an account has more than two works: only a sum of two does not depend on the order.
    """
    zero = len(accounts)
    places = [[place for place, a in enumerate(accounts) if a == account] for account in ACCOUNTS]
    if any(len(of) > 2 for of in places):
        return None
    return tuple(place for of in places for place in (*of, zero, zero)[:2])


_Entry = tuple[float, Callable[[], None]]


class Timetable:
    """Runs a scene's solver and makes the scheduled changes in between.

    Args:
        machine: Automaton whose parts change mode.
        run: Function that moves the machine by some ticks without scheduled changes.

    Attributes:
        tick: Present tick; set before a run by a caller that advanced the machine without a change.
    """

    def __init__(self, machine: HybridAutomaton, run: Callable[[int], object]) -> None:
        self._run, scene = run, machine.scene
        entries: list[_Entry] = [(time, partial(machine.set_part_mode, *change)) for time, *change in scene.schedule]
        entries += [(time, partial(machine.set_states, values)) for time, values in scene.settings]
        ticks = [(round(time / machine.tick_time), change) for time, change in entries]
        self._entries = sorted(ticks, key=lambda entry: entry[0])
        self.reset()

    def reset(self) -> None:
        """Return to tick 0."""
        self.tick = self._done = 0

    def holds_from(self, tick: int) -> int:
        """Return the number of whole sample times after a tick without a change; at most `HOLDS`."""
        if self._done == len(self._entries):
            return HOLDS
        return min(HOLDS, max(0, self._entries[self._done][0] - tick) // TICKS)

    def run(self, ticks: int) -> None:
        """Move by `ticks`, with the changes on the way."""
        end = self.tick + ticks
        while self._done < len(self._entries) and self._entries[self._done][0] < end:
            tick, change = self._entries[self._done]
            if tick > self.tick:
                self._run(tick - self.tick)
                self.tick = tick
            change()
            self._done += 1
        self._run(end - self.tick)
        self.tick = end
