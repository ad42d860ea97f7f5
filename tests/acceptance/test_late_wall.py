"""A wall whose torques come late, on a coarse encoder with noise: it must be there, not only be passive."""

from pathlib import Path

import pytest

from canhaptic import load_scene, simulate

SCENE = Path(__file__).resolve().parents[2] / "configs" / "accuracy" / "coarse_encoder.yaml"


@pytest.mark.slow
def test_what_late_torques_leave_open_takes_no_stiffness_from_a_certified_wall() -> None:
    """It counts against the damping of the device; the hand force certifies the wall without it."""
    account = simulate(load_scene(SCENE, ["bus.rate=250"])).account.raw
    rendered = account["ports"]["handle"]["rendered"]["stiffness"]
    assert rendered is not None
    assert rendered > 0.9  # 0.07 where it counts against the hand force
    assert account["truth"]["handle"]["least_interaction"] >= 0.0
