"""The easy, the friction and the stiff scene: as plants of ours, as textbook equations, and an event-located solver."""

import math
from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from canhaptic.sim.plant import AccuracyParameters
from canhaptic.sim.plant.plant import Plant, PlantParameters
from canhaptic.sim.plant.user import SinusoidMotion, UserParameters
from tests.plant.read_effect import read_effect

Array = NDArray[np.float64]
PERIOD_NS: Final = 1_000_000
PERIOD: Final = PERIOD_NS * 1e-9
MASS, DAMPING = 0.25, 0.1
KINETIC, STATIC = 0.3, 0.5
STOP, STOP_STIFFNESS, STOP_DAMPING = 0.002, 1e6, 100.0
WINDING: Final = 5e-5  # time constant of the current loop [s]

Rates = Callable[[float, Any, float], Sequence[float]]
Value = Callable[[float, Any, float], float]


class Way(NamedTuple):
    """Leaves a mode where `value` falls through zero."""

    value: Value
    mode: str
    reset: Callable[[Any], Sequence[float]] = lambda state: state


class Scene(NamedTuple):
    """One scene in both forms; `torques` are those of its holds."""

    name: str
    user: UserParameters
    effects: tuple[dict[str, Any], ...]
    modes: dict[str, tuple[Rates, tuple[Way, ...]]]
    smooth: Rates  # the same as one right-hand side for fixed-step methods, which do not locate events
    start: tuple[float, ...]
    first: str
    torques: Array

    def plant(self, event_bits: int = 24) -> Plant:
        """Returns the plant before its start."""
        accuracy = AccuracyParameters(event_bits=event_bits)
        parameters = PlantParameters(mass=MASS, damping=DAMPING)
        effects = [read_effect(effect) for effect in self.effects]
        return Plant(parameters, self.user, effects, PERIOD_NS, 1, accuracy)


def _hand(user: UserParameters) -> Callable[[float, float, float], float]:
    assert user.motion is not None
    omega, amplitude = 2.0 * math.pi * user.motion.frequency, user.motion.amplitude
    stiffness, damping = user.stiffness, user.damping

    def force(time: float, position: float, velocity: float) -> float:
        target, speed = amplitude * math.sin(omega * time), amplitude * omega * math.cos(omega * time)
        return stiffness * (target - position) + damping * (speed - velocity)

    return force


def _torques(count: int, size: float) -> Array:
    return np.random.default_rng(7).uniform(-size, size, count)


def easy(count: int) -> Scene:
    """Returns servo and hand: four states, linear."""
    user = UserParameters(stiffness=300, damping=3, motion=SinusoidMotion(amplitude=0.03, frequency=1.0))
    hand = _hand(user)

    def rates(t: float, y: Any, u: float) -> list[float]:
        return [y[1], (u + hand(t, y[0], y[1]) - DAMPING * y[1]) / MASS]

    return Scene("easy", user, (), {"free": (rates, ())}, rates, (0.0, 0.0), "free", _torques(count, 2.0))


def friction(count: int) -> Scene:
    """Returns the easy scene with dry friction."""
    user = UserParameters(stiffness=300, damping=3, motion=SinusoidMotion(amplitude=0.03, frequency=1.0))
    hand = _hand(user)

    def others(t: float, y: Any, u: float) -> float:
        return u + hand(t, y[0], y[1]) - DAMPING * float(y[1])

    def sliding(sign: float) -> Rates:
        return lambda t, y, u: [y[1], (others(t, y, u) - sign * KINETIC) / MASS]

    def stop(y: Any) -> list[float]:
        return [y[0], 0.0]

    def smooth(t: float, y: Any, u: float) -> list[float]:
        return [y[1], (others(t, y, u) - KINETIC * math.tanh(y[1] / 1e-4)) / MASS]

    modes: dict[str, tuple[Rates, tuple[Way, ...]]] = {
        "stuck": (
            lambda t, y, u: [0.0, 0.0],
            (
                Way(lambda t, y, u: STATIC - others(t, y, u), "forward"),
                Way(lambda t, y, u: STATIC + others(t, y, u), "backward"),
            ),
        ),
        "forward": (sliding(1.0), (Way(lambda t, y, u: y[1], "stuck", stop),)),
        "backward": (sliding(-1.0), (Way(lambda t, y, u: -y[1], "stuck", stop),)),
    }
    effect = {"type": "coulomb_friction", "kinetic": KINETIC, "static": STATIC}
    return Scene("friction", user, (effect,), modes, smooth, (0.0, 0.0), "stuck", _torques(count, 1.0))


