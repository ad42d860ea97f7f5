"""The users of the study: their plant is that of `canhaptic.sim`, they keep their limit, and they have teeth."""

import random

import numpy as np
import pytest

from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.lab.batch.scalar import render
from canhaptic.lab.loop.axis_loop import Reach
from canhaptic.sim.plant.plant import Plant, PlantParameters
from canhaptic.sim.plant.user import UserParameters
from tests.adversary.users import USERS
from tools.bench.standard_cases import standard_case
from tools.bench.user_laws import HandPlant

MS = 1_000_000


@pytest.mark.parametrize("damping", [0.0, 1e-6, 0.1, 200.0])
def test_the_plant_is_that_of_the_simulation_for_a_constant_hand(damping):
    known = Plant(
        PlantParameters(mass=0.25, damping=damping, initial_position=0.003), UserParameters(push=-2.0), [], MS
    )
    found = HandPlant(lambda *_: -2.0, MS, hand_force=5.0, damping=damping)
    for plant in (known, found):
        plant.begin(0)
        for k in range(1, 50):
            plant.advance_to(k * MS, 3.0 if k % 7 == 0 else 0.5)
    assert found.position == pytest.approx(known.position, rel=1e-11)
    assert found.velocity == pytest.approx(known.velocity, rel=1e-11)
    assert found.energy().motor == pytest.approx(known.energy().motor, rel=1e-9)
    assert found.energy().user == pytest.approx(known.energy().user, rel=1e-9)
    assert found.energy().dissipated == pytest.approx(known.energy().dissipated, rel=1e-6, abs=1e-12)


@pytest.mark.parametrize("name", USERS)
def test_no_user_exceeds_the_declared_force(name):
    mass, pushed = 0.25, []
    law = USERS[name](random.Random(1))
    plant = HandPlant(law, MS, hand_force=3.0, mass=mass, damping=0.0)
    for k in range(1, 400):
        before = plant.velocity
        plant.advance_to(k * MS, 0.0)
        pushed.append(abs(plant.velocity - before) * mass / 1e-3)
    assert max(pushed) <= 3.0 * (1.0 + 1e-9)
    assert max(pushed) > 0.5


def least(algorithm, user, stiffness, rate=1000.0, **options):
    case = standard_case(SpringDamperWall(stiffness=stiffness, damping=5.0), algorithm, rate, user, **options)
    run = render(case, 1200, Reach(-50.0, 50.0))
    return run.least_interaction, float(np.abs(run.torque).max())


@pytest.mark.slow_but("1-adversary")
@pytest.mark.parametrize("name", USERS)
@pytest.mark.parametrize("delay", [0, 1])
def test_guarded_gives_out_nothing_to_users_within_the_declared_force(name, delay):
    for stiffness in (1e3, 1e5):
        taken, felt = least("guarded", name, stiffness, delay=delay, hand_force=20.0, seed=2)
        assert taken >= -1e-6
        assert felt > 0.1


@pytest.mark.slow
@pytest.mark.parametrize("name", ["sudden_pull", "adversary", "telegraph"])
def test_the_same_users_take_energy_from_less_protection(name):
    assert least("unprotected", name, 1e5, hand_force=20.0, seed=2)[0] < -1e-2


def test_an_adversary_stronger_than_declared_takes_energy_from_guarded():
    assert least("guarded", "adversary", 1e5, hand_force=0.0, pull=20.0, seed=2)[0] < -1e-4
