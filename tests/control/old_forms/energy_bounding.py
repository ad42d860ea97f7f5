from dataclasses import dataclass, field
from math import sqrt
from typing import ClassVar

from canhaptic.control.balance import AT_REST, Certificate, EnergyBalance, RunningSum, add
from canhaptic.control.damping import DamperVelocity
from canhaptic.control.environments.environment import Environment
from canhaptic.control.passivity.controller import LoopProperties
from canhaptic.control.passivity.stepped import towards_zero
from canhaptic.errors import ParameterError
from canhaptic.kernels import Buffer, new
from canhaptic.units import Parameters
from tests.control.old_forms.hold_account import (
    Axis,
    AxisMemory,
    Hold,
    HoldAccount,
    HoldSettings,
    close_hold,
    hold_memory,
    hold_settings,
    open_hold,
)
from tests.control.old_forms.kernel import Kernel
from tests.control.old_forms.sampled_model import SampledModel, begin_model, follow, settle
from tests.control.old_forms.stepped import SteppedController


class EnergyBoundingParameters(DamperVelocity):
    pass


@dataclass(frozen=True, slots=True)
class _EnergyBoundingSettings:
    device_damping: float
    longest: float
    count: float
    quantum: float
    hold: HoldSettings


@dataclass(slots=True)
class _EnergyBoundingState:
    axis: Axis = field(default_factory=Axis)
    model: SampledModel = field(default_factory=SampledModel)
    energy: RunningSum = field(default_factory=RunningSum)
    torque: float = 0.0
    changes: float = 0.0


def settings_of(
    environment: Environment, parameters: EnergyBoundingParameters, loop: LoopProperties
) -> _EnergyBoundingSettings:
    if not loop.device_damping:
        raise ParameterError(
            f"energy_bounding: got device_damping {loop.device_damping!r}, expected > 0; "
            f"it renders nothing without certain damping: "
            "measure it and give passivity.device_damping, or choose another algorithm"
        )
    timing = loop.timing
    promised = Certificate.NONE if timing.late else Certificate.DEVICE_DAMPING
    hold = hold_settings(parameters, loop, promised)
    return _EnergyBoundingSettings(loop.device_damping, timing.longest, loop.encoder_count, loop.torque_quantum, hold)


def step(
    environment: Environment,
    settings: _EnergyBoundingSettings,
    state: _EnergyBoundingState,
    memory: AxisMemory,
    position: float,
    torque_applied: float,
) -> EnergyBalance:
    axis, model = (state.axis, state.model)
    if not axis.started:
        begin_model(environment, axis, model, memory, position)
        return AT_REST
    hold = open_hold(settings.hold, axis, memory, position, torque_applied)
    energy = known_energy(settings, state, hold, torque_applied)
    branch, h_r, contact, spring, damper = follow(environment, model, position, hold)
    wanted = abs(spring + damper)
    share = bounded_share(settings, memory.commands.torques, axis.oldest, energy, wanted)
    gen, leak = settle(environment, model, share, hold.h_i, h_r)
    if settings.quantum > 0.0 and wanted > 0.0:
        share = towards_zero(share * wanted, settings.quantum) / wanted
    efforts = (spring * share, damper * share, 0.0)
    account = new(HoldAccount, (branch, h_r, gen, 0.0, leak))
    rendered = environment.damping * share if contact else 0.0
    return close_hold(settings.hold, axis, memory, hold, account, efforts, rendered, model.state, model.h_s)


def known_energy(
    settings: _EnergyBoundingSettings, state: _EnergyBoundingState, hold: Hold, torque_applied: float
) -> float:
    count, periods = (settings.count, hold.elapsed / settings.hold.sample_time)
    moved = max(0.0, abs(hold.displacement) - count)
    booked = add(state.energy, hold.h_i + settings.device_damping * (moved * moved) / (periods * settings.longest))
    state.changes += abs(torque_applied - state.torque)
    state.torque = torque_applied
    return booked - 0.5 * count * (state.changes + abs(torque_applied))


def bounded_share(
    settings: _EnergyBoundingSettings, torques: Buffer, oldest: int, energy: float, wanted: float
) -> float:
    square = 4.0 * settings.device_damping / settings.longest * energy
    for place in range(oldest + 1 - len(torques), oldest):
        square -= torques[place] * torques[place]
    if wanted * wanted <= square:
        return 1.0
    return sqrt(square) / wanted if square > 0.0 else 0.0


class EnergyBounding(SteppedController):
    parameters_type: ClassVar[type[Parameters]] = EnergyBoundingParameters
    kernel: ClassVar[Kernel] = Kernel(settings_of, _EnergyBoundingState, hold_memory, step)
