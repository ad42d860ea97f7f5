"""Damages files of every kind and gives them to the commands that read them: `python -m tools.campaign --seed 1`.

Each case runs in a process of its own, forked once everything is imported (Linux, macOS), so that its time and memory
are its own. Counted as faulty: a traceback, a case that is killed, as it is after 60 s, one that takes 300 MB, a
command that takes 10 s of a processor, and a wrong pass:

- scene: `check` is content and `run` then refuses the scene as wrong input;
- dictionary: `new --simulate` writes a scene that `check` or `run` refuses;
- energy log: `inspect --check --recompute` passes although a column of a port is not what was recorded;
- bus log: `replay` says identical although the frames of the master are not those that were recorded.

Exit status 1 when anything was found. A case is repeated by its kind, number and seed: `--only scene:17`.
"""

import argparse
import contextlib
import gc
import io
import json
import os
import random
import resource
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, NamedTuple

from canhaptic.cli.main import main as command
from canhaptic.errors import CanHapticError
from canhaptic.logs.bus_reader import read_bus_log
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.replay import roles_of
from canhaptic.scene.load import load_scene
from tools.mutations import mutated_dictionary, mutated_frames, mutated_hdf5, mutated_scene

ROOT: Final = Path(__file__).resolve().parents[1]
DEMO: Final = ROOT / "configs" / "demo.yaml"
_BAD_INPUT: Final = 2
_LONGEST: Final = 10.0  # s, one command
_LARGEST: Final = 300.0  # MB, one case
_BARE: Final = 60.0  # MB, a process with everything imported; one that a case is forked from may hold more
_KILLED_AFTER: Final = 60  # s
_SHORT: Final = ("--pace", "free", "--duration", "0.02")


class Outcome(NamedTuple):
    """What became of one case."""

    statuses: list[tuple[str, int]]  # command, exit status
    trouble: str  # a traceback, or why it is a wrong pass; empty when nothing was found
    longest: float  # s of a processor, of one command
    memory: float  # MB

    def faults(self) -> list[str]:
        """Returns what is wrong with it."""
        found = [self.trouble] if self.trouble else []
        if self.longest > _LONGEST:
            found.append(f"too long: {self.longest:.1f} s")
        if self.memory > _LARGEST:
            found.append(f"too large: {self.memory:.0f} MB")
        return found


class Session:
    """Runs commands in this process and notes their exit status and time."""

    def __init__(self) -> None:
        self.statuses: list[tuple[str, int]] = []
        self.longest = 0.0

    def __call__(self, *words: object) -> int:
        """Returns the exit status of one command."""
        began = _cpu()
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            try:
                status = command([str(word) for word in words])
            except SystemExit as end:  # argparse
                status = end.code if isinstance(end.code, int) else _BAD_INPUT
        self.longest = max(self.longest, _cpu() - began)
        self.statuses.append((str(words[0]), status))
        return status


def _cpu() -> float:
    """Returns the time [s] that this process and its children had of a processor: no other load counts."""
    used = os.times()
    return used.user + used.system + used.children_user + used.children_system


Case = Callable[[random.Random, Path, Session], str]
"""Damages a file in a folder and runs commands on it; returns why a pass was wrong, or ""."""


def scene_case(chance: random.Random, folder: Path, run: Session) -> str:
    """A scene file, as `check` and `run` take it."""
    sources = [path for path in sorted((ROOT / "configs").glob("*.yaml")) if path.name[:4] not in ("sock", "far_")]
    source = chance.choice(sources)
    path = folder / "scene.yaml"
    text = source.read_text(encoding="utf-8").replace("../", f"{ROOT}/")
    path.write_bytes(mutated_scene(chance, text))
    if run("check", path) != 0 or load_scene(path).bus.interface != "virtual":
        return ""
    return "check is content, run refuses the scene" if run("run", path, *_SHORT) == _BAD_INPUT else ""


