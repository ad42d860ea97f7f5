"""`step_scaling`: the paper's method on several axes, which scales the model's step to the energy received in a hold.

The state x of the network stores received energy only. Of the step s of the model it takes the share l with

    H(x + l s) - H(x) + l L = H_m

where H_m is the energy of the hold and L the dissipation with l = 1: the damper efforts inside the torques applied in
that hold, times the displacement, and the dissipation inside the network. On one axis with spring and damper the method
equals `passivity.internal_dissipation` to rounding: start by eq. 14, exact and sticky root, eq. 18 without a root,
exit. The state drifts away from that of the model, and no torque is limited: `guarded` is more accurate, and certified.

H is convex along most steps but not along all (double wells), so the root is bracketed first and then found by Newton
steps that fall back to bisection. At most `EVALUATIONS` evaluations are made; the caller books the remaining energy, so
that an early end costs fidelity and never energy.
"""

from dataclasses import dataclass, field
from math import inf, isnan, sqrt
from typing import ClassVar, Final, NamedTuple, TypeAlias

from canhaptic.control.balance import AT_REST, Branch, Certificate, EnergyBalance
from canhaptic.control.damping import Alpha, modulated_damping
from canhaptic.control.multi_axis import group_kernel
from canhaptic.control.multi_axis.group_kernel import (
    GroupHold,
    GroupModel,
    begin_group,
    end_holds,
    move,
    next_place,
    norm,
    send_nothing,
    to_motors,
    uncertainty_of_gap,
)
from canhaptic.control.passivity import LoopProperties
from canhaptic.control.passivity.internal_dissipation import solve_balance
from canhaptic.control.passivity.stepped import HoldAccount
from canhaptic.control.port_hamiltonian.network import Functions, NetworkTables, discrete_gradient, extension, gradient
from canhaptic.control.port_hamiltonian.sampled_network import (
    begin_network,
    dampers,
    place_state,
    propose,
    settle_network,
    share_inside,
    springs,
)
from canhaptic.kernels import Buffer, Kernel, Run, list_of_zeros, new
from canhaptic.units import Parameters

EVALUATIONS: Final = 60
"""Largest number of evaluations of the stored energy in the solution of one energy balance."""
_PIECES: Final = 8
"""Number of points along a step that are tried if the end of the step stores less than the received energy."""
FURTHEST: Final = 2.0
"""Largest factor by which a step is scaled, in either direction; energy beyond its end is booked as a remainder."""


class StepScaling(NamedTuple):
    """Solution of the energy balance: the factor (share) by which the model's step is scaled."""

    share: float
    found: bool  # False: nothing balances; `share` is where the most is given, or the end where the most is taken
    evaluations: int


class LineMemory(NamedTuple):
    """Line of states x + l s on which the energy balance is solved, and work arrays; shapes (states,)."""

    state: Buffer  # x
    step: Buffer  # s
    moved: Buffer
    efforts: Buffer
    slopes: Buffer


def line_memory(states: int) -> LineMemory:
    """Return a line with zeros in all buffers."""
    return LineMemory(*[list_of_zeros(states) for _ in range(5)])


class StepBalance(NamedTuple):
    """The energy balance H(x + l s) - H(x) + l L = H_m of one step."""

    tables: NetworkTables
    functions: Functions  # energies given as functions
    line: LineMemory  # along which the state of the network moves
    received: float  # H_m, energy that the model received [J]
    loss: float  # L, which the network dissipates with l = 1 [J]


