"""`canhaptic run CONFIG`: bring the drives up, render the environment, stop, and print the energy account."""

import argparse
import importlib
import tempfile
from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, nullcontext, suppress
from itertools import chain
from math import inf
from pathlib import Path
from typing import Final

from canhaptic.axis_units import effort_unit
from canhaptic.cli.long_command import KEPT, NOT_PASSIVE, notes, walls_first
from canhaptic.cli.options import check_page, check_picture, require_new, scene_of
from canhaptic.errors import CanHapticError, ParameterError
from canhaptic.host.stop_signal import StopSignal
from canhaptic.result import RunResult
from canhaptic.scene.build import Experiment, build, logs_elsewhere
from canhaptic.scene.buses import kind_of
from canhaptic.scene.models import Scene, require_no_guesses
from canhaptic.view.terminal import (
    failure,
    leave_closed_terminal,
    note_file,
    run_progress,
    write_failure,
    write_json,
    write_line,
    write_note,
)

_LARGE: Final = 0.01  # energy allowance that needs --large-allowance [J]


def execute(arguments: argparse.Namespace) -> int:
    """Run the scene; return 0, 1 if --strict fails, or 128 + n after signal n."""
    if arguments.other is not None:
        from canhaptic.cli.run_pair import execute_pair

        return execute_pair(arguments)
    scene = scene_of(arguments)
    with ExitStack() as stack:
        energy_log, bus_log = arguments.log or scene.log.energy, arguments.bus_log or scene.log.bus
        elsewhere = logs_elsewhere(scene, energy=arguments.log is None, bus=arguments.bus_log is None)
        if not arguments.force:
            require_new(*filter(None, (energy_log, bus_log)))
        _check_files(arguments)
        if energy_log is None and (arguments.png or arguments.html or arguments.sink):
            energy_log = Path(stack.enter_context(tempfile.TemporaryDirectory())) / "run.h5"
        sinks = _sinks(arguments.sink, energy_log)  # one that cannot be loaded is named before a drive is touched
        require_no_guesses(scene)
        _require_allowed(scene, most=inf if arguments.large_allowance else _LARGE)
        for text in chain(elsewhere, _preflight(scene)):
            write_note(f"  {text}")
        stop = stack.enter_context(StopSignal())
        scene = _with_checked_holds(scene, stop, arguments)
        experiment = build(scene, arguments.pace, energy_log, bus_log, no_torque=arguments.no_torque)
        for text in notes(scene):
            write_note(f"  {text}")
        stack.enter_context(sinks)
        stack.callback(experiment.close, "interrupted")  # by then closed already, unless a second signal came
        result, error = _run(experiment, arguments.duration or scene.run.duration, stop)
        _report(result, error, arguments)  # before the picture, whose disk may be full
        if error is None and energy_log is not None:
            _draw(energy_log, arguments)
        _note_buzz(energy_log, scene)
    for name, texts in result.get("remarks", {}).items():
        write_note(f"  {name}: {'; '.join(texts)}")
    for name, texts in result.get("unrestored", {}).items() if scene.axes[0].simulation is None else ():
        write_note(f"  {name}: not put back in the drive: {'; '.join(texts)}")
    if error is not None:
        return error.exit_status
    return stop.exit_status or (NOT_PASSIVE if arguments.strict and _fails(result) else 0)


def _sinks(names: list[str], energy_log: Path | None) -> AbstractContextManager[None]:
    """Return what gives the rows of a log to the sinks that were asked for, once the log is open."""
    if energy_log is None or not names:
        return nullcontext()
    from canhaptic.logs.row_sinks import fed
    from canhaptic.registry import function_of

    for name in names:
        function_of("sink", name)
    return fed(names, energy_log)


def _check_files(arguments: argparse.Namespace) -> None:
    if arguments.png is not None:
        check_picture(arguments.png, arguments.force)
    if arguments.html is not None:
        check_page(arguments.html, arguments.force)


def _draw(energy_log: Path, arguments: argparse.Namespace) -> None:
    """Draw the picture and write the page that were asked for, from the log of the run."""
    if arguments.png is None and arguments.html is None:
        return
    from canhaptic.logs.energy_reader import EnergyLog

    with EnergyLog.open(energy_log) as log:
        if arguments.png is not None:
            from canhaptic.view.run_picture import draw_energy

            draw_energy(log, arguments.png)
        if arguments.html is not None:
            from canhaptic.audit.inspection import inspect
            from canhaptic.view.html_page import write_html

            write_html(log, arguments.html, inspect(log))


