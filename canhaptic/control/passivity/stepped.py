"""A passivity algorithm in the cycle: keeps the state of the kernel, and refuses values that are not finite.

Commands between their computation and the end of the hold in which they acted.

With a delay of n samples, n + 1 commands are queued when a new one is computed (a synchronous RPDO delays by one).
The damper and modulated efforts of a command are kept with it, so that the hold is booked with the efforts that were
parts of the torque applied in that very hold. Booked with the newest efforts instead, the velocity of the paper's
algorithm has a pole at -1.618 for a delay of one sample.

Division of one hold's energy between stored energy and surplus, as in `guarded` for one axis and for a group.
"""

from collections.abc import Callable
from functools import partial
from math import isfinite
from typing import ClassVar, Final, NamedTuple

from canhaptic.control.balance import AT_REST, Branch, EnergyBalance
from canhaptic.errors import ControlError, ParameterError
from canhaptic.kernels import Buffer, Kernel, MakeBuffer, Run, list_of_zeros, with_quick_fields
from canhaptic.units import Parameters

_WHOLE: Final = 2.0**53
"""Least floating-point number from which on all are whole."""


class Commands(NamedTuple):
    """Torques of the holds that have not ended and their component efforts, rings of shape (delay + 1,) [N or N*m].

    torque = -(spring + damper + modulated). With n = delay + 1 and `oldest` the index of the command whose hold ends
    next, those that act after it are at oldest + 1 - n, oldest + 2 - n, ... and the newest is at oldest - 1.
    """

    torques: Buffer
    dampers: Buffer  # effort d v of the model's damper
    modulated: Buffer  # effort d_pas v of the modulated damper of eq. 19


def no_commands(delay: int, make_buffer: MakeBuffer) -> Commands:
    """Return the commands of an axis at rest."""
    return Commands(make_buffer(delay + 1), make_buffer(delay + 1), make_buffer(delay + 1))


def send(commands: Commands, oldest: int, torque: float, damper: float, modulated: float) -> int:
    """Replace the command whose hold ended; return the index of the oldest one left."""
    commands.torques[oldest] = torque
    commands.dampers[oldest] = damper
    commands.modulated[oldest] = modulated
    oldest += 1
    return oldest if oldest < len(commands.torques) else 0


def repeat(commands: Commands, oldest: int) -> int:
    """Account for a hold without a new command: the drive repeats the last one. Returns the index as `send` does."""
    newest = oldest - 1
    return send(commands, oldest, commands.torques[newest], commands.dampers[newest], commands.modulated[newest])


def as_far_as_limit(torque: float, torque_limit: float) -> float:
    """Clip a sent torque to the limits of limiter and drive [N or N*m]."""
    return min(max(torque, -torque_limit), torque_limit)


def towards_zero(torque: float, quantum: float) -> float:
    """Return a torque rounded towards 0 to the quanta of a drive [N or N*m]; a quantum of 0 is ideal."""
    if quantum == 0.0:
        return torque
    steps = torque / quantum
    return int(steps) * quantum if abs(steps) < _WHOLE else torque  # beyond it every number is whole; NaN stays


def efforts_inside(commands: Commands, oldest: int, torque_applied: float) -> tuple[float, float]:
    """Return the damper and modulated effort inside the torque that was applied in the hold that ended [N or N*m].

    A clipped torque scales both in proportion.
    """
    torque, damper, modulated = commands.torques[oldest], commands.dampers[oldest], commands.modulated[oldest]
    if torque_applied != torque and (damper != 0.0 or modulated != 0.0):
        share = min(1.0, max(0.0, torque_applied / torque)) if torque != 0.0 else 0.0
        return damper * share, modulated * share
    return damper, modulated


def settle(
    h_s: float, surplus: float, lost: float, ceiling: float, slack: float
) -> tuple[float, float, float, float, float, float]:
    """Return (h_s, surplus, h_r, deficit, leak, paid) after a hold [J].

    Args:
        h_s: Stored energy including the hold's; below 0 is a deficit.
        surplus: Energy still to be dissipated.
        lost: Energy that the dissipators of the model took; negative values count as 0.
        ceiling: Energy that the model stores at its true state; the stored energy is limited to it.
        slack: Part of `h_s` that the certificates of the queued torques do not need; the rest must be kept.
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


_HELD = Branch.HELD.value
_TAKEN = 4
"""Arguments of the step of a kernel: environment, run, position, torque applied."""


class Wording(NamedTuple):
    """Names of input and output of a controller, for its messages."""

    effort: str  # in addition to the position
    command: str
    sensors: str  # advice where an input is not finite
    values: str  # advice where an output is not finite


class SteppedController:
    """A kernel with the state of one axis; see `Controller`."""

    parameters_type: ClassVar[type[Parameters]]
    kernel: ClassVar[Kernel]
    wording: ClassVar[Wording] = Wording(
        "applied torque",
        "torque",
        "the encoder and its scaling",
        "stiffness and damping against the size of the motion",
    )

    def __init_subclass__(cls) -> None:
        """Refuse a kernel whose step takes settings, state and memory one by one, as kernels once did.

        Raises:
            ParameterError: It does.
        """
        kernel = vars(cls).get("kernel")
        if kernel is not None and kernel.step.__code__.co_argcount != _TAKEN:
            raise ParameterError(
                f"{cls.__name__}: got a step of {kernel.step.__code__.co_argcount} arguments, expected (environment, "
                "run, position, torque_applied): settings, state and memory are fields of run; see docs/extending.md"
            )

    def __init__(self, environment: object, parameters: Parameters, loop: Parameters) -> None:
        """Prepare a run; `parameters` is of `parameters_type`.

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
        """Answer a SYNC whose position was lost; nothing is booked. See `Controller.hold`."""
        command = self._command_unseen() if self._axis.started else self._last.torque
        return self._last._replace(
            torque=command, branch=_HELD, h_i=0.0, h_pas=0.0, h_m=0.0, h_r=0.0, gen=0.0, deficit=0.0, leak=0.0, paid=0.0
        )

    def _command_unseen(self) -> float:
        """Return the command of a SYNC without a sample: the last one."""
        self._axis.missed += 1
        return self._last.torque

    def lasted(self, periods: float) -> None:
        """Record that the hold that the next `step` ends lasted this number of sample times, as SYNCs were skipped."""
        self._axis.lasted += periods - 1.0

    def withhold(self) -> None:
        """Record that the command of the last `step` is not sent: in a dry run the drive holds no torque."""
        commands = getattr(getattr(self._memory, "axis", None), "commands", None)
        if commands is not None:  # own code may keep none
            send(commands, self._axis.oldest - 1, 0.0, 0.0, 0.0)

    def step(self, position: float, torque_applied: float) -> EnergyBalance:
        """Account for the hold that ended; see `Controller.step`."""
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
