"""`canhaptic inspect LOG`: read the log of a run; print, check, compare, draw, export or recompute its account."""

import argparse
from contextlib import ExitStack
from typing import Final
from warnings import catch_warnings

from rich.console import Console

from canhaptic.audit.inspection import Inspection, compare, inspect, rows_to_draw
from canhaptic.audit.recompute import recompute_all, rederive, scene_of
from canhaptic.audit.user_checks import Checked, Outcome, check
from canhaptic.axis_units import counted
from canhaptic.cli.options import check_page, check_picture, check_place, require_new
from canhaptic.errors import CanHapticError, InputError
from canhaptic.logs.bus_reader import is_bus_log
from canhaptic.logs.columns import DIGEST
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.logs.export import export, require_library
from canhaptic.logs.repair import repair, require_readable
from canhaptic.view.buzz_lines import trial_lines, why_lines
from canhaptic.view.energy_table import inspection_report
from canhaptic.view.run_lines import failure_text, make_console, pair_lines
from canhaptic.view.run_picture import draw_energy
from canhaptic.view.terminal import note_file, write_json, write_line

_EXPORTS: Final = ("csv", "parquet", "mat", "mcap")
_OF_ONE_LOG: Final = ("compare", "recompute", "bus_log", "repair", "export", *_EXPORTS)
"""Options that take one log."""


def execute(arguments: argparse.Namespace) -> int:
    """Run the requested checks and write the requested files.

    Returns 0, or 1 if the run of a log failed, if a check of any log, the comparison or the recomputation fails, or if
    a log holds values that are not finite.

    Raises:
        InputError: A log or an argument cannot be used.
    """
    arguments.overlay = [*arguments.others, *arguments.overlay]
    _require_one_log(arguments)
    _check_files(arguments)
    console = make_console()
    if arguments.repair is not None:
        kept, lost = repair(arguments.log, arguments.repair)
        if not arguments.json:
            console.print(
                f" {arguments.repair}: {counted(kept, 'cycle')} saved, {lost} could not be read", soft_wrap=True
            )
        arguments.log = arguments.repair
    if is_bus_log(arguments.log):
        return _inspect_frames(arguments, console)
    for path in filter(None, (arguments.log, arguments.compare, *arguments.overlay)):
        require_readable(path)
    with EnergyLog.open(arguments.log) as log:
        result = _explained(log, arguments)
        for path in arguments.overlay:
            with EnergyLog.open(path) as other:
                result.setdefault("others", []).append(_explained(other, arguments))
                if log.far is not None and other.far is not None and len(arguments.overlay) == 1:
                    from canhaptic.audit.two_logs import joined

                    result["pair"] = joined(log, other)
        if arguments.why or arguments.try_ or arguments.html is not None:
            from canhaptic.cli.why import add_why

            add_why(log, result, arguments)
        result["checks"] = _checks(result, arguments)
        _judge(log, result, arguments)
        _write_files(log, result, arguments)
    _show(result, console, as_json=arguments.json, full=arguments.full, asked=arguments.why or arguments.try_)
    return 0 if _is_good(result) else 1


def _explained(log: EnergyLog, arguments: argparse.Namespace) -> Inspection:
    """Return the summary of a log; an axis on which nothing was rendered has the reason, if the scene is unchanged."""
    result = inspect(log, arguments.start, arguments.stop)
    silent = [port for port in result["ports"].values() if port.get("verdict") == "nothing rendered"]
    if not silent:
        return result
    from canhaptic.scene.first_contact import why_silent

    try:
        with catch_warnings(action="ignore"):  # the run has shown them
            scene = scene_of(log, arguments.config, allow_code=arguments.allow_code)
    except CanHapticError:
        return result
    for axis in scene.axes:
        port = result["ports"][axis.parameters.name]
        if port in silent and (why := why_silent(axis, int(result["link"]["skipped_syncs"]), result["cycles"])):
            port["advice"] = why
    return result


def _checks(result: Checked, arguments: argparse.Namespace) -> list[Outcome]:
    """Return the outcome of every check in every log; where there are several, each outcome names its log.

    Raises:
        InputError: A check cannot be read, or a log has nothing of that name.
    """
    runs = [result, *result.get("others", ())]
    found: list[Outcome] = []
    for expression in arguments.check:
        for run in runs:
            try:
                outcomes = check(run, expression)
            except InputError as error:
                raise InputError(f"{run['file']}: {error}" if len(runs) > 1 else str(error)) from error
            found += [{**outcome, "log": run["file"]} for outcome in outcomes] if len(runs) > 1 else outcomes
        pair = result.get("pair")
        if pair is not None and expression.strip() == "passive":
            both = {"check": expression, "name": "both logs", "value": pair["least"], "holds": pair["holds"]}
            found.append({**both, "unit": "J", "log": result["file"]})  # type: ignore[typeddict-item]
    return found


def _judge(log: EnergyLog, result: Inspection, arguments: argparse.Namespace) -> None:
    """Compare the log with another log, with its recomputation, and with the frames of the run, as requested."""
    if arguments.compare is not None:
        with EnergyLog.open(arguments.compare) as other:
            result["comparison"] = compare(log, other)
    is_finite = all(finding["dataset"] == DIGEST for finding in result["findings"])
    if arguments.recompute and is_finite:  # controllers take finite numbers
        result["recomputed"] = recompute_all(log, arguments.config, allow_code=arguments.allow_code)
    if arguments.bus_log is not None:
        scene = scene_of(log, arguments.config, allow_code=arguments.allow_code)
        result["rederived"] = rederive(arguments.bus_log, scene, log)


