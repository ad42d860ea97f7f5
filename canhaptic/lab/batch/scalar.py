"""Run the loop of one port without a bus, in Python or compiled: figures, or a record of every SYNC.

It takes every plant, also those that do not fit a batch, and is the reference for batches. The figures have the same
names. For several motors their meaning is: energies are sums over all motors and a mover; torques are Euclidean norms,
`torque_peak` is the largest of any motor; travel, stiffness and comparisons with a continuous run are NaN, because
there is no single position.

`continuous_reference` gives motion and force in the continuous environment, the reference for sampled algorithms. A
wall, damper or free space on a linear plant is solved in closed form between events (`continuous_run.follow_hold`); any
other environment or plant is integrated by DOP853 on the textbook plant (`canhaptic.lab.reference`).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from math import nan
from typing import Final, NamedTuple

import numpy as np

from canhaptic.audit.why.ripple import variation
from canhaptic.control.balance import EnergyBalance
from canhaptic.control.environments import Environment, plain
from canhaptic.control.multi_axis.group_kernel import GroupMotion
from canhaptic.control.passivity import LoopProperties
from canhaptic.drive.profile.causality import IMPEDANCE
from canhaptic.errors import CanHapticError
from canhaptic.kernels import Run, with_quick_fields
from canhaptic.lab import reference
from canhaptic.lab.batch import ChosenEngine, cases, closed_loop
from canhaptic.lab.batch.cases import NotBatchableError
from canhaptic.lab.batch.closed_loop import Control, CycleState, Loops, LoopSettings, Room, Signals, run_in_python
from canhaptic.lab.batch.continuous_run import ReferenceState, begin_reference, follow_hold
from canhaptic.lab.batch.marching import reference_memory_of
from canhaptic.lab.batch.network_loop import Explained, NetworkLoop, TrueNetwork, loop_of_motor, network_loop
from canhaptic.lab.batch.object_loop import (
    OBJECTS,
    Motors,
    ObjectControl,
    SensedMotors,
    motors_of,
    respond_as_object,
)
from canhaptic.lab.batch.plants import PlantValues, is_linear
from canhaptic.lab.figures import figures
from canhaptic.lab.figures.figures import CONTINUOUS, METRICS, last_rows, metrics_of, sums_of, sums_of_continuous
from canhaptic.lab.figures.meter import Meter, compare, diverge
from canhaptic.lab.loop import axis_loop
from canhaptic.lab.loop.axis_loop import EVERYWHERE, Array, LoopCase, LoopRun, Reach, Recorder, finished
from canhaptic.lab.reference import ContinuousReference
from canhaptic.scene.far_side import build_plant
from canhaptic.scene.method import simulation_of
from canhaptic.scene.models import AxisSimulation, Scene
from canhaptic.scene.parts import controller_of


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


def _compiled(case: LoopCase | Scene, cycles: int, reach: Reach) -> Array:
    """Return the rows of the compiled loop of a case, or of the only port of a scene.

    Raises:
        NotBatchableError: The loop cannot be compiled.
    """
    if isinstance(case, LoopCase):
        if reason := cases.why_not_compiled(case):
            raise NotBatchableError(reason)
        from canhaptic.lab.batch.compiled_loops import compiled_rows

        case.controller()  # refuses what cannot be built
        return compiled_rows(case, cycles, reach)
    if case.ports[0].causality is not IMPEDANCE:
        raise NotBatchableError("drives that take velocities are moved in Python")
    network = network_loop(case, reach=reach)
    if network.why_not:
        raise NotBatchableError(network.why_not)
    from canhaptic.lab.batch.compiled_loops import rows_together

    return rows_together(network, cycles)


def _as_objects(case: LoopCase | Scene, cycles: int, reach: Reach = EVERYWHERE) -> ObjectControl:
    """Return a case, or the only port of a scene, with controller and plants as objects."""
    if isinstance(case, LoopCase):
        motors = Motors([case.make_plant()], case.sample_time_ns)
        loop = replace(loop_settings(case, cycles), lowest=reach.lowest, highest=reach.highest)
        return ObjectControl(plain(case.environment), case.controller(), motors, [loop])
    [port], time = case.ports, case.bus.sample_time_ns
    controller, is_together = controller_of(case, port), bool(port.section)
    if port.causality is not IMPEDANCE:
        loops = [LoopSettings(case.bus.delay, lowest=reach.lowest, highest=reach.highest)] * len(port.axes)
        return ObjectControl(None, controller, SensedMotors(port.axes, time), loops, is_together)
    loops = [replace(loop_of_motor(axis, case.bus, reach), signals=Signals()) for axis in port.axes]
    return ObjectControl(None, controller, motors_of(case, port.axes), loops, is_together)


def _run(
    control: ObjectControl, cycles: int, meter: object, replaced: Mapping[object, object], watched: object = None
) -> str:
    """Run controller and plants as objects; return "", or why controller or rig stopped the run."""
    replaced = {closed_loop.respond: respond_as_object, **OBJECTS, **replaced}
    try:
        run_in_python(replaced, control, control.loops, control.motors, watched, meter, cycles)
    except control.motors.ending as error:
        return str(error).splitlines()[0]
    return control.motors.reason


def render(
    case: LoopCase | Scene, cycles: int, reach: Reach = EVERYWHERE, progress: Callable[[], None] | None = None,
    engine: ChosenEngine = "python",
) -> LoopRun:  # fmt: skip
    """Run a loop from its initial state; a run that diverges or fails ends early, and its `ended` says so.

    Args:
        case: Case of one torque axis, or simulated scene with only one port.
        cycles: Number of SYNCs.
        reach: Range of positions that do not count as divergence.
        progress: Called once per cycle; must be cheap.
        engine: "python" gives the same bits as a run over CAN; "numba" differs by rounding, and falls back to Python
            for a loop that cannot be compiled: `LoopRun.engine` says why.

    Raises:
        EventLimitError: The plant had more events in one sample time than allowed.
        InputError: The motors are not simulated, or their mechanism also moves other axes.
        ParameterError: The controller cannot be built.
    """
    if isinstance(case, Scene) and not case.ports[0].section and case.ports[0].causality is IMPEDANCE:
        case = axis_loop.loop_case(case.axes[0], case)
    axes, why_not = None if isinstance(case, LoopCase) else len(case.axes), ""
    if engine == "numba":
        try:
            run = LoopRun(_compiled(case, cycles, reach), axes, engine="numba")
        except NotBatchableError as error:
            why_not = str(error)
        else:
            for _ in run.rows:
                if progress is not None:
                    progress()
            return finished(run, cycles, reach)
    recorder, control = Recorder(axes, progress), _as_objects(case, cycles, reach)
    reason = _run(control, cycles, recorder, _RECORDED)
    run = finished(recorder.run("stopped" if reason else "", reason), cycles, reach)
    motion = np.array(control.motors.motion).reshape(-1, len(control.loops), 3)[: len(run.rows)]
    resolution = getattr(control.controller, "energy_resolution", 0.0)
    return replace(run, engine=f"python: {why_not}" if why_not else "python", motion=motion, resolution=resolution)


def work_of(case: LoopCase, cycles: int) -> float:
    """Return the cost of a run, in cycles of a plant without substeps."""
    if case.simulation is None:
        return 0.0
    accuracy, plant = case.simulation.accuracy, PlantValues(case.simulation, case.sample_time_ns).scene()
    return cycles * 4.0 * (accuracy.substeps if accuracy else 1) if plant.efforts else cycles  # a secant a substep


def run_network(loop: NetworkLoop, cycles: int, engine: ChosenEngine = "python") -> Explained:
    """Run the loop of a network; return its sums at the end, or when it diverged.

    Args:
        loop: Loop of the network.
        cycles: Number of SYNCs.
        engine: "numba" falls back to Python for a loop that cannot be compiled.
    """
    if engine == "numba" and not loop.why_not:
        from canhaptic.lab.batch.compiled_loops import sums_together

        return sums_together(loop, cycles)
    world, settings = (with_quick_fields(part) for part in (loop.world, loop.settings))
    memory, sums, watched = with_quick_fields(loop.kernel.memory(loop.world, loop.settings)), Explained(), None
    if loop.explains:
        watched = with_quick_fields(TrueNetwork(world, GroupMotion(), loop.true_memory(), sums))
    control = Control(world, Run(settings, loop.kernel.state(), memory))
    try:
        is_stuck = run_in_python(
            loop.replaced, control, loop.loops, loop.motors.made(True), watched, sums.figures, cycles
        ) > 0  # fmt: skip
    except CanHapticError:  # of a mechanism that is pushed where it cannot move
        is_stuck = True
    if is_stuck:
        diverge(sums.figures)
    return sums


_OF_A_POSITION: Final = ("travel", "stiffness_rendered.value", "stiffness_rendered.share", *CONTINUOUS)
"""Figures that several motors together do not have."""


def _figures(sums: Mapping[str, float], names: Sequence[str], absent: Sequence[str] = ()) -> dict[str, float]:
    """Return figures from the sums of a run; NaN for those that are absent."""
    own = [name for name in names if name not in absent]
    found = metrics_of(own, {name: np.array([sums[name]]) for name in sums_of(own)})
    return {name: float(found[name][0]) if name in found else nan for name in names}


class Figured(NamedTuple):
    """Figures of a scene by the names of `ALL`, or of `DISPLAY_METRICS`."""

    figures: dict[str, float]
    is_compiled: bool = False
    why_not: str = ""  # why the loop was not compiled, where its kernel steps several motors


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
    port, names, continuous = scene.ports[0], list(METRICS if metrics is None else metrics), None
    if port.causality is not IMPEDANCE:
        found = figures.figures_of(render(scene, cycles), scene)
        return Figured({name: found.get(name, nan) for name in metrics or figures.DISPLAY_METRICS})
    if port.section:
        loop = network_loop(scene)
        sums, is_compiled = asdict(run_network(loop, cycles, engine).figures), engine == "numba" and not loop.why_not
        return Figured(_figures(sums, names, _OF_A_POSITION), is_compiled, loop.why_not)
    [axis] = port.axes
    case = axis_loop.loop_case(axis, scene)
    if any(name in CONTINUOUS for name in names):
        continuous = continuous_reference(case.environment, simulation_of(axis), case.sample_time_ns, cycles)
    return Figured(run_case(case, cycles, names, continuous))


def run_case(
    case: LoopCase, cycles: int, metrics: Sequence[str] | None = None, continuous: ContinuousReference | None = None
) -> dict[str, float]:
    """Run one loop; return its figures by the names of `ALL`; see `run_scalar`."""
    meter, known, replaced = Meter(), None, dict[object, object]()
    if continuous is not None:
        known = continuous.position.tolist(), continuous.torque.tolist()
        replaced[closed_loop.watch] = compare_with_known
    if _run(_as_objects(case, cycles), cycles, meter, replaced, known):
        diverge(meter)
    sums = asdict(meter)
    if continuous is not None:
        sums |= sums_of_continuous(continuous, len(continuous.position), case.sample_time_ns * 1e-9)
    return _figures(sums, list(METRICS if metrics is None else metrics))


def loop_settings(case: LoopCase, cycles: int) -> LoopSettings:
    """Return the loop settings of a case for a run of the given number of cycles."""
    last_from = float(last_rows(cycles, case.sample_time_ns * 1e-9).start)
    (found,) = cases.loops_of(cases.BatchCase(case, {"last_from": last_from}, None), 1)
    return found


def continuous_reference(
    environment: Environment, simulation: AxisSimulation, sample_time_ns: int, cycles: int
) -> ContinuousReference:
    """Return the motion and force that the user would feel from the continuous environment.

    Args:
        environment: Environment to render without sampling.
        simulation: Plant and hand; effects on encoder and command are left out.
        sample_time_ns: T [ns], the grid of the result.
        cycles: Number of SYNCs.

    Raises:
        InputError: There are no equations for the environment or an effect, or a solver is needed and scipy is missing.
    """
    reference.surfaces(environment)
    readings = reference.readings_per_hold(sample_time_ns, cycles)
    step = sample_time_ns * 1e-9 / readings
    times = np.arange((cycles - 1) * readings + 1, dtype=np.float64) * step
    found, method = _in_closed_form(environment, simulation, step, len(times)), "closed form between events"
    if found is None:
        run = reference.continuous_run(environment, reference.textbook_model(simulation), times.tolist(), 1e-10)
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
    case = cases.many_loops(
        LoopCase(
            environment, "unprotected", None, LoopProperties(sample_time=step),
            lambda: build_plant(simulation, step_ns), step_ns, 0, simulation=simulation,
        ), {}, {},
    )  # fmt: skip
    if cases.why_not_continuous(case):
        return None
    modes = cases.continuous_modes(case, 1, count, with_force=False, with_travel=False)
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
