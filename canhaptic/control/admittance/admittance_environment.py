"""Environments of an admittance display: a velocity in response to a force, with walls that limit the position.

Commands change at SYNCs only. An environment with states of its own follows the command that was sent, which limits and
certificates may have reduced.

Motion of the rendered environment, its limits, and the queued commands.
"""

from dataclasses import dataclass
from math import inf
from typing import Annotated, ClassVar, Final, Literal, NamedTuple, Self

from pydantic import model_validator

from canhaptic.control.admittance.port import AdmittanceProperties, PortSettings, port_positions
from canhaptic.kernels import Buffer, MakeBuffer
from canhaptic.units import Parameters, quantity


class AdmittanceEnvironment(Parameters):
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
        """Advance the states by a hold at a speed; `before` is the speed of the previous hold [m/s or rad/s]."""

    def stored(self, inner: Buffer, speed: float, position: float) -> float:
        """Stored energy [J]."""
        raise NotImplementedError

    def stretch(self, position: float) -> float:
        """Displacement of the spring, for logs; 0 without one [m or rad]."""
        return 0.0


_BACK: Final = 0.125
"""Part of the way back that a command takes on in the time of a hold and of the drive's lag."""


@dataclass(frozen=True, slots=True)
class AdmittanceMotionSettings:
    """Limits of the commanded motion."""

    sample_time: float  # [s]
    delay: int
    quantum: float  # of the command; 0: any [m/s or rad/s]
    fastest: float  # [m/s or rad/s]
    step: float  # largest rise of the speed in a hold [m/s or rad/s]
    low: float  # least position [m or rad]
    high: float  # largest position [m or rad]
    lag: float  # of the drive: overshoot per speed [s]
    states: int  # of the environment


class AdmittanceMemory(NamedTuple):
    """Buffers of one axis."""

    positions: Buffer  # of the SYNCs whose forces have not come [m or rad]
    commands: Buffer  # the last ones sent, a ring [m/s or rad/s]
    inner: Buffer  # states of the environment


@dataclass(slots=True)
class AdmittanceMotion:
    """State of the commands."""

    speed: float = 0.0  # of the last command [m/s or rad/s]
    newest: int = 0  # place of the last command


def motion_settings(
    environment: AdmittanceEnvironment, properties: AdmittanceProperties, lag: float = 0.0
) -> AdmittanceMotionSettings:
    """Constants of a run; `lag` is the drive's moving mass over its gain [s]."""
    time = properties.sample_time
    return AdmittanceMotionSettings(
        time, properties.delay, properties.speed_quantum, properties.speed_limit, properties.acceleration_limit * time,
        max(environment.lower_wall, properties.position_low), min(environment.upper_wall, properties.position_high),
        lag, environment.states,
    )  # fmt: skip


def display_memory(
    port: PortSettings, motion: AdmittanceMotionSettings, kept: int, make_buffer: MakeBuffer
) -> AdmittanceMemory:
    """Buffers of one axis for this number of commands."""
    return AdmittanceMemory(port_positions(port, make_buffer), make_buffer(kept), make_buffer(motion.states))


def send(motion: AdmittanceMotion, commands: Buffer, speed: float) -> None:
    """Store a command as the newest."""
    motion.newest = motion.newest + 1 if motion.newest + 1 < len(commands) else 0
    commands[motion.newest] = speed
    motion.speed = speed


def sent(motion: AdmittanceMotion, commands: Buffer, age: int) -> float:
    """Return a command [m/s or rad/s]; age 0 is the newest."""
    return commands[motion.newest - age]


def limited(
    settings: AdmittanceMotionSettings,
    motion: AdmittanceMotion,
    commands: Buffer,
    request: float,
    position: float,
    velocity: float,
) -> float:
    """Return the nearest command that speed, acceleration and position limits allow [m/s or rad/s].

    A command may always go to zero. Towards a position limit, room is left for the queued commands and for the
    distance that the drive needs to follow. Beyond it the command leads back, slowly: a drive without an integral
    yields to a pushing hand.
    """
    last, step, most = motion.speed, settings.step, settings.fastest
    high = last + step if last > 0.0 else step
    low = last - step if last < 0.0 else -step
    ahead = position + settings.lag * velocity
    for age in range(settings.delay):
        ahead += settings.sample_time * commands[motion.newest - age]
    span = settings.sample_time + settings.lag
    room, rest = (settings.high - ahead) / span, (settings.low - ahead) / span
    if room < 0.0:
        room *= _BACK
    if rest > 0.0:
        rest *= _BACK
    request = room if request > room else request
    request = rest if request < rest else request
    high, low = most if high > most else high, -most if low < -most else low
    request = low if request < low else request
    return high if request > high else request


def whole(settings: AdmittanceMotionSettings, speed: float) -> float:
    """Round a command towards zero to whole quanta [m/s or rad/s]."""
    quantum = settings.quantum
    if quantum == 0.0 or speed in (inf, -inf):
        return speed
    return int(speed / quantum + 1e-9 if speed > 0.0 else speed / quantum - 1e-9) * quantum
