"""The continuous environment rendered to the same user and plant: the ideal for comparison.

It is rendered to the same user and plant without sampling, encoder or torque limit, on the textbook plant by
event-located DOP853 (extra `study`), which shares no code with the plant that it judges. An effect or
environment without equations here is refused. A wall on a linear plant needs no solver: `batch.scalar`.

A network on the motors of a group in continuous time, by DOP853: what the hands would feel without sampling.

    positions -> mechanism -> ports c(t) -> states x(t) of the network -> efforts at the ports -> torques of the motors
    x' = J e - sum(a_j phi_j(f_j)) + g c',    e = dH/dx,    f_j = a_j . e + b_j . c'

The equations are those of `canhaptic.control.port_hamiltonian`, in time and not in steps; energies and geometry are the
network's own. Where a contact begins the solver takes shorter steps by itself; a second run with a coarser tolerance
shows how far the result can be trusted.
"""

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Final, NamedTuple, cast

import numpy as np

from canhaptic.control.environments import Environment
from canhaptic.control.environments.coulomb_surface import CoulombSurface
from canhaptic.control.environments.damper_wall import DamperWall
from canhaptic.control.environments.detents import Detents
from canhaptic.control.environments.free_space import FreeSpace
from canhaptic.control.environments.hardening_wall import HardeningWall
from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.control.environments.two_sided_wall import TwoSidedWall
from canhaptic.control.environments.viscoelastic_medium import ViscoelasticMedium
from canhaptic.control.environments.viscous_medium import ViscousMedium
from canhaptic.control.mechanisms.kinematics import Kinematics, Limit
from canhaptic.control.multi_axis.group_controller import NetworkEnvironment
from canhaptic.control.multi_axis.group_kernel import GroupModel, world_of
from canhaptic.control.port_hamiltonian.network import extension, gradient
from canhaptic.control.port_hamiltonian.shapes import moved_by
from canhaptic.errors import InputError, ParameterError
from canhaptic.kernels import Buffer, list_of_zeros, zeros
from canhaptic.lab.judge.reference_group import AxesModel, ReferenceGroup, ReferenceMechanism, mechanism_model
from canhaptic.lab.judge.reference_group import State as GroupState
from canhaptic.lab.judge.reference_model import POSITION, VELOCITY, Floats, Model, Modes, State, Transition
from canhaptic.lab.judge.solvers import states_at
from canhaptic.lab.loop.axis_loop import environment_of, mechanism_moved
from canhaptic.scene.far_side import effect_of
from canhaptic.scene.method import simulation_of
from canhaptic.scene.models import AxisSimulation, Scene
from canhaptic.sim.plant.mechanism import MechanismParameters
from canhaptic.sim.plant.propagator import Array

_ROUNDING: Final = 1e-12  # [m or rad]
_BETWEEN_EVENTS: Final = 2.5e-4
"""Step at the ends of which friction, stops and flanks are checked [s]."""
_BETWEEN_SURFACES: Final = 2e-3
"""The same step if only the environment switches [s]: a handle takes longer to cross a surface and come back."""
_SURFACES: Final[dict[type, tuple[str, ...]]] = {
    SpringDamperWall: ("position",),
    HardeningWall: ("position",),
    DamperWall: ("position",),
    TwoSidedWall: ("lower", "upper"),
    ViscousMedium: (),
    ViscoelasticMedium: (),
    CoulombSurface: (),
    Detents: (),
    FreeSpace: (),
}
"""Parameters that are positions where contact begins or ends. A subclass is another environment: it may add some."""


class ContinuousRun(NamedTuple):
    """Motion of an axis or a group in the continuous environment; shapes (n,), of a group (n, axes) but for energy."""

    position: Array  # [m or rad]
    velocity: Array  # [m/s or rad/s]
    impulse: Array  # of the environment's force since the start [N*s or N*m*s]
    interaction: Array  # energy into the environment since the start, shape (n,) [J]
    apart: float = 0.0  # of a group: largest distance of its positions from those of a coarser tolerance [m or rad]


def continuous_run(
    environment: Environment, model: Model, times: Sequence[float], rtol: float, stop: Callable[[], bool] | None = None
) -> ContinuousRun:
    """Motion that the user would feel without sampling.

    Args:
        environment: Environment to render without sampling.
        model: Plant, user and effects; the environment is added to it.
        times: Times, ascending from 0 [s].
        rtol: Relative tolerance of the solver.
        stop: Polled regularly; true aborts.

    Raises:
        InputError: There are no equations for the environment, scipy is missing, the solver fails, or it was stopped.
    """
    longest = _BETWEEN_EVENTS if model.switches else _BETWEEN_SURFACES
    force = _EnvironmentForce(environment, model)
    model.add(force)
    table = np.array(states_at(model, times, rtol, stop, longest))
    return ContinuousRun(*table[:, [POSITION, VELOCITY, force.impulse, force.interaction]].T)


