"""One sample of a network: the state change that the discrete gradient balances with the motion of its ports.

    s = T (J e - sum(a_j phi_j(f_j))) + g dc,    e = e_dg(x, x + s),    f_j = a_j . e + b_j . dc / T

J is skew and e . s = H(x + s) - H(x), so that for every T

    H(x + s) - H(x) = y . dc - T sum(phi_j f_j),    y = g'e + sum(b_j phi_j),    phi_j f_j >= 0

A network whose state is moved by its ports alone (springs and dampers, no masses) has s = g dc and nothing to solve.
Else Newton's method solves for s, with a residual that falls from step to step. Near a double well the residual can
have a minimum that is no solution; from there on the power r . de along a step counts, r the residual and de the change
of the efforts. Where springs act on masses it is the slope of a potential (the masses' change of velocity, the losses
and the integral of the springs' discrete gradients) whose every level place is a solution, so that the way goes down
until it is level.
"""

import math
from typing import Final

from canhaptic.control.port_hamiltonian.discrete_gradient import NetworkTables, discrete_gradient
from canhaptic.control.port_hamiltonian.equation import Workspace, dissipate, drive, evaluate, linearise
from canhaptic.control.port_hamiltonian.gauss import solve_linear
from canhaptic.control.port_hamiltonian.user_energy import Functions
from canhaptic.kernels import Buffer

_EVALUATIONS: Final = 60
"""Most evaluations of the equation in one sample."""
_BY_RESIDUAL: Final = 18
"""Evaluations after which a residual that falls step by step has not fallen enough."""
_CLOSE: Final = 4e-16
"""Rounding, as a part of the terms of the equation."""
_FLOOR: Final = 1e-11
"""Below it a residual that falls no more is rounding: forces of very stiff springs cancel."""
_ROUNDING: Final = 1e-14
"""Below it the residual need not fall any more."""
_HALVINGS: Final = 8
"""Halvings of a Newton step after which the residual has not fallen; the shortest is taken all the same."""
_LEAST_SCALE: Final = 1e-3
"""Added to the root of a stiffness, for states that it leaves without a scale."""
_STEEP: Final = 0.9
"""Share of the power at the start of a step above which its end is no nearer to level ground: a longer one follows."""
_LONGER: Final = 3.0
_LEVEL: Final = 0.5
"""Share of the power at the start of a step that is level enough for its end."""
_INSIDE: Final = 0.1
"""Share of the way between two places, at either end, in which no place between them is tried."""


def advance(
    tables: NetworkTables,
    state: Buffer,
    displacement: Buffer,
    sample_time: float,
    room: Workspace,
    functions: Functions,
) -> int:
    """Find the state change of one sample; return the evaluations it took, negative where it did not converge.

    Args:
        tables: The network.
        state: x at the start of the hold, (n,).
        displacement: Motion of the ports during it, (r,).
        sample_time: T, or several of them where samples were lost [s].
        room: `step` holds a guess, and the solution afterwards.
        functions: Energies and structure given as functions.
    """
    drive(tables, state, displacement, room)
    for i in range(len(room.scale)):
        room.scale[i] = math.sqrt(abs(tables.stiffness[i])) + _LEAST_SCALE
    evaluations = _by_residual(tables, state, displacement, sample_time, room, functions)
    if evaluations < 0:
        evaluations = by_power(tables, state, displacement, sample_time, room, functions, -evaluations)
    return evaluations


def _by_residual(
    tables: NetworkTables,
    state: Buffer,
    displacement: Buffer,
    sample_time: float,
    room: Workspace,
    functions: Functions,
) -> int:
    """Take Newton steps, each as far as the residual falls; return the evaluations, negative where that ends."""
    worst = evaluate(tables, state, displacement, sample_time, room, functions)
    evaluations = 1
    while worst > _CLOSE:
        before, merit = worst, _merit_of(room)
        linearise(tables, sample_time, room, functions)
        if not solve_linear(room.jacobian, room.residual):
            return -evaluations
        for i in range(len(room.step)):
            room.direction[i] = room.residual[i]
        worst, tried = _descend(tables, state, displacement, sample_time, room, functions, merit)
        evaluations += tried
        if worst <= _FLOOR and worst > 0.25 * before:
            break  # Newton's method gains nothing more: rounding
        if evaluations >= _BY_RESIDUAL or (tried == _HALVINGS and worst > _ROUNDING and not _merit_of(room) < merit):
            return -evaluations
    return evaluations


