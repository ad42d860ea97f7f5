"""`step_scaling`: the network's step is scaled until its energy balances the hold. The paper's way, on several axes.

    H(x + l s) - H(x) + l L = H_m,    s the step of the model, L what its dissipators take with l = 1

L holds the damper efforts that were inside the torques applied in that very hold, times the displacement, and what is
dissipated inside the network. Of one axis with spring and damper it is `passivity.internal_dissipation` to rounding,
start by eq. 14, exact and sticky root, eq. 18 where there is none, exit. The state creeps away from that of the model,
and no torque is limited: `guarded` is more accurate, and certified.
"""

from math import sqrt
from typing import ClassVar, NamedTuple

from canhaptic.control.balance import AT_REST, Certificate, EnergyBalance
from canhaptic.control.multi_axis.group_commands import (
    GroupHolds,
    end_holds,
    next_place,
    norm,
    send_nothing,
    torque_held,
)
from canhaptic.control.multi_axis.group_kernel import (
    GroupHold,
    GroupKernel,
    GroupLoop,
    group_loop,
    group_memory,
)
from canhaptic.control.multi_axis.group_motion import World, begin_motion, move
from canhaptic.control.multi_axis.stepped_group import SteppedGroup
from canhaptic.control.passivity.controller import LoopProperties
from canhaptic.control.recovery import Alpha, modulated_damping
from canhaptic.kernels import Buffer, list_of_zeros, new
from canhaptic.lab.rivals.scaled_state import (
    ScaledGroupMemory,
    ScaledGroupState,
    begin_state,
    exchange,
    paid_memory,
    write_state_efforts,
)
from canhaptic.units import Parameters

_NO_PROMISE = Certificate.NONE.value


class ScaledGroupParameters(Parameters):
    """Free parameters of the algorithm."""

    alpha: Alpha = 0.0
    """Modulated damping per joule of surplus (eq. 19), always with its unit; 0: the surplus is not removed."""


class ScaledGroupSettings(NamedTuple):
    """Constants of a run."""

    loop: GroupLoop
    alpha: float  # [s/m^2 or s/rad^2]


def settings_of(
    world: World, parameters: ScaledGroupParameters, loops: tuple[LoopProperties, ...]
) -> ScaledGroupSettings:
    """Constants of a run."""
    return ScaledGroupSettings(group_loop(world, loops), parameters.alpha)


def memory_of(world: World, settings: ScaledGroupSettings) -> ScaledGroupMemory:
    """Return the buffers of a group at rest."""
    axes, one = len(settings.loop.caps), list_of_zeros
    ports = world.geometry.ports
    return ScaledGroupMemory(
        group_memory(world, settings.loop, ports), paid_memory(world.tables), one(axes), one(axes), one(axes)
    )


