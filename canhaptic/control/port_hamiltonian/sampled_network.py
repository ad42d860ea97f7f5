"""A network advanced from sample to sample by the measured motion of its ports.

In a sample of length T the ports move by dc; the state x then changes by the s that solves

    s = T (J e - sum(a_j phi_j(f_j))) + g dc,    e = e_dg(x, x + s),    f_j = a_j . e + b_j . dc / T

with e_dg the discrete gradient of the stored energy (see `network`). J is skew and e . s = H(x + s) - H(x), so that for
every T

    H(x + s) - H(x) = y . dc - T sum(phi_j f_j),    y = g'e + sum(b_j phi_j),    phi_j f_j >= 0

In a network without masses, which only its ports move, s = g dc and there is nothing to solve. Otherwise Newton's
method solves for s as long as the residual falls from step to step. Near a double well the residual can have a minimum
that is no solution. From there on the search follows the power r . de along a step, with r the residual and de the
change of the efforts. If springs act on masses, that power is the slope of a potential (the masses' change of velocity,
the losses and the integral of the springs' discrete gradients), and every level point of it is a solution: the search
goes downhill until it is level.
"""

import math
from dataclasses import dataclass
from math import sqrt
from typing import Final, NamedTuple, Protocol

from canhaptic.control.port_hamiltonian.network import (
    Functions,
    NetworkTables,
    discrete_gradient,
    dot,
    extension,
    gradient,
    solve_linear,
    stored_energy,
)
from canhaptic.kernels import Buffer, Matrix, list_of_zeros, zeros


class Workspace(NamedTuple):
    """Buffers of one sample of a network with n states and d dissipators; shapes (n,), (d,) and (n, n)."""

    step: Buffer  # s; the guess before, the solution after
    efforts: Buffer  # e
    slopes: Buffer
    flows: Buffer  # f_j
    losses: Buffer  # phi_j(f_j)
    factors: Buffer  # d phi_j / d f_j
    engaged: Buffer  # share of the motion in which dissipator j was engaged, 0..1
    driven: Buffer  # g dc
    residual: Buffer
    direction: Buffer  # of Newton's step
    scale: Buffer  # of the residual, fixed before the first evaluation of a sample
    weights: Buffer  # change of the efforts along the direction, for the power of a step
    before: Buffer  # the step where a search along a direction began
    jacobian: Matrix
    mobility: Matrix  # T (J - R) as it acts on e


def new_workspace(states: int, dissipators: int) -> Workspace:
    """Return buffers of zeros for one sample of a network."""
    n, d, one = states, dissipators, list_of_zeros
    return Workspace(
        one(n), one(n), one(n), one(d), one(d), one(d), one(d), one(n), one(n), one(n), one(n), one(n), one(n),
        zeros(n, n), zeros(n, n),
    )  # fmt: skip


class NetworkModel(Protocol):
    """Interface to the numbers and functions of a network, as `network.Network` and the model of a group have it."""

    @property
    def tables(self) -> NetworkTables:
        """The network as numbers."""

    @property
    def functions(self) -> Functions:
        """Energies and structure given as functions."""


class NetworkSample(NamedTuple):
    """One sample of a network."""

    state: Buffer  # x at the start of the hold, (n,)
    displacement: Buffer  # motion of the ports during it, (r,)
    sample_time: float  # T, or several of them where samples were lost [s]
    room: Workspace  # `step` holds a guess, and the solution afterwards


def drive(tables: NetworkTables, state: Buffer, displacement: Buffer, room: Workspace) -> None:
    """Compute the state change by the ports, g dc, and the share of the motion in which each dissipator is engaged."""
    driven, step = room.driven, room.step
    for i in range(len(driven)):
        driven[i] = dot(tables.gain[i], displacement)
        if not tables.moving:
            step[i] = driven[i]
    for j in range(len(room.engaged)):
        storage = tables.beside[j]
        room.engaged[j] = 1.0 if storage < 0 else engaged_share(tables, storage, state[storage], step[storage])


