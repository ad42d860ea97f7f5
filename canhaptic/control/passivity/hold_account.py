"""Opening and closing the account of one hold: the energy that came in, and the next command."""

from dataclasses import dataclass, field
from math import inf
from typing import Any, NamedTuple

from canhaptic.control.balance import Certificate, EnergyBalance
from canhaptic.control.damping import DamperVelocity, VelocityWindow, restart, update
from canhaptic.control.passivity.controller import LoopProperties
from canhaptic.control.passivity.stepped import Commands, as_far_as_limit, efforts_inside, no_commands, repeat, send
from canhaptic.kernels import Buffer, MakeBuffer, Run, new


@dataclass(frozen=True, slots=True)
class HoldSettings:
    """Settings of the account of a hold."""

    sample_time: float  # [s]
    delay: int  # whole holds between computation and action
    torque_limit: float  # largest torque that limiter and drive let act [N or N*m]
    tolerance: float  # of the velocity's window [m or rad]; 0: the damper uses the velocity of the last hold
    longest_window: int  # of the velocity, in samples; 0 without one
    certificate: int  # promise of the algorithm (`Certificate`)


@dataclass(slots=True)
class Axis:
    """Surplus, position and commands of one axis between two SYNCs."""

    started: bool = False
    position: float = 0.0  # [m or rad]
    moved: float = 0.0  # in the last hold [m or rad]
    missed: int = 0  # samples lost since
    lasted: float = 1.0  # the hold that ends next [sample times]: more where SYNCs were skipped
    oldest: int = 0  # place of the command whose hold ends next
    h_dis: float = 0.0  # surplus still to be dissipated [J]
    window: VelocityWindow = field(default_factory=VelocityWindow)


class AxisMemory(NamedTuple):
    """Buffers of one axis."""

    samples: Buffer  # of the velocity's window [m or rad]
    commands: Commands


class Hold(NamedTuple):
    """One completed hold; the efforts are parts of the applied torque."""

    displacement: float  # [m or rad]
    damper: float  # effort of the model's damper [N or N*m]
    h_i: float  # [J]
    h_pas: float  # [J]
    elapsed: float  # [s]; more than one sample time where positions were lost or SYNCs skipped
    velocity: float  # measured: of this hold, or from the window [m/s or rad/s]
    torque: float  # applied [N or N*m]
    missed: int  # samples lost within it


class HoldAccount(NamedTuple):
    """Account of one hold by an algorithm; energies in [J]."""

    branch: int
    h_r: float
    gen: float
    deficit: float
    leak: float


def hold_settings(parameters: DamperVelocity, loop: LoopProperties, certificate: Certificate) -> HoldSettings:
    """Constants of a run.

    Raises:
        ParameterError: A windowed velocity without an encoder count.
    """
    tolerance = parameters.window_tolerance(loop.encoder_count)
    longest = parameters.longest_window(loop.sample_time) if tolerance else 0
    limit = inf if loop.torque_limit is None else loop.torque_limit
    return HoldSettings(loop.sample_time, loop.delay, limit, tolerance, longest, certificate.value)


def axis_memory(delay: int, longest_window: int, make_buffer: MakeBuffer) -> AxisMemory:
    """Return the buffers of one axis.

    Args:
        delay: Whole holds between computation and action.
        longest_window: Longest window of the velocity, in samples; 0 without one.
        make_buffer: Constructor of a buffer, list or array.
    """
    return AxisMemory(make_buffer(longest_window + 1 if longest_window else 0), no_commands(delay, make_buffer))


class HoldMemory(NamedTuple):
    """Buffers of one axis, and of its algorithm."""

    axis: AxisMemory
    own: Buffer  # of the algorithm


def hold_memory(settings: Any, make_buffer: MakeBuffer, own: int = 0) -> HoldMemory:
    """Return the buffers of one axis for an algorithm whose settings have a `hold`, and its own of this length."""
    axis = axis_memory(settings.hold.delay, settings.hold.longest_window, make_buffer)
    return HoldMemory(axis, make_buffer(own))


def begin(axis: Axis, memory: AxisMemory, position: float) -> None:
    """Take the first position [m or rad]."""
    axis.started, axis.position, axis.missed, axis.lasted, axis.h_dis = True, position, 0, 1.0, 0.0
    if len(memory.samples) > 0:
        restart(axis.window, memory.samples, position)


