"""Which engine a batch is given."""

from importlib.machinery import ModuleSpec
from pathlib import Path

import pytest

from canhaptic.errors import ParameterError
from canhaptic.lab.batch import Engine, chosen_engine

INSTALLED = ModuleSpec("numba", None)


@pytest.mark.parametrize(
    ("installed", "asked", "pays", "chosen"),
    [
        (True, "auto", True, "numba"),
        (True, "auto", False, "python"),
        (True, "numba", False, "numba"),
        (True, "python", True, "python"),
        (False, "auto", True, "python"),
    ],
)
def test_auto_compiles_where_numba_is_there_and_pays(
    monkeypatch: pytest.MonkeyPatch, installed: bool, asked: Engine, pays: bool, chosen: str
) -> None:
    monkeypatch.setattr("canhaptic.lab.batch.find_spec", lambda _: INSTALLED if installed else None)
    assert chosen_engine(asked, pays) == chosen


def test_numba_that_is_not_installed_is_refused_with_the_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("canhaptic.lab.batch.find_spec", lambda _: None)
    with pytest.raises(ParameterError, match=r"engine: got numba, which is not installed; pip install"):
        chosen_engine("numba", True)


@pytest.mark.parametrize(
    ("found", "is_used"), [("0.62.1", False), ("0.63.0", True), ("0.68.9", True), ("0.69.0rc1", False), ("1.63", False)]
)
def test_only_the_declared_versions_of_numba_compile(
    monkeypatch: pytest.MonkeyPatch, found: str, is_used: bool
) -> None:
    monkeypatch.setattr("canhaptic.lab.batch.version", lambda _: found)
    monkeypatch.setattr("canhaptic.lab.batch.find_spec", lambda _: INSTALLED)
    assert chosen_engine("auto", True) == ("numba" if is_used else "python")
    if is_used:
        assert chosen_engine("numba", True) == "numba"
    else:
        with pytest.raises(ParameterError, match=rf"whose version {found} is not one of 0.63 to 0.68; pip install"):
            chosen_engine("numba", True)
    assert "numba>=0.63,<0.69" in (Path(__file__).parents[3] / "pyproject.toml").read_text()
