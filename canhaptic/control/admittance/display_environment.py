"""Environments of an admittance display: a velocity in response to a force, with walls that limit the position.

Commands change at SYNCs only. An environment with states of its own follows the command that was sent, which limits and
certificates may have reduced.
"""

from typing import Annotated, ClassVar, Literal, Self

from pydantic import model_validator

from canhaptic.kernels import Buffer
from canhaptic.units import Parameters, quantity


class DisplayEnvironment(Parameters):
    """Parameters and methods of an environment on one axis."""

    display: ClassVar[Literal["admittance"]] = "admittance"
    states: ClassVar[int] = 0
    """Number of states kept from SYNC to SYNC: `inner` of its methods, zeros at first."""

    damping: Annotated[float, quantity("N*s/m", "N*m*s/rad", ge=0.0, le=1e6)] = 0.0
    """Damping to ground."""
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
        """Inertia felt by a hand that moves slowly [kg or kg*m^2]."""
        raise NotImplementedError

    def speed_after(self, inner: Buffer, speed: float, force: float, position: float, time: float) -> float:
        """Speed after another hold under a constant force [m/s or rad/s].

        Args:
            inner: States of the environment.
            speed: Speed of the last command [m/s or rad/s].
            force: Force of the hand [N or N*m].
            position: Position at this SYNC [m or rad].
            time: T [s].
        """
        raise NotImplementedError

    def go_along(self, inner: Buffer, before: float, speed: float, time: float) -> None:
        """Advance its states by a hold at a speed; `before` is the speed of the hold before [m/s or rad/s]."""

    def stored(self, inner: Buffer, speed: float, position: float) -> float:
        """Stored energy [J]."""
        raise NotImplementedError

    def stretch(self, position: float) -> float:
        """Displacement of its spring, for logs; 0 without one [m or rad]."""
        return 0.0
