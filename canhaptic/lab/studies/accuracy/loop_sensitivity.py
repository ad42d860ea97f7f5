"""Sensitivity of a loop to its sample rate, delay, algorithm, velocity filter, resolution or encoder, one at a time.

Every variant of an axis or a group is rendered without a bus and compared with the continuous environment on a time
grid common to all rates; the bus load is computed.

A variant of an admittance display, or group of displays, is compared with an ideal display. This one renders the same
environment without protection at a 32nd of the sample time (20 kHz at most). Its drive is a thousand times as stiff,
its encoder a thousand times as fine, and its sensor shows the mean of each hold without error. Its distance from an
ideal display with twice its sample time estimates its own error. The simulated plant of a display is compared with its
textbook equations, under the commands of the scene's own controller.
"""

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, cast

import numpy as np

from canhaptic.axis_units import effort_unit
from canhaptic.control.passivity import LITERATURE
from canhaptic.drive.axis_parameters import CanBusParameters
from canhaptic.drive.can.bus_budget import bus_budget
from canhaptic.drive.can.pdo_map import choose_map
from canhaptic.drive.clock import ProcessorClock
from canhaptic.drive.profile.admittance_parameters import AdmittanceParameters
from canhaptic.errors import CanHapticError, InputError, ParameterError
from canhaptic.lab.batch import WORTH_COMPILING, WORTH_COMPILING_GROUPS, ChosenEngine, Engine, chosen_engine
from canhaptic.lab.batch.scalar import render_by, render_group, run_display, work_of
from canhaptic.lab.figures.figures import figures_of
from canhaptic.lab.judge.reference_group import DisplayModel
from canhaptic.lab.judge.reference_model import MotionError
from canhaptic.lab.judge.solvers import located
from canhaptic.lab.loop import axis_loop
from canhaptic.lab.loop.admittance_loop import AdmittanceRun
from canhaptic.lab.loop.axis_loop import at_rate, parts_of
from canhaptic.lab.reference import ContinuousRun
from canhaptic.lab.studies import Row
from canhaptic.scene.buses import can_bus, kind_of
from canhaptic.scene.load import with_loops
from canhaptic.scene.method import simulation_of
from canhaptic.scene.models import AxisScene, AxisSimulation, Scene
from canhaptic.scene.parts import controller_of
from canhaptic.sim.plant import AccuracyParameters
from canhaptic.sim.plant.direct_rig import Motion
from canhaptic.sim.plant.propagator import Array
from canhaptic.sim.plant.velocity_drive import AdmittanceSimulation, SimulatedForceSensor

Stop = Callable[[], bool]
HOLDS: Final = 1000
"""Number of holds of a comparison; a shorter scene is compared over its whole length."""


def holds_of(scene: Scene, duration: float | None = None) -> int:
    """Return the number of holds over which a scene is compared."""
    whole = duration or scene.run.duration
    holds = HOLDS if whole is None else round(whole / scene.bus.sample_time)
    return max(2, holds if duration is not None else min(HOLDS, holds))


FINEST: Final = 4
"""Ratio of the highest rate to the scene's; the reference is read at that rate."""
RATES: Final = (0.25, 0.5, 2.0, float(FINEST))
"""Sample rates of the variants, as multiples of the scene's."""
_RANGE: Final = (1.0, 20_000.0)
"""Lowest and highest rate of a scene [Hz]."""
_SUBSTEPS: Final = 32
"""Substeps of the plant in one sample time of the scene: the finest setting, whose error limits the comparison."""
_GROUP_SUBSTEPS: Final = 8
"""Substeps of the plants of a group; with order 2, the error of a mechanism is then far below that of its loop."""
_TRAVELS: Final = 10.0
"""Distance from the origin that counts as divergence of a group, as a multiple of the continuous run's."""
_ENCODER_EFFECTS: Final = ("encoder_noise", "encoder_quantisation")