def dictionary_case(chance: random.Random, folder: Path, run: Session) -> str:
    """An EDS, as `check-eds` and `new` take it, and the scene that is made of it."""
    sources = sorted([*(ROOT / "eds").glob("*.eds"), *(ROOT / "tests" / "sim_drive" / "eds").glob("*.eds")])
    path, made = folder / "drive.eds", folder / "made.yaml"
    path.write_bytes(mutated_dictionary(chance, chance.choice(sources).read_text(encoding="utf-8", errors="replace")))
    run("check-eds", path, *chance.choice(((), ("--json",))))
    if run("new", path, "--simulate", "--out", made) != 0:
        return ""
    refused = [name for name in (("check", made), ("run", made, *_SHORT)) if run(*name) != 0]
    return f"new makes a scene that {refused[0][0]} refuses" if refused else ""


def energy_log_case(chance: random.Random, folder: Path, run: Session) -> str:
    """An energy log, as `inspect` takes it."""
    whole, path = folder / "run.h5", folder / "damaged.h5"
    path.write_bytes(mutated_hdf5(chance, whole.read_bytes()))
    more = chance.choice(((), ("--json",), ("--compare", whole), ("--csv", folder / "table.csv")))
    run("inspect", path, *more)
    has_passed = run("inspect", path, "--check", "in >= 0", "--recompute") == 0
    run("inspect", path, "--repair", folder / "repaired.h5", "--recompute")
    return "inspect passes though a column differs" if has_passed and not _same_columns(whole, path) else ""


def bus_log_case(chance: random.Random, folder: Path, run: Session) -> str:
    """A bus log, as `inspect --frames`, `replay` and `inspect` take it."""
    whole, path = folder / "run.log", folder / "damaged.log"
    path.write_bytes(mutated_frames(chance, whole.read_bytes()))
    run("decode", path, *chance.choice(((), ("--json",), ("--config", DEMO))))
    run("inspect", path, "--config", DEMO, "--check", "in >= 0")
    if run("replay", path, "--config", DEMO, *chance.choice(((), ("--json",), ("--account",), ("--from-sync",)))) != 0:
        return ""
    expected, found = _sent(whole), _sent(path)
    return "" if found == expected[: len(found)] or found == expected[-len(found) :] else "replay passes a wrong frame"


CASES: Final[dict[str, Case]] = {
    "scene": scene_case,
    "dictionary": dictionary_case,
    "energy_log": energy_log_case,
    "bus_log": bus_log_case,
}


def _same_columns(whole: Path, other: Path) -> bool:
    with EnergyLog.open(whole) as first, EnergyLog.open(other) as second:
        return first.ports.keys() == second.ports.keys() and all(
            first.ports[port][name].tobytes() == second.ports[port][name].tobytes()
            for port in first.ports
            for name in first.ports[port]
        )


def _sent(path: Path) -> list[tuple[int, bytes]]:
    """Returns what the master sent but its heartbeats."""
    roles = roles_of(load_scene(DEMO))
    names = {cob_id for _, cob_id in roles.master} - {roles.heartbeat}
    return [(frame.can_id, bytes(frame.data)) for frame in read_bus_log(path) if frame.can_id in names]


def run_case(case: Case, seed: str, folder: Path) -> Outcome:
    """Returns what became of one case in a process of its own."""
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reader)
        signal.alarm(_KILLED_AFTER)
        with os.fdopen(writer, "w", encoding="utf-8") as answer:
            json.dump(_in_child(case, seed, folder), answer)
        os._exit(0)
    os.close(writer)
    with os.fdopen(reader, encoding="utf-8") as answer:
        text = answer.read()
    _, status, used = os.wait4(child, 0)
    if status or not text:  # it left no figure of what it shared with this process
        return Outcome([], f"killed by signal {os.WTERMSIG(status)}", 0.0, 0.0)
    said = json.loads(text)
    memory = (used.ru_maxrss - said["begun"]) / (1 << 20 if sys.platform == "darwin" else 1 << 10) + _BARE
    return Outcome([tuple(pair) for pair in said["statuses"]], said["trouble"], said["longest"], memory)


