"""Every branch of the safety room, and of the holds of a stop, is run by the fast tests nearest to it."""

import importlib.util
import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
TESTS = (
    "tests/drive/test_brake.py", "tests/drive/test_stop.py", "tests/drive/test_trust.py", "tests/drive/test_cycle.py",
    "tests/drive/test_limiter_and_policy.py", "tests/drive/test_refusals.py", "tests/drive/test_no_torque.py",
    "tests/acceptance/test_booked_stops.py",
    "tests/edges/test_cases.py", "tests/edges/test_signals_anywhere.py",
)  # fmt: skip
_SETTINGS = """[run]
branch = true
include = {root}/canhaptic/drive/safety/*
    {root}/canhaptic/control/booked_stop.py
data_file = {folder}/data
[report]
exclude_also =
    if TYPE_CHECKING:
    class .*\\(Protocol\\):
"""


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_every_branch_of_the_safety_room_is_run(tmp_path: Path) -> None:
    if importlib.util.find_spec("coverage") is None:
        pytest.skip("coverage is not installed (pip install 'canhaptic[release]')")
    settings, out = tmp_path / "coverage.ini", tmp_path / "coverage.json"
    settings.write_text(_SETTINGS.format(root=ROOT, folder=tmp_path), encoding="utf-8")
    coverage, given = [sys.executable, "-m", "coverage"], f"--rcfile={settings}"
    words = ["-q", "-n", "0", "-p", "no:cacheprovider", "-m", "not slow", *TESTS]
    ran = subprocess.run(
        [*coverage, "run", given, "-m", "pytest", *words], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert ran.returncode == 0, ran.stdout[-3000:]
    subprocess.run([*coverage, "json", given, "--quiet", "-o", str(out)], cwd=ROOT, check=True)
    files = json.loads(out.read_text(encoding="utf-8"))["files"]
    missed = {name: (of["missing_lines"], of["missing_branches"]) for name, of in files.items()}
    assert len(missed) == 7
    assert {name: what for name, what in missed.items() if any(what)} == {}