def taken(at: StepBalance, share: float) -> tuple[float, float]:
    """Return the energy stored and dissipated by `share` l of the step, and its derivative by l [J].

    Without cancellation: H(x + l s) - H(x) = l s . e_dg(x, x + l s).
    """
    tables, functions, line, loss = at.tables, at.functions, at.line, at.loss
    moved, efforts, step, state = line.moved, line.efforts, line.step, line.state
    for i in range(len(step)):
        moved[i] = share * step[i]
    discrete_gradient(tables, state, moved, efforts, line.slopes)
    if tables.by_functions:
        functions.add_discrete_gradient(state, moved, efforts)
    energy = loss * share
    for i in range(len(step)):
        energy += efforts[i] * moved[i]
        moved[i] += state[i]
    gradient(tables, moved, efforts)
    if tables.by_functions:
        functions.add_gradient(moved, efforts)
    slope = loss
    for i in range(len(step)):
        slope += efforts[i] * step[i]
    return energy, slope


def stiffness_along(tables: NetworkTables, line: LineMemory) -> float:
    """Return s . H'' s, the curvature of the energy along the line [J]; -1 if the energy is not quadratic there."""
    total = 0.0
    if tables.by_functions:
        return -1.0
    for i in range(len(line.step)):
        s, x = line.step[i], line.state[i]
        if s == 0.0 or (tables.stiffness[i] == 0.0 and tables.hardening[i] == 0.0):
            continue
        if tables.hardening[i] != 0.0:
            return -1.0
        inside_edges = tables.lower[i] < x < tables.upper[i]  # at an edge: emptied, and touched all the same
        if inside_edges and extension(tables, i, x) == 0.0:
            if extension(tables, i, x + FURTHEST * s) != 0.0 or extension(tables, i, x - FURTHEST * s) != 0.0:
                return -1.0
            continue
        total += tables.stiffness[i] * s * s
    if tables.coupled:
        for i in range(len(line.step)):
            row, along = tables.quadratic[i], 0.0
            for j in range(len(line.step)):
                along += row[j] * line.step[j]
            total += line.step[i] * along
    return max(total, 0.0)


def solve_scale(at: StepBalance, limit: float) -> StepScaling:
    """Return the share l of the step, nearest 0 with |l| <= limit, that stores and dissipates the received energy."""
    line, energy = at.line, at.received
    stiffness = stiffness_along(at.tables, line)
    if stiffness < 0.0:
        return search_scale(at, limit)
    square = 0.0
    for s in line.step:
        square += s * s
    length = sqrt(square)  # along a unit step: of one state, eq. 16 itself
    if length == 0.0:
        return new(StepScaling, (0.0, energy >= 0.0, 1))
    slope = taken(at, 0.0)[1]
    change = solve_balance(stiffness / (length * length), slope / length, energy, length)
    if isnan(change):
        return new(StepScaling, (0.0, False, 1))
    share = change / length
    if abs(share) > limit and energy > 0.0:
        share = limit if share > 0.0 else -limit
    return new(StepScaling, (share, True, 1))


def search_scale(at: StepBalance, limit: float) -> StepScaling:
    """Solve the balance as `solve_scale` does, for an energy that is not quadratic."""
    energy = at.received
    if abs(energy) <= rounding_of(at):
        return new(StepScaling, (0.0, True, 0))
    slope = taken(at, 0.0)[1]
    if slope == 0.0 and energy < 0.0:
        return new(StepScaling, (0.0, False, 1))
    far = limit if (slope > 0.0) == (energy > 0.0) or slope == 0.0 else -limit
    end, found, evaluations = bracket_upwards(at, far) if energy > 0.0 else bracket_downwards(at, far)
    if not found:
        return new(StepScaling, (end, False, evaluations + 1))
    return root_between(at, end, evaluations + 1)


def rounding_of(at: StepBalance) -> float:
    """Return the rounding of the energies of a balance [J]."""
    return 1e-15 * (abs(at.received) + abs(at.loss))


def bracket_upwards(at: StepBalance, far: float) -> tuple[float, bool, int]:
    """Return a share up to `far` that absorbs at least the energy > 0, whether it was found, and evaluations made."""
    if taken(at, far)[0] >= at.received:
        return far, True, 1
    for piece in range(1, _PIECES):
        place = far * piece / _PIECES
        if taken(at, place)[0] >= at.received:
            return place, True, piece + 1
    return far, False, _PIECES


