"""A network as plain numbers, its stored energy, and the discrete gradient of that energy (Gonzalez 1996).

For a storage of one state the discrete gradient is the divided difference (H(x + s) - H(x)) / s, for a quadratic form
Q (x + s / 2); each is exact, H(x + s) - H(x) = e . s, and so is their sum.

A scalar storage has the extension d = x beyond `upper`, x below `lower` and 0 between them - measured from those
edges - and stores k d^2 / 2 + k3 d^4 / 4. With lower = upper = 0 it is always engaged; a wall is engaged on one side.
With k < 0 it is a double well and stores k3 (d^2 + k / k3)^2 / 4, the same but for a constant: 0 in the wells.
"""

from typing import NamedTuple

from canhaptic.kernels import Buffer, Indices, Matrix


class NetworkTables(NamedTuple):
    """A network as data: n states, r ports, d dissipators."""

    stiffness: Buffer  # k, (n,)
    hardening: Buffer  # k3, (n,)
    lower: Buffer  # (n,)
    upper: Buffer  # (n,)
    coupled: bool  # whether `quadratic` is not zero
    quadratic: Matrix  # Q of x'Qx / 2, (n, n)
    moving: bool  # whether the state moves by itself: structure or dissipators on states
    structure: Matrix  # J, skew, (n, n)
    gain: Matrix  # g, (n, r)
    on_states: Matrix  # row of each dissipator over the efforts of the states, (d, n)
    on_ports: Matrix  # row of each dissipator over the port flows, (d, r)
    viscous: Buffer  # (d,)
    squared: Buffer  # (d,)
    coulomb: Buffer  # (d,)
    corner: Buffer  # flow at which Coulomb friction reaches 0.71 of its value, (d,)
    beside: Indices  # storage in parallel with a dissipator, only where that is engaged; -1: always, (d,)
    origin: Matrix  # rows of x(0) over the ports' first coordinates, (n, r)
    edged: Indices  # states whose storage can be left
    always: bool  # whether some storage or dissipator is felt everywhere
    by_functions: bool  # whether energies or the structure are also given as functions


def extension(tables: NetworkTables, index: int, value: float) -> float:
    """Return how far a state is beyond the edges of its storage; 0 where it is not engaged."""
    upper = tables.upper[index]
    if value > upper:
        return value - upper
    lower = tables.lower[index]
    return value - lower if value < lower else 0.0


def stored_energy(tables: NetworkTables, state: Buffer) -> float:
    """Return H(x) without user energies [J]."""
    total = 0.0
    stiffness, hardening = tables.stiffness, tables.hardening
    for i in range(len(stiffness)):
        d = extension(tables, i, state[i])
        if d != 0.0:
            square, k, k3 = d * d, stiffness[i], hardening[i]
            if k < 0.0:
                total += 0.25 * k3 * (square + k / k3) * (square + k / k3)
            else:
                total += square * (0.5 * k + 0.25 * k3 * square)
        elif stiffness[i] < 0.0:
            total += 0.25 * stiffness[i] * stiffness[i] / hardening[i]
    if tables.coupled:
        for i in range(len(stiffness)):
            row, sum_ = tables.quadratic[i], 0.0
            for j in range(len(stiffness)):
                sum_ += row[j] * state[j]
            total += 0.5 * state[i] * sum_
    return total


def gradient(tables: NetworkTables, state: Buffer, efforts: Buffer) -> None:
    """Write dH/dx at a state."""
    stiffness, hardening = tables.stiffness, tables.hardening
    for i in range(len(stiffness)):
        d = extension(tables, i, state[i])
        efforts[i] = d * (stiffness[i] + hardening[i] * d * d)
    if tables.coupled:
        for i in range(len(stiffness)):
            row = tables.quadratic[i]
            for j in range(len(stiffness)):
                efforts[i] += row[j] * state[j]


def discrete_gradient(tables: NetworkTables, state: Buffer, step: Buffer, efforts: Buffer, slopes: Buffer) -> None:
    """Write the discrete gradient between x and x + s, and its derivative by s for the scalar storages.

    Args:
        tables: The network.
        state: x, (n,).
        step: s, (n,).
        efforts: Receives e, (n,).
        slopes: Receives de_i / ds_i of the scalar storages, (n,).
    """
    stiffness, hardening = tables.stiffness, tables.hardening
    lower, upper = tables.lower, tables.upper
    for i in range(len(stiffness)):
        k, k3, s, x = stiffness[i], hardening[i], step[i], state[i]
        a, b = extension(tables, i, x), extension(tables, i, x + s)
        if lower[i] == upper[i] or a * b > 0.0:  # both ends on the same side: without cancellation
            both, squares = a + b, a * a + b * b
            efforts[i] = both * (0.5 * k + 0.25 * k3 * squares)
            slopes[i] = 0.5 * k + 0.25 * k3 * (squares + 2.0 * b * both)
        elif s != 0.0 and (a != 0.0 or b != 0.0):
            a2, b2 = a * a, b * b
            effort = (b2 * (0.5 * k + 0.25 * k3 * b2) - a2 * (0.5 * k + 0.25 * k3 * a2)) / s
            efforts[i] = effort
            slopes[i] = (b * (k + k3 * b2) - effort) / s
        else:
            efforts[i] = slopes[i] = 0.0
    if tables.coupled:
        for i in range(len(stiffness)):
            row = tables.quadratic[i]
            for j in range(len(stiffness)):
                efforts[i] += row[j] * (state[j] + 0.5 * step[j])
