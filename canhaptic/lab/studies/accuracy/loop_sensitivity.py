"""Sensitivity of a loop to its sample rate, delay, algorithm, velocity filter, resolution or encoder, one at a time.

Every variant of an axis or a group is rendered without a bus and compared with the continuous environment on a time
grid common to all rates; the bus load is computed.
"""

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from canhaptic.axis_units import effort_unit
from canhaptic.control.passivity import LITERATURE
from canhaptic.drive.can.bus_budget import bus_budget
from canhaptic.drive.can.pdo_map import choose_map
from canhaptic.drive.clock import ProcessorClock
from canhaptic.errors import ParameterError
from canhaptic.lab.batch import WORTH_COMPILING, WORTH_COMPILING_GROUPS, ChosenEngine, Engine, chosen_engine
from canhaptic.lab.batch.scalar import render, work_of
from canhaptic.lab.loop import axis_loop
from canhaptic.lab.loop.axis_loop import at_rate
from canhaptic.lab.reference import ContinuousRun
from canhaptic.lab.studies import Row
from canhaptic.scene.buses import can_bus, kind_of
from canhaptic.scene.load import with_loops
from canhaptic.scene.models import AxisScene, Scene
from canhaptic.scene.parts import controller_of
from canhaptic.sim.plant import AccuracyParameters
from canhaptic.sim.plant.propagator import Array

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
_IDEAL: Final = 1e9
"""Number that represents in JSON the infinite fineness of a method without a step."""
_ERRORS: Final = ("position_error", "force_error", "energy_error")
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
            return render(self.case, cycles, axis_loop.Reach.around(motion), tick, engine)
        furthest = _TRAVELS * float(np.abs(motion).max()) + float(np.ptp(motion, axis=0).max())
        return render(self.scene, cycles, axis_loop.Reach(-furthest, furthest), tick, engine)

    def work(self, cycles: int) -> tuple[str, float]:
        """Return the name of the code to compile, and the cost of the run in cycles of a light plant."""
        if not self.scene.groups:
            return self.case.algorithm, work_of(self.case, cycles)
        is_coarse = any(axis.loop.encoder_count for axis in self.scene.axes)  # decides the lengths of the buffers
        compiled = f"{_algorithm_of(self.scene)} {self.sample_time_ns} {self.scene.bus.delay} {is_coarse}"
        return compiled, cycles * WORTH_COMPILING / WORTH_COMPILING_GROUPS


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
    return [*found, *_delays(base, whole), *algorithms(base), *_filters(base), *_torques(base), *_encoders(base),
            *_without_encoder_effects(base)]  # fmt: skip


def settings_now(scene: Scene) -> dict[str, str]:
    """Return the scene's own values of the settings that variants change, by kind of change."""
    found = {"sample rate": hertz(scene.bus.rate), "RPDO": scene.bus.rpdo, "algorithm": _algorithm_of(scene)}
    axis, parameters = scene.axes[0].parameters, scene.ports[0].passivity.parameters
    if "velocity" in type(parameters).model_fields:
        found["velocity"] = getattr(parameters, "velocity", "last")
    if axis.rated_torque is not None:
        found["torque step"] = f"{axis.rated_torque * 1e-3:g} {effort_unit(axis.unit)}"
    found["encoder count"] = f"{1.0 / abs(axis.counts_per_unit):.3g} {axis.unit}"
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


def algorithms(base: Scene) -> Iterator[Variant]:
    """Yield the scene under each other algorithm for which it gives, or its plant has, the required values."""
    for name, place in base.ports[0].algorithms.table.items():
        if name != _algorithm_of(base) and LITERATURE.get(name) != place:  # which are only to compare with papers
            try:
                found = axis_loop.under(base, name)
            except ParameterError:
                continue
            yield Variant("algorithm", name, found.permitted(), remark=found.remark)


def _filters(base: Scene) -> Iterator[Variant]:
    [port] = base.ports
    parameters = port.passivity.parameters
    if "velocity" not in type(parameters).model_fields:
        return
    other = "last" if getattr(parameters, "velocity", "last") == "windowed" else "windowed"
    changed = port.passivity._replace(parameters=parameters.model_copy(update={"velocity": other}))
    yield Variant("velocity", other, base.with_port(port._replace(passivity=changed)))


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
    every = (effect.name for axis in base.axes if axis.simulation for effect in axis.simulation.effects)
    for name in dict.fromkeys(name for name in every if name in _ENCODER_EFFECTS):
        axes = tuple(_without(axis, name) for axis in base.axes)
        yield Variant("effect", f"without {name}", replace(base, axes=axes))


def _without(axis: AxisScene, name: str) -> AxisScene:
    """Return an axis whose plant lacks an effect."""
    if axis.simulation is None:
        return axis
    rest = tuple(effect for effect in axis.simulation.effects if effect.name != name)
    return replace(axis, simulation=replace(axis.simulation, effects=rest))


def loop_row(
    variant: Variant, scene: Scene, exact: ContinuousRun, step_ns: int, duration_ns: int, tick: Callable[[], None],
    engine: ChosenEngine = "python",
) -> tuple[Row, axis_loop.LoopRun]:  # fmt: skip
    """Return the row of one variant, and its run.

    Args:
        variant: Variant of the loop.
        scene: Whole scene, whose axes share the bus.
        exact: Motion of the continuous axis or group, at least as finely sampled as the variant.
        step_ns: Time between two of its readings [ns].
        duration_ns: Length of the run [ns].
        tick: Called once a cycle; may raise to abort.
        engine: Engine of the axis's loop.
    """
    period, clock = variant.sample_time_ns, ProcessorClock()
    begin = clock.now()
    run = variant.render(duration_ns // period + 1, exact.position, tick, engine)
    seconds, stable = (clock.now() - begin) * 1e-9, not run.ended
    row = {
        "group": variant.group,
        "setting": variant.setting,
        "is_scene": variant.is_scene,
        "remark": variant.remark or run.reason,
        "engine": run.engine,
        "fineness": None if variant.fineness is None else min(variant.fineness, _IDEAL),
        "largest_torque": float(np.abs(run.torque).max(initial=0.0)),
        "status": "ok" if stable else "unstable" if run.ended == "diverged" else run.ended,
        **dict(zip(_ERRORS, _errors(run, exact, step_ns, period) if stable else (None, None, None), strict=True)),
        "energy_uncertainty": run.believed_error,
        "energy_given_out": -run.least_interaction,
        "cpu_per_second": seconds / (duration_ns * 1e-9),
        "rate": variant.scene.bus.rate,
        **bus_figures(variant, scene),
    }
    return row, run


def _errors(run: axis_loop.LoopRun, exact: ContinuousRun, step_ns: int, period: int) -> list[float]:
    """Return the largest errors of position, mean torque of a hold and energy."""
    stride = period // step_ns
    impulse = exact.impulse[::stride]
    mean = np.diff(impulse, axis=0, prepend=np.zeros_like(impulse[:1])) / (period * 1e-9)
    of_run = run.true_position, run.torque, run.interaction
    return largest_apart(of_run, (exact.position[::stride], mean, exact.interaction[::stride]))


def largest_apart(columns: Sequence[Array], exact: Sequence[Array]) -> list[float]:
    """Return the largest difference of each column of a run from what is exact at the same times, as far as both go."""
    shown = min(map(len, (*columns, *exact)))
    return [float(np.abs(of[:shown] - to[:shown]).max(initial=0.0)) for of, to in zip(columns, exact, strict=True)]


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