def surfaces(environment: Environment) -> list[float]:
    """Return the positions where contact begins or ends [m or rad], and the torque may jump.

    Raises:
        InputError: There are no equations for an environment of this class.
    """
    if getattr(environment, "damps_by_place", False):
        return []  # a sum: its force is continuous, and where its damping is not, the solver takes short steps
    names = _SURFACES.get(type(environment))
    if names is None and _has_own_surfaces(environment):
        return [float(place) for place in environment.surfaces()]  # type: ignore[attr-defined]
    if names is None:
        known = ", ".join(kind.__name__ for kind in _SURFACES)
        raise InputError(
            f"environment: got {type(environment).__name__}, for which there is no continuous run, expected one of: "
            f"{known}, or an Environment with `surfaces` of its `contact`; other figures are still measured"
        )
    return [float(getattr(environment, name)) for name in names]


def _has_own_surfaces(environment: Environment) -> bool:
    """Whether a user's own environment defines its switching surfaces, and is a force that depends only on position.

    `surfaces` must be defined in the class of `contact` and `true_state`, or below: otherwise it may not match them.
    """
    where = {
        name: place
        for place, kind in reversed(list(enumerate(type(environment).__mro__)))
        for name in ("surfaces", "contact", "true_state")
        if name in vars(kind)
    }
    return "surfaces" in where and not environment.relaxes and where["surfaces"] == min(where.values())


class _EnvironmentForce:
    """The environment as an element of the textbook plant; books its impulse and the energy it takes."""

    def __init__(self, environment: Environment, model: Model) -> None:
        self._environment = environment
        self.impulse, self.interaction = model.add_state("impulse"), model.add_state("interaction")
        self._strain = model.add_state("strain") if environment.relaxes else -1
        self._surfaces, self._is_sum = surfaces(environment), getattr(environment, "damps_by_place", False)
        start = model.start[POSITION]
        if isinstance(environment, CoulombSurface):
            self.modes: tuple[str, ...] = ("elastic", "forward", "backward")
        elif self._surfaces:
            zone = str(environment.contact(start))
            self.modes = (zone, *(z for z in ("0", "1", "2") if z != zone))
        else:
            self.modes = ("only",)

    def apply(self, time: float, state: State, mode: str, forces: Floats, rates: Floats) -> None:
        """Add the force of the environment, its power, and the rate of its strain."""
        velocity = float(state[VELOCITY])
        force = 0.0 if mode == "0" else self._force(state, mode, velocity, rates)
        forces[0] += force
        rates[self.impulse] = force
        rates[self.interaction] = -force * velocity

    def ways(self, index: int, mode: str) -> Sequence[Transition]:
        """Transitions: crossing of the surfaces, yielding, or its reversal."""
        if isinstance(self._environment, CoulombSurface):
            return self._yielding(index, mode, self._environment.friction / self._environment.stiffness)
        found = []
        for surface in self._surfaces if mode != "only" else ():
            below, above = self._zone(surface, -1.0), self._zone(surface, 1.0)
            if below != above and mode in (below, above):
                zone, sign = (above, -1.0) if mode == below else (below, 1.0)
                found.append(Transition(index, zone, partial(_distance, surface, sign), _ROUNDING))
        return found

    def _zone(self, surface: float, side: float) -> str:
        return str(self._environment.contact(math.nextafter(surface, side * math.inf)))

    def _force(self, state: State, mode: str, velocity: float, rates: Floats) -> float:
        environment = self._environment
        damper = -(self._by_place(state) if self._is_sum else environment.damping) * velocity
        if isinstance(environment, CoulombSurface | ViscoelasticMedium):
            strain = float(state[self._strain])
            if isinstance(environment, CoulombSurface):
                rates[self._strain] = velocity if mode == "elastic" else 0.0
            else:
                rates[self._strain] = velocity - strain / environment.relaxation_time
            return damper - environment.effort(strain)
        place = float(state[POSITION])
        for surface in self._surfaces if mode != "only" else ():  # rounding may have it on the wrong side
            if mode == self._zone(surface, 1.0) != self._zone(surface, -1.0):
                place = max(place, math.nextafter(surface, math.inf))
            elif mode == self._zone(surface, -1.0) != self._zone(surface, 1.0):
                place = min(place, math.nextafter(surface, -math.inf))
        return damper - environment.effort(environment.true_state(place, 0.0, 0.0))

    def _by_place(self, state: State) -> float:
        environment = self._environment
        return environment.damping_at(environment.true_state(float(state[POSITION]), 0.0, 0.0))

    def _yielding(self, index: int, mode: str, limit: float) -> Sequence[Transition]:
        strain = self._strain
        if mode == "elastic":
            return [
                Transition(
                    index, name, partial(_room, strain, sign, limit), _ROUNDING, partial(_put, strain, sign * limit)
                )
                for name, sign in (("forward", 1.0), ("backward", -1.0))
            ]
        sign = 1.0 if mode == "forward" else -1.0
        return (Transition(index, "elastic", lambda t, y, u: sign * float(y[VELOCITY]), _ROUNDING),)


