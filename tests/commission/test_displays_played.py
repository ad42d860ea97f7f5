"""What the steps of an admittance display conclude, from a velocity loop whose motion is computed here."""

import math
from pathlib import Path

import numpy as np
import pytest

from canhaptic.commission.admittance_tests import commission_displays
from canhaptic.commission.session import StepVerdict
from canhaptic.scene.load import load_scene
from tests.commission.played import PlayedSession

CONFIGS = Path(__file__).parents[2] / "configs" / "admittance"


class Display:
    """A drive that follows a velocity, M v' = F - c (v - r) - friction, while a hand pushes and pulls it.

    Args:
        rate: Of the bus [Hz].
        mass: [kg].
        gain: c [N*s/m].
        friction: Dry [N].
        is_mean: Whether the sensor shows the mean force of the hold, and not that at its end.
        late: Holds by which the sensor is late.
    """

    def __init__(
        self, rate: float, mass: float = 2.0, gain: float = 630.0, friction: float = 0.0,
        *, is_mean: bool = False, late: int = 0,
    ) -> None:  # fmt: skip
        self.position = self._speed = self._now = 0.0
        self._mass, self._gain, self._friction, self._is_mean = mass, gain, friction, is_mean
        self._steps = max(4, round(2000.0 / rate))
        self._step = 1.0 / rate / self._steps
        self._shown = [0.0] * late

    def push(self, time: float) -> float:
        """Force of the hand [N]."""
        slow = 6.0 * math.sin(2.0 * math.pi * 0.7 * time) + 3.0 * math.sin(2.0 * math.pi * 5.3 * time)
        return slow + 2.0 * math.sin(2.0 * math.pi * 23.0 * time)

    def advance(self, command: float) -> float:
        """Let a velocity act for one hold; return minus the force that the sensor shows."""
        total = 0.0
        for _ in range(self._steps):
            force = self.push(self._now + 0.5 * self._step)
            total += force
            braked = self._friction * ((self._speed > 0.0) - (self._speed < 0.0))
            before = self._speed
            rate = (force - braked + self._gain * (command - before)) / (self._mass + 0.5 * self._gain * self._step)
            self._speed += rate * self._step
            self.position += 0.5 * (before + self._speed) * self._step
            self._now += self._step
        shown = total / self._steps if self._is_mean else self.push(self._now)
        self._shown.append(shown)
        return -self._shown.pop(0)


def commissioned(display: Display, *overrides: str, rate: float = 500.0, refused: str = "") -> PlayedSession:
    scene = load_scene(CONFIGS / "virtual_mass.yaml", [f"bus.rate={rate}", *overrides])
    session = PlayedSession(scene, [display], refused)
    commission_displays(session)
    return session


@pytest.fixture(scope="module")
def right() -> PlayedSession:
    """A display as the scene declares it."""
    return commissioned(Display(500.0))


def rows(session: PlayedSession) -> dict[str, tuple[str, StepVerdict]]:
    return {row.item: (row.configured, row.verdict) for row in session.report.findings}


def values(session: PlayedSession) -> dict[str, object]:
    return {value.key: value.value for value in session.report.values}


def number(session: PlayedSession, item: str) -> float:
    [found] = [row.found for row in session.report.findings if row.item == item]
    return float(found.split()[0])


def test_each_row_says_what_was_declared_and_agrees_where_it_is_an_over_estimate(right: PlayedSession) -> None:
    assert rows(right) == {
        "force at rest": ("error 0.05 N", StepVerdict.DIFFERS),  # the hand of this test never lets go
        "sign of the force": ("0.01", StepVerdict.AGREES),
        "latency of the force": ("0 samples", StepVerdict.AGREES),
        "friction of the drive": ("", StepVerdict.MEASURED),
        "mass of the drive": ("2.1 kg, an over-estimate", StepVerdict.AGREES),
        "gain of the velocity loop": ("660 N*s/m, an over-estimate", StepVerdict.AGREES),
    }
    assert number(right, "mass of the drive") == pytest.approx(2.0, rel=0.01)
    assert number(right, "gain of the velocity loop") == pytest.approx(630.0, rel=0.01)
    assert "passivity.drive_mass" not in values(right)
    assert right.hands == [False, True]


