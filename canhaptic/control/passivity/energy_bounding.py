"""`energy_bounding`: the torque is bounded by what the device is certain to dissipate (ref. [5]).

Device damping b takes at least (b / T) dx^2 out of every hold. With the account E_n = E_(n-1) + (b/T) dx^2 - F dx the
next hold ends with E_n + (b/T) dx^2 - F dx >= 0 for EVERY motion dx exactly when F^2 <= 4 E_n b / T. A torque f that is
already under way may cost up to f^2 T / 4b first, so with delay its square is taken off. This is the device-damping
certificate; what it renders is limited to a stiffness of about 2 b / T.

T is the longest that a hold may be, and of E_n is taken what encoder counts hide: a position is unsure by half a count
e, so that dx counts as |dx| - 2e in what is dissipated, and e (|F_n| + sum |F_k - F_(k-1)|) of the energy may not have
come in (`axis_meter`). A drive takes whole steps of torque, to which the command is rounded towards zero. The proof
needs one torque in a hold: where an older one acts in a part of it (window, lag), nothing is certified.
"""

from dataclasses import dataclass, field
from math import sqrt
from typing import ClassVar

from canhaptic.control.balance import AT_REST, Certificate, EnergyBalance
from canhaptic.control.environments.environment import Environment
from canhaptic.control.passivity.controller import LoopProperties
from canhaptic.control.passivity.hold_account import (
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
from canhaptic.control.passivity.in_flight import towards_zero
from canhaptic.control.passivity.sampled_model import SampledModel, begin_model, follow, settle
from canhaptic.control.passivity.stepped import SteppedController
from canhaptic.control.running_sum import RunningSum, add
from canhaptic.control.velocity import DamperVelocity
from canhaptic.errors import ParameterError
from canhaptic.kernels import Buffer, Kernel, new
from canhaptic.units import Parameters


class EnergyBoundingParameters(DamperVelocity):
    """Nothing to choose but the velocity of the damper: the device damping is a property of the loop."""


@dataclass(frozen=True, slots=True)
class _EnergyBoundingSettings:
    """Constants of a run."""

    device_damping: float  # certain [N*s/m or N*m*s/rad]
    longest: float  # hold [s]
    count: float  # of the encoder [m or rad]
    quantum: float  # of the torque command; 0: ideal [N or N*m]
    hold: HoldSettings


@dataclass(slots=True)
class _EnergyBoundingState:
    """State kept from SYNC to SYNC."""

    axis: Axis = field(default_factory=Axis)
    model: SampledModel = field(default_factory=SampledModel)
    energy: RunningSum = field(default_factory=RunningSum)  # E_n [J]
    torque: float = 0.0  # of the hold that ended [N or N*m]
    changes: float = 0.0  # sum of the changes of it [N or N*m]


def settings_of(
    environment: Environment, parameters: EnergyBoundingParameters, loop: LoopProperties
) -> _EnergyBoundingSettings:
    """Returns what is fixed for a run.

    Raises:
        ParameterError: No certain damping is known.
    """
    if not loop.device_damping:
        raise ParameterError(
            f"energy_bounding: got device_damping {loop.device_damping!r}, expected > 0; it renders nothing "
            "without certain damping: measure it and give passivity.device_damping "
            "(--set passivity.device_damping=0.1), or choose another algorithm"
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
    """Accounts for the hold that ended; see `Controller.step`."""
    axis, model = state.axis, state.model
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
    efforts = spring * share, damper * share, 0.0
    account = new(HoldAccount, (branch, h_r, gen, 0.0, leak))
    rendered = environment.damping * share if contact else 0.0
    return close_hold(settings.hold, axis, memory, hold, account, efforts, rendered, model.state, model.h_s)


def known_energy(
    settings: _EnergyBoundingSettings, state: _EnergyBoundingState, hold: Hold, torque_applied: float
) -> float:
    """Takes the hold that ended and returns E_n less what the counts of the encoder hide [J]."""
    count, periods = settings.count, hold.elapsed / settings.hold.sample_time
    moved = max(0.0, abs(hold.displacement) - count)
    booked = add(state.energy, hold.h_i + settings.device_damping * (moved * moved) / (periods * settings.longest))
    state.changes += abs(torque_applied - state.torque)
    state.torque = torque_applied
    return booked - 0.5 * count * (state.changes + abs(torque_applied))


def bounded_share(
    settings: _EnergyBoundingSettings, torques: Buffer, oldest: int, energy: float, wanted: float
) -> float:
    """Returns the part of a wanted torque that is within the bound, 0..1.

    Args:
        settings: Of the run.
        torques: In flight, a ring [N or N*m].
        oldest: Place of the one whose hold ended; the others act before the wanted one.
        energy: As `known_energy` has it [J].
        wanted: Size of the torque [N or N*m].
    """
    square = 4.0 * settings.device_damping / settings.longest * energy
    for place in range(oldest + 1 - len(torques), oldest):
        square -= torques[place] * torques[place]
    if wanted * wanted <= square:
        return 1.0
    return sqrt(square) / wanted if square > 0.0 else 0.0


class EnergyBounding(SteppedController):
    """The sampled environment, its torque bounded by certain device damping."""

    parameters_type: ClassVar[type[Parameters]] = EnergyBoundingParameters
    kernel: ClassVar[Kernel] = Kernel(settings_of, _EnergyBoundingState, hold_memory, step)
