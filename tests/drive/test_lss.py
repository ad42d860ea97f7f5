"""One node is given its node ID by LSS, against slaves written by hand from CiA 305."""

import threading
from collections.abc import Iterator
from pathlib import Path

import can
import pytest

from canhaptic.cli.main import main
from canhaptic.drive.can.link import Link
from canhaptic.drive.can.lss import give_node_id
from canhaptic.drive.clock import VirtualClock, WallClock
from canhaptic.errors import LinkError
from tests.drive.drive_bench import REPOSITORY, private_channel
from tests.drive.lss_slave import NO_NODE_ID, LssSlave

FIRST, SECOND = (0xF00D, 1, 2, 0x1001), (0xF00D, 1, 2, 0x1002)


class LssBench:
    """A master, and slaves on the other end of its bus."""

    def __init__(self, *slaves: tuple[tuple[int, int, int, int], int]) -> None:
        channel = private_channel()
        self.buses = [can.Bus(interface="virtual", channel=channel) for _ in range(len(slaves) + 1)]
        pairs = zip(self.buses[1:], slaves, strict=True)
        self.slaves = [LssSlave(bus, identity, node_id) for bus, (identity, node_id) in pairs]
        self.sent: list[tuple[int, bytes]] = []
        self.link = Link(self.buses[0], VirtualClock(self.slaves), self.record)
        self.questions: list[str] = []
        self.told: list[str] = []

    def record(self, _time: int, can_id: int, data: bytes | bytearray, is_rx: bool) -> None:
        if not is_rx:
            self.sent.append((can_id, bytes(data)))

    def give(self, node_id: int, identity: tuple[int, ...] | None = None, no: str = "nothing") -> bool:
        def confirm(question: str) -> bool:
            self.questions.append(question)
            return no not in question

        return give_node_id(self.link, node_id, identity, confirm, self.told.append)


@pytest.fixture
def make() -> Iterator[type[LssBench]]:
    made: list[LssBench] = []

    class Kept(LssBench):
        def __init__(self, *slaves: tuple[tuple[int, int, int, int], int]) -> None:
            super().__init__(*slaves)
            made.append(self)

    yield Kept
    for bench in made:
        for bus in bench.buses:
            bus.shutdown()


def test_the_only_node_is_given_a_node_id_which_it_stores_and_boots_with(make: type[LssBench]) -> None:
    b = make((FIRST, NO_NODE_ID))
    assert b.give(5)
    assert (b.slaves[0].node_id, b.slaves[0].stored) == (5, 5)
    assert not b.slaves[0].is_configuring
    assert "0x0000f00d, 0x00000001, 0x00000002, 0x00001001; node ID none" in b.told[0]
    assert "node 5 has booted" in b.told[1]


def test_the_frames_are_those_of_cia_305(make: type[LssBench]) -> None:
    b = make((FIRST, 9))
    b.give(5, FIRST)
    frames = [f"{can_id:03x} {data.hex(' ')}" for can_id, data in b.sent]
    assert frames == [
        "000 02 00",
        "7e5 04 00 00 00 00 00 00 00",
        "7e5 40 0d f0 00 00 00 00 00",
        "7e5 41 01 00 00 00 00 00 00",
        "7e5 42 02 00 00 00 00 00 00",
        "7e5 43 01 10 00 00 00 00 00",
        "7e5 5e 00 00 00 00 00 00 00",
        *(f"7e5 {service:02x} 00 00 00 00 00 00 00" for service in (0x5A, 0x5B, 0x5C, 0x5D)),
        "7e5 11 05 00 00 00 00 00 00",
        "7e5 17 00 00 00 00 00 00 00",
        "7e5 04 00 00 00 00 00 00 00",
        "000 82 00",
    ]


def test_one_of_several_is_named_by_all_four_numbers(make: type[LssBench]) -> None:
    b = make((FIRST, NO_NODE_ID), (SECOND, NO_NODE_ID))
    assert b.give(6, SECOND)
    assert [slave.node_id for slave in b.slaves] == [NO_NODE_ID, 6]


def test_several_nodes_without_a_name_are_refused_and_none_is_changed(make: type[LssBench]) -> None:
    b = make((FIRST, NO_NODE_ID), (SECOND, NO_NODE_ID))
    with pytest.raises(LinkError, match="2 nodes answer, expected one; leave one alone on the bus"):
        b.give(6)
    b.link.pump(b.link.clock.now() + 1)
    assert [slave.pending for slave in b.slaves] == [NO_NODE_ID, NO_NODE_ID]
    assert not any(slave.is_configuring for slave in b.slaves)


@pytest.mark.parametrize("part", range(4))
def test_three_numbers_that_fit_select_nothing(make: type[LssBench], part: int) -> None:
    b = make((FIRST, NO_NODE_ID))
    wrong = tuple(number + (place == part) for place, number in enumerate(FIRST))
    with pytest.raises(LinkError, match="no node has the identity"):
        b.give(6, wrong)
    assert b.slaves[0].pending == NO_NODE_ID


@pytest.mark.parametrize(("service", "code", "words"), [(0x11, 1, "out of its range"), (0x17, 1, "cannot store")])
def test_a_refusal_of_the_node_is_named(make: type[LssBench], service: int, code: int, words: str) -> None:
    b = make((FIRST, NO_NODE_ID))
    b.slaves[0].refuses = {service: code}
    with pytest.raises(LinkError, match=words):
        b.give(6)
    assert b.slaves[0].stored == NO_NODE_ID


def test_nothing_is_sent_changed_or_stored_without_consent(make: type[LssBench]) -> None:
    b = make((FIRST, NO_NODE_ID))
    assert not b.give(6, no="Go on?")
    assert b.sent == []
    assert not b.give(6, no="give this node")
    assert b.slaves[0].pending == NO_NODE_ID
    assert b.give(6, no="store")
    assert (b.slaves[0].node_id, b.slaves[0].stored) == (6, NO_NODE_ID)


def test_the_command_gives_a_node_its_id(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    channel, is_over = private_channel(), threading.Event()
    scene = ["configs/demo.yaml", "--set", f"bus.channel={channel}"]
    with can.Bus(interface="virtual", channel=channel) as bus:
        slave, clock = LssSlave(bus, FIRST), WallClock()

        def serve() -> None:
            while not is_over.wait(0.002):
                slave.process(clock.now())

        thread = threading.Thread(target=serve)
        thread.start()
        try:
            scene[0] = str(REPOSITORY / scene[0])
            assert main(["commission", *scene, "--node-id", "7", "--identity", *map(hex, FIRST), "--yes"]) == 0
            assert main(["commission", *scene, "--node-id", "128", "--yes"]) == 2
        finally:
            is_over.set()
            thread.join()
    assert slave.stored == 7
    assert "node 7 has booted" in capsys.readouterr().err


def test_all_four_bytes_of_a_number_name_a_node(make: type[LssBench]) -> None:
    identity = (0x8000_009A, 0x8765_4321, 0xFFFF_0001, 0x9123_4567)
    b = make((identity, NO_NODE_ID))
    assert b.give(6, identity)
    assert "0x8000009a, 0x87654321, 0xffff0001, 0x91234567" in b.told[0]
