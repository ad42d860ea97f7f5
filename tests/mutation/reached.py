"""Notes which functions and lines of the package each test reaches, for `tools.mutants`.

Processes that a test starts note their functions as well, where `watch_process` is called in them (by the tool's
`sitecustomize.py`).
"""

import json
import os
import sys
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from types import CodeType, FrameType
from typing import Any, Final

PLACE: Final = "CANHAPTIC_REACHED"
"""Name of the environment variable with the file in which a process notes what it calls."""
_PACKAGE: Final = "canhaptic"
_PATIENCE: Final = 200  # calls without a new line, after which not every call is watched
_SELDOM: Final = 50  # of which one call is watched then


class Watch:
    """What tests reach.

    Args:
        root: Of the repository whose package runs.
        lines_of: Modules, relative to it, of which lines are noted; of all others functions alone.
    """

    def __init__(self, root: Path, lines_of: Sequence[str]) -> None:
        self._root = f"{root.resolve()}{os.sep}"
        self._lines_of = frozenset(lines_of)
        self._codes: dict[CodeType, Callable[..., Any] | None] = {}
        self._lines: dict[str, set[int]] = {}
        self._called: set[CodeType] = set()

    def called(self, frame: FrameType, event: str, _argument: object) -> None:
        """Notes a call: a function for `sys.setprofile`."""
        if event == "call":
            self._called.add(frame.f_code)

    def functions(self) -> list[str]:
        """Returns `module:function` of each that was called, without its closures."""
        start = self._root + _PACKAGE + os.sep
        found = {_named(code, self._root) for code in self._called if code.co_filename.startswith(start)}
        return sorted(found)

    def reached(self, run: Callable[[], object]) -> dict[str, Any]:
        """Returns `calls` as `functions`, and `lines` of each module, of what is run."""
        self._codes, self._lines, self._called = {}, {}, set()
        threading.settrace(self._enter)
        sys.settrace(self._enter)
        try:
            run()
        finally:
            sys.settrace(None)
            threading.settrace(None)
        return {"calls": self.functions(), "lines": {path: sorted(lines) for path, lines in self._lines.items()}}

    def _enter(self, frame: FrameType, _event: str, _argument: object) -> Callable[..., Any] | None:
        code = frame.f_code
        try:
            watch = self._codes[code]
        except KeyError:
            self._called.add(code)
            watch = self._codes[code] = self._watch_of(code)
        return watch(frame, "call", None) if watch else None

    def _watch_of(self, code: CodeType) -> Callable[..., Any] | None:
        path = code.co_filename.removeprefix(self._root)
        if path not in self._lines_of:
            return None
        seen = self._lines.setdefault(path, set())
        left = {line for _, _, line in code.co_lines() if line} - {code.co_firstlineno}
        idle = 0

        def note(frame: FrameType, event: str, _argument: object) -> Callable[..., Any] | None:
            nonlocal idle
            if event == "line":
                if frame.f_lineno in left:
                    left.discard(frame.f_lineno)
                    seen.add(frame.f_lineno)
                    idle = 0
                return note
            idle += event == "call"
            return note if left and (idle < _PATIENCE or idle % _SELDOM == 0) else None

        return note


def _named(code: CodeType, root: str) -> str:
    return f"{code.co_filename.removeprefix(root)}:{code.co_qualname.split('.<locals>')[0]}"


def watch_process() -> None:
    """Notes at once each function that this process calls for the first time; it may be killed at any time."""
    test = os.environ.get("PYTEST_CURRENT_TEST", "").rsplit(" ", 1)[0]
    root = f"{Path(__file__).resolve().parents[2]}{os.sep}"
    called: set[CodeType] = set()

    def note(frame: FrameType, _event: str, _argument: object) -> None:
        code = frame.f_code
        if code not in called and code.co_filename.startswith(root + _PACKAGE + os.sep):
            called.add(code)
            with Path(os.environ[PLACE]).open("a", encoding="utf-8") as file:
                file.write(json.dumps({"test": test, "calls": [_named(code, root)]}) + "\n")

    if test:
        threading.settrace(note)
        sys.settrace(note)
