"""The loop of a group without a bus: what `closed_loop.run_loop` takes for several motors under one controller.

Linear motors move by one transition matrix; the other kinds replace `move_motors`:

* `EventMotors`: plants with events, current loops or forces over substeps. Separate axes have one `EventPlant` each, a
  stage is one plant of several motors. Every mode that a plant can enter is computed before the loop starts. If one
  plant needs booked work or substeps, all use them, because one loop moves them all.
* `FiveBarMotors`: a five-bar.
* `Motors`: plants as objects, in Python only.

Where the shares are asked for, the loop also computes the network's request at the true positions, without sampling
errors (`explain`). It splits the held torques into the rendered shares of spring and damper.

`group_case` makes the loop from a scene.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import inf, sqrt
from typing import Any, Final, NamedTuple, cast

import numpy as np

from canhaptic.control.balance import RANKS, Branch, EnergyBalance
from canhaptic.control.mechanisms.kinematics import Kinematics
from canhaptic.control.multi_axis import GROUP_ALGORITHMS, group_kernel
from canhaptic.control.multi_axis.group_controller import NetworkEnvironment
from canhaptic.control.multi_axis.group_kernel import GroupModel, MotionAhead, begin_motion, follow, write_efforts
from canhaptic.kernels import Buffer, Kernel, list_of_zeros, new
from canhaptic.kernels.records import record_of, records_of
from canhaptic.lab.batch import closed_loop
from canhaptic.lab.batch import plants as event_plant
from canhaptic.lab.batch.closed_loop import CycleState, LinearMotors, Loops, LoopSettings, Room, Signals
from canhaptic.lab.batch.plants import EventMotors
from canhaptic.lab.figures.meter import Meter, MeterSettings, count_branch, take_energy
from canhaptic.lab.loop.axis_loop import EVERYWHERE, mechanism_moved
from canhaptic.registry import load
from canhaptic.scene.buses import BusParameters
from canhaptic.scene.far_side import build_mechanism, build_plant
from canhaptic.scene.method import simulation_of
from canhaptic.scene.models import AxisScene, MechanismScene, Scene
from canhaptic.scene.parts import check_kinematics, loop_as_known
from canhaptic.sim.plant import AccuracyParameters
from canhaptic.sim.plant.assembly import PlantModel
from canhaptic.sim.plant.mechanism import SharedMechanism
from canhaptic.sim.plant.mechanism import five_bar_linkage as five_bar
from canhaptic.sim.plant.mechanism.five_bar_linkage import advance_five_bar, place_at
from canhaptic.sim.plant.mechanism.xy_stage import XYMotion
from canhaptic.sim.plant.plant import Plant
from canhaptic.sim.plant.propagator import TICKS, Array

_FREE, _EXIT = Branch.FREE.value, Branch.EXIT.value


class GroupControl(NamedTuple):
    """The controller of a group."""

    world: GroupModel  # network and kinematics
    settings: Any  # of the algorithm
    state: Any  # of the algorithm, at rest
    memory: Any  # of the algorithm, zeros


@dataclass(slots=True)
class GroupMeter:
    """Running sums of a group, from which its figures are computed."""

    figures: Meter = field(default_factory=Meter)
    spring_spring: float = 0.0  # products of the requested efforts, over holds that began and ended in contact
    spring_damper: float = 0.0
    damper_damper: float = 0.0
    held_spring: float = 0.0  # products of the held torques and the requested efforts, over the same holds
    held_damper: float = 0.0
    damping_asked: float = 0.0  # requested damping along the motion; `Meter.damping` is the rendered one


class TrueMemory(NamedTuple):
    """Buffers and constants of a network that follows the true positions."""

    settings: group_kernel.MotionSettings
    motion: group_kernel.MotionMemory
    request: group_kernel.RequestedEfforts  # efforts that this network requests
    spring: Buffer  # spring part of the request at the last SYNC, (motors,) [N or N*m]
    still: Buffer  # zeros, (motors,)


class TrueNetwork(NamedTuple):
    """A network moved by the true positions, and the sums from which the rendered shares are computed."""

    world: GroupModel
    motion: group_kernel.GroupMotion  # at rest
    memory: TrueMemory
    sums: GroupMeter


def step(*_kernel: Any) -> group_kernel.GroupHold:
    """Placeholder of an algorithm's step (`Kernel.step`)."""
    raise NotImplementedError


