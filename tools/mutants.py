"""Do the tests notice small slips? Samples mutants of the package: `python -m tools.mutants --sample 300 --seed 1`.

Each mutant is a module with one change that a slip of the hand could make (`tests/mutation/mutator.py`), written into a
copy of the repository. First of all the tests of the rooms run once there, unchanged, and note what each of them calls
(`tests/mutation/reached.py`). A mutant then meets the tests that call its function, or, where it is in no function,
those of its room and module: quick ones first, until one fails. That one must fail again with the mutant and pass
without it: then the mutant is killed. One that ends no test run within its time is killed as well. What has run is kept
in `--kept` (JSON lines), so that the same command goes on where it was stopped. A survivor is equivalent, or a test is
missing: both are for a person to say, in `equivalent_mutants.json` or as a test.

Exit status 1 when fewer than `--at-least` of the mutants that are not equivalent were killed. 300 mutants take some two
hours of one processor; `--seconds` ends earlier, and `--only PATH:NUMBER` runs one.
"""

import argparse
import ast
import json
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from itertools import accumulate, islice
from pathlib import Path
from typing import Any, Final

import pytest

from tests.mutation.mutator import changes
from tests.mutation.reached import CHOSEN, PLACE

ROOT: Final = Path(__file__).resolve().parents[1]
ROOMS: Final[dict[str, tuple[str, ...]]] = {  # part of the package -> folders of its tests, nearest first
    "drive": ("drive", "replay", "sim_bus", "acceptance", "commission"),
    "logs": ("logs", "audit", "replay", "view"),
    "replay": ("replay", "acceptance"),
    "sim": ("sim_drive", "sim_bus", "plant", "replay", "acceptance", "touch"),
    "view": ("view", "audit", "cli", "project"),
    "result.py": ("audit", "acceptance", "cli", "view"),
    "control/certificates": ("control", "replay", "kernels", "acceptance"),
    "control/balance.py": ("control", "audit", "replay", "acceptance"),
}
EQUIVALENT: Final[dict[str, str]] = json.loads(Path(__file__).with_name("equivalent_mutants.json").read_text("utf-8"))
"""`path: name of the mutant` -> why no test can notice it, or should."""
_LONGEST: Final = 600  # s, all tests of a mutant
_QUICK: Final = 40  # tests that run before all others
_SITE: Final = """import os
if os.environ.get("CANHAPTIC_REACHED") and os.environ.get("PYTEST_CURRENT_TEST"):
    from tests.mutation.reached import watch_process
    watch_process()
"""
Reached = Mapping[str, Sequence[str]]
"""Function (`module:name`) or module -> tests that call it, quick ones first."""


def modules(rooms: Sequence[str]) -> list[Path]:
    """Returns the modules of the rooms, relative to the repository."""
    found: list[Path] = []
    for room in rooms:
        place = ROOT / "canhaptic" / room
        found += [place] if place.is_file() else sorted(place.rglob("*.py"))
    return [path.relative_to(ROOT) for path in found]


def _texts(path: Path) -> Iterator[tuple[str, ast.Module]]:
    return changes(ROOT / path, {}, None)


def sample(rooms: Sequence[str], count: int, seed: int) -> list[tuple[Path, int]]:
    """Returns so many mutants, each as module and number, every mutant of all rooms with the same chance."""
    every = [(path, number) for path in modules(rooms) for number, _ in enumerate(_texts(path))]
    return random.Random(seed).sample(every, min(count, len(every)))


def room_of(path: Path) -> str:
    """Returns the key of `ROOMS` that a module belongs to; "" where it belongs to none."""
    inside = path.relative_to("canhaptic").as_posix()
    return next((room for room in ROOMS if inside == room or inside.startswith(f"{room}/")), "")


def copied(folder: Path) -> Path:
    """Returns a copy of what git knows or would take of the repository."""
    listed = subprocess.run(
        ["git", "ls-files", "-co", "--exclude-standard"], cwd=ROOT, check=True, capture_output=True, text=True
    )
    for name in listed.stdout.splitlines():
        if (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name)
    return folder


