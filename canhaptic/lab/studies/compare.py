"""Every algorithm on one scene: axes, displays and groups.

Every algorithm on one scene, next to the continuous environment, judged by the plant's own energies.

    user + plant -> continuous environment        the reference: no sampling, no encoder, no limit of the torque
    user + plant -> encoder -> algorithm -> delay -> torque quantum and limit -> plant        once per algorithm

Without a bus by default (`DirectRig`: the same floats, a tenth of the time), compiled, or over the whole CAN path.

Every algorithm on the admittance displays of one scene, over its simulated drives: accounts and true energies.

Every group algorithm on one scene: the accounts of its groups, and the true energies.

Over its simulated drives, or compiled without a bus. There is no continuous reference: the effect of a group on its
network is judged by the plant's own energies alone.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, TypedDict, cast

from canhaptic.control.admittance import DISPLAY_ALGORITHMS, DISPLAY_GROUP_ALGORITHMS
from canhaptic.control.multi_axis import GROUP_ALGORITHMS
from canhaptic.control.verdict import PortResult, passive_verdict
from canhaptic.errors import InputError, ParameterError
from canhaptic.lab.batch.continuous import continuous_reference
from canhaptic.lab.batch.engine import WORTH_COMPILING, WORTH_COMPILING_GROUPS, Engine, chosen_engine
from canhaptic.lab.batch.scalar import render_by, render_group, work_of
from canhaptic.lab.figures.figures import figures
from canhaptic.lab.loop.axis_loop import (
    EVERYWHERE,
    LoopCase,
    LoopRun,
    Reach,
    able_under,
    at_rate,
    chosen_algorithms,
    cycles_of,
    display_group_under,
    display_under,
    environment_of,
    group_under,
    loop_case,
    microseconds_per_step,
    own_algorithms,
    parts_of,
    plant_parts,
    require_single_axes,
)
from canhaptic.lab.loop.over_can import (
    Heading,
    Progress,
    accounts_over_can,
    heading_of,
    known_algorithms,
    render_over_can,
)
from canhaptic.lab.reference import ContinuousReference
from canhaptic.lab.studies import Row
from canhaptic.result import TruthResult
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
    """Result of a comparison: plain values, and the runs behind them for the picture."""

    result: Row
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
    """Return the results of every algorithm on every axis of a scene.

    Args:
        scene: Scene with simulated drives.
        algorithms: Names of `ALGORITHMS`; all of them by default.
        duration: Duration [s]; by default the scene's.
        rate: Rate that replaces the scene's [Hz], possibly beyond its bus; not over CAN.
        over_can: Whether the whole CAN path is used instead of `DirectRig`.
        engine: Engine without a bus: "python" gives the bits of the path over CAN, "numba" differs by rounding and
            saves time on stiff plants and long runs, "auto" takes it where it is worthwhile.
        repeats: Interleaved timings of a step, of which the minimum counts; 0 for none.
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
    result: Row = {**heading_of(scene, cycles, "can" if over_can else "direct")}
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
    plant, user, effects, _ = plant_parts(axis)
    try:
        found = continuous_reference(environment_of(axis), plant, user, effects, sample_time_ns, cycles)
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
            reach = EVERYWHERE if reference is None else Reach.around(reference.position)
            case = loop_case(chosen.axis, scene)
            computes = chosen_engine(engine, work_of(case, cycles) >= WORTH_COMPILING)
            runs[-1][name] = render_by(computes, case, cycles, reach, counter)
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
) -> Row:
    environment = environment_of(scene.axes[index])
    accounts: Row = {}
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


class AdmittanceRunCompared(TypedDict, total=False):
    """A display under one algorithm; a refused one has only status and remark."""

    status: str
    remark: str
    account: PortResult
    truth: TruthResult


class DisplaysCompared(Heading):
    """All displays of a scene, by algorithm."""

    axes: dict[str, dict[str, AdmittanceRunCompared]]


def display_algorithms(algorithms: Sequence[str] | None) -> list[str]:
    """Return the requested names; see `known_algorithms`."""
    return known_algorithms(DISPLAY_ALGORITHMS, "admittance algorithm", algorithms)


def compare_displays(
    scene: Scene,
    algorithms: Sequence[str] | None = None,
    *,
    duration: float | None = None,
    progress: Callable[[int], None] | None = None,
) -> DisplaysCompared:
    """Return the account of every axis, and of every group, under each algorithm, as plain values.

    Args:
        scene: Scene whose axes are admittance displays, with drives simulated in this process.
        algorithms: Names of `DISPLAY_ALGORITHMS`; by default all, or all group algorithms if there are only groups.
        duration: Duration [s]; by default the scene's.
        progress: Called with the number of cycles done so far, of all runs together.

    Raises:
        InputError: The drives are not simulated in this process.
        ParameterError: An unknown algorithm.
    """
    names, cycles = display_algorithms(algorithms), cycles_of(scene, duration)
    if algorithms is None and all(axis.group for axis in scene.axes):
        names = list(DISPLAY_GROUP_ALGORITHMS)
    runs = accounts_over_can(scene, names, cycles, _scene_under, progress)
    axes = list(parts_of(scene))
    return {
        **heading_of(scene, cycles),
        "axes": {axis: {name: _of_axis(axis, found) for name, found in runs.items()} for axis in axes},
    }


