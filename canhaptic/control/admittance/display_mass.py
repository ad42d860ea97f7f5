"""`virtual_mass`: a mass with a damper, a spring to ground and walls, as an admittance display renders it.

    m u' = F - b u - k (q - rest),   and no further than the walls

The spring acts at the measured position; a wall is a limit of the position and takes what the mass has left (plastic).
"""

from typing import Annotated, ClassVar, Literal

from pydantic import model_validator

from canhaptic.units import Parameters, quantity


class DisplayMass(Parameters):
    """A mass that the hand moves."""

    display: ClassVar[Literal["admittance"]] = "admittance"

    mass: Annotated[float, quantity("kg", "kg*m^2", gt=0.0, le=1e6)]
    """Felt at the sensor."""
    damping: Annotated[float, quantity("N*s/m", "N*m*s/rad", ge=0.0, le=1e6)] = 0.0
    """Of the mass to ground."""
    stiffness: Annotated[float, quantity("N/m", "N*m/rad", ge=0.0, le=1e8)] = 0.0
    """Of a spring to ground."""
    rest: Annotated[float, quantity("m", "rad", ge=-1e3, le=1e3)] = 0.0
    """Where that spring is at rest."""
    lower_wall: Annotated[float, quantity("m", "rad", ge=-1e3, le=1e3)] = -1e3
    """Below it the mass does not go."""
    upper_wall: Annotated[float, quantity("m", "rad", ge=-1e3, le=1e3)] = 1e3
    """Above it the mass does not go."""

    @model_validator(mode="after")
    def _walls_leave_room(self) -> "DisplayMass":
        if self.lower_wall >= self.upper_wall:
            raise ValueError(f"lower_wall is {self.lower_wall}, expected less than upper_wall ({self.upper_wall})")
        return self

    def stretch(self, position: float) -> float:
        """Returns the displacement of the spring; 0 without one [m or rad]."""
        return position - self.rest if self.stiffness else 0.0

    def potential(self, position: float) -> float:
        """Returns the energy stored in the spring [J]."""
        stretch = position - self.rest
        return 0.5 * self.stiffness * stretch * stretch

    def pull(self, position: float) -> float:
        """Returns the force of the spring on the mass [N or N*m]."""
        return -self.stiffness * (position - self.rest)
