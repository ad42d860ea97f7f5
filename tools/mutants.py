"""Do the tests notice small slips? Mutants of the package: `python -m tools.mutants --rooms control/certificates`.

Each mutant is a module with one change that a slip of the hand could make (`tests/mutation/mutator.py`), written into a
copy of the repository. First of all each test of the rooms runs there once, unchanged, for its time and for the lines
that it reaches (`tests/mutation/reached.py`); what passes is kept in `--reached` until the package or the test changes.
A mutant then meets the recordings whose replay reaches its lines and the other tests that do, those that call its
function and, where it is in no function, those of its module and room: quick ones first, and those that killed others
of the module, until one fails or their times fill the `--budget`. They run in forks of a process that has imported
everything (`tools/mutant_server.py`). A test that fails must fail again with the mutant and pass without it, the first
times that it kills: then the mutant is killed. One that ends no run of tests within its time is killed as well. What
has run is kept in `--kept` (JSON lines), so that the same command goes on where it was stopped. A survivor is
equivalent, or a test is missing: both are for a person to say, in `equivalent_mutants.json` or as a test.

Exit status 1 when fewer than `--at-least` of the mutants that are not equivalent were killed. Mutants come in random
order, so that those run when `--seconds` are over are a sample; `--only PATH:NUMBER` runs one, and `--again` the
survivors.
"""

import argparse
import ast
import hashlib
import json
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any, Final, NamedTuple

from tests.mutation.mutator import Change, changes
from tests.mutation.reached import PLACE
from tools.mutant_server import NOT_SWAPPED, TestServer

ROOT: Final = Path(__file__).resolve().parents[1]
_ACCOUNT: Final = ("control", "audit", "replay")
_CONTROL: Final = ("control", "replay", "kernels")
ROOMS: Final[dict[str, tuple[str, ...]]] = {  # part of the package -> folders of its tests, nearest first
    "drive": ("drive", "replay", "sim_bus", "acceptance", "commission"),
    "logs": ("logs", "audit", "replay", "view"),
    "replay.py": ("replay", "acceptance"),
    "sim": ("sim_drive", "sim_bus", "plant", "replay", "acceptance", "touch"),
    "view": ("view", "audit", "cli", "project"),
    "result.py": ("audit", "acceptance", "cli", "view"),
    "commission": ("commission", "drive", "journeys"),
    "lab/rivals": ("lab/rivals", *_CONTROL),
    "control/admittance": (*_CONTROL, "lab/displays", "acceptance"),
    "scene/displays.py": ("lab/displays", "control", "scene/test_build.py"),
    "control": (*_CONTROL, "lab/judge"),
    "control/certificates": _CONTROL,
    "control/passivity": _CONTROL,
    "control/multi_axis": _CONTROL,
    "control/verdict.py": _ACCOUNT,
    "control/balance.py": _ACCOUNT,
    "control/axis_meter.py": _ACCOUNT,
    "control/ledger.py": (*_ACCOUNT, "acceptance/test_energy_loss.py"),
    "meters.py": _ACCOUNT,
    "drive/safety/limiter.py": ("mutation", "replay"),
}
EQUIVALENT: Final[dict[str, str]] = json.loads(Path(__file__).with_name("equivalent_mutants.json").read_text("utf-8"))
"""`path: name of the mutant` -> why no test can notice it, or should."""
_RECORDINGS: Final = "tests/replay/test_replay.py::test_the_master_sends_today_what_it_sent_when_recorded["
_TRUSTED: Final = 2  # kills that were repeated
_FORK: Final = 0.02  # s that any test takes at least
_SITE: Final = f"""import os
if os.environ.get("{PLACE}") and os.environ.get("PYTEST_CURRENT_TEST"):
    from tests.mutation.reached import watch_process
    watch_process()
"""


class Test(NamedTuple):
    """What is known of one test."""

    name: str
    seconds: float
    calls: frozenset[str]  # `module:function`
    lines: Mapping[str, frozenset[int]]  # of modules


def modules(rooms: Sequence[str]) -> list[Path]:
    """Returns the modules of the rooms, relative to the repository, without those of a room inside."""
    found: dict[Path, None] = {}
    for room in rooms:
        place = ROOT / "canhaptic" / room
        paths = [path.relative_to(ROOT) for path in ([place] if place.is_file() else sorted(place.rglob("*.py")))]
        found |= dict.fromkeys(path for path in paths if room not in ROOMS or room_of(path) == room)
    return list(found)