def bracket_downwards(at: StepBalance, far: float) -> tuple[float, bool, int]:
    """Return a share between 0 and the energy minimum before `far` that releases at least the energy < 0.

    Returns:
        The share, or the one that releases most; whether it releases enough; the number of evaluations.
    """
    near, here, least, best, evaluations = 0.0, far, 0.0, 0.0, 0
    for _ in range(20):  # halving has the rest of the evaluations
        here_energy, here_slope = taken(at, here)
        evaluations += 1
        if here_energy < least:
            least, best = here_energy, here
        if here_energy <= at.received:
            return here, True, evaluations
        if here_slope * far < 0.0 and here_energy <= least:
            if here == far:
                break
            near = here
        else:
            far = here
        here = 0.5 * (near + far)
    return best, False, evaluations


def root_between(at: StepBalance, far: float, evaluations: int) -> StepScaling:
    """Return the share between 0 and `far` that solves the balance; `far` absorbs or releases at least the energy."""
    near, share, width, energy, tolerance = 0.0, far, abs(far), at.received, rounding_of(at)
    if energy > 0.0:
        slope = taken(at, 0.0)[1]
        evaluations += 1
        if slope * far > 0.0 and abs(energy / slope) < abs(far):
            share = energy / slope
    while evaluations < EVALUATIONS:
        found, slope = taken(at, share)
        evaluations += 1
        missing = energy - found
        if abs(missing) <= tolerance:
            break
        if (missing > 0.0) == (energy > 0.0):
            near = share
        else:
            far = share
        following = share + missing / slope if slope != 0.0 else inf
        if not min(near, far) < following < max(near, far) or abs(following - share) > 0.5 * width:
            following = 0.5 * (near + far)
        width = abs(following - share)
        if following == share:
            break
        share = following
    return new(StepScaling, (share, True, evaluations))


_START, _EXACT, _STICKY = Branch.START.value, Branch.EXACT.value, Branch.STICKY.value
_FALLBACK, _DEPLETED = Branch.FALLBACK.value, Branch.DEPLETED.value
_EXIT, _FREE, _NONE = Branch.EXIT.value, Branch.FREE.value, Certificate.NONE.value
_STATE_ROUNDING: Final = 1e-12  # of the energy at hand: below it a rest is rounding, not a leak


class ScaledGroupParameters(Parameters):
    """Parameters of `step_scaling`."""

    alpha: Alpha = 0.0
    """Modulated damping per joule of surplus (eq. 19), always with its unit; 0: the surplus is not removed."""


class ScaledSettings(NamedTuple):
    """Constants of a run."""

    loop: group_kernel.GroupLoop
    alpha: float  # [s/m^2 or s/rad^2]


@dataclass(slots=True)
class ScaledState:
    """State kept from SYNC to SYNC, including that of the paper's flow chart (Fig. 6)."""

    h_dis: float = 0.0  # surplus still to be dissipated [J]
    h_s: float = 0.0  # energy stored at the state, computed from it [J]
    engaged: bool = False  # whether anything can be felt
    pace: float = 0.0  # size of the last change of state over the step of the model: its velocity over the measured one
    blind: int = 0  # holds for which a start goes on
    touched: bool = False  # whether the model was in contact
    group: group_kernel.Group = field(default_factory=group_kernel.Group)


class ScaledMemory(NamedTuple):
    """Buffers of a group; shapes (states,), (ports,) and (axes,)."""

    group: group_kernel.GroupMemory
    line: LineMemory
    model: Buffer  # state of the model
    rest: Buffer  # change of state that takes every storage back to its edge
    efforts: Buffer
    ports: Buffer  # motion of the ports in one hold [m or rad]
    whole: Buffer  # efforts at the ports [N or N*m]
    previous: Buffer  # displacement of the hold before, (axes,) [rad or m]
    spring: Buffer  # efforts to be sent, (axes,) [N*m or N]
    damper: Buffer


