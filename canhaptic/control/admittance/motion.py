"""The motion of what is rendered, its limits, and the commands under way."""

from dataclasses import dataclass
from math import copysign, inf
from typing import Final, NamedTuple

from canhaptic.control.admittance.display_environment import DisplayEnvironment
from canhaptic.control.admittance.port import PortSettings, port_positions
from canhaptic.control.admittance.properties import DisplayProperties
from canhaptic.kernels import Buffer, MakeBuffer

_BACK: Final = 0.125
"""Part of the way back that a command takes on in the time of a hold and of the drive's lag."""


@dataclass(frozen=True, slots=True)
class DisplayMotionSettings:
    """What limits a command."""

    sample_time: float  # [s]
    delay: int
    quantum: float  # of the command; 0: any [m/s or rad/s]
    fastest: float  # [m/s or rad/s]
    step: float  # largest rise of the speed in a hold [m/s or rad/s]
    low: float  # least position [m or rad]
    high: float  # largest position [m or rad]
    lag: float  # of the drive: way that it goes on per speed [s]
    states: int  # of the environment


class DisplayMemory(NamedTuple):
    """Buffers of one axis."""

    positions: Buffer  # of the SYNCs whose forces have not come [m or rad]
    commands: Buffer  # the last ones sent, a ring [m/s or rad/s]
    inner: Buffer  # states of the environment


@dataclass(slots=True)
class DisplayMotion:
    """What is remembered of the commands."""

    speed: float = 0.0  # of the last command [m/s or rad/s]
    newest: int = 0  # place of the last command


def motion_settings(
    environment: DisplayEnvironment, properties: DisplayProperties, lag: float = 0.0
) -> DisplayMotionSettings:
    """Returns what is fixed for a run; `lag` is the drive's moving mass over its gain [s]."""
    time = properties.sample_time
    return DisplayMotionSettings(
        time, properties.delay, properties.speed_quantum, properties.speed_limit, properties.acceleration_limit * time,
        max(environment.lower_wall, properties.position_low), min(environment.upper_wall, properties.position_high),
        lag, environment.states,
    )  # fmt: skip


def display_memory(
    port: PortSettings, motion: DisplayMotionSettings, kept: int, make_buffer: MakeBuffer
) -> DisplayMemory:
    """Returns the buffers of one axis that keeps so many commands."""
    return DisplayMemory(port_positions(port, make_buffer), make_buffer(kept), make_buffer(motion.states))


def send(motion: DisplayMotion, commands: Buffer, speed: float) -> None:
    """Keeps a command as the newest."""
    motion.newest = motion.newest + 1 if motion.newest + 1 < len(commands) else 0
    commands[motion.newest] = speed
    motion.speed = speed


def sent(motion: DisplayMotion, commands: Buffer, age: int) -> float:
    """Returns a command [m/s or rad/s]; age 0 is the newest."""
    return commands[motion.newest - age]


def limited(
    settings: DisplayMotionSettings,
    motion: DisplayMotion,
    commands: Buffer,
    wish: float,
    position: float,
    velocity: float,
) -> float:
    """Returns the nearest command that speed, acceleration and position limits allow [m/s or rad/s].

    A command may always fall to zero. Towards a limit of the position there is room for the commands under way and for
    the way that the drive needs to follow; from beyond it the command leads back, slowly: a drive without an integral
    yields to a hand that pushes.
    """
    last, step = motion.speed, settings.step
    high = (last if last > 0.0 else 0.0) + step
    low = (last if last < 0.0 else 0.0) - step
    high, low = min(high, settings.fastest), max(low, -settings.fastest)
    ahead = position + settings.lag * velocity
    for age in range(settings.delay):
        ahead += settings.sample_time * sent(motion, commands, age)
    span = settings.sample_time + settings.lag
    room, rest = (settings.high - ahead) / span, (settings.low - ahead) / span
    wish = min(wish, room if room > 0.0 else _BACK * room)
    wish = max(wish, rest if rest < 0.0 else _BACK * rest)
    return min(max(wish, low), high)


def whole(settings: DisplayMotionSettings, speed: float) -> float:
    """Returns a command in whole quanta, towards zero [m/s or rad/s]."""
    if settings.quantum == 0.0 or abs(speed) == inf:
        return speed
    return copysign(int(abs(speed) / settings.quantum + 1e-9) * settings.quantum, speed) if speed else 0.0