def open_hold(settings: HoldSettings, axis: Axis, memory: AxisMemory, position: float, torque_applied: float) -> Hold:
    """Return the hold that ended.

    Args:
        settings: Constants of the run.
        axis: Axis; advanced to the position.
        memory: Buffers of the axis.
        position: Position at the end of the hold [m or rad].
        torque_applied: Torque applied in the hold [N or N*m].
    """
    displacement, missed = position - axis.position, axis.missed
    holds = missed + axis.lasted
    h_i, elapsed = -torque_applied * displacement, settings.sample_time * holds  # `interaction_energy`
    if missed:
        h_i -= let_samples_pass(axis, memory.commands, displacement, torque_applied, settings.torque_limit)
    damper, modulated = efforts_inside(memory.commands, axis.oldest, torque_applied)
    velocity = displacement / elapsed
    if settings.tolerance:
        if holds > 1.0:
            restart(axis.window, memory.samples, position)
        else:
            update(axis.window, memory.samples, settings.tolerance, elapsed, position)
            velocity = axis.window.velocity
    axis.position, axis.moved, axis.lasted = position, displacement, 1.0
    return new(Hold, (displacement, damper, h_i, modulated * displacement, elapsed, velocity, torque_applied, missed))


def let_samples_pass(
    axis: Axis, commands: Commands, displacement: float, torque_applied: float, torque_limit: float
) -> float:
    """Account for lost samples; return the largest error of torque applied times displacement [J].

    Within the holds the axis may have gone out and back, so that the excursion is not the displacement; it is taken
    as that and the motion before, for every lost hold. Any torque of the gap may have acted while SYNCs were skipped.

    Args:
        axis: The axis; its count of missing samples is cleared.
        commands: Commands of the axis.
        displacement: Total displacement of the holds [m or rad].
        torque_applied: Torque applied in the last of the holds [N or N*m].
        torque_limit: Largest torque that limiter and drive let act [N or N*m].
    """
    differences = largest = 0.0
    for _ in range(axis.missed):
        difference = abs(as_far_as_limit(commands.torques[axis.oldest], torque_limit) - torque_applied)
        differences, largest = differences + difference, max(largest, difference)
        axis.oldest = repeat(commands, axis.oldest)
    skipped = axis.lasted - 1.0
    excursion = abs(displacement) + (axis.missed + skipped) * abs(axis.moved)
    axis.missed = 0
    return (differences + skipped * largest) * excursion


def close_hold(
    run: Run[Any, Any, HoldMemory], hold: Hold, account: HoldAccount, efforts: tuple[float, float, float],
    rendered: float, state: float, h_s: float,
) -> EnergyBalance:  # fmt: skip
    """Send a command of given efforts (spring, damper, modulated) and return the balance of the hold.

    Args:
        run: Run of the algorithm; surplus and commands of its axis are updated.
        hold: The hold as it was opened.
        account: Account of the hold by the algorithm.
        efforts: Parts of the command [N or N*m].
        rendered: Total damping inside the command [N*s/m or N*m*s/rad].
        state: Displacement of the storage [m or rad].
        h_s: Energy stored at that displacement [J].
    """
    axis: Axis = run.state.axis
    h_i, h_pas = hold.h_i, hold.h_pas
    branch, h_r, gen, deficit, leak = account
    h_dis, paid = surplus_after(axis, hold, account)
    axis.h_dis = h_dis
    spring, damper, modulated = efforts
    torque = -spring - damper - modulated
    axis.oldest = send(run.memory.axis.commands, axis.oldest, torque, damper, modulated)
    return new(EnergyBalance, (
        torque, h_i, h_pas, h_i - h_pas, h_r, h_s, h_dis, gen, deficit, leak, paid, branch, rendered,
        run.settings.hold.certificate, state,
    ))  # fmt: skip


def surplus_after(axis: Axis, hold: Hold, account: HoldAccount) -> tuple[float, float]:
    """Surplus after a hold, and the part of the leak that reduced it [J]."""
    _, _, gen, deficit, leak = account
    surplus = axis.h_dis + gen + deficit - hold.h_pas
    paid = min(leak, surplus) if leak > 0.0 and surplus > 0.0 else 0.0
    return surplus - paid, paid