def _merit_of(room: Workspace) -> float:
    """Return the size of the residual in the scale of the sample."""
    total = 0.0
    for i in range(len(room.residual)):
        part = room.residual[i] * room.scale[i]
        total += part * part
    return total


def _descend(
    tables: NetworkTables,
    state: Buffer,
    displacement: Buffer,
    sample_time: float,
    room: Workspace,
    functions: Functions,
    before: float,
) -> tuple[float, int]:
    """Step along Newton's direction as far as the residual falls; return (residual, evaluations)."""
    share, taken = 1.0, 0.0
    worst = 1.0
    for tried in range(1, _HALVINGS + 1):
        for i in range(len(room.step)):
            room.step[i] -= (share - taken) * room.direction[i]
        taken = share
        worst = evaluate(tables, state, displacement, sample_time, room, functions)
        if worst <= _ROUNDING or _merit_of(room) < before:
            return worst, tried
        share *= 0.5
    return worst, _HALVINGS


def by_power(
    tables: NetworkTables,
    state: Buffer,
    displacement: Buffer,
    sample_time: float,
    room: Workspace,
    functions: Functions,
    spent: int,
) -> int:
    """Continue where the residual falls no more; return all evaluations, negative if they were not enough.

    The first step is a whole one: after it the equations without forces hold, and the power is that of the forces.
    """
    worst = evaluate(tables, state, displacement, sample_time, room, functions)
    evaluations, whole = spent + 1, True
    while worst > _CLOSE:
        if evaluations >= _EVALUATIONS:
            return -evaluations
        before, near = worst, worst <= _FLOOR
        power = _aim(tables, sample_time, room, functions)
        if not (power > 0.0 or near):  # upwards, along a slope below 0: as if it were level
            for i in range(len(room.slopes)):
                room.slopes[i] = max(room.slopes[i], 0.0)
            power = _aim(tables, sample_time, room, functions)
        left = 1 if whole or near or not power > 0.0 else _EVALUATIONS - evaluations
        worst, tried = _go_down(tables, state, displacement, sample_time, room, functions, power, left)
        evaluations, whole = evaluations + tried, False
        if worst <= _FLOOR and worst > 0.25 * before:
            break
    return evaluations


def _aim(tables: NetworkTables, sample_time: float, room: Workspace, functions: Functions) -> float:
    """Write Newton's direction and the change of the efforts along it; return the power, 0 where it has none."""
    n = len(room.step)
    linearise(tables, sample_time, room, functions)
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
        functions.add_change(room.direction, room.weights)
    return _power_of(room)


def _power_of(room: Workspace) -> float:
    """Return r . de."""
    total = 0.0
    for i in range(len(room.residual)):
        total += room.residual[i] * room.weights[i]
    return total


def _go_down(
    tables: NetworkTables, state: Buffer, displacement: Buffer, sample_time: float, room: Workspace,
    functions: Functions, power: float, left: int,
) -> tuple[float, int]:  # fmt: skip
    """Step along the direction towards a level point of the power; return (residual, evaluations).

    Args:
        tables: The network.
        state: x, (n,).
        displacement: Motion of the ports, (r,).
        sample_time: T [s].
        room: Workspace; `direction` and `weights` give the direction.
        functions: Energies and structure given as functions.
        power: Power at the start of the step; > 0 where `left` is more than one.
        left: Evaluations left; with one the whole step is taken.
    """
    for i in range(len(room.step)):
        room.before[i] = room.step[i]
    share, low, high, at_low, at_high = 1.0, 0.0, 0.0, power, 0.0
    worst = 1.0
    for tried in range(1, left + 1):
        for i in range(len(room.step)):
            room.step[i] = room.before[i] - share * room.direction[i]
        worst = evaluate(tables, state, displacement, sample_time, room, functions)
        here = _power_of(room) if worst < math.inf else -math.inf
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


def rest_on_ports(
    tables: NetworkTables,
    state: Buffer,
    displacement: Buffer,
    sample_time: float,
    room: Workspace,
    functions: Functions,
) -> None:
    """Take s = g dc where no solution was found: internal states rest in this sample, and nothing is created."""
    for i in range(len(room.step)):
        room.step[i] = room.driven[i]
    discrete_gradient(tables, state, room.step, room.efforts, room.slopes)
    if tables.by_functions:
        functions.add_discrete_gradient(state, room.step, room.efforts)
    dissipate(tables, displacement, sample_time, room)
