import os
import signal
from itertools import pairwise
from pathlib import Path

import pytest

from canhaptic.errors import LogFormatError, LogWriteError, ParameterError
from canhaptic.logs.bus_reader import read_bus_log
from canhaptic.logs.bus_sink import _BLOCK, FRAME_RING, BusSink, _aside_files
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.logs.ring import SharedArea, allocate, size_of
from canhaptic.logs.writer_process import BusLogWriter

FRAMES = [
    (0, 0x000, b"\x80\x00", False),
    (1_000_999, 0x080, b"", False),
    (1_001_000, 0x181, bytes.fromhex("3712A0860100E803"), True),
    (1_700_000_000_123_456_789, 0x18FF1234, b"\x01", True),
]
TEXT = (
    b"(0000000000.000000) can0 000#8000 T\n"
    b"(0000000000.001000) can0 080# T\n"
    b"(0000000000.001001) can0 181#3712A0860100E803 R\n"
    b"(1700000000.123456) can0 18FF1234#01 R\n"
)


def write(path: Path, frames: list[tuple[int, int, bytes, bool]]) -> None:
    log = BusLogWriter(path, "can0", pace="free")
    for frame in frames:
        log(*frame)
    log.close()


@pytest.mark.slow
def test_a_full_ring_at_real_pace_drops_and_counts_without_waiting(tmp_path: Path) -> None:
    log = BusLogWriter(tmp_path / "full.log", "can0", pace="real")
    os.kill(log.pid, signal.SIGSTOP)  # the disk stalls
    try:
        room = FRAME_RING.capacity
        for number in range(room + 3):
            log(number, 0x181, b"12345678", True)
        assert log.dropped == 3
    finally:
        os.kill(log.pid, signal.SIGCONT)
        log.close()


def test_frames_are_candump_lines_byte_for_byte(tmp_path: Path) -> None:
    write(tmp_path / "a.log", FRAMES)
    assert (tmp_path / "a.log").read_bytes() == TEXT


@pytest.mark.slow
def test_more_frames_than_the_ring_holds_all_arrive_in_order_at_free_pace(tmp_path: Path) -> None:
    frames = [(k * 1000, 0x181, k.to_bytes(8, "little"), True) for k in range(150_000)]
    write(tmp_path / "a.log", frames)
    lines = (tmp_path / "a.log").read_bytes().splitlines()
    assert len(lines) == len(frames)
    assert all(line.endswith(f"181#{k.to_bytes(8, 'little').hex().upper()} R".encode()) for k, line in enumerate(lines))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["run.log", "run", "run.2.log", "run[1].log"])
def test_a_series_of_files_is_bounded_in_number_and_size_and_keeps_the_newest(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    log = BusLogWriter(path, "can0", pace="free", file_size=300_000, files=3)
    for k in range(100_000):
        log(k * 1000, 0x181, k.to_bytes(8, "little"), True)
    log.close()
    files = [*_aside_files(path), path]
    assert len(files) == 3
    assert len(list(tmp_path.iterdir())) == 3
    block = _BLOCK * len(b"(0000000000.000000) can0 181#0000000000000000 R\n")  # what may still go into a full one
    assert max(file.stat().st_size for file in files) < 300_000 + block
    lines = b"".join(file.read_bytes() for file in files).splitlines()
    kept = range(100_000 - len(lines), 100_000)
    assert all(
        f"181#{k.to_bytes(8, 'little').hex().upper()}".encode() in line for k, line in zip(kept, lines, strict=True)
    )


@pytest.mark.slow
def test_a_killed_writer_is_replaced_and_no_line_is_lost_doubled_or_torn(tmp_path: Path) -> None:
    path = tmp_path / "a.log"
    log = BusLogWriter(path, "can0", pace="free")
    for k in range(120_000):
        if k in {20_000, 90_000}:
            os.kill(log.pid, 9)
        log(k * 1000, 0x181, k.to_bytes(8, "little"), True)
    log.close()
    lines = path.read_bytes().splitlines()
    assert len(lines) == 120_000
    assert all(f"181#{k.to_bytes(8, 'little').hex().upper()} ".encode() in line for k, line in enumerate(lines))


def test_a_missing_folder_is_one_error(tmp_path: Path) -> None:
    with pytest.raises(LogWriteError, match="No such file"):
        BusLogWriter(tmp_path / "no" / "a.log", "can0")


def test_a_channel_with_a_space_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match="channel"):
        BusLogWriter(tmp_path / "a.log", "can 0")


