"""What the steps of commissioning conclude, from axes whose motion is computed here; without a bus."""

from collections.abc import Callable, Sequence
from itertools import groupby
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from canhaptic.commission import mass_and_friction, sequence
from canhaptic.commission.sequence import STANDSTILL, commission, identify, move_by_hand, stand_still, time_the_cycle
from canhaptic.commission.session import (
    TRAVELS,
    CommissioningLimits,
    Guard,
    OpenLoop,
    StepFinding,
    StepVerdict,
)
from canhaptic.commission.torque_sign import SIGN, pulse
from canhaptic.commission.torque_tests import SCALE, RisingTorque, identify_dynamics, verified_axes
from canhaptic.drive.clock import DurationHistogram
from canhaptic.scene.load import load_scene
from canhaptic.scene.models import Scene
from tests.commission.played import FreeMass, PlayedSession

DEMO = Path(__file__).resolve().parents[2] / "configs" / "demo.yaml"
TIME, MASS = 1e-3, 0.25


def scene_of(*overrides: str) -> Scene:
    return load_scene(DEMO, list(overrides))


class Still:
    """An axis that does not move."""

    position = 0.0

    def advance(self, command: float) -> float:
        """As `Axis`."""
        return command


class Moved(Still):
    """An axis whose position is a function of the time since the start [s]."""

    def __init__(self, position: Callable[[float], float]) -> None:
        self._at, self.holds = position, 0
        self.position = position(0.0)

    def advance(self, command: float) -> float:
        """As `Axis`."""
        self.holds += 1
        self.position = self._at(self.holds * TIME)
        return command


class Weight(Still):
    """A weight on its support, as many newtons heavy, that moves 10 um per sample time while it is lifted.

    One that `sticks` does not come down again.
    """

    def __init__(self, force: float, *, sticks: bool = False) -> None:
        self._force, self._down = force, 0.0 if sticks else 1e-5

    def advance(self, command: float) -> float:
        """As `Axis`."""
        up = command > self._force
        self.position = max(0.0, self.position + (1e-5 if up else -self._down))
        return command


def played(axis: Any, *overrides: str, refused: str = "", **values: Any) -> PlayedSession:
    return PlayedSession(scene_of(*overrides), [axis], refused, **values)


def row(session: PlayedSession, item: str) -> StepFinding:
    [found] = [each for each in session.report.findings if each.item == item]
    return found


def test_an_axis_that_drifts_a_quarter_of_the_travel_does_not_stand_still() -> None:
    travel = TRAVELS["m"]
    for part, stands in ((0.2, True), (0.3, False)):
        session = played(Moved(lambda time, part=part: part * travel * time))  # type: ignore[misc]
        assert stand_still(session, 0) is stands
        assert row(session, STANDSTILL).verdict is (StepVerdict.AGREES if stands else StepVerdict.FAILED)
        assert float(row(session, STANDSTILL).found.split()[0]) == pytest.approx(min(part, 0.25) * travel, rel=0.01)


@pytest.mark.slow_but("199-False")
@pytest.mark.parametrize(("counts", "is_told"), [(199, False), (202, True)])
def test_a_distance_of_two_hundred_counts_tells_the_scale_of_the_encoder(counts: int, is_told: bool) -> None:
    session = played(Moved(lambda time: counts * 1e-6 * min(1.0, 10.0 * time)))
    move_by_hand(session, 0)
    rows = [each.item for each in session.report.findings]
    assert ("encoder counts" in rows) is is_told
    if not is_told:
        assert "at least 200" in row(session, "encoder").text


def test_a_person_has_two_minutes_for_a_motion_and_may_leave_it_out(monkeypatch: pytest.MonkeyPatch) -> None:
    session = played(Moved(lambda time: 0.1 * time), "simulation=null", "bus.interface=socketcan", "bus.channel=vcan0")
    move_by_hand(session, 0)
    assert session.played[-1][2] == round(120.0 / TIME)
    monkeypatch.setattr(PlayedSession, "play", lambda *_: OpenLoop())  # the operator's stop before the first cycle
    move_by_hand(session, 0)
    assert session.report.findings[-1][1:4] == ("encoder", "", "not tried")


