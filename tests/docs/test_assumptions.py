"""The table of premises: every key that a proof rests on, and where its value comes from."""

import re
from pathlib import Path

import pytest

from canhaptic.control.admittance.velocity_loop import GuardedAdmittanceParameters
from canhaptic.control.passivity import LoopProperties
from canhaptic.control.passivity.guarded import GuardedParameters

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "account_and_truth.md").read_text(encoding="utf-8")
COMMISSION = "\n".join(path.read_text(encoding="utf-8") for path in (ROOT / "canhaptic" / "commission").glob("*.py"))
NO_PREMISES = {
    *("sample_time", "encoder_count", "torque_quantum", "torque_limit", "torque_rate_limit", "power_limit"),
    *("earned_energy", "drag", "alpha"),
}
"""What the bus, the drive and its limits are set to, and what changes nothing in a promise."""


def rows_below(heading: str) -> list[list[str]]:
    table = PAGE.partition(f"## {heading}\n")[2].partition("\n## ")[0]
    lines = [line for line in table.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]


KEYED = {row[1].strip("`"): row for row in rows_below("Premises with a key")}


def test_every_key_on_which_a_proof_rests_is_in_the_table_of_premises() -> None:
    models = (LoopProperties, GuardedParameters, GuardedAdmittanceParameters)
    assert set(KEYED) == {key.removesuffix("_least") for model in models for key in model.model_fields} - NO_PREMISES
    for key, row in KEYED.items():
        assert len(row) == 5, key


@pytest.mark.parametrize("key", KEYED)
def test_what_the_table_calls_measured_is_proposed_by_commission(key: str) -> None:
    is_proposed = re.search(rf'"passivity\.{key}"|"{key}": f"|\("[^"]*", fit\.\w+, "{key}"', COMMISSION) is not None
    assert KEYED[key][3] == ("yes" if is_proposed else "no")


def test_every_premise_without_a_key_states_its_bound() -> None:
    rows = rows_below("Premises without a key")
    assert len(rows) >= 8
    assert all(len(row) == 4 and all(row) for row in rows)
    named = " ".join(" ".join(row) for row in rows)
    for premise in ("presliding", "overshoot", "integral", "sampled", "stiffen", "late torque"):
        assert premise in named
