"""However a run of the demo ends, the drive's torque goes to zero and it leaves OPERATION ENABLED: by its own frames.

The command runs in lock-step; what ends it happens inside the controller, in the middle of the contact.
"""

import json
import math
import signal
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import pytest

from canhaptic.cli.main import main
from canhaptic.control.balance import EnergyBalance
from canhaptic.control.passivity import Controller
from canhaptic.scene import parts
from tests.acceptance.bus_frames import DEMO, IN_CONTACT, Frame, commands, read_log, reports

CYCLE = 50  # in which it happens

Outcome = Callable[[EnergyBalance], EnergyBalance]


class Failing:
    """A controller around another one; `outcome` has the last word on one cycle."""

    def __init__(self, inner: Controller, outcome: Outcome) -> None:
        self.inner, self.outcome, self.steps = inner, outcome, 0

    def step(self, position: float, torque_applied: float) -> EnergyBalance:
        balance = self.inner.step(position, torque_applied)
        self.steps += 1
        return self.outcome(balance) if self.steps == CYCLE else balance

    def sample_lost(self) -> EnergyBalance:
        return self.inner.sample_lost()


def with_torque(torque: float) -> Outcome:
    return lambda balance: balance._replace(torque=torque)


def raise_error(balance: EnergyBalance) -> EnergyBalance:
    raise ZeroDivisionError("the law of this wall has a hole")


def return_nonsense(balance: EnergyBalance) -> EnergyBalance:
    return None  # type: ignore[return-value]


def raise_signal(number: signal.Signals) -> Outcome:
    def outcome(balance: EnergyBalance) -> EnergyBalance:
        signal.raise_signal(number)
        return balance

    return outcome


class Ending(NamedTuple):
    outcome: Outcome
    status: int
    message: str


ENDINGS = {
    "an exception in the controller": Ending(raise_error, 3, "ZeroDivisionError: the law of this wall"),
    "a balance that is none": Ending(return_nonsense, 3, "torque is zero"),
    "a torque of NaN": Ending(with_torque(math.nan), 3, "expected a finite number"),
    "an infinite torque": Ending(with_torque(-math.inf), 3, "expected a finite number"),
    "SIGINT": Ending(raise_signal(signal.SIGINT), 130, ""),
    "SIGTERM": Ending(raise_signal(signal.SIGTERM), 143, ""),
}


def run_with(controller_of: Callable[[Controller], Controller], bus_log: Path, monkeypatch: pytest.MonkeyPatch) -> int:
    original = parts.build_axis_controller
    monkeypatch.setattr(parts, "build_axis_controller", lambda axis: controller_of(original(axis)))
    return main(["run", str(DEMO), "--duration", "0.5", "--json", "--bus-log", str(bus_log), *IN_CONTACT])


@pytest.mark.slow_but("a torque of NaN", "an exception*", "SIGINT")
@pytest.mark.parametrize("what", ENDINGS)
def test_the_torque_goes_to_zero_and_the_drive_is_disabled(
    what: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    ending = ENDINGS[what]
    status = run_with(lambda inner: Failing(inner, ending.outcome), tmp_path / "a.log", monkeypatch)  # type: ignore[arg-type, return-value]
    captured = capsys.readouterr()
    assert status == ending.status, captured.err
    assert ending.message in captured.err
    assert "Traceback" not in captured.err
    answer = json.loads(captured.out)
    assert (answer["status"], answer.get("exit_status", status)) == ("error" if status == 3 else "stopped", status)
    frames = read_log(tmp_path / "a.log")
    assert_torque_taken_away([command.target_torque for command in commands(frames)])
    assert syncs_from_torque_to_zero(frames) == 1
    assert commands(frames)[-1].controlword & 0x0F != 0x0F
    told = reports(frames)
    assert max(abs(report.torque) for report in told) > 100  # there was torque to take away
    assert told[-1].torque == 0
    assert not told[-1].is_enabled
    first_off = next(k for k, report in enumerate(told) if k and told[k - 1].is_enabled and not report.is_enabled)
    assert {report.torque for report in told[first_off - 1 :]} == {0}  # without torque before it was disabled
    assert not any(report.is_enabled for report in told[first_off:])


def assert_torque_taken_away(torques: Sequence[int]) -> None:
    """From the torque of the controller to zero in one RPDO, and zero from there on."""
    last = max(k for k, torque in enumerate(torques) if torque)
    assert abs(torques[last]) > 100
    assert set(torques[last + 1 :]) == {0}


def syncs_from_torque_to_zero(frames: Sequence[Frame]) -> int:
    """SYNCs between the last RPDO with a torque and the next RPDO: 1 when zero was sent in the very next cycle."""
    rpdos = [k for k, frame in enumerate(frames) if frame.can_id == 0x201 and frame.is_sent]
    last = max(n for n, k in enumerate(rpdos) if frames[k].data[2:] != b"\0\0")
    return sum(frame.can_id == 0x080 for frame in frames[rpdos[last] : rpdos[last + 1]])


def test_a_run_to_its_end_ends_as_gently(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert run_with(lambda inner: inner, tmp_path / "a.log", monkeypatch) == 0
    told = reports(read_log(tmp_path / "a.log"))
    assert (told[-1].torque, told[-1].is_enabled) == (0, False)
