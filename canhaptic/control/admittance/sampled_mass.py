"""The environment sampled as it is: what the algorithms without a certificate share.

What sampling, the drive and the doubt of the account create is booked as `gen`, what they lose as `leak`, so that the
account closes like every other.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

from canhaptic.control.admittance.display_environment import DisplayEnvironment
from canhaptic.control.admittance.motion import (
    DisplayMemory,
    DisplayMotion,
    DisplayMotionSettings,
    display_memory,
    limited,
    motion_settings,
    send,
    whole,
)
from canhaptic.control.admittance.port import Port, PortSettings, book, port_settings
from canhaptic.control.admittance.properties import DisplayProperties
from canhaptic.control.balance import Branch, Certificate, EnergyBalance
from canhaptic.kernels import MakeBuffer, new
from canhaptic.units import Parameters

_EXACT, _FREE, _NONE = Branch.EXACT.value, Branch.FREE.value, Certificate.NONE.value


class NothingToChoose(Parameters):
    """Parameters of an admittance display: none."""


@dataclass(frozen=True, slots=True)
class DisplaySettings:
    """What is fixed for a run of an algorithm without a certificate."""

    port: PortSettings
    motion: DisplayMotionSettings


@dataclass(slots=True)
class DisplayState:
    """State kept from SYNC to SYNC."""

    axis: Port = field(default_factory=Port)
    motion: DisplayMotion = field(default_factory=DisplayMotion)
    h_s: float = 0.0  # [J]
    energy: float = 0.0  # of the algorithm's own: observed, in the tank, or still to be dissipated [J]
    slip: float = 0.0  # speed in the last command that dissipates [m/s or rad/s]


class SampledHold(NamedTuple):
    """One hold that ended, and where the mass goes on to."""

    energy: float  # that came in, at least [J]
    elapsed: float  # [s]
    velocity: float  # [m/s or rad/s]
    before: float  # the last command [m/s or rad/s]
    wish: float  # speed of the mass after another hold [m/s or rad/s]


def settings_of(
    environment: DisplayEnvironment, _parameters: Parameters, properties: DisplayProperties
) -> DisplaySettings:
    """Returns what is fixed for a run of an algorithm without settings of its own."""
    return DisplaySettings(port_settings(properties), motion_settings(environment, properties))


def memory_of(settings: DisplaySettings, make_buffer: MakeBuffer) -> DisplayMemory:
    """Returns the buffers of one axis."""
    return display_memory(settings.port, settings.motion, settings.motion.delay + 1, make_buffer)


def follow(
    environment: DisplayEnvironment,
    settings: DisplaySettings,
    state: DisplayState,
    memory: DisplayMemory,
    position: float,
    force: float,
) -> SampledHold:
    """Books the hold that ended and moves the mass on; `command` must follow."""
    hold = book(settings.port, state.axis, memory.positions, position, force)
    before = state.motion.speed - state.slip
    wish = environment.speed_after(memory.inner, before, force, position, settings.motion.sample_time)
    return new(SampledHold, (hold.energy, hold.elapsed, hold.moved / hold.elapsed, before, wish))


def command(
    environment: DisplayEnvironment,
    settings: DisplaySettings,
    state: DisplayState,
    memory: DisplayMemory,
    hold: SampledHold,
    h_pas: float,
    wish: float,
    slip: float,
) -> EnergyBalance:
    """Sends a speed and closes the account of the hold.

    Args:
        environment: What is rendered.
        settings: Of the run.
        state: Its mass and store change.
        memory: Of the axis.
        hold: That ended.
        h_pas: What of its energy the slip took in [J].
        wish: Speed of the mass [m/s or rad/s].
        slip: Speed besides, that dissipates [m/s or rad/s].
    """
    motion, commands, position = state.motion, memory.commands, state.axis.position
    speed = limited(settings.motion, motion, commands, wish + slip, position, hold.velocity)
    send(motion, commands, whole(settings.motion, speed))
    state.slip = slip if abs(speed - wish - slip) < abs(slip) else 0.0
    own = motion.speed - state.slip
    environment.go_along(memory.inner, hold.before, own, settings.motion.sample_time)
    h_s = environment.stored(memory.inner, own, position)
    h_r = environment.damping * hold.before * hold.before * hold.elapsed
    rest = state.h_s + hold.energy - h_pas - h_r - h_s
    state.h_s = h_s
    gen, leak = max(0.0, -rest), max(0.0, rest)
    branch = _EXACT if motion.speed != 0.0 or hold.before != 0.0 else _FREE
    return new(EnergyBalance, (
        motion.speed, hold.energy, h_pas, hold.energy - h_pas, h_r, h_s, 0.0, gen, 0.0, leak, 0.0, branch,
        environment.damping, _NONE, environment.stretch(position),
    ))  # fmt: skip