DRIVE = {(0x1000, 0): 0x00020192, (0x1018, 1): 7, (0x1018, 2): 8, (0x6502, 0): 0x3FF, (0x6076, 0): 10_000}


def identified(*overrides: str, **objects: int) -> PlayedSession:
    changed = {(int(name[1:5], 16), int(name[6:])): value for name, value in objects.items()}
    session = played(Still(), *overrides, objects=DRIVE | changed)
    identify(session)
    return session


def test_each_drive_is_compared_with_its_profile_and_its_dictionary() -> None:
    right = identified()
    verdicts = {each.item: (each.configured, each.found, each.verdict) for each in right.report.findings}
    assert verdicts["device profile"] == ("0x0192", "0x0192", StepVerdict.AGREES)
    assert verdicts["vendor id"] == ("0x00000007", "0x00000007", StepVerdict.AGREES)
    assert verdicts["product code"] == ("0x00000008", "0x00000008", StepVerdict.AGREES)
    assert row(identified(x1000_0=0x00020191), "device profile").verdict is StepVerdict.FAILED
    assert row(identified(x1018_2=9), "product code").verdict is StepVerdict.DIFFERS


def test_a_rated_torque_is_compared_at_the_axis_and_shown_where_none_is_configured() -> None:
    def seen(*overrides: str, counts: int) -> tuple[str, str, StepVerdict]:
        found = row(identified(*overrides, x6076_0=counts), "rated torque (0x6076)")
        return found.configured, found.found, found.verdict

    assert seen(counts=10_000) == ("10 N", "10 N", StepVerdict.AGREES)
    assert seen(counts=10_200) == ("10 N", "10.2 N", StepVerdict.DIFFERS)
    geared = ("axes.0.transmission=4",)
    assert seen(*geared, counts=2_500) == ("10 N", "10 N (2.5 N*m at the motor)", StepVerdict.AGREES)
    assert seen("axes.0.rated_torque=null", counts=9_000) == ("", "9 N", StepVerdict.AGREES)


@pytest.mark.slow
def test_the_hand_is_on_the_handle_for_the_encoder_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sequence, "time_the_cycle", lambda *_: None)
    session = played(Still(), refused="watchdog", objects=DRIVE)
    session.dialogue.choose = lambda *_: "no"
    commission(session, 0.1)
    assert session.hands == [False, True, False, False]  # standstill, encoder, first torque, all that follows


@pytest.mark.slow
def test_an_axis_that_no_pulse_moves_gives_none() -> None:
    session = played(Still())
    assert pulse(session, 0) is None
    assert row(session, "torque sign").found.startswith("no motion at 1 N")
    sizes = [max(map(abs, torques)) for _, torques, _, _ in session.played if torques]
    assert sizes == sorted(sizes)
    assert sizes[0] == session.quanta[0]


class Runaway(Moved):
    """An axis that moves away by itself as soon as a torque acts, a metre in a second."""

    def advance(self, command: float) -> float:
        """As `Axis`."""
        self.position += TIME * (command != 0.0 or self.position > 0.0)
        return command


def test_what_runs_away_loses_its_torque_within_the_guard_and_gets_no_larger_one() -> None:
    session = played(Runaway(lambda _: 0.0), "axes.0.counts_per_unit=2000")
    session.coast = lambda *_: None  # it never rests
    assert pulse(session, 0) is None
    assert (row(session, SIGN).found, row(session, SIGN).text.split(";")[0]) == (
        "stopped", "moved faster than 0.5 m/s, over 4 ms",
    )  # fmt: skip
    assert {max(map(abs, torques)) for _, torques, _, _ in session.played if torques} == {session.quanta[0]}
    assert session.moving[0].position < len(session.played) * 0.006  # of 32 counts, 16 mm, none is used


def test_pulses_of_a_free_mass_give_its_mass_and_one_against_the_encoder_fails() -> None:
    first = pulse(played(FreeMass(MASS, TIME)), 0)
    assert first is not None
    assert first.mass == pytest.approx(MASS, rel=0.1)
    turned = played(FreeMass(-MASS, TIME))
    assert pulse(turned, 0) is None
    assert row(turned, SIGN).verdict is StepVerdict.FAILED


