"""`canhaptic sweep CONFIG`: many scenes with some keys varied, each judged by the figures of `compare`."""

import argparse
from collections import Counter
from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from rich.console import Group, RenderableType
from rich.text import Text

from canhaptic.cli.options import scene_of
from canhaptic.control.verdict import PASSIVE_TOLERANCE
from canhaptic.errors import InputError
from canhaptic.files import scene_title
from canhaptic.host.stop_signal import StopSignal
from canhaptic.lab.commands.results import scene_progress, show
from canhaptic.lab.loop.axis_loop import Array
from canhaptic.lab.studies import Row
from canhaptic.lab.studies.chunk import COMPLETED, RADIUS, STATUS, UNRENDERED, UNTOUCHED
from canhaptic.lab.studies.columns import Column, table_of
from canhaptic.lab.studies.runner import Progress, dask_executor, pool_of
from canhaptic.lab.studies.store import SweepTable
from canhaptic.lab.studies.sweep import OPTIONS, sweep
from canhaptic.lab.studies.vary import CONTROLLER
from canhaptic.quantities import FIGURES, SUMMARY
from canhaptic.view.table import Table
from canhaptic.view.terminal import note_file, write_note


def execute(arguments: argparse.Namespace) -> int:
    """Run the sweep and print its summary; return 0, or 130 and 143 after a signal.

    Raises:
        CanHapticError: The input is invalid, a file cannot be written, or workers die.
    """
    scene, out = scene_of(arguments), arguments.out
    if out is None and (arguments.resume or arguments.force):
        raise InputError("--resume and --force need a folder; name it with --out FOLDER")
    with ExitStack() as stack:
        if out is None:
            out = Path(stack.enter_context(TemporaryDirectory(prefix="canhaptic-sweep-"))) / "sweep"
        stop = stack.enter_context(StopSignal(insists=True))
        executor, in_flight = _executor(arguments, stack)
        progress = stack.enter_context(scene_progress())
        given = {name: getattr(arguments, name) for name in (*OPTIONS, "allow_code")}
        state = sweep(
            scene, arguments.vary, out, executor, in_flight=in_flight,
            processes=arguments.workers is None, progress=progress, note=lambda text: write_note(f"  {text}"),
            stop_requested=stop.requested, **given,
        )  # fmt: skip
        with SweepTable(out) as table:
            found, errors = summary(table), table.note("plant_errors")
    found["file"] = None if arguments.out is None else found["file"]
    found["kept"] = state.begun
    show(arguments, found, lambda: summary_report(found))
    for line in errors.splitlines():
        write_note(f"  {line}")
    _note(arguments.out, state, stop.requested())
    return stop.exit_status


def _executor(arguments: argparse.Namespace, stack: ExitStack) -> tuple[Executor | None, int]:
    """Return the executor, and the number of chunks submitted ahead."""
    if arguments.dask is not None:
        executor, threads = stack.enter_context(dask_executor(arguments.dask))
        return executor, 2 * threads
    return stack.enter_context(pool_of(arguments.workers or 1)), 1


def _note(out: Path | None, state: Progress, stopped: bool) -> None:
    if out is not None:
        note_file("results", out)
    if stopped:
        kept = f"; finished work is kept: --resume goes on with {out}" if out is not None else ""
        write_note(f"  stopped     {state.done} of {state.total} scenes are finished{kept}")


_MOST_REMARKS: Final = 20


def summary(table: SweepTable) -> Row:
    """Return the summary of a sweep as plain values, as `canhaptic sweep --json` prints it."""
    remarks, status, engines = Counter[tuple[str, str, str]](), Counter[str](), Counter[str]()
    for ended, engine, remark, number in table.remarks():
        remarks[ended, engine, remark] += number
        status[ended] += number
        engines[engine] += number
    return {
        "file": str(table.folder),
        "scene": table.note("source"),
        "varied": [varied["given"] for varied in table.identity["varied"]],
        "scenes": len(table),
        "finished": table.finished(),
        "status": dict(status),
        "engines": dict(engines),
        "remarks": [
            {**dict(zip(("status", "engine", "remark"), kind, strict=True)), "scenes": number}
            for kind, number in remarks.most_common()
            if kind[2]
        ][:_MOST_REMARKS],
        "figures": {axis: _figures(table, axis) for axis in table.axes},
    }


