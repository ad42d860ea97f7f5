"""The field's figures: each is that of an ideal wall where sampling hardly matters, and tells where it does."""

import math

import pytest

from canhaptic.control.environments.free_space import FreeSpace
from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.sim.plant.plant import PlantParameters
from canhaptic.sim.plant.user import SinusoidMotion, UserParameters
from canhaptic.study.field_figures import (
    asked_impedance,
    drag,
    energy_beyond_device,
    energy_given_out,
    rate_hardness,
    rendered_impedance,
    stiffest,
    stiffness_grid,
)
from canhaptic.study.loop import render
from tools.bench.standard_cases import standard_case

HAND = UserParameters(stiffness=300.0, damping=3.0, motion=SinusoidMotion(amplitude=0.03, frequency=1.0))


def run_of(environment, algorithm, rate, seconds, user=HAND, **named):
    return render(standard_case(environment, algorithm, rate, user, **named), round(rate * seconds))


@pytest.mark.parametrize("stiffness", [300.0, 3000.0])
def test_the_rate_hardness_of_a_fine_wall_is_its_stiffness(stiffness):
    wall = SpringDamperWall(stiffness=stiffness, damping=0.0, position=-0.005)
    found = rate_hardness(run_of(wall, "unprotected", 10_000.0, 0.7), wall, 1e-4)
    assert found == pytest.approx(stiffness, rel=0.05)
    assert rate_hardness(run_of(FreeSpace(), "unprotected", 1000.0, 0.7), FreeSpace(), 1e-3) is None


def test_a_stiff_wall_at_a_low_rate_gives_energy_out_and_a_guarded_one_none():
    wall = SpringDamperWall(stiffness=5000.0, damping=0.0)
    assert energy_given_out(run_of(wall, "unprotected", 500.0, 2.0)) > 0.05
    assert energy_given_out(run_of(wall, "guarded", 500.0, 2.0)) == pytest.approx(0.0, abs=1e-9)


def test_what_the_device_takes_is_no_fault_of_the_display():
    rough = run_of(SpringDamperWall(stiffness=5000.0, damping=0.0), "unprotected", 500.0, 2.0)
    given = energy_given_out(rough)
    assert energy_beyond_device(rough, 0.0, 2e-3) == given
    assert 0.0 < energy_beyond_device(rough, 0.1, 2e-3) < given
    assert energy_beyond_device(rough, 1e4, 2e-3) == 0.0


def test_free_motion_has_no_drag():
    wall = SpringDamperWall(stiffness=500.0, damping=5.0)
    assert drag(run_of(FreeSpace(), "guarded", 1000.0, 1.0)) == 0.0
    dragged = drag(run_of(wall, "unprotected", 1000.0, 1.0))
    assert dragged == pytest.approx(0.0, abs=0.01)  # the last force of a contact is held into the free motion
    assert drag(run_of(SpringDamperWall(stiffness=100.0, position=0.1), "unprotected", 1000.0, 0.1)) is None


@pytest.mark.parametrize("frequency", [2.0, 10.0])
def test_the_impedance_of_a_fine_spring_with_damper_is_the_one_asked_for(frequency):
    spring = SpringDamperWall(stiffness=400.0, damping=8.0, position=0.1)  # always in contact
    user = UserParameters(stiffness=2000.0, damping=20.0, motion=SinusoidMotion(amplitude=0.01, frequency=frequency))
    asked = asked_impedance(400.0, 8.0, frequency)
    fine = rendered_impedance(run_of(spring, "unprotected", 8000.0, 2.0, user), 1 / 8000.0, frequency)
    assert abs(fine - asked) < 0.01 * abs(asked)
    plant = PlantParameters(mass=0.25, damping=0.1)
    late = run_of(spring, "unprotected", 500.0, 2.0, user, delay=1, plant=plant)
    lag = 1.5 / 500.0  # half a hold, and one whole of delay: a spring that comes late has damping below zero
    expected = asked * complex(math.cos(2.0 * math.pi * frequency * lag), -math.sin(2.0 * math.pi * frequency * lag))
    assert abs(rendered_impedance(late, 1 / 500.0, frequency) - expected) < 0.05 * abs(asked)


def test_the_stiffest_wall_is_the_one_below_which_all_pass():
    grid = stiffness_grid(10.0, 1000.0, 2)
    assert grid == pytest.approx([10.0, 31.6228, 100.0, 316.228, 1000.0], rel=1e-5)
    assert stiffest(lambda k: k < 200.0, grid) == pytest.approx(100.0)
    assert stiffest(lambda k: not 20.0 < k < 50.0, grid) == 10.0
    assert stiffest(lambda _: False, grid) == 0.0
