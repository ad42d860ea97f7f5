"""`unprotected` of an admittance display: the virtual mass as it is, and what sampling and the drive make of it."""

from dataclasses import dataclass, field
from typing import ClassVar

from canhaptic.control.admittance.display_controller import DisplayController
from canhaptic.control.admittance.motion import (
    DisplayMemory,
    Motion,
    MotionSettings,
    accelerated,
    display_memory,
    limited,
    motion_settings,
    send,
    sent,
    whole,
)
from canhaptic.control.admittance.port import Port, PortSettings, begin_port, book, port_settings
from canhaptic.control.admittance.properties import DisplayProperties
from canhaptic.control.admittance.virtual_mass import VirtualMass
from canhaptic.control.balance import AT_REST, Branch, Certificate, EnergyBalance
from canhaptic.kernels import Kernel, MakeBuffer, new
from canhaptic.units import Parameters

_EXACT, _FREE, _NONE = Branch.EXACT.value, Branch.FREE.value, Certificate.NONE.value


class UnprotectedDisplayParameters(Parameters):
    """Of an admittance display: nothing to choose."""


@dataclass(frozen=True, slots=True)
class DisplaySettings:
    """What is fixed for a run of an algorithm without a certificate."""

    port: PortSettings
    motion: MotionSettings


@dataclass(slots=True)
class _UnprotectedState:
    """What is remembered between two SYNCs."""

    axis: Port = field(default_factory=Port)
    motion: Motion = field(default_factory=Motion)
    h_s: float = 0.0  # [J]


def settings_of(
    environment: VirtualMass, _parameters: UnprotectedDisplayParameters, properties: DisplayProperties
) -> DisplaySettings:
    """Returns what is fixed for a run."""
    return DisplaySettings(port_settings(properties), motion_settings(environment, properties))


def memory_of(settings: DisplaySettings, make_buffer: MakeBuffer) -> DisplayMemory:
    """Returns the buffers of one axis."""
    return display_memory(settings.port, settings.motion.delay + 1, make_buffer)


def step(
    environment: VirtualMass,
    settings: DisplaySettings,
    state: _UnprotectedState,
    memory: DisplayMemory,
    position: float,
    torque_applied: float,
) -> EnergyBalance:
    """Moves the virtual mass on under the last force; see `Controller.step`."""
    motion, commands, force = state.motion, memory.commands, -torque_applied
    if not state.axis.started:
        begin_port(state.axis, memory.positions, position, force)
        return AT_REST
    hold = book(settings.port, state.axis, memory.positions, position, force)
    before = sent(motion, commands, 0)
    wish = accelerated(environment, settings.motion, before, force, position)
    wish = limited(settings.motion, motion, commands, wish, position, hold.moved / hold.elapsed)
    send(motion, commands, whole(settings.motion, wish))
    h_s = 0.5 * environment.mass * motion.speed * motion.speed + environment.potential(position)
    h_r = environment.damping * before * before * hold.elapsed
    rest = state.h_s + hold.energy - h_r - h_s
    state.h_s = h_s
    branch = _EXACT if motion.speed != 0.0 or before != 0.0 else _FREE
    return new(EnergyBalance, (
        motion.speed, hold.energy, 0.0, hold.energy, h_r, h_s, 0.0, max(0.0, -rest), 0.0, max(0.0, rest), 0.0, branch,
        environment.damping, _NONE, environment.stretch(position),
    ))  # fmt: skip


class Unprotected(DisplayController):
    """The virtual mass without protection."""

    parameters_type: ClassVar[type[Parameters]] = UnprotectedDisplayParameters
    kernel: ClassVar[Kernel] = Kernel(settings_of, _UnprotectedState, memory_of, step)
