"""`unprotected` on several axes: the sampled network without protection, to compare others with.

The torques are those of springs and dampers at the last positions. Sampling and delay create energy; it is booked as
`gen`, and energy that is lost as `leak`, as for one axis (`passivity.unprotected`).
"""

from dataclasses import dataclass, field
from typing import ClassVar, NamedTuple, TypeAlias

from canhaptic.control.balance import AT_REST, Branch, Certificate, EnergyBalance
from canhaptic.control.multi_axis import group_kernel
from canhaptic.control.multi_axis.group_kernel import (
    GroupHold,
    MotionAhead,
    begin_group,
    end_holds,
    follow,
    next_place,
    norm,
    send_nothing,
    uncertainty_of_gap,
    write_efforts,
)
from canhaptic.control.passivity import LoopProperties
from canhaptic.kernels import Buffer, Kernel, Run, list_of_zeros, new
from canhaptic.units import Parameters

_START, _EXACT = Branch.START.value, Branch.EXACT.value
_EXIT, _FREE, _NONE = Branch.EXIT.value, Branch.FREE.value, Certificate.NONE.value


class UnprotectedGroupParameters(Parameters):
    """Parameters of `unprotected` on several axes: none."""


class UnprotectedSettings(NamedTuple):
    """Constants of a run."""

    loop: group_kernel.GroupLoop


@dataclass(slots=True)
class UnprotectedState:
    """State kept from SYNC to SYNC."""

    h_s: float = 0.0  # energy stored in the network [J]
    h_dis: float = 0.0  # energy created and not lost since [J]
    was_engaged: bool = False
    group: group_kernel.Group = field(default_factory=group_kernel.Group)


class UnprotectedMemory(NamedTuple):
    """Buffers of a group; shapes (axes,)."""

    group: group_kernel.GroupMemory
    request: group_kernel.RequestedEfforts
    still: Buffer  # zeros: nothing is predicted [rad or m]
    previous: Buffer  # displacement of the hold before [rad or m]


UnprotectedRun: TypeAlias = Run[UnprotectedSettings, UnprotectedState, UnprotectedMemory]
"""Settings, state and memory of a group."""


def settings_of(
    world: group_kernel.GroupModel, _parameters: UnprotectedGroupParameters, loops: tuple[LoopProperties, ...]
) -> UnprotectedSettings:
    """Return the constants of a group."""
    return UnprotectedSettings(group_kernel.group_loop(world, loops))


def memory_of(world: group_kernel.GroupModel, settings: UnprotectedSettings) -> UnprotectedMemory:
    """Return the buffers of a group at rest."""
    axes, one = len(settings.loop.caps), list_of_zeros
    request = group_kernel.RequestedEfforts(one(axes), one(axes), one(axes), one(axes))
    group = group_kernel.group_memory(world, settings.loop, world.geometry.ports)
    return UnprotectedMemory(group, request, one(axes), one(axes))


def step(
    world: group_kernel.GroupModel, run: UnprotectedRun, missed: int, positions: Buffer, torques_applied: Buffer
) -> GroupHold:
    """Book the hold that ended, and compute the next torques; see `canhaptic.kernels.Kernel`."""
    settings, state, memory = run
    group, motion, ended, commands = state.group, state.group.motion, memory.group.ended, memory.group.commands
    if not group.started:
        begin_group(world, settings.loop.motion, group, memory.group, positions)
        state.h_s = motion.energy
        return new(GroupHold, (AT_REST, 0.0, 0.0, 0, 0))
    group.oldest = end_holds(commands, ended, settings.loop.largest, group.oldest, missed, positions, torques_applied)
    place, uncertainty = group.oldest, uncertainty_of_gap(ended, memory.previous, missed)
    follow(world, settings.loop.motion, motion, memory.group.motion, positions, ended.displacement, missed + 1)
    supplied, lost = supplied_by_mover(run), motion.internal
    h_i = supplied - uncertainty
    for i in range(len(positions)):
        h_i += ended.interactions[i]
        lost += commands.dampers[place][i] * ended.displacement[i]
    h_r = lost if lost > 0.0 else 0.0
    rest = state.h_s + h_i - h_r - motion.energy
    gen, leak = (0.0, rest) if rest > 0.0 else (-rest, 0.0)
    paid = min(leak, state.h_dis)
    state.h_s, state.h_dis = motion.energy, state.h_dis + gen - paid
    branch = branch_of(state, h_i != 0.0 or leak != 0.0)
    rendered = send(world, run)
    balance = new(EnergyBalance, (
        norm(commands.torques[place]), h_i, 0.0, h_i, h_r, state.h_s, state.h_dis, gen, 0.0, leak, paid, branch,
        rendered, _NONE, memory.group.motion.network.state[0], supplied,
    ))  # fmt: skip
    return new(GroupHold, (balance, uncertainty, uncertainty, motion.limit, place))


def supplied_by_mover(run: UnprotectedRun) -> float:
    """Return the energy that the mover of a wall supplied in the holds that ended [J]."""
    motion, commands = run.state.group.motion, run.memory.group.commands
    supplied = 0.0
    for effort in commands.ports[run.state.group.oldest]:
        supplied -= effort * motion.moved
    return supplied


def branch_of(state: UnprotectedState, exchanged: bool) -> int:
    """Return the value of the `Branch` by which a hold was booked."""
    engaged, was_engaged = state.group.motion.engaged, state.was_engaged
    state.was_engaged = engaged
    if engaged:
        return _EXACT if was_engaged else _START
    return _EXIT if was_engaged or exchanged else _FREE


def send(world: group_kernel.GroupModel, run: UnprotectedRun) -> float:
    """Send the torques of springs and dampers; return the damping rendered along the motion."""
    settings, state, memory = run
    group, commands, request = state.group, memory.group.commands, memory.request
    place = group.oldest
    if not group.motion.engaged:
        group.oldest = send_nothing(commands, place)
        return 0.0
    ahead = new(MotionAhead, (0.0, memory.still, memory.still, False))
    write_efforts(world, settings.loop.motion, group.motion, memory.group.motion, ahead, request)
    along = square = 0.0
    for i in range(len(memory.still)):
        spring, damper, velocity = request.spring[i], request.damper[i], request.velocity[i]
        commands.torques[place][i] = -spring - damper
        commands.dampers[place][i] = damper
        along += damper * velocity
        square += velocity * velocity
    followed = memory.group.motion
    for j in range(len(commands.ports[place])):
        commands.ports[place][j] = followed.spring_at_ports[j] + followed.damper_at_ports[j]
    group.oldest = next_place(commands, place)
    return along / square if square > 0.0 else 0.0


class UnprotectedGroup(group_kernel.SteppedGroup):
    """Controller of several axes that renders the sampled network without protection."""

    parameters_type: ClassVar[type[Parameters]] = UnprotectedGroupParameters
    kernel: ClassVar[Kernel] = Kernel(settings_of, UnprotectedState, memory_of, step)