def reached(copy: Path, folders: Sequence[str], into: Path, budget: float) -> Reached:
    """Returns which tests call which function, quick ones first; runs them all where `into` is not there yet.

    Args:
        copy: Of the repository.
        folders: Of tests.
        into: Where what they call is noted.
        budget: Time that the tests of one function may take together [s]; slower ones are left out.
    """
    if not into.exists():
        site = copy / "reached_site"
        site.mkdir(exist_ok=True)
        (site / "sitecustomize.py").write_text(_SITE, encoding="utf-8")
        words = ["-o", "timeout=900", *(f"tests/{folder}" for folder in folders)]
        _pytest(copy, words, {PLACE: str(into), "PYTHONPATH": f"{copy}{os.pathsep}{site}"}, None)
    seconds: dict[str, float] = {}
    callers: dict[str, set[str]] = {}
    for line in into.read_text(encoding="utf-8").splitlines():
        one = json.loads(line)
        seconds[one["test"]] = max(one["seconds"], seconds.get(one["test"], 0.0))
        for name in one["calls"]:
            callers.setdefault(name, set()).add(one["test"])
            callers.setdefault(name.partition(":")[0], set()).add(one["test"])
    for module in [name for name in callers if name.endswith(".py")]:
        room = room_of(Path(module))
        near = tuple(f"tests/{folder}/" for folder in ROOMS[room][:2]) if room else ()
        callers[module] |= {test for test in seconds if near and test.startswith(near)}
    for room, near in ROOMS.items():  # for modules that run in processes which no site reaches, as the log writer does
        callers[room] = {test for test in seconds if test.startswith(tuple(f"tests/{folder}/" for folder in near[:2]))}
    found = {}
    for name, tests in callers.items():
        ordered = sorted(tests, key=seconds.__getitem__)
        total = accumulate(seconds[test] for test in ordered)
        found[name] = [test for test, sofar in zip(ordered, total, strict=True) if sofar <= budget]
    return found


def _tests_of(mutant: str, path: Path, callers: Reached) -> Sequence[str]:
    """Returns the tests that call what a mutant is in; those of its room where it is in no function."""
    scope = mutant.partition(":")[0]
    is_class = scope.rpartition(".")[2].lstrip("_")[:1].isupper()  # whose body runs with the import, in one test alone
    found = callers.get(f"{path.as_posix()}:{scope}", ())
    found = found if found and not is_class else callers.get(path.as_posix(), ())
    return found or callers.get(room_of(path), ())


def outcome(copy: Path, path: Path, number: int, callers: Reached) -> dict[str, Any]:
    """Returns `{path, number, name, tests, killed_by}` of one mutant; `killed_by` is None for a survivor."""
    name, tree = next(islice(_texts(path), number, None))
    target, kept = copy / path, (copy / path).read_bytes()
    begin, tests = time.monotonic(), _tests_of(name, path, callers)
    mutant = ast.unparse(tree).encode()
    killer, passed = None, 0
    for few in (_QUICK, len(tests)):
        batch, passed = list(tests[passed:few]), max(passed, few)
        while batch and killer is None:
            _put(target, mutant)
            failed = _failure(copy, batch)
            if not failed:
                break
            again = _failure(copy, [failed]) if "::" in failed else failed
            _put(target, kept)
            if "::" not in failed or (again and not _failure(copy, [failed])):
                killer = failed
            batch = [test for test in batch if test != failed]
    _put(target, kept)
    found = {"path": path.as_posix(), "number": number, "name": name, "tests": len(tests), "killed_by": killer}
    return {**found, "seconds": round(time.monotonic() - begin, 1)}


def _put(target: Path, text: bytes) -> None:
    """Writes a module and forgets its compiled form, whose time stamp is no better than a second."""
    target.write_bytes(text)
    for compiled in (target.parent / "__pycache__").glob(f"{target.stem}.*.pyc"):
        compiled.unlink()


def _failure(copy: Path, tests: Sequence[str]) -> str:
    """Returns the first test that fails; "" where all pass, and what happened where pytest itself did not end well."""
    listed = copy / "tests_of_mutant.txt"
    listed.write_text("\n".join(tests), encoding="utf-8")
    try:
        files = dict.fromkeys(test.partition("::")[0] for test in tests)
        done = _pytest(copy, ["-x", *files], {"PYTHONPATH": str(copy), CHOSEN: str(listed)}, _LONGEST)
    except subprocess.TimeoutExpired:
        return f"no end within {_LONGEST} s"
    if done.returncode in (0, pytest.ExitCode.NO_TESTS_COLLECTED):  # none: the tests noted are no longer there
        return ""
    known = set(tests)
    for line in done.stdout.splitlines():
        if line.startswith(("FAILED", "ERROR")):
            name = line.split(" ", 1)[1]
            found = next((test for test in known if name == test or name.startswith(f"{test} - ")), "")
            return found or f"{line[:160]}"
    return f"pytest ended with {done.returncode}"


