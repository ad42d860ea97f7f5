"""One sample of a network: the state change that the discrete gradient balances with the motion of its ports.

    s = T (J e - sum(a_j phi_j(f_j))) + g dc,    e = e_dg(x, x + s),    f_j = a_j . e + b_j . dc / T

J is skew and e . s = H(x + s) - H(x), so that whatever T is

    H(x + s) - H(x) = y . dc - T sum(phi_j f_j),    y = g'e + sum(b_j phi_j),    phi_j f_j >= 0

Newton's method solves for s. A network whose state is moved by its ports alone (springs and dampers, no masses) has
s = g dc and nothing to solve.
"""

import math
from typing import Any, Final, NamedTuple

from canhaptic.haptics.network.tables import Matrix, Tables, Vector, discrete_gradient, extension

EVALUATIONS: Final = 60
"""Most evaluations of the equation in one sample."""
_CLOSE: Final = 4e-16
"""Of the terms of the equation: rounding."""
_FLOOR: Final = 1e-11
"""Below it a residual that falls no more is rounding: forces of very stiff springs cancel."""
_ROUNDING: Final = 1e-14
"""Below it the residual need not fall any more."""
_HALVINGS: Final = 8
"""Of a Newton step after which the residual has not fallen; the shortest is taken all the same."""
_LEAST_SCALE: Final = 1e-3
"""Added to the root of a stiffness, for states that it leaves without a scale."""


class Room(NamedTuple):
    """Where a step writes; shapes (n,), (d,) and (n, n)."""

    step: Vector  # s; the guess before, the solution after
    efforts: Vector  # e
    slopes: Vector
    flows: Vector  # f_j
    losses: Vector  # phi_j(f_j)
    factors: Vector  # d phi_j / d f_j
    engaged: Vector  # share of the motion in which dissipator j was engaged, 0..1
    driven: Vector  # g dc
    residual: Vector
    direction: Vector  # of Newton's step
    scale: Vector  # of the residual, fixed in the first evaluation of a sample
    jacobian: Matrix
    mobility: Matrix  # T (J - R) as it acts on e


def new_room(states: int, dissipators: int) -> Room:
    """Returns empty lists of the sizes that a network needs."""

    def zeros(count: int) -> list[float]:
        return [0.0] * count

    n, d = states, dissipators
    return Room(
        zeros(n), zeros(n), zeros(n), zeros(d), zeros(d), zeros(d), zeros(d), zeros(n), zeros(n), zeros(n), zeros(n),
        [zeros(n) for _ in range(n)], [zeros(n) for _ in range(n)],
    )  # fmt: skip


def drive(tables: Tables, state: Vector, displacement: Vector, room: Room) -> None:
    """Writes g dc, and how much of the motion every dissipator beside a storage took part in."""
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


def engaged_share(tables: Tables, index: int, value: float, change: float) -> float:
    """Returns the share of a state's change during which its storage was engaged; 0 where it is not at the end."""
    after = extension(tables, index, value + change)
    if tables.lower[index] == tables.upper[index]:
        return 1.0
    if after == 0.0:
        return 0.0
    return (after - extension(tables, index, value)) / change if change != 0.0 else 1.0


def dissipate(tables: Tables, displacement: Vector, sample_time: float, room: Room) -> None:
    """Writes flow, effort and slope of every dissipator at the efforts of the step."""
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


def evaluate(tables: Tables, state: Vector, displacement: Vector, sample_time: float, room: Room, user: Any) -> float:
    """Writes the residual of the equation at `room.step`; returns its largest entry over the rounding of its terms."""
    n = len(room.step)
    discrete_gradient(tables, state, room.step, room.efforts, room.slopes)
    if user is not None:
        user.add_discrete_gradient(state, room.step, room.efforts)
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
        if abs(missing) > worst * size:
            worst = abs(missing) / size
    return worst


def merit_of(room: Room) -> float:
    """Returns the size of the residual in the scale of the sample."""
    total = 0.0
    for i in range(len(room.residual)):
        part = room.residual[i] * room.scale[i]
        total += part * part
    return total


def linearise(tables: Tables, sample_time: float, room: Room, user: Any) -> None:
    """Writes the Jacobian of the equation, I + T (R' - J) de/ds."""
    n = len(room.step)
    mobility, jacobian = room.mobility, room.jacobian
    for i in range(n):
        structure, row = tables.structure[i], mobility[i]
        for k in range(n):
            row[k] = -sample_time * structure[k]
    for j in range(len(room.factors)):
        add_square(mobility, tables.on_states[j], sample_time * room.factors[j])
    for i in range(n):
        row, into = mobility[i], jacobian[i]
        for k in range(n):
            into[k] = row[k] * room.slopes[k]
    if tables.coupled:
        add_product(mobility, tables.quadratic, jacobian)
    if user is not None:
        user.add_slopes(mobility, jacobian)
    for i in range(n):
        jacobian[i][i] += 1.0


