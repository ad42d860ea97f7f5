"""Solvers of the reference plant: adaptive ones of scipy with event location, and fixed steps as in most simulators.

The adaptive solvers (extra `study`) locate every change of mode. DOP853 at 1e-12 is the reference of the accuracy
study, LSODA at 1e-9 an independent check.

With fixed steps a mode changes only at the end of a step. Each method has its own order while no mode switches, and
order 1 where one does.
"""

import math
from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import pairwise
from typing import Any, Final, Protocol

import numpy as np

from canhaptic.errors import InputError
from canhaptic.extras import install_hint
from canhaptic.lab.judge.reference_model import Floats, Model, Modes, State, Transition
from canhaptic.sim.plant.direct_rig import Motion
from canhaptic.sim.plant.propagator import Array

_LONGEST_STEP: Final = 2.5e-4
"""Longest step of a model whose modes may change [s]: guards are checked at the ends of steps."""
_MOST_CHANGES: Final = 10_000
"""Largest number of mode changes in one hold; more are an error."""
_Stop = Callable[[], bool] | None


class NotSolvedError(InputError):
    """Raised if a solver fails, or needs more evaluations than it was allowed."""


class SwitchedModel(Protocol):
    """Ordinary differential equations with modes; `torque` is a number, or a sequence with one for each motor.

    Attributes:
        start: State at time 0.
        first: Modes at time 0.
        breaks: Times at which the equations change [s].
        switches: Whether any element can leave its mode.
    """

    start: Floats
    first: Modes
    breaks: list[float]
    switches: bool

    def rates(self, time: float, state: Any, torque: Any, modes: Modes) -> Floats:
        """Return the rate of every state."""

    def ways(self, modes: Modes) -> list[Transition]:
        """Every transition out of these modes; valid until the next call."""


class MovedModel(SwitchedModel, Protocol):
    """Equations of a plant, or of the motors of a group.

    Attributes:
        evaluations: Number of evaluations so far.
    """

    evaluations: int

    def motion(self, states: Sequence[Any]) -> Motion:
        """Return a motion from the states at the ends of the holds."""


def reference(
    model: MovedModel, torques: Sequence[Any], sample_time_ns: int, stop: _Stop = None, most: float = math.inf
) -> Motion:
    """Return the motion by DOP853 with relative tolerance 1e-12, over fewer holds if these take `most` evaluations.

    Arguments as for `located`.
    """
    return located(model, torques, sample_time_ns, "DOP853", 1e-12, 1e-15, stop, most)


def located(
    model: MovedModel,
    torques: Sequence[Any],
    sample_time_ns: int,
    method: str,
    rtol: float,
    atol: float,
    stop: _Stop = None,
    most: float = math.inf,
) -> Motion:
    """Return the motion under the torques, by a solver of `scipy.integrate.solve_ivp`.

    Args:
        model: The plant.
        torques: Torque of each hold [N or N*m]; where the plant has several motors, one for each.
        sample_time_ns: Duration of a hold [ns].
        method: Name of the solver.
        rtol: Relative tolerance.
        atol: Absolute tolerance, of each state in its own unit.
        stop: Polled regularly; true aborts.
        most: Evaluations after which no further hold is begun; at least one hold is solved.

    Raises:
        NotSolvedError: The solver fails.
        InputError: scipy is missing, or it was stopped.
    """
    period = sample_time_ns * 1e-9
    longest = min(0.25 * period, _LONGEST_STEP) if model.switches else math.inf
    run, states = _Solved(model, method=method, rtol=rtol, atol=atol, max_step=longest), []
    for k, torque in enumerate(torques):
        if k and model.evaluations > most:
            break
        if k % 16 == 0:
            _require_running(stop)
        begin, end = k * period, (k + 1) * period
        for start, finish in pairwise([begin, *(t for t in sorted(model.breaks) if begin < t < end), end]):
            run.advance(torque, start, finish)
        states.append(list(run.state))
    return model.motion(states)