def respond_as_group(control: GroupControl, room: Room, place: CycleState) -> EnergyBalance:
    """Replace `closed_loop.respond` for the controller of a group."""
    hold = step(control.world, control.settings, control.state, control.memory, 0, room.seen, room.held)
    torques = control.memory.group.commands.torques[hold.place]
    for i in range(len(room.commands)):
        room.commands[i] = torques[i]
    place.supplied += hold.account.supplied
    account: EnergyBalance = hold.account
    return account


def take_group(
    control: GroupControl, loops: Loops, room: Room, place: CycleState, figures: Meter, account: EnergyBalance
) -> None:
    """Replace `closed_loop.take_sync`: add one SYNC to the figures of a group; see `meter.take`."""
    square = largest = 0.0
    figures.cycles += 1.0
    for i in range(len(room.held)):
        figures.lost += loops[i].meter.damping_per_time * (room.moved[i] * room.moved[i])
        square += room.held[i] * room.held[i]
        largest = max(largest, abs(room.held[i]))
    norm = sqrt(square)
    take_energy(loops[0].meter, figures, 0.0, place.supplied - place.work, account)
    figures.torque_peak = max(figures.torque_peak, largest)
    figures.variation += abs(norm - figures.torque)
    figures.torque = norm
    figures.certificate = max(figures.certificate, float(RANKS[account.certificate]))
    count_branch(figures, account.branch)
    if account.branch != _FREE and account.branch != _EXIT:  # noqa: PLR1714 - `in` would search
        rendered = account.damping_rendered
        figures.contacts += 1.0
        figures.damping += rendered
        figures.damping_least = min(figures.damping_least, rendered)
        figures.damping_most = max(figures.damping_most, rendered)


def explain(watched: TrueNetwork, room: Room, figures: Meter, cycle: int) -> None:
    """Replace `closed_loop.watch`: move the network with the true motion.

    A hold that began and ended in contact is added to the sums of the shares.
    """
    world, followed, memory, meter = watched.world, watched.motion, watched.memory, watched.sums
    if not cycle:
        begin_motion(world, memory.settings, followed, memory.motion, room.true)
        return
    was_engaged, request = followed.engaged, memory.request
    follow(world, memory.settings, followed, memory.motion, room.true, room.moved, 1)
    if followed.engaged:
        ahead = new(MotionAhead, (0.0, memory.still, memory.still, False))
        write_efforts(world, memory.settings, followed, memory.motion, ahead, request)
    along = square = 0.0
    for i in range(len(room.held)):
        along += request.damper[i] * request.velocity[i]
        square += request.velocity[i] * request.velocity[i]
        now = request.spring[i] if followed.engaged else 0.0
        spring, damper = 0.5 * (memory.spring[i] + now), request.damper[i]
        memory.spring[i] = now
        if was_engaged and followed.engaged:
            meter.spring_spring += spring * spring
            meter.spring_damper += spring * damper
            meter.damper_damper += damper * damper
            meter.held_spring -= room.held[i] * spring
            meter.held_damper -= room.held[i] * damper
    if followed.engaged and square > 0.0:
        meter.damping_asked += along / square


def shares(meter: GroupMeter) -> tuple[float, float]:
    """Return the rendered shares of spring and damper; NaN for a part of which no effort was requested.

    The spring's share is a least-squares fit of the held torques to the requested efforts of spring and damper. The
    damper's share is the damping booked by the controller over the requested one.
    """
    both, nothing = meter.spring_spring * meter.damper_damper, float("nan")
    apart = both - meter.spring_damper * meter.spring_damper
    damper = meter.figures.damping / meter.damping_asked if meter.damping_asked > 0.0 else nothing
    if meter.spring_spring == 0.0:
        return nothing, damper
    if meter.damper_damper <= 1e-9 * meter.spring_spring or apart <= 1e-9 * both:
        return meter.held_spring / meter.spring_spring, damper
    return (meter.held_spring * meter.damper_damper - meter.held_damper * meter.spring_damper) / apart, damper


class FiveBarMotors(NamedTuple):
    """A five-bar, its two motors and its hand."""

    settings: Sequence[five_bar.FiveBarSettings]  # one
    state: Sequence[five_bar.FiveBarState]  # one
    left: int  # index of the left motor in the group
    right: int