def _in_child(case: Case, seed: str, folder: Path) -> dict[str, Any]:
    session, begun = Session(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    try:
        trouble = case(random.Random(seed), folder, session)
    except CanHapticError as error:
        trouble = f"refused only by the judge: {error}"
    except BaseException:
        trouble = traceback.format_exc()
    return {"statuses": session.statuses, "trouble": trouble, "longest": session.longest, "begun": begun}


def record(folder: Path) -> None:
    """Records the run whose logs are damaged, with a contact, and has every command import what it needs."""
    session = Session()
    logs = ("--log", folder / "run.h5", "--bus-log", folder / "run.log")
    assert session("run", DEMO, "--pace", "free", "--duration", "1.2", *logs) == 0
    assert session("inspect", folder / "run.h5", "--recompute", "--check", "in >= 0") == 0
    assert session("replay", folder / "run.log", "--config", DEMO) == 0
    assert session("decode", folder / "run.log") == session("check", DEMO) == 0
    assert session("inspect", folder / "run.log", "--config", DEMO) == 0
    assert session("inspect", folder / "run.h5", "--repair", folder / "repaired.h5") == 0
    dictionary = ROOT / "eds" / "cia402_servo.eds"
    assert session("check-eds", dictionary) == session("new", dictionary, "--out", folder / "made.yaml") == 0
    gc.freeze()  # a collection would copy the memory that a case shares with this process


def campaign(kind: str, numbers: range, seed: int, folder: Path, until: float) -> int:
    """Runs the cases of one kind until a time [s, monotonic], prints the figures, and returns how many are faulty."""
    statuses, faulty, longest, memory, ran = Counter[str](), 0, 0.0, 0.0, 0
    for number in numbers:
        if time.monotonic() > until:
            break
        with tempfile.TemporaryDirectory(dir=folder) as own:
            for log in ("run.h5", "run.log"):
                (Path(own) / log).symlink_to(folder / log)
            outcome = run_case(CASES[kind], f"{kind}:{seed}:{number}", Path(own))
        ran += 1
        statuses.update(f"{name}={status}" for name, status in outcome.statuses)
        longest, memory = max(longest, outcome.longest), max(memory, outcome.memory)
        faults = outcome.faults()
        faulty += bool(faults)
        for fault in faults:
            print(f"{kind}:{number} (seed {seed}): {fault}", flush=True)
    print(
        f"{kind}: {ran} cases, {faulty} faulty, longest command {longest:.2f} s, most memory {memory:.0f} MB; "
        + ", ".join(f"{name}: {count}" for name, count in sorted(statuses.items())),
        flush=True,
    )
    return faulty


def main() -> int:
    """Runs what the arguments ask for; returns 1 when a case was faulty."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--seed", type=int, default=1)
    for kind, count in (("scene", 5000), ("dictionary", 500), ("energy_log", 500), ("bus_log", 500)):
        parser.add_argument(f"--{kind.replace('_', '-')}", type=int, default=count, metavar="CASES")
    parser.add_argument("--only", metavar="KIND:NUMBER", help="one case, again")
    parser.add_argument("--seconds", type=float, default=1e9, help="time for each kind")
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    if arguments.only:
        kind, _, number = arguments.only.partition(":")
        plan = {kind: range(int(number), int(number) + 1)}
    else:
        plan = {kind: range(getattr(arguments, kind)) for kind in CASES}
    with tempfile.TemporaryDirectory() as folder:
        record(Path(folder))
        ends = (
            campaign(kind, numbers, arguments.seed, Path(folder), time.monotonic() + arguments.seconds)
            for kind, numbers in plan.items()
        )
        return 1 if sum(ends) else 0


if __name__ == "__main__":
    sys.exit(main())
