"""Which engine a batch is given."""

from importlib.machinery import ModuleSpec

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
