"""Constants and state of `guarded` of an admittance display."""

from dataclasses import dataclass, field
from typing import NamedTuple

from canhaptic.control.admittance import declared_hand
from canhaptic.control.admittance.declared_hand import DeclaredHand, DeclaredHandSettings
from canhaptic.control.admittance.display_environment import DisplayEnvironment
from canhaptic.control.admittance.hand_force import HandForceSettings
from canhaptic.control.admittance.late_margin import LateMargin, MarginMemory, margin_memory
from canhaptic.control.admittance.loop_parameters import GuardedDisplayParameters, loop_settings
from canhaptic.control.admittance.motion import (
    DisplayMemory,
    DisplayMotion,
    DisplayMotionSettings,
    display_memory,
    motion_settings,
)
from canhaptic.control.admittance.port import Port, PortSettings, port_settings
from canhaptic.control.admittance.properties import DisplayProperties
from canhaptic.control.admittance.velocity_loop import LoopState, VelocityLoopSettings
from canhaptic.kernels import Buffer, MakeBuffer


@dataclass(frozen=True, slots=True)
class GuardedDisplaySettings:
    """Constants of a run."""

    port: PortSettings
    motion: DisplayMotionSettings
    loop: VelocityLoopSettings
    hand: HandForceSettings
    declared: DeclaredHandSettings
    allowance: float  # [J]
    may_be_limited: bool  # a torque at its limit would void the proof


@dataclass(slots=True)
class GuardedDisplayState:
    """State kept from SYNC to SYNC."""

    axis: Port = field(default_factory=Port)
    motion: DisplayMotion = field(default_factory=DisplayMotion)
    loop: LoopState = field(default_factory=LoopState)
    margin: LateMargin = field(default_factory=LateMargin)  # E - V
    hand: LateMargin = field(default_factory=LateMargin)  # E - G
    declared: DeclaredHand = field(default_factory=DeclaredHand)
    h_s: float = 0.0  # [J]
    surplus: float = 0.0  # [J]
    taken: float = 0.0  # dissipated or leaked so far, and not paid [J]
    limited: int = 0  # SYNCs for which a force may belong to a hold in which the drive was at its torque limit
    unsure: bool = False  # it may have done so where a certificate rested on that it does not
    by_encoder: float = 0.0  # E - V by encoder and commands alone, at least [J]
    by_force: float = 0.0  # E by the force, at most [J]


class GuardedMemory(NamedTuple):
    """Buffers of one axis."""

    display: DisplayMemory
    margin: MarginMemory
    hand: MarginMemory
    leads: Buffer  # a ring like those of the margins [m or rad]
    speeds: Buffer  # another, of the motion that the commands make [m/s or rad/s]


def settings_of(
    environment: DisplayEnvironment, parameters: GuardedDisplayParameters, properties: DisplayProperties
) -> GuardedDisplaySettings:
    """Constants of a run.

    Raises:
        ParameterError: A hand or losses are declared where their proof does not hold.
    """
    loop = loop_settings(parameters, properties)
    motion = motion_settings(environment, properties, loop.mass / loop.gain_least)
    hand = HandForceSettings(parameters.largest_hand_force)
    declared = declared_hand.declared_hand_settings(parameters, loop, properties.latency)
    ends = loop.integral > 0.0 or hand.force > 0.0 or declared.stiffness > 0.0
    return GuardedDisplaySettings(
        port_settings(properties), motion, loop, hand, declared, parameters.energy_allowance, ends
    )


def memory_of(settings: GuardedDisplaySettings, make_buffer: MakeBuffer) -> GuardedMemory:
    """Return the buffers of one axis."""
    kept, late = settings.loop.delay + settings.loop.losses + 2, settings.port.latency
    kept += late if settings.declared.stiffness > 0.0 else 0
    display = display_memory(settings.port, settings.motion, kept, make_buffer)
    return GuardedMemory(
        display, margin_memory(late, make_buffer), margin_memory(late, make_buffer), make_buffer(late + 1),
        declared_hand.speeds_of(late, make_buffer),
    )  # fmt: skip
