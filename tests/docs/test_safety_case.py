"""Every control of the safety case is held by a test that exists."""

from typing import Any

import pytest

from canhaptic.drive.safety.link_policy import STOP_TABLE
from canhaptic.errors import InputError
from tools import make_safety_case
from tools.make_safety_case import hazards, page

ROWS = [row for hazard in hazards() for row in hazard["rows"]]


def test_the_page_is_current() -> None:
    """The tests it names are in the tree, and its figures are those of docs/results."""
    text = make_safety_case.PAGE.read_text(encoding="utf-8")
    assert text == page(), "run: python -m tools.make_safety_case"


def test_every_control_has_a_test_in_make_test() -> None:
    """A slow one alone would let a change land that takes the control away."""
    for row in ROWS:
        assert any("slow" not in make_safety_case.marks_of(name) for name in row["tests"]), row["cause"]


@pytest.mark.parametrize(
    "tests",
    [
        [],
        ["drive/test_stop.py::test_that_nobody_wrote"],
        ["drive/test_nothing.py::test_it"],
        ["audit/test_damaged_logs.py::test_a_text_that_claims_gigabytes_is_refused_at_once"],
    ],
    ids=str,
)
def test_a_control_without_a_test_is_an_error(monkeypatch: pytest.MonkeyPatch, tests: list[str]) -> None:
    """The build fails, and says which row."""
    row: dict[str, Any] = {**ROWS[0], "tests": tests}
    monkeypatch.setattr(make_safety_case, "hazards", lambda: [{"hazard": "one", "rows": [row]}])
    with pytest.raises(
        InputError, match=r"safety_case\.yaml: (.* names no test|no test '|there is no tests/|.* is marked skipif)"
    ):
        page()


def test_every_reason_to_stop_is_that_of_some_hazard() -> None:
    """A new stop brings its hazard along."""
    named = {reason for row in ROWS for reason in row.get("stops", [])}
    assert named == {reason.name for reason in STOP_TABLE}
