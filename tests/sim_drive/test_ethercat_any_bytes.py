"""For all frames that arrive, neither drives nor master raise or hang, and no drive that is not enabled has torque."""

import pytest

from tests.sim_drive.ethercat_fuzz import attack_drives, attack_master


def test_mutated_frames_make_no_drive_raise_hang_or_push() -> None:
    assert attack_drives(400, seed=1) == 0


def test_mutated_answers_make_the_master_raise_nothing_but_errors_of_a_rig() -> None:
    assert attack_master(2, seed=1) > 50


@pytest.mark.slow
def test_ten_thousand_mutated_frames_each_way() -> None:
    assert attack_drives(10_000, seed=2) == 0
    assert attack_master(60, seed=2) > 5_000
