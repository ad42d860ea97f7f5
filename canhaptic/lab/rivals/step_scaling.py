"""The scalar balance of a scaled step: the share of a state change that the energy of a hold pays for.

    H(x + l s) - H(x) + l L = H_m

H is convex along most steps but not along all (double wells), so the root is bracketed first and then found by Newton
steps that fall back to halving the bracket. In every case at most `_EVALUATIONS` evaluations are made; the caller books
the remaining energy, so that an early end costs fidelity and never energy.
"""

from math import inf, isnan, sqrt
from typing import Final, NamedTuple

from canhaptic.control.passivity.root import solve_balance
from canhaptic.control.port_hamiltonian.discrete_gradient import NetworkTables, discrete_gradient, extension, gradient
from canhaptic.control.port_hamiltonian.user_energy import Functions
from canhaptic.kernels import Buffer, list_of_zeros, new

EVALUATIONS: Final = 60
"""Most evaluations of the energy in one balance."""
_SEARCH: Final = 20
"""Evaluations for the bracket; halving has the rest."""
_PIECES: Final = 8
"""Pieces of a step, searched for a place that takes up the energy received where the end of the step does not."""
FURTHEST: Final = 2.0
"""Largest share of a step, in either direction; what more energy would need is left over."""
_ROUNDING: Final = 1e-15


class StepScaling(NamedTuple):
    """A share of the step."""

    share: float
    found: bool  # False: nothing balances; `share` is where the most is given, or the end where the most is taken
    evaluations: int


class LineMemory(NamedTuple):
    """A line of states x + l s, and its work arrays; shapes (states,)."""

    state: Buffer  # x
    step: Buffer  # s
    moved: Buffer
    efforts: Buffer
    slopes: Buffer


def line_memory(states: int) -> LineMemory:
    """Return empty buffers."""
    return LineMemory(*[list_of_zeros(states) for _ in range(5)])


def taken(
    tables: NetworkTables, functions: Functions, line: LineMemory, loss: float, share: float
) -> tuple[float, float]:
    """Return the energy that a share of the step takes up, l L included, and its slope [J].

    Without cancellation: H(x + l s) - H(x) = l s . e_dg(x, x + l s).
    """
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
    """Return s . H'' s [J] where the energy is quadratic along the line while its storages stay engaged, else -1."""
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


def solve_scale(
    tables: NetworkTables, functions: Functions, line: LineMemory, energy: float, loss: float, limit: float
) -> StepScaling:
    """Return the share l nearest 0, |l| <= limit, that takes up an energy together with a loss in proportion to it.

    Args:
        tables: The network.
        functions: Energies given as functions.
        line: Line along which its state moves.
        energy: H_m, the energy that the model received [J].
        loss: L, what its dissipators take with l = 1 [J].
        limit: Largest |l|.
    """
    stiffness = stiffness_along(tables, line)
    if stiffness < 0.0:
        tolerance = _ROUNDING * (abs(energy) + abs(loss))
        return search_scale(tables, functions, line, energy, loss, limit, tolerance)
    square = 0.0
    for s in line.step:
        square += s * s
    length = sqrt(square)  # along a unit step: of one state, eq. 16 itself
    if length == 0.0:
        return new(StepScaling, (0.0, energy >= 0.0, 1))
    slope = taken(tables, functions, line, loss, 0.0)[1]
    change = solve_balance(stiffness / (length * length), slope / length, energy, length)
    if isnan(change):
        return new(StepScaling, (0.0, False, 1))
    share = change / length
    if abs(share) > limit and energy > 0.0:
        share = limit if share > 0.0 else -limit
    return new(StepScaling, (share, True, 1))


def search_scale(
    tables: NetworkTables, functions: Functions, line: LineMemory, energy: float, loss: float, limit: float,
    tolerance: float,
) -> StepScaling:  # fmt: skip
    """Return `solve_scale` of an energy that is not quadratic; `tolerance` is its rounding [J]."""
    if abs(energy) <= tolerance:
        return new(StepScaling, (0.0, True, 0))
    slope = taken(tables, functions, line, loss, 0.0)[1]
    if slope == 0.0 and energy < 0.0:
        return new(StepScaling, (0.0, False, 1))
    far = limit if (slope > 0.0) == (energy > 0.0) or slope == 0.0 else -limit
    end, found, evaluations = (
        bracket_upwards(tables, functions, line, energy, loss, far)
        if energy > 0.0
        else bracket_downwards(tables, functions, line, energy, loss, far)
    )
    if not found:
        return new(StepScaling, (end, False, evaluations + 1))
    return root_between(tables, functions, line, energy, loss, tolerance, end, evaluations + 1)


def bracket_upwards(
    tables: NetworkTables, functions: Functions, line: LineMemory, energy: float, loss: float, far: float
) -> tuple[float, bool, int]:
    """Return a place towards `far` that takes up at least an energy > 0, whether there is one, and evaluations."""
    if taken(tables, functions, line, loss, far)[0] >= energy:
        return far, True, 1
    for piece in range(1, _PIECES):
        place = far * piece / _PIECES
        if taken(tables, functions, line, loss, place)[0] >= energy:
            return place, True, piece + 1
    return far, False, _PIECES


def bracket_downwards(
    tables: NetworkTables, functions: Functions, line: LineMemory, energy: float, loss: float, far: float
) -> tuple[float, bool, int]:
    """Return a place that gives at least -energy, from 0 towards the lowest place before `far`.

    Returns:
        The place, or the one of the largest release; whether it suffices; evaluations.
    """
    near, here, least, best, evaluations = 0.0, far, 0.0, 0.0, 0
    for _ in range(_SEARCH):
        here_energy, here_slope = taken(tables, functions, line, loss, here)
        evaluations += 1
        if here_energy < least:
            least, best = here_energy, here
        if here_energy <= energy:
            return here, True, evaluations
        if here_slope * far < 0.0 and here_energy <= least:
            if here == far:
                break
            near = here
        else:
            far = here
        here = 0.5 * (near + far)
    return best, False, evaluations


def root_between(
    tables: NetworkTables, functions: Functions, line: LineMemory, energy: float, loss: float, tolerance: float,
    far: float, evaluations: int,
) -> StepScaling:  # fmt: skip
    """Return the share between 0, which takes up too little of the energy, and `far`, with enough of it."""
    near, share, width = 0.0, far, abs(far)
    if energy > 0.0:
        slope = taken(tables, functions, line, loss, 0.0)[1]
        evaluations += 1
        if slope * far > 0.0 and abs(energy / slope) < abs(far):
            share = energy / slope
    while evaluations < EVALUATIONS:
        found, slope = taken(tables, functions, line, loss, share)
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
