"""A hand of one's own is given the time, the place and the velocity of the handle."""

import numpy as np
import pytest

from canhaptic.sim.plant.plant import Plant, PlantParameters
from canhaptic.sim.plant.user import OwnHand, UserParameters

MS = 1_000_000


class _Grip(OwnHand):
    """The spring and the damper of every hand, once more."""

    def force(self, time: float, position: float, velocity: float) -> float:
        return -400.0 * position - 6.0 * velocity


def test_a_force_of_place_and_velocity_is_the_spring_and_damper_that_it_is():
    mass, torques = PlantParameters(mass=0.25, damping=0.1, initial_position=0.01), np.full(300, 0.5)
    own = Plant(mass, _Grip(), [], MS).run(torques)
    known = Plant(mass, UserParameters(stiffness=400.0, damping=6.0), [], MS).run(torques)
    assert own == pytest.approx(known, abs=2e-6)
    assert np.ptp(known) > 0.005
