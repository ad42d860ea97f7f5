"""NMT, boot-up and heartbeat of the drive against literal frames; virtual time."""

from canhaptic.canopen.objects import NmtState
from canhaptic.sim.drive.profile.state_machine import DriveState
from tests.sim_drive.drive_on_bus import PERIOD, Rig

MS = 1_000_000


def test_boot_up_comes_first_and_only_once() -> None:
    rig = Rig()
    try:
        assert rig.send(0x605, "40 00 10 00 00 00 00 00") == [
            (0x705, "00"),
            (0x585, "43 00 10 00 92 01 02 00"),
        ]
        assert rig.run(10 * PERIOD) == []
    finally:
        rig.close()


def test_nmt_commands_lead_to_their_states_by_node_and_by_broadcast(rig: Rig) -> None:
    for content, state in [
        ("01 05", NmtState.OPERATIONAL),
        ("80 05", NmtState.PRE_OPERATIONAL),
        ("01 00", NmtState.OPERATIONAL),
        ("02 00", NmtState.STOPPED),
        ("80 00", NmtState.PRE_OPERATIONAL),
    ]:
        rig.send(0x000, content)
        assert rig.drive.nmt_state is state


def test_nmt_commands_to_others_and_malformed_ones_are_ignored(rig: Rig) -> None:
    for content in ("01 06", "01", "", "01 05 00", "03 05", "ff 00"):
        assert rig.send(0x000, content) == []
        assert rig.drive.nmt_state is NmtState.PRE_OPERATIONAL


def test_stopped_drive_answers_no_sdo_and_no_sync_but_beats(rig: Rig) -> None:
    rig.write(0x1017, 0, 10, 2)
    rig.send(0x000, "02 05")
    assert rig.send(0x605, "40 00 10 00 00 00 00 00") == []
    assert rig.sync() == []
    assert rig.run(10 * MS) == [(0x705, "04")]


def test_pdos_pass_only_in_operational(rig: Rig) -> None:
    assert rig.sync() == []
    assert rig.send(0x205, "06 00 00 00") == []
    assert rig.drive.state is DriveState.SWITCH_ON_DISABLED
    rig.start()
    assert rig.sync() == [(0x185, "50 02 00 00 00 00 00 00")]


def test_heartbeats_keep_their_period_and_tell_the_state(rig: Rig) -> None:
    assert rig.write(0x1017, 0, 100, 2) == "ok"
    assert rig.run(99 * MS) == []
    assert rig.run(100 * MS) == [(0x705, "7f")]
    rig.send(0x000, "01 05")
    assert rig.run(300 * MS) == [(0x705, "05")] * 2
    rig.write(0x1017, 0, 0, 2)
    assert rig.run(600 * MS) == []


def test_heartbeats_missed_during_a_stall_are_skipped(rig: Rig) -> None:
    rig.write(0x1017, 0, 10, 2)
    rig.now = 95 * MS
    assert rig.run() == [(0x705, "7f")]
    assert rig.run(100 * MS) == [(0x705, "7f")]


def test_reset_node_restores_objects_and_boots_again(rig: Rig) -> None:
    rig.enable()
    rig.write(0x6072, 0, 500, 2)
    rig.write(0x1006, 0, 1000, 4)
    rig.send(0x205, "0f 00 64 00")
    assert rig.drive.torque != 0.0
    assert rig.send(0x000, "81 05") == [(0x705, "00")]
    assert rig.drive.nmt_state is NmtState.PRE_OPERATIONAL
    assert rig.drive.torque == 0.0
    assert rig.read(0x6041)[:5] == "50 02"
    assert rig.read(0x6072)[:5] == "e8 03"
    assert rig.read(0x1006) == "00 00 00 00"
    assert rig.read(0x6061)[:2] == "00"


def test_reset_communication_restores_the_communication_objects_only(rig: Rig) -> None:
    rig.write(0x6072, 0, 500, 2)
    rig.write(0x1017, 0, 100, 2)
    assert rig.send(0x000, "82 00") == [(0x705, "00")]
    assert rig.read(0x6072)[:5] == "f4 01"
    assert rig.read(0x1017)[:5] == "00 00"
    assert rig.run(500 * MS) == []


