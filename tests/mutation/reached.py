"""Notes which functions of the package each test calls: a plugin of pytest, for `python -m tools.mutants`.

    CANHAPTIC_REACHED=FILE pytest -p tests.mutation.reached

writes one JSON line for each test: its name, how long it took, and `module:function` of all that it called. Processes
that it starts note theirs as well, where `watch_process` is called in them (the tool's `sitecustomize.py` does).
"""

import json
import os
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import FrameType
from typing import Final

import pytest

PLACE: Final = "CANHAPTIC_REACHED"
"""Name of the environment variable with the file."""
CHOSEN: Final = "CANHAPTIC_CHOSEN"
"""Name of the environment variable with a file of names of tests, one a line: those alone run, in that order."""
_PACKAGE: Final = f"{Path(__file__).resolve().parents[2] / 'canhaptic'}{os.sep}"
_called: set[tuple[str, str]] = set()


def _note(frame: FrameType, _event: str, _argument: object) -> None:
    code = frame.f_code
    if code.co_filename.startswith(_PACKAGE):
        _called.add((code.co_filename, code.co_qualname))


def named(called: tuple[str, str]) -> str:
    """Returns `module:function`; the module relative to the repository, the function without its closures."""
    path, function = called
    return f"canhaptic/{path[len(_PACKAGE) :]}:{function.split('.<locals>')[0]}"


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Leaves the tests chosen."""
    if CHOSEN in os.environ:
        names = Path(os.environ[CHOSEN]).read_text(encoding="utf-8").splitlines()
        places = {name: place for place, name in enumerate(names)}
        items[:] = sorted((i for i in items if i.nodeid in places), key=lambda item: places[item.nodeid])


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Watches one test, its fixtures included."""
    if PLACE not in os.environ:
        return (yield)
    _called.clear()
    begin = time.perf_counter()
    threading.settrace(_note)
    sys.settrace(_note)
    try:
        return (yield)
    finally:
        sys.settrace(None)
        seconds = round(time.perf_counter() - begin, 3)
        write(item.nodeid, seconds, sorted(map(named, _called)))


def write(test: str, seconds: float, names: list[str]) -> None:
    """Adds a line to the file, in one piece."""
    with Path(os.environ[PLACE]).open("a", encoding="utf-8") as file:
        file.write(json.dumps({"test": test, "seconds": seconds, "calls": names}) + "\n")


def watch_process() -> None:
    """Notes at once each function that this process calls for the first time; it may be killed at any time."""
    test = os.environ.get("PYTEST_CURRENT_TEST", "").rsplit(" ", 1)[0]
    if not test:
        return

    def note(frame: FrameType, _event: str, _argument: object) -> None:
        code = frame.f_code
        called = code.co_filename, code.co_qualname
        if code.co_filename.startswith(_PACKAGE) and called not in _called:
            _called.add(called)
            write(test, 0.0, [named(called)])

    threading.settrace(note)
    sys.settrace(note)
