"""What lost samples leave in doubt is computed with torques that limiter and drive can have applied."""

import pytest

from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.control.mechanisms.kinematics import Identity
from canhaptic.control.multi_axis import build_group_controller
from canhaptic.control.passivity import ALGORITHMS, build_controller
from canhaptic.control.port_hamiltonian.shapes.box import Box
from tests.control.cases import loop

LIMIT = 20.0  # [N]
LOST = 3
MOVED = 0.002  # [m] in and out again, at every sample


def least_possible(torques_lost: int) -> float:
    """The most that could be missing: the largest torque to and fro, over twice the motion seen, in every hold [J]."""
    return -2.0 * LIMIT * torques_lost * 2.0 * MOVED * (1 + torques_lost)


@pytest.mark.parametrize("delay", [0, 1])
@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_no_more_is_in_doubt_than_the_limited_torque_can_have_given(algorithm: str, delay: int) -> None:
    """A wall so stiff and damped that what is asked for is beyond all reason."""
    wall = SpringDamperWall(stiffness=1e9, damping=1e7, position=0.0)
    known = loop(delay).model_copy(update={"torque_limit": LIMIT})
    controller = build_controller(wall, algorithm, None, known)
    controller.step(0.001, 0.0)
    for position in (-MOVED, -2.0 * MOVED, -MOVED):
        controller.step(position, LIMIT)
    for _ in range(LOST):
        controller.sample_lost()
    balance = controller.step(-2.0 * MOVED, LIMIT)
    booked = LIMIT * MOVED  # -torque times displacement
    least = balance.h_i - getattr(controller, "energy_resolution", 0.0)
    assert booked >= least >= booked + least_possible(LOST)


@pytest.mark.parametrize("algorithm", ["step_scaling", "guarded"])
def test_no_more_is_in_doubt_in_a_group_than_limited_torques_can_have_given(algorithm: str) -> None:
    box = Box(stiffness=1e9, damping=1e7, lower=(0.0, 0.0), upper=(1.0, 1.0))
    known = loop(1).model_copy(update={"torque_limit": LIMIT})
    controller = build_group_controller(box, Identity(axes=2), algorithm, None, [known, known])
    applied = (LIMIT, 0.0)
    controller.step((0.001, 0.5), (0.0, 0.0))
    for position in (-MOVED, -2.0 * MOVED, -MOVED):
        controller.step((position, 0.5), applied)
    for _ in range(LOST):
        controller.sample_lost()
    balance = controller.step((-2.0 * MOVED, 0.5), applied)
    booked = LIMIT * MOVED
    assert booked >= balance.account.h_i >= booked + 2.0 * least_possible(LOST)
