"""The vendors' dictionaries, skipped visibly when absent; our own, under eds/, always run."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from drive_on_bus import ROOT, Rig


@pytest.fixture(scope="session")
def vendor_eds() -> Path:
    folder = Path(os.environ.get("CANHAPTIC_VENDOR_EDS", ROOT.parent / "shared" / "eds"))
    if not folder.is_dir():
        pytest.skip(f"no vendor dictionaries in {folder} (set CANHAPTIC_VENDOR_EDS)")
    return folder


@pytest.fixture
def rig() -> Iterator[Rig]:
    with Rig() as rig:
        yield rig