@pytest.mark.slow_for("trc", "asc")
@pytest.mark.parametrize("suffix", ["log", "blf", "trc", "asc"])
def test_each_frame_names_its_bus_in_every_format(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"run.{suffix}"
    log = BusLogWriter(path, ["left", "right"], pace="free")
    on_right = log.on(1)
    log(1_000_000, 0x181, b"\1", True)
    on_right(2_000_000, 0x181, b"\2", True)
    on_right(3_000_000, 0x201, b"\3", False)
    log(4_000_000, 0x201, b"\4", False)
    log.close()
    names = ("left", "right") if suffix == "log" else ("0", "1")
    assert [(frame.channel, frame.data[0]) for frame in read_bus_log(path)] == [
        (names[0], 1),
        (names[1], 2),
        (names[1], 3),
        (names[0], 4),
    ]


@pytest.mark.slow
@pytest.mark.parametrize("suffix", ["log", "blf", "asc"])
def test_absolute_time_survives_in_the_formats_that_have_it(tmp_path: Path, suffix: str) -> None:
    """ASC has it in its head alone, to the millisecond, and python-can's default reader drops that."""
    path = tmp_path / f"run.{suffix}"
    write(path, [(1_700_000_000_123_000_000 + k * 1_000_000, 0x181, b"", True) for k in range(3)])
    stamps = [frame.timestamp_ns for frame in read_bus_log(path)]
    assert all(abs(stamp - 1_700_000_000_123_000_000 - k * 1_000_000) < 1_000_000 for k, stamp in enumerate(stamps))


@pytest.mark.parametrize("names", [[], ["a", "a"], ["a", "b c"], ["a", ""]])
def test_names_of_buses_that_cannot_be_told_apart_are_refused(tmp_path: Path, names: list[str]) -> None:
    with pytest.raises(ParameterError, match="channel"):
        BusLogWriter(tmp_path / "a.log", names)


@pytest.mark.slow
@pytest.mark.parametrize("suffix", ["blf", "trc", "asc"])
def test_other_formats_hold_the_same_frames(tmp_path: Path, suffix: str) -> None:
    frames = [
        (1_700_000_000_000_000_000 + k * 1_000_000, 0x181 + k % 3, bytes([k % 256] * (k % 9)), k % 2 == 0)
        for k in range(500)
    ]
    path = tmp_path / f"run.{suffix}"
    write(path, frames)
    back = list(read_bus_log(path))
    assert [(f.can_id, f.data, f.is_rx) for f in back] == [frame[1:] for frame in frames]
    gaps = [after.timestamp_ns - before.timestamp_ns for before, after in pairwise(back)]
    assert max(abs(gap - 1_000_000) for gap in gaps) <= 1000
    assert [file.name for file in tmp_path.iterdir()] == [path.name]


def test_our_reader_gives_back_what_was_written_to_the_microsecond(tmp_path: Path) -> None:
    write(tmp_path / "a.log", FRAMES)
    assert list(read_bus_log(tmp_path / "a.log")) == [
        (t // 1000 * 1000, *rest, line, "can0") for line, (t, *rest) in enumerate(FRAMES, 1)
    ]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (b"", "empty"),
        (b"nonsense\n", r":1: 'nonsense' is not a frame"),
        (b"(0.000001) can0 181#001\n", "is not a frame"),
        (
            b"(0.000001) can0 181#00\n(00000000",
            r":2: the last line, '\(00000000', is cut: .* sed -i '\$d' a\.log, and go on",
        ),
        (b"(0.000001) can0 181#00\n(00000000\n", "is not a frame"),
        (b"\xff\xfe\x00", "is not a frame"),
    ],
)
def test_a_text_that_is_no_bus_log_is_one_clear_error(tmp_path: Path, text: bytes, message: str) -> None:
    (tmp_path / "a.log").write_bytes(text)
    with pytest.raises(LogFormatError, match=message):
        list(read_bus_log(tmp_path / "a.log"))


def test_a_folder_and_a_missing_file_are_told_apart(tmp_path: Path) -> None:
    for read in (read_bus_log, EnergyLog.open):
        with pytest.raises(LogFormatError, match="is a folder, expected a log"):
            read(tmp_path)
        with pytest.raises(LogFormatError, match="no such file"):
            read(tmp_path / "a.log")


