"""Runs tests against mutants without importing anything anew: processes that are forked once all is imported.

Three kinds of process. The one that starts this imports no module of the package. `TestServer` is a fork of it that has
collected the tests, so that package and tests are imported there. Each run of tests is a fork of either:

- warm, of the server, where the mutant is in a function: its code takes the place of that of the function, wherever it
  was imported to. Some 20 ms, and the tests;
- cold, of a process that has imported nothing yet, where an import runs the changed line: a constant, the fields of a
  class, a function that a module calls while it is imported. Some 2 s, and the tests.

The mutant is on the disk as well (`tools.mutants` writes it there), for processes that the tests start. Linux, macOS.
"""

import functools
import importlib
import inspect
import json
import os
import resource
import select
import signal
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any, Final, NoReturn

import pytest

from tests.mutation.reached import PLACE, Watch

_OWN: Final = ("canhaptic", "tests", "tools")
"""Packages of the repository, of which every process imports its own."""
_IMPORTED: Final = "ignore::pytest.PytestAssertRewriteWarning"  # of plugins, which a cold run finds imported
_PYTEST: Final = (
    *("-q", "-p", "no:cacheprovider", "-m", "not slow", "--no-header", "--tb=no", "-o", "timeout=0", "-W", _IMPORTED),
)
NOT_SWAPPED: Final = "not swapped"
"""What `TestServer.run` returns for a change that takes a cold run."""
_MOST_MEMORY: Final = 8 << 30  # B of addresses: a mutant may make a loop that fills the machine
_LONGEST_START: Final = 300.0  # s, until the tests are collected


def function_of(module: object, scope: str) -> FunctionType | None:
    """Returns the outermost function of a scope such as `Class.method.inner`; None where it names none or several."""
    found: Any = module
    for name in scope.split("."):
        try:
            found = inspect.getattr_static(found, name)
        except AttributeError:
            return None
        if isinstance(found, property):
            found = None if found.fset else found.fget
        elif isinstance(found, functools.cached_property):
            found = found.func
        elif isinstance(found, staticmethod | classmethod):
            found = found.__func__
        found = inspect.unwrap(found) if callable(found) and not isinstance(found, type) else found
        if isinstance(found, FunctionType):
            return found
    return None


def codes_of(code: CodeType, qualified: str) -> Iterator[CodeType]:
    """Yields the codes of a qualified name inside a code."""
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            if constant.co_qualname == qualified:
                yield constant
            yield from codes_of(constant, qualified)


def swap(path: str, scope: str, text: str) -> bool:
    """Gives a function that is imported the code that it has in another text of its module; returns whether it could.

    Args:
        path: Of the module, relative to the repository.
        scope: Of the change, as the mutator names it.
        text: Of the whole module.
    """
    module = sys.modules.get(path.removesuffix(".py").replace("/", "."))
    function = function_of(module, scope) if module else None
    if function is None:
        return False
    found = list(codes_of(compile(text, path, "exec"), function.__qualname__))
    if len(found) != 1 or found[0].co_freevars != function.__code__.co_freevars:
        return False
    function.__code__ = found[0]
    return True


def run_items(session: pytest.Session, items: Sequence[pytest.Item]) -> str:
    """Runs tests until one fails; returns its name, or ""."""
    for place, item in enumerate(items):
        following = items[place + 1] if place + 1 < len(items) else None
        item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
        if session.testsfailed:
            return item.nodeid
    return ""


