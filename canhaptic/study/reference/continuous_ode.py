"""Continuous environments that are not piecewise affine, by scipy's DOP853 with event location; needs extra `study`.

Independent of the stepper of `canhaptic.sim`: it shares the plant's equations of motion, not how they are solved.
"""

import math
from collections.abc import Callable
from typing import Any, Final

import numpy as np

from canhaptic.control.environments.environment import Environment
from canhaptic.errors import InputError
from canhaptic.sim.plant.assembly import Rows
from canhaptic.sim.plant.plant import Plant
from canhaptic.study.loop import Array

_TOLERANCE: Final = 1e-10
_AHEAD: Final = 1e-9  # [s] how far beyond a crossing the next zone of contact is looked at
_BEYOND: Final = 1e-15  # [m or rad]
_LONGEST_STEP: Final = 2e-3  # [s]; crossings are seen by signs at the ends of a step
_MOST_CROSSINGS: Final = 100_000


def integrate(environment: Environment, plant: Plant, times: Array) -> tuple[Array, Array]:
    """Returns (position, velocity) of a linear plant against the continuous environment, shapes (n,).

    Args:
        environment: One without memory: its torque follows from position and velocity.
        plant: Before `begin`; read and not moved.
        times: Ascending, from 0 [s].

    Raises:
        InputError: The plant is not linear, the environment remembers, the axis crosses surfaces without end, or scipy
            is not installed.
    """
    try:
        from scipy.integrate import solve_ivp
    except ImportError as error:
        raise InputError("this environment needs scipy; install it with: pip install 'canhaptic[study]'") from error
    if not plant.is_linear or environment.relaxes:
        raise InputError(
            "DOP853 takes a linear plant and an environment without memory; leave out effects that switch "
            "(friction, stops, grasp changes), or compare with a piecewise affine environment"
        )
    matrix, torque_index = _equations(plant)
    state, begin = plant.initial_state(), float(times[0])
    position, velocity = np.empty(len(times)), np.empty(len(times))
    for _ in range(_MOST_CROSSINGS):
        ahead = float(state[0] + _AHEAD * state[1])
        zone = environment.contact(ahead)
        events = [_crossing(surface, rising=ahead < surface) for surface in surfaces(environment)]
        touching = zone != 0 or not events  # without a surface it acts everywhere, also where its force is 0
        rate = _rate(environment, matrix, torque_index, touching=touching)
        solved: Any = solve_ivp(
            rate,
            (begin, times[-1]),
            state,
            "DOP853",
            dense_output=True,
            events=events or None,
            rtol=_TOLERANCE,
            atol=1e-13,
            max_step=_LONGEST_STEP,
        )
        chosen = (times >= begin) & (times <= solved.t[-1])
        if chosen.any():
            position[chosen], velocity[chosen] = solved.sol(times[chosen])[:2]
        if solved.t[-1] >= times[-1]:
            return position, velocity
        begin, state = float(solved.t[-1]), solved.y[:, -1]
        state[0] += math.copysign(_BEYOND, state[1])  # or a step that returns would find the crossing it begins at
    raise InputError(f"the continuous axis crossed a surface {_MOST_CROSSINGS} times by {begin:g} s; shorten the run")


def surfaces(environment: Environment) -> list[float]:
    """Returns the positions where contact begins or ends [m or rad]; where the torque may jump."""
    names = ("position",) if hasattr(environment, "side") else ("lower", "upper")
    return [float(getattr(environment, name)) for name in names if hasattr(environment, name)]


def _equations(plant: Plant) -> tuple[Array, int]:
    """Returns F of dz/dt = F z and the place of the motor torque in z."""
    rows = Rows(plant.scene)
    for part in plant.scene.parts:
        part.assemble(rows, part.modes[0])
    rows.close()
    return rows.rates, rows.index["torque"]


def _rate(
    environment: Environment, matrix: Array, torque_index: int, *, touching: bool
) -> Callable[[float, Array], Array]:
    def rate(_time: float, state: Array) -> Array:
        z = state.copy()
        z[torque_index] = 0.0
        if touching:
            inner = environment.true_state(float(z[0]), 0.0, 0.0)
            z[torque_index] = -environment.effort(inner) - environment.damping * z[1]
        result: Array = matrix @ z
        return result

    return rate


def _crossing(surface: float, *, rising: bool) -> Callable[[float, Array], float]:
    def crossing(_time: float, state: Array) -> float:
        return float(state[0] - surface)

    crossing.terminal, crossing.direction = True, 1.0 if rising else -1.0  # type: ignore[attr-defined]
    return crossing