@dataclass(frozen=True, slots=True)
class Variant:
    """The loop of one axis or group, with one change.

    Attributes:
        group: Kind of change.
        setting: Value of the change.
        scene: Changed scene, with the axis or group alone.
        is_scene: Whether nothing is changed.
        remark: Values that the algorithm took from the plant.
        fineness: Resolution as a multiple of the scene's, infinite for an ideal one; None for other changes.
    """

    group: str
    setting: str
    scene: Scene
    is_scene: bool = False
    remark: str = ""
    fineness: float | None = None

    @property
    def sample_time_ns(self) -> int:
        """T [ns]."""
        return self.scene.bus.sample_time_ns

    @property
    def case(self) -> axis_loop.LoopCase:
        """The axis with algorithm and plant, as a loop without a bus."""
        (axis,) = self.scene.axes
        return replace(
            axis_loop.loop_case(axis, self.scene), counts_per_unit=abs(axis.parameters.counts_per_unit) or None
        )

    def controller(self) -> Any:
        """Return the algorithm, at rest."""
        return controller_of(self.scene, self.scene.ports[0])

    def render(self, cycles: int, motion: Array, tick: Callable[[], None], engine: ChosenEngine) -> axis_loop.LoopRun:
        """Run the loop and return its record.

        Args:
            cycles: Number of SYNCs.
            motion: Motion of the continuous run, which defines divergence [m or rad].
            tick: Called at every SYNC; may raise to abort.
            engine: Engine of the loop.
        """
        if not self.scene.groups:
            return render_by(engine, self.case, cycles, axis_loop.Reach.around(motion), tick)
        furthest = _TRAVELS * float(np.abs(motion).max()) + float(np.ptp(motion, axis=0).max())
        return render_group(engine, self.scene, cycles, furthest, tick)

    def work(self, cycles: int) -> tuple[str, float]:
        """Return the name of the code to compile, and the cost of the run in cycles of a light plant."""
        if not self.scene.groups:
            return self.case.algorithm, work_of(self.case, cycles)
        is_coarse = any(axis.loop.encoder_count for axis in self.scene.axes)  # decides the lengths of the buffers
        compiled = f"{_algorithm_of(self.scene)} {self.sample_time_ns} {self.scene.bus.delay} {is_coarse}"
        return compiled, cycles * WORTH_COMPILING / WORTH_COMPILING_GROUPS


@dataclass(frozen=True, slots=True)
class LoopRow:
    """Run of one variant of the loop, with its errors and its computing time."""

    variant: Variant
    run: axis_loop.LoopRun
    errors: MotionError  # the largest over the run, infinite where it ended early
    seconds: float  # processor time of the run, plant and recording included


def variants(alone: Scene, whole: Scene, refused: Callable[[str], None] = lambda _: None) -> list[Variant]:
    """Return an axis or a group and its variants, one change each, on finely solved plants.

    Args:
        alone: Scene of the axis or group alone.
        whole: Whole scene, whose other axes share the bus.
        refused: Called with a line on each rate that the bus cannot have.
    """
    base = finely_solved(alone)
    found = [Variant("as it is", _algorithm_of(base), base, is_scene=True)]
    for factor, rate in _rates(base):
        try:
            faster = finely_solved(at_rate(alone, rate), factor)
        except ParameterError as error:
            refused(f"left out: sample rate {hertz(rate)} ({str(error).splitlines()[0]})")
            continue
        found.append(Variant("sample rate", hertz(rate), faster, fineness=factor))
    return [*found, *_delays(base, whole), *_algorithms(base), *_filters(base), *_torques(base), *_encoders(base),
            *_without_encoder_effects(base)]  # fmt: skip


def settings_now(scene: Scene) -> dict[str, str]:
    """Return the scene's own values of the settings that variants change, by kind of change."""
    found = {"sample rate": hertz(scene.bus.rate), "RPDO": scene.bus.rpdo, "algorithm": _algorithm_of(scene)}
    if scene.groups:
        return found
    (axis,) = scene.axes
    case, unit, parameters = axis_loop.loop_case(axis, scene), axis.parameters.unit, axis.passivity.parameters
    if "velocity" in type(parameters).model_fields:
        found["velocity"] = getattr(parameters, "velocity", "last")
    if case.torque_quantum is not None:
        found["torque step"] = f"{case.torque_quantum:g} {effort_unit(unit)}"
    if case.counts_per_unit is not None:
        found["encoder count"] = f"{1.0 / abs(case.counts_per_unit):.3g} {unit}"
    return found


def _algorithm_of(scene: Scene) -> str:
    """Return the algorithm of a port alone."""
    return scene.ports[0].passivity.name


def finely_solved(scene: Scene, factor: float = 1.0) -> Scene:
    """Return the scene of an axis or group for `factor` times the rate, with plant substeps of the same length."""
    substeps = max(1, round((_GROUP_SUBSTEPS if scene.groups else _SUBSTEPS) / factor))

    def fine(axis: AxisScene) -> AxisScene:
        if axis.simulation is None:
            return axis
        return replace(axis, simulation=replace(axis.simulation, accuracy=AccuracyParameters(substeps=substeps)))

    mechanisms = tuple(replace(of, substeps=substeps) for of in scene.mechanisms)
    return replace(scene, axes=tuple(map(fine, scene.axes)), mechanisms=mechanisms)