def move_five_bar(motors: FiveBarMotors, room: Room, each: range, cycle: int) -> bool:
    """Replace `closed_loop.move_motors`; return False if the links were pushed through a singular pose."""
    state, settings = motors.state[0], motors.settings[0]
    torques = (room.acting[motors.left], room.acting[motors.right])
    place = place_at(settings.links, state.left, state.right)
    advance_five_bar(settings, state, place, (cycle - 1) * TICKS, TICKS, torques)
    return state.stuck == 0.0


def five_bar_position_of(motors: FiveBarMotors, i: int) -> float:
    """Replace `closed_loop.position_of`."""
    return motors.state[0].left if i == motors.left else motors.state[0].right


class Motors:
    """Motors of one axis or a group, whose plants are objects of `canhaptic.sim.plant`.

    Args:
        plants: Plant of each motor, before it begins.
        sample_time_ns: Time between two SYNCs [ns].
        mechanism: Mechanism that moves all motors, if there is one.
    """

    def __init__(self, plants: Sequence[Any], sample_time_ns: int, mechanism: Any = None) -> None:
        self.plants: Sequence[Plant] = plants
        self.sample_time_ns, self._mechanism = sample_time_ns, mechanism
        self.has_encoders = mechanism is None
        self._torques: Sequence[float] = [0.0] * len(plants)
        for i, plant in enumerate(plants):
            if mechanism is not None:
                plant.connect(lambda i=i: self._torques[i])
            plant.begin(0)

    def positions(self) -> list[float]:
        """Return the true positions [m or rad]."""
        return [plant.position for plant in self.plants]

    def velocities(self) -> list[float]:
        """Return the true velocities [m/s or rad/s]."""
        return [plant.velocity for plant in self.plants]

    def advance_to(self, now: int, torques: Sequence[float]) -> None:
        """Move to a time [ns] under constant torques [N or N*m]."""
        self._torques = torques
        for i, plant in enumerate(self.plants):
            plant.advance_to(now, torques[i])

    def works(self) -> tuple[float, float]:
        """Return the works of all motors and of all hands since the start [J]."""
        energies = [plant.energy() for plant in self.plants]
        return sum(energy.motor for energy in energies), sum(energy.user for energy in energies)

    def evaluations(self) -> int:
        """Return the evaluations of the equations of motion since the start."""
        if self._mechanism is not None:
            return int(getattr(self._mechanism, "iterations", 0))
        return sum(plant.products for plant in self.plants)


def move_objects(motors: Motors, room: Room, each: range, cycle: int) -> bool:
    """Replace `closed_loop.move_motors` for plants as objects, which apply all effects themselves."""
    motors.advance_to(cycle * motors.sample_time_ns, room.acting)
    return True


def object_position_of(motors: Motors, i: int) -> float:
    """Replace `closed_loop.position_of` for plants as objects."""
    return motors.plants[i].position


def object_encoder(motors: Motors, i: int, signals: Signals, cycle: int, position: float) -> float:
    """Replace `closed_loop.encoder` for plants as objects."""
    return motors.plants[i].encoder_position if motors.has_encoders else position


def object_work_of(motors: Motors, work: float) -> float:
    """Replace `closed_loop.work_of` by the energies that the plants report."""
    work = 0.0
    for plant in motors.plants:
        work += plant.energy().motor
    return work


OBJECTS: Final[Mapping[object, object]] = {
    closed_loop.move_motors: move_objects, closed_loop.position_of: object_position_of,
    closed_loop.encoder: object_encoder, closed_loop.work_of: object_work_of,
}  # fmt: skip
"""Replacements of functions of the loop for plants as objects."""


def motors_of(scene: Scene, axes: Sequence[AxisScene]) -> Motors:
    """Return the motors of a group as objects: one plant for each, or one mechanism.

    Args:
        scene: Scene with only this group.
        axes: Axes of the group.

    Raises:
        InputError: The motors are not simulated, or their mechanism also moves other axes.
    """
    of, time = mechanism_moved(scene), scene.bus.sample_time_ns
    if of is None:
        return Motors([build_plant(simulation_of(axis), time) for axis in axes], time)
    shared = SharedMechanism(build_mechanism(of, time), len(axes))
    motors = [shared.motors[of.axes.index(axis.parameters.name)] for axis in axes]
    return Motors(motors, time, shared.mechanism)


class GroupPlant(NamedTuple):
    """The motors of a group in the form that its loop takes."""

    made: Callable[[bool], Any]  # (True for lists, which Python takes; False for arrays) -> motors at their start
    replaced: Mapping[object, object]  # function of the loop -> its replacement