def engaged_share(tables: NetworkTables, index: int, value: float, change: float) -> float:
    """Return the share of a state's change during which its storage was engaged; 0 if it ends disengaged."""
    after = extension(tables, index, value + change)
    if tables.lower[index] == tables.upper[index]:
        return 1.0
    if after == 0.0:
        return 0.0
    return (after - extension(tables, index, value)) / change if change != 0.0 else 1.0


def dissipate(tables: NetworkTables, displacement: Buffer, sample_time: float, room: Workspace) -> None:
    """Compute flow, effort and d effort / d flow of every dissipator, at the storages' efforts in the step."""
    efforts = room.efforts
    for j in range(len(room.flows)):
        flow = dot(tables.on_ports[j], displacement) / sample_time
        if tables.moving:
            row = tables.on_states[j]
            for i in range(len(row)):
                flow += row[i] * efforts[i]
        room.flows[j] = flow
        r, r2, friction, share = tables.viscous[j], tables.squared[j], tables.coulomb[j], room.engaged[j]
        size = abs(flow)
        loss, factor = flow * (r + r2 * size), r + 2.0 * r2 * size
        if friction != 0.0:
            corner = tables.corner[j]
            root = math.sqrt(flow * flow + corner * corner)
            loss += friction * flow / root
            factor += friction * corner * corner / (root * root * root)
        room.losses[j] = share * loss
        room.factors[j] = share * factor


def write_losses(model: NetworkModel, sample: NetworkSample) -> None:
    """Compute the storages' efforts in the step, and the resulting flow and effort of every dissipator."""
    tables, state, room = model.tables, sample.state, sample.room
    discrete_gradient(tables, state, room.step, room.efforts, room.slopes)
    if tables.by_functions:
        model.functions.add_discrete_gradient(state, room.step, room.efforts)
    dissipate(tables, sample.displacement, sample.sample_time, room)


def evaluate(model: NetworkModel, sample: NetworkSample) -> float:
    """Compute the residual of the module's equation at `room.step`; return its largest entry relative to its terms.

    The result is infinite if an entry is not finite.
    """
    tables, sample_time, room = model.tables, sample.sample_time, sample.room
    write_losses(model, sample)
    n, worst = len(room.step), 0.0
    for i in range(n):
        row, total = tables.structure[i], 0.0
        size = abs(room.step[i]) + abs(room.driven[i])
        for k in range(n):
            if row[k] != 0.0:
                term = row[k] * room.efforts[k]
                total += term
                size += sample_time * abs(term)
        for j in range(len(room.losses)):
            a = tables.on_states[j][i]
            if a != 0.0:
                term = a * room.losses[j]
                total -= term
                size += sample_time * abs(term)
        missing = room.step[i] - sample_time * total - room.driven[i]
        room.residual[i] = missing
        if not abs(missing) < math.inf:
            return math.inf
        if abs(missing) > worst * size:
            worst = abs(missing) / size
    return worst


def linearise(model: NetworkModel, sample: NetworkSample) -> None:
    """Compute the Jacobian of the module's equation with respect to s: I + T (R' - J) de/ds."""
    tables, sample_time, room = model.tables, sample.sample_time, sample.room
    n = len(room.step)
    mobility, jacobian = room.mobility, room.jacobian
    for i in range(n):
        structure, row = tables.structure[i], mobility[i]
        for k in range(n):
            row[k] = -sample_time * structure[k]
    for j in range(len(room.factors)):
        _add_square(mobility, tables.on_states[j], sample_time * room.factors[j])
    for i in range(n):
        row, into = mobility[i], jacobian[i]
        for k in range(n):
            into[k] = row[k] * room.slopes[k]
    if tables.coupled:
        _add_product(mobility, tables.quadratic, jacobian)
    if tables.by_functions:
        model.functions.add_slopes(mobility, jacobian)
    for i in range(n):
        jacobian[i][i] += 1.0


