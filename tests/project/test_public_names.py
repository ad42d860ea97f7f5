import subprocess
import sys

import pytest

import canhaptic


def test_every_public_name_can_be_imported_and_there_are_few() -> None:
    assert len(canhaptic.__all__) <= 30
    for name in canhaptic.__all__:
        assert getattr(canhaptic, name).__name__ == name


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'rig'"):
        canhaptic.rig  # noqa: B018


def test_importing_the_package_imports_nothing_else() -> None:
    code = (
        "import sys, canhaptic; print([m for m in sys.modules if m.startswith('canhaptic.') or m in {'can', 'numpy'}])"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"
