"""`internal_dissipation` of an admittance display: the paper's algorithm with the port energy u J and the state m u.

Here u is the velocity held and J the impulse of the force: the energy that flows in is u J, and the damper takes
T b u u+. The next speed is the root of

    m u+^2 / 2 + T b u u+ - [m u^2 / 2 + u J - (U(x+) - U(x))] = 0

that keeps the sign. From rest the mass starts with J / m, which creates J^2 / 2m. If there is no root, more energy left
than was stored: the mass stops, and the shortfall is a deficit. A perfect drive is assumed, so that the algorithm
bounds the energy created by sampling, but not the energy created by the drive.
"""

from functools import cached_property
from math import sqrt
from typing import Any, ClassVar

from canhaptic.control.admittance.admittance_environment import AdmittanceMass
from canhaptic.control.admittance.group_environment import GroupMass, PathMass
from canhaptic.control.admittance.unprotected_admittance import UnprotectedAdmittance
from canhaptic.control.environments import plain
from canhaptic.errors import ParameterError
from canhaptic.kernels import Buffer


def next_speed(environment: AdmittanceMass, time: float, speed: float, impulse: float, risen: float) -> float:
    """Return the next speed by the energy balance, without a reversal [m/s or rad/s]; 0 without a solution.

    Args:
        environment: Virtual mass and damper.
        time: T [s].
        speed: Speed of the hold that ended, not 0 [m/s or rad/s].
        impulse: J, the impulse of the force in it [N*s or N*m*s].
        risen: Increase of the potential in it [J].
    """
    share = time * environment.damping / environment.mass
    square = (1.0 + share * share) * speed * speed + 2.0 * (speed * impulse - risen) / environment.mass
    if square <= 0.0:
        return 0.0
    root = sqrt(square)
    found = -share * speed + (root if speed > 0.0 else -root)
    return found if found * speed > 0.0 else 0.0


class BalancedMass(AdmittanceMass):
    """A virtual mass whose next speed solves the balance."""

    states: ClassVar[int] = 1  # potential at the last SYNC [J]

    def speed_after(self, inner: Buffer, speed: float, force: float, position: float, time: float) -> float:
        """Return the speed after another hold by the balance [m/s or rad/s]."""
        impulse, potential = force * time, self.potential(position)
        risen, inner[0] = potential - inner[0], potential
        if speed == 0.0:
            return (impulse + time * self.pull(position)) / self.mass
        return next_speed(self, time, speed, impulse, risen)


class BalancedMasses(GroupMass):
    """The same mass on every axis, with the balance solved on each; the balances add up."""

    states: ClassVar[int] = 1

    @cached_property
    def _alone(self) -> BalancedMass:
        return plain(BalancedMass(mass=self.mass, damping=self.damping, stiffness=self.stiffness))

    def speeds_after(
        self, inner: list[Buffer], speeds: list[float], forces: list[float], positions: list[float], time: float
    ) -> list[float]:
        """Return the speeds after another hold by the balance [m/s or rad/s]."""
        each = zip(inner, speeds, forces, self._stretches(positions), strict=True)
        return [self._alone.speed_after(*of, time) for of in each]


class DissipatingAdmittance(UnprotectedAdmittance):
    """The paper's energy balance with force in and velocity out."""

    @staticmethod
    def rendered(environment: Any) -> Any:
        """Return the environment with its next speed by the balance.

        Raises:
            ParameterError: It is no virtual mass.
        """
        if isinstance(environment, AdmittanceMass):
            return BalancedMass(**dict(environment))
        if isinstance(environment, GroupMass) and not isinstance(environment, PathMass):
            return BalancedMasses(**dict(environment))
        raise ParameterError(
            f"internal_dissipation: got {type(environment).__name__}, expected environment: virtual_mass; "
            "the balance is solved for a virtual mass only; use the algorithm `guarded`"
        )
