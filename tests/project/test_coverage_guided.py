"""Coverage-guided fuzzing of the readers, where atheris is installed."""

import subprocess
import sys
from pathlib import Path

import pytest

from tools.fuzz import TARGETS

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.slow
@pytest.mark.parametrize("target", TARGETS)
def test_no_bytes_end_in_an_error_that_is_not_ours(target: str, tmp_path: Path) -> None:
    pytest.importorskip("atheris", reason="atheris is not installed; hypothesis alone fuzzes the readers")
    command = [sys.executable, "-m", "tools.fuzz", target, "-runs=20000", f"-artifact_prefix={tmp_path}/"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-3000:]


def test_an_unknown_target_is_refused() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "tools.fuzz", "x"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert "expected one of: dictionary, scene" in done.stderr
