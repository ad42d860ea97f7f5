"""What does a kill at any moment cost? `python -m tools.bench.kills --kills 100`: rows and frames that the logs lack.

The demo at 1 kHz in real time, in contact, with both logs. At a random time the controller is killed (SIGKILL), or one
of the processes that write its logs, or all of them at once. A cycle is lost when the controller had completed it, and
the energy log has no row of it, or the bus log no SYNC. Nothing may be lost but where controller and writers die
together: then what was still in the memory that they share goes with them.
"""

import argparse
import os
import random
import signal
import struct
import tempfile
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from canhaptic.cycle import run
from canhaptic.drive.clock import WallClock
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.replay import Recording
from canhaptic.scene.build import build
from canhaptic.scene.load import load_scene
from tools.bench.demo import CONFIG, IN_CONTACT
from tools.bench.peers import SYNC
from tools.bench.report import Row, publish

_COUNT: Final = struct.Struct("<q")
_LONGEST: Final = 1.0  # s from the first cycle to the kill
_AFTER_A_WRITER: Final = 0.4  # s that a run goes on after one of its writers was killed
_PATIENCE: Final = 5.0  # s for writers to end what they have
KINDS: Final = ("the controller", "a writer", "controller and writers")


@dataclass(slots=True)
class Lost:
    """What the runs of one kind lacked."""

    rows: list[int] = field(default_factory=list)
    syncs: list[int] = field(default_factory=list)


def _control(folder: Path, report: int) -> None:
    """Runs the demo for ever and reports the writers' process IDs and then each cycle (in a process of its own)."""
    scene = load_scene(CONFIG, [*IN_CONTACT])
    with build(scene, "real", folder / "e.h5", folder / "b.log") as experiment:
        energy_log, bus_log = experiment.energy_log, experiment.bus_log
        assert energy_log is not None
        assert bus_log is not None
        for number in (energy_log.pid, bus_log.pid):
            os.write(report, _COUNT.pack(number))
        requested: list[int] = []
        signal.signal(signal.SIGTERM, lambda number, _frame: requested.append(number))
        run(
            experiment.cycle,
            stop_requested=lambda: bool(requested),
            progress=lambda cycles: void(os.write(report, _COUNT.pack(cycles))),
        )


def void(_value: object) -> None:
    """Takes a value and returns nothing."""


def _started(folder: Path) -> tuple[int, int]:
    """Returns the process of a controller and the pipe on which it reports."""
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reader)
        try:
            _control(folder, writer)
        finally:
            os._exit(0)
    os.close(writer)
    return child, reader


def _kill(process: int, number: int) -> None:
    with suppress(ProcessLookupError):
        os.kill(process, number)


def one_kill(kind: str, chance: random.Random, folder: Path) -> tuple[int, int] | None:
    """Returns how many rows and SYNCs of completed cycles are in no log; None where the rig did not start."""
    child, reader = _started(folder)
    with os.fdopen(reader, "rb") as pipe:
        begin = pipe.read(3 * _COUNT.size)  # of both writers, and of the first cycle
        if len(begin) < 3 * _COUNT.size:
            os.waitpid(child, 0)
            return None
        *writers, _ = (number for (number,) in _COUNT.iter_unpack(begin))
        _wait(chance.uniform(0.0, _LONGEST))
        if kind == "a writer":
            _kill(chance.choice(writers), signal.SIGKILL)
            _wait(_AFTER_A_WRITER)
            _kill(child, signal.SIGTERM)
        else:
            for process in (child, *(writers if kind == KINDS[2] else ())):
                _kill(process, signal.SIGKILL)
        counts = pipe.read()
    os.waitpid(child, 0)
    whole = len(counts) // 8 * 8
    done = _COUNT.unpack(counts[whole - 8 : whole])[0] if whole else 1
    rows = _settled(lambda: _rows(folder / "e.h5"), done)
    syncs = _settled(lambda: _syncs(folder / "b.log"), done)
    return max(0, done - rows), max(0, done - syncs)


def _wait(seconds: float) -> None:
    clock = WallClock(spin_margin=0.0)
    clock.wait_until(clock.now() + round(seconds * 1e9))


def _settled(count: Callable[[], int], wanted: int) -> int:
    """Returns a count once it has reached what is wanted, or no longer grows: a writer outlives its controller."""
    clock = WallClock(spin_margin=0.0)
    begin, seen = clock.now(), count()
    while seen < wanted and clock.now() - begin < _PATIENCE * 1e9:
        _wait(0.1)
        seen = max(seen, count())
    return seen


def _rows(path: Path) -> int:
    try:
        with EnergyLog.open(path) as log:
            return log.rows
    except ValueError:  # the writer is at it
        return 0


def _syncs(path: Path) -> int:
    """Returns how many SYNCs are in the log, from the one on that found the drive enabled."""
    try:
        scene = load_scene(CONFIG)
        recording = Recording(path, scene)
    except ValueError:  # a last line that was cut
        return 0
    return sum(frame.can_id == SYNC for frame in recording.frames[recording.first_sync :])


def main() -> None:
    """Kills as often as asked and publishes the table."""
    parser = argparse.ArgumentParser(description="Rows and frames that the logs lack after a kill at any moment.")
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    chance, lost = random.Random(arguments.seed), {kind: Lost() for kind in KINDS}
    for number in range(arguments.kills):
        kind = KINDS[number % len(KINDS)]
        with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
            lacking = one_kill(kind, chance, Path(folder))
        if lacking is not None:
            lost[kind].rows.append(lacking[0])
            lost[kind].syncs.append(lacking[1])
    publish("kills", [row for kind in KINDS for row in _table(kind, lost[kind])], ["canhaptic", "h5py", "python-can"])


def _table(kind: str, lost: Lost) -> list[Row]:
    must = kind != KINDS[2]
    found = (("rows", lost.rows), ("SYNCs of the bus log", lost.syncs))
    return [
        Row(
            f"{kind}: {name} lost at most, in {len(values)} kills",
            max(values, default=0),
            "",
            "in all",
            sum(values),
            target="0" if must else "",
            met=not any(values) if must else None,
        )
        for name, values in found
    ]


if __name__ == "__main__":
    main()
