"""A drive written by hand, with one odd habit at a time: refused, ended or endured, named, and no torque before."""

from collections.abc import Iterator
from contextlib import contextmanager

import can
import pytest

from canhaptic.canopen.attached_devices import ForceNode
from canhaptic.canopen.eds import read_dictionary
from canhaptic.drive.axis_parameters import AxisParameters, CanBusParameters
from canhaptic.drive.can.bus_cycle import can_buses
from canhaptic.drive.can.link import Link
from canhaptic.drive.can.motion_drive import CanMotionDrive
from canhaptic.drive.can.servo_drive import ServoDrive
from canhaptic.drive.clock import VirtualClock
from canhaptic.drive.profile.motion_parameters import ForceParameters, MotionParameters
from canhaptic.drive.rig import Rig
from canhaptic.errors import RigError, StartError
from tests.drive.drive_bench import REPOSITORY, axis, private_channel
from tests.drive.odd_habits import BEGIN, END, HABITS, Habit, table
from tests.drive.odd_slave import MILLISECOND, NODE, OddSensor, OddSlave

RATE = 100.0  # [Hz]
CYCLES = 200


def display(kind: str) -> AxisParameters:
    source = (
        {"node": ForceNode(node_id=0x21, device_type=404, tare=True)} if kind == "sensor" else {"object": "0x2205.1"}
    )
    force = ForceParameters(per_count=0.01, range=300.0, slew=5e3, error=0.5, frozen_after=50, **source)
    parameters = MotionParameters(mode="position", acceleration_limit=50.0, handle_acceleration=80.0, force=force)
    return axis(
        NODE,
        name="handle",
        eds=REPOSITORY / "eds" / "cia402_admittance.eds",
        admittance=parameters,
        speed_limit=1.0,
    )


class OddBench:
    """A master, and the slave on the other end of its bus."""

    def __init__(self, kind: str, slave: OddSlave, bus: can.BusABC, **values: bool) -> None:
        self.slave = slave
        self.sent: list[tuple[int, bytes]] = []
        link = Link(bus, VirtualClock([slave]), self.record)
        parameters = CanBusParameters(rate=RATE)
        if kind == "torque":
            one = axis(NODE, name="handle", vendor_id=0xF00D, product_code=1, **values)
            drive = ServoDrive(link, one, read_dictionary(one.eds, NODE), parameters)
        else:
            one = display(kind)
            drive = CanMotionDrive(link, one, read_dictionary(one.eds, NODE), parameters)
        self.rig = Rig(can_buses(link, [drive], parameters), [drive], parameters)

    def record(self, _time: int, can_id: int, data: bytes | bytearray, is_rx: bool) -> None:
        if not is_rx:
            self.sent.append((can_id, bytes(data)))

    @property
    def targets(self) -> list[int]:
        """The target of every RPDO."""
        return [int.from_bytes(data[2:], "little", signed=True) for can_id, data in self.sent if can_id == 0x205]

    @property
    def controlwords(self) -> list[int]:
        return [int.from_bytes(data[:2], "little") for can_id, data in self.sent if can_id == 0x205]

    def run(self) -> RigError | None:
        """Start, run with 2 N (a display: 1 mm/s) and stop; returns what was raised."""
        try:
            self.rig.start()
            for cycle in range(CYCLES):
                self.rig.sync()
                self.rig.write_torques(
                    [2.0 + 0.01 * (cycle % 50) if self.rig.drives[0].axis.admittance is None else 1e-3]
                )
            self.rig.stop()
        except RigError as error:
            return error
        return None


@contextmanager
def odd_bench(kind: str, **values: bool) -> Iterator[OddBench]:
    channel = private_channel()
    near, far = (can.Bus(interface="virtual", channel=channel, preserve_timestamps=True) for _ in range(2))
    slave = OddSlave(far, is_position_drive=kind != "torque")
    if kind == "sensor":
        slave.sensor = OddSensor()
    try:
        yield OddBench(kind, slave, near, **values)
    finally:
        near.shutdown()
        far.shutdown()


@pytest.mark.parametrize("kind", ["torque", "display", "sensor"])
def test_the_slave_without_an_odd_habit_is_run_and_stopped(kind: str) -> None:
    with odd_bench(kind) as b:
        assert b.run() is None
        assert len(set(b.targets)) > 20
        assert b.slave.state == "disabled"
        assert b.slave.torque == 0


@pytest.mark.slow_for(
    "torque:?left*",
    "torque:?boots*",
    "torque:?loses?each*",
    "torque:?sends?a?TPDO?0.7*",
    "display:?left*",
    "display:?is?pushed*",
    "torque:?shows*",
    "torque:?counts*",
    "torque:?answers*",
    "torque:?sends?an*",
    "torque:?sends?SDO*",
    "torque:?remote*",
    "torque:?is?in*",
    "torque:?toggles*",
    "sensor:?sends?every*",
)
@pytest.mark.parametrize("habit", HABITS, ids=lambda habit: f"{habit.rig}: {habit.what}")
def test_an_odd_habit_is_refused_ended_or_endured_and_named(habit: Habit) -> None:
    with odd_bench(habit.rig) as b:
        habit.take_on(b.slave)
        error = b.run()
        if habit.outcome == "runs":
            assert error is None
            assert b.rig.sync_index == CYCLES - 1
            return
        assert error is not None
        assert habit.words in str(error), error
        assert isinstance(error, StartError) == (habit.outcome == "refused"), error
        if habit.rig == "torque":
            assert b.targets[-1:] in ([], [0])
            if habit.outcome == "refused":
                assert set(b.targets) <= {0}
        assert b.slave.torque == 0


def test_the_table_of_the_page_is_that_of_this_test() -> None:
    page = (REPOSITORY / "docs" / "drives.md").read_text(encoding="utf-8")
    assert page.partition(BEGIN)[2].partition(END)[0] == table()


@pytest.mark.parametrize(("gap", "edges"), [(5 * MILLISECOND, 1), (0, 2)])
def test_a_fault_reset_gives_a_slow_loop_its_level_and_a_second_edge(gap: int, edges: int) -> None:
    with odd_bench("torque", reset_fault=True) as b:
        b.slave.state, b.slave.reset_gap, b.slave.reset_edges = "fault", gap, edges
        assert b.run() is None
