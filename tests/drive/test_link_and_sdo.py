"""Link and SDO against a node that is a script: literal request, literal answers."""

from collections.abc import Iterator

import can
import pytest
from canopen import ObjectDictionary

from canhaptic.drive.can.link import Link
from canhaptic.drive.can.sdo import SdoChannel
from canhaptic.drive.clock import VirtualClock
from canhaptic.errors import LinkError, SdoError
from tests.drive.drive_bench import OUR_EDS, MakeBench, TamperedBus, axis, dictionary, private_channel


class ScriptedNode:
    """A far side that answers known frames with known frames, literally."""

    def __init__(self, bus: can.BusABC, script: dict[str, list[str]]) -> None:
        self.bus, self.script, self.heard = bus, script, list[str]()

    def process(self, now: int) -> None:
        while (message := self.bus.recv(0)) is not None:
            request = f"{message.arbitration_id:03x}#{bytes(message.data).hex()}"
            self.heard.append(request)
            answers = self.script.get(request, [])
            if answers:
                self.send(answers.pop(0))

    def send(self, frames: str) -> None:
        for frame in frames.split():
            can_id, _, data = frame.partition("#")
            self.bus.send(can.Message(arbitration_id=int(can_id, 16), is_extended_id=False, data=bytes.fromhex(data)))

    def next_due(self) -> int:
        return 1 << 62


class Wire:
    """A link, its clock, and a scripted node 5."""

    def __init__(self) -> None:
        channel = private_channel()
        self.buses = [can.Bus(interface="virtual", channel=channel, preserve_timestamps=True) for _ in range(2)]
        self.node = ScriptedNode(self.buses[1], {})
        self.clock = VirtualClock([self.node])
        self.bus = TamperedBus(self.buses[0])
        self.frames: list[tuple[int, int, bytes, bool]] = []
        self.link = Link(
            self.bus,  # type: ignore[arg-type]
            self.clock,
            lambda *frame: self.frames.append((frame[0], frame[1], bytes(frame[2]), frame[3])),
        )

    def sdo(self, read: ObjectDictionary | None = None) -> SdoChannel:
        return SdoChannel(self.link, 5, read or dictionary(axis(eds=OUR_EDS)), "x", timeout=10_000_000)


@pytest.fixture
def wire() -> Iterator[Wire]:
    made = Wire()
    yield made
    for bus in made.buses:
        bus.shutdown()


@pytest.mark.parametrize(
    ("answer", "value"),
    [
        ("4b40600006000000", None),  # for another object: late, never taken
        ("4b64600006000000", 6),
        ("4364600018fcffff", -1000),
        ("42646000e8030000", 1000),  # size not indicated, as Elmo answers
    ],
)
def test_an_upload_is_decoded_by_size_and_sign(wire: Wire, answer: str, value: int | None) -> None:
    wire.node.script = {"605#4064600000000000": [f"585#{answer}"]}
    if value is None:
        with pytest.raises(SdoError, match="no answer"):
            wire.sdo().read(0x6064)
        assert wire.link.statistics.late == 1
    else:
        assert wire.sdo().read(0x6064) == value


def test_a_size_that_is_not_indicated_is_cut_to_the_object(wire: Wire) -> None:
    wire.node.script = {"605#4077600000000000": ["585#427760009cff1234"]}
    assert wire.sdo().read(0x6077) == -100


def test_an_object_that_the_dictionary_lacks_is_read_as_unsigned(wire: Wire) -> None:
    wire.node.script = {"605#4000200100000000": ["585#4f002001ff000000"]}
    assert wire.sdo().read(0x2000, 1) == 255


def test_a_download_is_expedited_with_the_size_of_the_object(wire: Wire) -> None:
    wire.node.script = {"605#2b716000ceff0000": ["585#6071600000000000"]}
    wire.sdo().write(0x6071, 0, -50)
    assert wire.node.heard == ["605#2b716000ceff0000"]


def test_an_abort_names_object_code_and_meaning(wire: Wire) -> None:
    wire.node.script = {"605#2f60600000000000": ["585#8060600030000906"]}
    with pytest.raises(SdoError, match=r"x: write 0x6060:00 .*0x06090030, Value range of parameter exceeded") as caught:
        wire.sdo().write(0x6060, 0, 0)
    assert (caught.value.index, caught.value.subindex, caught.value.code) == (0x6060, 0, 0x06090030)


def test_an_abort_without_meaning_is_reported_all_the_same(wire: Wire) -> None:
    wire.node.script = {"605#4064600000000000": ["585#80646000efbeadde"]}
    with pytest.raises(SdoError, match="0xdeadbeef, unknown abort code"):
        wire.sdo().read(0x6064)


def test_an_unanswered_request_is_repeated_and_then_aborted_with_its_index(wire: Wire) -> None:
    with pytest.raises(SdoError, match=r"0x6064:00.*node 5: no answer \(3 requests, 0.01 s each\)") as caught:
        wire.sdo().read(0x6064)
    assert caught.value.code is None
    assert wire.node.heard[:3] == ["605#4064600000000000"] * 3
    wire.link.drain()
    assert wire.node.heard[3:] == ["605#8064600000000405"]
    assert wire.clock.now() == 30_000_000


def test_the_second_request_is_enough_when_the_first_is_lost(wire: Wire) -> None:
    wire.node.script = {"605#4064600000000000": ["", "585#4364600001000000"]}
    assert wire.sdo().read(0x6064) == 1


