"""Common parts of one-axis passivity algorithms: the controller that steps a kernel, queued commands, energy of a hold.

With a delay of n samples, n + 1 commands are queued when a new one is computed (a synchronous RPDO delays by one).
The damper and modulated efforts of a command are stored with it, so that each hold is booked with those parts of the
torque that was applied in it. If it were booked with the newest efforts instead, the velocity of the paper's algorithm
would have a pole at -1.618 for a delay of one sample.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from math import inf, isfinite
from typing import Any, ClassVar, Final, NamedTuple

from canhaptic.control.balance import AT_REST, Certificate, EnergyBalance, held
from canhaptic.control.damping import DamperVelocity, VelocityWindow, restart, update
from canhaptic.control.passivity import LoopProperties
from canhaptic.errors import ControlError, ParameterError
from canhaptic.kernels import Buffer, Kernel, MakeBuffer, Run, list_of_zeros, new, with_quick_fields
from canhaptic.units import Parameters

_WHOLE: Final = 2.0**53
"""From this size on, every floating-point number is whole."""


class Commands(NamedTuple):
    """Queued torques and their damper and modulated efforts, ring buffers of shape (delay + 1,) [N or N*m].

    torque = -(spring + damper + modulated). With n = delay + 1 and `oldest` the index of the command whose hold ends
    next, the later commands are at oldest + 1 - n, oldest + 2 - n, ... and the newest is at oldest - 1.
    """

    torques: Buffer
    dampers: Buffer  # effort d v of the model's damper
    modulated: Buffer  # effort d_pas v of the modulated damper of eq. 19


def send(commands: Commands, oldest: int, torque: float, damper: float, modulated: float) -> int:
    """Queue a command in place of the one whose hold ended; return the index of the command whose hold ends next."""
    commands.torques[oldest] = torque
    commands.dampers[oldest] = damper
    commands.modulated[oldest] = modulated
    oldest += 1
    return oldest if oldest < len(commands.torques) else 0


def repeat(commands: Commands, oldest: int) -> int:
    """Queue the newest command again, because a drive without a new one repeats it; return the index as `send` does."""
    newest = oldest - 1
    return send(commands, oldest, commands.torques[newest], commands.dampers[newest], commands.modulated[newest])


def clipped(torque: float, torque_limit: float) -> float:
    """Return a torque, clipped to the largest size that limiter and drive let act [N or N*m]."""
    return min(max(torque, -torque_limit), torque_limit)


def towards_zero(torque: float, quantum: float) -> float:
    """Return a torque rounded towards 0 to a multiple of the drive's quantum [N or N*m]; a quantum of 0 is ideal."""
    if quantum == 0.0:
        return torque
    steps = torque / quantum
    return int(steps) * quantum if abs(steps) < _WHOLE else torque  # beyond it every number is whole; NaN stays


def efforts_inside(commands: Commands, oldest: int, torque_applied: float) -> tuple[float, float]:
    """Return the parts of the applied torque that are due to damper and modulated damper [N or N*m].

    If less than the sent torque was applied, both parts are reduced in proportion.
    """
    torque, damper, modulated = commands.torques[oldest], commands.dampers[oldest], commands.modulated[oldest]
    if torque_applied != torque and (damper != 0.0 or modulated != 0.0):
        share = min(1.0, max(0.0, torque_applied / torque)) if torque != 0.0 else 0.0
        return damper * share, modulated * share
    return damper, modulated


