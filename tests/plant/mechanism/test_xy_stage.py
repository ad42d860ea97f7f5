"""The simulated X-Y stage against DOP853, one axis of it against the plant of one axis, and its energy account."""

from typing import Any

import numpy as np
import pytest

from canhaptic.errors import ParameterError
from canhaptic.sim.plant.effects.coulomb_friction import CoulombFriction
from canhaptic.sim.plant.mechanism.task_hand import PlaneMotion, TaskHand
from canhaptic.sim.plant.plant import Plant, PlantParameters
from canhaptic.sim.plant.user import SinusoidMotion, UserParameters
from tests.plant.mechanism.mechanism_scenes import HAND, MS, STAGE, hand_force, integrated, run, stage, wavy

MASSES = np.array([STAGE["mass_x"], STAGE["mass_y"]])
DAMPINGS = np.array([STAGE["damping_x"], STAGE["damping_y"]])


def rates(time: float, z: Any, torques: tuple[float, float]) -> np.ndarray:
    force = hand_force(time, z[:2], z[2:]) + torques - DAMPINGS * z[2:]
    return np.concatenate([z[2:], force / MASSES])


@pytest.mark.slow
def test_an_elliptic_hand_couples_the_axes_as_the_reference_says():
    mechanism = stage()
    torques = wavy(400, 2.0)
    positions = run(mechanism, torques)
    expected = integrated(rates, [0, 0, 0, 0], torques, 1e-3)
    assert np.abs(positions - expected[:, :2]).max() < 1e-11
    for axis in (0, 1):
        motor = sum(pair[axis] * step for pair, step in zip(torques, np.diff(expected[:, axis]), strict=True))
        energy = mechanism.energy(axis)
        assert energy.motor == pytest.approx(motor, abs=1e-11)
        assert energy.stored == pytest.approx(0.5 * MASSES[axis] * expected[-1, 2 + axis] ** 2, abs=1e-11)
        assert abs(energy.motor + energy.user - energy.dissipated - energy.stored) < 1e-13


@pytest.mark.slow
@pytest.mark.parametrize("axis", [0, 1])
def test_with_a_round_hand_each_axis_is_the_plant_of_one_axis_dry_friction_included(axis: int):
    motion = SinusoidMotion(amplitude=0.05, frequency=2.0, phase=0.3)
    hand = TaskHand(stiffness=300, damping=3, rest=(0.01, 0.02), motion=PlaneMotion(x=motion, y=motion))
    dry = {"kinetic": 0.4, "static": 0.9}
    both = stage(hand, friction_x=dry, friction_y=dry)
    torques = wavy(600, 1.5)
    positions = run(both, torques)[:, axis]
    user = UserParameters(stiffness=300, damping=3, rest=hand.rest[axis], motion=motion)
    one = Plant(
        PlantParameters(mass=MASSES[axis], damping=DAMPINGS[axis]), user, [CoulombFriction(**dry)], MS
    )  # fmt: skip
    one.begin(0)
    expected = [one.position]
    for k, pair in enumerate(torques):
        one.advance_to((k + 1) * MS, pair[axis])
        expected.append(one.position)
    assert both.events > 4
    assert np.abs(positions - expected).max() < 1e-12
    assert both.energy(axis) == pytest.approx(one.energy(), abs=1e-12)


def test_a_stage_has_exactly_the_states_it_names():
    bare = {"x_position", "x_velocity", "x_force", "y_position", "y_velocity", "y_force", "torque", "one"}
    assert set(stage(None).state_names) == bare
    assert set(stage().state_names) - bare == {f"{a}_motion_{w}" for a in "xy" for w in ("sine", "cosine")}


def test_stuck_axes_do_not_creep():
    mechanism = stage(None, friction_x={"kinetic": 0.3, "static": 0.5}, friction_y={"kinetic": 0.3, "static": 0.5})
    positions = run(mechanism, [(0.4, -0.45)] * 200)
    assert np.all(positions == 0.0)


@pytest.mark.parametrize(
    ("values", "words"),
    [({"mass_x": 0.0}, "mass_x"), ({"friction_y": {"kinetic": 2.0, "static": 1.0}}, "static 1.0 is below kinetic 2.0")],
)
def test_impossible_stages_are_refused(values: dict[str, Any], words: str):
    with pytest.raises(ParameterError, match=words):
        stage(**values)


def test_motion_without_a_grip_is_refused():
    with pytest.raises(ParameterError, match="motion without a hand"):
        TaskHand(motion=HAND.motion)
