"""`virtual_mass`: a mass with a damper, a spring to ground and walls, as an admittance display renders it.

    m u' = F - b u - k (q - rest),   and no further than the walls

The spring acts at the measured position; a wall is a limit of the position and takes what the mass has left (plastic).
"""

from typing import Annotated

from canhaptic.control.admittance.display_environment import DisplayEnvironment
from canhaptic.kernels import Buffer
from canhaptic.units import quantity


class DisplayMass(DisplayEnvironment):
    """A mass that the hand moves."""

    mass: Annotated[float, quantity("kg", "kg*m^2", gt=0.0, le=1e6)]
    """Virtual mass felt at the sensor."""
    stiffness: Annotated[float, quantity("N/m", "N*m/rad", ge=0.0, le=1e8)] = 0.0
    """Stiffness of a spring to ground."""
    rest: Annotated[float, quantity("m", "rad", ge=-1e3, le=1e3)] = 0.0
    """Where that spring is at rest."""

    @property
    def inertia(self) -> float:
        """The mass [kg or kg*m^2]."""
        return self.mass

    def speed_after(self, inner: Buffer, speed: float, force: float, position: float, time: float) -> float:
        """Return the speed after another hold [m/s or rad/s]: implicit in the damper."""
        push = (force - self.stiffness * (position - self.rest)) * time
        return (self.mass * speed + push) / (self.mass + time * self.damping)

    def stored(self, inner: Buffer, speed: float, position: float) -> float:
        """Return the energy of mass and spring [J]."""
        return 0.5 * self.mass * speed * speed + self.potential(position)

    def potential(self, position: float) -> float:
        """Return the energy stored in the spring [J]."""
        stretch = position - self.rest
        return 0.5 * self.stiffness * stretch * stretch

    def pull(self, position: float) -> float:
        """Return the force of the spring on the mass [N or N*m]."""
        return -self.stiffness * (position - self.rest)

    def stretch(self, position: float) -> float:
        """Return the displacement of the spring; 0 without one [m or rad]."""
        return position - self.rest if self.stiffness else 0.0
