"""Environments of one admittance display, and the axis that renders them.

An environment answers a force with a velocity; its walls limit the position. Commands change at SYNCs only. An
environment with its own states follows the command that was sent, which limits and certificates may have reduced.

`virtual_mass` is a mass with a damper, a spring to ground and walls:

    m u' = F - b u - k (q - rest),   and no further than the walls

The spring acts at the measured position; a wall limits the position and absorbs the remaining momentum (plastic).
"""

from math import inf
from typing import Annotated, ClassVar, Final, Literal, Self

from pydantic import model_validator

from canhaptic.control.admittance.port import AdmittanceProperties, Port
from canhaptic.control.environments import plain
from canhaptic.kernels import Buffer
from canhaptic.units import Parameters, quantity


class AdmittanceEnvironment(Parameters):
    """Base class of an environment of one admittance display."""

    display: ClassVar[Literal["admittance"]] = "admittance"
    states: ClassVar[int] = 0
    """Number of internal states kept from SYNC to SYNC; in the methods they are the list `inner`, initially 0."""

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

    def of_axis(self, _axis: int) -> Self:
        """Return the environment on an axis: it has one."""
        return self

    def speed_after(self, inner: Buffer, speed: float, force: float, position: float, time: float) -> float:
        """Return the speed after another hold under a constant force [m/s or rad/s].

        Args:
            inner: States of the environment.
            speed: Speed of the last command [m/s or rad/s].
            force: Force of the hand [N or N*m].
            position: Position at this SYNC [m or rad].
            time: T [s].
        """
        raise NotImplementedError

    def go_along(self, inner: Buffer, before: float, speed: float, time: float) -> None:
        """Advance the internal states by one hold at `speed`, after a hold at speed `before` [m/s or rad/s]."""

    def stored(self, inner: Buffer, speed: float, position: float) -> float:
        """Return the stored energy [J]."""
        raise NotImplementedError

    def stretch(self, position: float) -> float:
        """Return the displacement of the spring for logs [m or rad]; 0 without a spring."""
        return 0.0


_BACK: Final = 0.125
"""Fraction of the distance beyond a position limit that a command corrects during one hold plus the drive's lag."""


class Commands(list[float]):
    """Ring buffer of the velocity commands sent [m/s or rad/s].

    Args:
        kept: Length of the ring buffer.

    Attributes:
        newest: Index of the last command.
        speed: Last command [m/s or rad/s].
    """

    __slots__ = ("newest", "speed")

    def __init__(self, kept: int) -> None:
        super().__init__([0.0] * kept)
        self.newest, self.speed = 0, 0.0

    def send(self, speed: float) -> None:
        """Store a command as the newest."""
        self.newest = self.newest + 1 if self.newest + 1 < len(self) else 0
        self[self.newest] = self.speed = speed

    def sent(self, age: int) -> float:
        """Return the command sent `age` SYNCs before the newest [m/s or rad/s]."""
        return self[self.newest - age]


class AdmittanceAxis:
    """Energy account, limits and commands of one axis of an admittance display.

    Args:
        environment: Environment of the axis.
        properties: Declared properties of the axis.
        kept: Number of past commands to store.
        lag: Overshoot per speed: moving mass of the drive divided by the gain of its velocity loop [s].

    Attributes:
        most: Largest speed that may be commanded; a stop lowers it [m/s or rad/s].
    """

    def __init__(
        self, environment: AdmittanceEnvironment, properties: AdmittanceProperties, kept: int, lag: float = 0.0
    ) -> None:
        self.properties, self._lag, self.most = plain(properties), lag, properties.speed_limit
        self._low = max(environment.lower_wall, properties.position_low)
        self._high = min(environment.upper_wall, properties.position_high)
        self._step = properties.acceleration_limit * properties.sample_time
        self.port, self.commands = Port(self.properties), Commands(kept)

    def begin(self, position: float, force: float) -> None:
        """Start the energy account at the first position [m or rad] and force [N or N*m]."""
        self.port.begin(position, force)

    def limited(self, request: float, position: float, velocity: float) -> float:
        """Return the nearest command that the limits of speed, acceleration and position allow [m/s or rad/s].

        The command may always go to zero. It leaves enough distance to a position limit for the queued commands and for
        the overshoot of the drive. Beyond the limit it leads back slowly, because a drive without an integral yields to
        a pushing hand.
        """
        properties, commands, lag, step = self.properties, self.commands, self._lag, self._step
        last, time, most = commands.speed, properties.sample_time, self.most
        high = last + step if last > 0.0 else step
        low = last - step if last < 0.0 else -step
        ahead = position + lag * velocity
        for age in range(properties.delay):
            ahead += time * commands[commands.newest - age]
        room, rest = (self._high - ahead) / (time + lag), (self._low - ahead) / (time + lag)
        if room < 0.0:
            room *= _BACK
        if rest > 0.0:
            rest *= _BACK
        request = room if request > room else request
        request = rest if request < rest else request
        high, low = most if high > most else high, -most if low < -most else low
        request = low if request < low else request
        return high if request > high else request

    def whole(self, speed: float) -> float:
        """Round a command towards zero to a multiple of the drive's command resolution [m/s or rad/s]."""
        quantum = self.properties.speed_quantum
        if quantum == 0.0 or speed in (inf, -inf):
            return speed
        return int(speed / quantum + 1e-9 if speed > 0.0 else speed / quantum - 1e-9) * quantum


class AdmittanceMass(AdmittanceEnvironment):
    """`virtual_mass`: a mass that the hand moves, with a damper, a spring to ground and walls."""

    mass: Annotated[float, quantity("kg", "kg*m^2", gt=0.0, le=1e6)]
    """Virtual mass felt at the sensor."""
    stiffness: Annotated[float, quantity("N/m", "N*m/rad", ge=0.0, le=1e8)] = 0.0
    """Stiffness of a spring to ground."""
    rest: Annotated[float, quantity("m", "rad", ge=-1e3, le=1e3)] = 0.0
    """Position at which the spring exerts no force."""

    @property
    def inertia(self) -> float:
        """Virtual mass [kg or kg*m^2]."""
        return self.mass

    def speed_after(self, inner: Buffer, speed: float, force: float, position: float, time: float) -> float:
        """Return the speed after another hold [m/s or rad/s], with the damper integrated implicitly."""
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
        """Return the displacement of the spring [m or rad]; 0 without a spring."""
        return position - self.rest if self.stiffness else 0.0
