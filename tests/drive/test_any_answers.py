"""Any answer of a node to an SDO, at any time: a value or SdoError, in bounded time, and never anything else."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

import can
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canhaptic.drive.can.link import Link
from canhaptic.drive.can.sdo import SdoChannel
from canhaptic.drive.clock import VirtualClock
from canhaptic.errors import SdoError
from tests.drawn import examples
from tests.drive.drive_bench import OUR_EDS, axis, dictionary, private_channel

ANY = st.binary(max_size=8)
LIKELY = st.builds(  # right enough to lead further in
    lambda first, rest: bytes([first]) + rest,
    st.sampled_from([0x40, 0x41, 0x42, 0x43, 0x4B, 0x4F, 0x60, 0x00, 0x10, 0x01, 0x11, 0x20, 0x30, 0x80, 0xC0, 0xA1]),
    st.sampled_from([bytes.fromhex("08100000000000"), bytes.fromhex("081000ffffffff"), bytes.fromhex("08100003000000")])
    | st.binary(min_size=7, max_size=7),
)


class Node:
    """Answers each request with the next frames of a list, or by a rule."""

    def __init__(self, bus: can.BusABC, answer: Callable[[bytes], list[bytes]]) -> None:
        self.bus, self.answer = bus, answer
        self.requests = 0

    def process(self, now: int) -> None:
        while (message := self.bus.recv(0)) is not None:
            self.requests += 1
            for data in self.answer(bytes(message.data)):
                self.bus.send(can.Message(arbitration_id=0x585, is_extended_id=False, data=data))

    def next_due(self) -> int:
        return 1 << 62


@contextmanager
def channel_to(answer: Callable[[bytes], list[bytes]]) -> Iterator[tuple[SdoChannel, Node]]:
    channel = private_channel()
    with (
        can.Bus(interface="virtual", channel=channel, preserve_timestamps=True) as near,
        can.Bus(interface="virtual", channel=channel, preserve_timestamps=True) as far,
    ):
        node = Node(far, answer)
        link = Link(near, VirtualClock([node]))
        yield SdoChannel(link, 5, dictionary(axis(eds=OUR_EDS)), "x", timeout=10_000_000), node


@settings(max_examples=examples(200))
@given(st.lists(st.lists(ANY | LIKELY, max_size=3), max_size=12), st.booleans(), st.integers(1, 12))
def test_any_answers_give_a_value_or_an_sdo_error(answers: list[list[bytes]], reads: bool, size: int) -> None:
    rest = iter(answers)
    with channel_to(lambda _: next(rest, [])) as (sdo, _), suppress(SdoError):
        if reads:
            assert isinstance(sdo.read(0x1008), int)
        else:
            sdo.write(0x1008, 0, 1, size=size)


@pytest.mark.slow
def test_an_upload_without_end_is_given_up() -> None:
    toggles = iter(range(1 << 30))

    def answer(request: bytes) -> list[bytes]:
        if request[0] == 0x40:
            return [bytes.fromhex("4008100000000000")]
        return [bytes([0x10 * (next(toggles) % 2)]) + bytes(7)]

    with channel_to(answer) as (sdo, node):
        with pytest.raises(SdoError, match="more than 65536 bytes"):
            sdo.read(0x1008)
        assert node.requests < 20_000


def test_answers_that_are_never_for_us_end_in_time() -> None:
    with channel_to(lambda _: [bytes.fromhex("4b41600000000000")] * 3) as (sdo, node):
        with pytest.raises(SdoError, match="no answer"):
            sdo.read(0x1008)
        assert node.requests == 3
