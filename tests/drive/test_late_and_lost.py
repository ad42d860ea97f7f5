"""A host that is late and frames that are lost: SYNCs skipped, how long a torque was held, what goes out after it."""

import itertools

import can
import pytest

from canhaptic.errors import LinkError
from canhaptic.sim.drive.profile.state_machine import DriveState
from tests.drive.drive_bench import MakeBench, axis, started


@pytest.mark.slow_but("0", "1", "6")
@pytest.mark.parametrize("late", [0, 1, 5, 6, 9])
def test_a_stall_skips_syncs_and_never_bursts(bench: MakeBench, late: int) -> None:
    b = started(bench)
    period = b.rig.bus.sample_time_ns
    b.run(3)
    b.clock.wait_until(b.clock.now() + 20 * period + late * period // 10)
    samples = b.run(5)
    times = [time for time, can_id, _, is_rx in b.frames if can_id == 0x080 and not is_rx][-7:]
    gaps = [(later - earlier) / period for earlier, later in itertools.pairwise(times)]
    assert gaps[0] == 1.0
    assert gaps[1] == pytest.approx(20.0 + late / 10 if late < 5 else 21.0)
    assert min(gaps) >= 0.5
    assert gaps[3:] == [1.0] * 3
    assert b.rig.skipped_syncs == (19 if late < 5 else 20)
    assert [sample.sync_index for sample in samples] == [3, 4, 5, 6, 7]
    assert b.rig.drives[0].longest_hold == (20 if late < 5 else 21)


@pytest.mark.slow_but("389-1", "517-3")
@pytest.mark.parametrize("lost", [0, 1, 3])
@pytest.mark.parametrize("cob_id", [0x185, 0x205])
def test_a_hold_lasts_as_many_sample_times_as_frames_were_lost_in_a_row(bench: MakeBench, cob_id: int, lost: int):
    b = started(bench)
    for cycle in range(6):
        b.run(1, torque=1.0 + 0.1 * cycle)
    assert b.rig.drives[0].longest_hold == 1
    gone = itertools.count()

    def lose(message: can.Message) -> can.Message | None:
        return None if message.arbitration_id == cob_id and next(gone) < lost else message

    b.tampered.on_send = b.tampered.on_receive = lose
    for cycle in range(8):
        b.run(1, torque=2.0 + 0.1 * cycle)
    assert b.rig.drives[0].longest_hold == 1 + lost


@pytest.mark.parametrize("asked", [5.0, -5.0, 0.5])
def test_after_a_skipped_sync_no_torque_is_raised_for_one_cycle(bench: MakeBench, asked: float) -> None:
    """A controller sees several sample times of motion as one: its damper would brake that many times too hard."""
    b = started(bench)
    b.run(4, torque=1.0)
    b.clock.wait_until(b.clock.now() + 14 * b.rig.bus.sample_time_ns)
    b.run(2, torque=1.0)  # the SYNC that is sent before the stall ends, and the one after it
    b.clock.wait_until(b.clock.now() + 14 * b.rig.bus.sample_time_ns)
    b.run(3, torque=asked)
    assert b.torques_sent()[-3:] == [{5.0: 100, -5.0: 0, 0.5: 50}[asked], *[round(100 * asked)] * 2]


@pytest.mark.parametrize("lost", [1, 3])
def test_frames_lost_both_ways_count_together(bench: MakeBench, lost: int) -> None:
    """A link dead from one RPDO on, until just before a SYNC: the torque before acts for every one of those holds."""
    b = started(bench)
    for cycle in range(6):
        b.run(1, torque=1.0 + 0.1 * cycle)
    taken, left = itertools.count(), itertools.count()

    def lose(message: can.Message) -> can.Message | None:
        rpdo, tpdo = message.arbitration_id == 0x205, message.arbitration_id == 0x185
        is_lost = (rpdo and next(left) <= lost) or (tpdo and 0 < next(taken) <= lost)
        return None if is_lost else message

    b.tampered.on_send = b.tampered.on_receive = lose
    for cycle in range(8):
        b.run(1, torque=2.0 + 0.1 * cycle)
    assert b.rig.drives[0].longest_hold == 2 + lost


@pytest.mark.parametrize("late", [7, 8])
def test_a_skipped_sync_and_a_lost_rpdo_count_together(bench: MakeBench, late: int) -> None:
    """The torque of cycle 5 acts from SYNC 6 on and, the RPDO of cycle 6 being lost, until SYNC 8; one is 3 T late."""
    b = started(bench)
    gone = itertools.count()

    def lose(message: can.Message) -> can.Message | None:
        return None if message.arbitration_id == 0x205 and next(gone) == 6 else message

    b.tampered.on_send = lose
    for cycle in range(12):
        if cycle == late:
            b.clock.wait_until(b.clock.now() + 3 * b.rig.bus.sample_time_ns)
        b.run(1, torque=1.0 + 0.1 * cycle)
    assert b.rig.drives[0].longest_hold == 3 + 1


def test_a_run_that_ends_unheard_tells_how_long_its_last_torque_was_held(bench: MakeBench) -> None:
    b = started(bench, bus={"hold_cycles": 4, "stop_cycles": 6})
    b.run(5, torque=4.0)
    b.tampered.drop(0x185)
    with pytest.raises(LinkError, match="6 SYNCs in a row"):
        b.run(20, torque=4.0)
    assert b.rig.drives[0].longest_hold == 6


def test_a_master_that_runs_late_still_sends_its_heartbeat_in_time(bench: MakeBench) -> None:
    """On a busy host each cycle oversleeps by six periods: 20 cycles would be 120 ms, and the drive waits for 100."""
    b = started(bench)
    before = len(b.sent(0x77E))
    for _ in range(60):
        b.clock.wait_until(b.clock.now() + 6 * b.rig.bus.sample_time_ns)
        b.run(1)
    assert b.rig.skipped_syncs >= 250
    assert len(b.sent(0x77E)) - before >= 15
    assert b.drives[0].state is DriveState.OPERATION_ENABLED


def test_what_may_have_acted_in_lost_holds_is_known(bench: MakeBench) -> None:
    """1.4 and 1.5 N were sent for them, 1.3 N acted before, and stayed where a command was lost; 1.5 N acted last."""
    b = started(bench)
    for cycle in range(6):
        b.run(1, torque=1.0 + 0.1 * cycle)
    drive, taken = b.rig.drives[0], itertools.count()
    assert drive.open_time is None
    b.tampered.on_receive = lambda message: None if message.arbitration_id == 0x185 and next(taken) < 2 else message
    b.run(2, torque=1.6)
    [sample] = b.run(1, torque=1.8)
    assert (sample.torque_applied, drive.open_time, drive.open_torque) == (1.5, 2, pytest.approx(0.2))
    b.run(1, torque=1.9)
    assert drive.open_time is None


def test_where_only_a_sum_of_displacements_is_known_the_bound_counts_the_farthest_that_the_speed_allows(bench):
    b = started(bench, [axis(read_back="none", speed_limit=1.0)])
    b.run(10, torque=1.0)
    before = b.rig.drives[0].read_back_bound
    b.tampered.drop(0x185)
    b.run(1, torque=-1.0)
    b.tampered.drop()
    b.run(1, torque=-1.0)
    rise = b.rig.drives[0].read_back_bound - before
    assert 1e-3 < rise < 2.0 * 3 * 2e-3  # [J]: 2 N over two or three holds of 1 m/s
