"""`energy_bounding`: the torque is bounded by the certain dissipation of the device (ref. [5]).

Device damping b dissipates at least (b / T) dx^2 in every hold. With the account E_n = E_(n-1) + (b/T) dx^2 - F dx the
next hold ends with E_n + (b/T) dx^2 - F dx >= 0 for EVERY motion dx exactly when F^2 <= 4 E_n b / T. A torque f that is
already queued may cost up to f^2 T / 4b first, so with delay its square is subtracted. This is the device-damping
certificate; it limits rendering to a stiffness of about 2 b / T.

T is the longest duration of a hold, and E_n is reduced by the encoder's uncertainty: a position is uncertain by half a
count e, so that dx counts as |dx| - 2e in the dissipated energy, and e (|F_n| + sum |F_k - F_(k-1)|) of the energy may
not have been received (`axis_meter`). The command is rounded towards zero, to whole torque steps of the drive. The
proof needs one torque per hold: if an older one acts in a part of it (window, lag), nothing is certified.
"""

from dataclasses import dataclass, field
from math import inf, sqrt

from canhaptic.control.balance import Certificate, RunningSum, add
from canhaptic.control.damping import DamperVelocity
from canhaptic.control.environments import Environment
from canhaptic.control.passivity import LoopProperties, unprotected
from canhaptic.control.passivity.stepped import Hold, SteppedController, hold_settings, towards_zero
from canhaptic.control.passivity.unprotected import Asked, Reply, SampledRun
from canhaptic.errors import ParameterError
from canhaptic.kernels import Buffer, new


class EnergyBoundingParameters(DamperVelocity):
    """Parameters of `energy_bounding`: how the damper's velocity is measured. Device damping is set for the loop."""


@dataclass(frozen=True, slots=True)
class Device:
    """Properties of the device on which the bound of the torque relies."""

    damping: float  # certain [N*s/m or N*m*s/rad]
    longest: float  # hold [s]
    count: float  # of the encoder [m or rad]
    quantum: float  # of the torque command; 0: ideal [N or N*m]


@dataclass(slots=True)
class _EnergyBoundingState(unprotected.SampledState):
    """State kept from SYNC to SYNC."""

    energy: RunningSum = field(default_factory=RunningSum)  # E_n [J]
    torque: float = 0.0  # of the hold that ended [N or N*m]
    changes: float = 0.0  # sum of the changes of it [N or N*m]


def settings_of(
    environment: Environment, parameters: EnergyBoundingParameters, loop: LoopProperties
) -> unprotected.SampledSettings[Device]:
    """Return the constants of a run.

    Raises:
        ParameterError: No device damping is declared.
    """
    if not loop.device_damping:
        raise ParameterError(
            f"energy_bounding: got device_damping {loop.device_damping!r}, expected > 0; it renders nothing "
            "without certain damping: measure it and give passivity.device_damping "
            "(--set passivity.device_damping=0.1), or choose another algorithm"
        )
    timing = loop.timing
    promised = Certificate.NONE if timing.late else Certificate.DEVICE_DAMPING
    device = Device(loop.device_damping, timing.longest, loop.encoder_count, loop.torque_quantum)
    return unprotected.SampledSettings(device, inf, hold_settings(parameters, loop, promised))


def respond(run: SampledRun[Device, _EnergyBoundingState], hold: Hold, asked: Asked) -> Reply:
    """Send the model's torque, reduced so far that the device dissipates all energy that it may generate."""
    state, device, wanted = run.state, run.settings.given, abs(asked.spring + asked.damper)
    energy = known_energy(device, run.settings.hold.sample_time, state, hold)
    stored = share = bounded_share(device, run.memory.axis.commands.torques, state.axis.oldest, energy, wanted)
    if device.quantum > 0.0 and wanted > 0.0:
        share = towards_zero(share * wanted, device.quantum) / wanted
    return new(Reply, (stored, asked.spring * share, asked.damper * share, 0.0, asked.damping * share))


def known_energy(device: Device, sample_time: float, state: _EnergyBoundingState, hold: Hold) -> float:
    """Book the hold that ended; return the energy received and dissipated, E_n, less the encoder's uncertainty [J]."""
    count, periods = device.count, hold.elapsed / sample_time
    moved = max(0.0, abs(hold.displacement) - count)
    booked = add(state.energy, hold.h_i + device.damping * (moved * moved) / (periods * device.longest))
    state.changes += abs(hold.torque - state.torque)
    state.torque = hold.torque
    return booked - 0.5 * count * (state.changes + abs(hold.torque))


def bounded_share(device: Device, torques: Buffer, oldest: int, energy: float, wanted: float) -> float:
    """Return the largest fraction of a requested torque for which the device's dissipation suffices, 0..1.

    Args:
        device: Guaranteed properties of the device.
        torques: Ring buffer of queued torques [N or N*m].
        oldest: Index of the torque whose hold ended; the others act before the wanted one.
        energy: Energy from `known_energy` [J].
        wanted: Magnitude of the torque [N or N*m].
    """
    square = 4.0 * device.damping / device.longest * energy
    for place in range(oldest + 1 - len(torques), oldest):
        square -= torques[place] * torques[place]
    if wanted * wanted <= square:
        return 1.0
    return sqrt(square) / wanted if square > 0.0 else 0.0


class EnergyBounding(SteppedController):
    """Controller that renders the environment with a torque bounded by the declared damping of the device."""

    parameters_type = EnergyBoundingParameters
    kernel = unprotected.sampled_kernel(respond, _EnergyBoundingState, settings_of)