def stiff(count: int) -> Scene:
    """Returns a grip and a stop of 1e6 N/m with a current loop of 50 us, at 1 ms."""
    user = UserParameters(stiffness=1e6, damping=200, motion=SinusoidMotion(amplitude=0.003, frequency=8.0))
    hand = _hand(user)

    def push(y: Any) -> float:
        return STOP_STIFFNESS * float(y[2]) + STOP_DAMPING * float(y[1])

    def common(t: float, y: Any, u: float, against: float) -> list[float]:
        force = y[3] + hand(t, y[0], y[1]) - DAMPING * y[1] - against
        return [y[1], force / MASS, 0.0, (u - y[3]) / WINDING]

    def apart(t: float, y: Any, u: float) -> list[float]:
        rates = common(t, y, u, 0.0)
        rates[2] = -STOP_STIFFNESS / STOP_DAMPING * y[2]
        return rates

    def touching(t: float, y: Any, u: float) -> list[float]:
        rates = common(t, y, u, push(y))
        rates[2] = y[1]
        return rates

    def smooth(t: float, y: Any, u: float) -> list[float]:
        depth = y[0] - STOP
        against = max(0.0, STOP_STIFFNESS * depth + STOP_DAMPING * y[1]) if depth > 0.0 else 0.0
        return common(t, y, u, against)

    modes: dict[str, tuple[Rates, tuple[Way, ...]]] = {
        "apart": (
            apart,
            (Way(lambda t, y, u: 1e3 * (y[2] - y[0] + STOP), "touching", lambda y: [y[0], y[1], y[0] - STOP, y[3]]),),
        ),
        "touching": (touching, (Way(lambda t, y, u: push(y), "apart"),)),
    }
    effects = (
        {"type": "hard_stop", "position": STOP, "stiffness": STOP_STIFFNESS, "damping": STOP_DAMPING},
        {"type": "current_loop", "time_constant": WINDING},
    )
    torques = np.where(np.arange(count) % 2, 3.0, -1.0)
    return Scene("stiff", user, effects, modes, smooth, (0.0, 0.0, 0.0, 0.0), "apart", torques)


def located(scene: Scene, method: str, rtol: float, atol: float, max_step: float = math.inf) -> Array:
    """Returns the position at every SYNC by scipy with located events, shape (len(torques),)."""
    mode, state, positions = scene.first, np.array(scene.start), []
    for k, torque in enumerate(scene.torques.tolist()):
        now, end = k * PERIOD, (k + 1) * PERIOD
        while now < end:
            rates, ways = scene.modes[mode]
            jumped = next((way for way in ways if way.value(now, state, torque) < -1e-9), None)
            if jumped is not None:
                mode, state = jumped.mode, np.array(jumped.reset(state))
                continue
            result = solve_ivp(
                rates, (now, end), state, method, events=[_event(way) for way in ways] or None, rtol=rtol, atol=atol,
                args=(torque,), max_step=max_step,
            )  # fmt: skip
            state, now = result.y[:, -1], float(result.t[-1])
            if result.status == 1:
                way = ways[next(i for i, times in enumerate(result.t_events) if len(times))]
                mode, state = way.mode, np.array(way.reset(state))
        positions.append(state[0])
    return np.array(positions)


def _event(way: Way) -> Any:
    def event(t: float, y: Any, torque: float) -> float:
        return way.value(t, y, torque)

    event.terminal, event.direction = True, -1.0  # type: ignore[attr-defined]
    return event


def reference(scene: Scene) -> Array:
    """Returns positions by event-located DOP853 at 1e-12, independent of the plant."""
    return located(scene, "DOP853", 1e-12, 1e-15, PERIOD / 4)


def advance(plant: Plant, torques: Sequence[float]) -> Array:
    """Returns positions of a plant moved from Python, SYNC by SYNC."""
    plant.begin(0)
    positions, move, now = [], plant.advance_to, 0
    for torque in torques:
        now += PERIOD_NS
        move(now, torque)
        positions.append(plant.position)
    return np.array(positions)


def semi_implicit_euler(scene: Scene, substeps: int) -> Array:
    """Returns positions by semi-implicit Euler: first all rates, then the position with the new velocity."""
    step, state, positions = PERIOD / substeps, list(scene.start), []
    for k, torque in enumerate(scene.torques.tolist()):
        for i in range(substeps):
            rates = scene.smooth(k * PERIOD + i * step, state, torque)
            state = [value + step * rate for value, rate in zip(state, rates, strict=True)]
            state[0] += step * step * rates[1]
        positions.append(state[0])
    return np.array(positions)


def runge_kutta(scene: Scene, substeps: int) -> Array:
    """Returns positions by the classical Runge-Kutta method of order 4."""
    step, state, positions, f = PERIOD / substeps, np.array(scene.start), [], scene.smooth
    for k, torque in enumerate(scene.torques.tolist()):
        for i in range(substeps):
            t = k * PERIOD + i * step
            a = np.array(f(t, state, torque))
            b = np.array(f(t + step / 2, state + step / 2 * a, torque))
            c = np.array(f(t + step / 2, state + step / 2 * b, torque))
            d = np.array(f(t + step, state + step * c, torque))
            state = state + step / 6 * (a + 2 * b + 2 * c + d)
        positions.append(state[0])
    return np.array(positions)
