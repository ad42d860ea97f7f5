"""A rig on EtherCAT: start, cycle and every way out, on simulated drives down to the bytes."""

from itertools import count
from types import SimpleNamespace

import pytest

from canhaptic.drive.safety.link_policy import StopReason
from canhaptic.errors import HoldsContradictedError, NmtStateLeftError, RigError, StartError, TpdoLostError
from canhaptic.sim.drive.ethercat.cable import CableEffects, Fault
from canhaptic.sim.drive.ethercat.drive_node import ClockParameters
from canhaptic.sim.drive.profile.state_machine import DriveState
from tests.drive.ethercat.rig_bench import Bench
from tests.sim_drive.ethercat_line import PERIOD


def go_on(b: Bench) -> None:
    for _ in range(60):
        b.rig.sync()
        b.rig.write_torques([1.0])


DISABLED, PRE_OP = DriveState.SWITCH_ON_DISABLED, 2


@pytest.mark.parametrize("frames", [1, 2])
def test_a_torque_acts_in_the_hold_that_the_account_uses(frames: int) -> None:
    b = Bench(frames=frames)
    b.rig.start()
    acting = []
    for k in range(8):
        sample = b.rig.sync()[0]
        acting.append(sample.torque_applied)
        b.rig.write_torques([5.0 if k == 2 else 0.0])
    # computed from sample 2, held from SYNC 2 + delay on, and shown by the sample one later
    assert [k for k, torque in enumerate(acting) if torque] == [2 + b.axes[0].delay + 1]
    assert b.axes[0].delay == (1 if frames == 2 else 2)
    assert b.axes[0].check.contradicted == b.axes[0].uncommanded == 0


def test_a_run_ends_with_disabled_drives_in_pre_op_without_sync0_and_what_was_written_restored() -> None:
    b = Bench(2, drift=40_000)
    b.run(50, 5.0, -2.0)
    assert [drive.state for drive in b.drives] == [DISABLED] * 2
    assert [drive.al_state for drive in b.drives] == [PRE_OP] * 2
    assert [drive.esc.registers[0x981] for drive in b.drives] == [0, 0]
    assert all(len(axis.unrestored) == 1 and "Max torque" in axis.unrestored[0] for axis in b.axes)
    assert b.line.statistics()["unanswered"] == b.line.statistics()["low_counter"] == b.line.statistics()["late"] == 0
    assert [axis.disagreement for axis in b.axes] == ["", ""]


@pytest.mark.slow_but("1")
@pytest.mark.parametrize("frames", [1, 2])
def test_lost_and_late_frames_cost_samples_and_the_counts_of_held_torques_agree(frames: int) -> None:
    effects = CableEffects(late=0.02, lost=0.02, answer_lost=0.02, low_counter=0.02)
    b = Bench(2, drift=60_000, effects=effects, frames=frames, loss_limit=1.0)
    b.run(300, 5.0, -2.0)
    counts = b.rig.link_statistics()
    assert counts["held"] > 3
    assert 0.85 < counts["success_rate"] < 0.99
    assert [axis.disagreement for axis in b.axes] == ["", ""]
    assert all(axis.uncommanded == 0 for axis in b.axes)


def is_off(b: Bench) -> bool:
    return [(drive.state, drive.torque, drive.al_state) for drive in b.drives] == [(DISABLED, 0.0, PRE_OP)] * 2


@pytest.mark.slow_but("40000")
@pytest.mark.parametrize("drift", [40_000, -40_000])  # [ppb]: the counts would show the faster one, and only later
def test_a_clock_that_follows_no_other_ends_the_run_before_a_hold_is_counted_otherwise(drift: int) -> None:
    b = Bench(2, clocks=(ClockParameters(), ClockParameters(drift, 77_777, has_servo=False)))
    with pytest.raises(HoldsContradictedError, match=r"axis1: .* its clock is .* us from the reference clock .* 50 us"):
        b.run(500, 5.0, -2.0)
    assert b.rig.stop_reason is StopReason.HOLDS_CONTRADICTED
    assert [bool(axis.disagreement) for axis in b.axes] == [False, True]
    assert is_off(b)