def _plant_in_loop(scene: Scene, axes: Sequence[AxisScene]) -> GroupPlant | str:
    """Return the motors of a group in the form of its loop, or the reason why there is none; see `motors_of`."""
    of, time = mechanism_moved(scene), scene.bus.sample_time_ns
    if of is not None:
        return _of_mechanism(build_mechanism(of, time), [of.axes.index(axis.parameters.name) for axis in axes], of)
    simulations = [simulation_of(axis) for axis in axes]
    reason = next(filter(None, map(event_plant.why_not_in_loop, simulations)), "")
    if reason:
        return reason
    if all(map(event_plant.is_linear, simulations)):
        return _side_by_side([build_plant(simulation, time) for simulation in simulations])
    models = [event_plant.PlantValues(simulation, time).scene for simulation in simulations]
    forces, accuracy = [len(model().names) - 2 for model in models], [one.accuracy for one in simulations]
    return _with_events(models, accuracy, list(range(len(axes))), forces, [0] * len(axes))


def _of_mechanism(moving: Any, order: Sequence[int], of: MechanismScene) -> GroupPlant | str:
    """Return a mechanism for the loop, or why there is none; `order`: index of each motor in the mechanism."""
    if isinstance(moving, five_bar.FiveBarMotion):
        return _of_five_bar(moving, order.index(0), order.index(1))
    if not isinstance(moving, XYMotion):
        return f"the mechanism {of.mechanism.name} is own code"
    if moving.is_linear:
        return _stage(moving, order)
    places = [[part[at] for at in order] for part in (moving.force_places, moving.position_places)]
    return event_plant.why_not_events(moving.model()) or _with_events([moving.model], [None], [0] * len(order), *places)


def _with_events(
    models: Sequence[Callable[[], PlantModel]], accuracy: Sequence[AccuracyParameters | None], *places: Sequence[int]
) -> GroupPlant:
    """Return motors whose plants have events; the further arguments are the last three fields of `EventMotors`."""
    scenes = [model() for model in models]
    is_booked = any(map(event_plant.works_are_booked, scenes))  # more than torque times displacement

    def made(listed: bool) -> EventMotors:
        modes = (
            event_plant.EventModes(model(), given, listed=listed, is_booked=is_booked)
            for model, given in zip(models, accuracy, strict=True)
        )
        whole: Callable[[Sequence[int]], Any] = list if listed else np.array
        return EventMotors(tuple(of.plant() for of in modes), *map(whole, places))

    return GroupPlant(made, event_plant.loop_replacements(scenes))


def _of_five_bar(motion: five_bar.FiveBarMotion, left: int, right: int) -> GroupPlant:
    def made(listed: bool) -> FiveBarMotors:
        form: Callable[[Any], Any] = list if listed else records_of
        return FiveBarMotors(form([motion.settings]), form([replace(motion.state)]), left, right)

    return GroupPlant(made, {closed_loop.move_motors: move_five_bar, closed_loop.position_of: five_bar_position_of})


def _side_by_side(plants: Sequence[Plant]) -> GroupPlant:
    """Return separate linear plants, each with the state [position, ..., torque, 1], as one linear plant."""
    flows, starts = [plant.whole_flow() for plant in plants], [plant.scene.initial_state() for plant in plants]
    sizes = [len(start) - 2 for start in starts]
    places = [sum(sizes[:i]) for i in range(len(sizes))]
    states, motors = sum(sizes), len(plants)
    whole, state = np.zeros((states, states + motors + 1)), np.zeros(states + motors + 1)
    for i, (flow, start, place, size) in enumerate(zip(flows, starts, places, sizes, strict=True)):
        rows = range(place, place + size)
        whole[np.ix_(rows, [*rows, states + i, -1])] = flow[:size]
        state[place : place + size] = start[:size]
    return _listed(whole, state, places)


def _stage(stage: XYMotion, order: Sequence[int]) -> GroupPlant:
    """Return a linear stage, in whose state the torques are constants.

    Args:
        stage: Stage without dry friction.
        order: Index of each motor of the group in the stage.
    """
    flow, start = stage.whole_flow(), stage.state
    forces = [stage.force_places[at] for at in order]
    rest = [i for i in range(len(start) - 1) if i not in forces]
    columns = [*rest, *forces, len(start) - 1]
    return _listed(flow[np.ix_(rest, columns)], start[columns], [rest.index(stage.position_places[at]) for at in order])