def _note_buzz(energy_log: Path | None, scene: Scene) -> None:
    """Note that the run buzzed, unless that cannot be found out; it has ended and shown its account."""
    if energy_log is not None:
        with suppress(CanHapticError, OSError, ImportError, MemoryError):
            from canhaptic.cli.why import note_buzz

            note_buzz(energy_log, scene)


def _preflight(scene: Scene) -> Iterator[str]:
    buses = [bus.parameters for bus in scene.buses]
    if not scene.simulated and any(bus.interface == "socketcan" or kind_of(bus) != "can" for bus in buses):
        from canhaptic.host.socketcan_state import require_preflight

        for note in require_preflight(scene.loaded_buses):
            yield f"{note.interface}: {note.item}: {note.seen}: {note.text}"


def _with_checked_holds(scene: Scene, stop: StopSignal, arguments: argparse.Namespace) -> Scene:
    """Test in which hold a torque acts, on every axis with `check_hold`; return the scene with the result."""
    if arguments.no_torque or all(axis.parameters.check_hold is None for axis in scene.axes):
        return scene
    from canhaptic.commission.torque_tests import checked_holds

    return checked_holds(scene, write_note, stop.requested)


def _require_allowed(scene: Scene, most: float) -> None:
    """Refuse an energy allowance above `most` [J], which a hand may feel as a kick.

    Raises:
        ParameterError: The allowance of an axis or a group is larger.
    """
    for port in scene.ports:
        energy = getattr(port.passivity.parameters, "energy_allowance", 0.0)
        if energy > most:
            text = (
                f"{port.name}: passivity.energy_allowance: got {energy:.3g} J, expected at most {most:g} J, since the"
            )
            text += " handle may give out this energy at once"
            raise ParameterError(f"{text}; declare less, or run with --large-allowance")


def _withheld(result: RunResult) -> str:
    axes = {name: axis for name, axis in result["ports"].items() if "withheld_torque" in axis}
    largest = [f"{name} {axis['withheld_torque']:.3g} {effort_unit(axis['unit'])}" for name, axis in axes.items()]
    return f"dry run: no torque was sent; the largest would have been: {', '.join(largest)}"


def _fails(result: RunResult) -> bool:
    """Return whether a touched port is not shown as passive, and report each such port."""
    from canhaptic.view.run_lines import headline_text

    for name, account in result["ports"].items():
        if account.get("verdict", "yes") not in KEPT:
            write_note(f"canhaptic: --strict:{headline_text(name, account).plain}")
    return result["verdict"] not in KEPT


def _run(experiment: Experiment, duration: float | None, stop: StopSignal) -> tuple[RunResult, CanHapticError | None]:
    """Run until the end or an error; return the account, and the error or None."""
    lines = importlib.import_module("canhaptic.view.run_lines")  # now: a run may use up every descriptor
    period = experiment.scene.bus.sample_time
    cycles = None if duration is None else max(1, round(duration / period))
    with run_progress(cycles, period, experiment.pace) as progress:
        if progress is not None and experiment.far is not None:
            progress.status = lines.link_status(experiment.far.summary).__next__
        result, error = experiment.run_through(cycles, walls_first(experiment, stop.requested), progress)
    if error is not None and result["status"].startswith("failed"):
        result["status"] = "failed"
    return result, error


def _report(result: RunResult, error: CanHapticError | None, arguments: argparse.Namespace) -> None:
    """Print the account, then the error that ended the run if there was one."""
    leave_closed_terminal()
    if arguments.json:
        write_json(result if error is None else {**failure(error), "result": result})
    elif result["cycles"]:
        if result.get("dry_run"):
            write_line(_withheld(result))
        from canhaptic.view.run_lines import brief_report, make_console

        if arguments.full:
            from canhaptic.view.energy_table import energy_report

        try:
            make_console().print(energy_report(result) if arguments.full else brief_report(result))
        except (OSError, MemoryError):  # nothing more can be loaded: the account all the same
            write_json(result)
    if error is not None:
        write_failure(error)
    files = {"energy log": arguments.log, "bus log": arguments.bus_log, "picture": None if error else arguments.png,
             "page": None if error else arguments.html}  # fmt: skip
    for what, path in files.items():
        if path is not None:
            note_file(what, path)
