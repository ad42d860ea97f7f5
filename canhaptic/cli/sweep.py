"""`canhaptic sweep CONFIG`: many scenes that differ in some keys, each judged by the figures of `compare`."""

import argparse
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

from canhaptic.cli.arguments import add_json, add_scene, names, scene_of, seconds
from canhaptic.cli.output import note_file, write_json, write_note
from canhaptic.cli.scene_progress import scene_progress
from canhaptic.cli.stop_signal import StopSignal
from canhaptic.errors import InputError
from canhaptic.study.batch import CONTINUOUS
from canhaptic.study.sweep.chunk import USUAL
from canhaptic.study.sweep.run_sweep import Progress, sweep
from canhaptic.study.sweep.summary import summary, summary_report
from canhaptic.study.sweep.sweep_table import SweepTable
from canhaptic.study.sweep.workers import Pool, dask_executor
from canhaptic.view.energy_table import make_console

_MOST_WORKERS: Final = 1024


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the arguments of `sweep`."""
    add_scene(parser)
    parser.add_argument(
        "--vary",
        metavar="KEY=VALUES",
        action="append",
        default=[],
        help="LOW:HIGH:N, LOW:HIGH:log:N or A,B,C of any key of the scene, as in environment.stiffness=1e2:1e6:log:40 "
        "(every axis) or axes.0.torque_limit=5,10; repeatable",
    )
    parser.add_argument("--controllers", metavar="A,B,...", type=names, default=[], help="judge each scene under these")
    parser.add_argument(
        "--sample", metavar="lhs:N", type=_samples, default=0, help="N points of a Latin hypercube, no grid"
    )
    parser.add_argument("--seed", metavar="N", type=_count, default=0, help="of the hypercube")
    length = parser.add_mutually_exclusive_group()
    length.add_argument("--duration", metavar="S", type=seconds, help="of every scene [s]; by default the scene's")
    length.add_argument("--cycles", metavar="N", type=_count, help="SYNCs of every scene, whatever its rate")
    parser.add_argument(
        "--metrics",
        metavar="A,B,...",
        type=names,
        help=f"fewer are faster; by default {', '.join(USUAL)}; beside a continuous run also {', '.join(CONTINUOUS)}",
    )
    parser.add_argument(
        "--engine", choices=("auto", "numpy", "numba"), default="auto", help="of scenes that fit a batch"
    )
    parser.add_argument("--beyond-bus", action="store_true", help="judge rates that the bus could not carry, too")
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--workers", metavar="N", type=_count, default=1, help="processes on this machine")
    where.add_argument("--dask", metavar="ADDRESS", help="scheduler of a Dask cluster, as in tcp://10.0.0.5:8786")
    parser.add_argument("--chunk", metavar="N", type=_count, help="scenes that are finished together")
    parser.add_argument("--out", metavar="FILE.h5", type=Path, help="results; each chunk is there once it is finished")
    again = parser.add_mutually_exclusive_group()
    again.add_argument("--resume", action="store_true", help="go on with FILE.h5 where it was stopped or killed")
    again.add_argument("--force", action="store_true", help="replace FILE.h5")
    add_json(parser)


def execute(arguments: argparse.Namespace) -> int:
    """Runs the sweep and prints its summary; returns 0, or 130 and 143 after a signal.

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
                progress=progress,
                stop_requested=stop.requested,
                **_options(arguments),
            )
        with SweepTable(out) as table:
            found = summary(table)
    found["file"] = None if arguments.out is None else found["file"]
    if arguments.json:
        write_json(found)
    else:
        make_console().print(summary_report(found))
    _note(arguments.out, state, stop.requested())
    return stop.exit_status


def _check(arguments: argparse.Namespace) -> None:
    if arguments.out is None and (arguments.resume or arguments.force):
        raise InputError("--resume and --force are about a file; name it with --out FILE.h5")
    if arguments.workers > _MOST_WORKERS:
        raise InputError(f"--workers: got {arguments.workers}, expected 1 to {_MOST_WORKERS}")


def _workers(arguments: argparse.Namespace, stack: ExitStack) -> tuple[Any, int]:
    """Returns (executor, chunks to have under way)."""
    if arguments.dask is not None:
        executor, threads = stack.enter_context(dask_executor(arguments.dask))
        return executor, 2 * threads
    if arguments.workers == 1:
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
    }


def _note(out: Path | None, state: Progress, stopped: bool) -> None:
    if out is not None:
        note_file("results", out)
    if stopped:
        kept = f"; what is finished is kept: --resume goes on with {out}" if out is not None else ""
        write_note(f"  stopped     {state.done} of {state.total} scenes are finished{kept}")


def _count(text: str) -> int:
    if not (text.isascii() and text.isdigit()) or not 0 <= int(text) <= 1_000_000_000:
        raise argparse.ArgumentTypeError(f"got {text!r}, expected a whole number from 0 to 10^9")
    return int(text)


def _samples(text: str) -> int:
    kind, _, number = text.partition(":")
    if kind != "lhs" or not number.isdigit() or not 1 <= int(number) <= 100_000_000:
        raise argparse.ArgumentTypeError(f"got {text!r}, expected lhs:N with N from 1 to 10^8")
    return int(number)
