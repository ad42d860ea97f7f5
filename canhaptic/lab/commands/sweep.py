"""`canhaptic sweep CONFIG`: many scenes that differ in some keys, each judged by the figures of `compare`."""

import argparse
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from canhaptic.cli.long_command import StopSignal
from canhaptic.cli.options import scene_of
from canhaptic.cli.output import note_file, write_json, write_note
from canhaptic.errors import InputError
from canhaptic.lab.commands.scene_progress import scene_progress
from canhaptic.lab.studies.sweep.run_sweep import Pool, Progress, dask_executor, sweep
from canhaptic.lab.studies.sweep.summary import summary, summary_report
from canhaptic.lab.studies.sweep.sweep_table import SweepTable
from canhaptic.view.run_lines import make_console


def execute(arguments: argparse.Namespace) -> int:
    """Run the sweep and print its summary; return 0, or 130 and 143 after a signal.

    Raises:
        CanHapticError: Bad input, a file that cannot be written, workers that die.
    """
    scene = scene_of(arguments)
    _check(arguments)
    with ExitStack() as stack:
        out = arguments.out
        if out is None:
            out = Path(stack.enter_context(TemporaryDirectory(prefix="canhaptic-sweep-"))) / "sweep.h5"
        stop = stack.enter_context(StopSignal())
        executor, in_flight = _workers(arguments, stack)
        with scene_progress() as progress:
            state = sweep(
                scene,
                arguments.vary,
                out,
                executor,
                resume=arguments.resume,
                force=arguments.force,
                in_flight=in_flight,
                processes=arguments.workers is None,
                progress=progress,
                stop_requested=stop.requested,
                **_options(arguments),
            )
        with SweepTable(out) as table:
            found, errors = summary(table), table.note("plant_errors")
    found["file"] = None if arguments.out is None else found["file"]
    if arguments.json:
        write_json(found)
    else:
        make_console().print(summary_report(found))
    for line in errors.splitlines():
        write_note(f"  {line}; of the scenes that vary ERROR NOT KNOWN")
    _note(arguments.out, state, stop.requested())
    return stop.exit_status


def _check(arguments: argparse.Namespace) -> None:
    if arguments.out is None and (arguments.resume or arguments.force):
        raise InputError("--resume and --force need a file; name it with --out FILE.h5")


def _workers(arguments: argparse.Namespace, stack: ExitStack) -> tuple[Any, int]:
    """Executor, and number of chunks in flight."""
    if arguments.dask is not None:
        executor, threads = stack.enter_context(dask_executor(arguments.dask))
        return executor, 2 * threads
    if arguments.workers in (None, 1):
        return None, 1
    pool = Pool(arguments.workers)
    stack.callback(pool.close)
    return pool, 2 * arguments.workers


def _options(arguments: argparse.Namespace) -> dict[str, Any]:
    return {
        "controllers": arguments.controllers,
        "samples": arguments.sample,
        "seed": arguments.seed,
        "duration": arguments.duration,
        "cycles": arguments.cycles,
        "metrics": arguments.metrics,
        "engine": arguments.engine,
        "chunk": arguments.chunk,
        "beyond_bus": arguments.beyond_bus,
        "allow_code": arguments.allow_code,
    }


def _note(out: Path | None, state: Progress, stopped: bool) -> None:
    if out is not None:
        note_file("results", out)
    if stopped:
        kept = f"; finished work is kept: --resume goes on with {out}" if out is not None else ""
        write_note(f"  stopped     {state.done} of {state.total} scenes are finished{kept}")
