"""Commands between their computation and the end of the hold in which they acted.

With a delay of n samples, n + 1 commands are under way when a new one is computed (a synchronous RPDO delays by one).
The damper and modulated efforts of a command are kept with it, so that the hold is booked with the efforts that were
parts of the torque applied in that very hold. Booked with the newest efforts instead, the velocity of the paper's
algorithm has a pole at -1.618 for a delay of one sample.
"""

from typing import Final, NamedTuple

from canhaptic.kernels import Buffer, MakeBuffer

_WHOLE: Final = 2.0**53
"""Least floating-point number from which on all are whole."""


class Commands(NamedTuple):
    """Torques of the holds that have not ended and their component efforts, rings of shape (delay + 1,) [N or N*m].

    torque = -(spring + damper + modulated). With n = delay + 1 and `oldest` the place of the command whose hold ends
    next, those that act after it are at oldest + 1 - n, oldest + 2 - n, ... and the newest is at oldest - 1.
    """

    torques: Buffer
    dampers: Buffer  # effort d v of the model's damper
    modulated: Buffer  # effort d_pas v of the modulated damper of eq. 19


def no_commands(delay: int, make_buffer: MakeBuffer) -> Commands:
    """Return the commands of an axis at rest."""
    return Commands(make_buffer(delay + 1), make_buffer(delay + 1), make_buffer(delay + 1))


def send(commands: Commands, oldest: int, torque: float, damper: float, modulated: float) -> int:
    """Put a command in the place of the one whose hold ended; return the place of the next oldest."""
    commands.torques[oldest] = torque
    commands.dampers[oldest] = damper
    commands.modulated[oldest] = modulated
    oldest += 1
    return oldest if oldest < len(commands.torques) else 0


def repeat(commands: Commands, oldest: int) -> int:
    """Account for a hold without a new command, in which the drive repeats the newest; return as `send`."""
    newest = oldest - 1
    return send(commands, oldest, commands.torques[newest], commands.dampers[newest], commands.modulated[newest])


def as_far_as_limit(torque: float, torque_limit: float) -> float:
    """Clip a torque that was sent to the limits of limiter and drive [N or N*m]."""
    return min(max(torque, -torque_limit), torque_limit)


def towards_zero(torque: float, quantum: float) -> float:
    """Return a torque rounded towards 0 to the grid of a drive [N or N*m]; 0 is an ideal one."""
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
