"""`canhaptic run A.yaml --with B.yaml`: two simulated rigs and the network between them, in one virtual time."""

import argparse
from contextlib import ExitStack
from pathlib import Path

from canhaptic.cli.long_command import KEPT, NOT_PASSIVE
from canhaptic.cli.options import require_new, scene_of
from canhaptic.errors import CanHapticError, InputError
from canhaptic.host.stop_signal import StopSignal
from canhaptic.scene.load import load_scene
from canhaptic.scene.pair import Outcome, Pair
from canhaptic.view.terminal import failure, note_file, run_progress, write_failure, write_json, write_line

_ALONE = ("bus_log", "png", "html")


def execute_pair(arguments: argparse.Namespace) -> int:
    """Run both scenes; return 0, 1 if --strict fails, or 128 + n after signal n.

    Raises:
        InputError: Neither the command nor the first scene says how long, a log exists, or an option is for one rig.
    """
    for name in _ALONE:
        if getattr(arguments, name) is not None:
            option = f"--{name.replace('_', '-')}"
            raise InputError(
                f"{option}: is of one rig; with --with give --log, and draw each log by `canhaptic inspect`"
            )
    scene, other = scene_of(arguments), load_scene(arguments.other)
    duration = arguments.duration or scene.run.duration
    if duration is None:
        raise InputError(f"{scene.source}: duration: missing; add it to the scene, or give --duration")
    logs = (None, None) if arguments.log is None else (arguments.log, far_log(arguments.log))
    if arguments.log is not None and not arguments.force:
        require_new(*logs)
    with ExitStack() as stack:
        stop = stack.enter_context(StopSignal())
        pair = Pair((scene, other), logs)
        stack.callback(pair.close, "interrupted")
        cycles = max(1, round(duration / scene.bus.sample_time))
        with run_progress(cycles, scene.bus.sample_time, "free") as progress:
            outcome = pair.run_through(duration, stop.requested, progress)
    _report(outcome, (scene.source, other.source), is_json=arguments.json)
    for path in filter(None, logs):
        note_file("energy log", path)
    if outcome.error is not None:
        return outcome.error.exit_status
    kept = all(result["verdict"] in KEPT for result in outcome.results)
    return stop.exit_status or (NOT_PASSIVE if arguments.strict and not kept else 0)


def far_log(path: Path) -> Path:
    """Return the name of the far rig's log: `a.far.h5` where that of this one is `a.h5`."""
    return path.with_name(f"{path.stem}.far{path.suffix}")


def _report(outcome: Outcome, sources: tuple[str, str], *, is_json: bool) -> None:
    one, other = outcome.results
    error: CanHapticError | None = outcome.error
    if is_json:
        both = {**one, "pair": outcome.pair, "with": other}
        write_json(both if error is None else {**failure(error), "result": both})
    else:
        from canhaptic.axis_units import si
        from canhaptic.view.run_lines import heading, headlines, link_lines, make_console

        console = make_console()
        for source, result in zip(sources, outcome.results, strict=True):
            write_line(f" {source}")
            for part in (*headlines(result), *link_lines(result), heading(result)):
                console.print(part)
        least = si(outcome.pair["least_true"], "J", 3)
        write_line(f" both plants: the least sum of what came in is {least}")
    if error is not None:
        write_failure(error)