def states_at(
    model: SwitchedModel, times: Sequence[float], rtol: float, stop: _Stop = None, longest: float = _LONGEST_STEP
) -> list[Floats]:
    """Return the states at the given times, without a motor torque, by DOP853 with dense output.

    Args:
        model: The plant and the forces on it.
        times: Times, ascending from 0 [s].
        rtol: Relative tolerance; the absolute one is a thousandth of it, in the unit of each state.
        stop: Polled regularly; true aborts.
        longest: Longest step [s]; guards are checked, and modes may change, at the ends of steps.

    Raises:
        InputError: scipy is missing, the solver fails, or it was stopped.
    """
    longest = longest if model.switches else math.inf
    run = _Solved(model, method="DOP853", rtol=rtol, atol=1e-3 * rtol, max_step=longest, dense_output=True)
    found = [list(model.start)]

    def read(result: Any) -> None:
        _require_running(stop)
        due = times[len(found) : bisect_right(times, result.t[-1])]
        if len(due):
            found.extend(result.sol(due).T.tolist())

    # so many [s] are solved at once that memory stays small and a request to stop is noticed
    cuts = [*np.arange(0.0, times[-1], 0.02), *(t for t in model.breaks if t < times[-1]), times[-1]]
    for start, finish in pairwise(sorted(cuts)):
        if finish > start:
            run.advance(0.0, start, finish, read)
    return found


class _Solved:
    """Model that a solver of `scipy.integrate.solve_ivp` advances; raises InputError where scipy is missing."""

    def __init__(self, model: SwitchedModel, **how: Any) -> None:
        try:
            from scipy.integrate import solve_ivp
        except ImportError as error:
            wanted = f"the reference of an accuracy study needs scipy; install it with: {install_hint('study')}"
            raise InputError(wanted) from error
        self._model, self._solve = model, partial(solve_ivp, **how)
        self.state, self._modes = list(model.start), model.first

    def advance(self, torque: Any, now: float, end: float, read: Callable[[Any], None] = lambda _result: None) -> None:
        """Advance from `now` to `end` under a constant torque; `read` receives the solution of every piece."""
        model, state, modes = self._model, self.state, self._modes
        for _ in range(_MOST_CHANGES):
            state, modes = settled(model, now, state, torque, modes)
            ways = model.ways(modes)
            events = [_event(way) for way in ways] or None
            result = self._solve(model.rates, (now, end), state, events=events, args=(torque, modes))
            if result.status < 0:
                failed = f"the reference failed at {now:g} s ({result.message})"
                raise NotSolvedError(f"{failed}; shorten the study or the scene")
            read(result)
            state, now = result.y[:, -1].tolist(), float(result.t[-1])
            if result.status == 0:
                self.state, self._modes = state, modes
                return
            fired = next(way for way, times in zip(ways, result.t_events, strict=True) if len(times))
            state, modes = through(fired, state, modes)
        often = f"the reference changed its mode {_MOST_CHANGES} times in one hold at {now:g} s"
        raise NotSolvedError(f"{often}; damp the contact")


def _require_running(stop: _Stop) -> None:
    """Raise InputError where a stop was requested."""
    if stop is not None and stop():
        raise InputError("stopped before the reference was computed; nothing can be compared without it")


def settled(
    model: SwitchedModel, time: float, state: list[float], torque: Any, modes: Modes
) -> tuple[list[float], Modes]:
    """Return state and modes after all transitions whose value is below zero."""
    for _ in range(16):  # without time between them
        broken = next((way for way in model.ways(modes) if way.value(time, state, torque) < -way.rounding), None)
        if broken is None:
            break
        state, modes = through(broken, state, modes)
    return state, modes


def through(way: Transition, state: Sequence[float], modes: Modes) -> tuple[Floats, Modes]:
    """Make a transition: return state and modes after it."""
    after = [float(value) for value in state]
    if way.reset is not None:
        way.reset(after)
    return after, (*modes[: way.element], way.mode, *modes[way.element + 1 :])


def _event(way: Transition) -> Any:
    """Return an event function slightly beyond the guard's zero, so that a guard that stays at zero is not an event."""

    def event(time: float, state: State, torque: Any, _modes: Modes) -> float:
        return way.value(time, state, torque) + way.rounding

    event.terminal, event.direction = True, -1.0  # type: ignore[attr-defined]
    return event


_Step = Callable[[Model, float, Floats, float, Modes, float], Floats]


