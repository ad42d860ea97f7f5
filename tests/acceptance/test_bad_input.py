"""Every bad input of a run: one clear error, its exit status, and not one frame that could move anything."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from canhaptic.cli.main import main
from canhaptic.sim.drive.can import door
from canhaptic.sim.drive.can.drive_node import SimulatedDrive
from canhaptic.sim.drive.can.sdo_server import SdoServer
from tests.acceptance.bus_frames import DEMO, assert_never_enabled, commands, read_log

Prepare = Callable[[pytest.MonkeyPatch], None]


def nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    pass


def drive_in_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    """Lets the drive fail after its boot-up and before the master comes."""
    original = SimulatedDrive

    def build_faulty(*arguments: Any) -> SimulatedDrive:
        drive = original(*arguments)
        drive.wake(0)
        drive.inject_fault(0x3210)
        return drive

    monkeypatch.setattr(door, "SimulatedDrive", build_faulty)


def sdo_answers(request: str, answer: str) -> Prepare:
    """Lets the drive answer the SDO requests that begin with these bytes so, and not do what they ask."""
    start, reply = bytes.fromhex(request), bytes.fromhex(answer)

    def prepare(monkeypatch: pytest.MonkeyPatch) -> None:
        original = SdoServer.answer
        monkeypatch.setattr(
            SdoServer,
            "answer",
            lambda server, data: reply if data.startswith(start) else original(server, data),
        )

    return prepare


class Case(NamedTuple):
    words: tuple[str, ...]
    status: int
    message: tuple[str, ...]
    prepare: Prepare = nothing


SECOND_AXIS = (
    "axes=[{name: left, node_id: 1, eds: cia402_servo.eds, unit: m, counts_per_unit: 1e6, rated_torque: 10, "
    "torque_limit: 20}, {name: right, node_id: 1, eds: cia402_servo.eds, unit: m, counts_per_unit: 1e6, "
    "rated_torque: 10, torque_limit: 20}]"
)
NO_FAR_SIDE = ("simulation=null", "bus.channel=nobody-is-here", "axes.0.sdo_timeout=30 ms")
CASES = {
    "unknown key": Case(("environment.stifness=5",), 2, ("stifness: unknown key; did you mean 'stiffness'?",)),
    "wrong unit": Case(("environment.stiffness=100 N*m/rad",), 2, ("unit 'N*m/rad' does not fit; expected [N/m]",)),
    "node id twice": Case((SECOND_AXIS,), 2, ("got 1, which is the node_id of another axis already",)),
    "EDS missing": Case(("axes.0.eds=none.eds",), 2, ("axes.0.eds: got 'none.eds', no such file",)),
    "bus overload": Case(("bus.bitrate=125 kbit/s",), 2, ("does not fit the bus", "rate", "bitrate")),
    "drive absent": Case(
        (*NO_FAR_SIDE, "axes.0.start_timeout=0 s"), 3, ("handle: presence", "node 1: no answer", "check power")
    ),
    "drive in fault": Case((), 3, ("handle: drive state", "FAULT", "0x3210"), drive_in_fault),
    "wrong device type": Case(
        ("simulation.drive.objects.0x1000=0x00030191",), 3, ("handle: device type", "0x00030191", "0x0192")
    ),
    "mode refused by abort": Case(
        (), 3, ("mode of operation", "0x06090030"), sdo_answers("2f 60 60 00", "80 60 60 00 30 00 09 06")
    ),
    "mode not taken": Case(
        (), 3, ("mode of operation", "0x6061 = 3"), sdo_answers("40 61 60 00", "4f 61 60 00 03 00 00 00")
    ),
    "mode not supported": Case(("simulation.drive.objects.0x6502=0x6D",), 3, ("drive modes", "0x6502", "bit 9")),
    "mapping refused by abort": Case(
        (), 3, ("PDO map", "0x06040041"), sdo_answers("23 00 1a 02", "80 00 1a 02 41 00 04 06")
    ),
}


def refused(case: Case, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    case.prepare(monkeypatch)
    log = folder / "a.log"
    overrides = [word for override in case.words for word in ("--set", override)]
    status = main(["run", str(DEMO), "--duration", "0.05", "--bus-log", str(log), *overrides])
    captured = capsys.readouterr()
    assert status == case.status, captured.err
    assert captured.out == ""
    errors = [line for line in captured.err.splitlines() if not line.startswith("  ")]  # notes before it
    assert errors[0].startswith("canhaptic: error")
    assert len(errors) == 1 or errors[0] == "canhaptic: errors:"
    for text in case.message:
        assert any(text in line for line in errors), captured.err
    if case.status == 2:
        assert not log.exists()  # refused before the bus was opened
    else:
        frames = read_log(log)
        assert frames
        assert_never_enabled(frames)
        assert all(command.controlword == 0 for command in commands(frames))


@pytest.mark.slow_but(
    "wrong device type",
    "mapping refused by abort",
    "drive in fault",
    "bus overload",
    "unknown key",
    "wrong unit",
    "node id twice",
    "EDS missing",
)
@pytest.mark.parametrize("what", CASES)
def test_bad_input_is_one_clear_error_and_no_torque(what: str, tmp_path, monkeypatch, capsys) -> None:
    refused(CASES[what], tmp_path, monkeypatch, capsys)
