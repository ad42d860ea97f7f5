"""A moving mass under a user's force law, for what no scene can express: a hand that answers the torque.

The plant is the closed form of m v' + b v = F for a force constant within a quarter of a hold. The hand force never
exceeds the declared one in either direction, so that a certificate is on trial and not the user.
"""

from functools import partial
from typing import Final

from canhaptic.signals import PlantEnergy
from tests.adversary import users
from tests.adversary.users import Force, Mass

SUBSTEPS: Final = 4
USERS: Final[dict[str, users.Maker]] = {**users.USERS, "adversary": partial(users.adversary, out=0.005, kinds=3)}
"""Name -> maker of a law; a law may keep a state and is used for one run."""


class HandPlant:
    """A moving mass under torque and hand, with the interface of `canhaptic.sim.plant.plant.Plant` that a loop uses.

    Args:
        law: Force law of the hand.
        sample_time_ns: T [ns].
        hand_force: Largest hand force [N or N*m].
        mass: [kg or kg*m^2].
        damping: Damping of the device [N*s/m or N*m*s/rad].
        initial_position: [m or rad].
    """

    def __init__(
        self,
        law: Force,
        sample_time_ns: int,
        *,
        hand_force: float,
        mass: float = 0.25,
        damping: float = 0.1,
        initial_position: float = 0.003,
    ) -> None:
        self._step = sample_time_ns * 1e-9 / SUBSTEPS
        self._body = Mass(mass, damping, self._step, initial_position)
        self._law, self._hand_force, self._mass, self._time = law, hand_force, mass, 0.0
        self._motor = self._user = 0.0
        self._period, self._now = sample_time_ns, 0

    @property
    def position(self) -> float:
        """True position [m or rad]; what an encoder shows too: encoders belong to the loop."""
        return self._body.position

    encoder_position = position

    @property
    def velocity(self) -> float:
        """True velocity [m/s or rad/s]."""
        return self._body.velocity

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
        travel = self._body.advance(torque + hand)
        self._motor += torque * travel
        self._user += hand * travel
        self._time += self._step

    def energy(self) -> PlantEnergy:
        """Returns the true energies since the start [J]; what is not stored was dissipated."""
        stored = 0.5 * self._mass * self.velocity * self.velocity
        return PlantEnergy(self._motor, self._user, self._motor + self._user - stored, stored)
