"""The textbook models of a stage and a five-bar, against forces written out by hand and the energy they must keep."""

import numpy as np
import pytest

from canhaptic.lab.judge.reference_group import FiveBarModel, StageModel
from canhaptic.sim.plant.mechanism.five_bar_linkage import (
    FiveBarLinkage,
    force_of_hand,
    hand_slope,
    hand_target,
    mean_pull,
    pose_at,
)
from canhaptic.sim.plant.mechanism.task_hand import PlaneMotion, TaskHand
from canhaptic.sim.plant.mechanism.xy_stage import XYStage
from canhaptic.sim.plant.user import SinusoidMotion
from tests.plant.mechanism.mechanism_scenes import HAND, LINKS, STAGE, hand_force

SWING = SinusoidMotion(amplitude=0.05, frequency=1.0)


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


@pytest.mark.parametrize("most", [0.39, 0.2])  # the elbow stop is out of reach; it pulls
def test_what_motors_and_hand_give_a_five_bar_is_what_it_stores_and_loses(most):
    stop = {"least": 0.05, "most": most, "stiffness": 2e4}
    links = FiveBarLinkage(**{**LINKS, "elbow_stop": stop})
    model, linkage = FiveBarModel(links, HAND), links.linkage()

    def stored(state):
        inertia, span = np.array(model.inertia(state[:2])), pose_at(linkage, state[0], state[1]).span
        return 0.5 * state[2:4] @ inertia @ state[2:4] + 0.5 * stop["stiffness"] * max(0.0, span - most) ** 2

    state, step = np.array([2.1, 1.0, 3.0, -2.0, 0.0, 0.0]), 1e-6
    rates = np.array(model.rates(0.2, state.tolist(), [0.4, -0.3], ()))
    change = (stored(state + step * rates) - stored(state - step * rates)) / (2.0 * step)
    assert (pose_at(linkage, 2.1, 1.0).span > most) is (most == 0.2)
    assert change == pytest.approx(rates[4] + rates[5] - LINKS["damping"] * (state[2:4] @ state[2:4]), rel=1e-4)


def test_the_slope_of_the_hands_force_is_its_derivative():
    hand, before, after, step, width = force_of_hand(HAND), (0.02, 0.2), (0.021, 0.198), 1e-3, 1e-6
    slope = hand_slope(hand, step)
    for axis, column in ((0, (slope.xx, slope.xy)), (1, (slope.xy, slope.yy))):
        ends = [np.array(after), np.array(after)]
        ends[0][axis] -= width
        ends[1][axis] += width
        low, high = (np.array(mean_pull(hand, before, (end[0], end[1]), 0.3, step)) for end in ends)
        assert -(high - low) / (2.0 * width) == pytest.approx(column, rel=1e-6)


@pytest.mark.parametrize("moving", ["x", "y"])
def test_a_hand_that_moves_along_one_axis_rests_along_the_other(moving):
    hand = TaskHand(stiffness=10, rest=(0.1, 0.2), motion=PlaneMotion(**{moving: SWING}))
    place, speed = hand_target(force_of_hand(hand), 0.25)
    other = 1 if moving == "x" else 0
    assert (place[other], speed[other]) == ((0.1, 0.2)[other], 0.0)
    assert place[1 - other] == pytest.approx((0.1, 0.2)[1 - other] + 0.05)