def _scene_under(scene: Scene, name: str) -> Scene:
    groups = tuple(display_group_under(group, name) for group in scene.groups)
    axes = tuple(axis if axis.group else display_under(axis, name) for axis in scene.axes)
    return replace(scene, axes=axes, groups=groups)


def _of_axis(axis: str, found: Mapping[str, Any]) -> AdmittanceRunCompared:
    if "ports" not in found:
        return {"status": found["status"], "remark": found["remark"]}
    status = f"{found['status']}: {found['remark']}" if found["remark"] else found["status"]
    return {"status": status, "account": found["ports"][axis], "truth": found["truth"][axis]}


class TrueEnergies(TypedDict):
    """True energies of a group [J]."""

    interaction: float
    least_interaction: float
    believed_error: float


class ComparedGroup(PortResult, total=False):
    """The account of a group under one algorithm; a refused one has only the first three fields."""

    status: str
    remark: str
    engine: str | None
    truth: TrueEnergies | None


class GroupCompared(TypedDict):
    """A group under all algorithms."""

    axes: list[str]
    network: str
    unit: str
    algorithms: dict[str, ComparedGroup]


class GroupsCompared(Heading):
    """All groups of a scene."""

    groups: dict[str, GroupCompared]


def compare_groups(
    scene: Scene,
    algorithms: Sequence[str] | None = None,
    *,
    duration: float | None = None,
    engine: Engine = "python",
    progress: Callable[[int], None] | None = None,
) -> GroupsCompared:
    """Return the accounts of every group of a scene under each algorithm, as plain values.

    Args:
        scene: Scene with groups, with all drives simulated in this process. Axes outside groups keep their
            own algorithm.
        algorithms: Names of `GROUP_ALGORITHMS`; all of them by default.
        duration: Duration [s]; by default the scene's.
        engine: "python" uses the whole CAN path, "numba" compiles each group with its motors, without a bus;
            "auto" compiles where that is worthwhile.
        progress: Called with the number of cycles done so far, of all runs together.

    Raises:
        InputError: The drives are not simulated in this process.
        ParameterError: An unknown algorithm.
    """
    names, cycles = group_algorithms(algorithms), cycles_of(scene, duration)
    chosen = chosen_engine(engine, len(names) * len(scene.groups) * cycles >= WORTH_COMPILING_GROUPS)
    accounts = _groups_over_can if chosen == "python" else _without_bus
    found = accounts(scene, names, cycles, progress)
    return {
        **heading_of(scene, cycles, "can" if chosen == "python" else "direct"),
        "groups": {
            group.name: {
                "axes": list(group.axes),
                "network": group.network.name,
                "unit": scene.axis(group.axes[0]).parameters.unit,
                "algorithms": found[group.name],
            }
            for group in scene.groups
        },
    }


def group_algorithms(algorithms: Sequence[str] | None) -> list[str]:
    """Return the requested names; see `known_algorithms`."""
    return known_algorithms(GROUP_ALGORITHMS, "group algorithm", algorithms)


def _groups_under(scene: Scene, name: str) -> Scene:
    return replace(scene, groups=tuple(group_under(group, name) for group in scene.groups))


_Accounts = dict[str, dict[str, ComparedGroup]]
"""By group and algorithm."""


def _groups_over_can(scene: Scene, names: Sequence[str], cycles: int, progress: Progress | None) -> _Accounts:
    runs = accounts_over_can(scene, names, cycles, _groups_under, progress)
    return {group.name: {name: _of_group(group.name, found) for name, found in runs.items()} for group in scene.groups}


def _of_group(name: str, found: Mapping[str, Any]) -> ComparedGroup:
    account: ComparedGroup = {"status": found["status"], "remark": found["remark"], "engine": "python"}
    if "ports" in found:
        account.update(found["ports"][name])
        account["truth"] = found["truth"].get(name)
    return account


def _without_bus(scene: Scene, names: Sequence[str], cycles: int, progress: Progress | None) -> _Accounts:
    parts, found, done = parts_of(scene), _Accounts(), 0
    for group in scene.groups:
        found[group.name] = {}
        for name in names:
            found[group.name][name] = _compiled(parts[group.name], name, cycles)
            done += cycles
            if progress is not None:
                progress(done // len(scene.groups))
    return found


def _compiled(scene: Scene, name: str, cycles: int) -> ComparedGroup:
    """Return the account of one group; whether it was passive is what the plant's own energies say."""
    try:
        run = render_group("numba", _groups_under(scene, name), cycles)
    except ParameterError as error:
        return {"status": "refused", "remark": str(error), "engine": None}
    account = cast("ComparedGroup", run.summary.as_json(scene.bus.sample_time))  # it has the keys of both
    account["status"], account["engine"] = run.ended or "completed", run.engine
    account["remark"] = "; ".join(text for text in (run.reason, run.engine.partition(": ")[2]) if text)
    account["passive"] = passive_verdict(run.least_interaction)[0]
    account["truth"] = {
        "interaction": float(run.interaction[-1]) if run.interaction.size else 0.0,
        "least_interaction": run.least_interaction,
        "believed_error": run.believed_error,
    }
    return account
