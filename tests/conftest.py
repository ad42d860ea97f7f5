"""Shared test settings: hypothesis deterministic, vendor dictionaries found or visibly absent, CPU time shown."""

import gc
import json
import os
import signal
from collections import Counter
from collections.abc import Generator, Iterator
from dataclasses import replace
from fnmatch import fnmatchcase
from itertools import chain
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings
from hypothesis.internal.conjecture import providers

from canhaptic.logs.writer_process import WriterProcess

settings.register_profile("thorough", derandomize=True, deadline=None, print_blob=False, max_examples=100)
settings.register_profile("canhaptic", settings.get_profile("thorough"), max_examples=10)
settings.load_profile("canhaptic")  # `make test-all` asks for the thorough one

# Examples may not depend on which modules a worker happens to have imported: hypothesis would draw the numbers in their
# source too, which takes two seconds to parse.
providers._get_local_constants = lambda: providers._local_constants

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # in the background of a shell: no Ctrl-C would reach a test
    signal.signal(signal.SIGINT, signal.default_int_handler)
for _name in ("SIGHUP", "SIGQUIT"):  # by nohup and in the background, likewise
    if hasattr(signal, _name) and signal.getsignal(getattr(signal, _name)) is signal.SIG_IGN:
        signal.signal(getattr(signal, _name), signal.SIG_DFL)
os.environ.pop("COLUMNS", None)  # that of the terminal in which the tests run says nothing about tables in pipes
gc.set_threshold(50_000, 10, 100)  # a test is short: its garbage need not be searched for as often as in a server
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # in each of the hundreds of processes: no thread a core for nothing

_FRESH = WriterProcess._spawn
REPOSITORY = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session")
def vendor_eds() -> Path:
    """The folder of real vendor dictionaries; skips, visibly, where it is absent."""
    folder = os.environ.get("CANHAPTIC_VENDOR_EDS")
    if not folder or not Path(folder).is_dir():
        pytest.skip(f"no vendor dictionaries: CANHAPTIC_VENDOR_EDS is {folder!r}, expected their folder")
    return Path(folder)


@pytest.fixture(scope="session", autouse=True)
def _forked_writers() -> Iterator[None]:
    """Forks the writer processes of logs, which saves their imports; see `forked`."""
    if hasattr(os, "fork"):
        from tests.forked import fork_writer

        WriterProcess._spawn = fork_writer  # type: ignore[assignment]
    yield
    WriterProcess._spawn = _FRESH


@pytest.fixture
def fresh_writer(monkeypatch: pytest.MonkeyPatch) -> None:
    """Starts the writer processes of a test as a run outside the tests does, with an interpreter of their own."""
    monkeypatch.setattr(WriterProcess, "_spawn", _FRESH)


@pytest.hookimpl(tryfirst=True)
def pytest_pycollect_makeitem(collector: pytest.Module | pytest.Class, obj: object) -> list[pytest.Item] | None:
    """Makes no items of a slow function for `-m "not slow"`: two workers made 4000 each, to leave them out."""
    is_slow = any(mark.name in _TIERS for mark in getattr(obj, "pytestmark", ()))
    return [] if is_slow and collector.config.option.markexpr == "not slow" else None


@pytest.hookimpl(trylast=True)  # when all cells are there
def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Marks single cells of a parametrized test as slow: those of `slow_for`, or all but those of `slow_but`.

    As above, `-m "not slow"` makes no items of them. `campaign_for` and `campaign_but` mark cells for campaigns.

    Raises:
        pytest.UsageError: A pattern matches no cell, so that it says nothing.
    """
    marks = [mark for mark in metafunc.definition.iter_markers() if mark.name in _OF_CELLS]
    cells = [call.id for call in metafunc._calls]
    for mark in marks:
        for pattern in mark.args:
            if not any(fnmatchcase(cell, pattern) for cell in cells):
                name = metafunc.definition.nodeid
                raise pytest.UsageError(f"{name}: got {pattern!r} in {mark.name}, expected a pattern of its cells")
    metafunc._calls = [
        replace(call, marks=[*call.marks, *(_OF_CELLS[mark.name] for mark in marks if _is_of(call.id, mark))])
        for call in metafunc._calls
    ]
    if metafunc.config.option.markexpr == "not slow":
        fast = [call for call in metafunc._calls if not any(mark.name in _TIERS for mark in call.marks)]
        metafunc._calls = fast or metafunc._calls[:1]  # of no cell at all pytest would make a test without parameters


_TIERS = ("slow", "campaign")
_OF_CELLS = {f"{tier}_{which}": getattr(pytest.mark, tier).mark for tier in _TIERS for which in ("for", "but")}
"""Marker with patterns of cells -> the mark that these cells get."""


def _is_of(cell: str, mark: pytest.Mark) -> bool:
    return any(fnmatchcase(cell, pattern) for pattern in mark.args) == mark.name.endswith("_for")


@pytest.hookimpl(tryfirst=True)  # before `-m` chooses
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """A test of a campaign is a slow one."""
    for item in items:
        if item.get_closest_marker("campaign"):
            item.add_marker("slow")


_SLOWEST = 10
_TESTS_TO_A_FREEZE = 100
_begun = 0  # tests of this process
_CPU = "cpu_seconds"
_spent = 0.0
"""CPU time of this process and of its children that ended [s], at the end of the last phase of a test."""


def _cpu_seconds() -> float:
    return sum(os.times()[:4])


def pytest_runtest_logstart() -> None:
    """Begins the measurement of a test in the process that runs it.

    What was imported and collected is no garbage: a walk through it takes 0.2 s, and all of them took a
    seventh of the CPU time of the tests. A run in real time ends by `gc.unfreeze`, so this is repeated; not at every
    test, for what is garbage by then stays.
    """
    global _begun, _spent
    if _begun % _TESTS_TO_A_FREEZE == 0:
        gc.collect(1)
        gc.freeze()  # asking how much is frozen would walk through it: 10 ms
    _begun += 1
    _spent = _cpu_seconds()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport() -> Generator[None, Any, Any]:
    """Adds the CPU time of a phase (setup, call, teardown) to its report, which a worker sends."""
    global _spent
    report = yield
    before, _spent = _spent, _cpu_seconds()
    report.user_properties.append((_CPU, _spent - before))
    return report


def recorded_coverage(path: Path) -> str:
    """What was last recorded of the lines that the fast tests run; measuring it doubles their CPU time."""
    how = "make bench Q=coverage RECORD=1"
    if not path.exists():
        return f"coverage of the fast tests: not recorded ({how})"
    found = json.loads(path.read_text(encoding="utf-8"))
    row = found["rows"][0]
    return f"coverage of the fast tests: {row['value']:.1f} % of the {row['row']} ({found['commit']}; {how})"


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """Ends a run with its CPU time and the slowest tests: wall-clock time says little on a machine with other work."""
    seconds: Counter[str] = Counter()
    for report in chain.from_iterable(terminalreporter.stats.values()):
        for name, value in getattr(report, "user_properties", ()):
            if name == _CPU:
                seconds[report.nodeid] += value
    if len(seconds) > _SLOWEST:
        terminalreporter.section(f"{_cpu_seconds():.0f} s of CPU; the {_SLOWEST} slowest tests")
        for test, spent in seconds.most_common(_SLOWEST):
            terminalreporter.write_line(f"{spent:6.2f} s  {test}")
        terminalreporter.write_line(recorded_coverage(REPOSITORY / "docs" / "results" / "coverage.json"))
