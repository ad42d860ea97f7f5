"""The loop of a network on several motors without a bus: what `closed_loop.run_loop` takes, made from a scene.

Linear motors move by one transition matrix; the other kinds replace `move_motors`:

* `EventMotors`: plants with events, current loops or forces over substeps. Separate axes have one `EventPlant` each, a
  stage is one plant of several motors. Every mode that a plant can enter is computed before the loop starts. If one
  plant needs booked work or substeps, all use them, because one loop moves them all.
* `FiveBarMotors`: a five-bar.
* `object_loop.Motors`: plants as objects, in Python only.

Where the shares are asked for, the loop also computes the network's request at the true positions, without sampling
errors (`explain`). It splits the held torques into the rendered shares of spring and damper.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import inf
from typing import Any, NamedTuple, cast

import numpy as np

from canhaptic.control.balance import EnergyBalance
from canhaptic.control.mechanisms.kinematics import Kinematics
from canhaptic.control.multi_axis import GROUP_ALGORITHMS, group_kernel
from canhaptic.control.multi_axis.group_controller import NetworkEnvironment
from canhaptic.control.multi_axis.group_kernel import GroupModel, MotionAhead, begin_motion, follow, write_efforts
from canhaptic.kernels import Buffer, Kernel, list_of_zeros, new
from canhaptic.kernels.records import record_of, records_of
from canhaptic.lab.batch import closed_loop
from canhaptic.lab.batch import plants as event_plant
from canhaptic.lab.batch.closed_loop import Control, CycleState, LinearMotors, LoopSettings, Room, Signals, step
from canhaptic.lab.batch.object_loop import OBJECTS, motors_of
from canhaptic.lab.batch.plants import EventMotors
from canhaptic.lab.figures.meter import Meter, MeterSettings, take_contact, take_last_part
from canhaptic.lab.loop.axis_loop import EVERYWHERE, Reach, mechanism_moved
from canhaptic.registry import load
from canhaptic.scene.buses import BusParameters
from canhaptic.scene.far_side import build_mechanism, build_plant
from canhaptic.scene.method import simulation_of
from canhaptic.scene.models import AxisScene, MechanismScene, Scene
from canhaptic.scene.parts import check_kinematics, loop_as_known
from canhaptic.sim.plant import AccuracyParameters
from canhaptic.sim.plant.assembly import PlantModel
from canhaptic.sim.plant.mechanism import five_bar_linkage as five_bar
from canhaptic.sim.plant.mechanism.five_bar_linkage import advance_five_bar, place_at
from canhaptic.sim.plant.mechanism.xy_stage import XYMotion
from canhaptic.sim.plant.plant import Plant
from canhaptic.sim.plant.propagator import TICKS, Array


@dataclass(slots=True)
class Explained:
    """Running sums of a loop, and those that give the shares of spring and damper in its torques."""

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
    sums: Explained


def respond_together(control: Control, room: Room, place: CycleState) -> EnergyBalance:
    """Replace `closed_loop.respond` for a kernel that steps several motors."""
    hold: group_kernel.GroupHold = step(control.world, control.run, 0, room.seen, room.held)
    torques = control.run.memory.group.commands.torques[hold.place]
    for i in range(len(room.commands)):
        room.commands[i] = torques[i]
    place.supplied += hold.account.supplied
    account: EnergyBalance = hold.account
    return account


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


def shares(meter: Explained) -> tuple[float, float]:
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


class LoopMotors(NamedTuple):
    """Motors in the form that a loop takes."""

    made: Callable[[bool], Any]  # (True for lists, which Python takes; False for arrays) -> motors at their start
    replaced: Mapping[object, object]  # function of the loop -> its replacement


def _motors_in_loop(scene: Scene, axes: Sequence[AxisScene]) -> LoopMotors | str:
    """Return the motors of a port in the form of its loop, or the reason why there is none; see `motors_of`."""
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


def _of_mechanism(moving: Any, order: Sequence[int], of: MechanismScene) -> LoopMotors | str:
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
) -> LoopMotors:
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

    return LoopMotors(made, event_plant.loop_replacements(scenes))


def _of_five_bar(motion: five_bar.FiveBarMotion, left: int, right: int) -> LoopMotors:
    def made(listed: bool) -> FiveBarMotors:
        form: Callable[[Any], Any] = list if listed else records_of
        return FiveBarMotors(form([motion.settings]), form([replace(motion.state)]), left, right)

    return LoopMotors(made, {closed_loop.move_motors: move_five_bar, closed_loop.position_of: five_bar_position_of})


def _side_by_side(plants: Sequence[Plant]) -> LoopMotors:
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


def _stage(stage: XYMotion, order: Sequence[int]) -> LoopMotors:
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


def _listed(flow: Array, state: Array, places: Sequence[int]) -> LoopMotors:
    state[-1] = 1.0
    motors = LinearMotors(flow.tolist(), state.tolist(), [0.0] * len(flow), list(places))
    return LoopMotors(lambda listed: motors._replace(state=list(motors.state)) if listed else record_of(motors)[0], {})


class NetworkLoop(NamedTuple):
    """The loop of a network on several motors, as kernels take it."""

    kernel: Kernel
    world: GroupModel
    settings: Any
    loops: list[LoopSettings]  # one for each motor
    motors: LoopMotors
    true: group_kernel.MotionSettings  # with which the network follows the true positions
    explains: bool  # whether the rendered shares of spring and damper are needed
    why_not: str = ""  # reason why its loop cannot be compiled; "" where it can

    @property
    def replaced(self) -> dict[object, object]:
        """Function of the loop -> its replacement."""
        unknown = closed_loop.miss_sync, take_contact, take_last_part
        found: dict[object, object] = dict.fromkeys(unknown, closed_loop.nothing)
        found |= {step: self.kernel.step, closed_loop.respond: respond_together, **self.motors.replaced}
        return found | {closed_loop.watch: explain} if self.explains else found

    def with_objects(self, scene: Scene) -> "NetworkLoop":
        """Return the same loop with its plants as objects, which apply all effects themselves."""
        axes = scene.ports[0].axes
        motors_of(scene, axes)  # refuses what cannot be built before a run would count it as diverged
        motors = LoopMotors(lambda _listed: motors_of(scene, axes), OBJECTS)
        return self._replace(motors=motors, loops=[replace(loop, signals=Signals()) for loop in self.loops])

    def true_memory(self) -> TrueMemory:
        """Return the buffers of the network at the true positions."""
        motors = len(self.loops)
        request = group_kernel.RequestedEfforts(*(list_of_zeros(motors) for _ in range(4)))
        motion = group_kernel.motion_memory(self.world, self.true)
        return TrueMemory(self.true, motion, request, list_of_zeros(motors), list_of_zeros(motors))


def network_loop(scene: Scene, *, explains: bool = False, reach: Reach = EVERYWHERE) -> NetworkLoop:
    """Return the loop of the only port of a scene, which renders a network.

    Args:
        scene: Scene with only this port.
        explains: Whether the rendered shares of spring and damper are needed.
        reach: Range of positions that do not count as divergence.

    Raises:
        InputError: The motors are not simulated, or their mechanism also moves other axes.
        ParameterError: The controller cannot be built.
    """
    [port] = scene.ports
    check_kinematics(port)
    axes, by = port.axes, port.passivity
    loops = tuple(loop_as_known(axis) for axis in axes)
    environment, kinematics = (cast(Any, part.parameters) for part in (port.rendered, port.kinematics))
    world = group_kernel.world_of(cast(NetworkEnvironment, environment), cast(Kinematics, kinematics), loops)
    kernel: Kernel = load(GROUP_ALGORITHMS, by.name, "group algorithm").kernel
    bare = tuple(loop.model_copy(update={"encoder_count": 0.0}) for loop in loops)
    nothing, found = LoopMotors(lambda _listed: None, {}), _motors_in_loop(scene, axes)
    loop = NetworkLoop(
        kernel, world, kernel.settings(world, by.parameters, loops),
        [loop_of_motor(axis, scene.bus, reach) for axis in axes], nothing,
        group_kernel.motion_settings(world, bare), explains,
    )  # fmt: skip
    if isinstance(found, str):
        return loop._replace(why_not=found).with_objects(scene)
    return loop._replace(motors=found, why_not=group_kernel.why_not_world(world))


def loop_of_motor(axis: AxisScene, bus: BusParameters, reach: Reach) -> LoopSettings:
    """Return the loop settings of one motor, with the effects of its plant on torque and encoder."""
    parameters, of = axis.parameters, axis.simulation
    signals = Signals() if of is None else event_plant.signals_of(of.effects, bus.sample_time, of.seed)
    return LoopSettings(
        bus.delay, parameters.counts_per_unit or 0.0, (parameters.rated_torque or 0.0) * 1e-3,
        parameters.torque_limit or inf, *reach,
        MeterSettings(damping_per_time=(axis.loop.device_damping or 0.0) / bus.sample_time), signals,
    )  # fmt: skip
