"""Every example runs as a reader would run it, and says what it is there to say."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from canhaptic.control.verdict import PASSIVE_TOLERANCE
from tests.docs.documents import ROOT

EXAMPLES = ROOT / "examples"
SAYS = {
    "touch_a_wall.py": "passive: yes",
    "vary_stiffness.py": r"10000 N/m\": \d",
    "compare_algorithms.py": r"unprotected .* um +[1-9]",
    "own_wall.py": "handle: yes",
    "own_hand.py": r"startled .* passive yes",
    "lossy_bus.py": r"drop.* link +9\d",
    "own_loop.py": r"least_interaction=0\.0",
    "own_program.py": r"passive: yes; in [\d.]+ mJ",
    "code_in_a_process.py": r"\d+ cycles, .* [1-9]\d* holds without an answer",
    "stop_when_deep.py": r"stopped after \d+ cycles at -8",
    "read_a_log.py": "in the wall for",
    "replay_a_recording.py": "identical",
    "room_in_a_plane.py": "stage: in .* passive yes",
    "slow_world.py": "mm deep yes",
}
"""Script -> what it prints."""


def test_the_list_names_every_example() -> None:
    listed = re.findall(r"^\| `([\w.]+)`", (EXAMPLES / "README.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert sorted(listed) == sorted(path.name for path in EXAMPLES.iterdir() if path.suffix in (".py", ".ipynb"))
    assert set(SAYS) | {"notebook.ipynb"} == set(listed)


@pytest.mark.slow
@pytest.mark.parametrize("name", SAYS)
def test_a_script_runs(name: str, tmp_path: Path) -> None:
    environment = {**os.environ, "MPLBACKEND": "Agg", "PYTHONPATH": str(ROOT)}
    words = [sys.executable, "-W", "error", str(EXAMPLES / name)]
    done = subprocess.run(
        words, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=110, check=False
    )
    assert done.returncode == 0, done.stderr
    assert re.search(SAYS[name], done.stdout), done.stdout


@pytest.mark.slow
def test_the_cells_of_the_notebook_run_in_order_where_it_lies(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(EXAMPLES)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    notebook = json.loads((EXAMPLES / "notebook.ipynb").read_text(encoding="utf-8"))
    assert all(not cell["outputs"] for cell in notebook["cells"] if cell["cell_type"] == "code")
    names: dict[str, Any] = {}
    shown = [_shown("".join(c["source"]), names) for c in notebook["cells"] if c["cell_type"] == "code"]
    first, figure, account, text, least = shown
    assert ">yes</td>" in first._repr_html_()
    assert len(figure.axes[0].lines) > 2
    assert account["handle"][3] == "yes"
    assert "mm deep" in text
    assert least["unprotected"] < -1e-3 < -PASSIVE_TOLERANCE <= least["guarded"]


def _shown(code: str, names: dict[str, Any]) -> Any:
    """Runs a cell and returns the value of its last line, which a notebook shows."""
    *lines, last = code.splitlines()
    exec("\n".join(lines), names)
    return eval(last, names)
