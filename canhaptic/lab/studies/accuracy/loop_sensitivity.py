"""The loop side: one change at a time, of sample rate, delay, algorithm, velocity filter, resolution or encoder.

Every variant is rendered without a bus and compared with the continuous environment; the bus load is computed.

Reference of the loop side: the continuous environment of an axis, read on a grid common to all rates.

The loop side of a group: one change at a time, of sample rate, delay, algorithm, torque step or encoder count.
"""

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple, Protocol

import numpy as np

from canhaptic.axis_units import effort_unit
from canhaptic.canopen.eds import read_dictionary
from canhaptic.control.multi_axis import GROUP_ALGORITHMS
from canhaptic.control.multi_axis.group_controller import GroupController
from canhaptic.control.passivity import ALGORITHMS, LITERATURE
from canhaptic.drive.axis_parameters import BusParameters
from canhaptic.drive.can.bus_budget import bus_budget
from canhaptic.drive.can.pdo_map import AxisMap, choose_map
from canhaptic.drive.clock import WallClock
from canhaptic.errors import ParameterError
from canhaptic.lab.batch.engine import WORTH_COMPILING, WORTH_COMPILING_GROUPS, ChosenEngine, Engine, chosen_engine
from canhaptic.lab.batch.group_loop import GroupRecorder
from canhaptic.lab.batch.scalar import render_by, render_group_by, work_of
from canhaptic.lab.loop.axis_loop import (
    Case,
    LoopCase,
    LoopRun,
    Recorder,
    able_under,
    at_rate,
    axis_at,
    environment_of,
    group_under,
    loop_case,
)
from canhaptic.lab.reference import continuous_run, textbook_model
from canhaptic.scene.models import AxisScene, Scene
from canhaptic.scene.parts import build_group
from canhaptic.scene.timing import with_timing
from canhaptic.scene.torque_history import simulation_of
from canhaptic.sim.plant.accuracy_parameters import AccuracyParameters
from canhaptic.sim.plant.propagator import Array

_TOLERANCE: Final = 1e-11


class ContinuousLoop(NamedTuple):
    """The continuous axis at every `step_ns`, shapes (steps + 1,)."""

    step_ns: int
    position: Array  # [m or rad]
    impulse: Array  # of the environment's force since the start [N*s or N*m*s]
    interaction: Array  # energy into the environment since the start [J]


def continuous_loop(
    axis: AxisScene, step_ns: int, steps: int, stop: Callable[[], bool] | None = None
) -> ContinuousLoop:
    """Return the motion and forces that the user would feel without sampling.

    Args:
        axis: Axis with environment, plant, user and effects.
        step_ns: Time between two readings [ns].
        steps: Readings after the first.
        stop: Polled regularly; true aborts.

    Raises:
        InputError: There are no equations for the environment or an effect, scipy is missing, the solver fails, or it
            was stopped.
    """
    times = [k * step_ns * 1e-9 for k in range(steps + 1)]
    run = continuous_run(environment_of(axis), textbook_model(simulation_of(axis)), times, _TOLERANCE, stop)
    return ContinuousLoop(step_ns, run.position, run.impulse, run.interaction)


FINEST: Final = 4
"""Highest rate over that of the scene; the reference is read at that rate."""
RATES: Final = (0.25, 0.5, 2.0, float(FINEST))
"""Sample rates that are tried, over that of the scene."""
_SUBSTEPS: Final = 32
"""Substeps of the plant in one sample time of the scene: the finest of the ladder, whose error is the floor here."""
_ENCODER_EFFECTS: Final = ("encoder_noise", "encoder_quantisation")


