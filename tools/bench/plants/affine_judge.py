"""An independent judge of piecewise-affine plants: the textbook equations, its own exponential, every event located.

Its equations are those of `canhaptic.lab.judge`, read off as matrices by evaluating them; it shares no row, no
propagator, no bound and no stepper with the plant. Guards are looked at on a grid of 256 instants of every stretch of
time, between them by a cubic, and a crossing is located by Brent's method on the exponential. Works are integrated by
Gauss' rule.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, NamedTuple

import numpy as np
from scipy.optimize import brentq

from canhaptic.lab.judge.reference_model import Model, Modes, Transition
from canhaptic.lab.judge.solvers import through
from canhaptic.sim.plant.propagator import Array
from tools.bench.plants.random_scenes import RandomScene

_DOUBLINGS: Final = 8
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(4)
_CHAIN: Final = 16
_LOCATED: Final = 1e-15
"""Part of the sample time to which a crossing is located."""


class JudgedMotion(NamedTuple):
    """What happened."""

    rows: Array  # position, velocity, work of the motor, work of the user at the end of every hold
    events: int
    grazing: float  # least |minimum| of a guard that turned back without a crossing, over its scale; inf without one


@dataclass(frozen=True)
class _Mode:
    """dz/dt = rates z with z = [states, sine, cosine, torque, 1]; guards are rows of z."""

    rates: Array
    guards: Array
    rounding: Array
    ways: tuple[Transition, ...]

    @cached_property
    def slopes(self) -> Array:
        """Rates of the guards as rows."""
        return self.guards @ self.rates


class AffineJudge:
    """One scene, moved hold by hold.

    Args:
        scene: Without effects that are not affine.
    """

    def __init__(self, scene: RandomScene) -> None:
        self._scene = scene
        self._model = Model(scene.plant, scene.user, scene.effects)
        self._size = self._model.dynamic_size
        motion = scene.user.sinusoid if scene.user else None
        self._omega = 2.0 * math.pi * motion.frequency if motion else 1.0
        self._phase = motion.phase if motion else 0.0
        self._modes: dict[Modes, _Mode] = {}

    def run(self) -> JudgedMotion:
        """Returns the motion under the torques of the scene."""
        self._works, self._events, self._grazing = np.zeros(2), 0, math.inf
        period, modes, rows = self._scene.period_ns * 1e-9, self._model.first, []
        state = np.array([*self._model.start[: self._size], 0.0, 0.0, 0.0, 1.0])
        state[-4:-2] = math.sin(self._phase), math.cos(self._phase)
        state, modes = self._settled(state, modes)
        self._events = 0  # where it starts is no event
        for torque in self._scene.torques:
            state[-2], left = torque, period
            while left > 0.0:
                state, modes = self._settled(state, modes)
                state, passed, fired = self._stretch(state, modes, left)
                left -= passed
                if fired is None:
                    break
                state, modes = self._through(fired, state, modes)
            rows.append((state[0], state[1], *self._works))
        return JudgedMotion(np.array(rows), self._events, self._grazing)

    def _through(self, way: Transition, state: Array, modes: Modes) -> tuple[Array, Modes]:
        self._events += 1
        after, modes = through(way, [*state[: self._size], 0.0, 0.0], modes)
        return np.concatenate([after[: self._size], state[self._size :]]), modes

    def _settled(self, state: Array, modes: Modes) -> tuple[Array, Modes]:
        for _ in range(_CHAIN):
            mode = self._mode(modes)
            broken = np.flatnonzero(mode.guards @ state < -mode.rounding)
            if not len(broken):
                break
            state, modes = self._through(mode.ways[broken[0]], state, modes)
        return state, modes

    def _stretch(self, state: Array, modes: Modes, left: float) -> tuple[Array, float, Transition | None]:
        """Returns the state after a stretch of one mode, its length, and the way out that ended it."""
        mode, step = self._mode(modes), left / (1 << _DOUBLINGS)
        grid = self._grid(mode, state, step)
        values = grid @ mode.guards.T + mode.rounding
        found = self._first_crossing(mode, grid, values, step)
        if found is None:
            self._integrate(mode, grid[:-1], step, modes)
            return grid[-1], left, None
        index, offset, guard = found
        self._integrate(mode, grid[:index], step, modes)
        self._integrate(mode, grid[index : index + 1], offset, modes)
        return exponential(mode.rates * offset) @ grid[index], index * step + offset, mode.ways[guard]

    def _grid(self, mode: _Mode, state: Array, step: float) -> Array:
        flow, grid = exponential(mode.rates * step), state[None]
        for _ in range(_DOUBLINGS):
            grid = np.concatenate([grid, grid @ flow.T])
            flow = flow @ flow
        return np.concatenate([grid, (grid[:1] @ flow.T)])

    def _first_crossing(self, mode: _Mode, grid: Array, values: Array, step: float) -> tuple[int, float, int] | None:
        """Returns the first crossing as (place in the grid, time after it, guard)."""
        slopes = grid @ mode.slopes.T
        suspects = (values[1:] < 0.0) | ((slopes[:-1] < 0.0) & (slopes[1:] > 0.0))
        for index in np.flatnonzero(suspects.any(axis=1)):
            crossings = [
                (offset, guard)
                for guard in np.flatnonzero(suspects[index])
                if (offset := self._crossing(mode, grid[index], int(guard), step)) is not None
            ]
            if crossings:
                offset, guard = min(crossings)
                return int(index), offset, int(guard)
        return None

    def _crossing(self, mode: _Mode, state: Array, guard: int, step: float) -> float | None:
        """Returns when a guard falls through zero inside one step of the grid; None where it does not."""
        row, slope, rounding = mode.guards[guard], mode.slopes[guard], float(mode.rounding[guard])

        def value(offset: float) -> float:
            return float(row @ (exponential(mode.rates * offset) @ state)) + rounding

        def rate(offset: float) -> float:
            return float(slope @ (exponential(mode.rates * offset) @ state))

        end = step
        if value(end) >= 0.0:
            if not rate(0.0) < 0.0 < rate(step):
                return None  # on the grid it was rounding
            end = float(brentq(rate, 0.0, step, xtol=1e-9 * step))
            if value(end) >= 0.0:
                scale = float(np.abs(row * state).max()) or 1.0
                self._grazing = min(self._grazing, value(end) / scale)
                return None
        return float(brentq(value, 0.0, end, xtol=_LOCATED * step, rtol=1e-15)) if value(0.0) > 0.0 else 0.0

    def _integrate(self, mode: _Mode, begins: Array, step: float, modes: Modes) -> None:
        """Adds the works of steps that begin at these states."""
        if not len(begins) or step <= 0.0:
            return
        names, user = self._model.names, self._scene.user
        for node, weight in zip(_NODES, _WEIGHTS, strict=True):
            states = begins @ exponential(mode.rates * (0.5 * (1.0 + node) * step)).T
            motor = states[:, names.index("motor_torque")] if "motor_torque" in names else states[:, -2]
            powers = [motor * states[:, 1], np.zeros(len(states))]
            if user:
                loaded = "load_velocity" in names
                velocity = states[:, names.index("load_velocity")] if loaded else states[:, 1]
                place = states[:, 0] - (states[:, names.index("twist")] if loaded else 0.0)
                swing, omega = (user.sinusoid.amplitude if user.sinusoid else 0.0), self._omega
                force = user.stiffness * (user.rest + swing * states[:, -4] - place)
                force += user.damping * (swing * omega * states[:, -3] - velocity)
                powers[1] = force * velocity
            self._works += 0.5 * step * weight * np.array([power.sum() for power in powers])

    def _mode(self, modes: Modes) -> _Mode:
        if modes not in self._modes:
            self._modes[modes] = self._read(modes)
        return self._modes[modes]

    def _read(self, modes: Modes) -> _Mode:
        """Returns a mode as matrices: what is affine is known from its values at 0, at units, at three times."""
        ways, size = tuple(self._model.ways(modes)), self._size

        def values(time: float, state: Array, torque: float) -> Array:
            full = [*state, 0.0, 0.0]
            rates = self._model.rates(time, full, torque, modes)[:size]
            return np.array([*rates, *(way.value(time, full, torque) for way in ways)])

        zero = np.zeros(size)
        quarter = 0.5 * math.pi / self._omega
        base = -self._phase / self._omega  # the sine is 0 there, the cosine 1
        at = [values(base + k * quarter, zero, 0.0) for k in range(3)]
        constant = 0.5 * (at[0] + at[2])
        columns = [values(base, unit, 0.0) - at[0] for unit in np.eye(size)]
        columns += [at[1] - constant, at[0] - constant, values(base, zero, 1.0) - at[0], constant]
        table = np.array(columns).T
        rates = np.zeros((size + 4, size + 4))
        rates[:size] = table[:size]
        rates[size, size + 1], rates[size + 1, size] = self._omega, -self._omega
        return _Mode(rates, table[size:], np.array([way.rounding for way in ways]), ways)


def exponential(matrix: Array) -> Array:
    """Returns exp(matrix) by its Taylor series, scaled and squared; scipy's is 20 times slower on so small a matrix."""
    norm = float(np.abs(matrix).sum(axis=0).max())
    squarings = max(0, math.ceil(math.log2(norm)) + 2) if norm > 0.0 else 0
    scaled = matrix * 0.5**squarings
    term = total = scaled
    for order in range(2, 14):  # 4^-14 / 14! is below 1e-19
        term = term @ scaled / order
        total = total + term
    for _ in range(squarings):
        total = 2.0 * total + total @ total
    return total + np.eye(len(matrix))


def judged(scene: RandomScene) -> tuple[str, dict[str, Any]]:
    """Returns how the plant differs from the judge, or nothing, and the largest errors relative to the largest values.

    Every bounce amplifies what a tick leaves of an event: an error counts where it is larger than what ticks of
    different length make of the run by themselves.
    """
    plant, moved = scene.move()
    motion = AffineJudge(scene).run()
    size = np.abs(motion.rows).max(axis=0) + 1e-9
    off = np.abs(moved[:, :4] - motion.rows).max(axis=0)
    errors = dict(zip(("position", "velocity", "motor", "user"), (off / size).tolist(), strict=True))
    found = {"events": plant.events, "judged": motion.events, "grazing": motion.grazing, **errors}
    if plant.events != motion.events:
        return f"{plant.events} events, {motion.events} by the judge", found
    if (off > 1e-6 * size).any():
        off -= 64.0 * np.abs(scene.move(8)[1] - scene.move(32)[1])[:, :4].max(axis=0)
    worst = float((off / size).max())
    return (f"{worst:.1e} of the largest value off" if worst > 1e-4 else ""), found