def _add_square(matrix: Matrix, row: Buffer, factor: float) -> None:
    """Add factor a a'."""
    for i in range(len(row)):
        if row[i] != 0.0:
            scaled, into = factor * row[i], matrix[i]
            for k in range(len(row)):
                into[k] += scaled * row[k]


def _add_product(left: Matrix, right: Matrix, into: Matrix) -> None:
    """Add half the product of two matrices."""
    n = len(left)
    for i in range(n):
        for k in range(n):
            total = 0.0
            for j in range(n):
                total += left[i][j] * right[j][k]
            into[i][k] += 0.5 * total


_EVALUATIONS: Final = 60
"""Most evaluations of the equation in one sample."""
_BY_RESIDUAL: Final = 18
"""Evaluations after which Newton's method is replaced by the search by power (see the module)."""
_CLOSE: Final = 4e-16
"""Residual, relative to the terms of the equation, at which a solution is exact to rounding."""
_FLOOR: Final = 1e-11
"""Relative residual below which one that falls no more is taken as rounding: forces of very stiff springs cancel."""
_ROUNDING: Final = 1e-14
"""Relative residual below which a Newton step is accepted even if the residual does not fall."""
_HALVINGS: Final = 8
"""Most halvings of a Newton step while the residual does not fall; the shortest step is then taken."""
_LEAST_SCALE: Final = 1e-3
"""Added to the square root of the stiffness that scales a state's residual, which may be 0."""
_STEEP: Final = 0.9
"""Ratio of the power at the end of a step to the power at its start: above it, a longer step follows."""
_LONGER: Final = 3.0
_LEVEL: Final = 0.5
"""Ratio of the power at the end of a step to the power at its start: up to it, the step is accepted."""
_INSIDE: Final = 0.1
"""Fraction of the interval that brackets the solution, at either end, in which no further point is tried."""


def advance(model: NetworkModel, sample: NetworkSample) -> int:
    """Find the state change of one sample; return the evaluations it took, negative if it did not converge."""
    room = sample.room
    drive(model.tables, sample.state, sample.displacement, room)
    for i in range(len(room.scale)):
        room.scale[i] = math.sqrt(abs(model.tables.stiffness[i])) + _LEAST_SCALE
    evaluations = _by_residual(model, sample)
    return evaluations if evaluations > 0 else by_power(model, sample, -evaluations)


def _by_residual(model: NetworkModel, sample: NetworkSample) -> int:
    """Solve by Newton's method while the residual falls; return the evaluations, negative if it found no solution."""
    room, worst, evaluations = sample.room, evaluate(model, sample), 1
    while worst > _CLOSE:
        before, merit = worst, _merit_of(room)
        linearise(model, sample)
        if not solve_linear(room.jacobian, room.residual):
            return -evaluations
        for i in range(len(room.step)):
            room.direction[i] = room.residual[i]
        worst, tried = _descend(model, sample, merit)
        evaluations += tried
        if worst <= _FLOOR and worst > 0.25 * before:
            break  # Newton's method gains nothing more: rounding
        if evaluations >= _BY_RESIDUAL or (tried == _HALVINGS and worst > _ROUNDING and not _merit_of(room) < merit):
            return -evaluations
    return evaluations


def _merit_of(room: Workspace) -> float:
    """Return the squared norm of the residual, each entry multiplied by its scale."""
    total = 0.0
    for i in range(len(room.residual)):
        part = room.residual[i] * room.scale[i]
        total += part * part
    return total


def _descend(model: NetworkModel, sample: NetworkSample, before: float) -> tuple[float, int]:
    """Step along Newton's direction as far as the residual falls; return (residual, evaluations)."""
    room, share, taken, worst = sample.room, 1.0, 0.0, 1.0
    for tried in range(1, _HALVINGS + 1):
        for i in range(len(room.step)):
            room.step[i] -= (share - taken) * room.direction[i]
        taken = share
        worst = evaluate(model, sample)
        if worst <= _ROUNDING or _merit_of(room) < before:
            return worst, tried
        share *= 0.5
    return worst, _HALVINGS