class Continuous(Protocol):
    """Motion and force without sampling, of an axis or, in further columns, of the axes of a group."""

    @property
    def step_ns(self) -> int:
        """Time between two readings [ns]."""

    @property
    def position(self) -> Array:
        """Position at every reading [m or rad]."""

    @property
    def impulse(self) -> Array:
        """Impulse of the rendered force since the start [N*s or N*m*s]."""

    @property
    def interaction(self) -> Array:
        """Energy received since the start [J]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Variant:
    """One loop with one change."""

    group: str
    setting: str
    buses: tuple[str, ...]  # names of those that its axes are on
    bus: BusParameters
    case: Case
    is_scene: bool = False
    remark: str = ""
    fineness: float | None = None  # times that of the scene, infinite for ideal; None where nothing is finer

    def render(self, cycles: int, motion: Array, tick: Callable[[], None], engine: ChosenEngine) -> LoopRun:
        """Return the result of the loop.

        Args:
            cycles: SYNCs.
            motion: Motion of the continuous run, which defines divergence [m or rad].
            tick: Called at every SYNC; may raise to abort.
            engine: Engine of the loop.
        """
        raise NotImplementedError

    def work(self, cycles: int) -> tuple[str, float]:
        """Return what must be compiled for it, and its cost in cycles of a light plant; 0: nothing is compiled."""
        return "", 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class _AxisVariant(Variant):
    """The loop of one axis."""

    axis: AxisScene
    case: LoopCase

    def render(self, cycles: int, motion: Array, tick: Callable[[], None], engine: ChosenEngine) -> LoopRun:
        """Return what it did; see `Variant`."""
        return render_by(engine, self.case, cycles, Recorder.around(motion), tick)

    def work(self, cycles: int) -> tuple[str, float]:
        """Return the algorithm, and the cost of a run; see `Variant`."""
        return self.case.algorithm, work_of(self.case, cycles)


def _variant(
    group: str, setting: str, axis: AxisScene, bus: BusParameters, case: LoopCase, **rest: Any
) -> _AxisVariant:
    return _AxisVariant(group=group, setting=setting, buses=(axis.bus,), axis=axis, bus=bus, case=case, **rest)


@dataclass(frozen=True, slots=True)
class LoopRow:
    """Result of one variant; errors are the largest over the run, None where it could not be run."""

    variant: Variant
    run: LoopRun
    position_error: float
    force_error: float
    energy_error: float
    seconds: float  # wall time of the run, plant and recording included

    @property
    def is_stable(self) -> bool:
        """Whether it ran to its end."""
        return not self.run.ended


def variants(axis: AxisScene, scene: Scene) -> Sequence[Variant]:
    """Return the scene itself and its variants, one change each, on a finely solved plant."""
    axis = _with_substeps(axis, 1.0)
    base = _variant("as it is", axis.passivity.name, axis, scene.bus, loop_case(axis, scene), is_scene=True)
    found = [base, *_rates(base, scene), *_delays(base, scene), *_algorithms(base, scene), *_filters(base, scene)]
    return [*found, *_torques(base), *_encoders(base), *_without_encoder_effects(base, scene)]


def settings_now(axis: AxisScene, scene: Scene) -> dict[str, str]:
    """Return the scene's own values of the settings that variants change, by group of variants."""
    case, unit, parameters = loop_case(axis, scene), axis.parameters.unit, axis.passivity.parameters
    quantum, counts = case.torque_quantum, case.counts_per_unit
    found = {"sample rate": hertz(scene.bus.rate), "RPDO": scene.bus.rpdo, "algorithm": axis.passivity.name}
    if "velocity" in type(parameters).model_fields:
        found["velocity"] = getattr(parameters, "velocity", "last")
    if quantum is not None:
        found["torque step"] = f"{quantum:g} {effort_unit(unit)}"
    if counts is not None:
        found["encoder count"] = f"{1.0 / abs(counts):.3g} {unit}"
    return found


def _with_substeps(axis: AxisScene, factor: float) -> AxisScene:
    """Return the axis with substeps of the same length at `factor` times the rate."""
    fine = AccuracyParameters(substeps=max(1, round(_SUBSTEPS / factor)))
    return replace(axis, simulation=replace(simulation_of(axis), accuracy=fine))


def _rates(base: _AxisVariant, scene: Scene) -> list[_AxisVariant]:
    found = []
    for factor in RATES:
        rate = base.bus.rate * factor
        if not 1.0 <= rate <= 20_000.0 or (factor > 1.0 and base.bus.sample_time_ns % int(factor)):
            continue
        bus = BusParameters(**{**base.bus.model_dump(), "rate": rate})
        axis = _with_substeps(axis_at(base.axis, bus.sample_time), factor)
        case = loop_case(axis, replace(scene, bus=bus))
        found.append(_variant("sample rate", hertz(rate), axis, bus, case, fineness=factor))
    return found


def hertz(rate: float) -> str:
    """Return a rate with its unit."""
    return f"{rate / 1000.0:g} kHz" if rate >= 1000.0 else f"{rate:g} Hz"