@pytest.mark.slow_but("300")
@pytest.mark.parametrize("counts", [300, 2_000, 60_000])
def test_a_coarse_encoder_tells_the_sign_within_its_guard(counts: int) -> None:
    for mass, verdict in ((MASS, StepVerdict.AGREES), (-MASS, StepVerdict.FAILED)):
        axis = FreeMass(mass, TIME, 1.0 / counts)
        session = played(axis, f"axes.0.counts_per_unit={counts}")
        pulse(session, 0)
        assert row(session, SIGN).verdict is verdict
        assert abs(axis.position) <= session.guard(0, 0.25).travel
        assert {travels for _, torques, _, travels in session.played if torques} == {0.25}


@pytest.mark.slow
def test_an_axis_that_something_else_moves_has_no_sign() -> None:
    """It swings, also without a torque: of 32 times 32 pulses as many move it along their sign as against it."""
    session = played(Moved(lambda time: 1e-4 * np.sin(37.0 * time)))
    session.coast = lambda *_: None
    assert pulse(session, 0) is None
    assert row(session, SIGN).found == "unclear"


def test_the_axis_is_at_rest_within_two_counts_of_a_coarse_encoder() -> None:
    """A millimetre is a count: one that still swings over three is waited for."""
    for counts, waits in ((2.0, False), (2.9, True)):
        axis = Moved(lambda time, counts=counts: 1e-3 * counts * (time % 0.02 > 0.01) * (time < 0.5))  # type: ignore[misc]
        session = played(axis, "axes.0.counts_per_unit=1000")
        session.coast(0)
        assert (axis.holds > 500) is waits


def test_the_torque_of_the_sweep_keeps_a_light_axis_within_its_travel() -> None:
    """A mass m swings by tau / (m w^2) at the lowest frequency, 2.5 Hz: a quarter of the travel."""
    session = played(FreeMass(0.05, 0.01), "bus.rate=100", refused="Reversals")
    identify_dynamics(session, 0, 0.05)
    torques = next(torques for _, torques, _, _ in session.played if torques)
    assert max(torques) == pytest.approx(0.05 * (2.0 * 3.14159265 * 2.5) ** 2 * 0.02 / 4.0, rel=1e-3)


def swept(*overrides: str, mass: float = MASS, count: float = 1e-6) -> PlayedSession:
    """The sweep and the shake of a free mass; the reversals are refused."""
    session = played(FreeMass(mass, TIME, count), *overrides, refused="Reversals")
    identify_dynamics(session, 0, mass)
    return session


def test_a_mass_is_measured_and_compared_with_the_declared_one() -> None:
    right = swept()
    assert row(right, "moving mass")[2:5] == ("0.2 kg (must not exceed the real mass)", "0.25 kg", StepVerdict.AGREES)
    assert row(right, "compliant shaft").verdict is StepVerdict.AGREES
    assert row(right, "compliant shaft").found.startswith("none found: 0.25 kg at 83.3 Hz")
    assert row(right, "dry friction").text.endswith(" N")
    wrong = swept("passivity.moving_mass=0.3")
    assert row(wrong, "moving mass").verdict is StepVerdict.FAILED
    assert "must not exceed" in row(wrong, "moving mass").text


class HungMass(FreeMass):
    """A mass of 5.2 N on a drive with 0.1 N of dry friction."""

    def advance(self, command: float) -> float:
        """As `Axis`."""
        before, brakes = self._speed, self._time * 0.1 / self._mass
        speed = before + self._time * (command - 5.2) / self._mass
        self._speed = max(0.0, speed - brakes) if speed > 0.0 else min(0.0, speed + brakes)
        self._at += self._time * 0.5 * (before + self._speed)
        return command


@pytest.mark.parametrize(("declared", "least", "most"), [(5.2, 0.0, 1e-3), (4.0, 0.01, 0.03)])
def test_between_tests_an_axis_that_hangs_is_held_and_sinks_no_further_than_a_test_may_where_its_weight_is_false(
    declared: float, least: float, most: float
) -> None:
    brake = f"axes.0.brake={{release_time: 0.03, set_time: 0.05, holds_weight: {declared} N}}"
    hung = HungMass(MASS, TIME)
    session = played(hung, brake)
    session.coast(0)
    assert least <= -hung.position <= most


