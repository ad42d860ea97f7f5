"""Shared test settings: hypothesis deterministic, vendor dictionaries found or visibly absent."""

import os
from pathlib import Path

import pytest
from hypothesis import settings

settings.register_profile("canhaptic", derandomize=True, deadline=None, print_blob=False)
settings.load_profile("canhaptic")

os.environ.pop("COLUMNS", None)  # that of the terminal in which the tests run says nothing about tables in pipes

REPOSITORY = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session")
def vendor_eds() -> Path:
    """The folder of real vendor dictionaries; skips, visibly, where it is absent."""
    folder = Path(os.environ.get("CANHAPTIC_VENDOR_EDS", REPOSITORY.parent / "shared" / "eds"))
    if not folder.is_dir():
        pytest.skip(f"vendor dictionaries not found at {folder}; set CANHAPTIC_VENDOR_EDS")
    return folder