def _rates(scene: Scene) -> Iterator[tuple[float, float]]:
    for factor in RATES:
        rate, divides = scene.bus.rate * factor, factor <= 1.0 or not scene.bus.sample_time_ns % int(factor)
        if _RANGE[0] <= rate <= _RANGE[1] and divides:
            yield factor, rate


def hertz(rate: float) -> str:
    """Return a rate as text with its unit."""
    return f"{rate / 1000.0:g} kHz" if rate >= 1000.0 else f"{rate:g} Hz"


def _delays(base: Scene, whole: Scene) -> Iterator[Variant]:
    if kind_of(base.bus) != "can":
        return
    other = "event" if base.bus.rpdo == "synchronous" else "synchronous"
    bus = base.bus.model_copy(update={"rpdo": other})
    own = {a.parameters.name: _changed(a, {"delay": bus.delay, "torque_window": None}, {}) for a in base.axes}
    timed = with_loops(replace(whole, bus=bus, axes=tuple(own.get(a.parameters.name, a) for a in whole.axes)))
    axes = tuple(axis for axis in timed.axes if axis.parameters.name in own)
    if all((axis.loop.torque_window or 0.0) < bus.sample_time for axis in axes):  # it comes before the next SYNC
        yield Variant("RPDO", other, replace(base, bus=bus, axes=axes))


def _algorithms(base: Scene) -> Iterator[Variant]:
    """Yield the scene under each other algorithm for which it gives, or its plant has, the required values."""
    for name, place in base.ports[0].algorithms.table.items():
        if name != _algorithm_of(base) and LITERATURE.get(name) != place:  # which are only to compare with papers
            try:
                found = axis_loop.under(base, name)
            except ParameterError:
                continue
            yield Variant("algorithm", name, found.permitted(), remark=found.remark)


def _filters(base: Scene) -> Iterator[Variant]:
    parameters = base.axes[0].passivity.parameters
    if base.groups or "velocity" not in type(parameters).model_fields:
        return
    other = "last" if getattr(parameters, "velocity", "last") == "windowed" else "windowed"
    changed = base.axes[0].passivity._replace(parameters=parameters.model_copy(update={"velocity": other}))
    yield Variant("velocity", other, replace(base, axes=(replace(base.axes[0], passivity=changed),)))


def _torques(base: Scene) -> Iterator[Variant]:
    if any(axis.parameters.rated_torque is None for axis in base.axes):
        return
    unit, quantum = effort_unit(base.axes[0].parameters.unit), base.axes[0].loop.torque_quantum or 0.0
    for times in (0.1, 10.0, 0.0):
        axes = tuple(
            _changed(a, {"torque_quantum": (a.loop.torque_quantum or 0.0) * times},
                     {"rated_torque": (a.parameters.rated_torque or 0.0) * times or None})
            for a in base.axes
        )  # fmt: skip
        setting = f"{quantum * times:g} {unit}" if times else "ideal"
        yield Variant("torque step", setting, replace(base, axes=axes), fineness=1.0 / times if times else math.inf)


def _encoders(base: Scene) -> Iterator[Variant]:
    given = base.axes[0].parameters
    for times in (0.01, 0.1, 10.0, 0.0):
        changed = replace(base, axes=tuple(_with_counts(axis, times) for axis in base.axes))
        setting = f"{1.0 / (abs(given.counts_per_unit) * times):.3g} {given.unit}" if times else "ideal"
        yield Variant("encoder count", setting, changed, fineness=times or math.inf)


def _with_counts(axis: AxisScene, times: float) -> AxisScene:
    counts = axis.parameters.counts_per_unit * times
    count = (axis.loop.encoder_count / times if axis.group else 1.0 / abs(counts)) if times else 0.0
    return _changed(axis, {"encoder_count": count}, {"counts_per_unit": counts})


_Values = Mapping[str, float | None]


def _changed(axis: AxisScene, loop: _Values, parameters: _Values) -> AxisScene:
    """Return an axis with changes to the known properties of its loop, and to its drive."""
    given = axis.parameters.model_copy(update=parameters)
    return replace(axis, loop=axis.loop.model_copy(update=loop), parameters=given)


