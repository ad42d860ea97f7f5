"""The product loads nothing of the laboratory but what a user names; the import contracts hold what is written."""

from pathlib import Path
from typing import Final

import pytest

from canhaptic.control.admittance import DISPLAY_ALGORITHMS
from canhaptic.control.multi_axis import GROUP_ALGORITHMS
from canhaptic.control.passivity import ALGORITHMS
from tools.count_structure import loaded_modules

ROOT: Final = Path(__file__).resolve().parents[2]
LAB: Final = "canhaptic.lab"


def of_the_lab(*options: str) -> set[str]:
    loaded = loaded_modules(ROOT, *options)
    assert {"canhaptic.cycle", "canhaptic.scene.build", "canhaptic.view.run_lines"} <= set(loaded)
    return {name for name in loaded if name.startswith(LAB)}


@pytest.mark.slow
def test_a_run_loads_nothing_of_the_laboratory() -> None:
    assert of_the_lab() == set()


@pytest.mark.slow
def test_a_run_with_a_rival_loads_that_rival_alone() -> None:
    found = of_the_lab("--set", "passivity={algorithm: a_priori_dissipation}")
    assert found == {LAB, f"{LAB}.rivals", f"{LAB}.rivals.a_priori_dissipation"}


@pytest.mark.parametrize("table", [ALGORITHMS, GROUP_ALGORITHMS, DISPLAY_ALGORITHMS])
def test_the_product_keeps_four_algorithms_and_names_the_rivals(table: dict[str, str]) -> None:
    kept = {name for name, place in table.items() if not place.startswith(f"{LAB}.rivals.")}
    assert "guarded" in kept
    assert kept <= {"guarded", "internal_dissipation", "unprotected", "passivity_observer"}