def step(
    world: World, settings: ScaledGroupSettings, state: ScaledGroupState, memory: ScaledGroupMemory, missed: int,
    positions: Buffer, torques_applied: Buffer,
) -> GroupHold:  # fmt: skip
    """Account for the hold that ended; see `GroupKernel`."""
    group, motion, ended, loop = state.group, state.group.motion, memory.group.ended, settings.loop
    if not group.started:
        group.started = True
        for i in range(len(positions)):
            ended.position[i] = positions[i]
        begin_motion(world, loop.motion, motion, memory.group.motion, positions)
        begin_state(world, state, memory)
        return new(GroupHold, (AT_REST, 0.0, 0.0, 0.0, 0, 0))
    commands = memory.group.commands
    group.oldest = end_holds(commands, ended, loop.largest, group.oldest, missed, positions, torques_applied)
    place, unsure = group.oldest, unsure_of(memory, ended, missed)
    move(world, loop.motion, motion, memory.group.motion, positions, ended.displacement, missed + 1)
    h_i = h_pas = damped = supplied = 0.0
    for i in range(len(positions)):
        h_i += ended.interactions[i]
        h_pas += commands.modulated[place][i] * ended.displacement[i]
        damped += commands.dampers[place][i] * ended.displacement[i]
    for j in range(len(commands.ports[place])):
        supplied -= commands.ports[place][j] * motion.moved
    h_i = h_i + supplied - unsure
    power = commands.power[place] * (missed + 1)
    account = exchange(world, state, memory, loop.delay, h_i - h_pas, damped, power)
    branch, h_r, gen, deficit, leak = account
    surplus = state.h_dis + gen + deficit - h_pas
    paid = min(leak, surplus) if leak > 0.0 and surplus > 0.0 else 0.0
    state.h_dis = surplus - paid
    rendered = send(world, settings, state, memory)
    balance = new(EnergyBalance, (
        norm(commands.torques[place]), h_i, h_pas, h_i - h_pas, h_r, state.paid.h_s, state.h_dis, gen, deficit,
        leak, paid, branch, rendered, _NO_PROMISE, memory.group.motion.network.state[0],
    ))  # fmt: skip
    return new(GroupHold, (balance, supplied, unsure, unsure, motion.limit, place))


def unsure_of(memory: ScaledGroupMemory, ended: GroupHolds, missed: int) -> float:
    """Largest error of the energy over holds of which only the total displacement is known [J]."""
    total = 0.0
    for i in range(len(ended.displacement)):
        moved, torque, apart = ended.displacement[i], ended.applied[i], 0.0
        if missed:
            excursion = abs(moved) + missed * abs(memory.previous[i])
            for hold in range(missed):
                apart += abs(torque_held(ended, hold, missed, i) - torque)
            total += apart * excursion
        memory.previous[i] = moved
    return total


def send(world: World, settings: ScaledGroupSettings, state: ScaledGroupState, memory: ScaledGroupMemory) -> float:
    """Send the torques of the state, its dampers and the modulated damper; return the damping rendered."""
    group, commands, caps = state.group, memory.group.commands, settings.loop.caps
    place, displacement, elapsed = group.oldest, memory.group.ended.displacement, group.motion.elapsed
    if not state.paid.engaged:
        group.oldest = send_nothing(commands, place)
        return 0.0
    spring, damper = memory.spring, memory.damper
    power = write_state_efforts(world, state, memory)
    size = room = square = moved = along = extra = 0.0
    for i in range(len(caps)):
        velocity = state.paid.pace * displacement[i] / elapsed
        size += damper[i] * damper[i] / caps[i]
        room += caps[i] * velocity * velocity
        square += velocity * velocity
        moved += displacement[i] * displacement[i]
    share = 1.0
    if size > room and not world.tables.moving:
        share = sqrt(room / size)
    for i in range(len(caps)):
        damper[i] *= share
        along += damper[i] * (state.paid.pace * displacement[i] / elapsed)
    rendered, moved = along / square if square != 0.0 else 0.0, sqrt(moved)
    if settings.alpha > 0.0 and state.h_dis > 0.0 and moved != 0.0:
        extra = modulated_damping(settings.alpha, state.h_dis, rendered, settings.loop.least_cap, moved, elapsed)
    for i in range(len(caps)):
        modulated = extra * displacement[i] / elapsed
        commands.torques[place][i] = -spring[i] - damper[i] - modulated
        commands.dampers[place][i], commands.modulated[place][i] = damper[i], modulated
    for j in range(len(memory.paid.whole)):
        commands.ports[place][j] = memory.paid.whole[j]
    commands.power[place] = share * power
    group.oldest = next_place(commands, place)
    return rendered + extra


class ScaledGroup(SteppedGroup):
    """A network whose state holds only energy that was received."""

    parameters_type: ClassVar[type[Parameters]] = ScaledGroupParameters
    kernel: ClassVar[GroupKernel] = GroupKernel(settings_of, ScaledGroupState, memory_of, step)
