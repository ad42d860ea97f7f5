"""A network followed sample by sample with the measured motion of its ports: the model-consistent state."""

from collections.abc import Sequence
from typing import Any

from canhaptic.control.port_hamiltonian import equation
from canhaptic.control.port_hamiltonian import newton as step
from canhaptic.control.port_hamiltonian.discrete_gradient import NetworkTables, extension, gradient, stored_energy
from canhaptic.control.port_hamiltonian.network import Network
from canhaptic.errors import ParameterError
from canhaptic.extras import install_hint


def _never_left(network: Network) -> bool:
    """Returns True where some storage or dissipator can be felt at every position."""
    tables = network.tables
    if network.user is not None or tables.coupled:
        return True
    for k, low, high, row in zip(tables.stiffness, tables.lower, tables.upper, tables.gain, strict=True):
        if k != 0.0 and low == high and any(row):
            return True
    return any(
        beside < 0 and any(row) for beside, row in zip(tables.beside, tables.on_ports, strict=True)
    )  # fmt: skip


def _compiled_equation(tables: NetworkTables, room: equation.Workspace, network: Network) -> Any:
    """Returns the equation of a network, compiled.

    Raises:
        ParameterError: numba is not installed, or the network has energies given as functions.
    """
    if network.user is not None:
        raise ParameterError("compiled: got energies given as functions, expected storages of the table; leave it out")
    try:
        from canhaptic.control.port_hamiltonian.njit_equation import CompiledEquation
    except ImportError as error:
        raise ParameterError(f"compiled: needs numba ({error}); {install_hint('fast')}, or leave it out") from error
    return CompiledEquation(tables, room)