def sample(rooms: Sequence[str], count: int, seed: int) -> list[tuple[Path, int]]:
    """Returns so many mutants of each room, as module and number, every mutant of a room with the same chance."""
    found = []
    for room in rooms:
        every = [(path, number) for path in modules([room]) for number, _ in enumerate(changes(ROOT / path, {}, None))]
        found += random.Random(seed).sample(every, min(count, len(every)))
    return found


def room_of(path: Path) -> str:
    """Returns the longest key of `ROOMS` that a module belongs to; "" where it belongs to none."""
    inside = path.relative_to("canhaptic").as_posix()
    return max((room for room in ROOMS if inside == room or inside.startswith(f"{room}/")), key=len, default="")


def copied(folder: Path) -> Path:
    """Returns a copy of what git knows or would take of the repository."""
    listed = subprocess.run(
        ["git", "ls-files", "-co", "--exclude-standard"], cwd=ROOT, check=True, capture_output=True, text=True
    )
    for name in listed.stdout.splitlines():
        if (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name)
    site = folder / "reached_site"
    site.mkdir()
    (site / "sitecustomize.py").write_text(_SITE, encoding="utf-8")
    return folder


def _mark(copy: Path, files: Iterable[str]) -> str:
    found = hashlib.sha256()
    for name in sorted(files):
        found.update(name.encode() + (copy / name).read_bytes())
    return found.hexdigest()[:16]


def reached(copy: Path, server: TestServer, wanted: Sequence[Path], slowest: float, kept: Path) -> list[Test]:
    """Returns what is known of every test that passes; watches those of which nothing is kept.

    Args:
        copy: Of the repository.
        server: With its tests.
        wanted: Modules of which lines matter.
        slowest: Tests that take longer are left out [s].
        kept: Where what they reach is kept.
    """
    package = _mark(copy, (str(path.relative_to(copy)) for path in (copy / "canhaptic").rglob("*.py")))
    lines_of = [path.as_posix() for path in wanted]
    by_file: dict[str, list[str]] = {}
    for test in server.tests:
        by_file.setdefault(test.partition("::")[0], []).append(test)
    known = {one["file"]: one for one in map(json.loads, kept.read_text().splitlines())} if kept.exists() else {}
    found = []
    for file, tests in by_file.items():
        key = [package, _mark(copy, [file]), hashlib.sha256(json.dumps([*lines_of, slowest]).encode()).hexdigest()[:16]]
        if known.get(file, {}).get("key") != key:
            print(f"watched: {file}", flush=True)
            known[file] = {"file": file, "key": key, "reached": server.watch(tests, lines_of, slowest)}
            with kept.open("a", encoding="utf-8") as stream:
                stream.write(json.dumps(known[file]) + "\n")
        found += [_test(one) for one in known[file]["reached"] if one["passes"]]
    return found


def _test(one: Mapping[str, Any]) -> Test:
    lines = {path: frozenset(lines) for path, lines in one["lines"].items()}
    return Test(one["test"], one["seconds"], frozenset(one["calls"]), lines)


class Chooser:
    """Which tests a mutant meets, in which order.

    Args:
        tests: What is known of each.
        budget: Time that those of one mutant may take together [s].
    """

    def __init__(self, tests: Sequence[Test], budget: float) -> None:
        self._tests, self._budget = tests, budget
        self._kills: Counter[tuple[str, str]] = Counter()
        self.seconds = {test.name: test.seconds for test in tests}

    def tests_for(self, path: str, change: Change) -> list[str]:
        """Returns the names of the tests for a change of a module."""
        scope = change.name.partition(": ")[0]
        wanted = frozenset(range(change.first, change.last + 1))
        by_line, by_call, by_module = [], [], []
        for test in self._tests:
            if wanted & test.lines.get(path, frozenset()):
                by_line.append(test)
            elif f"{path}:{scope}" in test.calls:
                by_call.append(test)
            elif any(call.startswith(f"{path}:") for call in test.calls):
                by_module.append(test)
        if not by_line and not by_call:  # of the module as it is imported, or of processes that no watch reaches
            near = tuple(f"tests/{folder}" for folder in ROOMS[room_of(Path(path))][:2])
            by_call = by_module or [test for test in self._tests if test.name.startswith(near)]
        ordered = [*sorted(by_line, key=lambda t: self._order(path, t)), *sorted(by_call, key=lambda t: t.seconds)]
        chosen, left = [], self._budget
        for test in ordered:
            if test.seconds <= left:
                chosen.append(test.name)
                left -= test.seconds
        return chosen

    def _order(self, path: str, test: Test) -> float:
        return (test.seconds + _FORK) / (1 + self._kills[path, test.name])

    def note(self, path: str, killer: str) -> None:
        """Takes a kill, so that the same test comes earlier for other mutants of the module."""
        self._kills[path, killer] += 1

    def trusts(self, test: str) -> bool:
        """Whether a test failed for mutants alone, as often as it was seen."""
        return sum(count for (_, name), count in self._kills.items() if name == test) >= _TRUSTED

    def longest(self, tests: Sequence[str]) -> float:
        """Returns how long tests may run before they count as endless [s]."""
        return 20.0 + 10.0 * sum(self.seconds.get(test, 0.0) for test in tests)


