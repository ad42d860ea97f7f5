"""EMCY, error register, history, and the watchdogs on RPDO and SYNC."""

import pytest

from canhaptic.sim.drive.profile.state_machine import DriveState
from tests.sim_drive.drive_on_bus import NODE, PERIOD, TRAITS, Rig

MS = 1_000_000


@pytest.mark.parametrize(
    ("code", "frame"),
    [
        (0x2310, "10 23 03 00 00 00 00 00"),  # current
        (0x3210, "10 32 05 00 00 00 00 00"),  # voltage
        (0x4310, "10 43 09 00 00 00 00 00"),  # temperature
        (0x7300, "00 73 01 00 00 00 00 00"),  # sensor
        (0x8611, "11 86 11 00 00 00 00 00"),  # following error
        (0xFF01, "01 ff 81 00 00 00 00 00"),  # manufacturer
    ],
)
def test_fault_sends_code_and_error_register(rig: Rig, code: int, frame: str) -> None:
    rig.drive.inject_fault(code)
    assert rig.run() == [(0x085, frame)]
    assert rig.read(0x603F)[:5] == frame[:5]
    assert rig.read(0x1001)[:2] == frame[6:8]
    assert rig.read(0x1003, 1) == frame[:5] + " 00 00"


def test_fault_takes_the_torque_away_at_once_and_reset_announces_no_error(rig: Rig) -> None:
    rig.enable()
    rig.send(0x205, "0f 00 64 00")
    rig.drive.inject_fault(0x2310)
    assert rig.drive.torque == 0.0
    assert rig.run(rig.now + 2 * PERIOD) == [(0x085, "10 23 03 00 00 00 00 00")]
    assert rig.send(0x205, "80 00 64 00") == [(0x085, "00 00 00 00 00 00 00 00")]
    assert rig.drive.state is DriveState.SWITCH_ON_DISABLED
    assert rig.read(0x603F)[:5] == "00 00"
    assert rig.read(0x1001)[:2] == "00"


def test_history_keeps_the_newest_first_and_can_be_cleared(rig: Rig) -> None:
    for code in (0x2310, 0x3210, 0x4310):
        rig.drive.inject_fault(code)
    assert rig.read(0x1003, 0)[:2] == "03"
    assert [rig.read(0x1003, i) for i in (1, 2, 3)] == ["10 43 00 00", "10 32 00 00", "10 23 00 00"]
    assert rig.write(0x1003, 0, 0, 1) == "ok"
    assert rig.read(0x1003, 0)[:2] == "00"
    assert rig.read(0x1003, 1) == "08000024"


def test_history_overflows_at_its_end(rig: Rig) -> None:
    for i in range(12):
        rig.drive.inject_fault(0xFF00 + i)
    assert rig.read(0x1003, 0)[:2] == "08"
    assert rig.read(0x1003, 8) == "04 ff 00 00"


def test_emcy_is_silent_when_its_cob_id_is_invalid_and_moves_with_it(rig: Rig) -> None:
    rig.write(0x1014, 0, 0x8000_0085, 4)
    rig.drive.inject_fault(0x2310)
    assert rig.run() == []
    rig.write(0x1014, 0, 0x0A5, 4)
    rig.drive.inject_fault(0x3210)
    assert rig.run() == [(0x0A5, "10 32 07 00 00 00 00 00")]


def test_short_rpdo_is_refused_and_announced_once(rig: Rig) -> None:
    rig.start()
    assert rig.send(0x205, "06 00 00") == [(0x085, "10 82 11 00 00 00 00 00")]
    assert rig.send(0x205, "06") == []
    assert rig.drive.state is DriveState.SWITCH_ON_DISABLED
    assert rig.send(0x205, "06 00 00 00") == [(0x085, "00 00 00 00 00 00 00 00")]
    assert rig.drive.state is DriveState.READY_TO_SWITCH_ON


def test_longer_rpdo_is_read_as_far_as_mapped(rig: Rig) -> None:
    rig.start()
    rig.send(0x205, "06 00 00 00 ff ff ff ff")
    assert rig.drive.state is DriveState.READY_TO_SWITCH_ON


def test_sync_with_more_than_a_counter_is_refused(rig: Rig) -> None:
    rig.start()
    assert rig.send(0x080, "01 02") == [(0x085, "40 82 11 00 00 00 00 00")]
    assert rig.send(0x080, "01") == [(0x185, "50 02 00 00 00 00 00 00")]


def test_rpdo_that_stays_away_longer_than_its_event_timer_faults(rig: Rig) -> None:
    rig.write(0x1400, 5, 5, 2)  # 5 ms
    rig.enable()
    rig.send(0x205, "0f 00 64 00")
    start = rig.now
    rig.run(start + 5 * MS - 1)
    assert rig.drive.torque == 0.1
    assert rig.run(start + 5 * MS) == [(0x085, "50 82 11 00 00 00 00 00")]
    assert rig.drive.torque == 0.0
    rig.run(start + 8 * MS)
    assert rig.drive.state is DriveState.FAULT


def test_rpdo_timeout_obeys_the_abort_connection_option(rig: Rig) -> None:
    rig.write(0x1400, 5, 5, 2)
    rig.write(0x6007, 0, 2, 2)
    rig.enable()
    rig.run(rig.now + 6 * MS)
    assert rig.drive.state is DriveState.SWITCH_ON_DISABLED


def test_a_drive_without_that_option_takes_a_lost_connection_for_a_fault() -> None:
    with Rig(TRAITS / "array_maps.eds") as rig:
        rig.enable()
        rig.send(0x000, f"02 {NODE:02x}")
        assert rig.drive.state is DriveState.FAULT_REACTION_ACTIVE


def test_missing_syncs_fault_when_the_cycle_period_is_known(rig: Rig) -> None:
    rig.write(0x1006, 0, 1000, 4)  # 1000 us
    rig.enable()
    rig.send(0x205, "0f 00 64 00")
    start = rig.now
    rig.run(start + 3 * MS - 1)
    assert rig.drive.torque == 0.1
    assert rig.run(start + 3 * MS) == [(0x085, "00 87 11 00 00 00 00 00")]
    assert rig.drive.torque == 0.0


def test_missing_syncs_go_unnoticed_when_the_cycle_period_is_not_known(rig: Rig) -> None:
    rig.enable()
    assert rig.run(rig.now + 100 * MS) == []
    assert rig.drive.state is DriveState.OPERATION_ENABLED


def test_diverged_motor_faults_instead_of_raising(rig: Rig) -> None:
    rig.enable()
    rig.motor.position = float("inf")
    rig.motor.velocity = float("nan")
    frames = rig.sync()
    assert (0x085, "00 73 01 00 00 00 00 00") in frames
    assert rig.drive.torque == 0.0