def watch_master(rig: Rig) -> None:
    assert rig.write(0x1016, 1, 0x007F_0064, 4) == "ok"  # node 127 within 100 ms


def test_watching_starts_with_the_first_heartbeat_of_the_master(rig: Rig) -> None:
    watch_master(rig)
    assert rig.run(500 * MS) == []
    rig.send(0x77F, "05")
    assert rig.run(599 * MS) == []
    assert rig.run(600 * MS) == [(0x085, "30 81 11 00 00 00 00 00")]


def test_lost_master_takes_the_torque_away_and_stops_pdos(rig: Rig) -> None:
    rig.enable()
    watch_master(rig)
    rig.send(0x77F, "05")
    rig.send(0x205, "0f 00 64 00")
    lost_at = rig.now + 100 * MS
    rig.run(lost_at - 1)
    assert rig.drive.torque == 0.1
    assert rig.run(lost_at) == [(0x085, "30 81 11 00 00 00 00 00")]
    assert rig.drive.torque == 0.0
    assert rig.drive.state is DriveState.FAULT_REACTION_ACTIVE
    assert rig.drive.nmt_state is NmtState.PRE_OPERATIONAL
    rig.run(lost_at + 2 * PERIOD)
    assert rig.read(0x603F)[:5] == "30 81"
    assert rig.read(0x6041)[:5] == "18 02"


def test_error_behaviour_decides_the_nmt_state_after_a_lost_heartbeat() -> None:
    for behaviour, state in [(0, NmtState.PRE_OPERATIONAL), (1, NmtState.OPERATIONAL), (2, NmtState.STOPPED)]:
        with Rig() as rig:
            rig.write(0x1029, 1, behaviour, 1)
            watch_master(rig)
            rig.start()
            rig.send(0x77F, "05")
            rig.run(rig.now + 100 * MS)
            assert rig.drive.nmt_state is state


def test_heartbeat_that_returns_withdraws_the_error_of_a_drive_without_power(rig: Rig) -> None:
    watch_master(rig)
    rig.send(0x77F, "05")
    rig.run(200 * MS)
    assert rig.send(0x77F, "05") == [(0x085, "00 00 00 00 00 00 00 00")]


def test_watching_one_node_twice_is_refused(rig: Rig) -> None:
    watch_master(rig)
    assert rig.write(0x1016, 2, 0x007F_0032, 4) == "06040043"
    assert rig.write(0x1016, 1, 0x007F_0032, 4) == "ok"
    assert rig.write(0x1016, 2, 0x007E_0032, 4) == "ok"


def test_abort_connection_option_decides_what_a_lost_master_does() -> None:
    outcomes = {
        0: (DriveState.OPERATION_ENABLED, 0.1),  # no action, as the standard says: the torque stays
        1: (DriveState.FAULT_REACTION_ACTIVE, 0.0),
        2: (DriveState.SWITCH_ON_DISABLED, 0.0),
        3: (DriveState.QUICK_STOP_ACTIVE, 0.0),
    }
    for option, (state, torque) in outcomes.items():
        with Rig() as rig:
            rig.enable()
            assert rig.write(0x6007, 0, option, 2) == "ok"
            watch_master(rig)
            rig.send(0x77F, "05")
            rig.send(0x205, "0f 00 64 00")
            rig.run(rig.now + 100 * MS)
            assert (rig.drive.state, rig.drive.torque) == (state, torque)


def test_leaving_operational_while_enabled_is_a_lost_connection() -> None:
    for command, state in [
        ("80", NmtState.PRE_OPERATIONAL),
        ("02", NmtState.STOPPED),
        ("82", NmtState.PRE_OPERATIONAL),
    ]:
        with Rig() as rig:
            rig.enable()
            rig.send(0x205, "0f 00 64 00")
            assert rig.send(0x000, f"{command} 05")[0] == (0x085, "00 81 11 00 00 00 00 00")
            assert rig.drive.torque == 0.0
            assert rig.drive.nmt_state is state
            rig.run(rig.now + 2 * PERIOD)
            assert rig.drive.state is DriveState.FAULT
