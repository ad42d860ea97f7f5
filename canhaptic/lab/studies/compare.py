"""Compare algorithms on one scene: its axes, admittance displays or groups, judged by the energies of the plant.

    user + plant -> continuous environment        the reference of an axis: no sampling, encoder or limit
    user + plant -> encoder -> algorithm -> delay -> torque quantum and limit -> plant        once per algorithm

Axes run without a bus by default (the same floats as over CAN, in a tenth of the time), compiled, or over the whole CAN
path. Admittance displays run over their simulated drives, and so do groups unless they run compiled without a bus;
neither has a continuous reference.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import count, product
from typing import Final, NamedTuple

import numpy as np

from canhaptic.control.verdict import PASSIVE_TOLERANCE, passive_verdict
from canhaptic.drive.profile.causality import IMPEDANCE
from canhaptic.errors import InputError, ParameterError
from canhaptic.lab.batch import WORTH_COMPILING, WORTH_COMPILING_GROUPS, Engine, chosen_engine
from canhaptic.lab.batch.scalar import continuous_reference, render, work_of
from canhaptic.lab.figures.figures import OUTCOMES, figures, outcomes
from canhaptic.lab.loop import axis_loop
from canhaptic.lab.loop.axis_loop import UnderAlgorithm
from canhaptic.lab.loop.over_can import Progress, accounts_over_can, heading_of, render_over_can
from canhaptic.lab.reference import ContinuousReference
from canhaptic.lab.studies import Row, flat
from canhaptic.scene.method import simulation_of
from canhaptic.scene.models import Port, Scene

_BATCH: Final = 64  # cycles between two reports of progress


@dataclass(frozen=True, slots=True)
class Comparison:
    """Result of a comparison: plain values, and the runs of single axes behind them for the picture.

    Attributes:
        result: Plain values; `rows` has one row for each port and algorithm.
        runs: Axis -> algorithm -> run, of each algorithm that does not refuse the axis.
        references: Axis -> continuous run; None where there is none.
        sample_time: Sample time [s].
    """

    result: Row
    runs: dict[str, dict[str, axis_loop.LoopRun]]
    references: dict[str, ContinuousReference | None]
    sample_time: float

    def __repr__(self) -> str:
        ports = dict.fromkeys(row["port"] for row in self.result["rows"])
        return f"<Comparison of {', '.join(ports)}: figures in `result`, runs of single axes in `runs`>"


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
    return Comparison(result, {}, {}, scene.bus.sample_time)


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
    try:
        found = continuous_reference(axis_loop.environment_of(axis), simulation_of(axis), period, cycles)
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
    references = {name: reference_of(part, cycles) for name, part in axis_loop.parts_of(scene).items()}
    runs: dict[str, dict[str, axis_loop.LoopRun]] = {name: {} for name in references}
    timed: dict[str, dict[str, tuple[axis_loop.LoopCase, axis_loop.LoopRun]]] = {name: {} for name in references}
    rows = []
    for case in asked:
        parts = axis_loop.parts_of(case.scene)
        tried = {name: axis_loop.tried(part, case.algorithm) for name, part in parts.items()}
        refused = next((one for one in tried.values() if one.scene is None), None)
        if engine is None and refused is not None:  # all axes run together
            tried = dict.fromkeys(tried, refused)
        known = {name: one.scene for name, one in tried.items() if one.scene is not None}
        if engine is not None:
            found = [run_axis(part, references[name][0], cycles, engine, counter) for name, part in known.items()]
        else:
            together = replace(case.scene, axes=tuple(of.axes[0] for of in known.values()))
            found = render_over_can(together, cycles, counter) if known else []
        for (name, part), run in zip(known.items(), found, strict=True):
            runs[name][case.shown] = run
            timed[name][case.shown] = axis_loop.loop_case(part.axes[0], scene), run
        for name, part in parts.items():
            rows.append(_row_of(part, case.shown, tried[name], runs[name].get(case.shown), *references[name]))
    costs = {name: axis_loop.microseconds_per_step(of, repeats) if repeats else {} for name, of in timed.items()}
    every = [{**row, "microseconds_per_step": costs[row["port"]].get(row["algorithm"])} for row in rows]
    result = {**heading_of(scene, cycles, "can" if engine is None else "direct"), "rows": every}
    return Comparison(result, runs, {name: of for name, (of, _) in references.items()}, scene.bus.sample_time)


def run_axis(
    scene: Scene, reference: ContinuousReference | None, cycles: int, engine: Engine = "python",
    counter: Callable[[], None] | None = None,
) -> axis_loop.LoopRun:  # fmt: skip
    """Return the run of the only axis of a scene without a bus; it diverged where it left the reference's reach."""
    reach = axis_loop.EVERYWHERE if reference is None else axis_loop.Reach.around(reference.position)
    case = axis_loop.loop_case(scene.axes[0], scene)
    return render(case, cycles, reach, counter, chosen_engine(engine, work_of(case, cycles) >= WORTH_COMPILING))


