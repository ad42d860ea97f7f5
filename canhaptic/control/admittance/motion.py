"""Motion of the rendered environment, its limits, and the commands under way."""

from dataclasses import dataclass
from math import inf
from typing import Final, NamedTuple

from canhaptic.control.admittance.display_environment import DisplayEnvironment
from canhaptic.control.admittance.port import PortSettings, port_positions
from canhaptic.control.admittance.properties import DisplayProperties
from canhaptic.kernels import Buffer, MakeBuffer

_BACK: Final = 0.125
"""Part of the way back that a command takes on in the time of a hold and of the drive's lag."""


@dataclass(frozen=True, slots=True)
class DisplayMotionSettings:
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


class DisplayMemory(NamedTuple):
    """Buffers of one axis."""

    positions: Buffer  # of the SYNCs whose forces have not come [m or rad]
    commands: Buffer  # the last ones sent, a ring [m/s or rad/s]
    inner: Buffer  # states of the environment


@dataclass(slots=True)
class DisplayMotion:
    """State of the commands."""

    speed: float = 0.0  # of the last command [m/s or rad/s]
    newest: int = 0  # place of the last command


def motion_settings(
    environment: DisplayEnvironment, properties: DisplayProperties, lag: float = 0.0
) -> DisplayMotionSettings:
    """Constants of a run; `lag` is the drive's moving mass over its gain [s]."""
    time = properties.sample_time
    return DisplayMotionSettings(
        time, properties.delay, properties.speed_quantum, properties.speed_limit, properties.acceleration_limit * time,
        max(environment.lower_wall, properties.position_low), min(environment.upper_wall, properties.position_high),
        lag, environment.states,
    )  # fmt: skip


def display_memory(
    port: PortSettings, motion: DisplayMotionSettings, kept: int, make_buffer: MakeBuffer
) -> DisplayMemory:
    """Buffers of one axis that keeps this number of commands."""
    return DisplayMemory(port_positions(port, make_buffer), make_buffer(kept), make_buffer(motion.states))


def send(motion: DisplayMotion, commands: Buffer, speed: float) -> None:
    """Keep a command as the newest."""
    motion.newest = motion.newest + 1 if motion.newest + 1 < len(commands) else 0
    commands[motion.newest] = speed
    motion.speed = speed


def sent(motion: DisplayMotion, commands: Buffer, age: int) -> float:
    """Return a command [m/s or rad/s]; age 0 is the newest."""
    return commands[motion.newest - age]


def limited(
    settings: DisplayMotionSettings,
    motion: DisplayMotion,
    commands: Buffer,
    wish: float,
    position: float,
    velocity: float,
) -> float:
    """Return the nearest command that speed, acceleration and position limits allow [m/s or rad/s].

    A command may always go to zero. Towards a position limit, room is left for the commands under way and for the
    distance that the drive needs to follow; beyond it the command leads back, slowly: a drive without an integral
    yields to a hand that pushes.
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
    wish = room if wish > room else wish
    wish = rest if wish < rest else wish
    high, low = most if high > most else high, -most if low < -most else low
    wish = low if wish < low else wish
    return high if wish > high else wish


def whole(settings: DisplayMotionSettings, speed: float) -> float:
    """Round a command towards zero to whole quanta [m/s or rad/s]."""
    quantum = settings.quantum
    if quantum == 0.0 or speed in (inf, -inf):
        return speed
    return int(speed / quantum + 1e-9 if speed > 0.0 else speed / quantum - 1e-9) * quantum
