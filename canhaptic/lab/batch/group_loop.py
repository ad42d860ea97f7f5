"""Kernel of the loop of a group without a bus: motors, encoders, the group's controller, delay and torque limits.

`run_group` is for several motors what `closed_loop.run_loop` is for one axis. Linear motors move by one transition
matrix; the other kinds replace `move_motors`:

* `EventMotors`: plants with events, current loops or forces over substeps. Separate axes have one `EventPlant` each, a
  stage is one plant of several motors. Every mode that a plant can enter is computed before the loop starts. If one
  plant needs booked work or substeps, all use them, because one loop moves them all.
* `FiveBarMotors`: a five-bar.
* `Motors`: plants as objects, in Python only.

With `GroupRig.explains` the loop also computes the network's request at the true positions, without sampling errors.
It splits the held torques into the rendered shares of spring and damper.

`group_case` makes the loop from a scene.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import inf, isfinite, sqrt
from typing import Annotated, Any, NamedTuple, cast

import numpy as np

from canhaptic.control.balance import RANKS, Branch
from canhaptic.control.mechanisms.kinematics import Kinematics
from canhaptic.control.multi_axis import GROUP_ALGORITHMS, group_kernel
from canhaptic.control.multi_axis.group_controller import NetworkEnvironment
from canhaptic.control.multi_axis.group_kernel import GroupModel, MotionAhead, begin_motion, follow, write_efforts
from canhaptic.drive.axis_parameters import BusParameters
from canhaptic.kernels import OFTEN_ZERO, Buffer, Indices, Kernel, Matrix, list_of_zeros, new
from canhaptic.kernels.records import record_of, records_of
from canhaptic.lab.batch import plants as event_plant
from canhaptic.lab.batch.closed_loop import LoopSettings, Signals, acting, commanded, measured, read
from canhaptic.lab.batch.mode_arrays import evaluate
from canhaptic.lab.batch.plants import move_held, run_on, run_substeps
from canhaptic.lab.figures.meter import Meter, count_branch, take_energy
from canhaptic.lab.loop.axis_loop import FURTHEST, mechanism_of_group
from canhaptic.registry import load
from canhaptic.scene.far_side import build_mechanism, build_plant
from canhaptic.scene.method import simulation_of
from canhaptic.scene.models import AxisScene, MechanismScene, Scene
from canhaptic.scene.parts import check_group, loop_as_known
from canhaptic.sim.plant import AccuracyParameters, splitting, stepper
from canhaptic.sim.plant.assembly import PlantModel
from canhaptic.sim.plant.mechanism import SharedMechanism
from canhaptic.sim.plant.mechanism import five_bar_linkage as five_bar
from canhaptic.sim.plant.mechanism.five_bar_linkage import advance_five_bar, place_at
from canhaptic.sim.plant.mechanism.xy_stage import XYMotion
from canhaptic.sim.plant.plant import Plant
from canhaptic.sim.plant.propagator import TICKS, Array

_FREE, _EXIT = Branch.FREE.value, Branch.EXIT.value


class GroupRig(NamedTuple):
    """Properties of the loop between motors and controller."""

    delay: int  # whole holds between the computation of a torque and its hold, 0 or 1
    loops: list[LoopSettings]  # one for each motor
    damping_per_time: Buffer  # b / T of each motor, with b its certain damping [N/m or N*m/rad]
    furthest: float  # distance from the origin that counts as divergence [m or rad]
    explains: Annotated[bool, OFTEN_ZERO]  # whether the rendered shares of spring and damper are needed
    true: group_kernel.MotionSettings  # settings with which the network follows the true positions


class LinearMotors(NamedTuple):
    """Linear motors, which move by one transition matrix."""

    flow: Matrix  # transition matrix over one hold, shape (states, states + motors + 1)
    state: Buffer  # [states..., torques..., 1]
    moved: Buffer  # buffer for the states
    places: Indices  # index of each motor's position in the state


class GroupRoom(NamedTuple):
    """Buffers of the loop, of shape (motors,) unless stated."""

    held: Buffer  # torques held since the previous SYNC [N or N*m]
    waiting: Buffer  # torques that are held from the next SYNC on, where commands are one sample late
    acting: Buffer  # part of `held` that reaches the motors
    temperatures: Buffer  # windings [K]
    true: Buffer  # true positions [m or rad]
    read: Buffer  # positions with the effects of the encoders
    seen: Buffer  # positions in whole counts, as the controller gets them
    moved: Buffer  # true displacement in the hold that ended
    spring: Buffer  # spring part of the request at the last SYNC [N or N*m]
    still: Buffer  # zeros
    asked: group_kernel.MotionMemory  # memory of the network at the true positions
    request: group_kernel.RequestedEfforts  # efforts that this network requests


@dataclass(slots=True)
class GroupMeter:
    """Running sums of a group, from which its figures are computed."""

    figures: Meter = field(default_factory=Meter)
    supplied: float = 0.0  # energy from a mover [J]
    work: float = 0.0  # work of all motors [J]
    spring_spring: float = 0.0  # products of the requested efforts, over holds that began and ended in contact
    spring_damper: float = 0.0
    damper_damper: float = 0.0
    held_spring: float = 0.0  # products of the held torques and the requested efforts, over the same holds
    held_damper: float = 0.0
    damping_asked: float = 0.0  # requested damping along the motion; `Meter.damping` is the rendered one


def step(*_kernel: Any) -> group_kernel.GroupHold:
    """Placeholder of an algorithm's step (`Kernel.step`); the caller of `run_group` binds one."""
    raise NotImplementedError