def settle(
    h_s: float, surplus: float, lost: float, ceiling: float, slack: float
) -> tuple[float, float, float, float, float, float]:
    """Book dissipation, deficit and leak of a hold; return (h_s, surplus, h_r, deficit, leak, paid) [J].

    Args:
        h_s: Stored energy with the energy of the hold; below 0 it is a deficit.
        surplus: Energy still to be dissipated.
        lost: Energy that the model dissipates; negative values count as 0.
        ceiling: Energy that the model stores at its true state; the stored energy is limited to it.
        slack: Part of `h_s` that the certificates of the queued torques do not need, so that it may be removed.
    """
    h_r = deficit = leak = paid = 0.0
    if lost > 0.0 and slack > 0.0:
        h_r = lost if lost < slack else slack
        h_s -= h_r
        slack -= h_r
    if h_s < 0.0:
        deficit, h_s = -h_s, 0.0
        surplus += deficit
    elif h_s > ceiling:
        paying = surplus if surplus > 0.0 else 0.0
        above, allowed = h_s - ceiling, paying + slack if slack > 0.0 else paying
        if above <= allowed:
            leak, h_s = above, ceiling
        else:
            leak = allowed
            h_s -= leak
        paid = leak if leak < paying else paying
        surplus -= paid
    return h_s, surplus, h_r, deficit, leak, paid


class SteppedController:
    """Controller that runs a kernel with the state of one axis, and refuses values that are not finite."""

    parameters_type: ClassVar[type[Parameters]]
    kernel: ClassVar[Kernel]
    wording: ClassVar[tuple[str, str, str, str]] = (
        "applied torque",
        "torque",
        "the encoder and its scaling",
        "stiffness and damping against the size of the motion",
    )
    """Words of the messages: second input, command, and what to check if an input or the command is not finite."""

    def __init_subclass__(cls) -> None:
        """Refuse a kernel whose step takes settings, state and memory one by one, as kernels once did.

        Raises:
            ParameterError: The step has other than four arguments.
        """
        kernel = vars(cls).get("kernel")
        if kernel is not None and kernel.step.__code__.co_argcount != 4:  # environment, run, position, torque applied
            raise ParameterError(
                f"{cls.__name__}: got a step of {kernel.step.__code__.co_argcount} arguments, expected (environment, "
                "run, position, torque_applied): settings, state and memory are fields of run; see docs/extending.md"
            )

    def __init__(self, environment: object, parameters: Parameters, loop: Parameters) -> None:
        """Prepare a run with parameters of `parameters_type`.

        Raises:
            ParameterError: A property that the algorithm needs is unknown.
        """
        self._environment = environment
        self._settings = self.kernel.settings(environment, parameters, loop)
        self.reset()

    def reset(self) -> None:
        """Clear the state: zero stored energy, no queued torque, no last position."""
        self._state = self.kernel.state()
        self._axis = self._state.axis
        self._memory = with_quick_fields(self.kernel.memory(self._settings, list_of_zeros))
        run = with_quick_fields(Run(self._settings, self._state, self._memory))
        self._advance: Callable[[float, float], EnergyBalance] = partial(self.kernel.step, self._environment, run)
        self._last = AT_REST

    def sample_lost(self) -> EnergyBalance:
        """Return the balance of a SYNC whose position was lost; see `Controller.sample_lost`."""
        command = self._command_unseen() if self._axis.started else self._last.torque
        return held(self._last, command)

    def _command_unseen(self) -> float:
        """Count a lost sample, and return the command of its SYNC: the last command again."""
        self._axis.missed += 1
        return self._last.torque

    def note_skipped_syncs(self, periods: float) -> None:
        """Lengthen the hold that ends at the next `step` to `periods` sample times, because SYNCs were skipped."""
        self._axis.hold_length += periods - 1.0

    def withhold(self) -> None:
        """Replace the command of the last `step` by zero torque in the queue, because a dry run does not send it."""
        commands = getattr(getattr(self._memory, "axis", None), "commands", None)
        if commands is not None:  # own code may keep none
            send(commands, self._axis.oldest - 1, 0.0, 0.0, 0.0)

    def replace(self, torque: float) -> None:
        """Replace the command of the last `step` by another in the queue, because a stop sends that one [N or N*m]."""
        commands = getattr(getattr(self._memory, "axis", None), "commands", None)
        if commands is not None:
            damper, modulated = efforts_inside(commands, self._axis.oldest - 1, torque)
            send(commands, self._axis.oldest - 1, torque, damper, modulated)
        self._last = self._last._replace(torque=torque)

    def step(self, position: float, torque_applied: float) -> EnergyBalance:
        """Book the hold that ended, and compute the next torque; see `Controller.step`."""
        if not isfinite(position - self._axis.position + torque_applied):
            effort, command, sensors, _ = self.wording
            self.reset()
            raise ControlError(
                f"controller: got position {position!r} and {effort} {torque_applied!r}, expected finite numbers; "
                f"{command} is zero and the controller was reset; check {sensors}"
            )
        balance = self._advance(position, torque_applied)
        if not isfinite(balance[0]):
            _, command, _, values = self.wording
            self.reset()
            raise ControlError(
                f"controller: computed {command} {balance.torque!r}, expected a finite number; {command} is zero and "
                f"the controller was reset; check {values}"
            )
        self._last = balance
        return balance