def test_a_hand_may_push_the_display_three_times_as_far_as_a_torque_and_the_chirp_ends_with_two_cycles(right):
    _, speeds, cycles, travels = right.played[-1]
    assert (cycles, travels) == (len(speeds) + 2, 3.0)


def test_the_chirp_stays_below_a_tenth_of_the_rate() -> None:
    """Faster ones are averaged away by the holds."""
    session = commissioned(Display(200.0), rate=200.0)
    speeds = np.array(session.played[-1][1])
    turns = np.flatnonzero(np.diff(np.signbit(speeds)))
    fastest = 200.0 / (2.0 * np.diff(turns)[-8:].mean())  # [Hz]
    assert 17.0 < fastest < 21.0


@pytest.mark.parametrize("sampling", ["point", "mean"])
def test_a_force_is_averaged_as_the_sensor_takes_it(sampling: str) -> None:
    display = Display(200.0, is_mean=sampling == "mean")
    session = commissioned(display, f"axes.0.admittance.force.sampling={sampling}", rate=200.0)
    assert rows(session)["latency of the force"] == ("0 samples", StepVerdict.AGREES)
    assert number(session, "mass of the drive") == pytest.approx(2.0, rel=0.03)
    assert number(session, "gain of the velocity loop") == pytest.approx(630.0, rel=0.02)


def test_a_drive_lighter_than_declared_is_covered_unless_force_and_motion_are_compared() -> None:
    """Declared are 2.1 kg. With `drive_friction` the mass must also be at least 1 - spread of them."""
    light = commissioned(Display(500.0, mass=1.5))
    assert rows(light)["mass of the drive"][1] is StepVerdict.AGREES
    compared = commissioned(Display(500.0, mass=1.5), "passivity.drive_friction=0.5")
    assert rows(compared)["mass of the drive"][1] is StepVerdict.DIFFERS
    assert values(compared)["passivity.drive_mass"] == pytest.approx(1.1 * 1.5, rel=0.02)


def test_friction_beyond_the_declared_one_is_proposed_with_a_margin_for_rest() -> None:
    rough = commissioned(Display(500.0, friction=3.0), "passivity.drive_friction=0.5")
    assert rows(rough)["friction of the drive"] == ("0.5 N, an over-estimate", StepVerdict.DIFFERS)
    measured = number(rough, "friction of the drive")
    assert measured == pytest.approx(3.0, rel=0.2)
    assert values(rough)["passivity.drive_friction"] == pytest.approx(1.3 * measured, rel=0.01)
    covered = commissioned(Display(500.0, friction=3.0), "passivity.drive_friction=6")
    assert rows(covered)["friction of the drive"] == ("6 N, an over-estimate", StepVerdict.AGREES)
    assert "passivity.drive_friction" not in values(covered)


def test_units_are_those_of_the_axis(right: PlayedSession) -> None:
    found = {row.item: row.found.split()[-1] for row in right.report.findings}
    assert found["friction of the drive"] == "N"
    assert found["mass of the drive"] == "kg"
    assert found["gain of the velocity loop"] == "N*s/m"


def test_a_refusal_before_the_drive_is_enabled_is_a_row_of_the_first_axis_and_the_end() -> None:
    session = commissioned(Display(500.0), refused="hands off")
    assert [(row.axis, row.item, row.found) for row in session.report.findings] == [("handle", "sensor", "not tried")]
    assert session.played == []


def test_the_axes_of_a_group_are_judged_by_the_group_and_the_comment_names_it() -> None:
    scene = load_scene(CONFIGS / "guided_path.yaml", ["bus.rate=500"])
    session = PlayedSession(scene, [Display(500.0), Display(500.0, mass=3.0)])
    commission_displays(session)
    masses = [(row.configured, row.verdict) for row in session.report.findings if row.item == "mass of the drive"]
    assert masses == [
        ("2.1 kg, an over-estimate", StepVerdict.AGREES),
        ("2.1 kg, an over-estimate", StepVerdict.DIFFERS),
    ]
    [comment] = [value.comment for value in session.report.values if value.key == "passivity.drive_mass"]
    assert comment.endswith("in the group stage, the largest of its axes")
    alone = commissioned(Display(500.0, mass=3.0))
    [comment] = [value.comment for value in alone.report.values if value.key == "passivity.drive_mass"]
    assert "group" not in comment