@pytest.mark.slow_but("5.19-*")
@pytest.mark.parametrize(("declared", "verdict"), [(5.2, StepVerdict.AGREES), (5.19, StepVerdict.DIFFERS)])
def test_the_weight_of_an_axis_with_a_brake_is_measured_and_proposed(declared: float, verdict: StepVerdict) -> None:
    brake = f"axes.0.brake={{release_time: 0.03, set_time: 0.05, holds_weight: {declared} N}}"
    session = played(HungMass(MASS, TIME), brake, refused="Reversals")
    identify_dynamics(session, 0, MASS)
    assert row(session, "weight")[3:5] == ("5.2 N", verdict)
    proposed = [value.value for value in session.report.values if value.key == "brake.holds_weight"]
    assert proposed == ([] if verdict is StepVerdict.AGREES else [pytest.approx(5.2, abs=0.02)])


@pytest.mark.parametrize(("declared", "verdict"), [(0.05, StepVerdict.AGREES), (0.2, StepVerdict.FAILED)])
def test_a_dry_friction_that_is_declared_above_the_real_one_is_a_failure(declared: float, verdict: StepVerdict) -> None:
    words = (f"passivity.device_friction={declared}", "passivity.device_friction_bound=0.3")
    brake = "axes.0.brake={release_time: 0.03, set_time: 0.05, holds_weight: 5.2 N}"
    session = played(HungMass(MASS, TIME), brake, *words, refused="Reversals")
    identify_dynamics(session, 0, MASS)
    assert row(session, "dry friction, least").verdict is verdict


def test_a_mass_that_nothing_declares_is_measured_alone() -> None:
    session = swept("passivity={algorithm: unprotected}")
    assert row(session, "moving mass").verdict is StepVerdict.MEASURED


def test_an_axis_that_does_not_move_has_an_unclear_mass_and_names_the_limit_to_raise() -> None:
    for mass, limit in ((MASS, "--travel"), (25.0, "--torque")):  # by the pulse before
        session = played(Still(), "bus.rate=100", refused="Reversals")
        identify_dynamics(session, 0, mass)
        assert row(session, "moving mass").found == "unclear"
        assert f"raise {limit}" in row(session, "moving mass").text


def test_where_no_friction_by_speed_is_known_the_least_one_stays_open_and_not_the_mass(monkeypatch) -> None:
    monkeypatch.setattr(mass_and_friction, "friction_curve", lambda *_: None)
    session = swept()
    assert row(session, "dry friction, least").text.startswith("too little motion in both directions")
    assert row(session, "moving mass").found == "0.25 kg"


def verified(axis: Any, means: str, *overrides: str, number: float | None, **limits: float) -> PlayedSession:
    session = played(axis, *overrides, limits=CommissioningLimits(**limits))
    session.dialogue.choose = lambda *_: means
    session.dialogue.number = lambda *_: number
    verified_axes(session)
    return session


def test_a_known_mass_gives_the_scale_of_the_torque() -> None:
    assert row(verified(FreeMass(MASS, TIME), "mass", number=0.25), SCALE).found == "1"
    assert row(verified(FreeMass(MASS, TIME), "mass", number=0.5), SCALE).found == "2"


class LateMass(FreeMass):
    """A multiple of the booked torque acts a hold late on a light mass that loses a tenth of its speed in a hold."""

    scale = 1.4

    def advance(self, command: float) -> float:
        acts, self._waits = getattr(self, "_waits", 0.0), command
        self._speed *= 0.9
        super().advance(self.scale * acts)
        return command


def test_a_torque_that_acts_late_on_a_damped_mass_gives_its_scale_all_the_same() -> None:
    session = verified(LateMass(0.078, 0.008, 1e-6), "mass", "bus.rate=125", number=0.078, travel=0.08)
    assert float(row(session, SCALE).found) == pytest.approx(1.4, rel=0.05)
    assert row(session, SCALE).verdict is StepVerdict.DIFFERS