@dataclass(frozen=True, slots=True)
class HoldSettings:
    """Constants for booking the energy of a hold."""

    sample_time: float  # [s]
    delay: int  # whole holds between computation and action
    torque_limit: float  # largest torque that limiter and drive let act [N or N*m]
    tolerance: float  # of the velocity's window [m or rad]; 0: the damper uses the velocity of the last hold
    longest_window: int  # of the velocity, in samples; 0 without one
    certificate: int  # promise of the algorithm (`Certificate`)


@dataclass(slots=True)
class Axis:
    """State of one axis between two SYNCs: position, surplus energy, lost samples, place in the command queue."""

    started: bool = False
    position: float = 0.0  # [m or rad]
    moved: float = 0.0  # in the last hold [m or rad]
    missed: int = 0  # samples lost since
    hold_length: float = 1.0  # the hold that ends next [sample times]: more where SYNCs were skipped
    oldest: int = 0  # place of the command whose hold ends next
    h_dis: float = 0.0  # surplus still to be dissipated [J]
    window: VelocityWindow = field(default_factory=VelocityWindow)


class AxisMemory(NamedTuple):
    """Buffers of one axis: window of the velocity estimate, and queued commands."""

    samples: Buffer  # of the velocity's window [m or rad]
    commands: Commands


class Hold(NamedTuple):
    """One completed hold: motion, energy and the parts of the torque applied in it."""

    displacement: float  # [m or rad]
    damper: float  # effort of the model's damper [N or N*m]
    h_i: float  # [J]
    h_pas: float  # [J]
    elapsed: float  # [s]; more than one sample time where positions were lost or SYNCs skipped
    velocity: float  # measured: of this hold, or from the window [m/s or rad/s]
    torque: float  # applied [N or N*m]
    missed: int  # samples lost within it


class HoldAccount(NamedTuple):
    """Energies of one hold as an algorithm books them [J], by the names of `EnergyBalance`."""

    branch: int
    h_r: float
    gen: float
    deficit: float
    leak: float


def hold_settings(parameters: DamperVelocity, loop: LoopProperties, certificate: Certificate) -> HoldSettings:
    """Return the constants for booking the energy of a run's holds.

    Raises:
        ParameterError: `velocity` is `windowed`, but the encoder count is not declared.
    """
    tolerance = parameters.window_tolerance(loop.encoder_count)
    longest = parameters.longest_window(loop.sample_time) if tolerance else 0
    limit = inf if loop.torque_limit is None else loop.torque_limit
    return HoldSettings(loop.sample_time, loop.delay, limit, tolerance, longest, certificate.value)


def axis_memory(delay: int, longest_window: int, make_buffer: MakeBuffer) -> AxisMemory:
    """Return the buffers of one axis: window of the velocity estimate, and queued commands.

    Args:
        delay: Whole holds from the computation of a torque to the hold in which it acts.
        longest_window: Longest window of the velocity, in samples; 0 without one.
        make_buffer: Constructor of a buffer, list or array.
    """
    return AxisMemory(
        make_buffer(longest_window + 1 if longest_window else 0), Commands(*(make_buffer(delay + 1) for _ in range(3)))
    )


