"""Scenes and the event-located reference that the tests of the plant share."""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

from canhaptic.sim.plant import AccuracyParameters
from canhaptic.sim.plant.plant import Plant, PlantParameters
from canhaptic.sim.plant.user import SinusoidMotion, UserParameters
from tests.plant.read_effect import read_effect

MS = 1_000_000
MASS, DAMPING = 0.25, 0.1
USER_S = UserParameters(stiffness=300, damping=3, motion=SinusoidMotion(amplitude=0.03, frequency=1.0))


def make_plant(
    *effects: dict[str, Any],
    user: UserParameters | None = USER_S,
    period: int = MS,
    accuracy: dict[str, int] | None = None,
    seed: int = 1,
    **values: float,
) -> Plant:
    parameters = PlantParameters(**{"mass": MASS, "damping": DAMPING, **values})
    return Plant(
        parameters, user, [read_effect(e) for e in effects], period, seed, AccuracyParameters(**(accuracy or {}))
    )


def run(plant: Plant, torques: Sequence[float]) -> np.ndarray:
    """Position at every SYNC, shape (len(torques) + 1,)."""
    plant.begin(0)
    positions = [plant.position]
    for k, torque in enumerate(torques):
        plant.advance_to((k + 1) * plant.sample_time_ns, torque)
        positions.append(plant.position)
    return np.array(positions)


def residual(plant: Plant) -> float:
    energy = plant.energy()
    return abs(energy.motor + energy.user - energy.dissipated - energy.stored)


def largest_flow(plant: Plant) -> float:
    return max(1e-6, *map(abs, plant.energy()))


def hand(time: float, position: float, velocity: float, user: UserParameters = USER_S) -> float:
    """Force of the hand, as in a textbook."""
    motion = user.motion
    target, speed = user.rest, 0.0
    if motion:
        omega = 2 * math.pi * motion.frequency
        target += motion.offset + motion.amplitude * math.sin(omega * time + motion.phase)
        speed = omega * motion.amplitude * math.cos(omega * time + motion.phase)
    return user.stiffness * (target - position) + user.damping * (speed - velocity) + user.push


State = Any
Rates = Callable[[float, State, float], Sequence[float]]
Leave = Callable[[float, State, float], float]


class Way(NamedTuple):
    """Leaves a mode where `value` falls through zero."""

    value: Leave
    mode: str
    reset: Callable[[State], State] = lambda state: state


class ReferenceMode(NamedTuple):
    rates: Rates
    ways: Sequence[Way] = ()


def reference(
    modes: dict[str, ReferenceMode], mode: str, state: Sequence[float], torques: Sequence[float], period: float
) -> np.ndarray:
    """State at every SYNC by event-located DOP853, shape (len(torques) + 1, n)."""
    state, rows = np.array(state, dtype=float), [np.array(state, dtype=float)]  # type: ignore[assignment]
    for k, torque in enumerate(torques):
        now, end = k * period, (k + 1) * period
        while now < end:
            current = modes[mode]
            jumped = next((w for w in current.ways if w.value(now, state, torque) < -1e-9), None)
            if jumped:
                mode, state = jumped.mode, jumped.reset(state)
                continue
            events = []
            for way in current.ways:

                def event(t: float, y: State, torque: float, value: Leave = way.value) -> float:
                    return value(t, y, torque)

                event.terminal, event.direction = True, -1.0  # type: ignore[attr-defined]
                events.append(event)
            step = (end - now) / 4
            result = solve_ivp(
                current.rates, (now, end), state, "DOP853", events=events or None, rtol=1e-12, atol=1e-15,
                args=(torque,), max_step=step,
            )  # fmt: skip
            state, now = result.y[:, -1], result.t[-1]
            if result.status == 1:
                which = next(i for i, times in enumerate(result.t_events) if len(times))
                mode, state = current.ways[which].mode, current.ways[which].reset(state)
        rows.append(state.copy())  # type: ignore[attr-defined]
    return np.array(rows)