def run_group(
    world: GroupModel, settings: object, state: Any, memory: Any, rig: GroupRig, motors: Any, room: GroupRoom,
    followed: group_kernel.GroupMotion, meter: GroupMeter, rows: Matrix, cycles: int,
) -> None:  # fmt: skip
    """Run a loop until its last SYNC or until it diverges; a number that is not finite counts as divergence.

    Args:
        world: Network and kinematics of the group.
        settings: Settings of the algorithm.
        state: State of the algorithm, at rest.
        memory: Memory of the algorithm, zeros.
        rig: Properties of the loop between motors and controller.
        motors: Motors in the form of `move_motors`, at their start.
        room: Buffers of zeros.
        followed: Motion of the network at the true positions, at rest.
        meter: Accumulates the sums.
        rows: Rows that a replacement of `take_group` fills; else unused.
        cycles: Number of SYNCs.
    """
    figures = meter.figures
    for cycle in range(cycles):
        act(rig, room, cycle)
        work = move_motors(motors, room, cycle)
        if not isfinite(work):
            figures.diverged = 1.0
            break
        meter.work += work
        if cycle and rig.explains:
            explain(world, rig, room, followed, meter)
        elif rig.explains:
            begin_motion(world, rig.true, followed, room.asked, room.true)
        see(rig, room, cycle)
        hold = step(world, settings, state, memory, 0, room.seen, room.held)
        torques, total = memory.group.commands.torques[hold.place], 0.0
        for i in range(len(room.held)):
            total += torques[i] + room.seen[i] + room.held[i]
        if not isfinite(total):
            figures.diverged = 1.0
            break
        meter.supplied += hold.supplied
        take_group(rig, room, meter, rows, hold)
        if is_away(rig, room):
            figures.diverged = 1.0
            break
        send(rig, room, torques)


def act(rig: GroupRig, room: GroupRoom, cycle: int) -> None:
    """Compute the part of each held torque that reaches its motor in the hold before a SYNC."""
    for i in range(len(room.held)):
        signals = rig.loops[i].signals
        if not cycle:
            room.temperatures[i] = signals.winding.ambient
        elif signals.on_torque:
            room.acting[i], room.temperatures[i] = acting(signals, room.temperatures[i], room.held[i])
        else:
            room.acting[i] = room.held[i]


def see(rig: GroupRig, room: GroupRoom, cycle: int) -> None:
    """Write the positions in whole counts of the encoders."""
    for i in range(len(room.seen)):
        at, loop = room.read[i], rig.loops[i]
        room.seen[i] = measured(loop, read(loop.signals, cycle, at)) if isfinite(at) else at


def send(rig: GroupRig, room: GroupRoom, torques: Buffer) -> None:
    """Pass the commands to the drives, for this hold or, one sample late, for the next."""
    for i in range(len(room.held)):
        command = commanded(rig.loops[i], torques[i])
        if rig.delay:
            room.held[i], room.waiting[i] = room.waiting[i], command
        else:
            room.held[i] = command


