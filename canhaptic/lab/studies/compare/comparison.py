"""Every algorithm on one scene, next to the continuous environment, judged by the plant's own energies.

    user + plant -> continuous environment        the reference: no sampling, no encoder, no limit of the torque
    user + plant -> encoder -> algorithm -> delay -> torque quantum and limit -> plant        once per algorithm

Without a bus by default (`DirectRig`: the same floats, a tenth of the time), compiled, or over the whole CAN path.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

from canhaptic.errors import InputError, ParameterError
from canhaptic.lab.batch.engine import WORTH_COMPILING, Engine, chosen_engine
from canhaptic.lab.batch.rendering import render_by, work_of
from canhaptic.lab.figures.figures import figures
from canhaptic.lab.loop.accounts_over_can import heading_of
from canhaptic.lab.loop.algorithms import able_under, chosen_algorithms, own_algorithms
from canhaptic.lab.loop.axis_loop import LoopCase, LoopRun, Recorder
from canhaptic.lab.loop.cost import microseconds_per_step
from canhaptic.lab.loop.over_can import render_over_can
from canhaptic.lab.loop.scenes import at_rate, cycles_of, environment_of, loop_case, plant_parts, require_single_axes
from canhaptic.lab.reference.continuous_reference import ContinuousReference, continuous_reference
from canhaptic.scene.models import AxisScene, Scene

_BATCH: Final = 64  # cycles between two reports of progress


@dataclass(frozen=True, slots=True)
class AxisComparison:
    """One axis: the continuous run, and one run per algorithm that could be built."""

    name: str
    unit: str
    reference: ContinuousReference | None
    runs: dict[str, LoopRun]


@dataclass(frozen=True, slots=True)
class Comparison:
    """What a comparison gave: plain values, and the runs behind them for the picture."""

    result: dict[str, Any]
    axes: tuple[AxisComparison, ...]
    sample_time: float


def compare(
    scene: Scene,
    algorithms: Sequence[str] | None = None,
    *,
    duration: float | None = None,
    rate: float | None = None,
    over_can: bool = False,
    engine: Engine = "python",
    repeats: int = 5,
    progress: Callable[[int], None] | None = None,
) -> Comparison:
    """Return every algorithm on every axis of a scene.

    Args:
        scene: With simulated drives.
        algorithms: Names of `ALGORITHMS`; all of them by default.
        duration: [s]; by default the scene's.
        rate: SYNCs per second instead of the scene's, also beyond what its bus could carry; not over CAN.
        over_can: Over the whole CAN path instead of `DirectRig`.
        engine: Engine without a bus: "python" gives the bits of the path over CAN, "numba" differs by rounding and
            saves time on stiff plants and long runs, "auto" takes it where it pays.
        repeats: Interleaved timings of a step, of which the least counts; 0 for none.
        progress: Called with the number of cycles done so far, of all runs together.

    Raises:
        InputError: Nothing is simulated, an unknown algorithm, or a rate over CAN.
    """
    names = chosen_algorithms(algorithms, own_algorithms(scene))
    _require_comparable(scene)
    if rate is not None:
        if over_can:
            raise InputError("--rate: changes the loop without a bus; with --can, use --set bus.rate=...")
        scene = at_rate(scene, rate)
    cycles = cycles_of(scene, duration)
    counter = _Counter(progress)
    references = [_reference(axis, scene.bus.sample_time_ns, cycles) for axis in scene.axes]
    if over_can:
        runs, remarks = _over_can(scene, names, cycles, counter)
    else:
        runs, remarks = _direct(scene, names, cycles, references, counter, engine)
    cost = _cost(scene, runs, repeats)
    axes = tuple(
        AxisComparison(axis.parameters.name, axis.parameters.unit, reference, run)
        for axis, (reference, _), run in zip(scene.axes, references, runs, strict=True)
    )
    result: dict[str, Any] = {**heading_of(scene, cycles, "can" if over_can else "direct")}
    result["axes"] = {
        axis.name: _account(scene, axis, index, references[index][1], names, remarks[index], cost[index])
        for index, axis in enumerate(axes)
    }
    return Comparison(result, axes, scene.bus.sample_time)


def _require_comparable(scene: Scene) -> None:
    require_single_axes(scene, "compare")
    if not all(axis.simulation is not None for axis in scene.axes):
        raise InputError(f"{scene.source}: has no `simulation`, expected a plant and a user to compare on; add one")


class _Counter:
    """Cycles done, reported now and then."""

    def __init__(self, progress: Callable[[int], None] | None) -> None:
        self._progress, self._done = progress, 0

    def __call__(self) -> None:
        self._done += 1
        if self._progress is not None and self._done % _BATCH == 0:
            self._progress(self._done)


_Reference = tuple[ContinuousReference | None, str]


def _reference(axis: AxisScene, sample_time_ns: int, cycles: int) -> _Reference:
    plant, user, effects, seed = plant_parts(axis)
    try:
        found = continuous_reference(environment_of(axis), plant, user, effects, sample_time_ns, cycles, seed)
    except InputError as error:
        return None, f"none: {error}"
    return found, found.method


def _direct(
    scene: Scene, names: Sequence[str], cycles: int, references: Sequence[_Reference], counter: _Counter, engine: Engine
) -> tuple[list[dict[str, LoopRun]], list[dict[str, str]]]:
    runs: list[dict[str, LoopRun]] = []
    remarks: list[dict[str, str]] = []
    for axis, (reference, _) in zip(scene.axes, references, strict=True):
        runs.append({})
        remarks.append({})
        for name in names:
            try:
                chosen = able_under(axis, name, scene)
            except ParameterError as error:
                remarks[-1][name] = f"refused: {error}"
                continue
            remarks[-1][name] = chosen.remark
            recorder = None if reference is None else Recorder.around(reference.position)
            case = loop_case(chosen.axis, scene)
            computes = chosen_engine(engine, work_of(case, cycles) >= WORTH_COMPILING)
            runs[-1][name] = render_by(computes, case, cycles, recorder, counter)
    return runs, remarks


def _over_can(
    scene: Scene, names: Sequence[str], cycles: int, counter: _Counter
) -> tuple[list[dict[str, LoopRun]], list[dict[str, str]]]:
    runs: list[dict[str, LoopRun]] = [{} for _ in scene.axes]
    remarks: list[dict[str, str]] = [{} for _ in scene.axes]
    for name in names:
        try:
            built = [able_under(axis, name, scene) for axis in scene.axes]
        except ParameterError as error:
            for remark in remarks:
                remark[name] = f"refused: {error}"
            continue
        found = render_over_can(replace(scene, axes=tuple(one.axis for one in built)), cycles, counter)
        for index, run in enumerate(found):
            runs[index][name], remarks[index][name] = run, built[index].remark
    return runs, remarks


def _cost(scene: Scene, runs: Sequence[dict[str, LoopRun]], repeats: int) -> list[dict[str, float]]:
    costs = []
    for axis, of_axis in zip(scene.axes, runs, strict=True):
        cases: dict[str, tuple[LoopCase, LoopRun]] = {}
        for name, run in of_axis.items():
            cases[name] = loop_case(able_under(axis, name, scene).axis, scene), run
        costs.append(microseconds_per_step(cases, repeats) if repeats else {})
    return costs


def _account(
    scene: Scene,
    axis: AxisComparison,
    index: int,
    method: str,
    names: Sequence[str],
    remarks: dict[str, str],
    cost: dict[str, float],
) -> dict[str, Any]:
    environment = environment_of(scene.axes[index])
    accounts: dict[str, Any] = {}
    for name in names:
        run = axis.runs.get(name)
        found = (
            {}
            if run is None or not run.position.size
            else figures(environment, run, axis.reference, scene.bus.sample_time)
        )
        accounts[name] = {
            "status": "refused" if run is None else run.ended or "completed",
            "remark": "; ".join(text for text in (remarks.get(name, ""), "" if run is None else run.reason) if text),
            "engine": None if run is None else run.engine,
            **found,
            "microseconds_per_step": cost.get(name),
        }
    reference = axis.reference
    return {
        "unit": axis.unit,
        "environment": scene.axes[index].environment.name,
        "reference": {
            "method": method,
            "travel": None if reference is None else reference.travel,
            "force_variation": None if reference is None else reference.variation,
        },
        "algorithms": accounts,
    }
