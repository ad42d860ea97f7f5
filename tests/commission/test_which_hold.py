"""The hold in which a torque acts, found from the motion; judged by the plant that moved."""

from itertools import count

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from canhaptic.commission.session import Report, StepVerdict, reversals
from canhaptic.commission.which_hold import TorqueDelay, _age, _remedy, _response, estimate_delay
from canhaptic.cycle import run
from canhaptic.drive.exchange import Exchange
from canhaptic.scene.build import build, experiment_account
from canhaptic.scene.load import load_scene
from canhaptic.sim.plant.effects import Effect
from canhaptic.sim.plant.effects.coulomb_friction import CoulombFriction
from canhaptic.sim.plant.effects.current_loop import CurrentLoop
from canhaptic.sim.plant.effects.shaft_compliance import ShaftCompliance
from canhaptic.sim.plant.plant import Plant, PlantParameters
from tests.commission.test_commissioning import commissioned, row, value
from tests.commission.test_torque_lag import timed
from tests.commission.whole_session import DEMO
from tools.late_twins import outcome_of

TIME = 1e-3
AHEAD = 4  # SYNCs before the first torque
EFFECTS: dict[str, list[Effect]] = {
    "nothing": [],
    "lag": [CurrentLoop(time_constant=600e-6)],
    "a lag of a hold": [CurrentLoop(time_constant=1e-3)],
    "friction": [CoulombFriction(kinetic=0.2, static=0.3)],
    "shaft": [ShaftCompliance(stiffness=2e4, damping=1.0, load_mass=0.15), CurrentLoop(time_constant=300e-6)],
}


def delay_of(effects: list[Effect], hold: int, count: float = 1e-6, doublets: int = 24) -> TorqueDelay:
    """What reversals of 1 N find, on 0.25 kg and a coarse encoder, of a torque that acts some holds late."""
    torques = np.array(reversals(1.0, 36, doublets))
    plant = Plant(PlantParameters(mass=0.25, damping=0.2), None, effects, 1_000_000)
    moved = plant.run(np.concatenate([np.zeros(AHEAD + hold), torques, np.zeros(AHEAD - hold)]))
    positions = np.floor(np.concatenate([[0.0], moved]) / count + 0.3) * count
    found = estimate_delay(positions, np.concatenate([np.zeros(AHEAD + 1), torques, np.zeros(AHEAD)]), TIME, 12)
    assert found is not None
    return found


@pytest.mark.slow_but("lag--1")
@pytest.mark.parametrize("hold", [-1, 0, 1, 2])
@pytest.mark.parametrize("effects", EFFECTS)
def test_the_hold_is_found_with_any_lag_the_friction_and_the_shaft(effects: str, hold: int) -> None:
    found = delay_of(EFFECTS[effects], hold)
    assert found.hold(0.25) == hold
    assert found.low - 0.1 <= hold <= found.high + 0.1
    assert found.high - found.low < 0.9


@pytest.mark.slow
def test_strong_damping_is_part_of_the_model_and_not_taken_for_a_resonance() -> None:
    """Twin 983: 62 g, 0.69 N*s/m, 145 us of lag, two SYNCs late; the torque before the window brakes within it too."""
    torques, hold = np.array(reversals(0.95, 16, 32)), 2
    plant = Plant(PlantParameters(mass=0.06232, damping=0.6929), None, [CurrentLoop(time_constant=145e-6)], 1_000_000)
    moved = plant.run(np.concatenate([np.zeros(AHEAD + hold), torques, np.zeros(AHEAD - hold)]))
    positions = np.floor(np.concatenate([[0.0], moved]) * 236_600) / 236_600
    found = estimate_delay(positions, np.concatenate([np.zeros(AHEAD + 1), torques, np.zeros(AHEAD)]), TIME, 5)
    assert found is not None
    assert (found.is_explained, found.hold(0.25)) == (True, hold)


@pytest.mark.slow
def test_a_motion_that_is_no_model_of_a_rig_tells_no_hold() -> None:
    generator = np.random.default_rng(3)
    torques = np.concatenate([np.zeros(5), reversals(1.0, 36, 16)])
    positions = np.cumsum(np.abs(generator.normal(size=len(torques))))  # one way, and without any torque
    found = estimate_delay(positions, torques, TIME, 12)
    assert found is None or found.hold(0.25) is None


def test_too_few_reversals_or_an_axis_that_turns_tells_nothing() -> None:
    torques = np.concatenate([np.zeros(20), reversals(1.0, 36, 16), np.zeros(20)])
    assert estimate_delay(np.zeros(len(torques)), torques, TIME, 12) is None
    assert estimate_delay(np.arange(100.0), torques[:100], TIME, 12) is None


