import contextlib
import json
import random
import re
from collections.abc import Iterator
from itertools import count
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

import pytest

from canhaptic.cli.main import main
from canhaptic.drive.clock import WallClock
from canhaptic.drive.rig import Rig
from canhaptic.errors import InputError
from canhaptic.logs.bus_reader import convert
from canhaptic.replay import ReplayResult, replay_bus_log
from canhaptic.scene.load import load_scene
from canhaptic.scene.models import Scene
from tools.record import RECORDINGS

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "tests" / "recordings"
LINE = re.compile(r"(\S+ \S+ )([0-9A-F]{3})#([0-9A-F]*)( [TR])\n")


def scene_of(name: str, *more: str) -> Scene:
    plan = RECORDINGS[name]
    return load_scene(ROOT / plan.config, [*plan.overrides, *more])


def lines_of(name: str) -> list[str]:
    return (FOLDER / f"{name}.log").read_text().splitlines(keepends=True)


def flipped(line: str, bit: int) -> str:
    match = LINE.fullmatch(line)
    assert match is not None
    data = bytearray.fromhex(match[3])
    data[bit // 8] ^= 1 << bit % 8
    return f"{match[1]}{match[2]}#{data.hex().upper()}{match[4]}\n"


def replay_lines(folder: Path, name: str, lines: list[str], **options: Any) -> ReplayResult:
    path = folder / f"{name}.log"
    path.write_text("".join(lines))
    return replay_bus_log(path, scene_of(name), **options)


@pytest.mark.timeout(60)  # it would wait for ever
def test_a_master_that_waits_for_an_answer_that_the_log_lacks_gives_up(tmp_path: Path) -> None:
    """Its next recorded frame is due at once, so the time of the recording does not go on by itself."""
    lines = lines_of("demo")
    answers = [number for number, line in enumerate(lines) if " 581#" in line]
    for number in (answers[0], answers[30], answers[-40]):
        found = replay_lines(tmp_path, "demo", lines[:number] + lines[number + 1 :])
        assert found["difference"] is not None
        assert found["difference"]["number"] >= number


@pytest.mark.parametrize("name", RECORDINGS)
def test_the_master_sends_today_what_it_sent_when_recorded(name: str) -> None:
    result = replay_bus_log(FOLDER / f"{name}.log", scene_of(name))
    assert result["difference"] is None
    assert result["status"] == "identical"
    assert result["start"] == "boot"
    frames = result["frames"]
    assert frames["compared"] == sum(line.endswith("T\n") and " 77E#" not in line for line in lines_of(name))
    assert frames["compared"] + frames["played"] == frames["recorded"]


@pytest.mark.slow_but("bound_sum-*", "bound_display-*", "bound_late_lossy_group-*")
@pytest.mark.parametrize(
    ("name", "place"),
    [
        ("bound_hand_force", "certificates.certified_torque.hand_force_bound"),
        ("bound_late_torque", "certificates.certified_torque.hand_force_bound"),
        ("bound_lost_frames", "certificates.certified_torque.torque_if_repeated"),
        ("bound_device_damping", "certificates.certified_torque.torque_for_any_hand"),
        ("bound_hand_speed", "certificates.certified_torque.torque_by_hand_speed"),
        ("bound_device_friction", "certificates.certified_torque.torque_for_any_hand"),
        ("bound_sum", "certificates.certified_torque.torque_by_reach"),
        ("bound_drag", "certificates.certified_torque.hand_force_bound"),
        ("bound_group", "multi_axis.group_account.by_hand_force"),
        ("bound_late_group", "multi_axis.group_account.by_hand_force"),
        ("bound_lossy_group", "multi_axis.group_certificates.largest_share"),
        ("bound_display", "admittance.velocity_loop.VelocityLoop.fastest"),
        ("bound_display_force", "admittance.declared_hand.LargestForce.fastest"),
        ("bound_declared_hand", "admittance.declared_hand.DeclaredHand.fastest_speed"),
        ("bound_late_lossy_group", "multi_axis.group_certificates.largest_share"),
        ("bound_group_of_handles", "multi_axis.group_certificates.hand_force_bound"),
    ],
)
def test_a_certificate_that_permits_a_little_more_changes_its_recording(name: str, place: str, monkeypatch) -> None:
    """Each is recorded where its torques are at the bound."""
    bound = resolve_name(f"canhaptic.control.{place}")
    monkeypatch.setattr(f"canhaptic.control.{place}", lambda *arguments: 1.05 * bound(*arguments))
    assert replay_bus_log(FOLDER / f"{name}.log", scene_of(name))["status"] == "different"


@pytest.mark.slow_but("emergency", "lost_frames")
@pytest.mark.parametrize("name", ["paper_fig8_100hz", "two_axes", "emergency", "lost_frames"])
def test_a_recording_without_the_start_is_replayed_from_the_first_sync(name: str, tmp_path: Path) -> None:
    lines = lines_of(name)
    cut = next(number for number, line in enumerate(lines) if "#0F000000 T" in line)
    bare = [line[:-3] + "\n" for line in lines[cut:]]  # without directions, too
    result = replay_lines(tmp_path, name, bare)
    assert result["difference"] is None
    assert result["start"] == "sync"
    assert result["cycles"] > 50


def test_the_end_of_a_run_is_found_in_the_frames() -> None:
    demo = replay_bus_log(FOLDER / "demo.log", scene_of("demo"))
    last = float(lines_of("demo")[-1][1:].partition(")")[0])
    assert (demo["cycles"], demo["duration"]) == (1603, pytest.approx(last, abs=1e-6))
    emergency = replay_bus_log(FOLDER / "emergency.log", scene_of("emergency"))
    assert "handle: the drive sent an EMCY at SYNC 150: EMCY 0x5000" in emergency["ended"]
    assert "no TPDO for too many SYNCs" in replay_bus_log(FOLDER / "lost_frames.log", scene_of("lost_frames"))["ended"]


def random_frames(name: str, can_id: str, count: int, seed: int) -> Iterator[tuple[int, int]]:
    """Line numbers from 0 and bits of frames in a recording."""
    generator = random.Random(seed)
    places = [number for number, line in enumerate(lines_of(name)) if f" {can_id}#" in line]
    for _ in range(count):
        yield generator.choice(places), generator.randrange(32)


@pytest.mark.slow_but("paper_fig7*")
@pytest.mark.parametrize(("name", "can_id"), [("paper_fig7_40hz", "201"), ("two_axes", "205")])
def test_any_flipped_bit_of_any_recorded_rpdo_is_found_at_its_line(name: str, can_id: str, tmp_path: Path) -> None:
    for number, bit in random_frames(name, can_id, 4, seed=1):
        lines = lines_of(name)
        lines[number] = flipped(lines[number], bit)
        difference = replay_lines(tmp_path, name, lines)["difference"]
        assert difference["number"] == number + 1
        changed = int(difference["recorded"]["data"], 16) ^ int(difference["sent"]["data"], 16)
        assert changed.bit_count() == 1
        assert difference["recorded"]["kind"] == difference["sent"]["kind"] == "RPDO1"
        before = [n for n in range(number) if " 77E#" not in lines[n]][-6:]  # the master's heartbeat has its own time
        assert [frame["number"] for frame in difference["before"]] == [n + 1 for n in before]
        assert [frame["direction"] for frame in difference["before"]] == [lines[n][-2] for n in before]


def test_a_difference_is_timed_from_the_beginning_of_the_log(tmp_path: Path) -> None:
    name = "emergency"
    later = [f"({1_700_000_000 + float(line[1:18]):017.6f}){line[19:]}" for line in lines_of(name)]
    number = [number for number, line in enumerate(later) if " 201#" in line][50]
    later[number] = flipped(later[number], 16)
    difference = replay_lines(tmp_path, name, later)["difference"]
    assert difference["number"] == number + 1
    assert difference["time"] == pytest.approx(float(lines_of(name)[number][1:18]) - float(lines_of(name)[0][1:18]))


@pytest.mark.slow
def test_what_a_drive_sends_between_two_commands_of_one_instant_is_no_difference(tmp_path: Path) -> None:
    lines = lines_of("two_axes")
    pairs = [n for n, line in enumerate(lines) if " 201#" in line and " 205#" in lines[n + 1]]
    heartbeat = f"{lines[pairs[20]].split(' ')[0]} vcan0 701#05 R\n"
    result = replay_lines(tmp_path, "two_axes", [*lines[: pairs[20] + 1], heartbeat, *lines[pairs[20] + 1 :]])
    assert (result["status"], result["difference"]) == ("identical", None)
    assert result["frames"]["played"] == 1 + sum(line.endswith("R\n") for line in lines)


def test_a_jump_of_the_recorded_time_does_not_end_the_comparison(tmp_path: Path) -> None:
    lines = lines_of("demo")
    syncs = [n for n, line in enumerate(lines) if " 080#" in line]
    lines[syncs[100]] = f"(3999999998.{lines[syncs[100]].partition('.')[2]}"
    lines.insert(syncs[400], lines[syncs[5]])
    result = replay_lines(tmp_path, "demo", lines)
    assert result["status"] == "different"


def test_a_time_that_no_clock_shows_is_refused_with_its_line(tmp_path: Path) -> None:
    lines = lines_of("demo")
    lines[700] = f"(9000000000.{lines[700].partition('.')[2]}"
    with pytest.raises(InputError, match=r"demo.log: frame 701 has the time 9e\+09 s, expected at most 4e\+09 s"):
        replay_lines(tmp_path, "demo", lines)


@pytest.mark.slow_but("3-60", "0--1")
@pytest.mark.parametrize("place", [60, -3, -2, -1])  # in the run, the last of it, and what disables the drive
@pytest.mark.parametrize("bit", [0, 3])
def test_a_flipped_bit_of_a_controlword_does_not_move_the_end_of_the_run(place: int, bit: int, tmp_path: Path) -> None:
    name = "paper_fig7_40hz"
    lines = lines_of(name)
    number = [number for number, line in enumerate(lines) if " 201#" in line][place]
    lines[number] = flipped(lines[number], bit)
    difference = replay_lines(tmp_path, name, lines)["difference"]
    assert difference["number"] == number + 1
    assert int(difference["recorded"]["data"], 16) ^ int(difference["sent"]["data"], 16) == 1 << bit + 24


def test_a_flipped_bit_of_a_recorded_position_is_found_where_it_changes_the_torque(tmp_path: Path) -> None:
    name = "emergency"
    reports = [number for number, line in enumerate(lines_of(name)) if " 181#3712" in line]
    for number, bit in [(reports[40], 16 + 14), (reports[80], 16 + 31), (reports[120], 3), (reports[20], 48 + 9)]:
        lines = lines_of(name)
        lines[number] = flipped(lines[number], bit)
        difference = replay_lines(tmp_path, name, lines)["difference"]
        assert number < difference["number"] <= number + 8
        assert any(frame["number"] == number + 1 for frame in difference["before"])


@pytest.mark.slow
def test_an_sdo_that_was_refused_then_is_shown_by_what_the_master_does_now(tmp_path: Path) -> None:
    lines = lines_of("demo")
    answers = [number for number, line in enumerate(lines) if " 581#60" in line]
    head, _, tail = lines[answers[2]].partition("#")
    lines[answers[2]] = f"{head}#80{tail[2:8]}20000008 R\n"
    difference = replay_lines(tmp_path, "demo", lines)["difference"]
    assert "abort by server" in difference["before"][-1]["text"]
    assert difference["sent"]["data"] != difference["recorded"]["data"]


def test_a_frame_that_was_not_recorded_and_one_that_is_not_sent_are_told_apart(tmp_path: Path) -> None:
    lines = lines_of("paper_fig7_40hz")
    commands = [number for number, line in enumerate(lines) if " 201#" in line]
    missing = lines[: commands[50]] + lines[commands[50] + 1 :]
    difference = replay_lines(tmp_path, "paper_fig7_40hz", missing)["difference"]
    assert difference["sent"]["kind"] == "RPDO1"
    assert difference["recorded"]["kind"] != "RPDO1"
    extra = [*lines, lines[-1].split(" ")[0] + " vcan0 000#8005 T\n"]
    difference = replay_lines(tmp_path, "paper_fig7_40hz", extra)["difference"]
    assert (difference["number"], difference["sent"]) == (len(extra), None)


@pytest.mark.slow
def test_a_recording_that_was_cut_off_is_compared_as_far_as_it_goes(tmp_path: Path) -> None:
    lines = lines_of("paper_fig8_100hz")
    for length in (len(lines) // 2, len(lines) // 3, 240):
        result = replay_lines(tmp_path, "paper_fig8_100hz", lines[:length])
        assert result["difference"] is None
        assert result["ended"] == "at the end of the recording"
    for length in (40, 3):
        with pytest.raises(InputError, match="holds no whole cycle"):
            replay_lines(tmp_path, "paper_fig8_100hz", lines[:length])


@pytest.mark.slow_but(".trc")
@pytest.mark.parametrize("suffix", [".blf", ".trc", ".asc"])
def test_recordings_in_other_formats_are_replayed(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"run{suffix}"
    convert(FOLDER / "paper_fig7_40hz.log", path)
    result = replay_bus_log(path, scene_of("paper_fig7_40hz"))
    assert (result["status"], result["difference"]) == ("identical", None)


@pytest.mark.slow
def test_a_late_sync_and_a_skipped_one_are_as_late_in_the_replay(tmp_path, monkeypatch) -> None:
    write, counted, clock = Rig.write_torques, count(), WallClock()

    def write_late(rig: Rig, torques: list[float]) -> None:
        busy = (0, 300_000, 800_000, 1_300_000, 2_600_000)[next(counted) % 5]  # [ns]: the host, before RPDOs go out
        clock.wait_until(clock.now() + busy)
        write(rig, torques)

    monkeypatch.setattr(Rig, "write_torques", write_late)
    path = tmp_path / "real.log"
    words = ["run", str(ROOT / "configs" / "demo.yaml"), "--pace", "real", "--duration", "0.3", "--json"]
    main([*words, "--bus-log", str(path)])  # however it ends on a busy machine
    monkeypatch.undo()  # the replay computes in no time
    result = replay_bus_log(path, scene_of("demo"))
    assert (result["status"], result["difference"]) == ("identical", None)


@pytest.mark.slow
def test_the_masters_heartbeats_are_left_out(tmp_path: Path) -> None:
    lines = lines_of("paper_fig7_40hz")
    bare = [line for line in lines if " 77E#" not in line]
    assert len(bare) < len(lines) - 10
    for kept in (bare, [*lines[:400], lines[399].split(" ")[0] + " vcan0 77E#05 T\n", *lines[400:]]):
        assert replay_lines(tmp_path, "paper_fig7_40hz", kept)["status"] == "identical"


def test_in_real_time_a_replay_takes_as_long_as_the_recording() -> None:
    result = replay_bus_log(FOLDER / "emergency.log", scene_of("emergency"), realtime=True)
    assert result["status"] == "identical"
    assert result["elapsed"] >= 0.99 * result["duration"]


@pytest.mark.slow
def test_another_wall_is_found_and_shown_decoded_on_both_sides(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["replay", str(FOLDER / "demo.log"), "--config", str(ROOT / "configs" / "demo.yaml"), "--quick"]
    assert main(words) == 0
    assert "identical" in capsys.readouterr().out
    assert main([*words, "--set", "environment.stiffness=101"]) == 1
    text = capsys.readouterr().out
    assert re.search(r"different at line \d+, 1\.1\d+ s", text)
    assert len(re.findall(r"(recorded|sent) +201#0F00.* RPDO1 handle: controlword 0x000F enable operation", text)) == 2
    assert main([*words, "--set", "environment.stiffness=101", "--json"]) == 1
    result = json.loads(capsys.readouterr().out)
    assert result["difference"]["sent"]["data"] != result["difference"]["recorded"]["data"]


def test_a_recording_of_another_scene_or_without_a_cycle_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.log").write_text("(1.0) can0 123#00\n")
    with pytest.raises(InputError, match="none of its 1 frames"):
        replay_bus_log(tmp_path / "a.log", scene_of("demo"))
    (tmp_path / "b.log").write_text("(1.0) can0 080#\n(1.1) can0 181#3712\n(1.2) can0 080#\n")  # a TPDO cut short
    with pytest.raises(InputError, match="replay needs one of them"):
        replay_bus_log(tmp_path / "b.log", scene_of("demo"))
    with pytest.raises(InputError, match="replay needs one of them"):
        replay_bus_log(FOLDER / "demo.log", scene_of("demo", "axes.0.node_id=7"))


def test_damaged_recordings_give_a_result_or_one_clear_error(tmp_path: Path) -> None:
    generator = random.Random(5)
    original = "".join(lines_of("emergency")[:600])
    for _ in range(8):
        damaged = list(original)
        for _ in range(generator.randrange(1, 20)):
            damaged[generator.randrange(len(damaged))] = chr(generator.randrange(32, 127))
        path = tmp_path / "damaged.log"
        path.write_text("".join(damaged))
        with contextlib.suppress(InputError):
            assert replay_bus_log(path, scene_of("emergency"))["status"] in {"identical", "different"}


@pytest.mark.slow
def test_a_whole_minute_is_replayed_frame_by_frame(tmp_path: Path) -> None:
    path = tmp_path / "minute.log"
    words = ["run", str(ROOT / "configs" / "demo.yaml"), "--pace", "free", "--duration", "60", "--json"]
    assert main([*words, "--bus-log", str(path)]) == 0
    assert replay_bus_log(path, scene_of("demo"))["status"] == "identical"


# --- recordings that lack something -----------------------------------------------------------------------------------


def test_a_recording_without_a_whole_cycle_is_not_identical_but_refused(tmp_path, capsys) -> None:
    lines = lines_of("demo")
    first = next(n for n, line in enumerate(lines) if " 080#" in line)
    path = tmp_path / "boot.log"
    path.write_text("".join(lines[:first]))
    assert main(["replay", str(path), "--config", str(ROOT / "configs" / "demo.yaml")]) == 2
    assert "boot.log: holds no whole cycle" in capsys.readouterr().err


@pytest.mark.slow_but("0")
@pytest.mark.parametrize("shift", range(4))
def test_a_gap_in_a_recording_is_named_as_such(shift: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Frames lost by the recorder, from any place in a cycle on, while the hand is in the wall."""
    lines = lines_of("paper_fig8_100hz")
    begin = len(lines) // 2 - 20 + shift  # the contact begins behind
    plan = RECORDINGS["paper_fig8_100hz"]
    path = tmp_path / "gap.log"
    path.write_text("".join(lines[:begin] + lines[begin + 90 :]))
    words = ["replay", str(path), "--config", str(ROOT / plan.config), "--quick"]
    for override in plan.overrides:
        words += ["--set", override]
    assert main(words) == 1
    out = " ".join(capsys.readouterr().out.split())
    assert re.search(r"the recording has a gap of 0\.[23]\d* s before this line: frames are missing", out)


def test_a_difference_without_a_gap_names_none(tmp_path: Path) -> None:
    lines = lines_of("paper_fig8_100hz")
    at = next(n for n in range(len(lines) // 2, len(lines)) if " 201#" in lines[n])
    lines[at] = flipped(lines[at], 20)
    result = replay_lines(tmp_path, "paper_fig8_100hz", lines)
    assert result["status"] == "different"
    assert result["difference"]["gap"] is None


@pytest.mark.slow
def test_can_fd_error_and_remote_frames_are_left_out_and_counted(tmp_path, capsys) -> None:
    lines = lines_of("demo")
    time = lines[100].split()[0]
    odd = [f"{time} can0 181##1AABB R\n", f"{time} can0 20000080#0000000000000000 R\n", f"{time} can0 181#R\n"]
    path = tmp_path / "odd.log"
    path.write_text("".join([*lines[:101], *odd, odd[1], *lines[101:]]))
    assert main(["replay", str(path), "--config", str(ROOT / "configs" / "demo.yaml"), "--quick"]) == 0
    assert "frames left out: 1 CAN FD, 2 error, 1 remote" in " ".join(capsys.readouterr().out.split())
    assert main(["inspect", "--frames", str(path)]) == 0
    captured = capsys.readouterr()
    assert captured.out.count("\n") == len(lines)
    assert "frames left out: 1 CAN FD, 2 error, 1 remote" in captured.err
