"""State of a network that holds only received energy: every change of it balances the energy of a hold."""

from dataclasses import dataclass, field
from typing import Final, NamedTuple

from canhaptic.control.balance import Branch
from canhaptic.control.multi_axis.group_kernel import Group, GroupMemory
from canhaptic.control.multi_axis.group_motion import World, to_motors
from canhaptic.control.passivity.hold_account import HoldAccount
from canhaptic.control.port_hamiltonian.discrete_gradient import NetworkTables, extension, gradient
from canhaptic.control.port_hamiltonian.sampled_network import (
    begin_network,
    dampers,
    place_state,
    propose,
    settle_network,
    share_inside,
    springs,
)
from canhaptic.kernels import Buffer, list_of_zeros, new
from canhaptic.lab.rivals.step_scaling import FURTHEST, LineMemory, line_memory, solve_scale, taken

_START, _EXACT, _STICKY = Branch.START.value, Branch.EXACT.value, Branch.STICKY.value
_FALLBACK, _DEPLETED = Branch.FALLBACK.value, Branch.DEPLETED.value
_EXIT, _FREE = Branch.EXIT.value, Branch.FREE.value
_ROUNDING: Final = 1e-12  # of the energy at hand: below it a rest is rounding, not a leak


@dataclass(slots=True)
class PaidState:
    """Stored energy, and the state of the paper's flow chart (Fig. 6)."""

    h_s: float = 0.0  # energy stored at the state, computed from it [J]
    engaged: bool = False  # whether anything can be felt
    pace: float = 0.0  # size of the last change of state over the step of the model: its velocity over the measured one
    blind: int = 0  # holds for which a start goes on
    touched: bool = False  # whether the model was in contact


@dataclass(slots=True)
class ScaledGroupState:
    """State kept from SYNC to SYNC."""

    h_dis: float = 0.0  # surplus still to be dissipated [J]
    group: Group = field(default_factory=Group)
    paid: PaidState = field(default_factory=PaidState)


class PaidMemory(NamedTuple):
    """Buffers of the state; shapes (states,) and (ports,)."""

    line: LineMemory
    model: Buffer  # state of the model
    rest: Buffer  # change of state that takes every storage back to its edge
    efforts: Buffer
    ports: Buffer  # motion of the ports in one hold [m or rad]
    whole: Buffer  # efforts at the ports [N or N*m]


class ScaledGroupMemory(NamedTuple):
    """Buffers of a group."""

    group: GroupMemory
    paid: PaidMemory
    previous: Buffer  # displacement of the hold before, (axes,) [rad or m]
    spring: Buffer  # efforts to be sent, (axes,) [N*m or N]
    damper: Buffer


def paid_memory(tables: NetworkTables) -> PaidMemory:
    """Return empty buffers."""
    states, ports = len(tables.stiffness), len(tables.gain[0])
    return PaidMemory(
        line_memory(states), *[list_of_zeros(states) for _ in range(3)], *[list_of_zeros(ports) for _ in range(2)]
    )  # fmt: skip


def begin_state(world: World, state: ScaledGroupState, memory: ScaledGroupMemory) -> None:
    """Take the first coordinates: strain there stores energy that no port supplied, and is released."""
    paid, motion, followed = state.paid, state.group.motion, memory.group.motion.network
    paid.h_s, paid.engaged, paid.pace, paid.blind, paid.touched = 0.0, False, 0.0, 0, False
    if not motion.located:
        return
    begin_network(world.tables, world.functions, motion.network, followed, memory.group.motion.coordinates)
    for i in range(len(followed.state)):
        followed.state[i] -= extension(world.tables, i, followed.state[i])
    settle_network(world.tables, world.functions, motion.network, followed)
    paid.h_s = motion.network.energy
    write_model(world, state, memory)
    paid.touched = touches(world.tables, memory.paid)


def exchange(
    world: World,
    state: ScaledGroupState,
    memory: ScaledGroupMemory,
    delay: int,
    h_m: float,
    damped: float,
    power: float,
) -> HoldAccount:
    """Book a hold whose motion `group_motion.move` has taken.

    Args:
        world: Network and kinematics of the group.
        state: State of the group; changed.
        memory: Buffers of the group.
        delay: Whole holds between computation and action.
        h_m: Energy that the model received [J].
        damped: Damper efforts inside the torques applied, times the displacements [J].
        power: The same efforts times the velocities they came from, times the hold (eq. 18) [J].
    """
    paid, motion, followed = state.paid, state.group.motion, memory.group.motion
    if not motion.located or motion.began:
        available = paid.h_s + h_m
        begin_state(world, state, memory)
        rest = available - paid.h_s
        return new(HoldAccount, (_EXIT, 0.0, 0.0, max(0.0, -rest), max(0.0, rest)))
    propose(
        world.tables, world.functions, motion.network, followed.network, followed.displacement, motion.elapsed
    )  # fmt: skip
    write_model(world, state, memory)
    touching, touched = touches(world.tables, memory.paid), paid.touched
    entered, left = touching and not touched, touched and not touching
    paid.touched = touching
    starts = touching and (entered or paid.blind > 0 or (paid.h_s == 0.0 and paid.pace == 0.0))
    if starts and not entered and not is_pushed_inward(world, memory):
        paid.blind, starts = 0, False
    if starts:
        account = start(world, state, memory, delay, h_m, entered)
    else:
        account = balance(world, state, memory, h_m, damped, power)
    return leave(world, state, memory, account, touching, left or h_m != 0.0)