def is_away(rig: GroupRig, room: GroupRoom) -> bool:
    """Return whether a motor has diverged: it is at least `rig.furthest` away from the origin."""
    for i in range(len(room.true)):
        if not -rig.furthest < room.true[i] < rig.furthest:
            return True
    return False


def take_group(rig: GroupRig, room: GroupRoom, meter: GroupMeter, rows: Matrix, hold: group_kernel.GroupHold) -> None:
    """Add one SYNC to the sums of a group; see `meter.take`."""
    figures, account, square, largest = meter.figures, hold.account, 0.0, 0.0
    figures.cycles += 1.0
    for i in range(len(room.held)):
        figures.lost += rig.damping_per_time[i] * (room.moved[i] * room.moved[i])
        square += room.held[i] * room.held[i]
        largest = max(largest, abs(room.held[i]))
    norm = sqrt(square)
    take_energy(rig.loops[0].meter, figures, 0.0, meter.supplied - meter.work, account)
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


def explain(
    world: GroupModel, rig: GroupRig, room: GroupRoom, followed: group_kernel.GroupMotion, meter: GroupMeter
) -> None:
    """Move the network with the true motion; add a hold that began and ended in contact to the sums of the shares."""
    was_engaged, request = followed.engaged, room.request
    follow(world, rig.true, followed, room.asked, room.true, room.moved, 1)
    if followed.engaged:
        write_efforts(
            world, rig.true, followed, room.asked, new(MotionAhead, (0.0, room.still, room.still, False)), request
        )
    along = square = 0.0
    for i in range(len(room.held)):
        along += request.damper[i] * request.velocity[i]
        square += request.velocity[i] * request.velocity[i]
        now = request.spring[i] if followed.engaged else 0.0
        spring, damper = 0.5 * (room.spring[i] + now), request.damper[i]
        room.spring[i] = now
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


def move_motors(motors: Any, room: GroupRoom, cycle: int) -> float:
    """Move the motors to a SYNC; return their work in that hold [J], NaN where the plant cannot be advanced."""
    state, moved = motors.state, motors.moved
    states, work, count = len(moved), 0.0, len(room.held)
    if cycle:
        for i in range(count):
            state[states + i] = room.acting[i]
        evaluate(motors.flow, state, moved)
        for row in range(states):
            state[row] = moved[row]
    for i in range(count):
        work += arrive(room, i, state[motors.places[i]], cycle)
    return work


def arrive(room: GroupRoom, i: int, at: float, cycle: int) -> float:
    """Record the position `at` of a motor at a SYNC [m or rad]; return its work in that hold [J]."""
    room.moved[i] = at - room.true[i] if cycle else 0.0
    room.true[i] = room.read[i] = at
    return room.acting[i] * room.moved[i]


class EventMotors(NamedTuple):
    """Motors whose plants have events."""

    plants: Any  # tuple of `EventPlant`
    owners: Indices  # index of each motor's plant
    forces: Indices  # index of each motor's torque in the state of that plant
    places: Indices  # index of its position there


def run_with_efforts(plant: event_plant.EventPlant, ticks: int, most: int) -> int:
    """Replace `run_ticks` where some plants have forces that are solved over substeps."""
    return run_substeps(plant, ticks, most) if len(plant.efforts) else run_on(plant, ticks, most)


def work_over(plant: event_plant.EventPlant, way: float) -> float:
    """Return the work of a motor in a hold [J]: `way`, its torque times displacement."""
    return way


def booked_over(plant: event_plant.EventPlant, way: float) -> float:
    """Replace `work_over` where the stepper integrates the work."""
    now = plant.now[0]
    booked: float = plant.books[0].totals[0] + now.rippled - now.began_work
    return booked


def move_event_motors(motors: EventMotors, room: GroupRoom, cycle: int) -> float:
    """Replace `move_motors`; NaN where a plant had too many events."""
    work, count = 0.0, len(room.held)
    if cycle:
        for i in range(count):
            motors.plants[motors.owners[i]].state[motors.forces[i]] = room.acting[i]
        for k in range(len(motors.plants)):
            if not move_held(motors.plants[k], cycle):
                return float("nan")
    for i in range(count):
        plant = motors.plants[motors.owners[i]]
        work += work_over(plant, arrive(room, i, plant.state[motors.places[i]], cycle))
    return work


class FiveBarMotors(NamedTuple):
    """A five-bar, its two motors and its hand, for `run_group`."""

    settings: Any  # (FiveBarSettings,)
    state: Any  # (FiveBarState,)
    left: int  # index of the left motor in the group
    right: int