def _is_good(result: Inspection) -> bool:
    runs = [result, *result.get("others", ())]
    return (
        not any(failure_text(run) or run["findings"] for run in runs)
        and all(outcome["holds"] for outcome in result["checks"])
        and result.get("comparison", {}).get("identical", True)
        and all(port["mismatch"] is None and not port["unchecked_rows"] for port in result.get("recomputed", []))
        and not any(result.get("rederived", {}).get(name) for name in ("differences", "damage"))
    )


def _require_one_log(arguments: argparse.Namespace) -> None:
    """Refuse several logs where an option, or a bus log, takes one alone.

    Raises:
        InputError: Several logs are named.
    """
    if not arguments.overlay:
        return
    others = ", ".join(map(str, arguments.overlay))
    for name in _OF_ONE_LOG:
        if getattr(arguments, name):
            option = f"--{name.replace('_', '-')}"
            raise InputError(f"{option}: got {arguments.log}, {others}, expected one log; inspect each by itself")
    if is_bus_log(arguments.log):
        raise InputError(f"{arguments.log}: is a bus log, expected alone; inspect {others} by itself")


def _check_files(arguments: argparse.Namespace) -> None:
    """Refuse output files that could not be written, before anything is read."""
    if arguments.export is not None:
        check_place(arguments.export, arguments.force)
        require_library(arguments.export)
    for suffix in _EXPORTS:
        path = getattr(arguments, suffix)
        if path is not None:
            if path.suffix != f".{suffix}":
                raise InputError(f"--{suffix} {path}: expected a name that ends in .{suffix}")
            check_place(path, arguments.force)
            require_library(path)
    if arguments.repair is not None and not arguments.force:
        require_new(arguments.repair)
    for path in filter(None, (arguments.png, arguments.svg, arguments.pdf)):
        check_picture(path, arguments.force)
    if arguments.html is not None:
        check_page(arguments.html, arguments.force)


def _write_files(log: EnergyLog, result: Inspection, arguments: argparse.Namespace) -> None:
    for path in filter(None, (arguments.export, *(getattr(arguments, suffix) for suffix in _EXPORTS))):
        export(log, path)
    pictures = [*filter(None, (arguments.png, arguments.svg, arguments.pdf))]
    if not pictures and arguments.html is None:
        return
    with ExitStack() as stack:
        paths = filter(None, (arguments.compare, *arguments.overlay))
        others = [stack.enter_context(EnergyLog.open(path)) for path in paths]
        for other in others:
            if not set(other.ports) & set(log.ports):
                text = f"{other.path}: got the ports {', '.join(other.ports)}, expected one of {', '.join(log.ports)}"
                raise InputError(f"{text}; name a log of the same rig to draw it over this run")
        for path in pictures:
            if arguments.why and result.get("why"):
                from canhaptic.view.state_lanes import draw_buzz

                draw_buzz(log, result["why"], rows_to_draw(log, arguments.start, arguments.stop), path)
            elif "pair" in result:
                from canhaptic.view.pair_picture import draw_pair

                draw_pair(log, others[0], path)
            else:
                span = arguments.start, arguments.stop
                draw_energy(log, path, *span, others, arguments.panels, arguments.width)
            note_file("picture", path)
        if arguments.html is not None:
            from canhaptic.view.html_page import write_html

            write_html(log, arguments.html, result, arguments.start, arguments.stop, others)
            note_file("page", arguments.html)


def _inspect_frames(arguments: argparse.Namespace, console: Console) -> int:
    """Print the account derived from a bus log; return 1 if a check fails or frames of a line are damaged, else 0."""
    from canhaptic.scene.load import load_scene

    if arguments.why:
        return _why_of_frames(arguments)
    if arguments.config is None and not _asks_for_account(arguments):
        from canhaptic.cli.decode import execute as print_frames

        return print_frames(argparse.Namespace(**{**vars(arguments), "bus_log": arguments.log, "only": None}))
    if arguments.config is None:
        raise InputError(f"{arguments.log}: is a bus log; name the scene of the run with --config")
    result = rederive(arguments.log, load_scene(arguments.config, allow_code=arguments.allow_code))
    result["status"] = f"derived from the frames of {arguments.log.name}"
    result["checks"] = _checks(result, arguments)
    _show(result, console, as_json=arguments.json, full=arguments.full)
    return 0 if all(outcome["holds"] for outcome in result["checks"]) and not result["damage"] else 1


def _asks_for_account(arguments: argparse.Namespace) -> bool:
    """Return whether options need more of a bus log than its frames."""
    return any(getattr(arguments, name) for name in ("check", "overlay", "png", "svg", "pdf", "html", *_OF_ONE_LOG))


def _why_of_frames(arguments: argparse.Namespace) -> int:
    """Print what a bus log says of a ripple; return 0."""
    from canhaptic.audit.why.frames import why_of_frames
    from canhaptic.scene.load import load_scene

    scene = arguments.config and load_scene(arguments.config, allow_code=arguments.allow_code)
    found = why_of_frames(arguments.log, scene)
    if arguments.json:
        write_json(found)
        return 0
    units = {axis.parameters.name: axis.parameters.unit for axis in scene.axes} if scene else {}
    for text in (*found["said"], *(f"missing: {signal}" for signal in found["missing"])):
        write_line(f" {text}")
    for text in why_lines(found["why"], units) if scene else ():
        write_line(text)
    return 0


def _show(result: Checked, console: Console, *, as_json: bool, full: bool, asked: bool = False) -> None:
    if as_json:
        write_json(result)
    else:
        console.print(inspection_report(result, full=full))
        for text in pair_lines(result):
            console.print(text)
    units = {name: port["unit"] for name, port in result.get("ports", {}).items() if "unit" in port}
    if not as_json and asked:
        for text in (*why_lines(result["why"], units), *trial_lines(result.get("trials", {}), units)):
            write_line(text)