def add_square(matrix: Matrix, row: Vector, factor: float) -> None:
    """Adds factor a a'."""
    for i in range(len(row)):
        if row[i] != 0.0:
            scaled, into = factor * row[i], matrix[i]
            for k in range(len(row)):
                into[k] += scaled * row[k]


def add_product(left: Matrix, right: Matrix, into: Matrix) -> None:
    """Adds half the product of two matrices."""
    n = len(left)
    for i in range(n):
        for k in range(n):
            total = 0.0
            for j in range(n):
                total += left[i][j] * right[j][k]
            into[i][k] += 0.5 * total


def solve_linear(matrix: Matrix, right: Vector) -> bool:
    """Solves in place by elimination with row pivots; returns False where the matrix is singular."""
    n = len(right)
    for column in range(n):
        pivot = pivot_of(matrix, column)
        if not abs(matrix[pivot][column]) > 0.0:
            return False
        if pivot != column:
            for k in range(column, n):
                matrix[pivot][k], matrix[column][k] = matrix[column][k], matrix[pivot][k]
            right[pivot], right[column] = right[column], right[pivot]
        eliminate(matrix, right, column)
    for back in range(n):
        index = n - 1 - back
        row, total = matrix[index], right[index]
        for k in range(index + 1, n):
            total -= row[k] * right[k]
        right[index] = total / row[index]
    return True


def pivot_of(matrix: Matrix, column: int) -> int:
    """Returns the row, from the diagonal down, with the largest entry of a column."""
    pivot, largest = column, abs(matrix[column][column])
    for row in range(column + 1, len(matrix)):
        if abs(matrix[row][column]) > largest:
            pivot, largest = row, abs(matrix[row][column])
    return pivot


def eliminate(matrix: Matrix, right: Vector, column: int) -> None:
    """Takes a column out of all rows below its diagonal."""
    n, above = len(right), matrix[column]
    for index in range(column + 1, n):
        row = matrix[index]
        if row[column] != 0.0:
            factor = row[column] / above[column]
            for k in range(column + 1, n):
                row[k] -= factor * above[k]
            right[index] -= factor * right[column]


def advance(tables: Tables, state: Vector, displacement: Vector, sample_time: float, room: Room, user: Any) -> int:
    """Finds the state change of one sample; returns the evaluations it took, negative where it did not converge.

    Args:
        tables: The network.
        state: x at the start of the hold, (n,).
        displacement: Motion of the ports during it, (r,).
        sample_time: T, or several of them where samples were lost [s].
        room: `step` holds a guess, and the solution afterwards.
        user: Energies given as functions; None for none.
    """
    drive(tables, state, displacement, room)
    if not tables.moving:
        discrete_gradient(tables, state, room.step, room.efforts, room.slopes)
        if user is not None:
            user.add_discrete_gradient(state, room.step, room.efforts)
        dissipate(tables, displacement, sample_time, room)
        return 1
    worst = evaluate(tables, state, displacement, sample_time, room, user)
    evaluations = 1
    for i in range(len(room.scale)):
        room.scale[i] = math.sqrt(abs(tables.stiffness[i])) + _LEAST_SCALE
    while worst > _CLOSE:
        before, merit = worst, merit_of(room)
        linearise(tables, sample_time, room, user)
        if not solve_linear(room.jacobian, room.residual):
            return -evaluations
        for i in range(len(room.step)):
            room.direction[i] = room.residual[i]
        worst, tried = descend(tables, state, displacement, sample_time, room, user, merit)
        evaluations += tried
        if worst <= _FLOOR and worst > 0.25 * before:
            break  # Newton's method gains nothing more: rounding
        if evaluations >= EVALUATIONS - _HALVINGS:
            return -evaluations
    return evaluations


def descend(
    tables: Tables, state: Vector, displacement: Vector, sample_time: float, room: Room, user: Any, before: float
) -> tuple[float, int]:
    """Goes along the Newton step as far as the residual falls; returns (residual, evaluations)."""
    share, taken = 1.0, 0.0
    worst = 1.0
    for tried in range(1, _HALVINGS + 1):
        for i in range(len(room.step)):
            room.step[i] -= (share - taken) * room.direction[i]
        taken = share
        worst = evaluate(tables, state, displacement, sample_time, room, user)
        if worst <= _ROUNDING or merit_of(room) < before:
            return worst, tried
        share *= 0.5
    return worst, _HALVINGS


def rest_on_ports(
    tables: Tables, state: Vector, displacement: Vector, sample_time: float, room: Room, user: Any
) -> None:
    """Takes s = g dc where no solution was found: nothing moves by itself in this sample, and nothing is created."""
    for i in range(len(room.step)):
        room.step[i] = room.driven[i]
    discrete_gradient(tables, state, room.step, room.efforts, room.slopes)
    if user is not None:
        user.add_discrete_gradient(state, room.step, room.efforts)
    dissipate(tables, displacement, sample_time, room)