def _distance(surface: float, sign: float, _time: float, state: State, _torque: float) -> float:
    """Value that falls through zero where the axis crosses the surface towards -sign."""
    return sign * (float(state[POSITION]) - surface)


def _room(strain: int, sign: float, limit: float, _time: float, state: State, _torque: float) -> float:
    """Value that falls through zero where the strain reaches its limit towards sign."""
    return limit - sign * float(state[strain])


def _put(strain: int, value: float, state: Floats) -> None:
    state[strain] = value


_FINEST: Final = 200_000
"""Longest time between two readings of the reference [ns]; at least two readings a hold."""
_MOST_READINGS: Final = 400_000
_TOLERANCE: Final = 1e-10
"""Relative tolerance of DOP853."""
REST: Final = 0.02
"""Peak-to-peak motion, as a part of the whole travel, below which the reference counts as being at rest."""


class ContinuousReference(NamedTuple):
    """Motion and torque of an axis in the continuous environment, at the SYNCs of a sampled run."""

    position: Array  # at SYNC k, shape (n,) [m or rad]
    torque: Array  # mean over the hold that ended at SYNC k, shape (n,) [N or N*m]
    variation: float  # total variation of the force, sampled finely [N or N*m]
    fine_time: Array  # [s]
    fine_torque: Array  # [N or N*m]
    method: str  # how it was computed

    @property
    def travel(self) -> float:
        """Range of the position, largest minus smallest [m or rad]."""
        return float(np.ptp(self.position))


def environment_torque(environment: Environment, position: Array, velocity: Array, step: float) -> Array:
    """Return the torque of the continuous environment along a motion [N or N*m], shape (n,).

    Strains that relax are followed over half a step before and half a step after the motion: second order in the step.

    Args:
        environment: Environment in contact.
        position: Shape (n,) [m or rad].
        velocity: Shape (n,) [m/s or rad/s].
        step: Time between two samples of the motion [s].
    """
    torque = np.zeros(len(position))
    state = last = 0.0
    zone_before = 0
    for i, (q, v) in enumerate(zip(position.tolist(), velocity.tolist(), strict=True)):
        zone = environment.contact(q)
        if zone:
            before = environment.relaxed(state, 0.5 * step) if zone == zone_before else 0.0
            state = environment.true_state(q, q - last if i else 0.0, before)
            state = environment.relaxed(state, 0.5 * step)
            torque[i] = -environment.effort(state) - environment.damping_at(state) * v
        zone_before, last = zone, q
    return torque


def textbook_model(simulation: AxisSimulation) -> Model:
    """Return the plant of a simulated axis as textbook equations."""
    return Model(simulation.plant, simulation.user, [effect_of(effect) for effect in simulation.effects])