def _without_encoder_effects(base: Scene) -> Iterator[Variant]:
    if base.groups:
        return
    (axis,) = base.axes
    simulation = simulation_of(axis)
    for name in dict.fromkeys(effect.name for effect in simulation.effects if effect.name in _ENCODER_EFFECTS):
        rest = tuple(effect for effect in simulation.effects if effect.name != name)
        changed = replace(axis, simulation=replace(simulation, effects=rest))
        yield Variant("effect", f"without {name}", replace(base, axes=(changed,)))


def loop_row(
    variant: Variant,
    exact: ContinuousRun,
    step_ns: int,
    duration_ns: int,
    tick: Callable[[], None],
    engine: ChosenEngine = "python",
) -> LoopRow:
    """Return the row of one variant after its run.

    Args:
        variant: Variant of the loop.
        exact: Motion of the continuous axis or group, at least as finely sampled as the variant.
        step_ns: Time between two of its readings [ns].
        duration_ns: Length of the run [ns].
        tick: Called once a cycle; may raise to abort.
        engine: Engine of the axis's loop.
    """
    period, clock = variant.sample_time_ns, ProcessorClock()
    begin = clock.now()
    run = variant.render(duration_ns // period + 1, exact.position, tick, engine)
    seconds = (clock.now() - begin) * 1e-9
    if run.ended:
        return LoopRow(variant, run, MotionError(math.inf, math.inf, math.inf), seconds)
    stride = period // step_ns
    shown = min(len(run.position), (len(exact.position) - 1) // stride + 1)
    rows = slice(0, (shown - 1) * stride + 1, stride)
    impulse = exact.impulse[rows]
    mean = np.diff(impulse, axis=0, prepend=np.zeros_like(impulse[:1])) / (period * 1e-9)
    apart = (
        run.true_position[:shown] - exact.position[rows],
        run.torque[:shown] - mean,
        run.interaction[:shown] - exact.interaction[rows],
    )
    return LoopRow(variant, run, MotionError(*(float(np.abs(of).max(initial=0.0)) for of in apart)), seconds)


def engines_of(variants: Sequence[Variant], duration_ns: int, engine: Engine) -> list[ChosenEngine]:
    """Return the engine of each variant; "auto" compiles an algorithm if its variants take longer than compiling."""
    works = [variant.work(duration_ns // variant.sample_time_ns + 1) for variant in variants]
    whole: Counter[str] = Counter()
    for name, work in works:
        whole[name] += round(work)
    return [chosen_engine(engine, whole[name] >= WORTH_COMPILING) for name, _ in works]


def bus_figures(variant: Variant, scene: Scene) -> Row:
    """Return load and worst cycle of the busiest bus of the axes, at the variant's rate; None of a line of EtherCAT."""
    if kind_of(variant.scene.bus) != "can":
        return {"bus_load": None, "worst_cycle": None, "bus_fits": True}
    budgets = []
    for bus in dict.fromkeys(axis.bus for axis in variant.scene.axes):
        given = [axis.parameters for axis in scene.axes if axis.bus == bus]
        maps = [choose_map(of.dictionary(), of) for of in given]
        budgets.append(bus_budget(can_bus(variant.scene.bus), maps))
    budget = max(budgets, key=lambda budget: budget.periodic_load)
    return {"bus_load": budget.periodic_load, "worst_cycle": budget.worst_cycle, "bus_fits": budget.fits}


_IDEAL_STEPS: Final = 32
"""Largest number of holds of the ideal display in one sample time; the display that checks it has half as many."""
_FASTEST: Final = 20e3
"""Highest rate that a scene may have [Hz]."""
_STIFFER: Final = 1000.0
_PLAIN: Final = "unprotected"


def study_display(
    scene: Scene,
    name: str | None,
    duration: float | None,
    stop: Stop,
    progress: Callable[[float], None] = lambda _: None,
) -> Row:
    """Return the study of one display, or group of displays, as plain values.

    Args:
        scene: Simulated scene.
        name: Name of the axis or group; None for the first.
        duration: Length of the comparison [s]; by default 1000 sample times, or the scene's if that is shorter.
        stop: Polled before every run; true ends the study with the results so far.
        progress: Called with the completed fraction.

    Raises:
        InputError: No axis or group has this name, or it is not simulated.
    """
    parts = parts_of(scene)
    if name is not None and name not in parts:
        raise InputError(f"{scene.source}: got axis {name!r}, expected one of: {', '.join(parts)}")
    name = name or next(iter(parts))
    alone, holds, steps = parts[name], holds_of(scene, duration), _steps(scene)
    ideal = run_display(_ideal(alone, steps), holds * steps)
    nearly = run_display(_ideal(alone, steps // 2), holds * steps // 2)
    rows: list[Row] = []
    every = list(_display_variants(alone))
    for number, variant in enumerate(every):
        progress((1 + number) / (1 + len(every)))
        if stop():
            break
        own = round(steps * variant.sample_time_ns / alone.bus.sample_time_ns)
        rows.append(_display_row(variant, ideal, own, holds * steps))
    is_whole = len(rows) == len(every)
    return {
        "scene": scene.source,
        "axis": name,
        "unit": alone.axes[0].parameters.unit,
        "rate": 1.0 / scene.bus.sample_time,
        "holds": holds,
        "reference": {
            "ended": ideal.reason or ideal.ended,
            "travel": float(np.ptp(_positions(ideal), axis=0).max()),
            "energy": float(ideal.interaction[-1]),
            "apart": _apart(nearly, ideal, 2)[0],
        },
        "plant": [_plant_row(alone, axis, holds) for axis in alone.axes] if is_whole else [],
        "loop": rows,
        "status": "completed" if is_whole else "stopped",
    }


def _steps(scene: Scene) -> int:
    """Return the number of holds of the ideal display in one sample time, a power of two."""
    steps = _IDEAL_STEPS
    while steps > 4 and steps / scene.bus.sample_time > _FASTEST:
        steps //= 2
    return steps


def _positions(run: AdmittanceRun) -> Array:
    return run.motion[:, :, 0]


def _apart(run: AdmittanceRun, ideal: AdmittanceRun, steps: int) -> tuple[float, float]:
    """Return the largest errors of position [m or rad] and energy [J] against the ideal display, at the same times."""
    exact, energies = _positions(ideal)[::steps], ideal.interaction[::steps]
    common = min(len(exact), len(run.rows))
    position = np.abs(_positions(run)[:common] - exact[:common]).max(initial=0.0)
    return float(position), float(np.abs(run.interaction[:common] - energies[:common]).max(initial=0.0))


def _display_row(variant: Variant, ideal: AdmittanceRun, steps: int, whole: int) -> Row:
    """Return the row of a variant; `steps` of the `whole` holds of the ideal display make one hold of the variant."""
    row, clock = Row(changed=variant.group, to=variant.setting), ProcessorClock()
    begin = clock.now()
    try:
        run = run_display(variant.scene, whole // steps)
    except CanHapticError as error:
        return row | {"status": f"refused: {str(error).splitlines()[0]}"}
    spent, figures = clock.now() - begin, figures_of(run, variant.scene)
    position, energy = _apart(run, ideal, steps)
    return row | {
        "status": run.reason or run.ended or "ok",
        "position_error": position,
        "energy_error": energy,
        "mass_felt": figures["mass_felt"],
        "given_out": -run.least_interaction,
        "guard_acts": figures["guard_acts"],
        "energy_unsure": run.resolution,
        "us_per_cycle": spent * 1e-3 / max(1, len(run.rows)),
    }


def _plant_row(scene: Scene, axis: AxisScene, holds: int) -> Row:
    """Return the difference of the plant from a solver, under the commands of the scene's own controller."""
    simulation, name = simulation_of(axis), axis.parameters.name
    if reason := why_no_equations(simulation):
        return {"axis": name, "status": f"not compared: no equations for {reason}"}
    run, place = run_display(scene, holds), scene.axes.index(axis)
    exact = exact_display(simulation, run.torque[1:, place].tolist(), scene.bus.sample_time_ns)
    row: Row = {"axis": name, "status": "ok"}
    row["position_error"] = float(np.abs(_positions(run)[1:, [place]] - exact.position).max())
    if run.axes == 1:
        row["energy_error"] = float(np.abs(run.interaction[1:] - exact.user).max())
    return row


def _display_variants(scene: Scene) -> Iterator[Variant]:
    """Yield the scene and its changes."""
    yield Variant("the scene", "", scene)
    for factor in (0.5, 2.0, 4.0):
        rate = factor / scene.bus.sample_time
        yield Variant("rate", f"{rate:g} Hz", at_rate(scene, rate))
    yield from _algorithms(scene)
    for sampling in ("point", "mean"):
        yield Variant("sampling", sampling, _sensed(scene, sampling=sampling))
    exact = _sensed(scene, gain=1.0, offset=0.0, drift=0.0, noise=0.0, quantum=0.0)
    yield Variant("sensor", "without errors", exact)
    finer = replace(scene, axes=tuple(_with(axis, {}, 10.0) for axis in scene.axes))
    yield Variant("encoder", "10 times finer", finer)


def _sensed(scene: Scene, **values: float | str) -> Scene:
    """Return a scene with other properties of the simulated sensor, whose sampling is also declared."""
    known = {key: value for key, value in values.items() if key == "sampling"}

    def changed(axis: AxisScene) -> AxisScene:
        return _with(axis, known, sensor=_simulated(axis).sensor.model_copy(update=values))

    return replace(scene, axes=tuple(map(changed, scene.axes)))


def _simulated(axis: AxisScene) -> AdmittanceSimulation:
    simulated = simulation_of(axis).admittance
    if axis.parameters.admittance is None or simulated is None:
        raise InputError(f"{axis.parameters.name}: is not an admittance display, expected one")
    return simulated


def _with(
    axis: AxisScene, known: Mapping[str, object], counts: float = 1.0, delay: int | None = None, **simulated: object
) -> AxisScene:
    """Return a display with another declared sensor, another encoder resolution, delay and simulation."""
    given, simulation, drive = axis.parameters, simulation_of(axis), simulation_of(axis).drive
    admittance = _simulated(axis).model_copy(update=simulated)
    display = cast(AdmittanceParameters, given.admittance)
    force = display.force.model_copy(update=known)
    if drive.display is not None:
        scales = {"force_per_count": force.per_count, "force_offset_counts": force.offset_counts}
        drive = drive.model_copy(update={"display": drive.display.model_copy(update=scales)})
    display = display.model_copy(update={"force": force})
    update = {"admittance": display, "counts_per_unit": counts * given.counts_per_unit}
    return replace(
        axis, parameters=given.model_copy(update=update),
        simulation=replace(simulation, admittance=admittance, drive=drive),
        loop=axis.loop if delay is None else axis.loop.model_copy(update={"delay": delay}),
    )  # fmt: skip


def _ideal(scene: Scene, steps: int) -> Scene:
    """Return the ideal display of a scene, with `steps` holds in one sample time."""

    def changed(axis: AxisScene) -> AxisScene:
        loop, display = _simulated(axis).loop, cast(AdmittanceParameters, axis.parameters.admittance)
        ideal = {"gain": _STIFFER * loop.gain, "integral_gain": 0.0, "torque_limit": None}
        known = {
            "sampling": "mean", "latency": 0, "filter": 0.0, "frozen_after": None, "offset_counts": 0.0, "range": 1e6,
            "per_count": 1e-6 * display.force.range,
        }  # fmt: skip
        sensor = SimulatedForceSensor(sampling="mean")
        return _with(axis, known, 1e3, delay=0, loop=loop.model_copy(update=ideal), sensor=sensor)

    finer = at_rate(axis_loop.under(scene, _PLAIN).permitted(), steps / scene.bus.sample_time)
    bus = CanBusParameters(rate=finer.bus.rate, rpdo="event")  # a command acts at once
    return replace(finer, bus=bus, axes=tuple(map(changed, finer.axes)))


def why_no_equations(simulation: AxisSimulation) -> str:
    """Return "" if the equations describe a plant completely, else the name of the part that they omit."""
    display, user = simulation.admittance, simulation.user
    if display is None:
        return "no admittance display"
    if display.loop.torque_limit is not None:
        return "the torque limit of the loop"
    if simulation.effects:
        return f"effect {simulation.effects[0].name}"
    if user is not None and not user.has_equations:
        return "a user-defined or recorded hand"
    return ""


def exact_display(simulation: AxisSimulation, held: Sequence[float], sample_time_ns: int) -> Motion:
    """Return the motion of a display by DOP853; its `user` is the energy through the sensor [J].

    Args:
        simulation: Simulation of the axis, without a part that `why_no_equations` names.
        held: Velocity command in each hold [m/s or rad/s].
        sample_time_ns: T [ns].

    Raises:
        InputError: scipy is missing, or the solver failed.
    """
    display = cast(AdmittanceSimulation, simulation.admittance)
    model = DisplayModel(simulation.plant, display, simulation.user)
    return located(model, held, sample_time_ns, "DOP853", 1e-11, 1e-14)
