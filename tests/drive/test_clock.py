"""The clocks: virtual time moves only while somebody waits; real time is never cut short and never bursts."""

import itertools
import threading
from collections.abc import Iterator

import can
import pytest

from canhaptic.drive.axis_parameters import CanBusParameters
from canhaptic.drive.can.bus_cycle import can_buses
from canhaptic.drive.can.link import Link
from canhaptic.drive.can.servo_drive import ServoDrive
from canhaptic.drive.clock import DurationHistogram, VirtualClock, WallClock
from canhaptic.drive.rig import Rig
from canhaptic.sim.drive import SimulatedDriveParameters
from canhaptic.sim.drive.can.drive_node import DrivesOnBus, SimulatedDrive
from canhaptic.sim.drive.profile.state_machine import DriveState
from tests.drive.drive_bench import FreeMass, MakeBench, axis, dictionary, make_bench, private_channel, started

MS = 1_000_000


class Metronome:
    """A far side with a timer every 3 ms, which notes when it is processed."""

    def __init__(self, bus: can.BusABC | None = None) -> None:
        self.bus, self.ticks, self.due = bus, list[int](), 3 * MS

    def process(self, now: int) -> None:
        while now >= self.due:
            self.ticks.append(now)
            self.due += 3 * MS
            if self.bus is not None:
                self.bus.send(can.Message(arbitration_id=0x705, is_extended_id=False, timestamp=now * 1e-9))

    def next_due(self) -> int:
        return self.due


@pytest.fixture
def pair() -> Iterator[tuple[can.BusABC, can.BusABC]]:
    channel = private_channel()
    buses = [can.Bus(interface="virtual", channel=channel, preserve_timestamps=True) for _ in range(2)]
    yield buses[0], buses[1]
    for bus in buses:
        bus.shutdown()


def test_virtual_time_stands_still_until_somebody_waits() -> None:
    clock = VirtualClock(start=5)
    assert [clock.now() for _ in range(3)] == [5, 5, 5]
    clock.wait_until(100)
    assert clock.now() == 100
    clock.wait_until(50)
    assert clock.now() == 100


def test_virtual_time_stops_at_every_timer_of_the_far_sides() -> None:
    far_side = Metronome()
    clock = VirtualClock([far_side])
    clock.wait_until(10 * MS)
    assert far_side.ticks == [3 * MS, 6 * MS, 9 * MS]


def test_a_frame_is_received_at_the_instant_it_was_sent(pair: tuple[can.BusABC, can.BusABC]) -> None:
    clock = VirtualClock([Metronome(pair[1])])
    message = clock.receive(pair[0], 10 * MS)
    assert message is not None
    assert clock.now() == 3 * MS
    assert message.timestamp == pytest.approx(0.003)


def test_receiving_ends_at_the_deadline_and_not_before(pair: tuple[can.BusABC, can.BusABC]) -> None:
    clock = VirtualClock()
    assert clock.receive(pair[0], 10 * MS) is None
    assert clock.now() == 10 * MS


def test_a_drive_with_nothing_due_is_not_asked_again_after_time_has_jumped(pair: tuple[can.BusABC, can.BusABC]) -> None:
    class Counted(Metronome):
        calls = 0

        def process(self, now: int) -> None:
            self.calls += 1
            super().process(now)

    far_side = Counted()
    clock = VirtualClock([far_side])
    assert clock.receive(pair[0], 2 * MS) is None
    assert (clock.now(), far_side.calls) == (2 * MS, 1)
    assert clock.receive(pair[0], 3 * MS) is None  # the timer is due at the deadline itself
    assert (far_side.ticks, far_side.calls) == ([3 * MS], 3)


def test_a_timer_that_stays_overdue_cannot_hold_time_up() -> None:
    class Stuck(Metronome):
        def process(self, now: int) -> None:
            pass

    clock = VirtualClock([Stuck()])
    clock.wait_until(10 * MS)
    assert clock.now() == 10 * MS


@pytest.mark.slow_for("1")
@pytest.mark.parametrize("far_sides", [0, 1])
def test_real_waiting_never_ends_early(pair: tuple[can.BusABC, can.BusABC], far_sides: int) -> None:
    clock = WallClock([Metronome()] * far_sides, spin_margin=1e-4)
    for wait in (0, 10_000, 300_000, 3 * MS):
        deadline = clock.now() + wait
        clock.wait_until(deadline)
        assert clock.now() >= deadline
        deadline = clock.now() + wait
        assert clock.receive(pair[0], deadline) is None
        assert clock.now() >= deadline