def _listed(flow: Array, state: Array, places: Sequence[int]) -> GroupPlant:
    state[-1] = 1.0
    motors = LinearMotors(flow.tolist(), state.tolist(), [0.0] * len(flow), list(places))
    return GroupPlant(lambda listed: motors._replace(state=list(motors.state)) if listed else record_of(motors)[0], {})


class GroupCase(NamedTuple):
    """One group as the objects that its loop takes."""

    kernel: Kernel
    world: GroupModel
    settings: Any
    loops: list[LoopSettings]  # one for each motor
    motors: GroupPlant
    true: group_kernel.MotionSettings  # with which the network follows the true positions
    explains: bool  # whether the rendered shares of spring and damper are needed
    why_not: str = ""  # reason why its loop cannot be compiled; "" where it can

    @property
    def replaced(self) -> dict[object, object]:
        """Function of the loop -> its replacement."""
        explained: dict[object, object] = {closed_loop.watch: explain} if self.explains else {}
        return {
            step: self.kernel.step, closed_loop.respond: respond_as_group, closed_loop.take_sync: take_group,
            closed_loop.miss_sync: closed_loop.nothing, **explained, **self.motors.replaced,
        }  # fmt: skip

    def with_objects(self, scene: Scene) -> "GroupCase":
        """Return the same group with its plants as objects, which apply all effects themselves."""
        axes = scene.ports[0].axes
        motors_of(scene, axes)  # refuses what cannot be built before a run would count it as diverged
        motors = GroupPlant(lambda _listed: motors_of(scene, axes), OBJECTS)
        return self._replace(motors=motors, loops=[replace(loop, signals=Signals()) for loop in self.loops])

    def true_memory(self) -> TrueMemory:
        """Return the buffers of the network at the true positions."""
        motors = len(self.loops)
        request = group_kernel.RequestedEfforts(*(list_of_zeros(motors) for _ in range(4)))
        motion = group_kernel.motion_memory(self.world, self.true)
        return TrueMemory(self.true, motion, request, list_of_zeros(motors), list_of_zeros(motors))


def group_case(scene: Scene, *, explains: bool = False) -> GroupCase:
    """Return the group of a scene for its loop.

    Args:
        scene: Scene with only this group.
        explains: Whether the rendered shares of spring and damper are needed.

    Raises:
        InputError: The motors are not simulated, or their mechanism also moves other axes.
        ParameterError: The group cannot be built.
    """
    [port] = scene.ports
    check_kinematics(port)
    axes = port.axes
    loops = tuple(loop_as_known(axis) for axis in axes)
    environment, kinematics = (cast(Any, part.parameters) for part in (port.rendered, port.kinematics))
    world = group_kernel.world_of(cast(NetworkEnvironment, environment), cast(Kinematics, kinematics), loops)
    kernel: Kernel = load(GROUP_ALGORITHMS, port.passivity.name, "group algorithm").kernel
    settings = kernel.settings(world, port.passivity.parameters, loops)
    bare = tuple(loop.model_copy(update={"encoder_count": 0.0}) for loop in loops)
    true = group_kernel.motion_settings(world, bare)
    of_motors = [_loop_of(axis, scene.bus) for axis in axes]
    found = _plant_in_loop(scene, axes)
    if isinstance(found, str):
        nothing = GroupPlant(lambda _listed: None, {})
        return GroupCase(kernel, world, settings, of_motors, nothing, true, explains, found).with_objects(scene)
    return GroupCase(kernel, world, settings, of_motors, found, true, explains, group_kernel.why_not_world(world))


def _loop_of(axis: AxisScene, bus: BusParameters) -> LoopSettings:
    """Return the loop settings of one motor, with the effects of its plant on torque and encoder."""
    parameters, of = axis.parameters, axis.simulation
    signals = Signals() if of is None else event_plant.signals_of(of.effects, bus.sample_time, of.seed)
    return LoopSettings(
        bus.delay, parameters.counts_per_unit or 0.0, (parameters.rated_torque or 0.0) * 1e-3,
        parameters.torque_limit or inf, *EVERYWHERE,
        MeterSettings(damping_per_time=(axis.loop.device_damping or 0.0) / bus.sample_time), signals,
    )  # fmt: skip
