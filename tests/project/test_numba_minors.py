"""Which versions of numba `make test-campaigns` runs."""

import pytest

from tests.conftest import REPOSITORY
from tools import numba_minors


def test_every_minor_version_that_the_package_declares_is_run_and_no_other() -> None:
    assert numba_minors.minors((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))[-1] == "0.63"
    assert numba_minors.minors('fast = ["numba>=0.63,<0.66"]') == ["0.65", "0.64", "0.63"]


def test_no_version_is_no_empty_list() -> None:
    with pytest.raises(ValueError, match="got 0 requirements of numba"):
        numba_minors.minors("dependencies = []")
