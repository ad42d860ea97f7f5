"""How does a program leave a rig? `python -m tools.bench.program_ends --ways 200`: every way out, on a simulated drive.

A program asks for a torque in every turn and is ended at a random one, in a process of its own. Ways that code can
answer: an exception, `break`, `sys.exit`, SIGINT, SIGTERM, a closed generator, the end of the interpreter; then the bus
log must show zero torque before the drive is disabled. Ways that it cannot (SIGKILL, `os._exit`, a crash, a body that
never ends) end at a drive in a process of its own, over UDP multicast: the time from the last heartbeat to the
emergency with which the drive ends the torque itself, against the timeout that it was given.
"""

import argparse
import math
import os
import random
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Final

from canhaptic.logs.bus_reader import read_bus_log
from tests.acceptance.test_killed_program import WAYS, TooBusyError, time_to_zero
from tests.acceptance.two_processes import HEARTBEAT_TIMEOUT, listening
from tools.bench.demo import CONFIG
from tools.bench.report import Row, publish

ROOT: Final = Path(__file__).resolve().parents[2]
ANSWERED: Final = {
    "exception": "raise RuntimeError",
    "break": "break",
    "sys.exit": "sys.exit(3)",
    "SIGINT": "os.kill(os.getpid(), signal.SIGINT)",
    "SIGTERM": "os.kill(os.getpid(), signal.SIGTERM)",
    "closed generator": "turns.close(); break",
    "end of the interpreter": "kept.append(turns); os.kill(os.getpid(), signal.SIGINT)",
    "NaN": "rig['handle'].torque = float('nan')",
}
PROGRAM: Final = """
import os, signal, sys
import canhaptic
kept, config, log, at = [], sys.argv[1], sys.argv[2], int(sys.argv[3])
rig = canhaptic.open_rig(config, guard="none", bus_log=log)
with rig:
    turns = iter(rig)
    for sample in turns:
        rig["handle"].torque = 3.0
        if sample["handle"].sync_index == at:
            {way}
"""
_RPDO: Final = 0x201
_SYNC: Final = 5.0  # [ms] sample time of the drive in a process of its own


def _started(way: str, *words: str) -> "subprocess.Popen[bytes]":
    text = PROGRAM.replace("{way}", way)
    if "kept" in way:  # nothing closes it but the end of the interpreter
        text = text.replace("with rig:", "rig.__enter__()\nif True:").replace("; os.kill", "; sys.exit() #")
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    words = (sys.executable, "-c", text, str(CONFIG), *words)
    return subprocess.Popen(words, env=environment, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)


def answered(way: str, turn: int, folder: Path) -> str:
    """Returns what was wrong with the end of a program; empty if zero torque came first and the drive was disabled."""
    log = folder / "bus.log"
    _started(ANSWERED[way], str(log), str(turn)).wait(120)
    sent = [frame for frame in read_bus_log(log) if frame.can_id == _RPDO]
    commands = [
        (int.from_bytes(f.data[:2], "little"), int.from_bytes(f.data[2:4], "little", signed=True)) for f in sent
    ]
    with_torque = [number for number, (_, torque) in enumerate(commands) if torque]
    if not with_torque:
        return "no torque was sent"
    end = commands[with_torque[-1] + 1 :]
    if not end or end[0][1]:
        return "no zero torque was sent"
    if end[0][0] & 0xF != 0xF:
        return "disabled before zero torque"
    return "" if end[-1][0] & 0xF != 0xF else "not disabled"


def watched(way: str, turn: int) -> float:
    """Returns the time from a program's last heartbeat to the end of its torque by the drive [s]; inf: another end."""
    while True:
        try:
            with listening() as (listener, on_bus):
                return 1e-6 * time_to_zero(way, turn, listener, on_bus)
        except TooBusyError:
            print(f"{way}: this computer was too busy, and the rig ended the run; once more")
        except AssertionError as error:
            print(f"{way}: {str(error)[:300]}")
            return math.inf


def main() -> None:
    """Ends as many programs as asked and publishes the table."""
    parser = argparse.ArgumentParser(description="How a program leaves a rig, by every way out.")
    parser.add_argument("--ways", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    chance, wrong, times = random.Random(arguments.seed), dict[str, list[str]](), dict[str, list[float]]()
    ways = [*ANSWERED, *WAYS]
    for number in range(arguments.ways):
        way, turn = ways[number % len(ways)], chance.randint(1, 300)
        if way in WAYS:
            times.setdefault(way, []).append(watched(way, turn))
            continue
        with tempfile.TemporaryDirectory() as folder:
            wrong.setdefault(way, []).append(answered(way, turn, Path(folder)))
    rows = [
        Row(f"{way}: not zero first and disabled second, of {len(found)}", sum(map(bool, found)), "", target="0",
            met=not any(found), note=next(filter(None, found), ""))
        for way, found in wrong.items()
    ]  # fmt: skip
    declared = 1e-3 * HEARTBEAT_TIMEOUT
    rows += [
        Row(f"{way}: longest torque after the last heartbeat, of {len(found)}", 1e3 * max(found), "ms", "declared",
            declared, 1e3 * max(found) / declared, "<= 1 + one SYNC", 1e3 * max(found) <= declared + _SYNC,
            f"median {1e3 * statistics.median(found):.1f} ms")
        for way, found in times.items()
    ]  # fmt: skip
    publish("program_ends", rows, ["canhaptic", "python-can"])


if __name__ == "__main__":
    main()
