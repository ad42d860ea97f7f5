"""The continuous environment for many sampled loops, in arrays: `reference.continuous_reference` is for one.

Plant, hand and a continuous wall are linear in each of at most three modes: outside, in the lower wall, in the upper
wall. A step is exp(F h) of the mode, h short against the fastest motion of its scene. Where a step crosses a surface or
turns round, and only there, it is done again from its Taylor series in pieces that move one way, so that no graze is
missed: the end of a piece is bracketed and found by a few safeguarded Newton steps. Nothing is kept but the state.

The environments are those with a flow in closed form: `why_not_continuous` says why another has none.
"""

from collections.abc import Mapping
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from canhaptic.control.environments.damper_wall import DamperWall
from canhaptic.control.environments.free_space import FreeSpace
from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.control.environments.two_sided_wall import TwoSidedWall
from canhaptic.control.environments.viscous_medium import ViscousMedium
from canhaptic.sim.plant.propagator import flow_changes
from canhaptic.study.batch.batch_case import BatchCase
from canhaptic.study.figures import last_rows
from canhaptic.study.loop import Array
from canhaptic.study.reference.continuous_reference import readings_per_hold

CLOSED_FORM: Final = (SpringDamperWall, TwoSidedWall, DamperWall, ViscousMedium, FreeSpace)
"""Environments that are linear in each of their modes."""
_ANGLE: Final = 0.5
"""Largest sum of the rates of a scene times its step [rad]."""
_TERMS: Final = 14  # of the series: 0.5^14 / 14! is below 1e-15
_NEWTON: Final = 8
_CLOSE: Final = 1e-12
"""Part of a piece within which a Newton step ends the search: the step after it would be below rounding."""
_MOST_STEPS: Final = 4096
"""Steps per hold beyond which a scene has no reference."""
_MOST_PIECES: Final = 64
_OUTSIDE, _LOWER, _UPPER = 0, 1, 2
_Rows = NDArray[np.intp]


def why_not_continuous(case: BatchCase) -> str:
    """Returns "" where many continuous runs can be marched in arrays, else the reason."""
    if not isinstance(case.environment, CLOSED_FORM):
        return f"{type(case.environment).__name__} has no flow in closed form"
    return "" if f"rate.1.{case.size - 2}" in case.numbers else "the plant has effects that are not in arrays"


class _Linear(NamedTuple):
    """Many scenes: y' = F y in each mode, y = [states of the plant..., 1]."""

    rates: tuple[Array, ...]  # by mode, each of shape (n, k, k) [1/s]
    start: Array  # shape (k, n)
    lower: Array  # solid below, -inf for none, shape (n,) [m or rad]
    upper: Array  # solid above, inf for none
    stiffness: Array  # [N/m or N*m/rad]
    damping: Array  # [N*s/m or N*m*s/rad]
    everywhere: bool  # whether the damper acts in every mode

    def part(self, rows: _Rows) -> "_Linear":
        """Returns some of the scenes."""
        rates = tuple(rate[rows] for rate in self.rates)
        lower, upper, stiffness, damping = (v[rows] for v in (self.lower, self.upper, self.stiffness, self.damping))
        return _Linear(rates, self.start[:, rows], lower, upper, stiffness, damping, self.everywhere)


