"""An axis that follows velocities: what its parameters, its dictionary and its frames must be."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import can
import pytest

from canhaptic.canopen.attached_devices import ForceNode
from canhaptic.canopen.eds import read_dictionary
from canhaptic.drive.axis_parameters import AxisParameters, CanBusParameters
from canhaptic.drive.can.link import Link
from canhaptic.drive.can.motion_drive import CanMotionDrive
from canhaptic.drive.can.pdo_map import choose_map
from canhaptic.drive.clock import VirtualClock
from canhaptic.drive.profile.fitness import Verdict, profile_findings
from canhaptic.drive.profile.motion_parameters import ForceChannel, ForceParameters, MotionParameters
from canhaptic.drive.safety.link_policy import StopReason
from canhaptic.errors import LinkError, ParameterError
from canhaptic.scene.build import build
from canhaptic.scene.load import load_scene
from canhaptic.signals import Sample
from tests.drive.drive_bench import REPOSITORY, axis, private_channel

EDS = REPOSITORY / "eds" / "cia402_admittance.eds"
FORCE: dict[str, Any] = {"per_count": 0.01, "range": 300.0, "slew": 5e3, "error": 0.5}


def display(drive_objects: dict[str, int] | None = None, **values: Any) -> AxisParameters:
    """An axis whose sensor is an input of its drive."""
    force = ForceParameters(object="0x2205.1", **FORCE)
    given = {"acceleration_limit": 50.0, "handle_acceleration": 80.0, "force": force} | values
    return axis(
        name="handle", eds=EDS, admittance=MotionParameters(**given), speed_limit=1.0,
        drive_objects=drive_objects or {},
    )  # fmt: skip


def test_a_force_has_one_source() -> None:
    node = ForceNode(cob_id=0x190)
    for source in ({}, {"object": "0x2205.1", "node": node}):
        with pytest.raises(ParameterError, match=r"either object .* or node"):
            ForceParameters(**FORCE, **source)
    assert ForceParameters(**FORCE, node=node).place is None


def test_a_drive_that_brakes_is_given_the_declared_time() -> None:
    with can.Bus(interface="virtual", channel=private_channel()) as bus:
        of = display(stop_time=0.25)
        drive = CanMotionDrive(
            Link(bus, VirtualClock()), of, read_dictionary(EDS, of.node_id), CanBusParameters(rate=1000.0)
        )
        assert drive.stop_time == 250_000_000


@pytest.mark.parametrize(("mode", "near"), [("velocity", 0), ("position", 1024)])
def test_a_start_goes_on_from_a_target_at_rest_alone(mode: str, near: int) -> None:
    """A velocity of 0, or a position that a handle may reach between two readings (1024 counts)."""
    scene = load_scene(REPOSITORY / "configs" / "admittance" / "virtual_mass.yaml", [f"axes.0.admittance.mode={mode}"])
    with build(scene, "free") as experiment:
        [drive] = experiment.rig.drives
        experiment.rig.start()
        rest = drive.position_counts if mode == "position" else 0
        assert all(drive.rests_at(rest + moved) for moved in (-near, 0, near))
        assert not any(drive.rests_at(rest + moved) for moved in (-near - 1, near + 1, 1 << 30, -(1 << 31)))


def test_a_ramp_in_the_drive_below_the_acceleration_limit_is_refused() -> None:
    for ramp, refused in ((4_900_000, True), (5_000_000, False)):  # counts/s^2, of 1e5 counts per metre
        of = display({"0x6083": ramp})
        found = [
            finding.verdict
            for finding in profile_findings(read_dictionary(EDS, of.node_id), of, 1_000_000)
            if "ramps" in finding.item
        ]
        assert found == ([Verdict.REFUSED] if refused else [])


def test_an_impulse_that_wraps_is_a_change_of_one_count() -> None:
    channel = ForceChannel(
        ForceParameters(node=ForceNode(cob_id=0x190, bits=16), sampling="impulse", **FORCE),
        1e-3,
    )
    channel.take(0x7FFF)
    assert channel.take(-0x8000) == pytest.approx(0.01 / 1e-3)


class OnTheBus:
    """A display's image of its drive, and the other end of its bus."""

    def __init__(self, buses: list[can.BusABC], **values: Any) -> None:
        self.far, of = buses[1], display(**values)
        self.clock = VirtualClock()
        self.link = Link(buses[0], self.clock)
        self.drive = CanMotionDrive(self.link, of, read_dictionary(EDS, of.node_id), CanBusParameters(rate=1000.0))
        self.sync_index = -1

    def sample(self, position: int, force: int) -> Sample:
        """The sample of the next SYNC, with these counts in the TPDO."""
        self.drive.expect_tpdos()
        data = (0x0237).to_bytes(2, "little") + position.to_bytes(4, "little", signed=True)
        data += force.to_bytes(2, "little", signed=True)
        self.far.send(can.Message(arbitration_id=0x185, data=data, is_extended_id=False))
        self.link.pump(self.clock.now() + 1)
        self.sync_index += 1
        return self.drive.sample(self.sync_index)


