"""Published rigs: the formula of Abbott and Okamura holds on both sides of its bound; what is assumed is no pass."""

import json
from pathlib import Path

import pytest

from tools.bench.published import _is_covered, displayed, is_quiet, row, run_of, scene_of

ROOT = Path(__file__).resolve().parents[3]
ROWS = {found["row"]: found for found in json.loads((ROOT / "docs/results/published.json").read_text())["rows"]}


@pytest.mark.slow
@pytest.mark.parametrize(("part", "covered"), [(0.9, True), (1.2, False)])
def test_the_worst_hand_for_an_encoder_is_covered_up_to_the_bound(part: float, covered: bool) -> None:
    bound = 2.0 * 0.02 / 1e-4
    assert _is_covered(part * bound, 0.02, 1e-4, 4.0, 100.0, 1e-6) == covered


@pytest.mark.slow
def test_a_wall_behind_a_slow_torque_rings_where_the_lag_takes_more_than_the_damping_gives() -> None:
    scene = scene_of("elbow_exoskeleton", {})
    damping, lag, inertia = 0.67, 0.043, 0.087
    border = damping / lag + damping**2 / inertia  # of Routh, with the rate left out: 20.7 N*m/rad
    assert is_quiet(scene, 0.8 * border, None)
    assert not is_quiet(scene, 1.25 * border, None)


@pytest.mark.slow
def test_a_displayed_stiffness_is_force_over_depth() -> None:
    values = {"simulation.plant.mass": 0.1, "axes.0.counts_per_unit": 1e7}
    soft = run_of(scene_of("phantom_premium_15", values, "passivity.algorithm=unprotected"), 150.0)
    assert displayed(soft) == pytest.approx(150.0, rel=0.05)


def test_where_values_are_assumed_there_is_a_range_and_no_pass() -> None:
    assumed = row("a", 1.1, "N/m", 1.0, "paper", "", (0.5, 2.0))
    assert assumed.met is None
    assert "theirs lies inside" in assumed.note
    assert row("a", 1.1, "N/m", 1.0, "paper", "").met is True
    assert row("a", 1.3, "N/m", 1.0, "paper", "").met is False
    for name, found in ROWS.items():
        if "spring wall" not in name and "virtual mass" not in name:
            assert found["met"] is None, name
        assert found["peer_value"] > 0.0