class Campaign:
    """Runs mutants.

    Args:
        copy: Of the repository.
        server: With the tests.
        chooser: Of them.
    """

    def __init__(self, copy: Path, server: TestServer, chooser: Chooser) -> None:
        self._copy, self._server, self._chooser = copy, server, chooser

    def outcome(self, path: Path, number: int) -> dict[str, Any]:
        """Returns `{path, number, name, tests, killed_by}` of one mutant; `killed_by` is None for a survivor."""
        change = next(islice(changes(self._copy / path, {}, None), number, None))
        target, kept = self._copy / path, (self._copy / path).read_bytes()
        text, begin = ast.unparse(change.tree), time.monotonic()
        tests = left = self._chooser.tests_for(path.as_posix(), change)
        killer = None
        while left and killer is None:
            _put(target, text.encode())
            failed = self._failure(path, change, text, left)
            if not failed:
                break
            if failed.startswith(_RECORDINGS) or self._chooser.trusts(failed):  # a replay has no chance in it
                killer = failed
                break
            if "::" not in failed:
                _put(target, kept)
                if self._server.run_cold(left[:1], self._chooser.longest(left[:1])):
                    left = left[1:]  # the first does not end in time without a mutant either
                    continue
                killer = failed
                break
            again = self._failure(path, change, text, [failed])
            _put(target, kept)
            if again and not self._server.run([failed], self._chooser.longest([failed])):
                killer = failed
            left = [test for test in left if test != failed]
        _put(target, kept)
        if killer:
            self._chooser.note(path.as_posix(), killer)
        found = {"path": path.as_posix(), "number": number, "name": change.name, "tests": len(tests)}
        return {**found, "killed_by": killer, "seconds": round(time.monotonic() - begin, 2)}

    def _failure(self, path: Path, change: Change, text: str, tests: Sequence[str]) -> str:
        """Returns the first test that fails; "" where all pass, and what happened where a run did not end well."""
        scope, longest = change.name.partition(": ")[0], self._chooser.longest(tests)
        if f"{path.as_posix()}:{scope}" not in self._server.imported:
            found = self._server.run(tests, longest, {"path": path.as_posix(), "scope": scope, "text": text})
            if found != NOT_SWAPPED:
                return found
        return self._server.run_cold(tests, longest)


def _put(target: Path, text: bytes) -> None:
    """Writes a module and forgets its compiled form, whose time stamp is no better than a second."""
    target.write_bytes(text)
    for compiled in (target.parent / "__pycache__").glob(f"{target.stem}.*.pyc"):
        compiled.unlink()


def _read(kept: Path) -> dict[tuple[str, str], dict[str, Any]]:
    lines = kept.read_text(encoding="utf-8").splitlines() if kept.exists() else []
    found: list[dict[str, Any]] = [json.loads(line) for line in lines]
    return {(one["path"], one["name"]): one for one in found}


def _way(one: Mapping[str, Any]) -> str:
    killer = one["killed_by"]
    if killer is None:
        return "equivalent" if f"{one['path']}: {one['name']}" in EQUIVALENT else "open"
    return "recording" if killer.startswith(_RECORDINGS) else "test"


