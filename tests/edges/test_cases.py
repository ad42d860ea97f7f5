"""Each case of `cases` ends for its reason, as soon as it should: zero first, the drive disabled, the account kept."""

from pathlib import Path
from typing import Any

import pytest

from canhaptic.drive.safety.link_policy import StopReason
from tests.edges.cases import CASES, DISPLAY, Case
from tests.edges.short_run import Outcome, pressed


def _cells() -> list[Any]:
    """All cases, of which the first of each kind is in `make test`."""
    first = {case.kind: name for name, case in reversed(CASES.items())}
    slow = {name for name, case in CASES.items() if first[case.kind] != name or case.own}
    return [pytest.param(name, marks=pytest.mark.slow if name in slow else ()) for name in CASES]


def outcome_of(case: Case, folder: Path) -> Outcome:
    return pressed(
        case.deed, *case.changes, each=case.each, cycles=case.cycles, name=case.name, own=folder if case.own else None
    )


@pytest.mark.parametrize("name", _cells())
def test_a_case_ends_for_its_reason_with_zero_torque_first_or_goes_on(name: str, tmp_path: Path) -> None:
    case = CASES[name]
    seen = outcome_of(case, tmp_path)
    assert seen.reason is (case.reason or StopReason.OPERATOR), seen.error
    assert seen.result["ports"]
    assert seen.is_disabled_or_said, seen.error
    assert seen.is_zero_first
    if case.reason is None:
        assert seen.error is None
        assert seen.result["cycles"] >= case.cycles
        words = [(port["passive"], port["plant_passive"]) for port in seen.result["ports"].values()]
        assert ("yes", "no") not in words
    else:
        under_way = {2} if case.own else set()  # an answer that own code gave before it ended
        assert seen.syncs_to_zero in {case.syncs, *under_way}


def test_every_way_out_has_a_case() -> None:
    """A new `StopReason` joins the cases in the same commit."""
    on_a_line = {StopReason.HOLDS_CONTRADICTED}  # in tests/drive/ethercat: no drive on CAN counts its holds
    assert set(StopReason) - {case.reason for case in CASES.values()} == {StopReason.NONE} | on_a_line


def test_a_drive_that_brakes_is_left_to_brake_for_its_time_before_anything_else_disables_it() -> None:
    """A display that loses its sensor while it moves: a disable by SDO would let it coast."""
    seen = pressed(
        CASES["force beyond the range"].deed, "axes.0.admittance.stop_time=0.2", name=DISPLAY, at=300, cycles=400
    )
    disabled_by_sdo = [frame for frame in seen.frames if frame.can_id > 0x600 and frame.data[:3] == b"\x2b\x40\x60"]
    assert seen.edge.syncs > 8  # it took longer than two rounds of SDO would wait
    assert not disabled_by_sdo
    assert seen.is_disabled_or_said
