"""Six kinds of user as force laws, and the mass that they move, exact for a force constant in a substep.

Independent of `canhaptic.sim`: closed form of m v' + b v = F for constant F. Every wall lies below 0, so outward is
positive. Who moves the mass limits the force to what is declared, so that a certificate is on trial and not the user.
"""

import math
import random
from collections.abc import Callable
from typing import Any, Final

Force = Callable[[float, float, float, float], float]
"""(time, position, velocity, torque) -> force of the hand, in SI."""
Maker = Callable[[random.Random], Force]
HAND_FORCE = 20.0  # [N]
_SMALL: Final = 1e-3
"""Part of a time constant in a step below which the closed form would cancel; there both are right to 1e-12."""


class Mass:
    """m v' + b v = F."""

    def __init__(self, mass: float, damping: float, step: float, position: float) -> None:
        self.position, self.velocity = position, 0.0
        fade = damping / mass * step
        drift = 1.0 - fade * (1.0 - fade * (1.0 - fade / 4.0) / 3.0) / 2.0
        creep = 0.5 - fade * (1.0 - fade * (1.0 - fade / 5.0) / 4.0) / 6.0
        self._keep = math.exp(-fade)
        self._drift = step * drift if fade < _SMALL else -math.expm1(-fade) * mass / damping
        self._creep = step * step / mass * creep if fade < _SMALL else (step - self._drift) / damping
        self._gain = self._drift / mass

    def advance(self, force: float) -> float:
        """Moves through one substep; returns the displacement."""
        travel = self._drift * self.velocity + self._creep * force
        self.velocity = self._keep * self.velocity + self._gain * force
        self.position += travel
        return travel


def sinusoid(_rng: random.Random) -> Force:
    w = 2.0 * math.pi
    return lambda t, q, v, _f: 300.0 * (0.03 * math.cos(w * t) - q) - 3.0 * (0.03 * w * math.sin(w * t) + v)


def tremor(_rng: random.Random) -> Force:
    return lambda t, _q, v, _f: -4.0 + 3.0 * math.sin(16.0 * math.pi * t) - 2.0 * v


def tapping(_rng: random.Random) -> Force:
    return lambda t, q, v, _f: 600.0 * (0.01 * math.sin(6.0 * math.pi * t) - q) - 5.0 * v


def sudden_pull(_rng: random.Random) -> Force:
    return lambda t, q, v, _f: -8.0 - 5.0 * v if t % 1.0 < 0.6 and q > -0.5 else HAND_FORCE


def adversary(rng: random.Random, out: float = 0.002, kinds: int = 4) -> Force:
    """Lets the wall load, pushes in within a hold where that is cheap, and pulls along the torque where it is not.

    It turns round `out` of the wall [m].
    """
    threshold, push, kind = rng.uniform(0.02, 3.0), rng.uniform(1.0, 15.0), rng.randrange(kinds)
    memory: dict[str, Any] = {"peak": 0.0, "tick": 0, "period": 4, "part": 0.3}

    def impulses() -> float:
        memory["tick"] += 1
        if memory["tick"] % memory["period"] == 0:
            memory["period"], memory["part"] = rng.randrange(1, 13), 0.5 * rng.random()
        return -4.0 * push if memory["tick"] % memory["period"] < memory["part"] * memory["period"] else HAND_FORCE

    def force(_t: float, q: float, v: float, torque: float) -> float:
        if q > out:
            return -0.3 * push - 3.0 * v
        if q < -0.3:
            return HAND_FORCE
        if kind == 0:
            return HAND_FORCE if torque > threshold else -push
        if kind == 1:
            return HAND_FORCE if torque > 0.0 and v > -0.01 else -push
        if kind == 2:
            memory["peak"] = max(0.999 * memory["peak"], torque)
            return HAND_FORCE if torque >= 0.5 * memory["peak"] else -push
        return impulses()

    return force


def telegraph(rng: random.Random) -> Force:
    """Pulls and pushes at random, each for a while."""
    state = [1.0]

    def force(_t: float, q: float, v: float, _f: float) -> float:
        if rng.random() < 0.03:
            state[0] = rng.choice((-1.0, 1.0)) * rng.random()
        if q > 0.005:
            return -5.0 - 3.0 * v
        return HAND_FORCE if q < -0.3 else state[0] * HAND_FORCE

    return force


USERS: dict[str, Maker] = {
    "sinusoid": sinusoid,
    "tremor": tremor,
    "tapping": tapping,
    "sudden_pull": sudden_pull,
    "adversary": adversary,
    "telegraph": telegraph,
}
