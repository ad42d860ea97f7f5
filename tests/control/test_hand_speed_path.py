"""The way that a hand of bounded speed can go while a torque acts."""

import pytest

from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.control.passivity import LoopProperties
from canhaptic.control.passivity.guarded import GuardedParameters, settings_of


@pytest.mark.parametrize("delay", [0, 1, 3])
def test_the_path_of_a_torque_counts_its_hold_and_every_hold_that_it_waits(delay: int) -> None:
    """A torque of a late bus is decided `delay` holds before its own: the hand moves in all of them."""
    wall = SpringDamperWall(stiffness=1000.0, damping=5.0, side="above", position=0.0)
    given = GuardedParameters(hand_force=5.0, hand_speed=0.5)
    loop = LoopProperties(
        sample_time=2e-3, delay=delay, moving_mass=0.2, device_damping_bound=0.2, device_friction_bound=0.0
    )
    assert settings_of(wall, given, loop).path == pytest.approx(0.5 * 2e-3 * (1 + delay), rel=1e-12)
