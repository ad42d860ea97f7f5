"""A network on the motors of a group in continuous time, by DOP853: what the hands would feel without sampling.

    positions -> mechanism -> ports c(t) -> states x(t) of the network -> efforts at the ports -> torques of the motors
    x' = J e - sum(a_j phi_j(f_j)) + g c',    e = dH/dx,    f_j = a_j . e + b_j . c'

The equations are those of `canhaptic.control.port_hamiltonian`, in time and not in steps; energies and geometry are the
network's own. Where a contact begins the solver takes shorter steps by itself; a second run with a coarser tolerance
says how far that can be trusted.
"""

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Final, NamedTuple, cast

import numpy as np

from canhaptic.control.mechanisms.kinematics import Kinematics, Limit
from canhaptic.control.multi_axis.group_controller import NetworkEnvironment
from canhaptic.control.multi_axis.group_motion import World, world_of
from canhaptic.control.port_hamiltonian.discrete_gradient import extension, gradient
from canhaptic.control.port_hamiltonian.shapes.geometry import moved_by
from canhaptic.errors import InputError, ParameterError
from canhaptic.kernels import Buffer, list_of_zeros, zeros
from canhaptic.lab.judge.event_location import states_at
from canhaptic.lab.judge.reference_elements import Transition
from canhaptic.lab.judge.reference_group import AxesModel, GroupModel, State, mechanism_model
from canhaptic.lab.judge.reference_model import Modes
from canhaptic.lab.loop.scenes import mechanism_of_group
from canhaptic.lab.reference.continuous_reference import textbook_model
from canhaptic.scene.models import Scene
from canhaptic.scene.torque_history import simulation_of
from canhaptic.sim.plant.mechanism import MechanismParameters
from canhaptic.sim.plant.propagator import Array

_TOLERANCES: Final = (1e-9, 1e-7)
"""Relative, of the run and of the one that it is compared with."""
_BETWEEN_GUARDS: Final = (2.5e-4, 5e-4)
"""Longest step where modes may change, of the run and of the one that it is compared with [s]."""


class ContinuousGroup(NamedTuple):
    """The continuous group at every `step_ns`."""

    step_ns: int
    position: Array  # of the motors, shape (steps + 1, axes) [m or rad]
    impulse: Array  # of the network's torques since the start, shape (steps + 1, axes) [N*s or N*m*s]
    interaction: Array  # energy into the network since the start, shape (steps + 1,) [J]
    apart: float  # largest distance of the positions from those of a coarser tolerance [m or rad]


def group_model(scene: Scene) -> GroupModel:
    """Equations of the plant of a scene's one group; the motors in the order of the group's axes.

    Raises:
        InputError: There are none for it.
    """
    (group,) = scene.groups
    of = mechanism_of_group(scene)
    if of is not None:
        if of.axes != group.axes:
            raise InputError("the mechanism names its axes in another order than the group")
        return mechanism_model(cast(MechanismParameters, of.mechanism.parameters), of.hand)
    simulations = [simulation_of(scene.axis(name)) for name in group.axes]
    try:
        models = [textbook_model(simulation) for simulation in simulations]
    except ParameterError as error:
        raise InputError(f"a plant of the group has no equations here: {error}") from error
    return AxesModel(models, [simulation.plant.mass for simulation in simulations])


def continuous_group(
    scene: Scene, step_ns: int, steps: int, stop: Callable[[], bool] = lambda: False
) -> ContinuousGroup:
    """Return what the hands would feel without sampling.

    Args:
        scene: Scene with one group, alone.
        step_ns: Time between two readings [ns].
        steps: Readings after the first.
        stop: Polled now and then; true gives up.

    Raises:
        InputError: There are no equations, scipy is missing, the solver fails, the mechanism leaves its workspace, or
            it was stopped.
    """
    times, coupled = [k * step_ns * 1e-9 for k in range(steps + 1)], _Coupled(scene)
    fine, coarse = (
        states_at(coupled, times, tolerance, stop, step)
        for tolerance, step in zip(_TOLERANCES, _BETWEEN_GUARDS, strict=True)
    )
    position, rough = (np.array([coupled.model.positions(row) for row in rows]) for rows in (fine, coarse))
    table, apart = np.array(fine), float(np.abs(position - rough).max())
    return ContinuousGroup(step_ns, position, table[:, -1 - coupled.axes : -1], table[:, -1], apart)