def _pytest(
    copy: Path, words: Sequence[str], more: Mapping[str, str], longest: float | None
) -> subprocess.CompletedProcess[str]:
    fixed = [
        "-m",
        "pytest",
        "-q",
        "-p",
        "tests.mutation.reached",
        "-p",
        "no:cacheprovider",
        "-m",
        "not slow",
        "--no-header",
    ]
    environment = {**os.environ, "PYTHONDONTWRITEBYTECODE": "", **more}
    return subprocess.run(
        [sys.executable, *fixed, *words], cwd=copy, env=environment, capture_output=True, text=True, timeout=longest,
        check=False,
    )  # fmt: skip


def _read(kept: Path) -> dict[tuple[str, int], dict[str, Any]]:
    lines = kept.read_text(encoding="utf-8").splitlines() if kept.exists() else []
    found: list[dict[str, Any]] = [json.loads(line) for line in lines]
    return {(one["path"], one["number"]): one for one in found}


def report(outcomes: Sequence[dict[str, Any]], at_least: float) -> int:
    """Prints how many were killed and who survived; returns the exit status."""
    survivors = [one for one in outcomes if one["killed_by"] is None]
    noticed = [one for one in survivors if f"{one['path']}: {one['name']}" not in EQUIVALENT]
    judged = len(outcomes) - len(survivors) + len(noticed)
    share = (judged - len(noticed)) / judged if judged else 1.0
    for one in noticed:
        print(f"survived: {one['path']}:{one['number']}: {one['name']}")
    print(f"{len(outcomes)} mutants, {len(outcomes) - judged} equivalent, {100.0 * share:.1f} % of the others killed")
    return 0 if share >= at_least else 1


def main() -> int:
    """Runs what the arguments ask for; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--sample", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--rooms", nargs="+", choices=ROOMS, default=["drive", "logs", "replay", "sim", "view", "result.py"]
    )
    parser.add_argument("--only", metavar="PATH:NUMBER", help="one mutant")
    parser.add_argument("--seconds", type=float, default=1e9, help="starts no further mutant after that time")
    parser.add_argument("--at-least", type=float, default=0.9, help="share that must be killed")
    parser.add_argument("--kept", type=Path, default=ROOT / "bench_output" / "mutants.jsonl")
    parser.add_argument("--budget", type=float, default=600.0, help="s of tests for one mutant, as they were noted")
    parser.add_argument("--reached", type=Path, default=ROOT / "bench_output" / "reached.jsonl")
    arguments = parser.parse_args()
    if arguments.only:
        path, _, number = arguments.only.rpartition(":")
        wanted = [(Path(path), int(number))]
    else:
        wanted = sample(arguments.rooms, arguments.sample, arguments.seed)
    done = {} if arguments.only else _read(arguments.kept)
    arguments.kept.parent.mkdir(parents=True, exist_ok=True)
    until = time.monotonic() + arguments.seconds
    with tempfile.TemporaryDirectory() as folder:
        copy = copied(Path(folder))
        folders = sorted({folder for room in ROOMS.values() for folder in room if (ROOT / "tests" / folder).is_dir()})
        callers = reached(copy, folders, arguments.reached, arguments.budget)
        for path, number in wanted:
            if (path.as_posix(), number) in done or time.monotonic() > until:
                continue
            one = done[path.as_posix(), number] = outcome(copy, path, number, callers)
            print(f"{one['path']}:{number}: {one['killed_by'] or 'SURVIVED'} ({one['seconds']} s)", flush=True)
            with arguments.kept.open("a", encoding="utf-8") as file:
                file.write(json.dumps(one) + "\n")
    found = [done[path.as_posix(), number] for path, number in wanted if (path.as_posix(), number) in done]
    return report(found, arguments.at_least)


if __name__ == "__main__":
    sys.exit(main())
