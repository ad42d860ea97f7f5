"""The torques of a group, with their components, from computation to the end of the hold in which they acted."""

from collections.abc import Sequence
from math import sqrt
from typing import NamedTuple

from canhaptic.kernels import Buffer, Matrix, list_of_zeros, zeros


class GroupCommands(NamedTuple):
    """Commands of the holds that have not ended, rings of delay + 1 rows; see `in_flight.Commands`.

    torque = -(spring + damper + modulated), per motor axis [N*m or N].
    """

    torques: Matrix
    dampers: Matrix  # efforts of the network's dissipators
    modulated: Matrix  # of eq. 19
    ports: Matrix  # effort at each port of the network
    power: Buffer  # of the dampers at the velocities they came from, times the sample time (eq. 18) [J]


class GroupHolds(NamedTuple):
    """The hold that ended, or several where samples were lost."""

    displacement: Buffer  # in all of them, (axes,) [rad or m]
    position: Buffer  # at their end, (axes,) [rad or m]
    applied: Buffer  # torques held in the last one, (axes,) [N*m or N]
    lost: Matrix  # torques of the first delay + 1 commands whose samples were lost; those after it are the last again
    interactions: Buffer  # energy that came in by each axis [J]


def no_group_commands(axes: int, ports: int, delay: int) -> GroupCommands:
    """Return the commands of a group at rest."""
    rows = delay + 1
    return GroupCommands(
        zeros(rows, axes), zeros(rows, axes), zeros(rows, axes), zeros(rows, ports), list_of_zeros(rows)
    )


def no_group_holds(axes: int, delay: int) -> GroupHolds:
    """Return the buffers of the holds that ended."""
    one = list_of_zeros
    return GroupHolds(one(axes), one(axes), one(axes), zeros(delay + 1, axes), one(axes))


def end_holds(
    commands: GroupCommands, ended: GroupHolds, largest: Buffer, oldest: int, missed: int, positions: Buffer,
    applied: Buffer,
) -> int:  # fmt: skip
    """Take the holds that ended; return the place of the command that acted in the last of them.

    The efforts at that place are afterwards those inside the torques applied: a torque that was cut had as much less
    of each of them.

    Args:
        commands: Commands of the group.
        ended: Receives displacement, torques and energy of each axis.
        largest: Torque of each axis that limiter and drive let act [N*m or N].
        oldest: Place of the command whose hold ended first.
        missed: Number of lost samples.
        positions: Positions at the end [rad or m].
        applied: Torques in the last hold [N*m or N].
    """
    for lost in range(missed):
        newest = oldest - 1
        for i in range(len(applied)):
            if lost < len(ended.lost):
                ended.lost[lost][i] = min(max(commands.torques[oldest][i], -largest[i]), largest[i])
            commands.torques[oldest][i] = commands.torques[newest][i]
            commands.dampers[oldest][i] = commands.dampers[newest][i]
            commands.modulated[oldest][i] = commands.modulated[newest][i]
        for j in range(len(commands.ports[oldest])):
            commands.ports[oldest][j] = commands.ports[newest][j]
        commands.power[oldest] = commands.power[newest]
        oldest = next_place(commands, oldest)
    torques, as_sent = commands.torques[oldest], True
    for i in range(len(applied)):
        torque = applied[i]
        displacement = positions[i] - ended.position[i]
        ended.displacement[i], ended.position[i], ended.applied[i] = displacement, positions[i], torque
        ended.interactions[i] = -torque * displacement
        if torque != torques[i]:
            as_sent = False
    if not as_sent:
        take_applied(commands, oldest, applied)
    return oldest


def next_place(commands: GroupCommands, place: int) -> int:
    """Return the place after another in the rings."""
    return place + 1 if place + 1 < len(commands.power) else 0


def take_applied(commands: GroupCommands, place: int, applied: Buffer) -> None:
    """Make the efforts of a command those inside torques that were not applied as sent: in proportion, by axis."""
    torques, sent, along = commands.torques[place], 0.0, 0.0
    for i in range(len(applied)):
        torque = torques[i]
        sent += torque * torque
        along += applied[i] * torque
        share = share_of(applied[i], torque)
        commands.dampers[place][i] *= share
        commands.modulated[place][i] *= share
        torques[i] = applied[i]
    whole = share_of(along, sent)
    for j in range(len(commands.ports[place])):
        commands.ports[place][j] *= whole
    commands.power[place] *= whole * whole


def share_of(part: float, whole: float) -> float:
    """Return part / whole, between 0 and 1; 0 of nothing."""
    return min(1.0, max(0.0, part / whole)) if whole != 0.0 else 0.0


def torque_held(ended: GroupHolds, hold: int, missed: int, axis: int) -> float:
    """Return the torque sent for one of the holds that ended, the first of them being 0 [N*m or N]."""
    if hold >= missed:
        return ended.applied[axis]
    return ended.lost[min(hold, len(ended.lost) - 1)][axis]


def send_nothing(commands: GroupCommands, place: int) -> int:
    """Put no torque at a place; return the place of the next oldest command."""
    for i in range(len(commands.torques[place])):
        commands.torques[place][i] = commands.dampers[place][i] = commands.modulated[place][i] = 0.0
    for j in range(len(commands.ports[place])):
        commands.ports[place][j] = 0.0
    commands.power[place] = 0.0
    return next_place(commands, place)


def norm(values: Sequence[float]) -> float:
    """Return the Euclidean norm."""
    total = 0.0
    for value in values:
        total += value * value
    return sqrt(total)