def test_a_torque_that_acts_late_on_a_damped_mass_makes_no_mass_too_large_to_declare(monkeypatch) -> None:
    """The mass of 0.25 kg would be found as 0.275."""
    monkeypatch.setattr(mass_and_friction, "time_the_torque", lambda *_: (0.008, 1e-5))
    late = LateMass(MASS, 0.008, 1e-6)
    late.scale = 1.0
    session = played(late, "bus.rate=125")
    identify_dynamics(session, 0, MASS)
    assert float(row(session, "moving mass").found.split()[0]) == pytest.approx(MASS, rel=0.02)
    [declared] = [value.value for value in session.report.values if value.key == "passivity.moving_mass"]
    assert isinstance(declared, float)
    assert declared <= 0.9 * 1.02 * MASS


def test_the_parts_of_a_doublet_are_four_cycles_at_least() -> None:
    """A light axis at a slow rate would leave its travel within one or two, which no encoder resolves."""
    session = verified(FreeMass(0.00083, 0.01), "mass", "bus.rate=100", number=0.00083, travel=0.08)
    parts = [torques for _, torques, _, travels in session.played if torques and travels == 1.0]
    assert parts
    for torques in parts:
        assert max(len(list(part)) for _, part in groupby(torques)) == 2 * 4  # of the two middle parts together


def weighed(force: float, number: float | None, *, sticks: bool = False) -> tuple[str, StepVerdict]:
    session = verified(
        Weight(force, sticks=sticks), "weight", "bus.rate=100", "axes.0.torque_limit=1 N", number=number, torque=0.05
    )
    found = row(session, SCALE)
    return found.found, found.verdict


def test_a_weight_that_is_lifted_and_comes_down_gives_the_scale_and_one_that_stays_up_none() -> None:
    ratio, verdict = weighed(0.3, 0.3)
    assert verdict is StepVerdict.AGREES
    assert float(ratio) == pytest.approx(1.0, abs=0.05)
    assert weighed(0.3, 0.3, sticks=True) == ("not compared", StepVerdict.UNKNOWN)
    assert weighed(0.3, None) == ("not compared", StepVerdict.UNKNOWN)


def test_a_weight_counts_as_down_as_soon_as_it_has_come_back_by_what_counts_as_lifted() -> None:
    law = RisingTorque(0.25, 4.0, 1, Guard(8.0, 8.0), 0.5, lifts=True)
    for position in (0.0, 0.0, 1.0, 1.0, 0.5):
        law.step(position, 0.0)
    assert law.up > 0.0
    assert law.down > 0.0
    assert law.has_ended


class TimedSession(PlayedSession):
    """A run at some pace whose latest SYNC was 25 us late; nothing was lost."""

    pace = "free"

    @property
    def experiment(self) -> Any:
        """As built."""
        return SimpleNamespace(pace=self.pace)

    @property
    def rig(self) -> Any:
        """A rig that lost nothing."""
        counts = dict.fromkeys(("skipped_syncs", "missed_tpdos", "late", "error_frames"), 0)
        return SimpleNamespace(link_statistics=lambda: counts, buses=())

    def run(self, laws: Sequence[OpenLoop], cycles: int, ready: Callable[[], bool] = bool) -> Any:
        """The times of a run."""
        histogram = DurationHistogram()
        histogram.add(25_000)
        return SimpleNamespace(cycles=cycles, timing={"wakeup_lateness": histogram})


@pytest.mark.parametrize(
    ("pace", "declared", "proposed"), [("free", 0.03, 0.03), ("free", 0.0, 0.01), ("real", 0.03, 0.05)]
)
def test_the_jitter_to_declare_is_twice_what_was_seen_where_a_clock_ran(pace: str, declared: float, proposed: float):
    session = TimedSession(scene_of(f"passivity.sync_jitter={declared}"), [Still()])
    session.pace = pace
    time_the_cycle(session, 0.5)
    [found] = [value.value for value in session.report.values if value.key == "passivity.sync_jitter"]
    assert found == pytest.approx(proposed)
    assert row(session, "cycle").found == "500 cycles, no frame lost"
    assert session.report.findings[-1].item == ("timing" if pace == "free" else "wakeup lateness")
