"""Logs as people have them: pasted from the screen, from SavvyCAN, compressed, with clocks that were set."""

import gzip
from itertools import accumulate
from pathlib import Path

import can
import pytest

from canhaptic.audit.recompute import rederive
from canhaptic.cli.main import main
from canhaptic.errors import LogFormatError
from canhaptic.logs.bus_reader import Frame, Remarks, convert, read_bus_log
from canhaptic.replay import replay_bus_log
from canhaptic.scene.load import load_scene
from tools.record import RECORDINGS

ROOT = Path(__file__).parents[2]
RECORDING = ROOT / "tests" / "recordings" / "paper_fig8_100hz.log"
PLAN = RECORDINGS["paper_fig8_100hz"]
TEXT = "(0000000000.000000) can0 181#1716\n"


def read(path: Path, content: str | bytes) -> tuple[list[Frame], list[str]]:
    """Returns the frames of a file and what there is to say."""
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    remarks = Remarks()
    return list(read_bus_log(path, remarks)), remarks.lines()


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("  can0  181   [2]  17 16", (-1, 0x181, "1716", True, "can0")),
        ("> can0  080   [0] ", (-1, 0x80, "", True, "can0")),
        ("robot-1 | \x1b[31m  vcan12  181\x1b[0m   [2]  17 16", (-1, 0x181, "1716", True, "vcan12")),
        (
            "  can0  TX - -  201   [8]  02 00 20 20 20 20 27 41   '..    'A'",
            (-1, 0x201, "0200202020202741", False, "can0"),
        ),
        ("  can0  RX B E  201   {2}  02 00", (-1, 0x201, "0200", True, "can0")),
        (" (1436509052.249713)  can0  181   [2]  17 16", (1436509052249713000, 0x181, "1716", True, "can0")),
        (" (2015-07-10 06:17:32.249713)  any  181 [1]  0a", (1436509052249713000, 0x181, "0a", True, "any")),
        ("12: (1.5) can1 7FE#aa t", (1500000000, 0x7FE, "aa", False, "can1")),
        ("39747828,000005EB,false,Rx,1,2,E8,45,,,,,,", (39747828000, 0x5EB, "e845", True, "1")),
        ("166064000,0000021A,false,0,8,FE,36,12,FE,69,05,07,AD,", (166064000000, 0x21A, "fe3612fe690507ad", True, "0")),
        ("0.5,0x1AB,FALSE,Tx,0,1,0x9", (500000000, 0x1AB, "09", False, "0")),
        ("000004F5,FF 34 23 ", (-1, 0x4F5, "ff3423", True, "0")),
    ],
)
def test_a_frame_of_every_form_is_read(tmp_path: Path, line: str, expected: tuple[int, int, str, bool, str]) -> None:
    time, can_id, data, is_rx, channel = expected
    (frame,), _ = read(tmp_path / "a.txt", f"{line}\n")
    assert frame[:6] == (time, can_id, bytes.fromhex(data), is_rx, 1, channel)


@pytest.mark.parametrize(
    ("line", "kind"),
    [
        ("  can0  181  [12]  00 00 00 00 00 00 00 00 00 00 00 00", "CAN FD"),
        ("  can0  181   [2]  remote request", "remote"),
        ("  can0  20000004   [8]  00 04 00 00 00 00 00 00   ERRORFRAME", "error"),
        ("  can0  181   [4]  17 16", "unreadable"),
        ("  can0  181   [2]  17 16 40", "unreadable"),
        ("  can0  181   [4]  40`16`17`00", "unreadable"),
        ("  can0  00000181   [2]  17 16", "29-bit"),
        ("1,00000181,true,Rx,0,1,17", "29-bit"),
        ("\tcontroller-problem{rx-overflow-warning}", "line of other text"),
        ("me@robot:~/a/long/path$ candump can0", "line of other text"),
    ],
)
def test_what_is_no_frame_of_canopen_is_counted(tmp_path: Path, line: str, kind: str) -> None:
    frames, said = read(tmp_path / "a.log", f"{line}\n\nTime Stamp,ID,Extended,Dir,Bus,LEN,D1\n{TEXT}")
    assert (len(frames), said) == (1, [f"frames left out: 1 {kind}"])


SPANS = "times are those since the last frame (candump -td): they were added up"


