"""The unprotected environment, and the step shared by the algorithms without a certificate.

Each of them is a parameter model and a function `respond`, of which `display_kernel` makes a kernel. What sampling, the
drive and the uncertainty of the account create is booked as `gen`, what they lose as `leak`, so that the account closes
like every other.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Generic, NamedTuple, TypeAlias

from canhaptic.control.admittance.admittance_environment import (
    AdmittanceEnvironment,
    AdmittanceMemory,
    AdmittanceMotion,
    AdmittanceMotionSettings,
    display_memory,
    limited,
    motion_settings,
    send,
    whole,
)
from canhaptic.control.admittance.port import AdmittanceProperties, Port, PortSettings, begin_port, book, port_settings
from canhaptic.control.balance import AT_REST, Branch, Certificate, EnergyBalance
from canhaptic.control.environments.environment import plain
from canhaptic.kernels import GivenT, Kernel, MakeBuffer, Run, new
from canhaptic.kernels.records import filled
from canhaptic.units import Parameters

_EXACT, _FREE, _NONE = Branch.EXACT.value, Branch.FREE.value, Certificate.NONE.value


class NothingToChoose(Parameters):
    """Parameters of an admittance algorithm without any."""


@dataclass(frozen=True, slots=True)
class AdmittanceSettings(Generic[GivenT]):
    """Constants of a run of an algorithm without a certificate."""

    given: GivenT  # parameters of the algorithm; a kernel reads their numbers alone
    port: PortSettings
    motion: AdmittanceMotionSettings


@dataclass(slots=True)
class AdmittanceState:
    """State kept from SYNC to SYNC."""

    axis: Port = field(default_factory=Port)
    motion: AdmittanceMotion = field(default_factory=AdmittanceMotion)
    h_s: float = 0.0  # [J]
    energy: float = 0.0  # of the algorithm's own: observed, in the tank, or still to be dissipated [J]
    created: float = 0.0  # created by sampling in the last hold; below 0 it was lost [J]
    slip: float = 0.0  # speed in the last command that dissipates [m/s or rad/s]


AdmittanceRun: TypeAlias = Run[AdmittanceSettings[GivenT], AdmittanceState, AdmittanceMemory]
"""Settings, state and memory of an algorithm with given parameters."""


class SampledHold(NamedTuple):
    """The hold that ended, and the next state of the mass."""

    energy: float  # that came in, at least [J]
    elapsed: float  # [s]
    velocity: float  # [m/s or rad/s]
    before: float  # the last command [m/s or rad/s]
    request: float  # speed of the mass after another hold [m/s or rad/s]
    force: float  # of the hand at its end [N or N*m]


class AdmittanceReply(NamedTuple):
    """Command of an algorithm after a hold."""

    request: float  # speed of the mass [m/s or rad/s]
    slip: float  # speed in addition, that dissipates [m/s or rad/s]
    h_pas: float  # energy of the hold that the slip of the last command took in [J]


def settings_of(
    environment: AdmittanceEnvironment, parameters: Parameters, properties: AdmittanceProperties
) -> AdmittanceSettings[Any]:
    """Constants of a run."""
    return AdmittanceSettings(plain(parameters), port_settings(properties), motion_settings(environment, properties))


def memory_of(settings: AdmittanceSettings[Any], make_buffer: MakeBuffer) -> AdmittanceMemory:
    """Return the buffers of one axis."""
    return display_memory(settings.port, settings.motion, settings.motion.delay + 1, make_buffer)


def respond(environment: AdmittanceEnvironment, run: AdmittanceRun[Any], hold: SampledHold) -> AdmittanceReply:
    """Placeholder of an algorithm: the command after a hold."""
    raise NotImplementedError


def first_energy(environment: Any, given: Any, position: float) -> float:
    """Energy with which an algorithm starts at the first position [J]."""
    return 0.0


def step(
    environment: AdmittanceEnvironment, run: AdmittanceRun[Any], position: float, torque_applied: float
) -> EnergyBalance:
    """Book the hold that ended and advance the mass; see `Controller.step`."""
    settings, state, memory = run.settings, run.state, run.memory
    force = -torque_applied
    if not state.axis.started:
        begin_port(state.axis, memory.positions, position, force)
        state.energy = first_energy(environment, settings.given, position)
        return AT_REST
    booked = book(settings.port, state.axis, memory.positions, position, force)
    before = state.motion.speed - state.slip
    request = environment.speed_after(memory.inner, before, force, position, settings.motion.sample_time)
    hold = new(SampledHold, (booked.energy, booked.elapsed, booked.moved / booked.elapsed, before, request, force))
    return command(environment, run, hold, respond(environment, run, hold))


def command(
    environment: AdmittanceEnvironment, run: AdmittanceRun[Any], hold: SampledHold, reply: AdmittanceReply
) -> EnergyBalance:
    """Send a speed and close the account of the hold."""
    settings, state, memory = run.settings, run.state, run.memory
    request, slip, h_pas = reply
    motion, commands, position = state.motion, memory.commands, state.axis.position
    speed = limited(settings.motion, motion, commands, request + slip, position, hold.velocity)
    send(motion, commands, whole(settings.motion, speed))
    state.slip = slip if abs(speed - request - slip) < abs(slip) else 0.0
    own = motion.speed - state.slip
    environment.go_along(memory.inner, hold.before, own, settings.motion.sample_time)
    h_s = environment.stored(memory.inner, own, position)
    h_r = environment.damping * hold.before * hold.before * hold.elapsed
    rest = state.h_s + hold.energy - h_pas - h_r - h_s
    state.h_s, state.created = h_s, -rest
    gen, leak = max(0.0, -rest), max(0.0, rest)
    branch = _EXACT if motion.speed != 0.0 or hold.before != 0.0 else _FREE
    return new(EnergyBalance, (
        motion.speed, hold.energy, h_pas, hold.energy - h_pas, h_r, h_s, 0.0, gen, 0.0, leak, 0.0, branch,
        environment.damping, _NONE, environment.stretch(position),
    ))  # fmt: skip


def display_kernel(
    respond_as: Callable[[Any, Any, SampledHold], AdmittanceReply],
    first_energy_as: Callable[[Any, Any, float], float] = first_energy,
    settings: Callable[..., AdmittanceSettings[Any]] = settings_of,
) -> Kernel:
    """Return the kernel of an algorithm with these functions in the place of `respond` and `first_energy`."""
    made = filled(step, respond=respond_as, first_energy=first_energy_as)
    return Kernel(settings, AdmittanceState, memory_of, made)
