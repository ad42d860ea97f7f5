"""The textbook model of a stage, against forces written out by hand."""

import numpy as np
import pytest

from canhaptic.sim.plant.mechanism.xy_stage import XYStage
from canhaptic.sim.textbook.reference_group import StageModel
from tests.plant.mechanism.mechanism_scenes import HAND, STAGE, hand_force


@pytest.mark.parametrize("has_hand", [True, False])
def test_the_rates_of_a_stage_are_those_of_newton(has_hand):
    model = StageModel(XYStage(**STAGE), HAND if has_hand else None)
    place, speed, torques, time = np.array([0.03, 0.2]), np.array([0.7, -0.4]), np.array([1.5, -2.0]), 0.37
    force = hand_force(time, place, speed) if has_hand else np.zeros(2)
    masses, damping = np.array([0.6, 0.25]), np.array([0.4, 0.1])
    expected = [*speed, *((torques + force - damping * speed) / masses), torques @ speed, force @ speed]
    assert model.rates(time, [*place, *speed, 0.0, 0.0], list(torques), model.first) == pytest.approx(
        expected, rel=1e-12
    )
    assert model.start == [0.0] * 6
