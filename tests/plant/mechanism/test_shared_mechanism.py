"""Several drives on one mechanism: in any order of the questions, the torques of all act in the hold that ended."""

import itertools

import pytest

from canhaptic.sim.plant.mechanism import SharedMechanism
from tests.plant.mechanism.mechanism_scenes import MS, five_bar, stage


class Held:
    """The torque of one drive."""

    def __init__(self) -> None:
        self.torque = 0.0


@pytest.mark.parametrize("make", [stage, five_bar])
@pytest.mark.parametrize("order", list(itertools.permutations((0, 1))))
def test_the_order_in_which_drives_move_does_not_matter(make, order):
    alone, shared = make(), SharedMechanism(make(), 2)
    drives = [Held(), Held()]
    for motor, drive in zip(shared.motors, drives, strict=True):
        motor.connect(lambda drive=drive: drive.torque)  # type: ignore[misc]
        motor.begin(0)
    alone.begin(0)
    for k in range(50):
        now = (k + 1) * MS
        alone.advance_to(now, (drives[0].torque, drives[1].torque))
        for axis in order:
            shared.motors[axis].advance_to(now, drives[axis].torque)
            drives[axis].torque = 0.1 * (k % 7 - 3) * (1 - 2 * axis)  # after its own move, as a drive does
    assert shared.mechanism.positions == alone.positions
    assert [m.energy() for m in shared.motors] == [alone.energy(axis) for axis in (0, 1)]
    assert [m.position for m in shared.motors] == list(alone.positions)
    assert [m.velocity for m in shared.motors] == list(alone.velocities)


def test_a_torque_that_changes_inside_a_hold_acts_from_then_on():
    alone, shared = stage(), SharedMechanism(stage(), 2)
    drives = [Held(), Held()]
    for motor, drive in zip(shared.motors, drives, strict=True):
        motor.connect(lambda drive=drive: drive.torque)  # type: ignore[misc]
        motor.begin(0)
    alone.begin(0)
    shared.motors[1].advance_to(400_000, 0.0)
    drives[1].torque = 3.0
    shared.motors[0].advance_to(MS, 0.0)
    alone.advance_to(400_000, (0.0, 0.0))
    alone.advance_to(MS, (0.0, 3.0))
    assert shared.mechanism.positions == alone.positions


def test_it_stands_still_until_the_last_drive_is_enabled():
    shared = SharedMechanism(stage(), 2)
    first, second = shared.motors
    first.begin(0)
    first.advance_to(5 * MS, 1.0)
    assert shared.mechanism.positions == (0.0, 0.0)
    second.begin(5 * MS)
    first.advance_to(6 * MS, 1.0)
    assert shared.mechanism.positions != (0.0, 0.0)