@pytest.mark.parametrize(
    ("low", "high", "hold"),
    [
        (-1.1, -0.7, -1), (-0.1, 0.1, 0), (0.9, 1.3, 1), (1.5, 2.1, 2),  # one of the holds alone
        (-0.8, 0.0, None), (0.1, 1.0, None), (-1.3, 0.0, None),  # two of them, or too wide
        (0.4, 0.7, 0), (-0.6, -0.4, -1),  # none at its begin: late within it
        (0.5, 1.4, 1), (2.4, 2.8, 2),
    ],
)  # fmt: skip
def test_a_hold_is_named_where_one_alone_is_possible(low: float, high: float, hold: int | None) -> None:
    found = TorqueDelay((low + high) / 2.0, low, high, 0.1, is_explained=True)
    assert found.hold(0.25) == hold
    assert found._replace(is_explained=False).hold(0.25) is None


@pytest.mark.slow
@given(st.floats(0.05, 2.0), st.floats(0.0, 2.0), st.sampled_from([None, (0.3, 0.05), (1.2, 0.2)]))
def test_the_response_to_a_step_is_that_of_the_differential_equations(lag, begin, mode) -> None:
    """Runge-Kutta of lag' = (1 - torque) / lag, and of a mass or an oscillator that the torque drives."""
    root, damping = mode or (0.0, 0.0)

    def rate(state: np.ndarray) -> np.ndarray:
        torque, position, speed = state
        force = torque - 2.0 * damping * root * speed - root * root * position
        return np.array([(1.0 - torque) / lag, speed, force])

    state, step, steps = np.zeros(3), 0.01, 800
    for _ in range(steps):
        a = rate(state)
        b = rate(state + 0.5 * step * a)
        c = rate(state + 0.5 * step * b)
        state = state + step / 6.0 * (a + 2.0 * b + 2.0 * c + rate(state + step * c))
    [found] = _response(np.array([begin + steps * step]) - begin, lag, mode)
    assert found == pytest.approx(state[1], rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("age", [0, 1, 3])
def test_the_age_of_a_read_back_is_the_shift_that_explains_it(age: int) -> None:
    commands = np.array(reversals(1.0, 12, 8))
    shown = np.concatenate([np.zeros(age), commands])[: len(commands)]
    assert _age(commands, shown) == age
    assert _age(commands, 0.95 * shown) == age
    assert _age(commands, np.zeros(len(commands))) is None


# --- of a whole drive ---------------------------------------------------------------------------------------------


def verdicts(report: Report) -> list[StepVerdict]:
    return [row(report, item).verdict for item in ("command to motion", "command to read-back", "read-back to motion")]


AGREES, DIFFERS, FAILED = StepVerdict.AGREES, StepVerdict.DIFFERS, StepVerdict.FAILED


@pytest.mark.slow_but("early")
@pytest.mark.parametrize(
    ("overrides", "expected", "proposed"),
    [
        ((), [AGREES, AGREES, AGREES], {}),
        (("simulation.drive.acts_at_once=true",), [FAILED, DIFFERS, AGREES], {}),
        (("simulation.drive.syncs_late=1",), [DIFFERS, DIFFERS, AGREES], {"quirks": "[acts_a_sync_late]"}),
        (("simulation.drive.syncs_late=2",), [FAILED, DIFFERS, AGREES], {}),
        (("axes.0.quirks=[acts_a_sync_late]",), [AGREES, AGREES, AGREES], {}),
        (
            ("axes.0.quirks=[acts_a_sync_late]", "simulation.drive.syncs_late=0"),
            [DIFFERS, DIFFERS, AGREES],
            {"quirks": "[]"},
        ),
        (
            ("simulation.drive.torque_read_back=after_update",),
            [AGREES, DIFFERS, DIFFERS],
            {"demand_reported": "after"},
        ),
        (
            ("simulation.drive={syncs_late: 1, torque_read_back: after_update, objects: {0x6502: 0x200}}",),
            [DIFFERS, AGREES, DIFFERS],
            {"quirks": "[acts_a_sync_late]", "demand_reported": "after"},
        ),
        (("axes.0.demand_reported=after", "simulation.drive.torque_read_back=before_update"),
         [AGREES, DIFFERS, DIFFERS], {"demand_reported": "before"}),
        (("bus.rpdo=event", "simulation.drive.acts_at_once=true"), [AGREES, AGREES, AGREES], {}),
    ],
    ids=["right", "early", "late", "later", "late_declared", "late_untrue", "after", "late_after", "before", "event"],
)  # fmt: skip
def test_motion_is_timed_against_the_commands_and_the_read_back_separately(overrides, expected, proposed):
    session, _ = timed(*overrides)
    report = session.report
    assert verdicts(report) == expected
    found = {v.key: v.value for v in report.values if v.value is not None and "passivity" not in v.key}
    assert ("hold_checked" in found) is (expected[0] is AGREES)
    assert {key: value for key, value in found.items() if key != "hold_checked"} == proposed
    if expected[0] is FAILED and "acts_at_once" in overrides[0]:
        assert "declare rpdo: event" in row(report, "command to motion").text
        assert not [v for v in report.values if v.key.startswith("passivity")]


@pytest.mark.slow
@pytest.mark.parametrize("drive", ["acts_at_once=true", "syncs_late=1"])
def test_a_hold_that_is_not_the_declared_one_is_found_without_a_read_back(drive: str) -> None:
    report = commissioned(f"simulation.drive.{drive}", "axes.0.read_back=none")
    found = row(report, "command to motion")
    assert found.verdict is (FAILED if "at_once" in drive else DIFFERS)
    assert row(report, "command to read-back").found == "none"


@pytest.mark.slow
def test_what_commissioning_proposes_for_a_late_drive_agrees_when_it_is_done_again() -> None:
    late = "simulation.drive.syncs_late=1"
    quirks = value(commissioned(late), "quirks")
    again = commissioned(late, f"axes.0.quirks={quirks}")
    assert verdicts(again) == [AGREES, AGREES, AGREES]
    assert not again.differs


@pytest.mark.slow
@pytest.mark.parametrize("seed", [*range(6), 983])
def test_of_random_twins_no_hold_is_wrong(seed: int) -> None:
    found = outcome_of(seed)
    assert found.hold in (None, found.true_hold)


@pytest.mark.slow
@pytest.mark.campaign
@pytest.mark.timeout(14_400)
def test_of_a_thousand_random_twins_no_hold_or_read_back_is_wrong_and_few_holds_are_unclear() -> None:
    twins = [outcome_of(seed) for seed in range(1000)]
    assert [of for of in twins if of.hold not in (None, of.true_hold) or of.wrong_read_back] == []
    assert sum(of.hold is None for of in twins) <= 50


@pytest.mark.slow
def test_a_torque_too_small_for_its_encoder_tells_no_hold_but_the_torque_that_does() -> None:
    found = delay_of([], 0, count=1e-4, doublets=12)
    assert found.hold(0.25) is None
    assert "too coarse" in _remedy(found)
    assert "about 4 times" in _remedy(found._replace(low=-0.4, high=0.2))
    assert "let go of the handle" in _remedy(found._replace(is_explained=False))


@pytest.mark.slow
def test_a_skipped_sync_costs_the_windows_around_it_and_not_the_test(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every 300 cycles the host is held up by two sample times: that hold is three times as long as it counts."""
    regular, calls, skipped = Exchange._wait, count(), []

    def held_up(exchange: Exchange) -> int:
        if next(calls) % 300 == 299:
            exchange.wait_until(exchange.pace.due + 2 * exchange.pace.period)
        woken = regular(exchange)
        skipped.append(exchange.pace.skipped)
        return woken

    monkeypatch.setattr(Exchange, "_wait", held_up)
    session, _ = timed()
    assert max(skipped) >= 4
    assert verdicts(session.report) == [AGREES, AGREES, AGREES]


@pytest.mark.slow_but("8-False")
@pytest.mark.parametrize(("serial", "is_checked"), [(7, True), (8, False)])
def test_a_check_of_the_hold_is_of_the_drive_that_was_tried(serial: int, *, is_checked: bool) -> None:
    objects = "simulation.drive.objects={{0x6502: 0x200, '0x1018.4': {}}}"
    with build(load_scene(DEMO, [objects.format(7)])) as experiment:
        run(experiment.cycle, 2)
        signature = experiment.rig.drives[0].signature()
        assert experiment_account(experiment, "completed", 1.0)["ports"]["handle"]["hold"] == "by construction"
    for rate, expected in (("1 kHz", is_checked), ("500 Hz", False)):
        values = [objects.format(serial), f"axes.0.hold_checked={signature}", f"bus.rate={rate}"]
        with build(load_scene(DEMO, values)) as experiment:
            run(experiment.cycle, 2)
            said = experiment_account(experiment, "completed", 1.0)["ports"]["handle"]["hold"]
        assert said == ("checked at commissioning" if expected else "not checked")


@pytest.mark.slow
def test_a_motion_that_is_none_of_the_models_is_found_and_said_to_be_unexplained() -> None:
    """Each reversal is followed by a kick that no torque gave."""
    torques = np.concatenate([np.zeros(5), reversals(1.0, 16, 12), np.zeros(6)])
    speeds = np.cumsum(torques[1:]) * TIME / 0.25
    positions = np.concatenate(
        [[0.0], np.cumsum(np.concatenate([[0.0], speeds[:-1]]) * TIME + 0.5 * torques[1:] * TIME**2 / 0.25)]
    )
    steps, kick = np.abs(np.diff(positions)), np.array([0, 0, 0, 1, 0, 0, -1, 0, 1, 0, 0])
    for turn in np.flatnonzero(torques[:-1] * torques[1:] < 0.0):
        if 5 <= turn < len(positions) - 6:
            size = 0.15 * np.median(steps[turn - 5 : turn + 5]) * np.sign(torques[turn + 1])
            positions[turn - 5 : turn + 6] += size * kick
    found = estimate_delay(positions, torques, TIME, 5)
    assert found is not None
    assert not found.is_explained


def test_a_reaction_longer_than_a_hold_counts_as_one() -> None:
    """A torque that begins 0.1 to 0.3 sample times after its SYNC acts in its own hold however slow the bus is."""
    found = TorqueDelay(0.2, 0.1, 0.3, 0.0, is_explained=True)
    assert [found.hold(reaction) for reaction in (0.2, 1.0, 1.5, 9.0)] == [0, 0, 0, 0]