class ContinuousRuns:
    """The continuous runs of a part of a batch, a few cycles at a time.

    Args:
        case: With an environment of `CLOSED_FORM`.
        numbers: Of these scenes.
        count: Scenes.
        cycles: SYNCs of the whole run.
        with_force: Whether the force is asked for: read as often as the reference for one loop reads it.
    """

    def __init__(self, case: BatchCase, numbers: Mapping[str, Any], count: int, cycles: int, with_force: bool) -> None:
        self._count, self._with_force = count, with_force
        linear = _linear(case, numbers, count)
        period = np.broadcast_to(np.asarray(numbers["loop.sample_time"], dtype=float), (count,))
        readings = np.ones(count, dtype=np.int64)
        if with_force:
            for value in np.unique(period):
                readings[period == value] = readings_per_hold(round(float(value) * 1e9), cycles)
        steps = readings * 2 ** np.ceil(np.log2(np.maximum(1.0, period * _fastest(linear) / (_ANGLE * readings))))
        self._groups: list[tuple[_Rows, _Group]] = []
        for key in np.unique(np.stack([readings, steps]), axis=1).T:
            rows = np.flatnonzero((readings == key[0]) & (steps == key[1]))
            if key[1] <= _MOST_STEPS:
                group = _Group(linear.part(rows), period[rows], int(key[0]), int(key[1] // key[0]), cycles)
                self._groups.append((rows, group))

    def block(self, cycles: int) -> tuple[Array, Array]:
        """Returns the positions at the next SYNCs and the mean torques of the holds that end there, (cycles, n) each.

        NaN where a scene has no reference; the torques are empty where nobody asked for them.
        """
        position = np.full((cycles, self._count), np.nan)
        torque = np.full((cycles, self._count), np.nan) if self._with_force else np.empty((0, 0))
        for rows, group in self._groups:
            here, there = group.block(cycles, self._with_force)
            position[:, rows] = here
            if self._with_force:
                torque[:, rows] = there
        return position, torque

    def sums(self) -> dict[str, Array]:
        """Returns travel, travel in the last part, and variation of the force; NaN without a reference."""
        found = {name: np.full(self._count, np.nan) for name in ("continuous_travel", "continuous_rest", "continuous")}
        for rows, group in self._groups:
            found["continuous_travel"][rows] = group.highest - group.lowest
            found["continuous_rest"][rows] = group.last_highest - group.last_lowest
            found["continuous"][rows] = group.variation
        return found


def _linear(case: BatchCase, numbers: Mapping[str, Any], count: int) -> _Linear:
    def number(name: str, absent: float = 0.0) -> Array:
        return np.array(np.broadcast_to(numbers.get(name, absent), (count,)), dtype=float)

    states, environment = case.size - 2, case.environment
    free, start = np.zeros((count, states + 1, states + 1)), np.ones((states + 1, count))
    for row in range(states):
        start[row] = number(f"start.{row}")
        for column in range(states):
            free[:, row, column] = number(f"rate.{row}.{column}")
        free[:, row, states] = number(f"rate.{row}.{states + 1}")
    share = number(f"rate.1.{states}")  # 1 / mass
    stiffness, damping = number("environment.stiffness"), number("environment.damping")
    lower, upper = np.full(count, -np.inf), np.full(count, np.inf)
    everywhere = isinstance(environment, ViscousMedium)
    if everywhere:
        free[:, 1, 1] -= share * damping
    elif isinstance(environment, TwoSidedWall):
        lower, upper = number("environment.lower"), number("environment.upper")
    elif isinstance(environment, SpringDamperWall | DamperWall):
        surface = number("environment.position")
        lower, upper = (surface, upper) if environment.side == "below" else (lower, surface)
    rates = [free]
    for surface in (lower, upper):
        inside = free.copy()
        inside[:, 1, 0] -= share * stiffness
        inside[:, 1, 1] -= share * damping
        inside[:, 1, states] += share * stiffness * np.where(np.isfinite(surface), surface, 0.0)
        rates.append(inside)
    guarded = bool(np.isfinite(lower).any() or np.isfinite(upper).any())
    return _Linear(tuple(rates if guarded else rates[:1]), start, lower, upper, stiffness, damping, everywhere)


def _fastest(linear: _Linear) -> Array:
    """Returns a bound of the rates of each scene [rad/s]: those of an oscillator, and those of the hand's motion."""
    found = np.zeros(len(linear.lower))
    for rates in linear.rates:
        hand = np.abs(rates[:, 2:-1]).max(axis=(1, 2)) if rates.shape[1] > 3 else 0.0
        found = np.maximum(found, np.sqrt(np.abs(rates[:, 1, 0])) + np.abs(rates[:, 1, 1]) + hand)
    return found


class _Group:
    """Scenes with the same number of steps in a hold."""

    def __init__(self, linear: _Linear, period: Array, readings: int, steps: int, cycles: int) -> None:
        self._linear, self._readings, self._steps = linear, readings, steps
        self._step = period / (readings * steps)
        flows = [np.eye(rate.shape[1]) + flow_changes(rate * self._step[:, None, None]) for rate in linear.rates]
        self._flows = [np.ascontiguousarray(flow.transpose(1, 2, 0)) for flow in flows]
        states = len(linear.start) - 1
        self._terms = [[c for c in range(states + 1) if any(f[r, c].any() for f in self._flows)] for r in range(states)]
        position = linear.start[0]
        self._state, self._next = linear.start.copy(), linear.start.copy()
        self._mode = np.where(position < linear.lower, _LOWER, np.where(position > linear.upper, _UPPER, _OUTSIDE))
        self._flow = self._flows[0].copy()
        self._enter(np.arange(len(position)))
        self._product = np.empty(len(position))
        self._cycle = 0
        self._last_from = np.array([last_rows(cycles, value).start for value in period.tolist()])
        self.highest, self.lowest = position.copy(), position.copy()
        self.last_highest, self.last_lowest = np.full(len(position), -np.inf), np.full(len(position), np.inf)
        self._torque = self._force()
        self.variation = np.abs(self._torque)

    def block(self, cycles: int, with_force: bool) -> tuple[Array, Array]:
        """Returns positions and mean torques of the next SYNCs, shape (cycles, n) each."""
        positions, torques = (np.empty((cycles, len(self._mode))) for _ in range(2))
        with np.errstate(all="ignore"):
            for cycle in range(cycles):
                torques[cycle] = self._hold(with_force)
                positions[cycle] = position = self._state[0]
                self._cycle += 1
                np.maximum(self.highest, position, out=self.highest)
                np.minimum(self.lowest, position, out=self.lowest)
                late = self._cycle >= self._last_from
                np.maximum(self.last_highest, position, out=self.last_highest, where=late)
                np.minimum(self.last_lowest, position, out=self.last_lowest, where=late)
        return positions, torques

    def _hold(self, with_force: bool) -> Any:
        """Moves by one hold; returns the mean torque in it, by the trapezoids between readings."""
        mean = np.zeros(len(self._mode)) if with_force else 0.0
        for _ in range(self._readings):
            for _ in range(self._steps):
                self._move()
            if with_force:
                torque = self._force()
                mean += (0.5 / self._readings) * (torque + self._torque)
                self.variation += np.abs(torque - self._torque)
                self._torque = torque
        return mean

    def _force(self) -> Array:
        """Returns the torque of the environment [N or N*m]."""
        linear, (position, velocity) = self._linear, self._state[:2]
        if linear.everywhere:
            torque: Array = -linear.damping * velocity
            return torque
        below, above = position < linear.lower, position > linear.upper
        depth = np.where(below, position - linear.lower, np.where(above, position - linear.upper, 0.0))
        torque = -linear.stiffness * depth - np.where(below | above, linear.damping * velocity, 0.0)
        return torque

    def _move(self) -> None:
        """Moves by one step, and again in pieces where an event may lie in it."""
        state, moved, flow, product = self._state, self._next, self._flow, self._product
        for row, (first, *others) in enumerate(self._terms):
            total = np.multiply(flow[row, first], state[first], out=moved[row])
            for column in others:
                np.multiply(flow[row, column], state[column], out=product)
                total += product
        if len(self._flows) > 1:
            linear, mode, position = self._linear, self._mode, moved[0]
            crossed = (position < linear.lower) != (mode == _LOWER)
            crossed |= (position > linear.upper) != (mode == _UPPER)
            crossed |= np.multiply(state[1], moved[1], out=product) < 0.0
            rows = np.flatnonzero(crossed)
            if rows.size:
                self._in_pieces(rows[self._is_near(rows)])
        self._state, self._next = moved, state

    def _is_near(self, rows: _Rows) -> NDArray[np.bool_]:
        """Returns whether a surface lies within reach of a step; whoever turns round elsewhere meets no event."""
        position, reach = self._state[0, rows], np.abs(self._state[1, rows]) + np.abs(self._next[1, rows])
        reach *= self._step[rows]
        to_lower, to_upper = np.abs(position - self._linear.lower[rows]), np.abs(position - self._linear.upper[rows])
        near: NDArray[np.bool_] = np.minimum(to_lower, to_upper) <= reach
        return near

    def _enter(self, rows: _Rows) -> None:
        """Takes the flow of the mode of some scenes."""
        for mode, flow in enumerate(self._flows):
            some = rows[self._mode[rows] == mode]
            self._flow[:, :, some] = flow[:, :, some]

    def _in_pieces(self, rows: _Rows) -> None:
        """Moves some scenes by one step, piece by piece: each ends at a surface, at a turning point, or at the end."""
        state, left, began = self._state[:, rows], self._step[rows].copy(), rows
        for _ in range(_MOST_PIECES):
            if not rows.size:
                break
            series = self._series(rows, state)
            ends = _horner(series, left)
            turns = state[1] * ends[1] < 0.0
            until = left
            if turns.any():
                until = np.where(turns, _root(series[1:, 1], series[0, 1], left, ends[1]), left)
            state, at, crossed = self._piece(rows, series, until, np.where(turns, state[1], state[1] + ends[1]))
            state[1, turns & ~crossed] = 0.0
            left = left - at
            goes_on = (turns | crossed) & (left > 0.0)
            self._next[:, rows[~goes_on]] = state[:, ~goes_on]
            rows, state, left = rows[goes_on], state[:, goes_on], left[goes_on]
        self._next[:, rows] = state
        self._enter(began)

    def _piece(self, rows: _Rows, series: Array, until: Array, way: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Returns (state at the end of a piece that moves one way, its duration, whether it ended at a surface)."""
        lower, upper, mode = self._linear.lower[rows], self._linear.upper[rows], self._mode[rows]
        up = way > 0.0
        ahead = np.where(up, np.where(mode == _LOWER, lower, upper), np.where(mode == _UPPER, upper, lower))
        no_surface = np.where(up, mode == _UPPER, mode == _LOWER)
        end = _horner(series[:, :1], until)[0] - ahead
        crossed = np.where(up, end > 0.0, end < 0.0) & ~no_surface
        at = until.copy()
        if crossed.any():
            some = np.flatnonzero(crossed)
            at[some] = _root(series[1:, 0, some], series[0, 0, some] - ahead[some], until[some], end[some])
            closed = lower[some] == upper[some]
            after = np.where(mode[some] == _OUTSIDE, np.where(up[some], _UPPER, _LOWER), _OUTSIDE)
            self._mode[rows[some]] = np.where(closed & (mode[some] != _OUTSIDE), _LOWER + _UPPER - mode[some], after)
        moved = _horner(series, at)
        moved[0, crossed] = ahead[crossed]
        return moved, at, crossed

    def _series(self, rows: _Rows, state: Array) -> Array:
        """Returns the Taylor coefficients of the states, shape (terms, k, len(rows))."""
        mode = self._mode[rows]
        rates = np.empty((len(rows), *self._linear.rates[0].shape[1:]))
        for of_mode, rate in enumerate(self._linear.rates):
            some = mode == of_mode
            rates[some] = rate[rows[some]]
        term = np.ascontiguousarray(state.T)
        terms = [term]
        for order in range(1, _TERMS):  # a sum along the last axis: the same whatever scenes are beside
            term = (rates * term[:, None, :]).sum(axis=2) / order
            terms.append(term)
        return np.ascontiguousarray(np.array(terms).transpose(0, 2, 1))


def _horner(series: Array, at: Array) -> Array:
    """Returns polynomials at a time of each scene, shape (k, n), from coefficients of shape (terms, k, n)."""
    total: Array = series[-1].copy()
    for coefficients in series[-2::-1]:
        total *= at
        total += coefficients
    return total


def _root(rising: Array, constant: Array, until: Array, end: Array) -> Array:
    """Returns where polynomials that move one way pass through zero before `until`, shape (n,).

    Args:
        rising: Coefficients of t, t^2, ..., shape (terms - 1, n).
        constant: Coefficient of 1; 0 or of the sign opposite to `end`.
        until: Where the bracket ends.
        end: The polynomial there.
    """
    low, high = np.zeros_like(until), until.copy()
    at = until * constant / (constant - end)
    slopes, found = rising * np.arange(1, len(rising) + 1)[:, None], np.zeros(len(at), dtype=bool)
    for _ in range(_NEWTON):
        value = _horner(rising[:, None], at)[0] * at + constant
        beyond = (value > 0.0) == (end > 0.0)
        low, high = np.where(beyond, low, at), np.where(beyond, at, high)
        newton = at - value / _horner(slopes[:, None], at)[0]
        better = np.where((newton >= low) & (newton <= high), newton, 0.5 * (low + high))
        near = np.abs(better - at) <= _CLOSE * until
        at = np.where(found, at, better)  # what is found stays, so that no scene depends on those beside it
        found |= near
        if found.all():
            break
    return at
