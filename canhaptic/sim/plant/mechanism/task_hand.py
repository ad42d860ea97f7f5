"""The human at a handle that moves in a plane: an impedance between a voluntary motion and the handle, in task space.

Force on the handle: K (x_u - x) + D (v_u - v) + push, with K and D symmetric 2 x 2. The stiffness of a human arm is an
ellipse, not a circle (Mussa-Ivaldi, Hogan, Bizzi, J. Neuroscience 5(10), 1985): it has a value along its major axis,
one across it, and an angle.
"""

import math
from typing import Annotated, NamedTuple

from pydantic import model_validator

from canhaptic.sim.plant.user import SinusoidMotion
from canhaptic.units import Parameters, quantity

_Force = Annotated[float, quantity("N", ge=-1e6, le=1e6)]
Length = Annotated[float, quantity("m", ge=-1e3, le=1e3)]


class Ellipse(NamedTuple):
    """A symmetric 2 x 2 matrix: stiffness or damping in the plane."""

    xx: float
    xy: float
    yy: float


class PlaneMotion(Parameters):
    """Voluntary motion in each direction; None: no motion."""

    x: SinusoidMotion | None = None
    """Voluntary motion in x."""
    y: SinusoidMotion | None = None
    """Voluntary motion in y."""


class TaskHand(Parameters):
    """Parameters of the hand at the handle; every part is absent by default."""

    stiffness: Annotated[float, quantity("N/m", ge=0.0, le=1e6)] = 0.0
    """Stiffness along the major axis of the ellipse."""
    stiffness_across: Annotated[float, quantity("N/m", ge=0.0, le=1e6)] | None = None
    """Stiffness across the major axis; None: as along it."""
    damping: Annotated[float, quantity("N*s/m", ge=0.0, le=1e4)] = 0.0
    """Damping along the major axis of the ellipse."""
    damping_across: Annotated[float, quantity("N*s/m", ge=0.0, le=1e4)] | None = None
    """Damping across the major axis; None: as along it."""
    angle: Annotated[float, quantity("rad", ge=-10.0, le=10.0)] = 0.0
    """Angle of the major axis, from +x towards +y."""
    push: tuple[_Force, _Force] = (0.0, 0.0)
    """Constant force of the hand on the handle."""
    rest: tuple[Length, Length] = (0.0, 0.0)
    """Rest position of the hand's spring; the motion is added to it."""
    motion: PlaneMotion = PlaneMotion()
    """Voluntary motion, which the handle follows through the grip."""

    @model_validator(mode="after")
    def _motion_reaches_the_handle(self) -> "TaskHand":
        moves = self.motion.x is not None or self.motion.y is not None
        if moves and not (self.stiffness or self.damping or self.stiffness_across or self.damping_across):
            raise ValueError("motion without a hand: stiffness and damping are 0, expected one > 0")
        return self

    @property
    def motions(self) -> tuple[SinusoidMotion | None, SinusoidMotion | None]:
        """Voluntary motion in x and in y."""
        return self.motion.x, self.motion.y

    @property
    def stiffness_matrix(self) -> Ellipse:
        """K [N/m]."""
        return _ellipse(self.stiffness, self.stiffness_across, self.angle)

    @property
    def damping_matrix(self) -> Ellipse:
        """D [N*s/m]."""
        return _ellipse(self.damping, self.damping_across, self.angle)


class PointerTaskHand(TaskHand):
    """A hand whose position is set while the mechanism runs; initially at `rest`."""


def _ellipse(along: float, across: float | None, angle: float) -> Ellipse:
    other = along if across is None else across
    cosine, sine = math.cos(angle), math.sin(angle)
    return Ellipse(
        along * cosine * cosine + other * sine * sine,
        (along - other) * cosine * sine,
        along * sine * sine + other * cosine * cosine,
    )