def _delays(base: _AxisVariant, scene: Scene) -> list[_AxisVariant]:
    other = "event" if base.bus.rpdo == "synchronous" else "synchronous"
    bus = base.bus.model_copy(update={"rpdo": other})
    loop = base.axis.loop.model_copy(update={"delay": bus.delay, "torque_window": None})
    name = base.axis.parameters.name
    axes = (replace(base.axis, loop=loop) if each.parameters.name == name else each for each in scene.axes)
    timed = with_timing(replace(scene, bus=bus, axes=tuple(axes)))
    axis = next(each for each in timed.axes if each.parameters.name == name)
    if (axis.loop.torque_window or 0.0) >= bus.sample_time:  # the torque would come behind the next SYNC
        return []
    return [_variant("RPDO", other, axis, bus, loop_case(axis, timed))]


def _algorithms(base: _AxisVariant, scene: Scene) -> list[_AxisVariant]:
    found = []
    for name in ALGORITHMS:
        if name == base.axis.passivity.name or name in LITERATURE:
            continue
        try:
            chosen = able_under(base.axis, name, scene)
        except ParameterError:
            continue
        case = loop_case(chosen.axis, scene)
        found.append(_variant("algorithm", name, chosen.axis, base.bus, case, remark=chosen.remark))
    return found


def _filters(base: _AxisVariant, scene: Scene) -> list[_AxisVariant]:
    parameters = base.axis.passivity.parameters
    if "velocity" not in type(parameters).model_fields:
        return []
    other = "last" if getattr(parameters, "velocity", "last") == "windowed" else "windowed"
    changed = parameters.model_copy(update={"velocity": other})
    axis = replace(base.axis, passivity=base.axis.passivity._replace(parameters=changed))
    return [_variant("velocity", other, axis, base.bus, loop_case(axis, scene))]


def _torques(base: _AxisVariant) -> list[_AxisVariant]:
    quantum = base.case.torque_quantum
    if quantum is None:
        return []
    unit = effort_unit(base.axis.parameters.unit)
    found = []
    for factor in (0.1, 10.0, None):
        step = None if factor is None else quantum * factor
        loop = base.case.loop.model_copy(update={"torque_quantum": step or 0.0})
        setting = "ideal" if step is None else f"{step:g} {unit}"
        case = replace(base.case, torque_quantum=step, loop=loop)
        found.append(_variant("torque step", setting, base.axis, base.bus, case, fineness=fineness(factor, -1.0)))
    return found


def _encoders(base: _AxisVariant) -> list[_AxisVariant]:
    counts = base.case.counts_per_unit
    if counts is None:
        return []
    found = []
    for factor in (0.01, 0.1, 10.0, None):
        scale: float | None = None if factor is None else abs(counts) * factor
        loop = base.case.loop.model_copy(update={"encoder_count": 1.0 / scale if scale else 0.0})
        setting = "ideal" if scale is None else f"{1.0 / scale:.3g} {base.axis.parameters.unit}"
        case = replace(base.case, counts_per_unit=scale, loop=loop)
        found.append(_variant("encoder count", setting, base.axis, base.bus, case, fineness=fineness(factor, 1.0)))
    return found


def fineness(factor: float | None, power: float) -> float:
    """Return the factor by which a step is finer; infinite where it has none."""
    return math.inf if factor is None else float(factor**power)


def _without_encoder_effects(base: _AxisVariant, scene: Scene) -> list[_AxisVariant]:
    simulation, found = simulation_of(base.axis), []
    for name in dict.fromkeys(effect.name for effect in simulation.effects if effect.name in _ENCODER_EFFECTS):
        rest = tuple(effect for effect in simulation.effects if effect.name != name)
        axis = replace(base.axis, simulation=replace(simulation, effects=rest))
        found.append(_variant("effect", f"without {name}", axis, base.bus, loop_case(axis, scene)))
    return found


