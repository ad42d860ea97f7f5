"""Compare algorithms on one scene: its axes, admittance displays or groups, judged by the energies of the plant.

    user + plant -> continuous environment        the reference of an axis: no sampling, encoder or limit
    user + plant -> encoder -> algorithm -> delay -> torque quantum and limit -> plant        once per algorithm

Axes run without a bus by default (the same floats as over CAN, in a tenth of the time), compiled, or over the whole CAN
path. Admittance displays run over their simulated drives, and so do groups unless they run compiled without a bus;
neither has a continuous reference.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import count, product
from typing import Final, NamedTuple

import numpy as np

from canhaptic.control.verdict import passive_verdict
from canhaptic.drive.profile.causality import IMPEDANCE
from canhaptic.errors import InputError, ParameterError
from canhaptic.lab.batch import WORTH_COMPILING, WORTH_COMPILING_GROUPS, Engine, chosen_engine
from canhaptic.lab.batch.scalar import continuous_reference, render, work_of
from canhaptic.lab.figures.figures import OUTCOMES, figures, outcomes
from canhaptic.lab.loop import axis_loop
from canhaptic.lab.loop.axis_loop import UnderAlgorithm
from canhaptic.lab.loop.over_can import Progress, accounts_over_can, heading_of, render_over_can
from canhaptic.lab.reference import ContinuousReference
from canhaptic.lab.studies import Row
from canhaptic.quantities import with_old_names
from canhaptic.scene.models import AxisScene, Port, Scene

_BATCH: Final = 64  # cycles between two reports of progress


@dataclass(frozen=True, slots=True)
class AxisComparison:
    """Runs of one axis: the continuous one, and one for each algorithm that does not refuse it."""

    name: str
    unit: str
    reference: ContinuousReference | None
    runs: dict[str, axis_loop.LoopRun]


@dataclass(frozen=True, slots=True)
class Comparison:
    """Result of a comparison: plain values, and the runs of single axes behind them for the picture."""

    result: Row
    axes: tuple[AxisComparison, ...]
    sample_time: float

    def __repr__(self) -> str:
        ports = [*self.result.get("axes", ()), *self.result.get("groups", ())]
        return f"<Comparison of {', '.join(ports)}: figures in `result`, runs of single axes in `axes`>"


class Case(NamedTuple):
    """One column of a comparison."""

    scene: Scene  # the scene of the comparison, but for the parameters of a user's own algorithm
    algorithm: str  # its name in that scene
    shown: str  # its name in the result


def compared_algorithms(scene: Scene, algorithms: Sequence[str] | None) -> list[str]:
    """Return the requested algorithms without repetitions; for None all that fit the scene's axes, displays or groups.

    Raises:
        ParameterError: A name is unknown.
    """
    own = dict.fromkeys(axis.passivity.name for axis in scene.axes if axis.passivity.own is not None)
    return axis_loop.chosen_algorithms(algorithms, scene.ports[0].algorithms, list(own))


def compare(
    scene: Scene,
    algorithms: Sequence[str | Case] | None = None,
    *,
    duration: float | None = None,
    rate: float | None = None,
    over_can: bool = False,
    engine: Engine = "python",
    repeats: int = 5,
    progress: Progress | None = None,
) -> Comparison:
    """Return the results of every algorithm on every axis, admittance display or group of a scene.

    Args:
        scene: Scene with simulated drives.
        algorithms: Names of `compared_algorithms`, and cases of single axes; all that have a name by default.
        duration: Duration [s]; by default the scene's.
        rate: Rate that replaces the scene's [Hz], possibly beyond its bus; for single axes, not over CAN.
        over_can: Whether the whole CAN path is used instead of a loop without a bus.
        engine: Engine without a bus: "python" gives the same bits as the path over CAN, "numba" differs by rounding and
            saves time on stiff plants and long runs, "auto" chooses numba where it saves time.
        repeats: Interleaved timings of a step of a single axis, of which the minimum counts; 0 for none.
        progress: Called with the number of cycles done so far, of all runs together.

    Raises:
        InputError: Nothing is simulated, an algorithm is unknown, axes are of several kinds, or a rate is given with
            CAN.
    """
    cases = _cases(scene, algorithms)
    if rate is not None:
        _require_rate(scene, over_can=over_can)
        scene = axis_loop.at_rate(scene, rate)
        cases = [case._replace(scene=axis_loop.at_rate(case.scene, rate)) for case in cases]
    cycles, names = axis_loop.cycles_of(scene, duration), [case.algorithm for case in cases]
    if has_references(scene):
        return _of_axes(scene, cases, cycles, _counter(progress), None if over_can else engine, repeats)
    result = _of_ports(scene, names, cycles, "python" if over_can else engine, progress)
    return Comparison(result, (), scene.bus.sample_time)


def _cases(scene: Scene, algorithms: Sequence[str | Case] | None) -> list[Case]:
    """Return the columns of a comparison, each once, in the order in which they were asked for."""
    every = [] if algorithms else [Case(scene, name, name) for name in compared_algorithms(scene, None)]
    for one in algorithms or ():
        case = Case(scene, one, one) if isinstance(one, str) else one
        compared_algorithms(case.scene, [case.algorithm])  # refuses an unknown name
        every.append(case)
    return list({case.shown: case for case in every}.values())


def has_references(scene: Scene) -> bool:
    """Whether every port is one torque axis, which has a continuous run and a loop without a bus."""
    return all(port.causality is IMPEDANCE and not port.section for port in scene.ports)


def _require_rate(scene: Scene, *, over_can: bool) -> None:
    """Refuse another rate for runs that use the drives of the scene; raise InputError."""
    if over_can or not has_references(scene):
        text = "--rate: changes the loop without a bus, of torque axes outside groups"
        raise InputError(f"{text}; for this comparison use --set bus.rate=...")


def _counter(progress: Progress | None) -> Callable[[], None]:
    """Return a function that counts cycles and reports every `_BATCH` of them."""
    cycles = count(1)

    def tick() -> None:
        done = next(cycles)
        if progress is not None and done % _BATCH == 0:
            progress(done)

    return tick


def reference_of(scene: Scene, cycles: int) -> tuple[ContinuousReference | None, str]:
    """Return the continuous run of the only axis of a scene and its method; None and the reason if there is none."""
    (axis,), period = scene.axes, scene.bus.sample_time_ns
    plant, user, effects, _ = axis_loop.plant_parts(axis)
    try:
        found = continuous_reference(axis_loop.environment_of(axis), plant, user, effects, period, cycles)
    except InputError as error:
        return None, f"none: {error}"
    return found, found.method


def _of_axes(
    scene: Scene, asked: Sequence[Case], cycles: int, counter: Callable[[], None], engine: Engine | None, repeats: int
) -> Comparison:
    """Compare algorithms on single axes, with an engine without a bus, or over CAN where `engine` is None."""
    axis_loop.require_near(scene)
    if not all(axis.simulation is not None for axis in scene.axes):
        raise InputError(f"{scene.source}: has no `simulation`, expected a plant and a user to compare on; add one")
    alone = axis_loop.parts_of(scene).values()
    references = [reference_of(part, cycles) for part in alone]
    tried: list[dict[str, _Tried]] = [{} for _ in alone]
    for given, name, shown in asked:
        cases = [axis_loop.tried(part, name) for part in axis_loop.parts_of(given).values()]
        known = [case.scene for case in cases if case.scene is not None]
        if engine is not None:
            runs = [
                None if case.scene is None else run_axis(case.scene, reference, cycles, engine, counter)
                for case, (reference, _) in zip(cases, references, strict=True)
            ]
        elif len(known) == len(cases):
            runs = [*render_over_can(replace(given, axes=tuple(of.axes[0] for of in known)), cycles, counter)]
        else:  # all axes run together
            refused = next(case for case in cases if case.scene is None)
            cases, runs = [refused] * len(cases), [None] * len(cases)
        for axis, own, case, run in zip(tried, given.axes, cases, runs, strict=True):
            axis[shown] = _Tried(own, case, run)
    axes = [_of_axis(scene, *row, repeats) for row in zip(scene.axes, references, tried, strict=True)]
    result = {**heading_of(scene, cycles, "can" if engine is None else "direct")}
    accounts = {axis.name: account for axis, account in axes}
    return Comparison({**result, "axes": accounts}, tuple(axis for axis, _ in axes), scene.bus.sample_time)


def run_axis(
    scene: Scene, reference: ContinuousReference | None, cycles: int, engine: Engine = "python",
    counter: Callable[[], None] | None = None,
) -> axis_loop.LoopRun:  # fmt: skip
    """Return the run of the only axis of a scene without a bus; it diverged where it left the reference's reach."""
    reach = axis_loop.EVERYWHERE if reference is None else axis_loop.Reach.around(reference.position)
    case = axis_loop.loop_case(scene.axes[0], scene)
    return render(case, cycles, reach, counter, chosen_engine(engine, work_of(case, cycles) >= WORTH_COMPILING))