def by_power(model: NetworkModel, sample: NetworkSample, spent: int) -> int:
    """Search for the solution where the power r . de of a step vanishes, if Newton's method stalls (see the module).

    The first step is a full Newton step: after it the equations without forces hold, and only forces have power.

    Args:
        model: The network.
        sample: The sample; `step` of its workspace is where Newton's method stopped.
        spent: Evaluations so far.

    Returns:
        All evaluations of the sample, negative where no solution was found.
    """
    room, worst = sample.room, evaluate(model, sample)
    evaluations, whole = spent + 1, True
    while worst > _CLOSE:
        if evaluations >= _EVALUATIONS:
            return -evaluations
        before, near = worst, worst <= _FLOOR
        power = _aim(model, sample)
        if not (power > 0.0 or near):  # upwards, along a slope below 0: as if it were level
            for i in range(len(room.slopes)):
                room.slopes[i] = max(room.slopes[i], 0.0)
            power = _aim(model, sample)
        left = 1 if whole or near or not power > 0.0 else _EVALUATIONS - evaluations
        worst, tried = _go_down(model, sample, power, left)
        evaluations, whole = evaluations + tried, False
        if worst <= _FLOOR and worst > 0.25 * before:
            break
    return evaluations


def _aim(model: NetworkModel, sample: NetworkSample) -> float:
    """Compute Newton's direction and the change of efforts along it; return the power r . de, 0 if there is none."""
    tables, room = model.tables, sample.room
    n = len(room.step)
    linearise(model, sample)
    for i in range(n):
        room.direction[i] = room.residual[i]
    if not solve_linear(room.jacobian, room.direction):
        return 0.0
    for i in range(n):
        weight = max(room.slopes[i], 0.0) * room.direction[i]
        if tables.coupled:
            for k in range(n):
                weight += 0.5 * tables.quadratic[i][k] * room.direction[k]
        room.weights[i] = weight
    if tables.by_functions:
        model.functions.add_change(room.direction, room.weights)
    return dot(room.residual, room.weights)  # the power r . de


def _go_down(model: NetworkModel, sample: NetworkSample, power: float, left: int) -> tuple[float, int]:
    """Search along the direction for a step at which the power is small; return (residual, evaluations).

    Args:
        model: The network.
        sample: The sample; `direction` and `weights` of its workspace give the direction.
        power: Power r . de at the start of the step; > 0 if `left` is more than 1.
        left: Evaluations left; 1: the whole step is accepted.
    """
    room = sample.room
    for i in range(len(room.step)):
        room.before[i] = room.step[i]
    share, low, high, at_low, at_high, worst = 1.0, 0.0, 0.0, power, 0.0, 1.0
    for tried in range(1, left + 1):
        for i in range(len(room.step)):
            room.step[i] = room.before[i] - share * room.direction[i]
        worst = evaluate(model, sample)
        here = dot(room.residual, room.weights) if worst < math.inf else -math.inf
        if worst <= _FLOOR or abs(here) <= _LEVEL * power or (high == 0.0 and 0.0 < here <= _STEEP * power):
            return worst, tried
        if here < 0.0:
            at_low *= 0.5 if at_high < 0.0 else 1.0  # the same end again: the other counts for less (Illinois)
            high, at_high = share, here
        else:
            low, at_low = share, here
        if high == 0.0:
            share *= _LONGER
        else:
            share = low + (high - low) * min(max(at_low / (at_low - at_high), _INSIDE), 1.0 - _INSIDE)
    return worst, left


def rest_on_ports(model: NetworkModel, sample: NetworkSample) -> None:
    """Fall back to s = g dc if no solution was found: only the ports move the states, and no energy is created."""
    room = sample.room
    for i in range(len(room.step)):
        room.step[i] = room.driven[i]
    write_losses(model, sample)