def readings_per_hold(sample_time_ns: int, cycles: int) -> int:
    """Return how many times per hold the reference is read in a run of `cycles`."""
    least = max(2, -(-sample_time_ns // _FINEST))
    least = min(least, max(2, _MOST_READINGS // max(1, cycles)))
    return next((n for n in range(least, 2 * least + 8) if sample_time_ns % n == 0), least)


_TOLERANCE_OF_AN_AXIS: Final = 1e-11
_TOLERANCES: Final = (1e-9, 1e-7)
"""Relative tolerances of the run, and of a coarser run whose distance from it estimates the error."""
_BETWEEN_GUARDS: Final = (2.5e-4, 5e-4)
"""Longest steps of the run and of the coarser run if modes may change [s]."""


def group_model(scene: Scene) -> ReferenceGroup:
    """Equations of the plant of a scene's one group; the motors in the order of the group's axes.

    Raises:
        InputError: The plant has no equations.
    """
    if mechanism_moved(scene) is not None:
        return mechanism_of(scene)
    try:
        return AxesModel([textbook_model(simulation_of(axis)) for axis in scene.ports[0].axes])
    except ParameterError as error:
        raise InputError(f"a plant of the group has no reference equations: {error}") from error


def mechanism_of(scene: Scene) -> ReferenceMechanism:
    """Equations of the mechanism that the one group of a scene moves; errors as for `group_model`."""
    [of], [port] = scene.mechanisms, scene.ports
    if of.axes != tuple(axis.parameters.name for axis in port.axes):
        raise InputError("the mechanism lists the axes of the group in another order; use the same order")
    return mechanism_model(cast(MechanismParameters, of.mechanism.parameters), of.hand)


def continuous_motion(
    scene: Scene, step_ns: int, steps: int, stop: Callable[[], bool] = lambda: False
) -> ContinuousRun:
    """Return the motion and forces that the hands would feel without sampling.

    Args:
        scene: Scene with one axis or one group, alone.
        step_ns: Time between two readings [ns].
        steps: Readings after the first.
        stop: Polled regularly; true aborts.

    Raises:
        InputError: There are no equations, scipy is missing, the solver fails, the mechanism leaves its workspace, or
            it was stopped.
    """
    times = [k * step_ns * 1e-9 for k in range(steps + 1)]
    if not scene.groups:
        (axis,) = scene.axes
        model = textbook_model(simulation_of(axis))
        return continuous_run(environment_of(axis), model, times, _TOLERANCE_OF_AN_AXIS, stop)
    coupled = _Coupled(scene)
    fine, coarse = (
        states_at(coupled, times, tolerance, stop, step)
        for tolerance, step in zip(_TOLERANCES, _BETWEEN_GUARDS, strict=True)
    )
    position, rough = (np.array([coupled.model.positions(row) for row in rows]) for rows in (fine, coarse))
    table, apart = np.array(fine), float(np.abs(position - rough).max())
    velocity = np.array([coupled.model.velocities(row) for row in fine])
    return ContinuousRun(position, velocity, table[:, -1 - coupled.axes : -1], table[:, -1], apart)


class _Coupled:
    """Motors and network; state: motors' states, network's x, impulse of every motor, energy taken by the network."""

    def __init__(self, scene: Scene) -> None:
        [port] = scene.ports
        loops = tuple(axis.loop for axis in port.axes)
        environment = cast(NetworkEnvironment, port.rendered.parameters)
        self._world: GroupModel = world_of(environment, cast(Kinematics, port.kinematics.parameters), loops)
        self.model, self.axes = group_model(scene), len(port.axes)
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

    def rates(self, time: float, state: GroupState, torque: float, modes: Modes) -> list[float]:
        """Return the rate of every state; see `SwitchedModel`, whose torque here comes from the network."""
        torques, moved, taken = self._felt(time, state)
        motors = state[: len(self.model.start)]
        return [*self.model.rates(time, motors, torques, modes), *moved, *torques, taken]

    def ways(self, modes: Modes) -> list[Transition]:
        """Every transition out of these modes, which belong to the motors; see `SwitchedModel`."""
        return [way._replace(value=partial(self._guard, way)) for way in self.model.ways(modes)]

    def _guard(self, way: Transition, time: float, state: GroupState, _torque: float) -> float:
        return way.value(time, state[: len(self.model.start)], self._felt(time, state)[0])

    def _felt(self, time: float, state: GroupState) -> tuple[Buffer, Buffer, float]:
        """Return the torques of the network, the rates of its states and the power that it takes [W]."""
        own = len(self.model.start)
        motors, x = state[:own], [float(value) for value in state[own : own + self._states]]
        _, flows = self._ports(time, motors)
        moved, efforts = self._network(x, flows)
        torques = [-_dot([row[i] for row in self._at_motors], efforts) for i in range(self.axes)]
        return torques, moved, _dot(efforts, flows)

    def _ports(self, time: float, motors: GroupState) -> tuple[Buffer, Buffer]:
        """Return the coordinates of the ports [m or rad] and their velocities [m/s or rad/s]."""
        world, velocities = self._world, self.model.velocities(motors)
        limit = world.mechanism.locate(self.model.positions(motors), self._place, self._jacobian)
        if limit != Limit.NONE:
            why = Limit(limit).name.lower()
            raise InputError(f"at {time:g} s the mechanism is at its limit {why}; reduce the motion")
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
    """Return the effort phi(f) of a dissipator at a flow f."""
    dry = coulomb * flow / math.hypot(flow, corner) if coulomb else 0.0
    return flow * (viscous + squared * abs(flow)) + dry


def _dot(one: Sequence[float], other: Sequence[float]) -> float:
    return sum(a * b for a, b in zip(one, other, strict=True))
