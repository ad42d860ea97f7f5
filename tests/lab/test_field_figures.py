"""The field's figures: each is that of an ideal wall where sampling hardly matters, and tells where it does."""

import math

import numpy as np
import pytest

from canhaptic.control.environments.free_space import FreeSpace
from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.lab.batch.scalar import render
from canhaptic.lab.figures.figures import (
    _moved_in_a_hold,
    asked_impedance,
    drag,
    energy_beyond_device,
    energy_given_out,
    m_width,
    rate_hardness,
    rendered_impedance,
    stiffest_walls,
)
from canhaptic.quantities import ARENA
from canhaptic.sim.plant.plant import PlantParameters
from canhaptic.sim.plant.user import SinusoidMotion, UserParameters
from tools.bench.standard_cases import standard_case

HAND = UserParameters(stiffness=300.0, damping=3.0, motion=SinusoidMotion(amplitude=0.03, frequency=1.0))


def run_of(environment, algorithm, rate, seconds, user=HAND, **named):
    return render(standard_case(environment, algorithm, rate, user, **named), round(rate * seconds))


@pytest.mark.slow
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


@pytest.mark.slow
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
    tried = np.array([10.0, 20.0, 40.0, 80.0])
    passive = np.array([[1, 1, 0], [1, 1, 1], [0, 1, 1], [1, 1, 1]])
    shares = np.array([[1.0, 1.04, 1.0], [0.94, 0.96, 1.0], [1.0, 1.2, 1.0], [1.0, np.nan, 1.0]])
    found = stiffest_walls(tried, passive, shares)
    assert found.passive.tolist() == [20.0, 80.0, 0.0]
    assert found.near.tolist() == [10.0, 20.0, 0.0]  # the share of the second wall is 6 % too small
    assert found.is_open.tolist() == [False, True, False]


@pytest.mark.parametrize(("delay", "most"), [(0, 2.0), (1, math.sqrt(5.0) - 1.0)])
def test_the_m_width_of_a_free_mass_is_that_of_its_polynomial(delay, most):
    # z^(1 + d) z + a (z + 1) = 0 with a = M / 2m: by Jury's criterion -1/2 < a < 1, and a^2 + a < 1 one sample late
    found = m_width(0.25, 0.0, 1e-3, delay)
    assert found.most == pytest.approx(0.25 * most, rel=1e-5)
    assert found.least == pytest.approx(-0.25, rel=1e-5)


@pytest.mark.parametrize("ratio", [1.1e-6, 1e-5, 1e-4])
def test_what_a_force_moves_in_a_hold_is_exact_where_the_damping_is_small(ratio):
    # x1 = exp(-r) - 1 + r and x0 = 1 - exp(-r) - r exp(-r), over r^2, as series in r = b T / m
    series = 0.5 - ratio / 6.0 + ratio**2 / 24.0, 0.5 - ratio / 3.0 + ratio**2 / 8.0
    found = _moved_in_a_hold(1.0, ratio, 1.0)
    assert found == pytest.approx(series, rel=1e-8)


def test_a_virtual_mass_within_the_m_width_comes_to_rest_and_one_beyond_does_not():
    mass, damping, period = 0.25, 0.5, 2e-3
    width = m_width(mass, damping, period, 1)

    def still_moves(virtual):
        decay = math.exp(-damping * period / mass)
        position, speed, held = [0.0, 0.0, 0.0], 0.1, [0.0]
        for _ in range(6000):
            force = held.pop(0)
            held.append(-virtual * (position[-1] - 2.0 * position[-2] + position[-3]) / period**2)
            settled = force / damping
            position.append(position[-1] + settled * period + (speed - settled) * (1.0 - decay) * mass / damping)
            speed = settled + (speed - settled) * decay
        return abs(speed) > 1e-3

    assert not still_moves(0.97 * width.most)
    assert not still_moves(0.97 * width.least)
    assert still_moves(1.03 * width.most)
    assert still_moves(1.03 * width.least)


def test_a_filter_of_the_acceleration_widens_the_m_width():
    assert m_width(0.25, 0.1, 1e-3, 0, 30.0).most > 5.0 * m_width(0.25, 0.1, 1e-3, 0, 1e6).most
    assert m_width(0.25, 0.1, 1e-3, 0, 1e6).most == pytest.approx(m_width(0.25, 0.1, 1e-3).most)


def test_every_figure_of_the_field_has_a_definition_and_its_source():
    asked = {"K-B", "M-width", "rate-hardness", "impedance", "limit cycle", "energy", "force ripple", "drag", "time"}
    assert all(any(word in row.title for row in ARENA.values()) for word in asked)
    assert all(row.sentence and row.source for row in ARENA.values())