@pytest.fixture
def buses() -> Iterator[list[can.BusABC]]:
    channel = private_channel()
    made = [can.Bus(interface="virtual", channel=channel) for _ in range(2)]
    yield made
    for bus in made:
        bus.shutdown()


def test_a_sample_is_the_position_and_minus_the_force_and_a_jump_is_a_reason_to_stop(buses: list[can.BusABC]) -> None:
    b = OnTheBus(buses)
    assert b.sample(1000, 250)[:3] == (0, pytest.approx(0.01), pytest.approx(-2.5))
    b.sample(1150, 250)  # 1.5 m/s, of at most twice 1 m/s
    b.drive.is_operational = True
    assert b.drive.fault(b.clock.now()) is StopReason.NONE
    b.sample(1400, 250)
    assert b.drive.fault(b.clock.now()) is StopReason.POSITION_JUMP


def test_a_force_is_mapped_with_the_length_of_its_object(tmp_path: Path) -> None:
    text = EDS.read_text(encoding="utf-8")
    start = text.index("[2205sub1]")
    wide = tmp_path / "wide.eds"
    wide.write_text(text[:start] + text[start:].replace("DataType=0x0003", "DataType=0x0004", 1), encoding="utf-8")
    for eds, bits in ((EDS, 16), (wide, 32)):
        of = display().model_copy(update={"eds": eds})
        chosen = choose_map(read_dictionary(eds, of.node_id), of)
        assert [e.bits for tpdo in chosen.tpdos for e in tpdo.entries if e.index == 0x2205] == [bits]


def test_without_a_period_the_interpolation_in_milliseconds_is_what_a_dictionary_must_take(tmp_path: Path) -> None:
    text = EDS.read_text(encoding="utf-8")
    start = text.index("[60C2sub2]")
    narrow = tmp_path / "milliseconds.eds"
    limited = text[start:].replace("LowLimit=-128", "LowLimit=-3", 1).replace("HighLimit=63", "HighLimit=-3", 1)
    narrow.write_text(text[:start] + limited, encoding="utf-8")
    dictionary, of = read_dictionary(narrow, 5), display()
    assert not [each for each in profile_findings(dictionary, of) if "0x60c2:02" in each.item]
    [refused] = [each for each in profile_findings(dictionary, of, 500_000) if "0x60c2:02" in each.item]
    assert refused.verdict is Verdict.REFUSED


def test_a_target_position_that_could_not_be_sent_is_not_added_to(buses: list[can.BusABC], monkeypatch) -> None:
    def refuse(*_: object) -> None:
        raise can.CanOperationError("no buffer space")

    def targets() -> list[int]:
        frames = iter(lambda: buses[1].recv(0.0), None)
        return [int.from_bytes(frame.data[2:6], "little", signed=True) for frame in frames]

    b = OnTheBus(buses, mode="position")
    b.sample(1000, 0)
    b.drive.write(7)
    with monkeypatch.context() as patch:
        patch.setattr(buses[0], "send", refuse)
        with pytest.raises(LinkError, match="no buffer space"):
            b.drive.write(7)
    b.drive.write(7)
    assert targets() == [7, 14]  # counts


def test_while_samples_are_missing_the_velocity_is_held_and_then_falls_to_zero(buses: list[can.BusABC]) -> None:
    b = OnTheBus(buses, acceleration_limit=4e4)
    b.sample(0, 0)
    commands = [b.drive.command_per_mille(0.5)]
    for _ in range(25):
        b.drive.expect_tpdos()
        b.drive.refuse_tpdos()
        b.sync_index += 1
        assert not b.drive.sample(b.sync_index).fresh
        commands.append(b.drive.command_per_mille(0.5))
    assert commands[0] == 50_000  # counts per second
    assert commands[1] == commands[0]  # one may be lost
    assert commands == sorted(commands, reverse=True)
    assert set(commands) == {50_000, 0}
    assert commands[-1] == 0