class SampledNetwork:
    """State and efforts of a network.

    Attributes:
        state: x, (states,).
        energy: H(x) [J].
        internal: Energy dissipated on the states in the last step, without what its dissipators took at the ports [J].
        engaged: Whether any storage that can be left is engaged, or there is one that cannot.
        tables: Of the network, with its structure at the state.
        room: What the last step found.
        user: Energies given as functions.
        always: Whether some storage or dissipator is felt everywhere.
        edged: States whose storage can be left.
        evaluations: Of the equation in the last step; negative where it did not converge.
    """

    def __init__(self, network: Network, sample_time: float, compiled: bool = False) -> None:
        """Makes a follower at rest.

        Args:
            network: What is followed; not shared state.
            sample_time: T [s].
            compiled: Whether its equation runs compiled by numba.

        Raises:
            ParameterError: Compiled without numba, or with energies given as functions.
        """
        tables, n = network.tables, network.states
        self._network, self._sample_time = network, sample_time
        self.tables = tables._replace(structure=[list(row) for row in tables.structure])
        self.user = network.user
        self.always = _never_left(network)
        self.edged = [i for i in range(n) if tables.lower[i] != tables.upper[i]]
        self.room = equation.new_workspace(n, len(tables.viscous))
        self._equation = _compiled_equation(self.tables, self.room, network) if compiled else None
        self._next, self._ahead = [0.0] * n, [0.0] * n
        self.begin((0.0,) * network.ports)

    def begin(self, coordinates: Sequence[float]) -> None:
        """Starts at given coordinates of the ports: walls where they are, masses at rest."""
        self._first = tuple(coordinates)
        self.state = [sum(a * c for a, c in zip(row, coordinates, strict=True)) for row in self._network.origin]
        self._begun = list(self.state)
        self.settle()
        self.internal = 0.0
        self.evaluations = 0
        for i in range(len(self.state)):
            self.room.step[i] = 0.0

    def advance(self, coordinates: Sequence[float], displacement: Sequence[float], elapsed: float) -> bool:
        """Follows one motion of the ports; returns False where no solution was found: the state then moved by it alone.

        Args:
            coordinates: Of the ports at its end [m or rad].
            displacement: Of the ports, relative to what is moved by itself [m or rad].
            elapsed: One sample time, or several [s].
        """
        solved = self.propose(displacement, elapsed)
        if self.tables.moving:
            for i, change in enumerate(self.room.step):
                self.state[i] += change
        else:
            self.state[:] = self.at(coordinates)
        self.settle()
        return solved

    def propose(self, displacement: Sequence[float], elapsed: float) -> bool:
        """Finds the state change of one motion of the ports without taking it; see `advance`."""
        room, tables = self.room, self.tables
        self.internal = 0.0
        if not tables.moving:  # s = g dc: nothing to solve, and nothing dissipated beyond the ports
            equation.drive(tables, self.state, displacement, room)
            self.evaluations = 1
            return True
        changed = self._network.structure_at is not None
        if changed:
            self._fill_structure()
        if self._equation is None:
            self.evaluations = step.advance(tables, self.state, displacement, elapsed, room, self.user)
        else:
            self.evaluations = self._equation.advance(self.state, displacement, elapsed, changed)
        if self.evaluations < 0:
            step.rest_on_ports(tables, self.state, displacement, elapsed, room, self.user)
            return False
        inner = 0.0
        for loss, flow, row in zip(room.losses, room.flows, tables.on_ports, strict=True):
            at_ports = 0.0
            for b, d in zip(row, displacement, strict=True):
                at_ports += b * d
            inner += loss * (flow * elapsed - at_ports)
        self.internal = inner
        return True

    def at(self, coordinates: Sequence[float]) -> list[float]:
        """Returns the state that only the ports have moved, free of rounding: where they are."""
        found = []
        for begun, row in zip(self._begun, self.tables.gain, strict=True):
            total = begun
            for a, c, c0 in zip(row, coordinates, self._first, strict=True):
                total += a * (c - c0)
            found.append(total)
        return found

    def _fill_structure(self) -> None:
        """Takes the skew part of J at the state, so that no function can create energy."""
        found = self._network.structure_at(self.state)  # type: ignore[misc]
        structure = self.tables.structure
        for i in range(len(structure)):
            for j in range(i + 1):
                value = 0.5 * (float(found[i][j]) - float(found[j][i]))
                structure[i][j], structure[j][i] = value, -value

    def settle(self) -> None:
        """Takes energy and engagement of the state."""
        self.energy = stored_energy(self.tables, self.state)
        if self.user is not None:
            self.energy += self.user.energy(self.state)
        self.engaged = self.always
        if not self.always:
            for i in self.edged:
                if extension(self.tables, i, self.state[i]) != 0.0:
                    self.engaged = True
                    break

    def springs(self, lead: float, holds: int, displacement: Sequence[float]) -> tuple[list[float], list[float]]:
        """Returns the efforts of the storages at the ports now, and what `lead` more holds like the last would add.

        A wall that is not engaged is not led into.

        Args:
            lead: [holds].
            holds: That the last step spanned.
            displacement: Of the ports in one hold [m or rad]; a smoothed one may differ from the last step's.
        """
        tables, room = self.tables, self.room
        now, ahead, moved = room.efforts, self._ahead, self._next
        for i, row in enumerate(tables.gain):
            driven = 0.0
            for a, d in zip(row, displacement, strict=True):
                driven += a * d
            moved[i] = self.state[i] + lead * ((room.step[i] - room.driven[i]) / holds + driven)
        gradient(tables, self.state, now)
        gradient(tables, moved, ahead)
        if self.user is not None:
            self.user.add_gradient(self.state, now)
            self.user.add_gradient(moved, ahead)
        for i in self.edged:
            if now[i] == 0.0 or now[i] * ahead[i] < 0.0:
                ahead[i] = 0.0
        ports = range(self._network.ports)
        spring, added = [0.0] * len(ports), [0.0] * len(ports)
        for i, row in enumerate(tables.gain):
            for j in ports:
                if row[j] != 0.0:
                    spring[j] += row[j] * now[i]
                    added[j] += row[j] * (ahead[i] - now[i])
        return spring, added

    def dampers(
        self, displacement: Sequence[float], elapsed: float, touched: Sequence[float] | None = None
    ) -> list[float]:
        """Returns the efforts of the dissipators at the ports for a motion of them; call it before `springs`.

        Args:
            displacement: Of the ports [m or rad].
            elapsed: Time of it [s].
            touched: State that says which storages are engaged, and then for the whole motion; None: as it is.
        """
        tables, room = self.tables, self.room
        efforts = [0.0] * self._network.ports
        if not room.losses:
            return efforts
        if touched is not None:
            for j in range(len(room.engaged)):
                room.engaged[j] = 1.0
        equation.dissipate(tables, displacement, elapsed, room)
        state = self.state if touched is None else touched
        for j, row in enumerate(tables.on_ports):
            storage = tables.beside[j]
            if storage in self.edged and extension(tables, storage, state[storage]) == 0.0:
                continue
            for i, b in enumerate(row):
                if b != 0.0:
                    efforts[i] += b * room.losses[j]
        return efforts

    def internal_motion(self) -> float:
        """Returns how far the storages at the ports moved by themselves in the last step, as a norm [m or rad]."""
        if not self.tables.moving:
            return 0.0
        total = 0.0
        for s, driven, row in zip(self.room.step, self.room.driven, self.tables.gain, strict=True):
            if any(row):
                total += (s - driven) ** 2
        return float(total**0.5)

    def entered_share(self) -> float:
        """Returns the largest share of the last step, already taken, for which any storage was engaged."""
        return self.share_inside(self.state)

    def share_inside(self, after: Sequence[float]) -> float:
        """Returns the largest share of the last step, ending at a state, for which any storage was engaged."""
        largest = 0.0
        for i in self.edged:
            changed = self.room.step[i]
            share = equation.engaged_share(self.tables, i, after[i] - changed, changed)
            if share > largest:
                largest = share
        return largest if largest > 0.0 else 1.0