def test_a_clock_that_is_far_from_the_reference_clock_is_refused_at_the_start() -> None:
    b = Bench(2, clocks=(ClockParameters(), ClockParameters(-200_000, 77_777, has_servo=False)))
    with pytest.raises(StartError, match=r"phase lock: got axis1: its clock is .* us from the reference clock"):
        b.rig.start()
    assert is_off(b)


def test_frames_that_are_lost_as_the_counts_begin_are_no_disagreement() -> None:
    b, frames = Bench(), count()
    b.cable.draw = lambda: Fault.LOST if next(frames) in (3, 5, 7) else Fault.NONE  # those that write
    b.run(20, 5.0)
    assert next(frames) > 7
    assert b.axes[0].disagreement == ""


def test_counts_of_held_torques_that_disagree_end_the_run() -> None:
    b = Bench()
    b.rig.start()
    entry = b.drives[0].store.find(0x1C32, 11)
    assert entry is not None
    entry.value = entry.number + 7
    with pytest.raises(HoldsContradictedError, match=r"axis0: .* disagree: the drive counts 8, the host 1"):
        b.rig.stop()


def test_a_drive_that_leaves_op_ends_the_run_with_its_al_code_although_every_counter_is_full() -> None:
    b = Bench(2, effects=CableEffects(falls_to_safe_op=0.05))
    with pytest.raises(NmtStateLeftError, match=r"AL status 0x14 \(SAFE_OP\), code 0x001a.*lower bus.rate"):
        b.run(200, 5.0, -2.0)
    assert b.rig.stop_reason is StopReason.NMT_STATE_LEFT
    assert b.line.low == 0
    assert all(drive.torque == 0.0 for drive in b.drives)


def test_a_broken_cable_ends_the_run_and_says_which_drive_did_not_confirm() -> None:
    b = Bench(2, effects=CableEffects(broken_at=0.05))
    with pytest.raises(TpdoLostError, match=r"axis0: .*NOT confirmed to be disabled: axis1: ") as error:
        b.run(200, 5.0, -2.0)
    assert "without an answer of all drives" in str(error.value)
    b.clock.wait_until(b.clock.now() + 20_000_000)
    assert all(drive.torque == 0.0 for drive in b.drives)


def test_the_drive_takes_its_torque_away_within_its_watchdog_where_the_master_falls_silent() -> None:
    b = Bench(watchdog=0.005)
    b.rig.start()
    for _ in range(5):
        b.rig.sync()
        b.rig.write_torques([5.0])
    b.clock.wait_until(b.clock.now() + 4_000_000)
    assert b.drives[0].torque == 5.0
    b.clock.wait_until(b.clock.now() + 2_000_000)
    assert (b.drives[0].torque, b.drives[0].al_state) == (0.0, 4)


def test_an_emergency_in_the_mailbox_ends_the_run() -> None:
    b = Bench()
    b.rig.start()
    b.drives[0].inject_fault(0x7305)
    with pytest.raises(RigError):
        go_on(b)
    assert b.rig.stop_reason in (StopReason.EMERGENCY, StopReason.DRIVE_FAULT)


@pytest.mark.parametrize(
    ("axis", "drive", "text"),
    [
        ({"position": 3}, {}, "presence: got 1 drives on the line, expected one at position 3"),
        ({"product_code": 0x99}, {}, "identity: got product 0x1234 in its EEPROM, expected 0x99"),
        ({}, {"objects": {"0x1C32.5": 2_000_000}}, "cycle time: .*at least 2000000 ns.*lower bus.rate to 500 Hz"),
        ({}, {"objects": {"0x6502": 0xA0}}, "drive modes: got 0x6502 = 0xa0"),
    ],
)
def test_a_drive_that_does_not_fit_is_refused_before_it_is_enabled(axis, drive, text):
    b = Bench(axis=axis, drive=drive)
    with pytest.raises(StartError, match=text):
        b.rig.start()
    assert b.drives[0].state is DISABLED
    assert b.drives[0].torque == 0.0