class TestServer:
    """Processes with the tests of some folders.

    Args:
        copy: Of the repository.
        folders: Of tests, relative to it.

    Attributes:
        tests: Names of those collected.
        imported: `module:function` of all that imports and the collection called.
    """

    __test__ = False

    def __init__(self, copy: Path, folders: Sequence[str]) -> None:
        self._copy = copy
        self._words = [*_PYTEST, *folders]
        self._ask, self._answer = _Pipe(), _Pipe()
        self.process = _forked(lambda: self._serve(copy))
        hello = self._answer.read(_LONGEST_START)
        if hello is None:
            raise RuntimeError(
                f"the tests of {', '.join(folders)} were not collected: `pytest --collect-only` says why"
            )
        self.tests: list[str] = hello["tests"]
        self.imported = frozenset(hello["called"])
        for name in hello["modules"]:
            _import(name)

    def run(self, tests: Sequence[str], longest: float, changed: Mapping[str, str] | None = None) -> str:
        """Returns the first test that fails in a warm run, "" where all pass.

        Args:
            tests: Their names, in their order.
            longest: After which they count as endless [s].
            changed: Arguments of `swap`; None: nothing.
        """
        return str(self._asked({"tests": list(tests), "longest": longest, "swap": changed})["failed"])

    def watch(self, tests: Sequence[str], lines_of: Sequence[str], slowest: float) -> list[dict[str, Any]]:
        """Returns of each test its time, whether it passes, and what it reached: see `Watch`.

        Args:
            tests: Their names.
            lines_of: Modules of which lines are noted.
            slowest: Tests that take longer are left out [s].
        """
        question = {"tests": list(tests), "watch": list(lines_of), "slowest": slowest}
        found: list[dict[str, Any]] = self._asked(question)["reached"]
        return found

    def run_cold(self, tests: Sequence[str], longest: float) -> str:
        """As `run`, in a process that imports the package from the disk."""
        answer = _Pipe()

        def child() -> None:
            files = dict.fromkeys(test.partition("::")[0] for test in tests)
            plugin = _Cold(tests)
            _prepare(self._copy)
            status = pytest.main([*_PYTEST, *files], [plugin])
            answer.write({"failed": plugin.failed or ("" if plugin.ran else f"pytest ended with {status}")})

        return _outcome(child, answer, longest)

    def close(self) -> None:
        """Ends the server."""
        os.kill(self.process, signal.SIGKILL)
        os.waitpid(self.process, 0)

    def _asked(self, question: dict[str, Any]) -> dict[str, Any]:
        self._ask.write(question)
        found = self._answer.read(None)
        if found is None:
            raise RuntimeError("the process with the tests has ended")
        return found

    def _serve(self, copy: Path) -> None:
        _prepare(copy)
        watch = Watch(copy, ())
        sys.setprofile(watch.called)
        pytest.main(self._words, [_Warm(self._ask, self._answer, watch, frozenset(sys.modules))])


class _Warm:
    """A plugin that runs, in the place of all tests, those that are asked for, each time in a fork."""

    def __init__(self, ask: "_Pipe", answer: "_Pipe", watch: Watch, before: frozenset[str]) -> None:
        self._ask, self._answer, self._watch, self._before = ask, answer, watch, before

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        sys.setprofile(None)
        self._items = {item.nodeid: item for item in session.items}
        others = [name for name in sys.modules if name not in self._before and name.partition(".")[0] not in _OWN]
        hello = {"tests": list(self._items), "called": self._watch.functions(), "modules": others}
        self._answer.write(hello)
        while (question := self._ask.read(None)) is not None:
            if "watch" in question:
                self._answer.write(self._watched(session, question))
            else:
                self._answer.write(self._judged(session, question))
        return True

    def _judged(self, session: pytest.Session, question: dict[str, Any]) -> dict[str, Any]:
        answer, changed = _Pipe(), question["swap"]

        def child() -> None:
            if changed and not swap(**changed):
                answer.write({"failed": NOT_SWAPPED})
                return
            items = [self._items[test] for test in question["tests"] if test in self._items]
            answer.write({"failed": run_items(session, items)})

        return {"failed": _outcome(child, answer, question["longest"])}

    def _watched(self, session: pytest.Session, question: dict[str, Any]) -> dict[str, Any]:
        """Runs each test twice in a fork: as it is, for its time, and watched, for what it reaches."""
        answer = _Pipe()

        def child() -> None:
            copy = Path.cwd()
            watch, notes = Watch(copy, question["watch"]), copy / "reached_site" / "notes.jsonl"
            found = []
            for test in question["tests"]:
                begin = sum(os.times()[:4])  # of processor, those of the processes that it starts among them
                failed = run_items(session, [self._items[test]])
                seconds = sum(os.times()[:4]) - begin
                session.testsfailed = 0
                if seconds > question["slowest"]:
                    continue
                os.environ |= {PLACE: str(notes), "PYTHONPATH": f"{copy}{os.pathsep}{notes.parent}"}
                reached = watch.reached(partial(run_items, session, [self._items[test]]))
                os.environ.pop(PLACE)
                os.environ["PYTHONPATH"] = str(copy)
                reached["calls"] += _noted(notes)
                session.testsfailed = 0
                found.append({"test": test, "seconds": round(seconds, 4), "passes": not failed, **reached})
            answer.write({"reached": found})

        process = _forked(child)
        found = answer.read(None)
        os.waitpid(process, 0)
        return found or {"reached": []}