def _figures(table: SweepTable, axis: str) -> Row:
    """Return shares and medians over the completed scenes, by algorithm."""
    status = table.status(axis)
    if CONTROLLER not in table.keys:
        return {"of the scene": _shares(table, axis, status)}
    numbers = table.points.numbers(CONTROLLER)
    names = next(one.values for one in table.points.varied if one.key == CONTROLLER)
    return {str(name): _shares(table, axis, np.where(numbers == i, status, 0)) for i, name in enumerate(names)}


def _shares(table: SweepTable, axis: str, status: NDArray[np.uint8]) -> Row:
    """Return shares, least values and medians of some scenes that were touched; None where there are none."""
    rows = status == COMPLETED
    found: Row = {"scenes": int(rows.sum())}
    for key, number in _PROVE_NOTHING.items():
        if count := int((status == number).sum()):
            found[key] = count
    for name, (_, metric, figure) in _SHARES.items():
        if metric in table.metrics:
            values = table.figure(axis, metric)[rows]
            found[name] = figure(values) if len(values) else None
    return found


def _kept(values: Array) -> float:
    return float((values >= -PASSIVE_TOLERANCE).mean())


def _finite(figure: Callable[[Array], Any]) -> Callable[[Array], float | None]:
    """Return a function that applies `figure` to the finite values only; None if there are none."""

    def of(values: Array) -> float | None:
        finite = values[np.isfinite(values)]
        return float(figure(finite)) if len(finite) else None

    return of


_SHARES: Final[Mapping[str, tuple[str, str, Callable[[Array], float | None]]]] = {
    "passive": (SUMMARY["passive_by_plant"].title, "least_interaction", _kept),
    "margin_kept": (SUMMARY["margin_kept"].title, "margin", _kept),
    "least_margin": (FIGURES["margin"].title, "margin", _finite(np.min)),
    "diverged": (FIGURES["diverged"].title, "diverged", lambda values: float((values == 1.0).mean())),
    "stable": (SUMMARY["stable_alone"].title, RADIUS, _finite(lambda values: (values < 1.0).mean())),
    "stiffness_rendered": (
        f"{FIGURES['stiffness_rendered.share'].title}, median",
        "stiffness_rendered.share",
        _finite(np.median),
    ),
    "mass_felt": (f"{FIGURES['mass_felt'].title}, median", "mass_felt.share", _finite(np.median)),
    "guard_acts": (f"{FIGURES['guard_acts'].title}, median", "guard_acts", _finite(np.median)),
}
"""Name -> heading, metric, and the function from its values to one number."""
_PROVE_NOTHING: Final = {"no_contact": UNTOUCHED, "nothing_rendered": UNRENDERED}
"""Name -> status of scenes that count neither as passive nor as active."""


def summary_report(found: Row) -> RenderableType:
    """Return the tables of a summary for a terminal."""
    finished = f"   {found['finished']} of {found['scenes']} scenes   "
    heading = Text.assemble(" ", (scene_title(found["scene"]), "bold"), finished, "  ".join(found["varied"]))
    engines = {_ENGINES[name]: number for name, number in found["engines"].items()}
    kept = f" ({found['kept']} kept from an earlier run)" if found["kept"] else ""
    scenes = Text(f" scenes computed: {_listed(engines)}{kept}")
    lines = [scenes, Text(f" their status:    {_listed(found['status'])}")]
    style = {"refused": "yellow", "failed": "red"}
    lines += [
        Text(f" {of['scenes']} {of['status']} ({_ENGINES[of['engine']]}): {of['remark']}", style.get(of["status"], ""))
        for of in found["remarks"]
    ]
    return Group(heading, *lines, _shares_table(found))


def _listed(counts: dict[str, int]) -> str:
    return ", ".join(f"{number} {name}" for name, number in counts.items()) or "nothing yet"


_ENGINES: Final = {"none": "not run", "scalar": "one by one", "python": "in batches", "numba": "in compiled batches",
                   "closed form": "in closed form"}  # fmt: skip


_ALGORITHMS: Final = {"of the scene": "the scene's algorithm"}


def _shares_table(found: Row) -> Table:
    heads = [Column("axis, algorithm", "of"), Column("scenes", "scenes")]
    heads += [Column(STATUS[number], key) for key, number in _PROVE_NOTHING.items()]
    heads += [Column(head, key, "J" if key == "least_margin" else "%") for key, (head, _, _) in _SHARES.items()]
    rows = [
        {"of": f"{axis}, {_ALGORITHMS.get(name, name)}", **entry}
        for axis, of in found["figures"].items()
        for name, entry in of.items()
    ]
    return table_of("", heads, rows, "m", 1)