def start(
    world: World, state: ScaledGroupState, memory: ScaledGroupMemory, delay: int, h_m: float, entered: bool
) -> HoldAccount:
    """First-order start (eq. 14): the state is the model's, and the energy for it is created.

    After it the user feels no torque before `delay` more holds have ended; until then it goes on.
    """
    paid, network, followed = state.paid, state.group.motion.network, memory.group.motion.network
    model = memory.paid.model
    paid.blind = delay if entered or paid.blind == 0 else paid.blind - 1
    available = paid.h_s + h_m
    paid.pace = share_inside(world.tables, followed.room, model) if entered else 1.0
    for i in range(len(model)):
        followed.state[i] = model[i]
    settle_network(world.tables, world.functions, network, followed)
    paid.h_s = h_s = network.energy
    return new(HoldAccount, (_START, 0.0, max(0.0, h_s - available), 0.0, max(0.0, available - h_s)))


def lay_line(memory: ScaledGroupMemory, step: Buffer) -> None:
    """Set the line from the state along a step."""
    line, state = memory.paid.line, memory.group.motion.network.state
    for i in range(len(state)):
        line.state[i], line.step[i] = state[i], step[i]


def balance(
    world: World, state: ScaledGroupState, memory: ScaledGroupMemory, h_m: float, damped: float, power: float
) -> HoldAccount:
    """Solve the scalar balance and take its step; eq. 18 where there is no solution."""
    tables, functions, line, before = world.tables, world.functions, memory.paid.line, state.paid.h_s
    step = memory.group.motion.network.room.step
    lay_line(memory, step)
    loss = damped + state.group.motion.network.internal
    scale = solve_scale(tables, functions, line, h_m, loss, FURTHEST)
    if scale.found and loss * scale.share < 0.0:
        loss = 0.0
        scale = solve_scale(tables, functions, line, h_m, 0.0, FURTHEST)
    share = scale.share
    if not scale.found and h_m <= 0.0:
        return approximate(world, state, memory, h_m, power, share)
    is_sticky = h_m > 0.0 and taken(tables, functions, line, 0.0, 0.0)[1] * share < 0.0
    take(world, state, memory, share, step)
    return settle_state(world, state, memory, _STICKY if is_sticky else _EXACT, before + h_m, loss * share, share)


def approximate(
    world: World, state: ScaledGroupState, memory: ScaledGroupMemory, h_m: float, power: float, deepest: float
) -> HoldAccount:
    """Dissipate the last velocity's loss, as far as available; the state relaxes to the remaining energy (eq. 18).

    Where that frees too little, the step is taken to its largest energy release, and the rest is a deficit.
    """
    tables, functions, followed, h_s = world.tables, world.functions, memory.group.motion.network, state.paid.h_s
    line, rest, model, available = memory.paid.line, memory.paid.rest, followed.room.step, h_s + h_m
    h_r = min(max(0.0, power), max(0.0, available))
    left, is_empty = max(0.0, available) - h_r, available <= 0.0
    for i in range(len(rest)):
        rest[i] = -extension(tables, i, followed.state[i])
    lay_line(memory, rest)
    sunk = solve_scale(tables, functions, line, left - h_s, 0.0, 1.0)
    share, sinks = (sunk.share, True) if sunk.found else (deepest, False)
    is_bottom = left <= _ROUNDING * h_s  # a double root, not to be searched for
    if is_bottom and taken(tables, functions, line, 0.0, 1.0)[0] <= (_ROUNDING - 1.0) * h_s:
        share, sinks = 1.0, True
    square = along = 0.0
    for i in range(len(model)):
        change = share * (rest[i] if sinks else model[i])
        line.step[i] = change
        square += model[i] * model[i]
        along += change * model[i]
    take(world, state, memory, 1.0, line.step)
    pace = along / square if square > 0.0 and not is_empty else 0.0
    return settle_state(world, state, memory, _DEPLETED if is_empty else _FALLBACK, available, h_r, pace)


