"""`cup_and_ball`: a cup that the hand moves to and fro, with a ball that swings in it like a pendulum.

    (M + m) u' + m l (w' cos a - w^2 sin a) = F - b u,       l w' + u' cos a + g sin a = 0,       a' = w

The command is constant in a hold, so that the ball swings in an inertial frame (integrated by Stoermer and Verlet), and
the force of the ball on the cup is the change of its momentum along the path, m l cos(a) w. At a SYNC the speed jumps
by du: the rate of the ball changes by dw = -du cos(a) / l, and the cup resists with M + m sin(a)^2.
The task is that of Hasson, Shen and Sternad, J. Neurophysiology 108, 2012; 2.4 kg, 0.6 kg and 0.45 m are the usually
cited values of their rig; the source was not consulted.
"""

from math import cos, sin
from typing import Annotated, ClassVar, Final

from canhaptic.control.admittance.admittance_environment import AdmittanceEnvironment
from canhaptic.kernels import Buffer
from canhaptic.units import quantity

_GRAVITY: Final = 9.80665  # standard gravity [m/s^2]


class CupAndBall(AdmittanceEnvironment):
    """A cup with a ball, on an axis in metres."""

    states: ClassVar[int] = 3  # angle of the ball [rad], its rate [rad/s], its push on the cup in the last hold [N*s]

    cup: Annotated[float, quantity("kg", gt=0.0, le=1e3)] = 2.4
    """Mass of the cup."""
    ball: Annotated[float, quantity("kg", gt=0.0, le=1e3)] = 0.6
    """Mass of the ball."""
    length: Annotated[float, quantity("m", gt=0.0, le=100.0)] = 0.45
    """Length of the pendulum: the radius of the cup."""

    @property
    def inertia(self) -> float:
        """Mass of cup and ball together [kg]."""
        return self.cup + self.ball

    def speed_after(self, inner: Buffer, speed: float, force: float, position: float, time: float) -> float:
        """Return the speed of the cup after another hold [m/s]."""
        sine = sin(inner[0])
        mass = self.cup + self.ball * sine * sine
        return (mass * speed + force * time + inner[2]) / (mass + time * self.damping)

    def go_along(self, inner: Buffer, before: float, speed: float, time: float) -> None:
        """Apply the change of speed to the ball, and let it swing for a hold."""
        angle, pull = inner[0], _GRAVITY / self.length
        rate = inner[1] - cos(angle) * (speed - before) / self.length
        momentum = cos(angle) * rate
        rate -= 0.5 * time * pull * sin(angle)
        angle += time * rate
        rate -= 0.5 * time * pull * sin(angle)
        inner[0], inner[1] = angle, rate
        inner[2] = -self.ball * self.length * (cos(angle) * rate - momentum)

    def stored(self, inner: Buffer, speed: float, position: float) -> float:
        """Return the energy of cup and ball [J]."""
        along = speed + self.length * cos(inner[0]) * inner[1]
        across = self.length * sin(inner[0]) * inner[1]
        height = self.length * (1.0 - cos(inner[0]))
        moving = self.cup * speed * speed + self.ball * (along * along + across * across)
        return 0.5 * moving + self.ball * _GRAVITY * height