def move_five_bar(motors: FiveBarMotors, room: GroupRoom, cycle: int) -> float:
    """Replace `move_motors`; NaN where the links were pushed through a singular pose."""
    state, settings = motors.state[0], motors.settings[0]
    if cycle:
        torques = (room.acting[motors.left], room.acting[motors.right])
        place = place_at(settings.links, state.left, state.right)
        advance_five_bar(settings, state, place, (cycle - 1) * TICKS, TICKS, torques)
        if state.stuck != 0.0:
            return float("nan")
    return arrive(room, motors.left, state.left, cycle) + arrive(room, motors.right, state.right, cycle)


class Motors:
    """Motors of a group as objects: one plant for each, or one mechanism.

    Args:
        scene: Scene with only this group.
        axes: Axes of the group.

    Raises:
        InputError: The motors are not simulated, or their mechanism also moves other axes.
    """

    def __init__(self, scene: Scene, axes: Sequence[AxisScene]) -> None:
        self.sample_time_ns, self._torques = scene.bus.sample_time_ns, tuple(0.0 for _ in axes)
        of = mechanism_of_group(scene)
        shared = None if of is None else SharedMechanism(build_mechanism(of, self.sample_time_ns), len(axes))
        self._mechanism = shared and shared.mechanism
        self._motors: list[Any] = (
            [build_plant(simulation_of(axis), self.sample_time_ns) for axis in axes]
            if of is None or shared is None
            else [shared.motors[of.axes.index(axis.parameters.name)] for axis in axes]
        )
        for i, motor in enumerate(self._motors):
            if shared is not None:
                motor.connect(lambda i=i: self._torques[i])
            motor.begin(0)

    def positions(self) -> list[float]:
        """Return the true positions [m or rad]."""
        return [motor.position for motor in self._motors]

    def velocities(self) -> list[float]:
        """Return the true velocities [m/s or rad/s]."""
        return [motor.velocity for motor in self._motors]

    def encoders(self) -> list[float]:
        """Return the positions after the effects of encoders [m or rad]."""
        return [getattr(motor, "encoder_position", motor.position) for motor in self._motors]

    def advance_to(self, now: int, torques: tuple[float, ...]) -> None:
        """Move to a time [ns] under constant torques [N or N*m]."""
        self._torques = torques
        for motor, torque in zip(self._motors, torques, strict=True):
            motor.advance_to(now, torque)

    def works(self) -> tuple[float, float]:
        """Return the works of all motors and of all hands since the start [J]."""
        energies = [motor.energy() for motor in self._motors]
        return sum(energy.motor for energy in energies), sum(energy.user for energy in energies)

    def evaluations(self) -> int:
        """Return the evaluations of the equations of motion since the start."""
        if self._mechanism is not None:
            return int(getattr(self._mechanism, "iterations", 0))
        return sum(motor.products for motor in self._motors)


def move_objects(motors: Motors, room: GroupRoom, cycle: int) -> float:
    """Replace `move_motors` for plants as objects."""
    before, _ = motors.works()
    if cycle:
        motors.advance_to(cycle * motors.sample_time_ns, tuple(room.held))
    for i, at in enumerate(motors.positions()):
        arrive(room, i, at, cycle)
    room.read[:] = motors.encoders()
    return motors.works()[0] - before


class GroupPlant(NamedTuple):
    """The motors of a group in the form that its loop takes."""

    made: Callable[[bool], Any]  # (True for lists, which Python takes; False for arrays) -> motors at their start
    replaced: Mapping[object, object]  # function of the loop -> its replacement


def _plant_in_loop(scene: Scene, axes: Sequence[AxisScene]) -> GroupPlant | str:
    """Return the motors of a group, or the reason why the loop of a group cannot move them.

    Args:
        scene: Scene with only this group.
        axes: Axes of the group.

    Raises:
        InputError: The motors are not simulated, or their mechanism also moves other axes.
    """
    of, time = mechanism_of_group(scene), scene.bus.sample_time_ns
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
    is_booked = any(event_plant.works_are_booked(model()) for model in models)  # more than torque times displacement

    def made(listed: bool) -> EventMotors:
        modes = (
            event_plant.EventModes(model(), given, listed=listed, is_booked=is_booked)
            for model, given in zip(models, accuracy, strict=True)
        )
        whole: Callable[[Sequence[int]], Any] = list if listed else np.array
        return EventMotors(tuple(of.plants().plant for of in modes), *map(whole, places))

    replaced: dict[object, object] = {**event_plant.by_its_way(), move_motors: move_event_motors}
    if any(model().efforts for model in models):
        replaced |= {event_plant.run_ticks: run_with_efforts, splitting.residual: event_plant.residual_of_plant}
    if is_booked:
        replaced |= {stepper.book: event_plant.book_motor, work_over: booked_over}
    return GroupPlant(made, replaced)