def test_lines_of_candump_without_direction_and_remote_frames_are_read(tmp_path: Path) -> None:
    (tmp_path / "a.log").write_text(
        "(1436509052.249713) vcan0 044#2A366C2BBA\n(1.5) vcan0 123#R\n\n(2.0) can1 7FF#\n"
        "(2.5) can1 7FE# t\n(3.0) can1 7FD# r\n"
    )
    assert list(read_bus_log(tmp_path / "a.log")) == [
        (1_436_509_052_249_713_000, 0x044, bytes.fromhex("2A366C2BBA"), True, 1, "vcan0"),
        (2_000_000_000, 0x7FF, b"", True, 4, "can1"),
        (2_500_000_000, 0x7FE, b"", False, 5, "can1"),
        (3_000_000_000, 0x7FD, b"", True, 6, "can1"),
    ]


def test_a_damaged_blf_is_one_clear_error(tmp_path: Path) -> None:
    (tmp_path / "a.blf").write_bytes(b"LOGG" + bytes(100))
    with pytest.raises(LogFormatError, match="BLF"):
        list(read_bus_log(tmp_path / "a.blf"))


@pytest.mark.parametrize("suffix", ["log", "blf", "trc", "asc"])
def test_a_bus_log_that_may_not_be_read_is_one_clear_error(tmp_path, suffix: str, monkeypatch) -> None:
    path = tmp_path / f"a.{suffix}"
    path.write_text("(0.1) can0 080#\n")

    def refuse(*_words: object, **_options: object) -> None:  # as for a user who may not; root may read anything
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "open", refuse)
    with pytest.raises(LogFormatError, match=rf"a\.{suffix}: cannot be read .*Permission denied"):
        list(read_bus_log(path))


def test_a_writer_killed_between_write_and_release_is_continued_behind_its_last_whole_line(tmp_path: Path) -> None:
    descriptor = allocate(size_of([FRAME_RING]))
    area = SharedArea(descriptor, [FRAME_RING])
    for k in range(10):
        area.rings[0].push((k * 1000, 0x181, 1, True, 0, bytes([k])))
    killed = BusSink(tmp_path / "a.log", ["can0"], area)
    killed.open(restart=False)
    killed.drain([7], final=False)
    area.rings[0].release(2)  # killed before it could say how far it was, in the middle of the next line
    with (tmp_path / "a.log").open("ab") as file:
        file.write(b"(0000000000.000007) can0 18")
    second = BusSink(tmp_path / "a.log", ["can0"], area)
    second.open(restart=True)
    second.drain([10], final=True)
    second.finish("complete")
    expected = [f"(0000000000.{k:06d}) can0 181#{k:02X} R" for k in range(10)]
    assert (tmp_path / "a.log").read_text().splitlines() == expected
    area.close()
    os.close(descriptor)


def test_a_writer_killed_in_a_later_file_of_a_series_doubles_no_line(tmp_path: Path) -> None:
    descriptor = allocate(size_of([FRAME_RING]))
    area = SharedArea(descriptor, [FRAME_RING])
    for k in range(10):
        area.rings[0].push((k * 1000, 0x181, 1, True, 0, bytes([k])))
    path = tmp_path / "a.log"
    killed = BusSink(path, ["can0"], area, file_size=100, files=3)
    killed.open(restart=False)
    killed.drain([7], final=False)  # more than 100 bytes: put aside
    killed.drain([9], final=False)
    area.rings[0].release(7)  # killed before it could say how far it was
    second = BusSink(path, ["can0"], area, file_size=100, files=3)
    second.open(restart=True)
    second.drain([10], final=True)
    second.finish("complete")
    lines = b"".join(file.read_bytes() for file in [*_aside_files(path), path]).splitlines()
    assert lines == [f"(0000000000.{k:06d}) can0 181#{k:02X} R".encode() for k in range(10)]
    area.close()
    os.close(descriptor)


@pytest.mark.slow_but("failed*", "completed-None")
@pytest.mark.parametrize(
    ("status", "first"), [("failed: LinkError", 9_000), ("complete", None), ("completed", None), ("stopped", None)]
)
def test_the_last_seconds_are_written_only_when_a_run_ends_badly(tmp_path, status: str, first: int | None) -> None:
    path = tmp_path / "fault.log"
    log = BusLogWriter(path, "can0", pace="free", last=1.0)
    for k in range(10_001):
        log(k * 1_000_000, 0x181, k.to_bytes(4, "little"), True)
    log.close(status)
    if first is None:
        assert list(tmp_path.iterdir()) == []
        return
    frames = list(read_bus_log(path))
    assert [int.from_bytes(frame.data, "little") for frame in frames] == list(range(first, 10_001))
