"""A network followed sample by sample with the measured motion of its ports: the model-consistent state."""

from dataclasses import dataclass
from math import sqrt
from typing import NamedTuple

from canhaptic.control.port_hamiltonian.discrete_gradient import NetworkTables, extension, gradient, stored_energy
from canhaptic.control.port_hamiltonian.equation import (
    Workspace,
    dissipate,
    drive,
    engaged_share,
    new_workspace,
)
from canhaptic.control.port_hamiltonian.newton import advance, rest_on_ports
from canhaptic.control.port_hamiltonian.user_energy import Functions
from canhaptic.kernels import Buffer, list_of_zeros


@dataclass(slots=True)
class NetworkState:
    """Result of the last step."""

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


def begin_network(
    tables: NetworkTables, functions: Functions, network: NetworkState, memory: NetworkMemory, coordinates: Buffer
) -> None:
    """Start at given coordinates of the ports: walls where they are, masses at rest."""
    for j in range(len(coordinates)):
        memory.first[j] = coordinates[j]
    for i in range(len(memory.state)):
        row, total = tables.origin[i], 0.0
        for j in range(len(coordinates)):
            total += row[j] * coordinates[j]
        memory.state[i] = memory.begun[i] = total
        memory.room.step[i] = 0.0
    settle_network(tables, functions, network, memory)
    network.internal, network.evaluations = 0.0, 0


def advance_network(
    tables: NetworkTables,
    functions: Functions,
    network: NetworkState,
    memory: NetworkMemory,
    coordinates: Buffer,
    displacement: Buffer,
    elapsed: float,
) -> bool:
    """Follow one motion of the ports; return False if no solution was found: only the ports then moved the state.

    Args:
        tables: The network.
        functions: Energies and structure given as functions.
        network: State of the network; changed.
        memory: Buffers of the network; changed.
        coordinates: Coordinates of the ports at its end [m or rad].
        displacement: Motion of the ports, less the mover's [m or rad].
        elapsed: One sample time, or several [s].
    """
    solved = propose(tables, functions, network, memory, displacement, elapsed)
    if tables.moving:
        for i in range(len(memory.state)):
            memory.state[i] += memory.room.step[i]
    else:
        place_state(tables, memory, coordinates, memory.state)
    settle_network(tables, functions, network, memory)
    return solved


def propose(
    tables: NetworkTables,
    functions: Functions,
    network: NetworkState,
    memory: NetworkMemory,
    displacement: Buffer,
    elapsed: float,
) -> bool:
    """Find the state change of one motion of the ports without taking it; see `advance_network`."""
    room = memory.room
    network.internal, network.evaluations = 0.0, 1
    if not tables.moving:  # s = g dc: nothing to solve, and nothing dissipated beyond the ports
        drive(tables, memory.state, displacement, room)
        return True
    if tables.by_functions:
        functions.fill_structure(memory.state, tables.structure)
    network.evaluations = advance(tables, memory.state, displacement, elapsed, room, functions)
    if network.evaluations < 0:
        rest_on_ports(tables, memory.state, displacement, elapsed, room, functions)
        return False
    inner = 0.0
    for j in range(len(room.losses)):
        row, at_ports = tables.on_ports[j], 0.0
        for i in range(len(row)):
            at_ports += row[i] * displacement[i]
        inner += room.losses[j] * (room.flows[j] * elapsed - at_ports)
    network.internal = inner
    return True


def place_state(tables: NetworkTables, memory: NetworkMemory, coordinates: Buffer, into: Buffer) -> None:
    """Write the state of a network that only its ports have moved: from their positions, free of rounding."""
    for i in range(len(into)):
        row, total = tables.gain[i], memory.begun[i]
        for j in range(len(coordinates)):
            total += row[j] * (coordinates[j] - memory.first[j])
        into[i] = total


def settle_network(tables: NetworkTables, functions: Functions, network: NetworkState, memory: NetworkMemory) -> None:
    """Update energy and engagement of the state."""
    energy, engaged = stored_energy(tables, memory.state), tables.always
    if tables.by_functions:
        energy += functions.energy(memory.state)
    if not engaged:
        for i in tables.edged:
            if extension(tables, i, memory.state[i]) != 0.0:
                engaged = True
                break
    network.energy, network.engaged = energy, engaged


def springs(
    tables: NetworkTables,
    functions: Functions,
    memory: NetworkMemory,
    lead: float,
    holds: int,
    way: Buffer,
    spring: Buffer,
    added: Buffer,
) -> None:
    """Write the present efforts of the storages at the ports, and their change by a predicted motion.

    No effort is predicted for a wall that is not engaged.

    Args:
        tables: The network.
        functions: Energies and structure given as functions.
        memory: Buffers of the network.
        lead: Holds of prediction, in which the network's own motion goes on as in the last step.
        holds: Number of holds that the last step spanned.
        way: Predicted motion of the ports [m or rad].
        spring: Receives the efforts, (ports,).
        added: Receives their change, (ports,).
    """
    room, state = memory.room, memory.state
    now, ahead, moved, gain = room.efforts, memory.ahead, memory.moved, tables.gain
    for i in range(len(state)):
        row, driven = gain[i], 0.0
        for j in range(len(way)):
            driven += row[j] * way[j]
        moved[i] = state[i] + (lead * ((room.step[i] - room.driven[i]) / holds) + driven)
    gradient(tables, state, now)
    gradient(tables, moved, ahead)
    if tables.by_functions:
        functions.add_gradient(state, now)
        functions.add_gradient(moved, ahead)
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
    """Write the efforts of the dissipators at the ports for a motion of them; call it before `springs`.

    Args:
        tables: The network.
        memory: Buffers of the network.
        displacement: Motion of the ports [m or rad].
        elapsed: Time of it [s].
        state: State that determines the engaged storages, (states,).
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
    """Return how far the storages at the ports moved by themselves in the last step, as a norm [m or rad]."""
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
    """Return the largest share of the last step, ending at a state, for which any storage was engaged."""
    largest = 0.0
    for i in tables.edged:
        changed = room.step[i]
        share = engaged_share(tables, i, after[i] - changed, changed)
        if share > largest:
            largest = share
    return largest if largest > 0.0 else 1.0