class _Tried(NamedTuple):
    """One algorithm on one axis."""

    given: AxisScene  # before its algorithm was exchanged
    case: UnderAlgorithm
    run: axis_loop.LoopRun | None  # None: refused


def _of_axis(
    scene: Scene, axis: AxisScene, found: tuple[ContinuousReference | None, str], tried: Mapping[str, _Tried],
    repeats: int,
) -> tuple[AxisComparison, Row]:  # fmt: skip
    """Return the runs of one axis, and their account as plain values."""
    reference, method = found
    runs = {name: of.run for name, of in tried.items() if of.run is not None}
    cases = {name: (axis_loop.loop_case(of.case.scene.axes[0], scene), runs[name]) for name, of in tried.items()
             if of.case.scene is not None}  # fmt: skip
    cost = axis_loop.microseconds_per_step(cases, repeats) if repeats else {}
    accounts = {}
    for name, (given, case, run) in tried.items():
        remarks = (f"refused: {case.remark}",) if run is None else (case.remark, run.reason)
        accounts[name] = {
            "status": "refused" if run is None else run.ended or "completed",
            "remark": "; ".join(filter(None, remarks)),
            "engine": None if run is None else run.engine,
            **(figures(axis_loop.environment_of(axis), run, reference, scene.bus.sample_time,
                       axis.parameters.torque_limit) if run is not None and run.position.size else {}),
            "hand_force": getattr(given.passivity.parameters, "hand_force", None),
            "microseconds_per_step": cost.get(name),
        }  # fmt: skip
    account = {
        "unit": axis.parameters.unit,
        "environment": axis.environment.name,
        "reference": {
            "method": method,
            "travel": None if reference is None else reference.travel,
            "force_variation": None if reference is None else reference.variation,
        },
        "algorithms": accounts,
    }
    return AxisComparison(axis.parameters.name, axis.parameters.unit, reference, runs), account


