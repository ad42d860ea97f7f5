"""`canhaptic replay BUSLOG --config CONFIG`: replay the drives of a bus log, and compare every frame of the master."""

import argparse

from rich.text import Text

from canhaptic.audit.recompute import scene_of as scene_of_log
from canhaptic.cli.options import scene_of
from canhaptic.errors import InputError
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.logs.repair import require_readable
from canhaptic.replay import FrameWords, ReplayResult, replay_bus_log
from canhaptic.view.energy_table import energy_report
from canhaptic.view.run_lines import make_console
from canhaptic.view.terminal import write_json


def execute(arguments: argparse.Namespace) -> int:
    """Replay the bus log; return 0 if the master sent the recorded frames, 1 if it did not.

    Raises:
        InputError: The recording or the scene cannot be used.
    """
    dry_run = arguments.no_torque
    if arguments.energy_log is not None:
        require_readable(arguments.energy_log)
        with EnergyLog.open(arguments.energy_log) as log:
            scene = scene_of_log(log, arguments.config, allow_code=arguments.allow_code)
            dry_run = dry_run or log.dry_run
    else:
        scene = scene_of(arguments)
        if scene.own_code:
            text = f"{arguments.bus_log}: a bus log does not record user code, and the scene uses"
            text = f"{text} {', '.join(scene.own_code)}; add the energy log of the same run, which does: --energy-log"
            raise InputError(text)
    result = replay_bus_log(
        arguments.bus_log, scene, realtime=arguments.realtime, from_sync=arguments.from_sync, dry_run=dry_run
    )
    if arguments.json:
        write_json(result)
    else:
        console = make_console()
        for line in _replay_report(result):
            console.print(line, soft_wrap=True)
        if arguments.account:
            console.print(energy_report(result["account"]))
    return 0 if result["status"] == "identical" else 1


def _replay_report(result: ReplayResult) -> list[Text]:
    """Return the outcome of a replay as lines of text."""
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