def test_a_frame_ends_a_real_wait_at_once(pair: tuple[can.BusABC, can.BusABC]) -> None:
    clock = WallClock()
    pair[1].send(can.Message(arbitration_id=0x123, is_extended_id=False))
    deadline = clock.now() + 5_000 * MS
    assert clock.receive(pair[0], deadline) is not None
    assert clock.now() < deadline


class SlowMachine:
    """Replaces the module `time`: every look costs 1 us, every sleep lasts 80 us longer than asked for."""

    def __init__(self) -> None:
        self.nanoseconds, self.sleeps = 0, list[int]()

    def monotonic_ns(self) -> int:
        self.nanoseconds += 1_000
        return self.nanoseconds

    def sleep(self, seconds: float) -> None:
        self.sleeps.append(round(seconds * 1e9))
        self.nanoseconds += round(seconds * 1e9) + 80_000

    def recv(self, timeout: float) -> None:
        """Replaces a bus on which nothing ever comes."""
        if timeout:
            self.sleep(timeout)
        self.nanoseconds += 2_000


@pytest.mark.parametrize("far_sides", [0, 1])
def test_a_real_wait_sleeps_once_for_each_thing_due_and_spins_the_rest(monkeypatch, far_sides: int) -> None:
    for waits_on_bus in (False, True):
        machine, far_side = SlowMachine(), Metronome()
        monkeypatch.setattr("canhaptic.drive.clock.time", machine)
        clock = WallClock([far_side] * far_sides, spin_margin=200e-6)
        for deadline in (2 * MS, 10 * MS):
            if waits_on_bus:
                assert clock.receive(machine, deadline) is None  # type: ignore[arg-type]
            else:
                clock.wait_until(deadline)
            assert 0 <= machine.nanoseconds - deadline <= 5_000
        assert len(machine.sleeps) == (5 if far_sides else 2)  # until 2, 3, 6, 9 and 10 ms; or until 2 and 10
        assert [tick // 100_000 for tick in far_side.ticks] == ([30, 60, 90] if far_sides else [])


@pytest.mark.slow
def test_a_frame_from_elsewhere_ends_a_real_wait_though_a_drive_lives_in_this_thread(pair):
    clock = WallClock([Metronome()])
    sender = threading.Timer(0.01, pair[1].send, [can.Message(arbitration_id=0x123, is_extended_id=False)])
    sender.start()
    deadline = clock.now() + 60_000 * MS
    assert clock.receive(pair[0], deadline) is not None
    assert clock.now() < deadline
    sender.join()


def test_the_lateness_of_a_wakeup_ends_before_the_sync_is_sent() -> None:
    bench = make_bench()
    bench.rig.start()
    bench.run(3)
    slow = bench.tampered.inner.send

    def send(message: can.Message, timeout: float | None = None) -> None:
        if message.arbitration_id == 0x080:
            bench.clock.wait_until(bench.clock.now() + 7_000)
        slow(message, timeout)

    bench.tampered.inner.send = send  # type: ignore[assignment]
    bench.rig.sync()
    bench.rig.write_torques([0.0])
    assert (bench.rig.timing.wakeup_lateness, bench.rig.timing.sync_to_last_tpdo) == (0, 7_000)
    bench.close()


def test_a_rig_in_real_time_never_sends_syncs_in_a_burst(pair: tuple[can.BusABC, can.BusABC]) -> None:
    parameters, of_axis = (
        CanBusParameters(rate=200.0, heartbeat_timeout=10.0),
        axis(),
    )  # a busy machine may sleep for long
    drive = SimulatedDrive(
        pair[1],
        of_axis.node_id,
        dictionary(of_axis),
        FreeMass(),
        SimulatedDriveParameters(counts_per_unit=of_axis.counts_per_unit, rated_torque=10.0),
        parameters.sample_time_ns,
    )
    syncs: list[int] = []

    def record(timestamp: int, can_id: int, data: bytes | bytearray, is_rx: bool) -> None:
        if can_id == 0x080:
            syncs.append(timestamp)

    clock = WallClock([DrivesOnBus(pair[1], (drive,))])
    link = Link(pair[0], clock, record)
    drives = [ServoDrive(link, of_axis, dictionary(of_axis), parameters)]
    rig = Rig(can_buses(link, drives, parameters), drives, parameters)
    with rig:
        syncs.clear()
        for cycle in range(30):
            rig.sync()
            rig.write_torques([0.5])
            if cycle == 10:
                clock.wait_until(clock.now() + 33 * MS)
    gaps = [later - earlier for earlier, later in itertools.pairwise(syncs)]
    assert min(gaps) >= 2 * MS
    assert rig.skipped_syncs >= 5
    assert drive.state is DriveState.SWITCH_ON_DISABLED


def test_the_timing_of_a_cycle_is_recorded() -> None:
    bench = make_bench()
    bench.rig.start()
    assert bench.rig.timing == (0, 0, 0, 0)
    bench.run(5)
    assert bench.rig.timing == (0, 0, 0, 0)
    bench.rig.sync()
    bench.clock.wait_until(bench.clock.now() + 250_000)
    bench.rig.write_torques([0.0])
    assert bench.rig.timing.compute == 250_000
    bench.clock.wait_until(bench.clock.now() + MS)
    bench.rig.sync()
    bench.rig.write_torques([0.0])
    assert bench.rig.timing.wakeup_lateness == 250_000
    bench.close()


@pytest.mark.parametrize(("late", "gap", "skipped"), [(0.4, 0.6, 0), (0.7, 1.3, 1), (2.2, 0.8, 2), (2.9, 1.1, 3)])
def test_a_sync_held_up_after_its_wait_is_not_followed_at_once(late: float, gap: float, skipped: int) -> None:
    bench, syncs = make_bench(), list[int]()
    bench.rig.start()
    bench.run(3)
    period = bench.rig.bus.sample_time_ns
    drive, send = bench.rig.drives[0], bench.tampered.inner.send
    expect = drive.expect_tpdos

    def hold_up() -> None:
        bench.clock.wait_until(bench.clock.now() + round(late * period))
        drive.expect_tpdos = expect
        expect()

    def note(message: can.Message, timeout: float | None = None) -> None:
        if message.arbitration_id == 0x080:
            syncs.append(bench.clock.now())
        send(message, timeout)

    drive.expect_tpdos = hold_up
    bench.tampered.inner.send = note  # type: ignore[assignment]
    before, index = bench.rig.skipped_syncs, bench.rig.deadline_index
    for _ in range(2):
        bench.rig.sync()
        bench.rig.write_torques([0.0])
    assert syncs[1] - syncs[0] == pytest.approx(gap * period, abs=2)
    assert bench.rig.skipped_syncs - before == skipped
    assert bench.rig.deadline_index - index == 2 + skipped
    bench.close()


@pytest.mark.parametrize(("beyond_half", "skipped"), [(0, 0), (1, 1)])
def test_a_deadline_is_skipped_when_it_is_overslept_by_more_than_half_a_period(beyond_half: int, skipped: int) -> None:
    bench = make_bench()
    bench.rig.start()
    bench.run(3)
    last = bench.clock.now()
    bench.clock.wait_until(last + MS + MS // 2 + beyond_half)
    bench.rig.sync()
    assert bench.rig.skipped_syncs == skipped
    assert bench.clock.now() == last + (2 * MS if skipped else MS + MS // 2)
    bench.close()


def test_durations_have_quantiles_to_a_microsecond_and_an_exact_maximum() -> None:
    durations = DurationHistogram()
    assert durations.quantile(0.5) == 0.0
    for duration in (*[1_500] * 98, 7_200, 41_000_000):
        durations.add(duration)
    assert durations.total == 100
    assert [durations.quantile(part) for part in (0.5, 0.98, 0.99)] == pytest.approx([2e-6, 2e-6, 8e-6])
    assert durations.quantile(1.0) == pytest.approx(41e-3)  # beyond the bins
    assert durations.summary() == pytest.approx({"p50": 2e-6, "p99": 8e-6, "p99.9": 41e-3, "max": 41e-3})
    durations.add(-5)
    assert durations.quantile(0.001) == pytest.approx(1e-6)


def test_a_hold_is_uneven_by_what_it_differs_from_its_sample_times(bench: MakeBench) -> None:
    b = started(bench)
    b.run(3)
    assert (b.rig.uneven, b.rig.periods) == (0, 1)
    b.clock.wait_until(b.clock.now() + 1_200_000)  # after the SYNC due at 1 ms
    b.run(1)
    assert b.rig.periods == 1
    assert b.rig.uneven == pytest.approx(200_000, abs=20_000)