ScaledRun: TypeAlias = Run[ScaledSettings, ScaledState, ScaledMemory]
"""Settings, state and memory of a group."""


def begin_state(world: GroupModel, run: ScaledRun) -> None:
    """Set the state to the first coordinates, without strain, whose energy would not have come from any port."""
    _, state, memory = run
    motion, followed = state.group.motion, memory.group.motion.network
    state.h_s, state.engaged, state.pace, state.blind, state.touched = 0.0, False, 0.0, 0, False
    if not motion.located:
        return
    begin_network(world, motion.network, followed, memory.group.motion.coordinates)
    for i in range(len(followed.state)):
        followed.state[i] -= extension(world.tables, i, followed.state[i])
    settle_network(world, motion.network, followed)
    state.h_s = motion.network.energy
    write_model(world, run)
    state.touched = touches(world.tables, memory.model)


def exchange(world: GroupModel, run: ScaledRun, h_m: float, damped: float, power: float) -> HoldAccount:
    """Book the energy of a hold, after `group_kernel.move` advanced the motion, and update the stored state.

    Args:
        world: Network and kinematics of the group.
        run: Settings, state and memory of the group.
        h_m: Energy received by the model [J].
        damped: Damper efforts contained in the torques applied, times the displacements [J].
        power: The same efforts, times the velocities from which they were computed and the hold's length (eq. 18) [J].
    """
    _, state, memory = run
    motion, followed = state.group.motion, memory.group.motion
    if not motion.located or motion.began:
        available = state.h_s + h_m
        begin_state(world, run)
        rest = available - state.h_s
        return new(HoldAccount, (_EXIT, 0.0, 0.0, max(0.0, -rest), max(0.0, rest)))
    propose(world, motion.network, followed.network, followed.displacement, motion.elapsed)
    write_model(world, run)
    touching, touched = touches(world.tables, memory.model), state.touched
    entered, left = touching and not touched, touched and not touching
    state.touched = touching
    starts = touching and (entered or state.blind > 0 or (state.h_s == 0.0 and state.pace == 0.0))
    if starts and not entered and not is_pushed_inward(world, memory):
        state.blind, starts = 0, False
    account = start(world, run, h_m, entered) if starts else balance(world, run, h_m, damped, power)
    return leave(world, run, account, touching, left or h_m != 0.0)


def start(world: GroupModel, run: ScaledRun, h_m: float, entered: bool) -> HoldAccount:
    """Start a contact (eq. 14): set the state to the model's, and book its energy as generated.

    The user feels no torque until `delay` more holds have ended; until then the start continues.
    """
    settings, state, memory = run
    network, followed, model = state.group.motion.network, memory.group.motion.network, memory.model
    state.blind = settings.loop.delay if entered or state.blind == 0 else state.blind - 1
    available = state.h_s + h_m
    state.pace = share_inside(world.tables, followed.room, model) if entered else 1.0
    for i in range(len(model)):
        followed.state[i] = model[i]
    settle_network(world, network, followed)
    state.h_s = h_s = network.energy
    return new(HoldAccount, (_START, 0.0, max(0.0, h_s - available), 0.0, max(0.0, available - h_s)))


def lay_line(memory: ScaledMemory, step: Buffer) -> None:
    """Set the line on which the balance is solved: it begins at the state and goes along `step`."""
    line, state = memory.line, memory.group.motion.network.state
    for i in range(len(state)):
        line.state[i], line.step[i] = state[i], step[i]


