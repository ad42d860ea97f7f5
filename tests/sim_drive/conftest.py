"""Dictionaries for the tests: our own, which always run, and the vendors', which are skipped visibly when absent."""

import os
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SERVO_EDS = ROOT / "eds" / "cia402_servo.eds"
TRAITS = Path(__file__).parent / "eds"


@pytest.fixture(scope="session")
def vendor_eds() -> Path:
    folder = Path(os.environ.get("CANHAPTIC_VENDOR_EDS", ROOT.parent / "shared" / "eds"))
    if not folder.is_dir():
        pytest.skip(f"no vendor dictionaries in {folder} (set CANHAPTIC_VENDOR_EDS)")
    return folder