def fixed_step(
    model: MovedModel, torques: Sequence[Any], sample_time_ns: int, step: Callable[..., Floats], substeps: int
) -> Motion:
    """Return the motion under the torques; not finite after a divergence.

    Args:
        model: The plant.
        torques: Torque of each hold [N or N*m]; where the plant has several motors, one for each.
        sample_time_ns: Duration of a hold [ns].
        step: Step function, one of `METHODS`.
        substeps: Steps in a hold.
    """
    period = sample_time_ns * 1e-9
    length = period / substeps
    state, modes, states = list(model.start), model.first, list[Floats]()
    for k, torque in enumerate(torques):
        for i in range(substeps):
            now = k * period + i * length
            if model.switches:
                state, modes = settled(model, now, state, torque, modes)
            try:
                state = step(model, now, state, torque, modes, length)
            except (OverflowError, np.linalg.LinAlgError):
                state = [float("inf")] * len(state)
            if not abs(state[0]) < 1e6:  # [m or rad]
                return model.motion([*states, *[[float("inf")] * len(state)] * (len(torques) - k)])
        if model.switches:
            state, modes = settled(model, (k + 1) * period, state, torque, modes)
        states.append(list(state))
    return model.motion(states)


def _semi_implicit_euler(model: Model, now: float, state: Floats, torque: float, modes: Modes, step: float) -> Floats:
    """Return the state after a step of order 1: positions move with the new velocities."""
    after = [value + step * rate for value, rate in zip(state, model.rates(now, state, torque, modes), strict=True)]
    for index, terms in model.kinematics.items():
        after[index] = state[index] + step * sum(factor * after[velocity] for velocity, factor in terms)
    return after


def runge_kutta_4(model: SwitchedModel, now: float, state: Floats, torque: Any, modes: Modes, step: float) -> Floats:
    """Return the state after a step of the classical method of order 4."""
    half = 0.5 * step
    a = model.rates(now, state, torque, modes)
    b = model.rates(now + half, [y + half * r for y, r in zip(state, a, strict=True)], torque, modes)
    c = model.rates(now + half, [y + half * r for y, r in zip(state, b, strict=True)], torque, modes)
    d = model.rates(now + step, [y + step * r for y, r in zip(state, c, strict=True)], torque, modes)
    slopes = zip(state, a, b, c, d, strict=True)
    return [y + step / 6.0 * (ka + 2.0 * kb + 2.0 * kc + kd) for y, ka, kb, kc, kd in slopes]


class _ImplicitMidpoint:
    """Implicit midpoint rule, order 2, solved by Newton's method with a reused Jacobian."""

    def __init__(self) -> None:
        self._solvers: dict[tuple[Modes, float], Array] = {}

    def __call__(self, model: Model, now: float, state: Floats, torque: float, modes: Modes, step: float) -> Floats:
        """Return the state after a step."""
        middle_time, size = now + 0.5 * step, model.dynamic_size
        begin = np.array(state)
        middle, rates = begin.copy(), np.array(model.rates(middle_time, state, torque, modes))
        key = (modes, step)
        for correction in range(8):
            residual = (begin + 0.5 * step * rates - middle)[:size]
            change = np.linalg.solve(self._matrix(model, middle_time, middle, torque, key), residual)
            middle[:size] += change
            rates = np.array(model.rates(middle_time, middle.tolist(), torque, modes))
            if np.abs(change).max() <= 1e-13 * max(1e-6, float(np.abs(middle[:size]).max())):
                break
            if correction == 2:
                self._solvers.pop(key, None)  # the Jacobian is out of date
        result: Floats = (begin + step * rates).tolist()
        return result

    def _matrix(self, model: Model, time: float, state: Array, torque: float, key: tuple[Modes, float]) -> Array:
        """Return I - h/2 df/dy of the states without the works, by finite differences."""
        if key not in self._solvers:
            modes, step = key
            size = model.dynamic_size
            base = np.array(model.rates(time, state.tolist(), torque, modes))
            jacobian = np.empty((size, size))
            for column in range(size):
                moved = state.copy()
                width = 1e-7 * max(1e-3, abs(float(state[column])))
                moved[column] += width
                jacobian[:, column] = (np.array(model.rates(time, moved.tolist(), torque, modes)) - base)[:size] / width
            self._solvers[key] = np.eye(size) - 0.5 * step * jacobian
        return self._solvers[key]


METHODS: Final[Mapping[str, tuple[int, Callable[[], _Step]]]] = {
    "semi-implicit Euler": (1, lambda: _semi_implicit_euler),
    "implicit midpoint": (2, _ImplicitMidpoint),
    "RK4": (4, lambda: runge_kutta_4),
}
"""Name -> (order while nothing switches, maker of its step)."""