class _Coupled:
    """Motors and network; state: that of the motors, x of the network, impulse of every motor, energy taken."""

    def __init__(self, scene: Scene) -> None:
        (group,) = scene.groups
        loops = tuple(scene.axis(name).loop for name in group.axes)
        environment = cast(NetworkEnvironment, group.network.parameters)
        self._world: World = world_of(environment, cast(Kinematics, group.kinematics.parameters), loops)
        self.model, self.axes = group_model(scene), len(group.axes)
        geometry, tables = self._world.geometry, self._world.tables
        ports, dimensions = geometry.ports, geometry.dimensions
        self._place, self._jacobian = list_of_zeros(dimensions), zeros(dimensions, self.axes)
        self._values, self._rows = list_of_zeros(ports), zeros(ports, dimensions)
        self._at_motors = zeros(ports, self.axes)
        self._states, self._efforts = len(tables.stiffness), list_of_zeros(len(tables.stiffness))
        self.first, self.breaks, self.switches = self.model.first, self.model.breaks, self.model.switches
        coordinates, _ = self._ports(0.0, self.model.start)
        begun = [_dot(row, coordinates) for row in tables.origin]
        self.start = [*self.model.start, *begun, *(0.0,) * self.axes, 0.0]

    def rates(self, time: float, state: State, torque: float, modes: Modes) -> list[float]:
        """Return the rate of every state; see `SwitchedModel`, whose torque is that of the network here."""
        torques, moved, taken = self._felt(time, state)
        motors = state[: len(self.model.start)]
        return [*self.model.rates(time, motors, torques, modes), *moved, *torques, taken]

    def ways(self, modes: Modes) -> list[Transition]:
        """Every transition out of these modes, which are those of the motors; see `SwitchedModel`."""
        return [way._replace(value=partial(self._guard, way)) for way in self.model.ways(modes)]

    def _guard(self, way: Transition, time: float, state: State, _torque: float) -> float:
        return way.value(time, state[: len(self.model.start)], self._felt(time, state)[0])

    def _felt(self, time: float, state: State) -> tuple[Buffer, Buffer, float]:
        """Return the torques of the network, the rates of its states and the power that it takes [W]."""
        own = len(self.model.start)
        motors, x = state[:own], [float(value) for value in state[own : own + self._states]]
        _, flows = self._ports(time, motors)
        moved, efforts = self._network(x, flows)
        torques = [-_dot([row[i] for row in self._at_motors], efforts) for i in range(self.axes)]
        return torques, moved, _dot(efforts, flows)

    def _ports(self, time: float, motors: State) -> tuple[Buffer, Buffer]:
        """Return the coordinates of the ports [m or rad] and their velocities [m/s or rad/s]."""
        world, velocities = self._world, self.model.velocities(motors)
        limit = world.mechanism.locate(self.model.positions(motors), self._place, self._jacobian)
        if limit != Limit.NONE:
            raise InputError(f"at {time:g} s the mechanism is at its limit {Limit(limit).name.lower()}")
        world.geometry.measure(self._place, self._values, self._rows)
        for row, into in zip(self._rows, self._at_motors, strict=True):
            into[:] = [_dot(row, [line[i] for line in self._jacobian]) for i in range(self.axes)]
        mover, offset, speed = world.mover, 0.0, 0.0
        if mover.half != 0.0:
            offset, speed = moved_by(mover, time), mover.half * mover.rate * math.sin(mover.rate * time)
        coordinates = [value - offset for value in self._values]
        return coordinates, [_dot(row, velocities) - speed for row in self._at_motors]

    def _network(self, x: Buffer, flows: Buffer) -> tuple[Buffer, Buffer]:
        """Return the rates of the states, and the efforts at the ports."""
        world = self._world
        tables, efforts, structure = world.tables, self._efforts, world.tables.structure
        gradient(tables, x, efforts)
        if tables.by_functions:
            world.functions.add_gradient(x, efforts)
            world.functions.fill_structure(x, structure)
        moved = [_dot(structure[i], efforts) + _dot(tables.gain[i], flows) for i in range(self._states)]
        at_ports = [_dot([row[j] for row in tables.gain], efforts) for j in range(len(flows))]
        for j, beside in enumerate(tables.beside):
            is_left = beside >= 0 and tables.lower[beside] != tables.upper[beside]
            if is_left and extension(tables, beside, x[beside]) == 0.0:
                continue
            a, b = tables.on_states[j], tables.on_ports[j]
            loss = _loss(tables.viscous[j], tables.squared[j], tables.coulomb[j], tables.corner[j],
                         _dot(a, efforts) + _dot(b, flows))  # fmt: skip
            moved = [rate - weight * loss for rate, weight in zip(moved, a, strict=True)]
            at_ports = [effort + weight * loss for effort, weight in zip(at_ports, b, strict=True)]
        return moved, at_ports


def _loss(viscous: float, squared: float, coulomb: float, corner: float, flow: float) -> float:
    """Return phi(f) of a dissipator."""
    dry = coulomb * flow / math.hypot(flow, corner) if coulomb else 0.0
    return flow * (viscous + squared * abs(flow)) + dry


def _dot(one: Sequence[float], other: Sequence[float]) -> float:
    return sum(a * b for a, b in zip(one, other, strict=True))
