"""Run one axis, group or admittance display without a bus, in Python or compiled: figures, or a record of every SYNC.

It takes every plant, also those that do not fit a batch, and is the reference for batches. The figures have the same
names. For a group their meaning is: energies are sums over all its motors and a mover; torques are Euclidean norms,
`torque_peak` is the largest of any motor; travel, stiffness and comparisons with a continuous run are NaN, because a
group has no single position.

`continuous_reference` gives motion and force in the continuous environment, the reference for sampled algorithms. A
wall, damper or free space on a linear plant is solved in closed form between events (`continuous_run.follow_hold`); any
other environment or plant is integrated by DOP853 on the textbook plant (`canhaptic.lab.reference`).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from math import nan
from typing import Any, Final, NamedTuple, cast

import numpy as np

from canhaptic.audit.why.ripple import variation
from canhaptic.control.balance import EnergyBalance, GroupBalance
from canhaptic.control.environments import Environment, plain
from canhaptic.control.multi_axis.group_kernel import GroupMotion
from canhaptic.control.passivity import LoopProperties
from canhaptic.drive.profile.causality import IMPEDANCE
from canhaptic.drive.profile.motion_parameters import ForceChannel
from canhaptic.errors import CanHapticError, ControlError, InputError
from canhaptic.kernels import Run, with_quick_fields
from canhaptic.lab import reference
from canhaptic.lab.batch import ChosenEngine, closed_loop
from canhaptic.lab.batch.cases import (
    BatchCase,
    NotBatchableError,
    continuous_modes,
    loops_of,
    many_loops,
    why_not_compiled,
    why_not_continuous,
)
from canhaptic.lab.batch.closed_loop import CycleState, Loops, LoopSettings, Room, run_in_python
from canhaptic.lab.batch.continuous_run import ReferenceState, begin_reference, follow_hold
from canhaptic.lab.batch.group_loop import OBJECTS, GroupCase, GroupControl, GroupMeter, Motors, TrueNetwork, group_case
from canhaptic.lab.batch.marching import reference_memory_of
from canhaptic.lab.batch.plants import PlantValues, is_linear
from canhaptic.lab.figures import figures
from canhaptic.lab.figures.figures import CONTINUOUS, METRICS, last_rows, metrics_of, sums_of, sums_of_continuous
from canhaptic.lab.figures.meter import Meter, compare, diverge
from canhaptic.lab.judge.reference_model import Model
from canhaptic.lab.loop import axis_loop
from canhaptic.lab.loop.admittance_loop import AdmittanceRun
from canhaptic.lab.loop.axis_loop import EVERYWHERE, Array, LoopCase, LoopRun, Reach, Recorder, finished
from canhaptic.lab.reference import ContinuousReference
from canhaptic.scene.components import ComponentSpec
from canhaptic.scene.far_side import build_plant
from canhaptic.scene.method import simulation_of
from canhaptic.scene.models import AxisScene, AxisSimulation, Scene
from canhaptic.scene.parts import controller_of
from canhaptic.sim.drive import SimulatedDriveParameters
from canhaptic.sim.plant.effects import Effect
from canhaptic.sim.plant.plant import PlantParameters
from canhaptic.sim.plant.user import UserParameters
from canhaptic.sim.plant.velocity_drive import VelocityDrivenPlant


def respond_as_object(control: closed_loop.AxisControl, room: Room, place: CycleState) -> EnergyBalance:
    """Replace `respond`: the memory is a controller object."""
    balance: EnergyBalance = control.run.memory.step(room.seen[0], room.held[0])
    room.commands[0] = balance.torque
    return balance


def compare_with_known(known: Sequence[Sequence[float]], room: Room, meter: Meter, cycle: int) -> None:
    """Replace `watch`: compare with the positions and mean torques of a finished continuous run."""
    positions, torques = known
    compare(meter, room.true[0], room.held[0], positions[cycle], torques[cycle])


def record(
    control: object, loops: Loops, room: Room, place: CycleState, recorder: Recorder, balance: EnergyBalance
) -> None:
    """Replace `take_sync`: record a SYNC."""
    recorder.take(place.supplied - place.work, room.seen, room.true, room.held, balance)


_RECORDED: Final[Mapping[object, object]] = {closed_loop.take_sync: record, diverge: closed_loop.nothing}
"""Replacements of functions of the loop that record rows, which end where the run diverges."""


def _run(case: LoopCase, cycles: int, loop: LoopSettings, meter: Any, continuous: ContinuousReference | None) -> str:
    """Run a loop with plant and controller as objects; return "", or why the controller stopped it."""
    replaced: dict[object, object] = {closed_loop.respond: respond_as_object, **OBJECTS}
    if isinstance(meter, Recorder):
        replaced.update(_RECORDED)
    known = None
    if continuous is not None:
        known = continuous.position.tolist(), continuous.torque.tolist()
        replaced[closed_loop.watch] = compare_with_known
    control = closed_loop.AxisControl(plain(case.environment), Run(None, None, case.controller()))
    motors = Motors([case.make_plant()], case.sample_time_ns)
    try:
        run_in_python(replaced, control, [loop], motors, known, meter, cycles)
    except ControlError as error:
        return str(error)
    return ""


def render(
    case: LoopCase, cycles: int, reach: Reach = EVERYWHERE, progress: Callable[[], None] | None = None
) -> LoopRun:
    """Run a case from the plant's initial state; a run that diverges or fails ends early, and its `ended` says so.

    Args:
        case: Case to run.
        cycles: Number of SYNCs.
        reach: Range of positions that do not count as divergence.
        progress: Called once per cycle; must be cheap.

    Raises:
        EventLimitError: The plant had more events in one sample time than allowed.
        ParameterError: The algorithm needs a property of the loop that the case does not give.
    """
    recorder, loop = Recorder(tick=progress), replace(loop_settings(case, cycles), lowest=reach[0], highest=reach[1])
    reason = _run(case, cycles, loop, recorder, None)
    return finished(recorder.run("stopped" if reason else "", reason), cycles, reach)


def render_by(
    engine: ChosenEngine, case: LoopCase, cycles: int, reach: Reach = EVERYWHERE,
    progress: Callable[[], None] | None = None,
) -> LoopRun:  # fmt: skip
    """Run a case as `render` does; `LoopRun.engine` names the engine, and why it is not the requested one.

    Args:
        engine: "python" gives the same bits as a run over CAN; "numba" differs by rounding, and falls back to Python
            for a case that cannot be compiled.
        case: Case to run.
        cycles: Number of SYNCs.
        reach: Range of positions that do not count as divergence.
        progress: Called once per cycle.

    Raises:
        EventLimitError: The plant had more events in one sample time than allowed.
        ParameterError: The algorithm needs a property of the loop that the case does not give.
    """
    if engine == "python":
        return render(case, cycles, reach, progress)
    reason = why_not_compiled(case)
    if not reason:
        from canhaptic.lab.batch.compiled_loops import compiled_rows

        case.controller()  # refuses what cannot be built
        try:
            run = LoopRun(compiled_rows(case, cycles, reach), engine="numba")
        except NotBatchableError as error:
            reason = str(error)
        else:
            for _ in run.rows:
                if progress is not None:
                    progress()
            return finished(run, cycles, reach)
    return replace(render(case, cycles, reach, progress), engine=f"python: {reason}")


def work_of(case: LoopCase, cycles: int) -> float:
    """Return the cost of a run, in cycles of a plant without substeps."""
    if case.simulation is None:
        return 0.0
    accuracy, plant = case.simulation.accuracy, PlantValues(case.simulation, case.sample_time_ns).scene()
    return cycles * 4.0 * (accuracy.substeps if accuracy else 1) if plant.efforts else cycles  # a secant a substep


def render_group(
    engine: ChosenEngine, scene: Scene, cycles: int, furthest: float = axis_loop.FURTHEST,
    progress: Callable[[], None] | None = None,
) -> LoopRun:  # fmt: skip
    """Run the group of a scene; see `render_by`. Python moves the plants as objects.

    Args:
        engine: As for `render_by`.
        scene: Scene with only this group.
        cycles: Number of SYNCs.
        furthest: Distance from the origin that counts as divergence [m or rad].
        progress: Called once per cycle.

    Raises:
        InputError: The motors are not simulated, or their mechanism also moves other axes.
        ParameterError: The group cannot be built.
    """
    case, reach = group_case(scene), Reach(-furthest, furthest)
    case = case._replace(loops=[replace(loop, lowest=-furthest, highest=furthest) for loop in case.loops])
    recorder, reason = Recorder(len(case.loops), progress), ""
    if engine == "numba" and not case.why_not:
        from canhaptic.lab.batch.compiled_loops import compiled_group_rows

        return finished(LoopRun(compiled_group_rows(case, cycles), len(case.loops), engine="numba"), cycles, reach)
    try:
        _run_group(case.with_objects(scene), cycles, GroupMeter(), recorder, _RECORDED)
    except ControlError as error:
        reason = str(error)
    run = recorder.run("stopped" if reason else "", reason)
    return replace(finished(run, cycles, reach), engine=f"python: {case.why_not}" if engine == "numba" else "python")


def group_meter(case: GroupCase, cycles: int, engine: ChosenEngine = "python") -> GroupMeter:
    """Run the loop of a group; return its sums at the end, or when it diverged.

    Args:
        case: Case of the group.
        cycles: Number of SYNCs.
        engine: "numba" falls back to Python for a case that cannot be compiled.
    """
    if engine == "numba" and not case.why_not:
        from canhaptic.lab.batch.compiled_loops import compiled_group_meter

        return compiled_group_meter(case, cycles)
    meter = GroupMeter()
    try:
        is_stuck = _run_group(case, cycles, meter, meter.figures, {})
    except CanHapticError:  # of a mechanism that is pushed where it cannot move
        is_stuck = True
    if is_stuck:
        diverge(meter.figures)
    return meter


def _run_group(case: GroupCase, cycles: int, sums: GroupMeter, meter: Any, replaced: Mapping[object, object]) -> bool:
    """Run a group in Python; return whether its motors could not be moved any further."""
    world, settings = (with_quick_fields(part) for part in (case.world, case.settings))
    memory = with_quick_fields(case.kernel.memory(case.world, case.settings))
    control = GroupControl(world, settings, case.kernel.state(), memory)
    watched = None
    if case.explains:
        watched = with_quick_fields(TrueNetwork(world, GroupMotion(), case.true_memory(), sums))
    replaced = {**case.replaced, **replaced}
    return run_in_python(replaced, control, case.loops, case.motors.made(True), watched, meter, cycles) > 0


def group_figures(meter: GroupMeter, metrics: Sequence[str] | None = None) -> dict[str, float]:
    """Return the figures of a group from its sums; NaN for figures that need a single position."""
    names, sums = list(METRICS if metrics is None else metrics), meter.figures
    of_a_position = "travel", "stiffness_rendered.value", "stiffness_rendered.share", *CONTINUOUS
    own = [name for name in names if name not in of_a_position]
    found = metrics_of(own, {name: np.array([getattr(sums, name)]) for name in sums_of(own)})
    return {name: float(found[name][0]) if name in found else nan for name in names}


class Figured(NamedTuple):
    """Figures of a scene by the names of `ALL`, or of `DISPLAY_METRICS`."""

    figures: dict[str, float]
    is_compiled: bool = False
    why_not: str = ""  # why the loop of several motors was not compiled


def run_scalar(scene: Scene, cycles: int, metrics: Sequence[str] | None = None) -> dict[str, float]:
    """Return the figures of `run_port` in Python."""
    return run_port(scene, cycles, metrics).figures


def run_port(
    scene: Scene, cycles: int, metrics: Sequence[str] | None = None, engine: ChosenEngine = "python"
) -> Figured:
    """Run the first port of a scene.

    Args:
        scene: Scene with one group of axes, or with a simulated first axis, which is run.
        cycles: Number of SYNCs.
        metrics: Names of figures; NaN for those that this kind of axis does not have; None for those that need no
            continuous run.
        engine: Engine of the loop of several motors.

    Raises:
        InputError: An axis is not simulated, or a metric needs a continuous run and there is none.
        ParameterError: The controller cannot be built.
    """
    port = scene.ports[0]
    if port.causality is not IMPEDANCE:
        found = figures.figures_of(run_display(scene, cycles), scene)
        return Figured({name: found.get(name, nan) for name in metrics or figures.DISPLAY_METRICS})
    if port.section:
        several = group_case(scene)
        meter, is_compiled = group_meter(several, cycles, engine), engine == "numba" and not several.why_not
        return Figured(group_figures(meter, metrics), is_compiled, several.why_not)
    [axis] = port.axes
    case, names, continuous = axis_loop.loop_case(axis, scene), list(METRICS if metrics is None else metrics), None
    if any(name in CONTINUOUS for name in names):
        parts = axis_loop.plant_parts(axis)[:3]
        continuous = continuous_reference(case.environment, *parts, scene.bus.sample_time_ns, cycles)
    return Figured(run_case(case, cycles, names, continuous))


def run_case(
    case: LoopCase, cycles: int, metrics: Sequence[str] | None = None, continuous: ContinuousReference | None = None
) -> dict[str, float]:
    """Run one loop; return its figures by the names of `ALL`; see `run_scalar`."""
    meter, names = Meter(), list(METRICS if metrics is None else metrics)
    if _run(case, cycles, loop_settings(case, cycles), meter, continuous):
        diverge(meter)
    found = asdict(meter)
    if continuous is not None:
        found |= sums_of_continuous(continuous, len(continuous.position), case.sample_time_ns * 1e-9)
    sums = {name: np.array([found[name]]) for name in sums_of(names)}
    return {name: float(values[0]) for name, values in metrics_of(names, sums).items()}


class _Display:
    """One simulated admittance display with its encoder and force sensor: a plant of `Motors`."""

    def __init__(self, axis: AxisScene, scene: Scene) -> None:
        given, display, simulation = axis.parameters, axis.parameters.admittance, simulation_of(axis)
        if display is None:
            raise InputError(f"{given.name}: is not an admittance display, expected one")
        self._name, self._counts = given.name, given.counts_per_unit
        self.plant = plant = cast(VelocityDrivenPlant, build_plant(simulation, scene.bus.sample_time_ns))
        self.begin, self.advance_to, self.energy = plant.begin, plant.advance_to, plant.energy
        self._channel = ForceChannel(display.force, scene.bus.sample_time)
        own = simulation.drive.display
        self._per_count = own.force_per_count if own else display.force.per_count
        self._offset = own.force_offset_counts if own else display.force.offset_counts
        self._fastest = 2.0 * given.largest_speed * scene.bus.sample_time  # [m or rad] in a hold, as in the link policy

    @property
    def position(self) -> float:
        """True position [m or rad]."""
        return self.plant.position

    @property
    def encoder_position(self) -> float:
        """Encoder reading [m or rad]."""
        return round(self.plant.encoder_position * self._counts) / self._counts

    def force(self) -> float:
        """Sensor reading [N or N*m]."""
        return self._channel.take(round(self.plant.read_force() / self._per_count + self._offset))

    def why_stopped(self, moved: float) -> str:
        """Return why the rig stops after a hold with the measured displacement `moved` [m or rad]; "": it does not."""
        if self._channel.is_wrong:
            return f"{self._name}: the force sensor is beyond its range, or frozen"
        return f"{self._name}: the position moved faster than the speed limit" if abs(moved) > self._fastest else ""


class _DisplayControl:
    """Controller of displays, with what it measured at the last SYNC."""

    def __init__(self, scene: Scene) -> None:
        [port] = scene.ports
        self.displays, self.is_group = [_Display(axis, scene) for axis in port.axes], bool(scene.groups)
        self.controller: Any = controller_of(scene, port)
        self.seen, self.motion = [nan] * len(self.displays), list[list[float]]()
        self.reason = ""  # why the rig stops


def respond_as_display(control: _DisplayControl, room: Room, place: CycleState) -> EnergyBalance:
    """Replace `respond`: read the force sensors too; the commands are velocities [m/s or rad/s]."""
    forces, before = [-display.force() for display in control.displays], control.seen
    control.seen = list(room.seen)
    for display, now, last in zip(control.displays, control.seen, before, strict=True):
        control.reason = display.why_stopped(now - last) or control.reason
    if not control.is_group:
        account: EnergyBalance = control.controller.step(control.seen[0], forces[0])
        room.commands[0] = account.torque
        return account
    balance: GroupBalance = control.controller.step(control.seen, forces)
    room.commands[:] = balance.torques
    return balance.account


def record_display(
    control: _DisplayControl, loops: Loops, room: Room, place: CycleState, recorder: Recorder, balance: EnergyBalance
) -> None:
    """Replace `take_sync`: record a SYNC.

    Raises:
        ControlError: The rig stops here.
    """
    record(control, loops, room, place, recorder, balance)
    plants = [display.plant for display in control.displays]
    control.motion.append([value for plant in plants for value in (plant.position, plant.velocity, plant.force)])
    if control.reason:
        raise ControlError(control.reason)


def run_display(scene: Scene, cycles: int) -> AdmittanceRun:
    """Run one axis or one group of admittance displays; an error that would stop the rig ends the run.

    Encoder and force are read in whole counts, commands are whole quanta, and the delay is that of the scene's bus.

    Args:
        scene: Simulated scene with only that axis or group.
        cycles: Number of SYNCs.

    Raises:
        InputError: An axis is not simulated, or is not an admittance display.
        ParameterError: The controller cannot be built.
    """
    control, recorder, reason = _DisplayControl(scene), Recorder(len(scene.axes)), ""
    motors = Motors(control.displays, scene.bus.sample_time_ns)
    loops = [LoopSettings(scene.bus.delay, lowest=EVERYWHERE.lowest, highest=EVERYWHERE.highest)] * len(scene.axes)
    shown: dict[object, object] = {closed_loop.respond: respond_as_display, closed_loop.take_sync: record_display}
    try:
        run_in_python({**OBJECTS, **_RECORDED, **shown}, control, loops, motors, None, recorder, cycles)
    except CanHapticError as error:
        reason = str(error).splitlines()[0]
    run = finished(recorder.run("stopped" if reason else "", reason), cycles, EVERYWHERE)
    moved = np.array(control.motion).reshape(-1, len(scene.axes), 3)
    return AdmittanceRun(
        run.rows, run.axes, run.ended, run.reason, run.engine, moved, control.controller.energy_resolution
    )


def loop_settings(case: LoopCase, cycles: int) -> LoopSettings:
    """Return the loop settings of a case for a run of the given number of cycles."""
    last_from = float(last_rows(cycles, case.sample_time_ns * 1e-9).start)
    (found,) = loops_of(BatchCase(case, {"last_from": last_from}, None), 1)
    return found


def continuous_reference(
    environment: Environment,
    plant: PlantParameters,
    user: UserParameters | None,
    effects: Sequence[Effect],
    sample_time_ns: int,
    cycles: int,
) -> ContinuousReference:
    """Return the motion and force that the user would feel from the continuous environment.

    Args:
        environment: Environment to render without sampling.
        plant: Moving mass.
        user: The hand.
        effects: Effects of the plant; effects on encoder and command are left out.
        sample_time_ns: T [ns], the grid of the result.
        cycles: Number of SYNCs.

    Raises:
        InputError: There are no equations for the environment or an effect, or a solver is needed and scipy is missing.
    """
    reference.surfaces(environment)
    readings = reference.readings_per_hold(sample_time_ns, cycles)
    step = sample_time_ns * 1e-9 / readings
    times = np.arange((cycles - 1) * readings + 1, dtype=np.float64) * step
    specs = tuple(ComponentSpec(effect.type, effect) for effect in effects)  # type: ignore[arg-type]
    simulation = AxisSimulation(SimulatedDriveParameters(counts_per_unit=1.0), plant, user, specs, 0)
    found, method = _in_closed_form(environment, simulation, step, len(times)), "closed form between events"
    if found is None:
        run = reference.continuous_run(environment, Model(plant, user, effects), times.tolist(), 1e-10)
        found, method = (run.position, run.velocity), "DOP853 with event location, relative tolerance 1e-10"
    position, velocity = found
    torque = reference.environment_torque(environment, position, velocity, step)
    ends = 0.5 * (torque[1:] + torque[:-1])
    mean = np.concatenate([[0.0], ends.reshape(-1, readings).mean(axis=1)]) if cycles > 1 else torque[:1]
    way = variation(torque, 0.0)
    return ContinuousReference(position[::readings], mean, way, times, torque, method)


def _in_closed_form(
    environment: Environment, simulation: AxisSimulation, step: float, count: int
) -> tuple[Array, Array] | None:
    """Return positions and velocities at every `step` [s]; None where the motion has no closed form."""
    if (simulation.user is not None and not simulation.user.has_equations) or not is_linear(simulation):
        return None
    step_ns = round(step * 1e9)
    case = many_loops(
        LoopCase(
            environment, "unprotected", None, LoopProperties(sample_time=step),
            lambda: build_plant(simulation, step_ns), step_ns, 0, simulation=simulation,
        ), {}, {},
    )  # fmt: skip
    if why_not_continuous(case):
        return None
    modes = continuous_modes(case, 1, count, with_force=False, with_travel=False)
    settings, state, memory = modes.settings[0], ReferenceState(), reference_memory_of(modes, 0)
    if not settings.exists:
        return None
    motion = np.empty((count, 2))
    begin_reference(settings, state, memory)
    for k in range(count):
        if k:
            follow_hold(settings, state, memory)
        motion[k] = memory.state[0], memory.state[1]
    return motion[:, 0], motion[:, 1]
