"""`canhaptic home` as it is typed: agreed to, declined, stopped, and refused with nothing sent."""

from pathlib import Path
from typing import Any

import pytest

from canhaptic.cli import home as command
from canhaptic.cli.main import main
from canhaptic.drive import homing
from canhaptic.drive.can.link import Link
from tests.drive.test_homing import with_homing

DEMO = Path(__file__).resolve().parents[2] / "configs" / "demo.yaml"
WORDS = ("--method", "34", "--speed", "0.02", "0.01", "--torque", "2")


def scene(folder: Path, without: str = "", **more: tuple[int, str, int]) -> str:
    text = DEMO.read_text().replace("cia402_servo.eds ", f"{with_homing(folder, more, without)} ")
    path = folder / "rig.yaml"
    path.write_text(text.replace("0x6502: 0x200", "0x6502: 0x220"))
    return str(path)


@pytest.fixture
def sent(monkeypatch: pytest.MonkeyPatch) -> list[tuple[int, bytes]]:
    frames: list[tuple[int, bytes]] = []
    send = Link.send

    def record(self: Link, can_id: int, data: bytes) -> int:
        frames.append((can_id, bytes(data)))
        return send(self, can_id, data)

    monkeypatch.setattr(Link, "send", record)
    return frames


class Person:
    """Says no to the question with this number, and yes to all before."""

    def __init__(self, no: int) -> None:
        self.left, self.questions = no, list[str]()

    def confirm(self, question: str) -> bool:
        self.questions.append(question)
        self.left -= 1
        return self.left >= 0


def test_home_prints_the_position_before_and_after(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["commission", "--home", scene(tmp_path), *WORDS, "--yes"]) == 0
    out, err = capsys.readouterr()
    assert out.splitlines()[0] == "handle: home found by method 34; the drive is disabled"
    assert out.splitlines()[1] == "  position before: 0 counts (0x6064), 0 m"
    assert "handle (node 1) will be enabled" in err
    assert "it moves towards larger counts to the next index; at 0.02 and 0.01 m/s" in err
    assert "with at most 2 N, for at most 30 s" in err
    assert "not put back in the drive: 0x6072:00 Max torque is 200, was 1000 before the run" in err


@pytest.mark.parametrize("no", [0, 1, 2])
def test_a_no_to_any_question_sends_nothing(tmp_path, monkeypatch, sent: list[tuple[int, bytes]], no: int) -> None:
    person = Person(no)
    monkeypatch.setattr(command, "dialogue_of", lambda *_, **__: person)
    assert main(["commission", "--home", scene(tmp_path, without="6072"), *WORDS]) == 1
    assert len(person.questions) == no + 1
    assert sent == []
    wanted = ("takes no torque limit from the bus (0x6072)", "Is 0x6099 in counts/s?", "emergency stop at hand?")
    assert wanted[no] in person.questions[-1]


def test_a_signal_in_the_middle_ends_with_its_status_and_zero_torque(tmp_path, monkeypatch, sent, capsys):
    cycle = homing._cycle

    def interrupted(rig: Any) -> float:
        if rig.sync_index == 300:
            import signal

            signal.raise_signal(signal.SIGINT)
        return cycle(rig)

    monkeypatch.setattr(homing, "_cycle", interrupted)
    assert main(["commission", "--home", scene(tmp_path), *WORDS, "--yes"]) == 130
    images = [data for can_id, data in sent if can_id == 0x201]
    assert {data[2:4] for data in images} == {b"\0\0"}
    words = [int.from_bytes(data[:2], "little") for data in images]
    assert 0x1F in words
    assert (words[-1], 0x10F in words) == (0x00, True)
    assert "stopped before home was found" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("torque", "got"), [("21", "got 21 N, expected more than 0, at most 20 N"), ("nan", "got nan N")]
)
def test_a_torque_beyond_the_limit_is_refused_before_a_frame(tmp_path: Path, torque, got, sent, capsys) -> None:
    assert main(["commission", "--home", scene(tmp_path), *WORDS, "--torque", torque, "--yes"]) == 2
    assert f"--torque: {got}" in capsys.readouterr().err
    assert sent == []


@pytest.mark.parametrize("missing", ["--method", "--speed", "--torque"])
def test_method_speeds_and_torque_must_be_named(missing: str, capsys: pytest.CaptureFixture[str]) -> None:
    words = list(WORDS)
    place = words.index(missing)
    del words[place : place + (3 if missing == "--speed" else 2)]
    with pytest.raises(SystemExit):
        main(["commission", "--home", str(DEMO), *words, "--yes"])
    assert f"required: {missing}" in capsys.readouterr().err


def test_yes_is_for_simulated_drives_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    real = ("bus.interface=udp_multicast", "bus.channel=239.74.163.99")
    words = [word for value in real for word in ("--set", value)]
    assert main(["commission", "--home", scene(tmp_path), *words, *WORDS, "--yes"]) == 2
    assert "for a real drive a person at the machine must answer" in capsys.readouterr().err
