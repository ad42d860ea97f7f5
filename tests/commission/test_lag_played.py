"""How often the torque is timed and what of its lateness is lag, on a free mass without a bus."""

from itertools import pairwise
from pathlib import Path
from typing import Any, cast

import pytest

from canhaptic.commission import mass_and_friction, torque_tests
from canhaptic.commission.mass_and_friction import time_the_torque
from canhaptic.commission.session import StepVerdict
from canhaptic.commission.torque_tests import checked_holds
from canhaptic.commission.which_hold import HoldTimes, TorqueDelay
from canhaptic.drive.clock import WallClock
from canhaptic.scene.load import load_scene
from tests.commission.played import FreeMass, PlayedSession

DEMO = Path(__file__).resolve().parents[2] / "configs" / "demo.yaml"
TIME, MASS = 1e-3, 0.25
KNOWN = {"moving_mass": 0.2, "device_damping_bound": 0.2, "device_friction_bound": 0.0}


class LateMass(FreeMass):
    """A free mass whose torques act some holds later."""

    def __init__(self, holds: int) -> None:
        super().__init__(MASS, TIME, 1e-6)
        self._queue = [0.0] * holds

    def advance(self, command: float) -> float:
        """As `Axis`."""
        self._queue.append(command)
        super().advance(self._queue.pop(0))
        return command


def hold_of(hold: int | None, width: float) -> HoldTimes:
    """Times that name a hold, from a range of onsets of this width [sample times]."""
    begin = float(hold or 0)
    return HoldTimes(TorqueDelay(begin, begin, begin + width, 0.1, is_explained=True), 0, None, hold, is_read_back=True)


@pytest.fixture
def holds(monkeypatch: pytest.MonkeyPatch) -> list[HoldTimes]:
    """What the tests in turn say of the hold; the last one goes on."""
    given: list[HoldTimes] = []

    def next_hold(*_: object) -> HoldTimes:
        return given.pop(0) if len(given) > 1 else given[0]

    monkeypatch.setattr(mass_and_friction, "_DOUBLETS", (4, 8, 16, 32))
    monkeypatch.setattr(mass_and_friction, "is_dear", lambda *_: False)
    monkeypatch.setattr(mass_and_friction, "time_the_hold", next_hold)
    monkeypatch.setattr(mass_and_friction, "report_hold", lambda session, axis, times: session.reported.append(times))
    return given


def timed(holds: int, *overrides: str) -> PlayedSession:
    session = PlayedSession(load_scene(DEMO, list(overrides)), cast(Any, [LateMass(holds)]))
    session.reported = []  # type: ignore[attr-defined]
    time_the_torque(session, 0, 1.0, MASS, KNOWN)
    return session


def lengths(session: PlayedSession) -> list[int]:
    """Number of doublets of each test, as its cycles show: the first has 4."""
    cycles = [cycles for _, torques, cycles, _ in session.played if torques]
    return [round(4 * each / cycles[0]) for each in cycles]


def lag(session: PlayedSession) -> tuple[float, StepVerdict]:
    [found] = [each for each in session.report.findings if each.item == "torque lag"]
    proposed = [each.value for each in session.report.values if each.key == "passivity.current_lag"]
    return (float(proposed[0] or 0.0) if proposed else -1.0), found.verdict


def test_a_sure_hold_is_timed_once_and_one_that_is_not_must_be_seen_twice(holds: list[HoldTimes]) -> None:
    holds += [hold_of(0, 0.3)]
    assert lengths(timed(0)) == [4]
    holds[:] = [hold_of(0, 0.8)]
    assert lengths(timed(0)) == pytest.approx([4, 8], abs=1)
    holds[:] = [hold_of(1, 0.8), hold_of(0, 0.8), hold_of(0, 0.8)]
    assert lengths(timed(0)) == pytest.approx([4, 8, 16], abs=2)


@pytest.mark.parametrize("late", [0, 1, 2])
def test_what_is_late_by_whole_holds_is_no_lag(late: int, holds: list[HoldTimes]) -> None:
    holds += [hold_of(late, 0.3)]
    session = timed(late)
    proposed, verdict = lag(session)
    assert verdict is not StepVerdict.FAILED
    assert 0.0 <= proposed < 50e-6
    assert session.reported == [hold_of(late, 0.3)]  # type: ignore[attr-defined]


def test_a_lateness_that_no_hold_explains_is_a_lag_with_a_margin_and_its_uncertainty(holds, monkeypatch):
    holds += [hold_of(0, 0.3)]
    monkeypatch.setattr(mass_and_friction, "estimate_lateness", lambda *_: (200e-6, 10e-6))
    session = timed(0)
    assert lag(session)[0] == pytest.approx(1.1 * 230e-6)
    [proposed] = [each.text for each in session.report.values if each.key == "passivity.current_lag"]
    assert proposed == f"[{170 / 1.1:.6g} us, 253 us]"  # read back as a range
    assert timed(0, f"passivity.current_lag={proposed}").axes[0].loop.current_lag_least == pytest.approx(
        170e-6 / 1.1, rel=1e-5
    )


def test_a_check_at_the_start_replaces_what_an_older_one_said_in_the_scene_that_is_logged(monkeypatch) -> None:
    monkeypatch.setattr(mass_and_friction, "time_the_torque", lambda *_: None)
    asked = ("axes.0.check_hold=each_start", "axes.0.hold_checked=older")
    scene = checked_holds(load_scene(DEMO, list(asked)), lambda _: None, lambda: False)
    assert scene.overrides == (*asked, "axes.0.hold_checked=null")
    assert scene.axes[0].parameters.hold_checked is None

    def agrees(session: PlayedSession, axis: int, *_: object) -> None:
        session.propose(axis, "hold_checked", "this drive")

    monkeypatch.setattr(mass_and_friction, "time_the_torque", agrees)
    scene = checked_holds(load_scene(DEMO, list(asked)), lambda _: None, lambda: False)
    assert scene.overrides == (*asked, "axes.0.hold_checked=this drive")
    assert scene.axes[0].parameters.hold_checked == "this drive"


def test_before_a_real_drive_moves_the_stop_is_looked_at_twenty_times_a_second(monkeypatch: pytest.MonkeyPatch) -> None:
    times, looks = [10**9], []

    def wait(_: WallClock, deadline: int) -> None:
        times.append(deadline)

    def stop() -> bool:
        looks.append(times[-1])
        return False

    monkeypatch.setattr(WallClock, "now", lambda _: times[-1])
    monkeypatch.setattr(WallClock, "wait_until", wait)
    scene = type("RealScene", (), {"simulated": False})
    assert torque_tests._Announced(lambda _: None, stop, scene).confirm("x: Reversals. Start now?")  # type: ignore[arg-type]
    assert times[-1] == 4 * 10**9
    assert max(after - before for before, after in pairwise(looks)) <= 50_000_000


def test_a_declared_lag_that_covers_what_is_not_excluded_is_kept(holds: list[HoldTimes], monkeypatch) -> None:
    holds += [hold_of(0, 0.3)]
    monkeypatch.setattr(mass_and_friction, "estimate_lateness", lambda *_: (0.0, 10e-6))
    session = timed(0, "passivity.current_lag=100 us")
    assert [each.value for each in session.report.values if each.key == "passivity.current_lag"] == [None]
    assert lag(timed(0, "passivity.current_lag=20 us"))[0] == pytest.approx(1.1 * 30e-6)
