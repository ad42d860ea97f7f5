"""Captures of Ethernet are read and decoded, of whichever program. The error for a damaged one names it."""

import gzip
import os
import struct
from pathlib import Path

import pytest

from canhaptic.cli.main import main
from canhaptic.drive.ethercat.segment import al_remedy, al_text
from canhaptic.errors import LogFormatError
from canhaptic.logs.ethercat_frames import (
    FrameDatagram,
    command_name,
    datagram_text,
    datagrams_of,
    mail_text,
    read_capture,
)

# BRD of AL status: SAFE-OP with an error, code 0x001D, from one drive
FRAME = bytes.fromhex(
    "ffffffffffff 101010101010 88a4 1210 07 05 0000 3001 0600 0000 140000001d00 0100".replace(" ", "")
)
FRAME = FRAME.ljust(60, b"\0")
AT = (1_700_000_000, 123_456_000)


def pcap(order: str, magic: int, unit: int) -> bytes:
    head = struct.pack(f"{order}IHHiIII", magic, 2, 4, 0, 0, 65535, 1)
    return head + struct.pack(f"{order}IIII", AT[0], AT[1] // unit, len(FRAME), len(FRAME)) + FRAME


def pcapng(order: str, resolution: bytes = b"", per_second: int = 10**6) -> bytes:
    def block(kind: int, body: bytes) -> bytes:
        size = len(body) + 12
        return struct.pack(f"{order}II", kind, size) + body + struct.pack(f"{order}I", size)

    time = AT[0] * per_second + AT[1] * per_second // 10**9
    packet = struct.pack(f"{order}IIIII", 0, time >> 32, time & 0xFFFFFFFF, len(FRAME), len(FRAME)) + FRAME
    return (
        block(0x0A0D0D0A, struct.pack(f"{order}IHHq", 0x1A2B3C4D, 1, 0, -1))
        + block(1, struct.pack(f"{order}HHI", 1, 0, 0) + resolution)
        + block(6, packet)
    )


@pytest.mark.parametrize(
    "content",
    [
        pcap("<", 0xA1B2C3D4, 1000), pcap(">", 0xA1B2C3D4, 1000), pcap("<", 0xA1B23C4D, 1), pcapng("<"), pcapng(">"),
        pcapng("<", struct.pack("<HHB3xHH", 9, 1, 9, 0, 0), 10**9), gzip.compress(pcapng("<")),
    ],
    ids=["us", "us, big", "ns", "ng", "ng, big", "ng, ns", "gz"],
)  # fmt: skip
def test_every_kind_of_capture_gives_the_same_frames(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "line.pcap"
    path.write_bytes(content)
    assert read_capture(path) == [(AT[0] * 10**9 + AT[1], FRAME)]


@pytest.mark.parametrize(
    "content",
    [b"", b"hello", pcap("<", 0xA1B2C3D4, 1000)[:-1], pcapng("<")[:-9], gzip.compress(pcapng("<"))[:-12]],
    ids=["empty", "text", "cut", "cut ng", "cut gz"],
)
def test_what_is_no_whole_capture_is_refused_by_name(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "line.pcap"
    path.write_bytes(content)
    with pytest.raises(LogFormatError, match=r"line\.pcap"):
        read_capture(path)


def test_a_refusal_is_told_in_words(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "line.pcapng"
    path.write_bytes(pcapng("<"))
    assert main(["inspect", str(path)]) == 0
    assert "BRD  0x0000 0x0130 wkc 1 is in SAFE-OP, refused or left: AL code 0x001d invalid output configuration" in (
        capsys.readouterr().out
    )


@pytest.mark.parametrize(
    ("mail", "text"),
    [
        ("0a00 0000 00 13 0020 40 1010 01 00000000", "reads 0x1010:01"),
        ("0a00 0000 00 13 0030 4b 121c 01 00160000", "is 0x1c12:01 = 0016"),
        ("0a00 0000 00 13 0020 2f 6060 00 0a000000", "writes 0x6060:00 = 0a"),
        ("0a00 0000 00 13 0030 60 6060 00 00000000", "confirms 0x6060:00"),
        ("0a00 0000 00 13 0020 80 ff5f 00 00000206", "abort of 0x5fff:00: "),
        ("0a00 0000 00 13 0010 0573 11 0000000000", "emergency 0x7305: "),
        ("0a00 0000 00 12 0010 0573 11 0000000000", ""),
    ],
)
def test_a_mail_is_told_in_words(mail: str, text: str) -> None:
    assert mail_text(bytes.fromhex(mail.replace(" ", ""))).startswith(text)
    assert datagram_text(FrameDatagram(4, 0x1001, 0x1080, bytes.fromhex(mail.replace(" ", "")), 1)).startswith(text)


def test_no_frame_makes_the_decoder_fail() -> None:
    for stop in range(len(FRAME)):
        for of in datagrams_of(FRAME[:stop]) or ():
            datagram_text(of)
    assert (command_name(12), command_name(15)) == ("LRW", "unknown")


@pytest.mark.parametrize(
    ("name", "count"), [("kollmorgen_akd_soem_slaveinfo", 6759), ("kollmorgen_akd_twincat_scan", 18_793)]
)
@pytest.mark.slow
def test_every_frame_of_a_real_drive_decodes_with_no_unknown_command(name: str, count: int) -> None:
    folder = os.environ.get("CANHAPTIC_CAPTURES")
    if folder is None or not Path(folder).is_dir():
        pytest.skip(f"no captures: CANHAPTIC_CAPTURES is {folder!r}, expected their folder")
    frames = read_capture(Path(folder) / "pcap" / f"{name}.pcapng.gz")
    found = [of for _, content in frames if (of := datagrams_of(content)) is not None]
    assert len(found) == count
    assert all(command_name(of.command) != "unknown" for frame in found for of in frame)


@pytest.mark.slow
def test_the_refusal_of_a_real_drive_is_in_our_words() -> None:
    folder = os.environ.get("CANHAPTIC_CAPTURES")
    if folder is None or not Path(folder).is_dir():
        pytest.skip(f"no captures: CANHAPTIC_CAPTURES is {folder!r}, expected their folder")
    frames = read_capture(Path(folder) / "pcap" / "kollmorgen_akd_soem_slaveinfo.pcapng.gz")
    texts = [datagram_text(of, al_text) for _, content in frames for of in datagrams_of(content) or ()]
    [said] = {text for text in texts if "0x001d" in text}
    assert said.endswith("the length of the outputs is not what 0x1C12 assigns")
    assert "assign one RxPDO" in al_remedy(0x1D)