def loop_row(
    variant: Variant, exact: Continuous, duration_ns: int, tick: Callable[[], None], engine: ChosenEngine = "python"
) -> LoopRow:
    """Return the row of one variant after its run.

    Args:
        variant: Variant of the loop.
        exact: The continuous axis or group, read at least as often as the variant samples.
        duration_ns: Length of the run [ns].
        tick: Called once a cycle; may raise to abort.
        engine: Engine of the axis's loop.
    """
    period = variant.case.sample_time_ns
    clock = WallClock()
    begin = clock.now()
    run = variant.render(duration_ns // period + 1, exact.position, tick, engine)
    seconds = (clock.now() - begin) * 1e-9
    stride = period // exact.step_ns
    shown = min(len(run.position), (len(exact.position) - 1) // stride + 1)
    rows = slice(0, (shown - 1) * stride + 1, stride)
    impulse = exact.impulse[rows]
    mean = np.diff(impulse, axis=0, prepend=np.zeros_like(impulse[:1])) / (period * 1e-9)
    if run.ended:
        infinite = float("inf")
        return LoopRow(variant, run, infinite, infinite, infinite, seconds)
    return LoopRow(
        variant,
        run,
        _most(run.true_position[:shown] - exact.position[rows]),
        _most(run.torque[:shown] - mean),
        _most(run.interaction[:shown] - exact.interaction[rows]),
        seconds,
    )


def _most(values: Array) -> float:
    return float(np.abs(values).max(initial=0.0))


def engines_of(variants: Sequence[Variant], duration_ns: int, engine: Engine) -> list[ChosenEngine]:
    """Return the engine of each variant; "auto" compiles where all of one algorithm take longer than compiling."""
    works = [variant.work(duration_ns // variant.case.sample_time_ns + 1) for variant in variants]
    whole: Counter[str] = Counter()
    for name, work in works:
        whole[name] += round(work)
    return [chosen_engine(engine, whole[name] >= WORTH_COMPILING) for name, _ in works]


def bus_figures(variant: Variant, scene: Scene) -> dict[str, Any]:
    """Return load and worst cycle of the busiest bus of the axes, at the variant's rate."""
    budgets = []
    for bus in dict.fromkeys(variant.buses):
        maps: Sequence[AxisMap] = [
            choose_map(read_dictionary(a.parameters.eds, a.parameters.node_id), a.parameters)
            for a in scene.axes
            if a.bus == bus
        ]
        budgets.append(bus_budget(variant.bus, maps))
    budget = max(budgets, key=lambda budget: budget.periodic_load)
    return {"bus_load": budget.periodic_load, "worst_cycle": budget.worst_cycle, "bus_fits": budget.fits}


_GROUP_SUBSTEPS: Final = 8
"""Substeps of the plants in one sample time: of order 2, the error of a mechanism is far below that of its loop."""
_TRAVELS: Final = 10.0
"""Distance from the origin that counts as divergence, in that of the continuous run."""


@dataclass(frozen=True, slots=True)
class _GroupCase(Case):
    """The group of a scene."""

    scene: Scene

    @property
    def sample_time_ns(self) -> int:
        """T [ns]."""
        return self.scene.bus.sample_time_ns

    def controller(self) -> GroupController:
        """Return the algorithm, at rest."""
        (group,) = self.scene.groups
        return build_group(self.scene, group)


@dataclass(frozen=True, slots=True, kw_only=True)
class _GroupVariant(Variant):
    """The loop of a group."""

    case: _GroupCase

    def render(self, cycles: int, motion: Array, tick: Callable[[], None], engine: ChosenEngine) -> LoopRun:
        """Return what it did; see `Variant`."""
        furthest = _TRAVELS * float(np.abs(motion).max()) + float(np.ptp(motion, axis=0).max())
        return render_group_by(engine, self.case.scene, cycles, GroupRecorder(motion.shape[1], furthest, tick))

    def work(self, cycles: int) -> tuple[str, float]:
        """Return the algorithm with what decides the lengths of its buffers, and the cost of a run; see `Variant`."""
        (group,), bus = self.case.scene.groups, self.bus
        is_coarse = any(axis.loop.encoder_count for axis in self.case.scene.axes)
        compiled = f"{group.passivity.name} {bus.sample_time_ns} {bus.delay} {is_coarse}"
        return compiled, cycles * WORTH_COMPILING / WORTH_COMPILING_GROUPS


def finely_solved(scene: Scene, factor: float = 1.0) -> Scene:
    """Return a scene with plants of substeps of the same length at `factor` times the rate."""
    substeps = max(1, round(_GROUP_SUBSTEPS / factor))

    def fine(axis: AxisScene) -> AxisScene:
        if axis.simulation is None:
            return axis
        accuracy = AccuracyParameters(substeps=substeps)
        return replace(axis, simulation=replace(simulation_of(axis), accuracy=accuracy))

    mechanisms = tuple(replace(of, substeps=substeps) for of in scene.mechanisms)
    return replace(scene, axes=tuple(map(fine, scene.axes)), mechanisms=mechanisms)


def group_variants(scene: Scene) -> list[Variant]:
    """Return the one group of a scene and its variants, one change each, on finely solved plants."""
    (group,) = scene.groups
    base = finely_solved(scene)
    found = [_group_variant("as it is", group.passivity.name, base, is_scene=True)]
    for factor in RATES:
        rate = scene.bus.rate * factor
        if 1.0 <= rate <= 20_000.0 and (factor <= 1.0 or not scene.bus.sample_time_ns % int(factor)):
            changed = finely_solved(at_rate(scene, rate), factor)
            found.append(_group_variant("sample rate", hertz(rate), changed, fineness=factor))
    return [*found, *_group_delays(base), *_group_algorithms(base), *_group_torques(base), *_group_encoders(base)]


def _group_variant(kind: str, setting: str, scene: Scene, **rest: Any) -> Variant:
    buses = tuple(axis.bus for axis in scene.axes)
    return _GroupVariant(group=kind, setting=setting, buses=buses, bus=scene.bus, case=_GroupCase(scene), **rest)


def _group_delays(base: Scene) -> list[Variant]:
    other = "event" if base.bus.rpdo == "synchronous" else "synchronous"
    bus = base.bus.model_copy(update={"rpdo": other})
    changes = {"delay": bus.delay, "torque_window": None}
    timed = with_timing(replace(_with_loops(base, lambda _axis: changes), bus=bus))
    if any((axis.loop.torque_window or 0.0) >= bus.sample_time for axis in timed.axes):
        return []  # the torque would come behind the next SYNC
    return [_group_variant("RPDO", other, timed)]


def _group_algorithms(base: Scene) -> list[Variant]:
    (group,), found = base.groups, []
    for name in GROUP_ALGORITHMS:
        changed = replace(base, groups=(group_under(group, name),))
        try:
            build_group(changed, changed.groups[0])
        except ParameterError:
            continue
        if name != group.passivity.name:
            found.append(_group_variant("algorithm", name, changed))
    return found


def _group_torques(base: Scene) -> list[Variant]:
    if any(axis.parameters.rated_torque is None for axis in base.axes):
        return []
    unit, quantum = effort_unit(base.axes[0].parameters.unit), base.axes[0].loop.torque_quantum
    found = []
    for factor in (0.1, 10.0, None):

        def change(axis: AxisScene, factor: float | None = factor) -> Mapping[str, float | None]:
            return {"torque_quantum": (axis.loop.torque_quantum or 0.0) * (factor or 0.0)}

        def parameters(axis: AxisScene, factor: float | None = factor) -> Mapping[str, float | None]:
            return {"rated_torque": None if factor is None else (axis.parameters.rated_torque or 0.0) * factor}

        setting = "ideal" if factor is None else f"{(quantum or 0.0) * factor:g} {unit}"
        changed = _with_loops(base, change, parameters)
        found.append(_group_variant("torque step", setting, changed, fineness=fineness(factor, -1.0)))
    return found


def _group_encoders(base: Scene) -> list[Variant]:
    found, given = [], base.axes[0].parameters
    for factor in (0.01, 0.1, 10.0, None):

        def change(axis: AxisScene, factor: float | None = factor) -> Mapping[str, float | None]:
            return {"encoder_count": 0.0 if factor is None else axis.loop.encoder_count / factor}

        def parameters(axis: AxisScene, factor: float | None = factor) -> Mapping[str, float | None]:
            return {"counts_per_unit": axis.parameters.counts_per_unit * (factor or 0.0)}

        setting = "ideal" if factor is None else f"{1.0 / (abs(given.counts_per_unit) * factor):.3g} {given.unit}"
        changed = _with_loops(base, change, parameters)
        found.append(_group_variant("encoder count", setting, changed, fineness=fineness(factor, 1.0)))
    return found


_Changes = Callable[[AxisScene], Mapping[str, float | None]]


def _with_loops(scene: Scene, loop: _Changes, parameters: _Changes = lambda _axis: {}) -> Scene:
    """Return the scene with changes to what is known of the loop of every axis, and to its drive."""
    axes = tuple(
        replace(
            axis, loop=axis.loop.model_copy(update=loop(axis)),
            parameters=axis.parameters.model_copy(update=parameters(axis)),
        )
        for axis in scene.axes
    )  # fmt: skip
    return replace(scene, axes=axes)
