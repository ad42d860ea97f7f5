"""`canhaptic replay BUSLOG`: replay the drives of a bus log, compare every frame of the master, say what that tests."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

from rich.text import Text

from canhaptic.audit.recompute import cycles_on_line
from canhaptic.audit.recompute import scene_of as scene_of_log
from canhaptic.audit.replay_coverage import Covered, covered, scene_next_to
from canhaptic.cli.options import check_place, scene_of
from canhaptic.errors import InputError
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.logs.frame_log import is_frame_log
from canhaptic.logs.repair import require_readable
from canhaptic.replay import FrameWords, ReplayResult, replay_bus_log, replay_line
from canhaptic.scene.buses import kind_of
from canhaptic.scene.models import Scene
from canhaptic.view.energy_table import energy_report
from canhaptic.view.run_lines import make_console
from canhaptic.view.terminal import write_json


def execute(arguments: argparse.Namespace) -> int:
    """Replay the bus log; return 0 if the master sent the recorded frames and they test the scene, else 1.

    Raises:
        InputError: The recording or the scene cannot be used.
    """
    return (_replay_line if is_frame_log(arguments.bus_log) else _replay_buses)(arguments)


def _replay_buses(arguments: argparse.Namespace) -> int:
    if arguments.junit is not None:
        check_place(arguments.junit, force=True)
    scene, dry_run = _recorded_scene(arguments)
    result = replay_bus_log(
        arguments.bus_log, scene, realtime=arguments.realtime, from_sync=arguments.from_sync, dry_run=dry_run
    )
    covers = covered(result, scene, keys=not arguments.quick, dry_run=dry_run)
    faults = why_failed(result, covers, allow_empty=arguments.allow_empty or dry_run)
    if arguments.junit is not None:
        _write_junit(arguments.junit, result, covers, faults)
    if arguments.json:
        write_json({**result, "covers": covers})
    else:
        console = make_console()
        for line in [*_replay_report(result), *_coverage_report(covers, quick=arguments.quick)]:
            console.print(line, soft_wrap=True)
        for fault in faults[result["status"] == "different" :]:
            console.print(Text(f" {fault}", style="bold red"), soft_wrap=True)
        if arguments.account:
            console.print(energy_report(result["account"]))
    return 1 if faults else 0


def _recorded_scene(arguments: argparse.Namespace) -> tuple[Scene, bool]:
    """Return the scene of the recorded run, as it was where its energy log is named, and whether it was a dry run."""
    if arguments.config is None and arguments.energy_log is None:
        arguments.config = scene_next_to(arguments.bus_log)
    if arguments.energy_log is not None:
        require_readable(arguments.energy_log)
        with EnergyLog.open(arguments.energy_log) as log:
            scene = scene_of_log(log, arguments.config, allow_code=arguments.allow_code)
            return scene, arguments.no_torque or log.dry_run
    scene = scene_of(arguments)
    if scene.own_code:
        text = f"{arguments.bus_log}: a bus log does not record user code, and the scene uses"
        text = f"{text} {', '.join(scene.own_code)}; add the energy log of the same run, which does: --energy-log"
        raise InputError(text)
    return scene, arguments.no_torque


def _replay_line(arguments: argparse.Namespace) -> int:
    path, (scene, dry_run) = arguments.bus_log, _recorded_scene(arguments)
    is_line = kind_of(scene.bus) != "can" and len(scene.buses) == 1
    result = replay_line(path, scene, dry_run=dry_run, cycles=cycles_on_line(path, scene) if is_line else None)
    if arguments.json:
        write_json(result._asdict())
    else:
        text = " identical: the master sent every frame byte for byte as recorded, at its time"
        outcome = (
            Text(text, style="green") if not result.difference else Text(f" {result.difference}", style="bold red")
        )
        console = make_console()
        console.print(f" {result.compared} of {result.recorded} frames of the master compared")
        console.print(outcome, soft_wrap=True)
    return 1 if result.difference else 0


def why_failed(result: ReplayResult, covers: Covered, *, allow_empty: bool) -> list[str]:
    """Return why a replay fails: another frame, and ports that it does not test."""
    faults = [] if (found := result["difference"]) is None else [f"different at line {found['number']}"]
    if covers["untested"] and not allow_empty and not faults:  # of a replay that ended early nothing more is said
        text = "not tested: no torque was sent, so any environment and algorithm would be identical; record a contact"
        faults.append(f"{', '.join(covers['untested'])}: {text}, or allow it with --allow-empty")
    return faults


def replay_text(result: ReplayResult, covers: Covered, faults: Sequence[str]) -> str:
    """Return outcome, coverage and faults of a replay as lines of text."""
    lines = [line.plain for line in (*_replay_report(result), *_coverage_report(covers, quick=False))]
    return "\n".join([*lines, *(f" {fault}" for fault in faults)])


def _write_junit(path: Path, result: ReplayResult, covers: Covered, faults: Sequence[str]) -> None:
    """Write one test case as JUnit XML, with its text."""
    time = f"{result['elapsed']:.3f}"
    counts = {"tests": "1", "failures": str(int(bool(faults))), "errors": "0", "skipped": "0", "time": time}
    suite = ElementTree.Element("testsuite", {"name": "canhaptic replay", **counts})
    case = ElementTree.SubElement(suite, "testcase", classname="canhaptic.replay", name=result["recording"], time=time)
    text = replay_text(result, covers, faults)
    if faults:
        ElementTree.SubElement(case, "failure", message="; ".join(faults)).text = text
    else:
        ElementTree.SubElement(case, "system-out").text = text
    ElementTree.indent(suite)
    ElementTree.ElementTree(suite).write(path, encoding="utf-8", xml_declaration=True)


def _coverage_report(covers: Covered, *, quick: bool) -> list[Text]:
    """Return what the recording covers as lines of text."""
    lines = [Text(f" stop: {covers['stop']}")]
    for name, count in covers["commands"].items():
        lines.append(Text(f" {name}: {count} commands other than zero"))
    for name, contacts in covers["contacts"].items():
        branches = ", ".join(f"{kind} {count}" for kind, count in covers["branches"][name].items()) or "none"
        certificates = ", ".join(covers["certificates"][name]) or "none"
        lines.append(Text(f" {name}: {contacts} holds in contact; branches: {branches}; certificates: {certificates}"))
    if covers["untraced"]:
        keys = ", ".join(covers["untraced"])
        lines.append(Text(f" no trace in any frame, so not tested: {keys}", style="yellow"))
    elif not quick and not covers["not_tried"]:
        lines.append(Text(" every number of environment, algorithm and torque limit left a trace"))
    if covers["not_tried"]:
        lines.append(Text(f" not tried, since the scene takes no other value: {', '.join(covers['not_tried'])}"))
    return lines


def _replay_report(result: ReplayResult) -> list[Text]:
    difference, frames = result["difference"], result["frames"]
    start = "from the boot of the drives" if result["start"] == "boot" else "from the first SYNC with all axes enabled"
    played = f"{frames['compared']} frames of the master compared, {frames['played']} frames of the drives replayed"
    lines = [
        Text(f" {result['recording']}: {result['duration']:.6g} s, {frames['recorded']} frames, replayed {start}"),
        Text(f" {played}, {result['cycles']} cycles, {result['speed']:.1f} times real time"),
        Text(f" ended: {result['ended']}"),
    ]
    lines += [Text(f" {remark}") for remark in result["remarks"]]
    if result["reads_left_out"]:
        objects = ", ".join(result["reads_left_out"])
        lines.append(Text(f" objects not read at the start, as in the recording by an older master: {objects}"))
    if difference is None:
        text = " identical: the master sent every frame byte for byte as recorded (except heartbeats and times)"
        return [*lines, Text(text, style="green")]
    place = f"line {difference['number']}, {difference['time']:.6f} s"
    lines.append(Text(f" different at {place}:", style="bold red"))
    lines.append(Text(f"   recorded  {_words(difference['recorded'])}"))
    lines.append(Text(f"   sent      {_words(difference['sent'])}"))
    if difference["gap"] is not None:
        text = f" the recording has a gap of {difference['gap']:.6g} s before this line: frames are missing from it"
        lines.append(Text(text, style="bold"))
    lines.append(Text(" the last equal frames before it:", style="dim"))
    lines += [
        Text(f"   {frame['number']:>7} {frame['time']:12.6f} {frame['direction']} {_words(frame)}", style="dim")
        for frame in difference["before"]
    ]
    return lines


def _words(frame: FrameWords | None) -> str:
    if frame is None:
        return "nothing more"
    return f"{frame['id']:03X}#{frame['data']:<16} {frame['kind']} {frame['node']}: {frame['text']}".rstrip(" :")
