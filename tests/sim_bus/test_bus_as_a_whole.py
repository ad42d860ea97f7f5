"""The bus as a whole: wire time, freezes, stalls, bus-off, full queues, other devices, and real time."""

import errno
import itertools

import can
import pytest

from canhaptic.drive.clock import WallClock
from canhaptic.sim.bus.faulty_bus import BusEffects, FaultyBus, _worst_case_bits
from tests.sim_bus.bus_bench import MS, US, Bench, frame, numbered, numbers, virtual_bus


def test_frames_take_the_bits_of_the_literature() -> None:
    assert [_worst_case_bits(n) for n in (0, 2, 4, 6, 8)] == [55, 75, 95, 115, 135]


@pytest.mark.parametrize(("bitrate", "sync", "answer"), [(1_000_000, 55, 190), (125_000, 440, 1520)])
def test_a_frame_arrives_when_its_last_bit_has_passed(bitrate: int, sync: int, answer: int) -> None:
    with Bench(answer=bytes(8), wire_time=True, bitrate=bitrate, bring_up=True) as bench:
        bench.master.send(frame(0x080))
        assert bench.until(5 * MS) == [(answer * US, 0x181, bytes(8))]
        assert bench.ear.heard == [(sync * US, 0x080, b"")]


def test_the_wire_carries_one_frame_at_a_time_and_the_lowest_cob_id_of_those_that_wait() -> None:
    with Bench(wire_time=True, bring_up=True) as bench:
        for can_id in (0x77E, 0x601, 0x201, 0x080):
            bench.master.send(frame(can_id))
        bench.ear.bus.send(frame(0x181))
        assert bench.until(5 * MS) == [(3 * 55 * US, 0x181, b"")]
        assert [(time // US, can_id) for time, can_id, _ in bench.ear.heard] == [
            (55, 0x77E),  # it had begun when the others came
            (110, 0x080),
            (220, 0x201),
            (275, 0x601),
        ]


def test_a_frozen_bus_hands_over_everything_in_one_burst_at_the_end() -> None:
    with Bench(freeze=[{"begin": 0.1025, "duration": 4e-3}]) as bench:
        bench.sync()
        begin = bench.clock.now()
        heard = bench.send_all(numbered(10))
        assert [(time - begin) / MS for time, _, _ in heard] == [0, 1, 2, 6.5, 6.5, 6.5, 6.5, 7, 8, 9]
        assert numbers(heard) == list(range(10))


def test_a_frozen_wire_lets_the_burst_through_one_by_one() -> None:
    with Bench(freeze=[{"begin": 0.1, "duration": 4e-3}], wire_time=True) as bench:
        bench.sync()
        times = [time for time, _, _ in bench.send_all(numbered(3))]
        assert [after - before for before, after in itertools.pairwise(times)] == [95 * US, 95 * US]


@pytest.mark.parametrize("wire_time", [False, True])
def test_a_frozen_bus_carries_no_frame_of_another_device_either(wire_time: bool) -> None:
    with Bench(freeze=[{"begin": 0.01, "duration": 4e-3}], foreign_rate=2e4, wire_time=wire_time) as bench:
        bench.master.send(frame(0x080))
        heard = [time for time, _, _ in bench.until(20 * MS)]
        begun = 10 * MS + 135 * US * wire_time
        assert not any(begun < time < 14 * MS for time in heard)
        burst = heard.count(14 * MS)
        assert burst == 0 if wire_time else burst > 40  # on a wire they come one by one


def test_with_the_bus_off_frames_of_other_devices_are_lost_too() -> None:
    with Bench(bus_off=[{"duration": 1.0}], foreign_rate=1000.0) as bench:
        with pytest.raises(can.CanOperationError, match="bus-off"):
            bench.master.send(frame(0x080))
        assert bench.until(100 * MS) == []
        lost = len(bench.ear.heard)
        assert lost > 50
        assert bench.master.totals()["bus_off"] == {"to_drive": 1, "to_master": lost}


def test_a_stalled_master_sleeps_while_the_drives_live_on() -> None:
    with Bench(answer=b"\1", stall=[{"begin": 0.105, "duration": 50e-3}]) as bench:
        bench.sync()
        begin = bench.clock.now()
        times = []
        for n in range(10):
            bench.until(begin + n * MS)
            bench.master.send(frame(0x201))
            times.append((bench.clock.now() - begin) / MS)
        assert times == [0, 1, 2, 3, 4, 55, 55, 55, 55, 55]
        assert bench.master.totals() == {"stall": {"to_drive": 1}}


def test_a_stall_begins_with_the_faults_and_not_before() -> None:
    with Bench(stall=[{"duration": 1.0}]) as bench:
        bench.send_all(numbered(3))
        assert bench.clock.now() == 103 * MS
        bench.master.send(frame(0x080))
        bench.master.send(frame(0x080))
        assert bench.clock.now() == 1103 * MS


def test_with_the_bus_off_nothing_is_sent_and_what_comes_is_lost() -> None:
    with Bench(bus_off=[{"begin": 0.1, "duration": 2e-3}]) as bench:
        bench.sync()
        with pytest.raises(can.CanOperationError, match="bus-off"):
            bench.master.send(frame(0x201))
        bench.ear.bus.send(frame(0x181))
        assert bench.until(bench.clock.now() + 2 * MS) == []
        bench.master.send(frame(0x202))
        bench.ear.bus.send(frame(0x182))
        assert [can_id for _, can_id, _ in bench.until(bench.clock.now() + MS)] == [0x182]
        assert [can_id for _, can_id, _ in bench.ear.heard] == [0x202]
        assert bench.master.totals() == {"bus_off": {"to_drive": 1, "to_master": 1}}


def test_a_full_queue_refuses_a_frame_as_a_real_interface_does() -> None:
    with Bench(refuse=0.2) as bench:
        bench.sync()
        codes = []
        for message in numbered(1000):
            try:
                bench.master.send(message)
            except can.CanOperationError as error:
                codes.append(error.error_code)
        bench.until(bench.clock.now() + MS)
        refused = len(codes)
        assert set(codes) == {errno.ENOBUFS}
        assert refused == pytest.approx(200, abs=50)
        assert len(bench.ear.heard) == 1000 - refused
        assert bench.master.totals() == {"refuse": {"to_drive": refused}}


def test_frames_of_other_devices_reach_both_sides_at_the_rate_asked_for() -> None:
    with Bench(foreign_rate=2000.0, foreign_ids=(0x123, 0x321)) as bench:
        bench.master.send(frame(0x080))
        heard = bench.until(bench.clock.now() + 1000 * MS)
        assert len(heard) == pytest.approx(2000, abs=180)
        assert heard == bench.ear.heard[1:]
        assert bench.master.totals() == {"foreign": {"both": len(heard)}}
        assert [can_id for _, can_id, _ in heard[:4]] == [0x123, 0x321, 0x123, 0x321]
        assert {len(data) for _, _, data in heard} == set(range(9))
        gaps = [after[0] - before[0] for before, after in itertools.pairwise(heard)]
        assert min(gaps) < 50 * US < 1500 * US < max(gaps)  # at random, not evenly


def test_a_bus_without_clock_says_so() -> None:
    with (
        FaultyBus(virtual_bus("sim-bus-clockless"), BusEffects(drop=0.5), bitrate=1_000_000) as bus,
        pytest.raises(can.CanOperationError, match=r"no clock; call use\(clock\) first"),
    ):
        bus.send(frame(0x080))


def test_in_real_time_a_delayed_frame_wakes_whoever_waits_for_it() -> None:
    clock = WallClock()
    with (
        FaultyBus(virtual_bus("sim-bus-real"), BusEffects(delay=0.03, bring_up=True), bitrate=1_000_000) as bus,
        virtual_bus("sim-bus-real") as other,
    ):
        bus.use(clock)
        assert bus.recv(0.0) is None
        begin = clock.now()
        other.send(frame(0x181))
        bus.send(frame(0x201))
        message = bus.recv(60.0)
        assert message is not None
        assert message.arbitration_id == 0x181
        assert 0.03 <= (clock.now() - begin) * 1e-9 < 60.0
        assert other.recv(0.0) is not None
        begin = clock.now()
        assert bus.recv(0.05) is None
        assert (clock.now() - begin) * 1e-9 >= 0.05