def _of_ports(scene: Scene, names: Sequence[str], cycles: int, engine: Engine, progress: Progress | None) -> Row:
    """Return the comparison of ports without a continuous run: over the whole CAN path, or compiled without a bus."""
    ports = scene.ports
    if alone := ", ".join(port.name for port in ports if not port.section and port.causality is IMPEDANCE):
        raise InputError(f"{scene.source}: has torque axes by themselves ({alone}), and others; make a scene of each")
    pays = len(names) * len(ports) * cycles >= WORTH_COMPILING_GROUPS
    torques = all(port.causality is IMPEDANCE for port in ports)
    is_direct = torques and chosen_engine(engine, pays) == "numba"
    found = (_compiled if is_direct else _over_can)(scene, names, cycles, progress)
    heading = heading_of(scene, cycles, "direct" if is_direct else "can")
    if not torques:
        return {**heading, "axes": found}
    groups = {
        port.name: {
            "axes": [axis.parameters.name for axis in port.axes],
            "network": port.rendered.name,
            "unit": port.axes[0].parameters.unit,
            "algorithms": found[port.name],
        }
        for port in ports
    }
    return {**heading, "groups": groups}


def _over_can(scene: Scene, names: Sequence[str], cycles: int, progress: Progress | None) -> dict[str, Row]:
    """Return the accounts of each port over the whole CAN path, by algorithm."""
    runs = accounts_over_can(scene, names, cycles, progress)
    return {port.name: {name: _account(port, of) for name, of in runs.items()} for port in scene.ports}


def _account(port: Port, found: Row) -> Row:
    """Return the account of a port in a run over CAN; of drives that take velocities it is an entry of its own."""
    status, remark = found["status"], found["remark"]
    account = {"status": status, "remark": remark}
    if port.causality is IMPEDANCE:
        account["engine"] = "python"
    if "ports" not in found:
        return account
    own, truth = found["ports"][port.name], found["truth"].get(port.name)
    outcome = own["verdict"] if own["verdict"] in OUTCOMES else ""  # by the headline of the port
    if port.causality is IMPEDANCE:
        return {**account, **own, "outcome": outcome, "truth": truth}
    return {"status": ": ".join(filter(None, (status, remark))), "outcome": outcome, "account": own, "truth": truth}


def _compiled(scene: Scene, names: Sequence[str], cycles: int, progress: Progress | None) -> dict[str, Row]:
    """Return the accounts of each port without a bus, by algorithm."""
    parts, found = axis_loop.parts_of(scene), {port.name: Row() for port in scene.ports}
    for done, (port, name) in enumerate(product(found, names), 1):
        found[port][name] = _account_of_run(parts[port], name, cycles)
        if progress is not None:
            progress(done * cycles // len(found))
    return found


def _account_of_run(scene: Scene, name: str, cycles: int) -> Row:
    """Return the account of the only port; the plant's own energies say whether it was passive."""
    try:
        run = render(axis_loop.under(scene, name).permitted(), cycles, engine="numba")
    except ParameterError as error:
        return {"status": "refused", "remark": str(error), "engine": None}
    account: Row = {**run.summary.as_json(scene.bus.sample_time)}
    account["status"], account["engine"] = run.ended or "completed", run.engine
    account["remark"] = "; ".join(text for text in (run.reason, run.engine.partition(": ")[2]) if text)
    account["passive"] = passive_verdict(run.least_interaction)[0]
    known = {"contact": np.isfinite(run.damping).mean(), "torque_peak": np.abs(run.torque).max(initial=0.0)}
    account["outcome"] = OUTCOMES[int(outcomes(known.get))]
    truth = {
        "interaction": float(run.interaction[-1]) if run.interaction.size else 0.0,
        "least_interaction": run.least_interaction,
        "accounted_error": run.believed_error,
    }
    account["truth"] = with_old_names(truth)
    return account
