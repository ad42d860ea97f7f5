"""For all frames that arrive, neither drives nor master raise or hang, and no drive that is not enabled has torque."""

import pytest

from tests.sim_drive.ethercat_fuzz import attack_drives, attack_master


def test_mutated_frames_make_no_drive_raise_hang_or_push() -> None:
    assert attack_drives(400, seed=1) == 0


def test_mutated_answers_make_the_master_raise_nothing_but_errors_of_a_rig() -> None:
    assert attack_master(2, seed=1) > 50


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("frames", [10_000, pytest.param(1_000_000, marks=pytest.mark.campaign)])
def test_many_mutated_frames_each_way(frames: int) -> None:
    assert attack_drives(frames, seed=2) == 0
    assert attack_master(frames // 160, seed=2) > frames // 2