def balance(world: GroupModel, run: ScaledRun, h_m: float, damped: float, power: float) -> HoldAccount:
    """Scale the model's step by the energy balance and add it to the state; without a solution, use eq. 18."""
    _, state, memory = run
    before, step = state.h_s, memory.group.motion.network.room.step
    lay_line(memory, step)
    loss = damped + state.group.motion.network.internal
    lossless = StepBalance(world.tables, world.functions, memory.line, h_m, 0.0)
    scale = solve_scale(StepBalance(world.tables, world.functions, memory.line, h_m, loss), FURTHEST)
    if scale.found and loss * scale.share < 0.0:
        loss = 0.0
        scale = solve_scale(lossless, FURTHEST)
    share = scale.share
    if not scale.found and h_m <= 0.0:
        return approximate(world, run, h_m, power, share)
    is_sticky = h_m > 0.0 and taken(lossless, 0.0)[1] * share < 0.0
    take(world, run, share, step)
    return settle_state(world, run, _STICKY if is_sticky else _EXACT, before + h_m, loss * share, share)


def approximate(world: GroupModel, run: ScaledRun, h_m: float, power: float, deepest: float) -> HoldAccount:
    """Dissipate the loss at the last velocity, as far as available; the state takes the remaining energy (eq. 18).

    If that releases too little, the step is taken up to its largest energy release, and the rest is a deficit.
    """
    tables, followed, h_s = world.tables, run.memory.group.motion.network, run.state.h_s
    line, rest, model, available = run.memory.line, run.memory.rest, followed.room.step, h_s + h_m
    h_r = min(max(0.0, power), max(0.0, available))
    left, is_empty = max(0.0, available) - h_r, available <= 0.0
    for i in range(len(rest)):
        rest[i] = -extension(tables, i, followed.state[i])
    lay_line(run.memory, rest)
    at = StepBalance(tables, world.functions, line, left - h_s, 0.0)
    sunk = solve_scale(at, 1.0)
    share, sinks = (sunk.share, True) if sunk.found else (deepest, False)
    is_bottom = left <= _STATE_ROUNDING * h_s  # a double root, not to be searched for
    if is_bottom and taken(at, 1.0)[0] <= (_STATE_ROUNDING - 1.0) * h_s:
        share, sinks = 1.0, True
    square = along = 0.0
    for i in range(len(model)):
        change = share * (rest[i] if sinks else model[i])
        line.step[i] = change
        square += model[i] * model[i]
        along += change * model[i]
    take(world, run, 1.0, line.step)
    pace = along / square if square > 0.0 and not is_empty else 0.0
    return settle_state(world, run, _DEPLETED if is_empty else _FALLBACK, available, h_r, pace)


def take(world: GroupModel, run: ScaledRun, share: float, step: Buffer) -> None:
    """Change the state by a share of a step, without crossing to the other side of a wall that the model touches."""
    tables, found, model = world.tables, run.memory.group.motion.network.state, run.memory.model
    write_model(world, run)
    for i in range(len(found)):
        found[i] += share * step[i]
    for i in tables.edged:
        true = extension(tables, i, model[i])
        if true * extension(tables, i, found[i]) <= 0.0 and true != 0.0:
            found[i] = tables.upper[i] if true > 0.0 else tables.lower[i]


def settle_state(
    world: GroupModel, run: ScaledRun, branch: int, available: float, h_r: float, pace: float
) -> HoldAccount:
    """Compute the energy of the new state; book an excess over the available energy as deficit, a shortfall as leak."""
    state, network = run.state, run.state.group.motion.network
    settle_network(world, network, run.memory.group.motion.network)
    state.h_s, state.pace = network.energy, pace
    rest = available - h_r - state.h_s
    if abs(rest) <= _STATE_ROUNDING * max(abs(available), h_r, state.h_s):
        rest = 0.0
    return new(HoldAccount, (branch, h_r, 0.0, max(0.0, -rest), max(0.0, rest)))


