"""The thin master sends the bytes of the standard, reads and writes objects of any length, and survives lost frames."""

import random

import pytest

from canhaptic.drive.ethercat.datagrams import Command, Datagram, answers_of, frame_of
from canhaptic.drive.ethercat.segment import AlError, AlState, Identity
from canhaptic.errors import LinkError, SdoError
from tests.sim_drive.ethercat_line import Line, make_drive


def test_a_frame_is_the_bytes_of_the_standard() -> None:
    sent = (Datagram(Command.SPREAD, 0x1001, 0x0910, bytes(8)), Datagram(Command.READ_ALL, 0, 0x0130, bytes(2)))
    frame = frame_of(7, sent)
    assert frame.hex(" ") == (
        "ff ff ff ff ff ff 10 10 10 10 10 10 88 a4 22 10 "
        "0e 07 01 10 10 09 08 80 00 00 00 00 00 00 00 00 00 00 00 00 "
        "07 07 00 00 30 01 02 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00"
    )
    found = answers_of(frame, 7, sent)
    assert found is not None
    assert [of.counter for of in found] == [0, 0]
    assert answers_of(frame, 8, sent) is None  # the answer to another frame
    assert answers_of(frame[:40], 7, sent) is None


def prepared(line: Line) -> Line:
    line.master.scan()
    line.master.request(0, AlState.PRE_OP)
    return line


def test_drives_are_found_with_their_identities() -> None:
    line = Line(make_drive(), make_drive(objects={"0x1018.4": 9}))
    assert list(line.master.scan()) == [Identity(0xABC, 0x1234, 1, 7), Identity(0xABC, 0x1234, 1, 9)]
    assert list(line.master.scan()) == [Identity(0xABC, 0x1234, 1, 7), Identity(0xABC, 0x1234, 1, 9)]


def test_objects_are_read_expedited_and_in_segments() -> None:
    line = prepared(Line())
    assert line.master.read(0, 0x1018, 1) == b"\xbc\n\0\0"
    assert line.master.read(0, 0x6060, 0) == b"\0"
    name = line.master.read(0, 0x1008, 0)
    assert name.startswith(b"canhaptic EtherCAT servo") and len(name) > 180  # noqa: PT018


def test_objects_are_written_and_refusals_say_why() -> None:
    line = prepared(Line())
    line.master.write(0, 0x6072, 0, b"\xf4\x01")
    assert line.master.read(0, 0x6072, 0) == b"\xf4\x01"
    with pytest.raises(SdoError, match=r"drive 0: object 0x6041:00: attempt to write a read-only object"):
        line.master.write(0, 0x6041, 0, b"\0\0")
    with pytest.raises(SdoError, match=r"0x06020000"):
        line.master.read(0, 0x7000, 0)
    with pytest.raises(SdoError, match=r"0x06070012"):
        line.master.write(0, 0x6072, 0, bytes(300))  # in segments, and too long


def test_a_refused_state_names_the_code_and_is_acknowledged() -> None:
    line = Line()
    line.master.scan()
    with pytest.raises(AlError, match="code 0x0011"):
        line.master.request(0, AlState.OP)
    line.master.request(0, AlState.PRE_OP)


def test_no_drive_is_an_error_that_says_so() -> None:
    line = Line()
    line.cable._reach = 0
    with pytest.raises(LinkError, match="check cable and power"):
        line.master.scan()


@pytest.mark.parametrize("seed", range(5))
def test_frames_that_are_lost_are_sent_again_and_nothing_is_done_twice(seed: int) -> None:
    line = prepared(Line())
    dice, carry = random.Random(seed), line.cable.exchange

    def lossy(frame: bytes, deadline: int) -> bytes | None:
        if dice.random() < 0.15:
            return None
        answer = carry(frame, deadline)
        return None if dice.random() < 0.15 else answer

    line.master._exchange = lossy
    for value in range(20):
        line.master.write(0, 0x6072, 0, bytes((value, 1)))
        assert line.master.read(0, 0x6072, 0) == bytes((value, 1))
        assert len(line.master.read(0, 0x1008, 0)) > 180
