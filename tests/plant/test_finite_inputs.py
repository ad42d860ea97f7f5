"""A number that is not finite is refused by name, before the plant moves."""

import math
from typing import Any

import numpy as np
import pytest

from canhaptic.errors import ParameterError
from canhaptic.sim.plant.effects import Effect
from canhaptic.sim.plant.effects.coulomb_friction import CoulombFriction
from canhaptic.sim.plant.mechanism.five_bar_linkage import FiveBarLinkage
from canhaptic.sim.plant.mechanism.task_hand import PointerTaskHand
from canhaptic.sim.plant.mechanism.xy_stage import XYStage
from canhaptic.sim.plant.plant import Plant, PlantParameters
from canhaptic.sim.plant.user import PointerHand, UserParameters
from tests.plant.mechanism.mechanism_scenes import LINKS

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


@pytest.mark.parametrize(
    "mechanism", [XYStage(mass_x=0.5, mass_y=0.4), FiveBarLinkage(**LINKS)], ids=["xy", "five_bar"]
)
def test_a_mechanism_refuses_what_is_no_number_and_moves_on(mechanism: Any) -> None:
    plant = mechanism.build(PointerTaskHand(stiffness=100.0, damping=1.0, rest=(0.0, 0.25)), PERIOD, 1)
    plant.begin(0)
    for torques in ((math.nan, 0.0), (0.0, -math.inf)):
        with pytest.raises(
            ParameterError, match=r"plant at 0 s: got (torque|force) (nan|-inf), expected a finite number"
        ):
            plant.advance_to(PERIOD, torques)
    with pytest.raises(ParameterError, match="got hand position nan"):
        plant.move_hand(0.0, math.nan)
    plant.advance_to(PERIOD, (0.0, 0.0))
    assert np.isfinite(plant.positions).all()