class HoldMemory(NamedTuple):
    """Buffers of one axis, and the buffer of its algorithm."""

    axis: AxisMemory
    own: Buffer  # of the algorithm


def hold_memory(settings: Any, make_buffer: MakeBuffer, own: int = 0) -> HoldMemory:
    """Return the buffers of one axis, sized by `settings.hold`, and one of length `own` for its algorithm."""
    axis = axis_memory(settings.hold.delay, settings.hold.longest_window, make_buffer)
    return HoldMemory(axis, make_buffer(own))


def begin(axis: Axis, memory: AxisMemory, position: float) -> None:
    """Set an axis to its first position [m or rad], with no surplus energy and no lost samples."""
    axis.started, axis.position, axis.missed, axis.hold_length, axis.h_dis = True, position, 0, 1.0, 0.0
    if len(memory.samples) > 0:
        restart(axis.window, memory.samples, position)


def open_hold(settings: HoldSettings, axis: Axis, memory: AxisMemory, position: float, torque_applied: float) -> Hold:
    """Compute motion and interaction energy of the hold that ended at a SYNC, and store the new position.

    Args:
        settings: Constants of the run.
        axis: State of the axis; changed.
        memory: Buffers of the axis.
        position: Position at the end of the hold [m or rad].
        torque_applied: Torque applied in the hold [N or N*m].
    """
    displacement, missed = position - axis.position, axis.missed
    holds = missed + axis.hold_length
    h_i, elapsed = -torque_applied * displacement, settings.sample_time * holds  # eq. 2
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
    axis.position, axis.moved, axis.hold_length = position, displacement, 1.0
    return new(Hold, (displacement, damper, h_i, modulated * displacement, elapsed, velocity, torque_applied, missed))


def let_samples_pass(
    axis: Axis, commands: Commands, displacement: float, torque_applied: float, torque_limit: float
) -> float:
    """Advance the command queue over lost samples; return the largest error of the energy booked for these holds [J].

    Booked is one torque times one displacement for all of them. But the axis may have moved out and back, so that its
    excursion exceeds the displacement. The excursion is assumed to be the displacement plus the motion of the hold
    before, once for every lost hold. While SYNCs were skipped, any torque of the gap may have acted.

    Args:
        axis: The axis; its count of missing samples is cleared.
        commands: Commands of the axis.
        displacement: Total displacement of the holds [m or rad].
        torque_applied: Torque applied in the last of the holds [N or N*m].
        torque_limit: Largest torque that limiter and drive let act [N or N*m].
    """
    differences = largest = 0.0
    for _ in range(axis.missed):
        difference = abs(clipped(commands.torques[axis.oldest], torque_limit) - torque_applied)
        differences, largest = differences + difference, max(largest, difference)
        axis.oldest = repeat(commands, axis.oldest)
    skipped = axis.hold_length - 1.0
    excursion = abs(displacement) + (axis.missed + skipped) * abs(axis.moved)
    axis.missed = 0
    return (differences + skipped * largest) * excursion


def close_hold(
    run: Run[Any, Any, HoldMemory], hold: Hold, account: HoldAccount, efforts: tuple[float, float, float],
    rendered: float, state: float, h_s: float,
) -> EnergyBalance:  # fmt: skip
    """Queue a command of given efforts (spring, damper, modulated) and return the balance of the hold that ended.

    Args:
        run: Run of the algorithm; surplus and commands of its axis are updated.
        hold: The hold that ended, from `open_hold`.
        account: Energies of the hold as the algorithm booked them.
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
        run.settings.hold.certificate, state, 0.0,
    ))  # fmt: skip


def surplus_after(axis: Axis, hold: Hold, account: HoldAccount) -> tuple[float, float]:
    """Return the surplus energy after a hold, and the part of the hold's leak that reduced it [J]."""
    _, _, gen, deficit, leak = account
    surplus = axis.h_dis + gen + deficit - hold.h_pas
    paid = min(leak, surplus) if leak > 0.0 and surplus > 0.0 else 0.0
    return surplus - paid, paid
