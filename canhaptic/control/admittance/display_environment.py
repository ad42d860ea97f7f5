"""What an admittance display renders: a speed that answers a force, with walls that limit the position.

Commands change at SYNCs only. An environment with states of its own goes along with the command that was sent, which
limits and certificates may have cut.
"""

from typing import Annotated, ClassVar, Literal, Self

from pydantic import model_validator

from canhaptic.kernels import Buffer
from canhaptic.units import Parameters, quantity


class DisplayEnvironment(Parameters):
    """Parameters and methods of what is rendered on one axis."""

    display: ClassVar[Literal["admittance"]] = "admittance"
    states: ClassVar[int] = 0
    """How many numbers it remembers from SYNC to SYNC: `inner` of its methods, zeros at first."""

    damping: Annotated[float, quantity("N*s/m", "N*m*s/rad", ge=0.0, le=1e6)] = 0.0
    """To ground."""
    lower_wall: Annotated[float, quantity("m", "rad", ge=-1e3, le=1e3)] = -1e3
    """Lower limit of the position."""
    upper_wall: Annotated[float, quantity("m", "rad", ge=-1e3, le=1e3)] = 1e3
    """Upper limit of the position."""

    @model_validator(mode="after")
    def _walls_leave_room(self) -> Self:
        if self.lower_wall >= self.upper_wall:
            raise ValueError(f"lower_wall is {self.lower_wall}, expected less than upper_wall ({self.upper_wall})")
        return self

    @property
    def inertia(self) -> float:
        """What a slow hand moves [kg or kg*m^2]."""
        raise NotImplementedError

    def speed_after(self, inner: Buffer, speed: float, force: float, position: float, time: float) -> float:
        """Returns the speed after another hold under a force [m/s or rad/s].

        Args:
            inner: Its states.
            speed: Of the last command [m/s or rad/s].
            force: Of the hand [N or N*m].
            position: At this SYNC [m or rad].
            time: T [s].
        """
        raise NotImplementedError

    def go_along(self, inner: Buffer, before: float, speed: float, time: float) -> None:
        """Moves its states on by a hold at a speed; `before` is that of the hold before [m/s or rad/s]."""

    def stored(self, inner: Buffer, speed: float, position: float) -> float:
        """Returns the energy that it holds [J]."""
        raise NotImplementedError

    def stretch(self, position: float) -> float:
        """Returns the displacement of its spring, for logs; 0 without one [m or rad]."""
        return 0.0
