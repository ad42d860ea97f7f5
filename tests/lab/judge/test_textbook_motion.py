"""The difference of two motions, by numbers worked out by hand."""

import numpy as np
import pytest

from canhaptic.lab.judge.reference_model import difference
from canhaptic.sim.plant.direct_rig import Motion


def motion(position: float, velocity: float, motor: float, user: float) -> Motion:
    return Motion(*(np.array([0.0, value]) for value in (position, velocity, motor, user)))


@pytest.mark.parametrize(
    ("one", "other", "expected"),
    [
        (motion(0.0, 3.0, 0.0, 0.0), motion(0.0, 1.0, 0.0, 0.0), (0.0, 40.0, 8.0)),  # 2 kg * 2 m/s / 0.1 s; (9 - 1) J
        (motion(0.5, 1.0, 4.0, 1.0), motion(0.25, 1.0, 1.0, 3.0), (0.25, 0.0, 3.0)),  # the motor's work
        (motion(0.0, 1.0, 1.0, -3.0), motion(0.25, 1.0, 1.0, 1.0), (0.25, 0.0, 4.0)),  # the user's
    ],
)
def test_two_motions_differ_by(one, other, expected):
    assert difference(one, other, 2.0, 0.1) == pytest.approx(expected)


def test_a_motion_that_is_not_finite_is_infinitely_far_away():
    found = difference(motion(np.nan, 1.0, 0.0, 0.0), motion(0.0, 1.0, 0.0, 0.0), 2.0, 0.1)
    assert not found.is_finite
    assert found.position == np.inf
