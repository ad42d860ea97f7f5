"""Another master on the bus: a frame that this master alone may send and did not send stops the rig."""

import can
import pytest

from canhaptic.drive.safety.link_policy import StopReason
from canhaptic.errors import SecondMasterError
from canhaptic.sim.drive.profile.state_machine import DriveState
from tests.drive.drive_bench import Bench, MakeBench, axis, started

FRAMES = {
    "SYNC": (0x080, b""),
    "NMT": (0x000, b"\x01\x22"),  # to a node of somebody else
    "RPDO of axis5": (0x205, b"\x0f\x00\x00\x00"),
    "SDO request to axis5": (0x605, bytes.fromhex("4041600000000000")),
    "heartbeat of the master": (0x77E, b"\x05"),
}


def let_in(b: Bench, can_id: int, data: bytes, **values: bool) -> None:
    """A frame that reaches this master alone, from a node that it does not know."""
    b.buses[1].send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False, **values))


def is_without_torque(b: Bench) -> bool:
    return b.torques_sent()[-1] == 0 and b.drives[0].torque == 0.0


@pytest.mark.parametrize("name", FRAMES)
def test_a_frame_of_the_master_from_elsewhere_stops_the_rig_at_once(bench: MakeBench, name: str) -> None:
    b = started(bench)
    b.run(10, torque=1.0)
    can_id, data = FRAMES[name]
    let_in(b, can_id, data)
    with pytest.raises(SecondMasterError, match=rf"{name} \(COB-ID {can_id:#05x}\).*another master.*SECOND_MASTER"):
        b.run(1, torque=1.0)
    assert b.rig.stop_reason is StopReason.SECOND_MASTER
    assert is_without_torque(b)
    assert b.drives[0].state is not DriveState.OPERATION_ENABLED


@pytest.mark.parametrize("name", FRAMES)
def test_a_second_master_during_the_start_is_named(bench: MakeBench, name: str) -> None:
    b = bench()
    let_in(b, *FRAMES[name])
    with pytest.raises(SecondMasterError, match=name):
        b.rig.start()
    assert set(b.torques_sent()) <= {0}
    assert b.drives[0].state is not DriveState.OPERATION_ENABLED


def test_the_next_start_begins_anew(bench: MakeBench) -> None:
    b = started(bench)
    let_in(b, 0x080, b"")
    with pytest.raises(SecondMasterError):
        b.run(2)
    b.rig.start()
    b.run(20)
    assert b.rig.is_running


@pytest.mark.parametrize(
    ("can_id", "data"), [(0x206, b"\x0f\0\0\0"), (0x606, bytes(8)), (0x706, b"\x05"), (0x100, b"")]
)
def test_frames_for_and_of_other_nodes_stop_nothing(bench: MakeBench, can_id: int, data: bytes) -> None:
    b = started(bench)
    let_in(b, can_id, data)
    b.run(10)
    assert b.rig.is_running


@pytest.mark.parametrize("kind", ["is_remote_frame", "is_error_frame"])
def test_remote_and_error_frames_prove_nothing(bench: MakeBench, kind: str) -> None:
    b = started(bench)
    let_in(b, 0x080, b"", **{kind: True})
    b.run(10)
    assert b.rig.is_running


class Echo:
    """An interface that gives back every frame that it was sent, before it hands over others."""

    def __init__(self, b: Bench) -> None:
        self.frames: list[can.Message] = []
        inner, b.tampered.on_send = b.tampered.inner, self.sent
        receive = inner.recv

        def recv(timeout: float | None = None) -> can.Message | None:
            return self.frames.pop(0) if self.frames else receive(timeout)

        inner.recv = recv
        b.links[0]._echoes = True

    def sent(self, message: can.Message) -> can.Message:
        self.frames.append(
            can.Message(arbitration_id=message.arbitration_id, data=bytes(message.data), is_extended_id=False)
        )
        return message


def test_own_frames_that_an_interface_gives_back_stop_nothing(bench: MakeBench) -> None:
    b = bench([axis()])
    Echo(b)
    b.rig.start()
    b.run(200, torque=1.0)
    assert b.rig.is_running
    assert b.rig.link_statistics()["echoed"] > 400


def test_one_frame_more_than_was_sent_is_no_echo(bench: MakeBench) -> None:
    b = bench()
    Echo(b)
    b.rig.start()
    b.run(20, torque=1.0)
    let_in(b, 0x080, b"")
    with pytest.raises(SecondMasterError, match="SYNC"):
        b.run(2, torque=1.0)
    assert is_without_torque(b)


@pytest.mark.parametrize(("interface", "is_told"), [("udp_multicast", True), ("socketcan", False)])
def test_two_scenes_on_one_port_are_told_why_they_hear_each_other(bench: MakeBench, monkeypatch, interface, is_told):
    b = bench()
    [on] = b.rig.buses
    monkeypatch.setattr(on, "_bus", b.rig.bus.model_copy(update={"interface": interface}))
    let_in(b, *FRAMES["SYNC"])
    with pytest.raises(SecondMasterError) as raised:
        b.rig.start()
    assert ("give each its own bus.options: {port: ...}" in str(raised.value)) is is_told
