"""A number that is not finite is refused by name, before the plant moves."""

import math

import numpy as np
import pytest

from canhaptic.errors import ParameterError
from canhaptic.sim.plant.effects import Effect
from canhaptic.sim.plant.effects.coulomb_friction import CoulombFriction
from canhaptic.sim.plant.plant import Plant, PlantParameters
from canhaptic.sim.plant.user import PointerHand, UserParameters

PERIOD = 1_000_000


@pytest.mark.parametrize("effects", [(), (CoulombFriction(kinetic=0.3, static=0.4),)], ids=["linear", "with events"])
@pytest.mark.parametrize("torque", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("until", [PERIOD, PERIOD // 4])
def test_a_torque_that_is_not_finite_is_refused(effects: tuple[Effect, ...], torque: float, until: int) -> None:
    plant = Plant(PlantParameters(mass=0.3), UserParameters(push=1.0), effects, sample_time_ns=PERIOD)
    plant.begin(0)
    plant.advance_to(PERIOD, 1.0)
    before = plant.position
    with pytest.raises(ParameterError, match=f"got torque {torque}, expected a finite number"):
        plant.advance_to(PERIOD + until, torque)
    assert plant.position == before
    assert np.isfinite(plant.position)


def test_a_hand_is_not_moved_to_what_is_no_place() -> None:
    plant = Plant(PlantParameters(mass=0.3), PointerHand(stiffness=100.0, damping=1.0), (), sample_time_ns=PERIOD)
    with pytest.raises(ParameterError, match=r"plant at 0 s: got \w+ nan, expected a finite number"):
        plant.move_hand(math.nan)
    plant.begin(0)
    plant.advance_to(PERIOD, 0.0)
    assert plant.position == 0.0