def leave(world: GroupModel, run: ScaledRun, account: HoldAccount, touching: bool, exchanged: bool) -> HoldAccount:
    """Empty the storages with which the model is no longer in contact, and book their energy as leak."""
    tables, state, motion = world.tables, run.state, run.state.group.motion
    followed, model = run.memory.group.motion.network, run.memory.model
    branch, h_r, gen, deficit, leak = account
    if not tables.moving:
        before = motion.network.energy
        write_model(world, run)
        for i in tables.edged:
            if extension(tables, i, model[i]) == 0.0:
                upper, lower = tables.upper[i], tables.lower[i]
                followed.state[i] = upper if abs(model[i] - upper) <= abs(model[i] - lower) else lower
        settle_network(world, motion.network, followed)
        state.h_s = motion.network.energy
        leak = leak + before - motion.network.energy
    state.engaged = touching and motion.limit == 0
    if not touching:
        state.pace, state.blind = 0.0, 0
        branch = _EXIT if exchanged or leak != 0.0 else _FREE
    return new(HoldAccount, (branch, h_r, gen, deficit, leak))


def write_model(world: GroupModel, run: ScaledRun) -> None:
    """Write the model's state to its buffer: from the ports, or for a network that moves by itself, one step on."""
    followed, model, motion = run.memory.group.motion.network, run.memory.model, run.state.group.motion
    if world.tables.moving or not motion.located:
        for i in range(len(model)):
            model[i] = followed.state[i] + followed.room.step[i]
    else:
        place_state(world.tables, followed, run.memory.group.motion.coordinates, model)


def touches(tables: NetworkTables, model: Buffer) -> bool:
    """Return whether the model is in contact."""
    if tables.always or len(tables.edged) == 0:
        return True
    for i in tables.edged:
        if extension(tables, i, model[i]) != 0.0:
            return True
    return False


def is_pushed_inward(world: GroupModel, memory: ScaledMemory) -> bool:
    """Return whether the step stores energy at the model's state, or moves there without any opposing effort."""
    tables, efforts, step = world.tables, memory.efforts, memory.group.motion.network.room.step
    gradient(tables, memory.model, efforts)
    if tables.by_functions:
        world.functions.add_gradient(memory.model, efforts)
    along, moves = 0.0, False
    for i in range(len(step)):
        along += efforts[i] * step[i]
        if step[i] != 0.0:
            moves = True
    return along > 0.0 or (along == 0.0 and moves)


def write_state_efforts(world: GroupModel, run: ScaledRun) -> float:
    """Write the efforts of springs and dampers at motors and ports; return what the dampers dissipate in a hold [J]."""
    _, state, memory = run
    motion, followed, tables = state.group.motion, memory.group.motion, world.tables
    holds, ports, network = motion.holds, memory.ports, followed.network
    for j in range(len(ports)):
        ports[j] = state.pace * followed.displacement[j] / holds
    for j in range(len(network.room.engaged)):
        network.room.engaged[j] = 1.0
    write_model(world, run)
    spring, damper = followed.spring_at_ports, followed.damper_at_ports
    dampers(tables, network, ports, motion.elapsed / holds, memory.model, damper)
    springs(world, network, 0.0, 1, ports, spring, followed.lead_at_ports)
    power = 0.0
    for j in range(len(ports)):
        power += damper[j] * ports[j]
        memory.whole[j] = spring[j] + damper[j]
    to_motors(followed, spring, memory.spring)
    to_motors(followed, damper, memory.damper)
    return power


def settings_of(
    world: GroupModel, parameters: ScaledGroupParameters, loops: tuple[LoopProperties, ...]
) -> ScaledSettings:
    """Return the constants of a run."""
    return ScaledSettings(group_kernel.group_loop(world, loops), parameters.alpha)


def memory_of(world: GroupModel, settings: ScaledSettings) -> ScaledMemory:
    """Return the buffers of a group at rest."""
    axes, ports, states = len(settings.loop.caps), world.geometry.ports, len(world.tables.stiffness)
    sizes = [states] * 3 + [ports] * 2 + [axes] * 3
    return ScaledMemory(
        group_kernel.group_memory(world, settings.loop, ports),
        line_memory(states),
        *(list_of_zeros(size) for size in sizes),
    )