@dataclass(slots=True)
class NetworkState:
    """Energy, losses and engagement of a network after the last sample."""

    energy: float = 0.0  # H(x) [J]
    internal: float = 0.0  # dissipated on the states in the last step, without the ports' part [J]
    engaged: bool = False  # whether any storage that can be left is engaged, or there is one that cannot
    evaluations: int = 0  # of the equation in the last step; negative where it did not converge


class NetworkMemory(NamedTuple):
    """Buffers of a sampled network."""

    state: Buffer  # x, (states,)
    begun: Buffer  # x at the first sample
    first: Buffer  # coordinates of the ports there [m or rad]
    ahead: Buffer  # efforts of the state ahead, (states,)
    moved: Buffer  # that state
    room: Workspace


def network_memory(tables: NetworkTables) -> NetworkMemory:
    """Return the buffers of a network, at rest."""
    n = len(tables.stiffness)
    ports = list_of_zeros(len(tables.gain[0]))
    room = new_workspace(n, len(tables.viscous))
    return NetworkMemory(list_of_zeros(n), list_of_zeros(n), ports, list_of_zeros(n), list_of_zeros(n), room)


def begin_network(model: NetworkModel, network: NetworkState, memory: NetworkMemory, coordinates: Buffer) -> None:
    """Start a network at given coordinates of its ports: walls at their positions, masses at rest."""
    for j in range(len(coordinates)):
        memory.first[j] = coordinates[j]
    for i in range(len(memory.state)):
        memory.state[i] = memory.begun[i] = dot(model.tables.origin[i], coordinates)
        memory.room.step[i] = 0.0
    settle_network(model, network, memory)
    network.internal, network.evaluations = 0.0, 0


def advance_network(
    model: NetworkModel, network: NetworkState, memory: NetworkMemory, coordinates: Buffer, displacement: Buffer,
    elapsed: float,
) -> bool:  # fmt: skip
    """Advance a network by one motion of its ports; return False if unsolved: then only the ports moved the state.

    Args:
        model: The network.
        network: State of the network; changed.
        memory: Buffers of the network; changed.
        coordinates: Coordinates of the ports at the end [m or rad].
        displacement: Motion of the ports, less the mover's [m or rad].
        elapsed: One sample time, or several [s].
    """
    solved = propose(model, network, memory, displacement, elapsed)
    if model.tables.moving:
        for i in range(len(memory.state)):
            memory.state[i] += memory.room.step[i]
    else:
        place_state(model.tables, memory, coordinates, memory.state)
    settle_network(model, network, memory)
    return solved


def propose(
    model: NetworkModel, network: NetworkState, memory: NetworkMemory, displacement: Buffer, elapsed: float
) -> bool:
    """Find the state change for one motion of the ports without applying it; see `advance_network`."""
    tables, room = model.tables, memory.room
    network.internal, network.evaluations = 0.0, 1
    if not tables.moving:  # s = g dc: nothing to solve, and nothing dissipated beyond the ports
        drive(tables, memory.state, displacement, room)
        return True
    if tables.by_functions:
        model.functions.fill_structure(memory.state, tables.structure)
    sample = NetworkSample(memory.state, displacement, elapsed, room)
    network.evaluations = advance(model, sample)
    if network.evaluations < 0:
        rest_on_ports(model, sample)
        return False
    inner = 0.0
    for j in range(len(room.losses)):
        inner += room.losses[j] * (room.flows[j] * elapsed - dot(tables.on_ports[j], displacement))
    network.internal = inner
    return True


def place_state(tables: NetworkTables, memory: NetworkMemory, coordinates: Buffer, into: Buffer) -> None:
    """Compute the state of a network without masses from the ports' coordinates, so that rounding does not add up."""
    for i in range(len(into)):
        row, total = tables.gain[i], memory.begun[i]
        for j in range(len(coordinates)):
            total += row[j] * (coordinates[j] - memory.first[j])
        into[i] = total