def report(outcomes: Sequence[dict[str, Any]], at_least: float) -> int:
    """Prints how many were killed and who survived; returns the exit status."""
    ways = {room: Counter[str]() for room in sorted({room_of(Path(one["path"])) for one in outcomes})}
    for one in outcomes:
        ways[room_of(Path(one["path"]))][_way(one)] += 1
        if _way(one) == "open":
            print(f"survived: {one['path']}:{one['number']}: {one['name']}")
    columns = ("recording", "test", "equivalent", "open")
    print("| room | mutants | judged | killed by a recording | by a test | equivalent | open |")
    print("|---|---|---|---|---|---|---|")
    for room, found in ways.items():
        whole = sum(1 for path in modules([room]) for _ in changes(ROOT / path, {}, None))
        print(f"| {room} | {whole} | {found.total()} | {' | '.join(str(found[column]) for column in columns)} |")
    total = sum(ways.values(), Counter[str]())
    judged = total.total() - total["equivalent"]
    share = (judged - total["open"]) / judged if judged else 1.0
    print(f"{total.total()} mutants, {total['equivalent']} equivalent, {100.0 * share:.1f} % of the others killed")
    return 0 if share >= at_least else 1


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--sample", type=int, default=300, help="mutants; more than there are: all")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--rooms", nargs="+", default=["drive", "logs", "replay.py", "sim", "view", "result.py"],
        help=f"{', '.join(ROOMS)}, or a module inside one of them",
    )  # fmt: skip
    parser.add_argument("--tests", nargs="+", metavar="PATH", help="inside tests/, in the place of those of the rooms")
    parser.add_argument("--only", metavar="PATH:NUMBER", help="one mutant")
    parser.add_argument("--functions", action="store_true", help="those in functions alone: others take an import each")
    parser.add_argument("--again", action="store_true", help="runs survivors again")
    parser.add_argument(
        "--seconds", type=float, default=1e9, help="starts no further mutant after that time; 0: the table alone"
    )
    parser.add_argument("--at-least", type=float, default=0.9, help="share that must be killed")
    parser.add_argument("--kept", type=Path, default=ROOT / "bench_output" / "mutants.jsonl")
    parser.add_argument("--budget", type=float, default=60.0, help="s of tests for one mutant, on a quiet machine")
    parser.add_argument("--slowest", type=float, default=1.0, help="s of a single test; slower ones are left out")
    parser.add_argument("--reached", type=Path, default=ROOT / "bench_output" / "reached.jsonl")
    return parser.parse_args()


def _wanted(arguments: argparse.Namespace) -> list[tuple[Path, int]]:
    if arguments.only:
        path, _, number = arguments.only.rpartition(":")
        return [(Path(path), int(number))]
    return sample(arguments.rooms, arguments.sample, arguments.seed)


def _names(wanted: Sequence[tuple[Path, int]]) -> Iterator[tuple[Path, int, str]]:
    """Yields each mutant with its name."""
    names = {path: [change.name for change in changes(ROOT / path, {}, None)] for path in {path for path, _ in wanted}}
    for path, number in wanted:
        yield path, number, names[path][number]


def _is_in_function(name: str) -> bool:
    scope = name.partition(": ")[0]
    return scope != "module" and not scope.rpartition(".")[2].lstrip("_")[:1].isupper()


def _run(
    arguments: argparse.Namespace, wanted: Sequence[tuple[Path, int, str]], done: dict[tuple[str, str], dict[str, Any]]
) -> None:
    """Runs the mutants that are not done yet; adds each to those that are."""
    until = time.monotonic() + arguments.seconds
    rooms = sorted({room_of(path) for path, _, _ in wanted})
    places = arguments.tests or {place for room in rooms for place in ROOMS[room]}
    folders = sorted(f"tests/{place}" for place in places)
    with tempfile.TemporaryDirectory() as folder:
        copy = copied(Path(folder).resolve())
        server = TestServer(copy, folders)
        paths = sorted({path for path, _, _ in wanted})
        tests = reached(copy, server, paths, arguments.slowest, arguments.reached)
        campaign = Campaign(copy, server, Chooser(tests, arguments.budget))
        for path, number, name in wanted:
            before = done.get((path.as_posix(), name))
            if time.monotonic() > until or (before and not (arguments.again and before["killed_by"] is None)):
                continue
            one = done[path.as_posix(), name] = campaign.outcome(path, number)
            print(f"{one['path']}:{number}: {one['killed_by'] or 'SURVIVED'} ({one['seconds']} s)", flush=True)
            with arguments.kept.open("a", encoding="utf-8") as file:
                file.write(json.dumps(one) + "\n")
        server.close()


def main() -> int:
    """Runs what the arguments ask for; returns the exit status."""
    arguments = _arguments()
    wanted = [one for one in _names(_wanted(arguments)) if not arguments.functions or _is_in_function(one[2])]
    done = {} if arguments.only else _read(arguments.kept)
    arguments.kept.parent.mkdir(parents=True, exist_ok=True)
    if arguments.seconds > 0.0:
        _run(arguments, wanted, done)
    found = [done[path.as_posix(), name] for path, _, name in wanted if (path.as_posix(), name) in done]
    return report(found, arguments.at_least)


if __name__ == "__main__":
    sys.exit(main())