@pytest.mark.parametrize("axis", [{"watchdog": False}, {}])
def test_the_watchdog_of_the_sync_manager_is_that_of_the_bus_unless_the_axis_has_none(axis: dict[str, object]) -> None:
    b = Bench(axis=axis, watchdog=0.02)
    b.rig.start()
    assert int.from_bytes(b.drives[0].esc.registers[0x420:0x422], "little") == (0 if axis else 200)
    b.rig.stop()


@pytest.mark.slow_but("700000")
@pytest.mark.parametrize("drift", [700_000, -700_000])
def test_the_sample_times_of_a_clock_that_drifts_by_a_whole_one_are_counted_exactly(drift: int) -> None:
    bench = Bench(drift=drift)
    bench.rig.start()
    begun = bench.clock.now()
    for _ in range(1600):  # in which the clocks part by more than a sample time
        bench.rig.sync()
        bench.rig.write_torques([0.0])
    assert abs(bench.clock.now() - begun - bench.rig.sync_index * PERIOD) > PERIOD
    assert (bench.rig.deadline_index, bench.rig.skipped_syncs) == (bench.rig.sync_index, 0)
    bench.rig.stop()


@pytest.mark.slow_but("0.4", "0.6")
@pytest.mark.parametrize("late", [0.4, 0.6, 0.7])
def test_a_host_that_is_held_up_before_its_frame_counts_the_holds_of_the_drives(late: float) -> None:
    bench = Bench()
    bench.rig.start()
    ask, held_up = bench.line.ask, list[float]()

    def ask_late(woken: int) -> int:
        bench.clock.wait_until(woken + round(held_up.pop() * PERIOD) if held_up else woken)
        return ask(bench.clock.now())

    bench.line.ask = ask_late
    counted, passed = [], 0
    for k in range(40):
        held_up[:] = [late] if k == 10 else []
        bench.rig.sync()
        bench.rig.write_torques([0.0])
        passed += bench.rig.periods * (k > 0)  # what the algorithms are given
        if bench.axes[0].is_complete:
            counted.append((bench.rig.deadline_index, bench.line._taken))
            assert passed == bench.rig.deadline_index
    assert len(counted) > 30
    assert {hold - index for index, hold in counted} == {counted[0][1] - counted[0][0]}
    bench.rig.stop()


def test_two_late_frames_in_a_row_are_no_slip_of_the_host_and_no_two_samples_are_of_one_hold() -> None:
    bench = Bench(loss_limit=1.0)
    bench.rig.start()
    kinds = iter(([Fault.NONE, Fault.LATE] * 2 + [Fault.NONE] * 12) * 4)
    bench.cable.draw = lambda: next(kinds, Fault.NONE)
    seen, passed = [], 0
    for k in range(40):
        [sample] = bench.rig.sync()
        bench.rig.write_torques([1.0])
        passed += bench.rig.periods * (k > 0)
        seen.append((sample.fresh, bench.rig.deadline_index, passed))
    assert sum(not fresh for fresh, _, _ in seen) == 8
    assert all(index == count == k for k, (_, index, count) in enumerate(seen))
    bench.rig.stop()


def test_a_drive_that_counts_no_held_torques_is_not_asked_for_its_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench()
    monkeypatch.setattr(bench.axes[0], "dictionary", SimpleNamespace(get_variable=lambda *_place: None))
    monkeypatch.setattr(bench.line.segment, "register", pytest.fail)
    bench.axes[0].begin_counts()
    assert bench.axes[0].counts_before is None