def settle_network(model: NetworkModel, network: NetworkState, memory: NetworkMemory) -> None:
    """Update the stored energy of a network, and whether it is in contact, from its state."""
    tables = model.tables
    energy, engaged = stored_energy(tables, memory.state), tables.always
    if tables.by_functions:
        energy += model.functions.energy(memory.state)
    if not engaged:
        for i in tables.edged:
            if extension(tables, i, memory.state[i]) != 0.0:
                engaged = True
                break
    network.energy, network.engaged = energy, engaged


def springs(
    model: NetworkModel, memory: NetworkMemory, lead: float, holds: int, way: Buffer, spring: Buffer, added: Buffer
) -> None:
    """Compute the storages' present efforts at the ports, and the change of these efforts by a predicted motion.

    A wall that is not in contact now has no predicted effort.

    Args:
        model: The network.
        memory: Buffers of the network.
        lead: Length of the prediction [holds]; the network's own motion continues as in the last step.
        holds: Number of holds that the last step spanned.
        way: Predicted motion of the ports [m or rad].
        spring: Receives the efforts, (ports,).
        added: Receives their change, (ports,).
    """
    tables, room, state = model.tables, memory.room, memory.state
    now, ahead, moved, gain = room.efforts, memory.ahead, memory.moved, tables.gain
    for i in range(len(state)):
        moved[i] = state[i] + (lead * ((room.step[i] - room.driven[i]) / holds) + dot(gain[i], way))
    gradient(tables, state, now)
    gradient(tables, moved, ahead)
    if tables.by_functions:
        model.functions.add_gradient(state, now)
        model.functions.add_gradient(moved, ahead)
    for i in tables.edged:
        if now[i] == 0.0 or now[i] * ahead[i] < 0.0:
            ahead[i] = 0.0
    for j in range(len(spring)):
        spring[j] = added[j] = 0.0
    for i in range(len(state)):
        row = gain[i]
        for j in range(len(spring)):
            if row[j] != 0.0:
                spring[j] += row[j] * now[i]
                added[j] += row[j] * (ahead[i] - now[i])


def dampers(
    tables: NetworkTables, memory: NetworkMemory, displacement: Buffer, elapsed: float, state: Buffer, efforts: Buffer
) -> None:
    """Compute the dissipators' efforts at the ports for a given motion; call it before `springs` overwrites its buffer.

    Args:
        tables: The network.
        memory: Buffers of the network.
        displacement: Motion of the ports [m or rad].
        elapsed: Duration of that motion [s].
        state: State that determines which storages are engaged, (states,).
        efforts: Receives the efforts, (ports,).
    """
    room = memory.room
    for i in range(len(efforts)):
        efforts[i] = 0.0
    if len(room.losses) == 0:
        return
    dissipate(tables, displacement, elapsed, room)
    for j in range(len(room.losses)):
        storage = tables.beside[j]
        if (
            storage >= 0
            and tables.lower[storage] != tables.upper[storage]
            and extension(tables, storage, state[storage]) == 0.0
        ):
            continue
        row = tables.on_ports[j]
        for i in range(len(efforts)):
            if row[i] != 0.0:
                efforts[i] += row[i] * room.losses[j]


def internal_motion(tables: NetworkTables, room: Workspace) -> float:
    """Return how far the storages at the ports moved relative to the ports in the last sample, as a norm [m or rad]."""
    total = 0.0
    if tables.moving:
        for i in range(len(room.step)):
            row, is_at_port = tables.gain[i], False
            for j in range(len(row)):
                if row[j] != 0.0:
                    is_at_port = True
            if is_at_port:
                apart = room.step[i] - room.driven[i]
                total += apart * apart
    return sqrt(total)


def share_inside(tables: NetworkTables, room: Workspace, after: Buffer) -> float:
    """Return the largest share of the last sample, ending at the state `after`, in which a storage was engaged."""
    largest = 0.0
    for i in tables.edged:
        changed = room.step[i]
        share = engaged_share(tables, i, after[i] - changed, changed)
        if share > largest:
            largest = share
    return largest if largest > 0.0 else 1.0