@pytest.mark.parametrize(
    ("microseconds", "are_spans"),
    [
        ([0, 1000, 1000, 250, 0, 3_000_000], True),
        ([0, 1000, 1000, 1000], True),  # a SYNC alone
        ([0, *([1000] + [0] * 19) * 4], True),  # many frames at each SYNC
        ([0, 0, 0, 1000, 1000, 1000, 2000, 2000], False),  # as a simulation stamps
        ([*range(0, 90_000, 1000), *range(0, 90_000, 1000)], False),  # two recordings in one file
    ],
)
def test_times_since_the_last_frame_are_added_up_and_those_from_zero_are_not(tmp_path, microseconds, are_spans) -> None:
    lines = [f" ({us // 1_000_000:03d}.{us % 1_000_000:06d})  can0  080   [0]\n" for us in microseconds]
    frames, said = read(tmp_path / "a.log", "".join(lines))
    expected = list(accumulate(microseconds)) if are_spans else microseconds
    assert [frame.timestamp_ns // 1000 for frame in frames] == expected
    assert (SPANS in said) is are_spans


def test_a_clock_that_was_set_is_told(tmp_path: Path) -> None:
    _, said = read(tmp_path / "a.log", "".join(f"({t}.0) can0 080#\n" for t in (5, 6, 4, 5, 100, 99)))
    assert said == [
        "time goes back 2 times, first at line or frame 3, by 2 s",
        "time jumps forward first at line or frame 5, by 95 s",
    ]


@pytest.mark.slow_but("blf")
@pytest.mark.parametrize("suffix", ["log", "blf", "trc", "asc", "csv"])
def test_a_compressed_log_holds_the_same_frames(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a.{suffix}"
    if suffix == "csv":  # that of python-can
        with can.CSVWriter(path) as writer:
            for frame in read_bus_log(RECORDING):
                writer.on_message_received(frame.message())
    elif suffix == "log":
        path.write_bytes(RECORDING.read_bytes())
    else:
        convert(RECORDING, path)
    packed = tmp_path / (f"b.{suffix}" if suffix == "trc" else f"a.{suffix}.gz")  # its content tells, not its name
    frames, said = read(packed, gzip.compress(path.read_bytes()))
    assert ([frame[1:3] for frame in frames], said) == ([frame[1:3] for frame in read_bus_log(RECORDING)], [])
    packed.write_bytes(packed.read_bytes()[:-2000])
    with pytest.raises(LogFormatError, match=r"cannot be read"):
        list(read_bus_log(packed))


def test_the_first_frame_after_the_short_header_of_busmaster_is_not_lost(tmp_path: Path) -> None:
    line = "{} 1 185 Rx d 2 08 37\n"
    text = (
        "date Thu May 16 06:16:50.884 pm 2024\nbase hex timestamps absolute\n" + line.format("0.1") + line.format("0.2")
    )
    frames, said = read(tmp_path / "a.asc", text)
    assert (len(frames), said) == (2, [])
    frames, said = read(tmp_path / "a.asc", text + line.format("0,3"))  # python-can drops it without a word
    assert (len(frames), said) == (2, ["frames left out: 1 unreadable"])


def test_a_file_of_another_format_than_its_name_says_is_one_error(tmp_path: Path) -> None:
    for suffix in ("asc", "trc", "blf"):
        with pytest.raises(LogFormatError, match=suffix.upper()):
            read(tmp_path / f"a.{suffix}", "  can0  080   [0]\n")


def as_pasted(*, timed: bool) -> str:
    """Returns a recording as `candump` shows it on the screen."""
    lines = []
    for frame in read_bus_log(RECORDING):
        time = f" ({frame.timestamp_ns / 1e9:017.6f})" if timed else ""
        data = "".join(f" {byte:02X}" for byte in frame.data)
        lines.append(f"{time}  can0  {frame.can_id:03X}   [{len(frame.data)}] {data}\n")
    return "$ candump can0\n" + "".join(lines)


@pytest.mark.slow
def test_a_pasted_log_is_replayed_and_rederived_as_the_file_is_if_it_has_times(tmp_path, capsys) -> None:
    scene, path = load_scene(ROOT / PLAN.config, PLAN.overrides), tmp_path / "a.txt"
    path.write_text(as_pasted(timed=True))
    result = replay_bus_log(path, scene)
    assert (result["status"], result["remarks"]) == ("identical", ["frames left out: 1 line of other text"])
    assert rederive(path, scene)["ports"] == rederive(RECORDING, scene)["ports"]
    path.write_text(as_pasted(timed=False))
    for use in (replay_bus_log, rederive):
        with pytest.raises(LogFormatError, match=r"no time.*candump -L"):
            use(path, scene)
    assert main(["inspect", "--frames", str(path), "--only", "sync"]) == 0
    printed = capsys.readouterr()
    assert printed.out.startswith("             - can0 R 080                  SYNC\n")
    assert "frames have no time, as in candump without -t" in printed.err


def test_a_span_of_a_log_without_times_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "a.txt").write_text("  can0  080   [0]\n")
    assert main(["inspect", "--frames", str(tmp_path / "a.txt"), "--from", "1"]) == 2
    assert "has no time; leave --from and --to out" in capsys.readouterr().err