def _of_five_bar(motion: five_bar.FiveBarMotion, left: int, right: int) -> GroupPlant:
    def made(listed: bool) -> FiveBarMotors:
        settings, state = [motion.settings], [replace(motion.state)]
        if listed:
            return FiveBarMotors(settings, state, left, right)
        return FiveBarMotors(records_of(settings), records_of(state), left, right)

    return GroupPlant(made, {move_motors: move_five_bar})


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
    rig: GroupRig
    motors: GroupPlant
    why_not: str = ""  # reason why its loop cannot be compiled; "" where it can

    def with_objects(self, scene: Scene) -> "GroupCase":
        """Return the same group with its plants as objects, which apply all effects themselves."""
        axes = [scene.axis(name) for name in scene.groups[0].axes]
        bare = [replace(loop, signals=Signals()) for loop in self.rig.loops]
        Motors(scene, axes)  # refuses what cannot be built before a run would count it as diverged
        motors = GroupPlant(lambda _listed: Motors(scene, axes), {move_motors: move_objects})
        return self._replace(motors=motors, rig=self.rig._replace(loops=bare))

    def room(self) -> GroupRoom:
        """Return the buffers of the loop, filled with zeros."""
        axes = len(self.rig.loops)
        one = [list_of_zeros(axes) for _ in GroupRoom._fields]
        request = group_kernel.RequestedEfforts(*(list_of_zeros(axes) for _ in range(4)))
        return GroupRoom(*one)._replace(asked=group_kernel.motion_memory(self.world, self.rig.true), request=request)  # type: ignore[arg-type]


def group_case(scene: Scene, *, explains: bool = False) -> GroupCase:
    """Return the group of a scene for its loop.

    Args:
        scene: Scene with only this group.
        explains: Whether the rendered shares of spring and damper are needed.

    Raises:
        InputError: The motors are not simulated, or their mechanism also moves other axes.
        ParameterError: The group cannot be built.
    """
    (group,) = scene.groups
    check_group(group)
    axes = [scene.axis(name) for name in group.axes]
    loops = tuple(loop_as_known(axis) for axis in axes)
    environment, kinematics = (cast(Any, part.parameters) for part in (group.network, group.kinematics))
    world = group_kernel.world_of(cast(NetworkEnvironment, environment), cast(Kinematics, kinematics), loops)
    kernel: Kernel = load(GROUP_ALGORITHMS, group.passivity.name, "group algorithm").kernel
    settings = kernel.settings(world, group.passivity.parameters, loops)
    rig = GroupRig(
        scene.bus.delay, [_loop_of(axis, scene.bus) for axis in axes],
        [(axis.loop.device_damping or 0.0) / scene.bus.sample_time for axis in axes], FURTHEST, explains,
        group_kernel.motion_settings(world, tuple(loop.model_copy(update={"encoder_count": 0.0}) for loop in loops)),
    )  # fmt: skip
    found = _plant_in_loop(scene, axes)
    if isinstance(found, str):
        return GroupCase(kernel, world, settings, rig, GroupPlant(lambda _listed: None, {}), found).with_objects(scene)
    return GroupCase(kernel, world, settings, rig, found, group_kernel.why_not_world(world))


def _loop_of(axis: AxisScene, bus: BusParameters) -> LoopSettings:
    """Return the loop settings of one motor, with the effects of its plant on torque and encoder."""
    parameters, of = axis.parameters, axis.simulation
    signals = Signals() if of is None else event_plant.signals_of(of.effects, bus.sample_time, of.seed)
    return LoopSettings(
        bus.delay, parameters.counts_per_unit or 0.0, (parameters.rated_torque or 0.0) * 1e-3,
        parameters.torque_limit or inf, signals=signals,
    )  # fmt: skip
