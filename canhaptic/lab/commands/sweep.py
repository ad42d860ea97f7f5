"""`canhaptic sweep CONFIG`: many scenes with some keys varied, each judged by the figures of `compare`."""

import argparse
from concurrent.futures import Executor
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from canhaptic.cli.long_command import StopSignal
from canhaptic.cli.options import scene_of
from canhaptic.errors import InputError
from canhaptic.lab.commands.results import scene_progress, show
from canhaptic.lab.studies.runner import Pool, Progress, dask_executor, pool_of
from canhaptic.lab.studies.sweep.run_sweep import sweep
from canhaptic.lab.studies.sweep.sweep_table import SweepTable, summary, summary_report
from canhaptic.view.terminal import note_file, write_note

_OPTIONS: Final = (
    "resume", "force", "controllers", "seed", "duration", "cycles", "metrics", "engine", "chunk", "beyond_bus",
    "allow_code",
)  # fmt: skip
"""Command-line arguments with the same name as an option of a sweep."""


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
        stop = stack.enter_context(StopSignal())
        executor, in_flight = _executor(arguments, stack)
        progress = stack.enter_context(scene_progress())
        given = {name: getattr(arguments, name) for name in _OPTIONS}
        state = sweep(
            scene, arguments.vary, out, executor, samples=arguments.sample, in_flight=in_flight,
            processes=arguments.workers is None, progress=progress, stop_requested=stop.requested, **given,
        )  # fmt: skip
        with SweepTable(out) as table:
            found, errors = summary(table), table.note("plant_errors")
    found["file"] = None if arguments.out is None else found["file"]
    show(arguments, found, lambda: summary_report(found))
    for line in errors.splitlines():
        write_note(f"  {line}")
    _note(arguments.out, state, stop.requested())
    return stop.exit_status


def _executor(arguments: argparse.Namespace, stack: ExitStack) -> tuple[Executor | Pool | None, int]:
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