def step(world: GroupModel, run: ScaledRun, missed: int, positions: Buffer, torques_applied: Buffer) -> GroupHold:
    """Book the hold that ended and send the next torques; see `canhaptic.kernels.Kernel`."""
    settings, state, memory = run
    group, motion, ended, loop = state.group, state.group.motion, memory.group.ended, settings.loop
    if not group.started:
        begin_group(world, loop.motion, group, memory.group, positions)
        begin_state(world, run)
        return new(GroupHold, (AT_REST, 0.0, 0.0, 0, 0))
    commands = memory.group.commands
    group.oldest = end_holds(commands, ended, loop.largest, group.oldest, missed, positions, torques_applied)
    place, uncertainty = group.oldest, uncertainty_of_gap(ended, memory.previous, missed)
    move(world, loop.motion, motion, memory.group.motion, positions, ended.displacement, missed + 1)
    h_i = h_pas = damped = supplied = 0.0
    for i in range(len(positions)):
        h_i += ended.interactions[i]
        h_pas += commands.modulated[place][i] * ended.displacement[i]
        damped += commands.dampers[place][i] * ended.displacement[i]
    for j in range(len(commands.ports[place])):
        supplied -= commands.ports[place][j] * motion.moved
    h_i = h_i + supplied - uncertainty
    branch, h_r, gen, deficit, leak = exchange(world, run, h_i - h_pas, damped, commands.power[place] * (missed + 1))
    surplus = state.h_dis + gen + deficit - h_pas
    paid = min(leak, surplus) if leak > 0.0 and surplus > 0.0 else 0.0
    state.h_dis = surplus - paid
    rendered = send(world, run)
    balance = new(EnergyBalance, (
        norm(commands.torques[place]), h_i, h_pas, h_i - h_pas, h_r, state.h_s, state.h_dis, gen, deficit,
        leak, paid, branch, rendered, _NONE, memory.group.motion.network.state[0], supplied,
    ))  # fmt: skip
    return new(GroupHold, (balance, uncertainty, uncertainty, motion.limit, place))


def send(world: GroupModel, run: ScaledRun) -> float:
    """Send the torques of springs, dampers and modulated damper at the stored state; return the damping rendered."""
    settings, state, memory = run
    group, commands, caps = state.group, memory.group.commands, settings.loop.caps
    place, displacement, elapsed = group.oldest, memory.group.ended.displacement, group.motion.elapsed
    if not state.engaged:
        group.oldest = send_nothing(commands, place)
        return 0.0
    spring, damper = memory.spring, memory.damper
    power = write_state_efforts(world, run)
    size = room = square = moved = along = extra = 0.0
    for i in range(len(caps)):
        velocity = state.pace * displacement[i] / elapsed
        size += damper[i] * damper[i] / caps[i]
        room += caps[i] * velocity * velocity
        square += velocity * velocity
        moved += displacement[i] * displacement[i]
    share = 1.0
    if size > room and not world.tables.moving:
        share = sqrt(room / size)
    for i in range(len(caps)):
        damper[i] *= share
        along += damper[i] * (state.pace * displacement[i] / elapsed)
    rendered, moved = along / square if square != 0.0 else 0.0, sqrt(moved)
    if settings.alpha > 0.0 and state.h_dis > 0.0 and moved != 0.0:
        extra = modulated_damping(settings.alpha, state.h_dis, rendered, settings.loop.least_cap, moved, elapsed)
    for i in range(len(caps)):
        modulated = extra * displacement[i] / elapsed
        commands.torques[place][i] = -spring[i] - damper[i] - modulated
        commands.dampers[place][i], commands.modulated[place][i] = damper[i], modulated
    for j in range(len(memory.whole)):
        commands.ports[place][j] = memory.whole[j]
    commands.power[place] = share * power
    group.oldest = next_place(commands, place)
    return rendered + extra


class ScaledGroup(group_kernel.SteppedGroup):
    """Controller of several axes that renders a network whose state stores received energy only."""

    parameters_type: ClassVar[type[Parameters]] = ScaledGroupParameters
    kernel: ClassVar[Kernel] = Kernel(settings_of, ScaledState, memory_of, step)