def _row_of(
    given: Scene, name: str, case: UnderAlgorithm, run: axis_loop.LoopRun | None,
    reference: ContinuousReference | None, method: str,
) -> Row:  # fmt: skip
    """Return the row of one algorithm on the only axis of a scene."""
    [axis] = given.axes
    known: Row = {}
    if run is not None and run.position.size:
        environment, limit = axis_loop.environment_of(axis), axis.parameters.torque_limit
        known = figures(environment, run, reference, given.bus.sample_time, limit)
    remarks = (f"refused: {case.remark}",) if run is None else (case.remark, run.reason)
    return {
        "port": axis.parameters.name,
        "unit": axis.parameters.unit,
        "environment": axis.environment.name,
        "reference.method": method,
        "reference.travel": None if reference is None else reference.travel,
        "reference.force_variation": None if reference is None else reference.variation,
        "algorithm": name,
        "status": "refused" if run is None else run.ended or "completed",
        "remark": "; ".join(filter(None, remarks)),
        "engine": None if run is None else run.engine,
        **known,
        "passive_by_plant": _passive(known),
        "hand_force": getattr(axis.passivity.parameters, "hand_force", None),
    }


def _passive(row: Row) -> str | None:
    """Return yes if, by the plant's energy, the handle never gave out more than it received; else no, or an outcome."""
    least = row.get("least_interaction")
    if least is None or least < -PASSIVE_TOLERANCE:
        return None if least is None else "no"
    return str(row["outcome"] or "yes")


def _of_ports(scene: Scene, names: Sequence[str], cycles: int, engine: Engine, progress: Progress | None) -> Row:
    """Return the comparison of ports without a continuous run: over the whole CAN path, or compiled without a bus."""
    ports = scene.ports
    if alone := ", ".join(port.name for port in ports if not port.section and port.causality is IMPEDANCE):
        raise InputError(f"{scene.source}: has torque axes by themselves ({alone}), and others; make a scene of each")
    pays = len(names) * len(ports) * cycles >= WORTH_COMPILING_GROUPS
    torques = all(port.causality is IMPEDANCE for port in ports)
    is_direct = torques and chosen_engine(engine, pays) == "numba"
    found = [*(_compiled if is_direct else _over_can)(scene, names, cycles, progress)]
    rows = [_of_port(port, row, truth) for port in ports for name, row, truth in found if name == port.name]
    return {**heading_of(scene, cycles, "direct" if is_direct else "can"), "rows": rows}


def _of_port(port: Port, row: Row, truth: Row) -> Row:
    """Return the row of a port: its account, and the energies of the plant in place of booked ones of that name."""
    booked = {"account.least_interaction": row["least_interaction"]} if "least_interaction" in row else {}
    whole = {"port": port.name, "environment": port.rendered.name, "unit": port.axes[0].parameters.unit,
             **({"axes": [axis.parameters.name for axis in port.axes]} if port.section else {}),
             **row, **booked, **truth}  # fmt: skip
    return {**whole, "passive_by_plant": _passive(whole)}


def _over_can(
    scene: Scene, names: Sequence[str], cycles: int, progress: Progress | None
) -> Iterator[tuple[str, Row, Row]]:
    """Yield port, account and energies of the plant under each algorithm, over the whole CAN path."""
    for name, found in accounts_over_can(scene, names, cycles, progress).items():
        for port in scene.ports:
            account = found.get("ports", {}).get(port.name, {})
            verdict = account.get("verdict")
            ended = {"algorithm": name, "status": found["status"], "remark": found["remark"], "engine": "python"}
            outcome = {"outcome": verdict if verdict in OUTCOMES else ""} if account else {}
            yield port.name, {**flat(account), **ended, **outcome}, flat(found.get("truth", {}).get(port.name) or {})


def _compiled(
    scene: Scene, names: Sequence[str], cycles: int, progress: Progress | None
) -> Iterator[tuple[str, Row, Row]]:
    """Yield port, account and energies of the plant under each algorithm, without a bus."""
    parts = axis_loop.parts_of(scene)
    for done, (port, name) in enumerate(product(parts, names), 1):
        yield port, *_account_of_run(parts[port], name, cycles)
        if progress is not None:
            progress(done * cycles // len(parts))


def _account_of_run(scene: Scene, name: str, cycles: int) -> tuple[Row, Row]:
    """Return the account of the only port, and the plant's own energies, which say whether it was passive."""
    try:
        run = render(axis_loop.under(scene, name).permitted(), cycles, engine="numba")
    except ParameterError as error:
        return {"algorithm": name, "status": "refused", "remark": str(error), "engine": None}, {}
    known = {"contact": np.isfinite(run.damping).mean(), "torque_peak": np.abs(run.torque).max(initial=0.0)}
    account = {
        **flat(run.summary.as_json(scene.bus.sample_time)),
        "algorithm": name,
        "status": run.ended or "completed",
        "engine": run.engine,
        "remark": "; ".join(text for text in (run.reason, run.engine.partition(": ")[2]) if text),
        "passive": passive_verdict(run.least_interaction)[0],
        "outcome": OUTCOMES[int(outcomes(known.get))],
    }
    return account, {
        "interaction": float(run.interaction[-1]) if run.interaction.size else 0.0,
        "least_interaction": run.least_interaction,
        "accounted_error": run.believed_error,
    }
