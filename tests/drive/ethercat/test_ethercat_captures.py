"""Frames and EEPROMs recorded from real EtherCAT drives; read where CANHAPTIC_CAPTURES names their folder."""

import gzip
import os
import struct
from collections.abc import Iterator
from pathlib import Path

import pytest

from canhaptic.canopen.sii import check_sum
from canhaptic.drive.ethercat.datagrams import Datagram, answers_of, frame_of
from canhaptic.drive.ethercat.segment import Identity
from tests.sim_drive.ethercat_line import Line


@pytest.fixture
def captures() -> Path:
    folder = os.environ.get("CANHAPTIC_CAPTURES")
    if folder is None or not Path(folder).is_dir():
        pytest.skip(f"no captures: CANHAPTIC_CAPTURES is {folder!r}, expected their folder")
    return Path(folder)


def frames_of(path: Path) -> Iterator[bytes]:
    raw, at = gzip.decompress(path.read_bytes()), 0
    while at + 12 <= len(raw):
        kind, size = struct.unpack_from("<II", raw, at)
        if kind == 6:
            (length,) = struct.unpack_from("<I", raw, at + 20)
            frame = raw[at + 28 : at + 28 + length]
            if frame[12:14] == b"\x88\xa4":
                yield frame
        at += size


def datagrams_of(frame: bytes) -> list[Datagram]:
    at, more, found = 16, True, []
    while more:
        command, _, address, offset, length, _ = struct.unpack_from("<BBHHHH", frame, at)
        stop, more = at + 10 + (length & 0x7FF), bool(length & 0x8000)
        found.append(Datagram(command, address, offset, frame[at + 10 : stop], *struct.unpack_from("<H", frame, stop)))
        at = stop + 2
    return found


def with_one_index(frame: bytes) -> bytes:
    """Return a frame whose datagrams carry the index of the first: some masters number each of them."""
    changed, at, more = bytearray(frame), 16, True
    while more:
        length = frame[at + 6] | frame[at + 7] << 8
        changed[at + 1], at, more = frame[17], at + 12 + (length & 0x7FF), bool(length & 0x8000)
    return bytes(changed)


@pytest.mark.parametrize("name", ["kollmorgen_akd_soem_slaveinfo", "beckhoff_el28xx_dc_op_5ms"])
def test_frames_of_other_masters_are_made_and_read_byte_for_byte(captures: Path, name: str) -> None:
    count = 0
    for frame in frames_of(captures / "pcap" / f"{name}.pcapng.gz"):
        frame = with_one_index(frame)
        sent, index = datagrams_of(frame), frame[17]
        assert answers_of(frame, index, sent) == sent
        made, end = bytearray(frame_of(index, sent)), 16
        for of in sent:
            end += 12 + len(of.data)
            struct.pack_into("<H", made, end - 2, of.counter)
        assert made[12:end] == frame[12:end]
        count += 1
    assert count > 500


def test_the_eeprom_of_a_real_drive_is_read_word_by_word(captures: Path) -> None:
    content = (captures / "sii" / "kollmorgen_akd.bin").read_bytes()
    assert check_sum(content[:14]) == content[14]
    line = Line()
    line.drives[0].esc.eeprom = content
    assert list(line.master.scan()) == [Identity(0x6A, 0x00414B44, *struct.unpack_from("<II", content, 0x18))]
    assert [tuple(of) for of in line.master._drives[0].managers] == [
        (0x1800, 1024, 0x26), (0x1C00, 1024, 0x22), (0x1100, 0, 0x24), (0x1140, 0, 0x20),
    ]  # fmt: skip
