"""The equation of one sample of a network at a given step of its state: efforts, losses, residual and Jacobian.

s = T (J e - sum(a_j phi_j(f_j))) + g dc,    e = e_dg(x, x + s),    f_j = a_j . e + b_j . dc / T
"""

import math
from typing import NamedTuple

from canhaptic.control.port_hamiltonian.discrete_gradient import NetworkTables, discrete_gradient, extension
from canhaptic.control.port_hamiltonian.user_energy import Functions
from canhaptic.kernels import Buffer, Matrix, list_of_zeros, zeros


class Workspace(NamedTuple):
    """Buffers that a step writes; shapes (n,), (d,) and (n, n)."""

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
    """Return zeros of the sizes that a network needs."""
    n, d, one = states, dissipators, list_of_zeros
    return Workspace(
        one(n), one(n), one(n), one(d), one(d), one(d), one(d), one(n), one(n), one(n), one(n), one(n), one(n),
        zeros(n, n), zeros(n, n),
    )  # fmt: skip


def drive(tables: NetworkTables, state: Buffer, displacement: Buffer, room: Workspace) -> None:
    """Write g dc, and the engaged share of the motion for every dissipator in parallel to a storage."""
    driven, step = room.driven, room.step
    for i in range(len(driven)):
        row, total = tables.gain[i], 0.0
        for j in range(len(row)):
            total += row[j] * displacement[j]
        driven[i] = total
        if not tables.moving:
            step[i] = total
    for j in range(len(room.engaged)):
        storage = tables.beside[j]
        room.engaged[j] = 1.0 if storage < 0 else engaged_share(tables, storage, state[storage], step[storage])


def engaged_share(tables: NetworkTables, index: int, value: float, change: float) -> float:
    """Return the share of a state's change during which its storage was engaged; 0 where it is not at the end."""
    after = extension(tables, index, value + change)
    if tables.lower[index] == tables.upper[index]:
        return 1.0
    if after == 0.0:
        return 0.0
    return (after - extension(tables, index, value)) / change if change != 0.0 else 1.0


def dissipate(tables: NetworkTables, displacement: Buffer, sample_time: float, room: Workspace) -> None:
    """Write flow, effort and slope of every dissipator at the efforts of the step."""
    efforts = room.efforts
    for j in range(len(room.flows)):
        flow = 0.0
        row = tables.on_ports[j]
        for i in range(len(row)):
            flow += row[i] * displacement[i]
        flow /= sample_time
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


def evaluate(
    tables: NetworkTables,
    state: Buffer,
    displacement: Buffer,
    sample_time: float,
    room: Workspace,
    functions: Functions,
) -> float:
    """Write the residual of the equation at `room.step`; return its largest entry over the size of its terms.

    Infinite where an entry is no finite number.
    """
    n = len(room.step)
    discrete_gradient(tables, state, room.step, room.efforts, room.slopes)
    if tables.by_functions:
        functions.add_discrete_gradient(state, room.step, room.efforts)
    dissipate(tables, displacement, sample_time, room)
    worst = 0.0
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


def linearise(tables: NetworkTables, sample_time: float, room: Workspace, functions: Functions) -> None:
    """Write the Jacobian of the equation, I + T (R' - J) de/ds."""
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
        functions.add_slopes(mobility, jacobian)
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
