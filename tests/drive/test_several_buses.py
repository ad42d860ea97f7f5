"""One rig on two buses: one SYNC index, each bus with its own budget."""

import can
import pytest
from drive_bench import FreeMass, axis, dictionary, private_channel

from canhaptic.drive.clock import VirtualClock
from canhaptic.drive.link import Link
from canhaptic.drive.parameters import BusParameters
from canhaptic.drive.rig import Rig
from canhaptic.drive.servo_drive import ServoDrive
from canhaptic.errors import LinkError
from canhaptic.sim.drive_node import SimulatedDrive
from canhaptic.sim.drive_parameters import SimulatedDriveParameters
from canhaptic.sim.state_machine import DriveState


class TwoBuses:
    """Four axes that do not fit one bus at 1 kHz, two and two; the same node IDs on both."""

    def __init__(self) -> None:
        parameters = BusParameters(rate=1000.0)
        axes = [axis(node_id, name=f"{side}{node_id}") for side in "ab" for node_id in (5, 6)]
        channels = [private_channel(), private_channel()]
        self.buses: list[can.BusABC] = []
        self.simulated = [
            SimulatedDrive(
                self.connect(channels[number // 2]),
                a.node_id,
                dictionary(a),
                FreeMass(),
                SimulatedDriveParameters(counts_per_unit=a.counts_per_unit, rated_torque=10.0),
                parameters.sample_time_ns,
            )
            for number, a in enumerate(axes)
        ]
        self.clock = VirtualClock(self.simulated)
        self.links = [Link(self.connect(channel), self.clock) for channel in channels]
        drives = [ServoDrive(self.links[number // 2], a, dictionary(a), parameters) for number, a in enumerate(axes)]
        self.rig = Rig(self.links, drives, parameters)

    def connect(self, channel: str) -> can.BusABC:
        self.buses.append(can.Bus(interface="virtual", channel=channel, preserve_timestamps=True))
        return self.buses[-1]

    def close(self) -> None:
        for bus in self.buses:
            bus.shutdown()


def test_two_buses_share_one_sync_index_and_stop_together() -> None:
    two = TwoBuses()
    two.rig.start()
    for _ in range(10):
        samples = two.rig.sync()
        assert len({sample.sync_index for sample in samples}) == 1
        two.rig.write_torques([1.0, 2.0, 3.0, 4.0])
    assert [sample.torque_applied for sample in samples] == pytest.approx([1.0, 2.0, 3.0, 4.0])
    assert len(two.rig.budgets) == 2
    two.rig.stop()
    assert {drive.state for drive in two.simulated} == {DriveState.SWITCH_ON_DISABLED}
    two.close()


def test_one_bus_that_dies_stops_the_drives_of_the_other() -> None:
    two = TwoBuses()
    two.rig.start()
    for _ in range(5):
        two.rig.sync()
        two.rig.write_torques([1.0] * 4)

    def fail(message: can.Message, timeout: float | None = None) -> None:
        raise can.CanOperationError("bus-off")

    two.buses[-1].send = fail  # type: ignore[method-assign]
    with pytest.raises(LinkError, match="NOT confirmed to be disabled: b5"):
        two.rig.sync()
    assert [drive.state for drive in two.simulated[:2]] == [DriveState.SWITCH_ON_DISABLED] * 2
    assert [drive.torque for drive in two.simulated[:2]] == [0.0, 0.0]
    two.close()
