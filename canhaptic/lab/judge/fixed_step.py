"""The reference plant by fixed-step methods, as in most simulators: a mode changes at the end of a step only.

So each is of its own order while nothing switches, and of order 1 where something does.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import numpy as np

from canhaptic.lab.judge.event_location import SwitchedModel, settled
from canhaptic.lab.judge.reference_elements import Floats
from canhaptic.lab.judge.reference_model import Model, Modes
from canhaptic.lab.judge.reference_motion import motion_of
from canhaptic.sim.plant.plant_motion import Motion
from canhaptic.sim.plant.propagator import Array

_Step = Callable[[Model, float, Floats, float, Modes, float], Floats]
_LARGEST: Final = 1e6  # [m or rad] beyond which a motion counts as diverged
_CLOSE: Final = 1e-13  # relative change at which the implicit step is solved
_MOST_CORRECTIONS: Final = 8


def fixed_step(model: Model, torques: Sequence[float], sample_time_ns: int, step: _Step, substeps: int) -> Motion:
    """Return the motion under the torques; arguments as for `fixed_step_states`."""
    return motion_of(fixed_step_states(model, torques, sample_time_ns, step, substeps))


def fixed_step_states(
    model: SwitchedModel, torques: Sequence[Any], sample_time_ns: int, step: Callable[..., Floats], substeps: int
) -> list[Floats]:
    """Return every state at the end of each hold; not finite from where it diverges.

    Args:
        model: The plant.
        torques: Torque of each hold [N or N*m]; where the plant has several motors, one for each.
        sample_time_ns: Duration of a hold [ns].
        step: One of `METHODS`.
        substeps: Steps in a hold.
    """
    period = sample_time_ns * 1e-9
    length = period / substeps
    state, modes, states = list(model.start), model.first, []
    for k, torque in enumerate(torques):
        for i in range(substeps):
            now = k * period + i * length
            if model.switches:
                state, modes = settled(model, now, state, torque, modes)
            try:
                state = step(model, now, state, torque, modes, length)
            except (OverflowError, np.linalg.LinAlgError):
                state = [float("inf")] * len(state)
            if not abs(state[0]) < _LARGEST:
                states += [[float("inf")] * len(state)] * (len(torques) - k)
                return states
        if model.switches:
            state, modes = settled(model, (k + 1) * period, state, torque, modes)
        states.append(list(state))
    return states


def _semi_implicit_euler(model: Model, now: float, state: Floats, torque: float, modes: Modes, step: float) -> Floats:
    """Return the state after a step of order 1: positions move with the new velocities."""
    rates = model.rates(now, state, torque, modes)
    after = [value + step * rate for value, rate in zip(state, rates, strict=True)]
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
    """Steps of the implicit midpoint rule, order 2, solved by Newton's method with a kept Jacobian."""

    def __init__(self) -> None:
        self._solvers: dict[tuple[Modes, float], Array] = {}

    def __call__(self, model: Model, now: float, state: Floats, torque: float, modes: Modes, step: float) -> Floats:
        """Return the state after a step."""
        middle_time, size = now + 0.5 * step, model.dynamic_size
        begin = np.array(state)
        middle, rates = begin.copy(), np.array(model.rates(middle_time, state, torque, modes))
        key = (modes, step)
        for correction in range(_MOST_CORRECTIONS):
            residual = (begin + 0.5 * step * rates - middle)[:size]
            change = np.linalg.solve(self._matrix(model, middle_time, middle, torque, key), residual)
            middle[:size] += change
            rates = np.array(model.rates(middle_time, middle.tolist(), torque, modes))
            if np.abs(change).max() <= _CLOSE * max(1e-6, float(np.abs(middle[:size]).max())):
                break
            if correction == 2:
                self._solvers.pop(key, None)  # the Jacobian is out of date
        result: Floats = (begin + step * rates).tolist()
        return result

    def _matrix(self, model: Model, time: float, state: Array, torque: float, key: tuple[Modes, float]) -> Array:
        """Return I - h/2 df/dy of the states without the works, by differences."""
        if key not in self._solvers:
            modes, step = key
            size = model.dynamic_size
            base = np.array(model.rates(time, state.tolist(), torque, modes))
            jacobian = np.empty((size, size))
            for column in range(size):
                moved = state.copy()
                width = 1e-7 * max(1e-3, abs(float(state[column])))
                moved[column] += width
                changed = np.array(model.rates(time, moved.tolist(), torque, modes))
                jacobian[:, column] = (changed - base)[:size] / width
            self._solvers[key] = np.eye(size) - 0.5 * step * jacobian
        return self._solvers[key]


METHODS: Final[Mapping[str, tuple[int, Callable[[], _Step]]]] = {
    "semi-implicit Euler": (1, lambda: _semi_implicit_euler),
    "implicit midpoint": (2, _ImplicitMidpoint),
    "RK4": (4, lambda: runge_kutta_4),
}
"""Name -> (order while nothing switches, maker of its step)."""
