"""One rig on two buses: one SYNC index, each bus with its own budget."""

import itertools

import can
import pytest

from canhaptic.drive.axis_parameters import CanBusParameters
from canhaptic.drive.can.bus_cycle import can_buses
from canhaptic.drive.can.link import Link
from canhaptic.drive.can.servo_drive import ServoDrive
from canhaptic.drive.clock import VirtualClock
from canhaptic.drive.rig import Rig
from canhaptic.errors import BusBudgetError, LinkError
from canhaptic.sim.drive import SimulatedDriveParameters
from canhaptic.sim.drive.can.drive_node import DrivesOnBus, SimulatedDrive
from canhaptic.sim.drive.profile.state_machine import DriveState
from tests.drive.drive_bench import FreeMass, axis, dictionary, private_channel


class Buses:
    """Axes side by side, the same node IDs on every bus; by default four that do not fit one bus at 1 kHz, two and two.

    Args:
        count: Of buses.
        per_bus: Axes on each.
        rate: Of SYNC [Hz].
    """

    def __init__(self, count: int = 2, per_bus: int = 2, rate: float = 1000.0) -> None:
        parameters = CanBusParameters(rate=rate)
        axes = [axis(node, name=f"{side}{node}") for side in "abc"[:count] for node in range(5, 5 + per_bus)]
        channels = [private_channel() for _ in range(count)]
        self.buses: list[can.BusABC] = []
        self.simulated = [
            SimulatedDrive(
                self.connect(channels[number // per_bus]),
                a.node_id,
                dictionary(a),
                FreeMass(),
                SimulatedDriveParameters(counts_per_unit=a.counts_per_unit, rated_torque=10.0),
                parameters.sample_time_ns,
            )
            for number, a in enumerate(axes)
        ]
        far_sides = zip(self.buses, self.simulated, strict=True)
        self.clock = VirtualClock([DrivesOnBus(bus, (drive,)) for bus, drive in far_sides])
        self.links = [Link(self.connect(channel), self.clock) for channel in channels]
        drives = [
            ServoDrive(self.links[number // per_bus], a, dictionary(a), parameters) for number, a in enumerate(axes)
        ]
        self.rig = Rig(can_buses(self.links, drives, parameters), drives, parameters)

    def connect(self, channel: str) -> can.BusABC:
        self.buses.append(can.Bus(interface="virtual", channel=channel, preserve_timestamps=True))
        return self.buses[-1]

    def close(self) -> None:
        for bus in self.buses:
            bus.shutdown()


def test_two_buses_share_one_sync_index_and_stop_together() -> None:
    two = Buses()
    two.rig.start()
    for _ in range(10):
        samples = two.rig.sync()
        assert len({sample.sync_index for sample in samples}) == 1
        two.rig.write_torques([1.0, 2.0, 3.0, 4.0])
    assert [sample.torque_applied for sample in samples] == pytest.approx([1.0, 2.0, 3.0, 4.0])
    assert len(two.rig.buses) == 2
    two.rig.stop()
    assert {drive.state for drive in two.simulated} == {DriveState.SWITCH_ON_DISABLED}
    two.close()


def test_a_host_that_stops_while_it_reads_the_second_bus_sends_no_two_syncs_in_a_burst(monkeypatch) -> None:
    two = Buses()
    two.rig.start()
    period, drain, sent = two.rig.bus.sample_time_ns, two.rig.buses[1].drain, [0]
    stops = itertools.count()

    def late() -> None:
        drain()
        if len(sent) == 6 and next(stops) == 0:
            two.clock.wait_until(two.clock.now() + 9 * period + 9 * period // 10)

    monkeypatch.setattr(two.rig.buses[1], "drain", late)
    for _ in range(12):
        two.rig.sync()
        two.rig.write_torques([1.0] * 4)
        sent.append(two.rig._pace.synced)
    gaps = [(after - before) / period for before, after in itertools.pairwise(sent[2:])]
    assert max(gaps) == pytest.approx(11.0)
    assert min(gaps) == pytest.approx(1.0)
    assert two.rig.skipped_syncs == 10
    two.close()


def test_one_bus_that_dies_stops_the_drives_of_the_other() -> None:
    two = Buses()
    two.rig.start()
    for _ in range(5):
        two.rig.sync()
        two.rig.write_torques([1.0] * 4)

    def fail(message: can.Message, timeout: float | None = None) -> None:
        raise can.CanOperationError("bus-off")

    two.buses[-1].send = fail  # type: ignore[assignment]
    with pytest.raises(LinkError, match="NOT confirmed to be disabled: b5"):
        two.rig.sync()
    assert [drive.state for drive in two.simulated[:2]] == [DriveState.SWITCH_ON_DISABLED] * 2
    assert [drive.torque for drive in two.simulated[:2]] == [0.0, 0.0]
    two.close()


@pytest.mark.slow_but("1-3-500.0", "1-2-1000.0")
@pytest.mark.parametrize(
    ("count", "per_bus", "rate"),
    [(1, 1, 1000.0), (1, 2, 1000.0), (1, 3, 500.0), (1, 6, 400.0), (2, 3, 500.0), (3, 2, 1000.0)],
)
def test_each_axis_pairs_its_own_torque_and_displacement_by_one_sync_index(count: int, per_bus: int, rate: float):
    rig_of = Buses(count, per_bus, rate)
    rig_of.rig.start()
    axes = count * per_bus
    torques = [0.5 * (number + 1) for number in range(axes)]
    work, last = [0.0] * axes, rig_of.rig.sync()
    for cycle in range(1, 30):
        rig_of.rig.write_torques([torque * (-1) ** (cycle // 5) for torque in torques])
        samples = rig_of.rig.sync()
        assert [sample.sync_index for sample in samples] == [cycle] * axes
        for number, (sample, before) in enumerate(zip(samples, last, strict=True)):
            work[number] += sample.torque_applied * (sample.position - before.position)
        last = samples
    for number, drive in enumerate(rig_of.simulated):
        kinetic = 0.5 * drive.servo.motor.velocity**2  # of a free mass of 1 kg
        assert work[number] == pytest.approx(kinetic, abs=30 * torques[-1] * 1e-5)  # one count in each cycle
    rig_of.rig.stop()
    assert {drive.state for drive in rig_of.simulated} == {DriveState.SWITCH_ON_DISABLED}
    rig_of.close()


def test_six_axes_do_not_fit_one_bus_at_1_khz() -> None:
    with pytest.raises(BusBudgetError, match=r"2180 us of 1000 us.*rate: 400"):
        Buses(1, 6)