def take(world: World, state: ScaledGroupState, memory: ScaledGroupMemory, share: float, step: Buffer) -> None:
    """Change the state by a share of a step; it does not cross to the other side of a wall that the model touches."""
    tables, found, model = world.tables, memory.group.motion.network.state, memory.paid.model
    write_model(world, state, memory)
    for i in range(len(found)):
        found[i] += share * step[i]
    for i in tables.edged:
        true = extension(tables, i, model[i])
        if true * extension(tables, i, found[i]) <= 0.0 and true != 0.0:
            found[i] = tables.upper[i] if true > 0.0 else tables.lower[i]


def settle_state(
    world: World,
    state: ScaledGroupState,
    memory: ScaledGroupMemory,
    branch: int,
    available: float,
    h_r: float,
    pace: float,
) -> HoldAccount:
    """Take the energy of the state; book its excess or shortfall."""
    network = state.group.motion.network
    settle_network(world.tables, world.functions, network, memory.group.motion.network)
    state.paid.h_s = h_s = network.energy
    state.paid.pace = pace
    rest = available - h_r - h_s
    if abs(rest) <= _ROUNDING * max(abs(available), h_r, h_s):
        rest = 0.0
    return new(HoldAccount, (branch, h_r, 0.0, max(0.0, -rest), max(0.0, rest)))


def leave(
    world: World,
    state: ScaledGroupState,
    memory: ScaledGroupMemory,
    account: HoldAccount,
    touching: bool,
    exchanged: bool,
) -> HoldAccount:
    """Leak the energy of storages that the model no longer touches."""
    tables, paid, motion = world.tables, state.paid, state.group.motion
    followed, model = memory.group.motion.network, memory.paid.model
    branch, h_r, gen, deficit, leak = account
    if not tables.moving:
        before = motion.network.energy
        write_model(world, state, memory)
        for i in tables.edged:
            if extension(tables, i, model[i]) == 0.0:
                upper, lower = tables.upper[i], tables.lower[i]
                followed.state[i] = upper if abs(model[i] - upper) <= abs(model[i] - lower) else lower
        settle_network(tables, world.functions, motion.network, followed)
        paid.h_s = motion.network.energy
        leak = leak + before - motion.network.energy
    paid.engaged = touching and motion.limit == 0
    if not touching:
        paid.pace, paid.blind = 0.0, 0
        branch = _EXIT if exchanged or leak != 0.0 else _FREE
    return new(HoldAccount, (branch, h_r, gen, deficit, leak))


def write_model(world: World, state: ScaledGroupState, memory: ScaledGroupMemory) -> None:
    """Write the state of the model: at the ports, or a whole step further."""
    followed, model = memory.group.motion.network, memory.paid.model
    if world.tables.moving or not state.group.motion.located:
        for i in range(len(model)):
            model[i] = followed.state[i] + followed.room.step[i]
    else:
        place_state(world.tables, followed, memory.group.motion.coordinates, model)


def touches(tables: NetworkTables, memory: PaidMemory) -> bool:
    """Return whether the model is in contact."""
    if tables.always or len(tables.edged) == 0:
        return True
    for i in tables.edged:
        if extension(tables, i, memory.model[i]) != 0.0:
            return True
    return False


def is_pushed_inward(world: World, memory: ScaledGroupMemory) -> bool:
    """Return True when the step stores energy at the model's state, or when nothing opposes it there."""
    tables, efforts, step = world.tables, memory.paid.efforts, memory.group.motion.network.room.step
    gradient(tables, memory.paid.model, efforts)
    if tables.by_functions:
        world.functions.add_gradient(memory.paid.model, efforts)
    along, moves = 0.0, False
    for i in range(len(step)):
        along += efforts[i] * step[i]
        if step[i] != 0.0:
            moves = True
    return along > 0.0 or (along == 0.0 and moves)


def write_state_efforts(world: World, state: ScaledGroupState, memory: ScaledGroupMemory) -> float:
    """Write springs and dampers at the motors and their sum at the ports; return the dampers' power in a hold [J]."""
    motion, followed, tables = state.group.motion, memory.group.motion, world.tables
    holds, ports, network = motion.holds, memory.paid.ports, followed.network
    for j in range(len(ports)):
        ports[j] = state.paid.pace * followed.displacement[j] / holds
    for j in range(len(network.room.engaged)):
        network.room.engaged[j] = 1.0
    write_model(world, state, memory)
    spring, damper = followed.spring_at_ports, followed.damper_at_ports
    dampers(tables, network, ports, motion.elapsed / holds, memory.paid.model, damper)
    springs(tables, world.functions, network, 0.0, 1, ports, spring, followed.lead_at_ports)
    power = 0.0
    for j in range(len(ports)):
        power += damper[j] * ports[j]
        memory.paid.whole[j] = spring[j] + damper[j]
    to_motors(followed, spring, memory.spring)
    to_motors(followed, damper, memory.damper)
    return power
