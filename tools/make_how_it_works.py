"""Writes the traced cycle into docs/how_it_works.md: `python -m tools.make_how_it_works`.

One cycle of the demo, in contact, with a log, is run under `sys.setprofile`; every call of the package is written down.
"""

import sys
import tempfile
from pathlib import Path
from types import FrameType
from typing import Any, Final

from canhaptic import build, load_scene
from canhaptic.cycle import Cycle
from tools.page_part import with_part, write_page

ROOT: Final = Path(__file__).resolve().parent.parent
PAGE: Final = ROOT / "docs" / "how_it_works.md"
_IN_CONTACT: Final = 1500  # cycles into the demo: the hand is in the wall
_PACKAGE: Final = str(ROOT / "canhaptic")
_DEEPEST: Final = 6
_FAR_SIDE: Final = "canhaptic/sim/"


class _Trace:
    """Lines of one cycle; what the simulated drive does is named once and not opened."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self._depth = 0
        self._hidden = 0

    def __call__(self, frame: FrameType, event: str, _argument: Any) -> None:
        file = frame.f_code.co_filename
        if event not in ("call", "return") or not file.startswith(_PACKAGE) or frame.f_code.co_name.startswith("<"):
            return  # comprehensions are frames of their own in some versions of Python and not in others
        if event == "return":
            self._depth -= 1
            self._hidden -= self._hidden > 0
            return
        self._depth += 1
        name = Path(file).relative_to(ROOT).as_posix()
        is_far = name.startswith(_FAR_SIDE)
        if self._hidden or (self._depth > _DEEPEST and not is_far):
            self._hidden += bool(self._hidden)
            return
        self._hidden = int(is_far)
        self._write(f"{'    ' * min(self._depth - 1, _DEEPEST)}{frame.f_code.co_qualname}", name)

    def _write(self, call: str, file: str) -> None:
        line = f"{call:<56} {file.removeprefix('canhaptic/')}"
        if not self.lines or self.lines[-1] != line:  # the same again: a frame handled like the one before
            self.lines.append(line)


def trace() -> list[str]:
    """Returns the calls of one cycle, indented by depth, each with its file."""
    scene = load_scene(ROOT / "configs" / "demo.yaml")
    with tempfile.TemporaryDirectory() as folder:
        paths = Path(folder) / "run.h5", Path(folder) / "run.log"
        with build(scene, energy_log=paths[0], bus_log=paths[1]) as experiment:
            return _of_one_cycle(experiment.cycle)


def _of_one_cycle(cycle: Cycle) -> list[str]:
    found = _Trace()
    cycle.rig.start()
    try:
        for _ in range(_IN_CONTACT):
            cycle.step()
        while cycle.rig.bus.heartbeat_cycles - 1 != cycle.cycles % cycle.rig.bus.heartbeat_cycles:
            cycle.step()
        sys.setprofile(found)
        try:
            cycle.step()
        finally:
            sys.setprofile(None)
    finally:
        cycle.rig.stop()
    return found.lines


def page() -> str:
    """Returns the text of the page with a fresh trace in it."""
    return with_part(PAGE, "trace", "".join(["```text\n", *(f"{line}\n" for line in trace()), "```\n"]))


if __name__ == "__main__":
    write_page(PAGE, page)
