"""Six kinds of user as force laws on a moving mass, for what no scene can express: a hand that answers the torque.

The plant is the closed form of m v' + b v = F for a force constant within a quarter of a hold. The hand force never
exceeds the declared one in either direction, so that a certificate is on trial and not the user.
"""

import math
import random
from collections.abc import Callable
from typing import Final

from canhaptic.signals import PlantEnergy

Law = Callable[[float, float, float, float], float]
"""(time [s], position, velocity, torque held) -> hand force [N or N*m]."""

SUBSTEPS: Final = 4
_DEEP, _OUT = -0.3, 0.005  # [m] where a user turns round in every case


class HandPlant:
    """A moving mass under torque and hand, with the interface of `canhaptic.sim.plant.plant.Plant` that a loop uses.

    Args:
        law: Of the hand.
        sample_time_ns: T [ns].
        hand_force: Largest hand force [N or N*m].
        mass: [kg or kg*m^2].
        damping: Of the device [N*s/m or N*m*s/rad].
        initial_position: [m or rad].

    Attributes:
        position: True position [m or rad].
        velocity: True velocity [m/s or rad/s].
    """

    def __init__(
        self,
        law: Law,
        sample_time_ns: int,
        *,
        hand_force: float,
        mass: float = 0.25,
        damping: float = 0.1,
        initial_position: float = 0.003,
    ) -> None:
        step = sample_time_ns * 1e-9 / SUBSTEPS
        fade = damping / mass * step
        self.position, self.velocity = initial_position, 0.0
        self._law, self._hand_force, self._step = law, hand_force, step
        # Series where the closed form would cancel; both are right to 1e-12 at the limit between them.
        small = fade < 1e-3
        drift = 1.0 - fade * (1.0 - fade * (1.0 - fade / 4.0) / 3.0) / 2.0
        creep = 0.5 - fade * (1.0 - fade * (1.0 - fade / 5.0) / 4.0) / 6.0
        self._keep = math.exp(-fade)
        self._drift = step * drift if small else -math.expm1(-fade) * mass / damping
        self._creep = step * step / mass * creep if small else (step - self._drift) / damping
        self._gain = self._drift / mass
        self._damping, self._mass, self._time = damping, mass, 0.0
        self._motor = self._user = 0.0
        self._period, self._now = sample_time_ns, 0

    @property
    def encoder_position(self) -> float:
        """The position: encoders belong to the loop."""
        return self.position

    def begin(self, now: int) -> None:
        """Starts the clock at `now` [ns]."""
        self._now = now

    def advance_to(self, now: int, torque: float) -> None:
        """Moves by whole sample times under a constant torque."""
        for _ in range((now - self._now) // self._period):
            for _ in range(SUBSTEPS):
                self._substep(torque)
        self._now = now

    def _substep(self, torque: float) -> None:
        limit = self._hand_force
        hand = max(-limit, min(limit, self._law(self._time, self.position, self.velocity, torque)))
        force = torque + hand
        travel = self._drift * self.velocity + self._creep * force
        self.velocity = self._keep * self.velocity + self._gain * force
        self.position += travel
        self._motor += torque * travel
        self._user += hand * travel
        self._time += self._step

    def energy(self) -> PlantEnergy:
        """Returns the true energies since the start [J]; what is not stored was dissipated."""
        stored = 0.5 * self._mass * self.velocity * self.velocity
        return PlantEnergy(self._motor, self._user, self._motor + self._user - stored, stored)


def sinusoid(_chance: random.Random) -> Law:
    """Returns user S: 300 N/m and 3 N*s/m behind 30 mm at 1 Hz."""
    w = 2.0 * math.pi
    return lambda t, q, v, _f: 300.0 * (0.03 * math.cos(w * t) - q) - 3.0 * (0.03 * w * math.sin(w * t) + v)


def tremor(_chance: random.Random) -> Law:
    """Returns a hand that leans on the wall and trembles at 8 Hz."""
    return lambda t, _q, v, _f: -4.0 + 3.0 * math.sin(16.0 * math.pi * t) - 2.0 * v


def tapping(_chance: random.Random) -> Law:
    """Returns a hand that taps three times a second."""
    return lambda t, q, v, _f: 600.0 * (0.01 * math.sin(6.0 * math.pi * t) - q) - 5.0 * v


def sudden_pull(_chance: random.Random) -> Law:
    """Returns a hand that leans on the wall and then pulls as hard as it can."""
    return lambda t, _q, v, _f: -8.0 - 5.0 * v if t % 1.0 < 0.6 else math.inf


def adversary(chance: random.Random) -> Law:
    """Returns a hand that lets the wall load where that is cheap and pulls along the torque where it pays."""
    threshold, push, kind = chance.uniform(0.02, 3.0), chance.uniform(1.0, 15.0), chance.randrange(3)
    peak = 0.0

    def force(_t: float, q: float, v: float, torque: float) -> float:
        nonlocal peak
        if q > _OUT:
            return -0.3 * push - 3.0 * v
        if q < _DEEP:
            return math.inf
        peak = max(0.999 * peak, torque)
        pulls = (torque > threshold, torque > 0.0 and v > -0.01, torque >= 0.5 * peak)[kind]
        return math.inf if pulls else -push

    return force


def telegraph(chance: random.Random) -> Law:
    """Returns a hand that pulls and pushes at random, each for a while."""
    share = 1.0

    def force(_t: float, q: float, v: float, _torque: float) -> float:
        nonlocal share
        if chance.random() < 0.03:
            share = chance.uniform(-1.0, 1.0)
        if q > _OUT:
            return -5.0 - 3.0 * v
        return math.inf if q < _DEEP else 20.0 * share

    return force


USERS: Final[dict[str, Callable[[random.Random], Law]]] = {
    "sinusoid": sinusoid,
    "tremor": tremor,
    "tapping": tapping,
    "sudden_pull": sudden_pull,
    "adversary": adversary,
    "telegraph": telegraph,
}
"""Name -> maker of a law; a law may keep a state and is used for one run."""
