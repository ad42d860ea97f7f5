"""How late a torque acts: what is declared bounds what the plant does, and the wall is kept."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canhaptic.commission import mass_and_friction
from canhaptic.commission.mass_and_friction import (
    estimate,
    estimate_lateness,
    is_dear,
    needed_allowance,
    propose_allowance,
    time_the_torque,
)
from canhaptic.commission.session import CommissioningLimits, OpenLoop, Session, StepVerdict, reversals
from canhaptic.scene.first_contact import share_of_wall
from canhaptic.scene.load import load_scene
from canhaptic.sim.plant.effects.coulomb_friction import CoulombFriction
from canhaptic.sim.plant.effects.current_loop import CurrentLoop
from canhaptic.sim.plant.effects.stribeck_friction import StribeckFriction
from canhaptic.sim.plant.plant import Plant, PlantParameters
from tests.commission.test_commissioning import Answers, row, value
from tests.commission.whole_session import DEMO
from tests.drawn import examples

TIME = 1e-3
MASS = 0.25
FRICTIONS = {
    "none": None,
    "dry": CoulombFriction(kinetic=0.2, static=0.25),
    "falling": StribeckFriction(kinetic=0.2, static=0.4, stribeck_velocity=0.05),
}


def measured(lag: float, damping: float, friction: str, count: float, offset: float = 0.0) -> tuple[float, float]:
    """What reversals of 1 N find, on 0.25 kg and an encoder of finite counts."""
    effects = [effect for effect in (FRICTIONS[friction], CurrentLoop(time_constant=lag) if lag else None) if effect]
    torques = np.array(reversals(1.0, 36, 32))
    positions = Plant(PlantParameters(mass=MASS, damping=damping), None, effects, 1_000_000).run(torques)
    shown = np.floor((np.concatenate([[0.0], positions]) + offset) / count) * count
    late = estimate_lateness(shown, np.concatenate([[0.0], torques]), TIME, 12)
    assert late is not None
    return late


@pytest.mark.slow_but("dry")
@pytest.mark.parametrize("friction", FRICTIONS)
def test_a_first_order_lag_is_found_whatever_the_friction(friction: str) -> None:
    late, error = measured(300e-6, 0.1, friction, 1e-6)
    assert late == pytest.approx(300e-6, abs=40e-6 if friction == "falling" else 6e-6)
    assert error < 20e-6


def test_a_hold_of_three_sample_times_costs_its_windows_and_not_the_lag() -> None:
    """Where a SYNC was skipped the position is not a number; counted as one sample time it would be a wrong lag."""
    torques = np.array(reversals(1.0, 36, 32))
    plant = PlantParameters(mass=MASS, damping=0.1)
    skipped = np.arange(90, len(torques), 137)
    long = np.repeat(torques, np.where(np.isin(np.arange(len(torques)), skipped), 3, 1))
    shown = np.concatenate([[0.0], Plant(plant, None, [CurrentLoop(time_constant=300e-6)], 1_000_000).run(long)])
    ends = np.cumsum(np.where(np.isin(np.arange(len(torques)), skipped), 3, 1))
    positions, applied = np.concatenate([[0.0], shown[ends]]), np.concatenate([[0.0], torques])
    law = OpenLoop()
    law.positions, law.skipped = list(positions), [int(sync) + 1 for sync in skipped]
    blind = estimate_lateness(positions, applied, TIME, 12)
    late = estimate_lateness(law.regular_positions(), applied, TIME, 12)
    assert late is not None
    assert blind is not None
    assert late[0] == pytest.approx(300e-6, abs=10e-6)
    assert abs(blind[0] - 300e-6) > 3 * abs(late[0] - 300e-6)
    found, wrong = (estimate(shown, applied, TIME, 12) for shown in (law.regular_positions(), positions))
    assert found is not None
    assert wrong is not None
    assert found.mass == pytest.approx(MASS, rel=0.02)
    assert abs(wrong.mass - MASS) > 2 * abs(found.mass - MASS)


@pytest.mark.slow
@settings(max_examples=examples(100), deadline=None)
@given(
    lag=st.floats(0.0, 900e-6),
    damping=st.sampled_from([0.0, 0.1, 1.0]),
    friction=st.sampled_from(list(FRICTIONS)),
    count=st.sampled_from([1e-6, 1e-5, 5e-5]),
    offset=st.floats(0.0, 5e-5),
)
def test_what_would_be_declared_bounds_the_lag(lag: float, damping: float, friction: str, count: float, offset: float):
    late, error = measured(lag if lag > 1e-6 else 0.0, damping, friction, count, offset)
    assert lag <= mass_and_friction._at_most((late, error)) + 1e-6


def timed(*overrides: str) -> tuple[Session, Answers]:
    """The test of the lag alone, of the demo."""
    said = Answers()
    session = Session(load_scene(DEMO, list(overrides)), said, CommissioningLimits(), lambda: False)
    with session.rig_of(with_hand=False):
        time_the_torque(session, 0, 1.0, MASS, {})
    return session, said


@pytest.mark.slow
def test_what_the_test_cannot_exclude_is_declared_where_less_was_configured() -> None:
    """The row and the value say the same; a window of 0, as in lock-step, is never written: it declares nothing."""
    session, _ = timed("bus.rpdo=synchronous")
    found, lag = row(session.report, "torque lag"), float(value(session.report, "passivity.current_lag"))
    assert (found.configured, found.verdict) == ("none", StepVerdict.MEASURED)
    assert found.text == f"current_lag {lag * 1e6:.3g} us is safe"
    assert "passivity.torque_window" not in [each.key for each in session.report.values]
    session, _ = timed("passivity.torque_window=50 us")
    assert float(value(session.report, "passivity.torque_window")) == pytest.approx(50e-6)


@pytest.mark.slow
def test_a_torque_that_acts_before_its_sync_fails_and_bounds_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mass_and_friction, "estimate_lateness", lambda *_: (-1e-3, 1e-5))
    session, _ = timed()
    assert row(session.report, "torque lag").verdict is StepVerdict.FAILED
    assert not [found for found in session.report.values if found.key.startswith("passivity")]


@pytest.mark.slow
def test_a_test_that_leaves_too_much_open_is_repeated_longer(monkeypatch: pytest.MonkeyPatch) -> None:
    lengths: list[int] = []

    def uncertainty(positions: np.ndarray, *_: object) -> tuple[float, float]:
        lengths.append(len(positions))
        return (-387e-6, 660e-6) if len(lengths) < 3 else (-100e-6, 60e-6)

    monkeypatch.setattr(mass_and_friction, "_DOUBLETS", (8, 16, 32, 64))
    monkeypatch.setattr(mass_and_friction, "estimate_lateness", uncertainty)
    session, said = timed()
    assert len(lengths) == 3
    assert lengths[0] * 1.8 < lengths[1] < lengths[2] / 1.8
    assert len([line for line in said.said if "costs too much of the wall" in line or "which hold" in line]) == 2
    assert value(session.report, "passivity.current_lag") == pytest.approx(1.1 * 180e-6)
    assert "energy_allowance" not in str(session.report.values)


@pytest.mark.slow
def test_a_lag_that_ends_the_wall_is_declared_with_the_allowance_that_keeps_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mass_and_friction, "_DOUBLETS", (2, 4))
    monkeypatch.setattr(mass_and_friction, "estimate_lateness", lambda *_: (-387e-6, 500e-6))
    session, _ = timed()
    lag, allowance = (float(value(session.report, f"passivity.{key}")) for key in ("current_lag", "energy_allowance"))
    axis = session.scene.axes[0]
    assert lag == pytest.approx(1.65e-3)
    assert share_of_wall(axis, 0.5, {"current_lag": lag, "energy_allowance": allowance}) > 0.9
    assert allowance < 3e-3


@pytest.mark.slow
def test_an_allowance_is_proposed_once_and_only_where_none_is_declared() -> None:
    session, _ = timed()
    known = {"moving_mass": 0.2, "device_damping_bound": 0.5, "device_friction_bound": 1.0}
    for _ in range(2):
        propose_allowance(session, 0, known)
    proposed = [each for each in session.report.values if each.key == "passivity.energy_allowance"]
    assert len(proposed) == 1
    assert float(proposed[0].value or 0.0) >= 3.0 * 1e-6 / 0.2 / 4.0
    assert proposed[0].comment.startswith(
        "the handle may give out this much more than it received since the start: 0.2 kg at "
    )


@pytest.mark.slow
def test_the_wall_ends_where_a_hold_is_over_before_its_torque_acts() -> None:
    """(2) of `hold_timing`: with theta = T a contact may give back what its own motion brings in."""
    axis = load_scene(DEMO).axes[0]
    shares = [share_of_wall(axis, 0.5, {"current_lag": lag * 1e-3}) for lag in (0.0, 0.6, 1.0)]
    assert shares[0] == pytest.approx(1.0)
    assert shares[1] > 0.9
    assert shares[2] == 0.0
    assert is_dear(axis, 0.5, {}, {"current_lag": 1e-3})
    assert not is_dear(axis, 0.5, {}, {"current_lag": 0.6e-3})


@pytest.mark.slow
def test_no_allowance_keeps_a_wall_that_is_far_too_late() -> None:
    assert needed_allowance(load_scene(DEMO).axes[0], 0.5, {}, {"current_lag": 0.02}) is None


@pytest.mark.parametrize("scene", ["xy_box.yaml", "admittance/virtual_mass.yaml"])
def test_of_what_renders_no_wall_by_itself_nothing_is_judged(scene: str) -> None:
    axis = load_scene(Path(DEMO).with_name(scene) if "/" not in scene else Path(DEMO).parent / scene).axes[0]
    assert share_of_wall(axis, 0.5, {"current_lag": 0.02}) == 1.0


def test_reversals_bring_a_mass_back_and_are_of_both_signs_and_many_lengths() -> None:
    torques = np.array(reversals(1.0, 24, 16))
    assert np.array_equal(torques, reversals(1.0, 24, 16))
    assert abs(np.cumsum(torques)[-1]) < 1e-12
    assert abs(np.cumsum(np.cumsum(torques))[-1]) <= np.abs(np.cumsum(torques)).max() * 16
    assert 0.6 <= np.abs(torques).min() < 0.7
    assert 0.95 < np.abs(torques).max() <= 1.0
    assert {-1.0, 1.0} == set(np.sign(torques))