def _noted(notes: Path) -> list[str]:
    """Returns what processes that a test started noted of their calls, and forgets it."""
    if not notes.exists():
        return []
    lines = notes.read_text(encoding="utf-8").splitlines()
    notes.unlink()
    return sorted({name for line in lines for name in json.loads(line)["calls"]})


class _Cold:
    """A plugin that runs chosen tests until one fails."""

    def __init__(self, tests: Sequence[str]) -> None:
        self._tests, self.failed, self.ran = tests, "", False

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        items = {item.nodeid: item for item in session.items}
        self.ran = True
        self.failed = run_items(session, [items[test] for test in self._tests if test in items])
        return True


class _Pipe:
    """Messages of one process to another."""

    def __init__(self) -> None:
        self._reading, self._writing = os.pipe()
        self._rest = b""

    def write(self, message: object) -> None:
        """Writes one."""
        data = memoryview(json.dumps(message).encode() + b"\n")
        while data:
            data = data[os.write(self._writing, data) :]

    def read(self, longest: float | None) -> dict[str, Any] | None:
        """Returns one; None where none came in time [s], or none will."""
        self._close_writing()
        until = None if longest is None else time.monotonic() + longest
        while b"\n" not in self._rest:
            left = None if until is None else max(0.0, until - time.monotonic())
            if not select.select([self._reading], [], [], left)[0]:
                return None
            data = os.read(self._reading, 1 << 16)
            if not data:
                return None
            self._rest += data
        line, _, self._rest = self._rest.partition(b"\n")
        found: dict[str, Any] = json.loads(line)
        return found

    def _close_writing(self) -> None:
        """So that the end of the other process is an end of the messages."""
        if self._writing >= 0:
            os.close(self._writing)
            self._writing = -1

    def close(self) -> None:
        """Closes both ends of this process."""
        self._close_writing()
        os.close(self._reading)


def _outcome(child: Callable[[], None], answer: _Pipe, longest: float) -> str:
    """Returns what a child answers as `failed`, or how it ended without an answer."""
    process = _forked(child)
    begin = time.monotonic()
    found = answer.read(longest)
    _kill(process)
    answer.close()
    if found is not None:
        return str(found["failed"])
    return f"no end within {longest:.0f} s" if time.monotonic() - begin >= longest else "the process of the tests ended"


def _kill(process: int) -> None:
    """Ends a process and what it started, which is in its group."""
    try:
        os.killpg(process, signal.SIGKILL)
    except ProcessLookupError:
        os.kill(process, signal.SIGKILL)  # it has not made its group yet
    os.waitpid(process, 0)


def _forked(child: Callable[[], None]) -> int:
    process = os.fork()
    if process == 0:
        _become(child)
    return process


def _become(child: Callable[[], None]) -> NoReturn:
    try:
        os.setpgid(0, 0)
        resource.setrlimit(resource.RLIMIT_AS, (_MOST_MEMORY, resource.getrlimit(resource.RLIMIT_AS)[1]))
        child()
    finally:
        os._exit(0)


def _prepare(copy: Path) -> None:
    """Makes a process that imported none of the package one of the copy, without an output."""
    root = str(Path(__file__).resolve().parents[1])
    os.chdir(copy)
    sys.path[:] = [str(copy), *(place for place in sys.path if place not in ("", root, str(copy)))]
    os.environ["PYTHONPATH"] = str(copy)
    os.environ.pop(PLACE, None)
    for name in [name for name in sys.modules if name.partition(".")[0] in _OWN]:
        del sys.modules[name]
    silent = os.open(os.devnull, os.O_RDWR)
    for stream in (0, 1, 2):
        os.dup2(silent, stream)


def _import(name: str) -> None:
    """Imports what the tests import of others, so that a cold run finds it."""
    try:
        importlib.import_module(name)
    except Exception:  # then a cold run imports it
        return
