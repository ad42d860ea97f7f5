from dataclasses import dataclass, field
from typing import NamedTuple

from canhaptic.control.admittance.display_environment import (
    DisplayEnvironment,
    DisplayMemory,
    DisplayMotion,
    DisplayMotionSettings,
    display_memory,
    limited,
    motion_settings,
    send,
    whole,
)
from canhaptic.control.admittance.port import DisplayProperties, Port, PortSettings, book, port_settings
from canhaptic.control.balance import Branch, Certificate, EnergyBalance
from canhaptic.kernels import MakeBuffer, new
from canhaptic.units import Parameters

_EXACT, _FREE, _NONE = (Branch.EXACT.value, Branch.FREE.value, Certificate.NONE.value)


class NothingToChoose(Parameters):
    pass


@dataclass(frozen=True, slots=True)
class DisplaySettings:
    port: PortSettings
    motion: DisplayMotionSettings


@dataclass(slots=True)
class DisplayState:
    axis: Port = field(default_factory=Port)
    motion: DisplayMotion = field(default_factory=DisplayMotion)
    h_s: float = 0.0
    energy: float = 0.0
    slip: float = 0.0


class SampledHold(NamedTuple):
    energy: float
    elapsed: float
    velocity: float
    before: float
    wish: float


def settings_of(
    environment: DisplayEnvironment, _parameters: Parameters, properties: DisplayProperties
) -> DisplaySettings:
    return DisplaySettings(port_settings(properties), motion_settings(environment, properties))


def memory_of(settings: DisplaySettings, make_buffer: MakeBuffer) -> DisplayMemory:
    return display_memory(settings.port, settings.motion, settings.motion.delay + 1, make_buffer)


def follow(
    environment: DisplayEnvironment,
    settings: DisplaySettings,
    state: DisplayState,
    memory: DisplayMemory,
    position: float,
    force: float,
) -> SampledHold:
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
    motion, commands, position = (state.motion, memory.commands, state.axis.position)
    speed = limited(settings.motion, motion, commands, wish + slip, position, hold.velocity)
    send(motion, commands, whole(settings.motion, speed))
    state.slip = slip if abs(speed - wish - slip) < abs(slip) else 0.0
    own = motion.speed - state.slip
    environment.go_along(memory.inner, hold.before, own, settings.motion.sample_time)
    h_s = environment.stored(memory.inner, own, position)
    h_r = environment.damping * hold.before * hold.before * hold.elapsed
    rest = state.h_s + hold.energy - h_pas - h_r - h_s
    state.h_s = h_s
    gen, leak = (max(0.0, -rest), max(0.0, rest))
    branch = _EXACT if motion.speed != 0.0 or hold.before != 0.0 else _FREE
    return new(
        EnergyBalance,
        (
            motion.speed,
            hold.energy,
            h_pas,
            hold.energy - h_pas,
            h_r,
            h_s,
            0.0,
            gen,
            0.0,
            leak,
            0.0,
            branch,
            environment.damping,
            _NONE,
            environment.stretch(position),
        ),
    )
