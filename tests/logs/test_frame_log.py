"""A log of Ethernet frames keeps every byte and time, and played back it finds every difference."""

from pathlib import Path

import pytest

from canhaptic.errors import LogFormatError, LogWriteError
from canhaptic.logs.frame_log import (
    FrameLog,
    LoggedFrame,
    RecordedLine,
    RecordingLine,
    ReplayDepartureError,
    read_frame_log,
)
from canhaptic.sim.drive.ethercat.cable import CableEffects
from canhaptic.sim.drive.ethercat.drive_node import ClockParameters
from tests.sim_drive.ethercat_line import Line, make_drive

CYCLES = 200
EFFECTS = CableEffects(late=0.02, lost=0.02, answer_lost=0.02, low_counter=0.02)


def work(line: Line) -> None:
    """Start, and hold the drives by springs that depend on what they answer."""
    line.start()
    torques = [50, -50]
    for _ in range(CYCLES):
        seen = line.cycle(*torques)
        torques = [max(-300, min(300, -(counts // 5))) for _, counts, _ in seen or [(0, 0, 0)] * 2]


def make_line() -> Line:
    return Line(make_drive(ClockParameters(40_000)), make_drive(ClockParameters(-20_000, 10**12)), effects=EFFECTS)


@pytest.fixture
def frames(tmp_path: Path) -> list[LoggedFrame]:
    line = make_line()
    with FrameLog(tmp_path / "line.pcap") as log:
        line.master._exchange = RecordingLine(line.cable, line.clock, log.note).exchange
        work(line)
    return read_frame_log(tmp_path / "line.pcap")


def play(frames: list[LoggedFrame]) -> RecordedLine:
    line = make_line()
    recorded = RecordedLine(frames, line.clock)
    line.master._exchange = recorded.exchange
    work(line)
    return recorded


def with_flipped_bit(frames: list[LoggedFrame], number: int, at: int) -> list[LoggedFrame]:
    changed = bytearray(frames[number].content)
    changed[at] ^= 0x40
    return [*frames[:number], frames[number]._replace(content=bytes(changed)), *frames[number + 1 :]]


def test_every_frame_is_sent_again_byte_for_byte_and_one_flipped_bit_is_named(frames: list[LoggedFrame]) -> None:
    recorded = play(frames)
    assert recorded.left == 0
    assert recorded.compared > 2 * CYCLES
    number = len(frames) - 101  # of an answer, in the middle of the cycles
    while not (frames[number].is_answer and frames[number].content[16 + 20 + 14] == 10):
        number -= 1
    position = 16 + 20 + 14 + 10 + 2
    with pytest.raises(ReplayDepartureError, match=r"frame \d+: byte 6\d: got 0x\w\w, recorded 0x\w\w"):
        play(with_flipped_bit(frames, number, position))
    sent = next(n for n in range(number, 0, -1) if not frames[n].is_answer)
    with pytest.raises(ReplayDepartureError, match=rf"frame {sent + 1}: byte 50: "):
        play(with_flipped_bit(frames, sent, 50))


def test_a_log_that_ends_early_or_another_time_is_a_departure(frames: list[LoggedFrame]) -> None:
    with pytest.raises(ReplayDepartureError, match="the log ends before it"):
        play(frames[:300])
    later = [*frames[:100], *(frame._replace(time=frame.time + 1) for frame in frames[100:])]
    with pytest.raises(ReplayDepartureError, match="recorded at"):
        play(later)


def test_what_is_no_log_of_frames_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.pcap"
    with pytest.raises(LogFormatError, match="cannot be read"):
        read_frame_log(path)
    with FrameLog(path) as log:
        log.note(5, bytes(60))
    assert read_frame_log(path) == [LoggedFrame(5, bytes(60))]
    with pytest.raises(LogWriteError, match="choose another file"):
        FrameLog(tmp_path)
    whole = path.read_bytes()
    for cut, said in ((whole[:-1], "frame 1: got 60 bytes"), (whole[:30], "ends within it"), (whole[4:], "no pcap")):
        path.write_bytes(cut)
        with pytest.raises(LogFormatError, match=said):
            read_frame_log(path)
