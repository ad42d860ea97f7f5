"""The human at the handle: an impedance (stiffness, damping) between a voluntary motion and the handle.

Hand force on the handle: K (x_u - q) + D (v_u - v) + push, with x_u the voluntary motion. A sinusoid enters the plant
as two states of a harmonic oscillator, so that hand and plant together stay exactly linear. Hogan, "Impedance control",
ASME J. Dynamic Systems 107, 1985, for the model; grips measured on hands: 100..1000 N/m, 1..10 N*s/m.
"""

import math
from typing import Annotated, Literal

from canhaptic.parameters import Parameters, quantity


class SinusoidMotion(Parameters):
    """Voluntary motion x_u(t) = offset + amplitude * sin(2 pi frequency t + phase), t from the start of the plant."""

    type: Literal["sinusoid"] = "sinusoid"
    amplitude: Annotated[float, quantity("m", "rad", ge=0.0, le=1e3)]
    frequency: Annotated[float, quantity("Hz", gt=0.0, le=1e3)]
    phase: Annotated[float, quantity("rad", ge=-10.0, le=10.0)] = 0.0
    offset: Annotated[float, quantity("m", "rad", ge=-1e3, le=1e3)] = 0.0

    def position(self, time: float) -> float:
        """Returns x_u [m or rad] at `time` [s]."""
        return self.offset + self.amplitude * math.sin(2.0 * math.pi * self.frequency * time + self.phase)


class UserParameters(Parameters):
    """The hand; every part absent unless it is given."""

    stiffness: Annotated[float, quantity("N/m", "N*m/rad", ge=0.0, le=1e8)] = 0.0
    damping: Annotated[float, quantity("N*s/m", "N*m*s/rad", ge=0.0, le=1e6)] = 0.0
    push: Annotated[float, quantity("N", "N*m", ge=-1e6, le=1e6)] = 0.0
    """Constant force of the hand, towards +q."""
    rest: Annotated[float, quantity("m", "rad", ge=-1e3, le=1e3)] = 0.0
    """Where the hand's spring is at rest; the motion comes on top of it."""
    motion: SinusoidMotion | None = None