def test_an_answer_that_comes_twice_is_not_the_answer_to_the_next_request(wire: Wire) -> None:
    wire.node.script = {
        "605#4064600000000000": ["585#4364600001000000 585#4364600002000000"],
        "605#4077600000000000": ["585#4b77600003000000"],
    }
    sdo = wire.sdo()
    assert (sdo.read(0x6064), sdo.read(0x6077)) == (1, 3)
    assert wire.link.statistics.late == 1


def test_a_value_that_does_not_fit_is_refused_before_it_is_sent(wire: Wire) -> None:
    with pytest.raises(SdoError, match="100000 does not fit 2 bytes"):
        wire.sdo().write(0x6071, 0, 100_000)
    assert wire.node.heard == []


def test_a_short_sdo_frame_is_no_answer(wire: Wire) -> None:
    wire.node.script = {"605#4064600000000000": ["585#436460", "585#4364600007000000"]}
    assert wire.sdo().read(0x6064) == 7
    assert wire.link.statistics.short == 1


# --- the link ---------------------------------------------------------------------------------------------------------


def test_an_exception_in_a_handler_reaches_the_caller(wire: Wire) -> None:
    """canopen logs it and goes on: a control law in a callback dies silently there."""

    def fail(data: bytearray) -> None:
        raise ZeroDivisionError

    wire.link.subscribe(0x185, fail)
    wire.node.send("185#00")
    with pytest.raises(ZeroDivisionError):
        wire.link.drain()


def test_a_frame_that_came_before_the_wait_counts(wire: Wire) -> None:
    """canopen's wait_for_reception loses it."""
    seen: list[bytes] = []
    wire.link.subscribe(0x185, lambda data: seen.append(bytes(data)))
    wire.node.send("185#01")
    wire.link.drain()
    assert wire.link.wait_for(lambda: bool(seen), timeout=0)


def test_waiting_ends_at_its_time(wire: Wire) -> None:
    assert not wire.link.wait_for(lambda: False, timeout=5_000_000)
    assert wire.clock.now() == 5_000_000


def test_our_own_frames_given_back_are_counted_and_recorded_once(wire: Wire) -> None:
    """udp_multicast gives back what it was sent, although documented otherwise."""
    wire.link._echoes = True
    wire.link.send(0x205, b"\x0f\0\0\0")
    wire.node.send("205#0f000000")
    wire.link.drain()
    assert wire.link.statistics.echoed == 1
    assert len(wire.frames) == 1


def test_the_recorder_sees_every_frame_with_its_time_and_direction(wire: Wire) -> None:
    wire.clock.wait_until(7_000_000)
    wire.link.send(0x080, b"")
    wire.node.send("123#0102")
    wire.link.drain()
    assert wire.frames == [(7_000_000, 0x080, b"", False), (7_000_000, 0x123, b"\1\2", True)]
    assert wire.link.statistics.foreign == 1


def test_a_wait_that_is_over_handles_whatever_waits_already(wire: Wire) -> None:
    wire.node.send("705#05 705#04 705#7f")
    states: list[int] = []
    wire.link.subscribe(0x705, lambda data: states.append(data[0]))
    wire.link.pump(wire.clock.now())
    assert states == [5, 4, 0x7F]


def test_a_wait_that_frames_fill_to_its_end_ends_in_an_error_instead_of_a_hang(wire: Wire) -> None:
    message = can.Message(arbitration_id=0x705, is_extended_id=False, data=b"\x05")
    wire.bus.inner.recv = lambda timeout=None: message
    with pytest.raises(LinkError, match="floods the bus"):
        wire.link.pump(wire.clock.now())


def test_a_flood_ends_in_an_error_instead_of_a_hang(wire: Wire) -> None:
    endless = can.Message(arbitration_id=0x123, is_extended_id=False)
    wire.bus.recv = lambda timeout=None: endless
    with pytest.raises(LinkError, match="floods the bus"):
        wire.link.drain()


def test_a_bus_that_cannot_be_read_is_a_link_error(wire: Wire) -> None:
    def fail(timeout: float | None = None) -> can.Message:
        raise can.CanOperationError("interface is down")

    wire.bus.recv = fail
    with pytest.raises(LinkError, match="interface is down"):
        wire.link.drain()


def test_a_frame_that_was_received_does_not_change_when_the_next_one_is_sent(wire: Wire) -> None:
    wire.link.send(0x205, b"\x01\x02")
    wire.link.send(0x205, b"\x03")
    first, second = wire.buses[1].recv(0), wire.buses[1].recv(0)
    assert first is not None
    assert second is not None
    assert [bytes(frame.data) for frame in (first, second)] == [b"\x01\x02", b"\x03"]
    assert [frame.dlc for frame in (first, second)] == [2, 1]
    expected = can.Message(arbitration_id=0x205, is_extended_id=False, channel=first.channel, data=[1, 2])
    assert first.equals(expected, timestamp_delta=None)


@pytest.mark.parametrize(("doubled", "is_doubled"), [(4, False), (12, True), (2, False)])
def test_two_nodes_with_one_id_answer_most_requests_twice(bench: MakeBench, doubled: int, is_doubled: bool) -> None:
    """A bus may double a frame now and then."""
    b = bench()
    sdo = b.rig.drives[0].sdo
    for request in range(16 if doubled > 2 else 2):
        sdo.read(0x6502)
        if request < doubled:
            b.links[0]._handlers[0x585](bytearray.fromhex("4302650000000000"))
    assert sdo.is_doubled is is_doubled
