"""Hands that are guided, walls that are leant on, and slow hands: against closed forms and the continuous wall."""

import math
from dataclasses import replace

import numpy as np
import pytest

from canhaptic.control.certificates.scalar_bounds import displacement_response, start_energy
from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.lab.studies.design.contact_quality import (
    Bench,
    GuidedHand,
    GuidedPlant,
    Leaning,
    Leg,
    SlowHand,
    enter,
    held,
    largest_held,
    settling_time,
)
from canhaptic.sim.plant.effects.coulomb_friction import CoulombFriction
from canhaptic.sim.plant.plant import PlantParameters
from canhaptic.sim.plant.user import UserParameters
from tools.bench.feel import certified_rest, energy_for_any_hand, largest_rise
from tools.bench.feel_best import best_from_nothing, bound_from_nothing, depths_of
from tools.bench.standard_cases import standard_case

MS = 1_000_000
STILL = UserParameters()


def device(algorithm: str, rate: float, damping: float, hand_force: float = 0.0, delay: int = 0) -> Bench:
    plant = PlantParameters(mass=0.25, damping=damping)
    wall = SpringDamperWall(stiffness=1.0)
    case = standard_case(wall, algorithm, rate, STILL, delay=delay, plant=plant, hand_force=hand_force)
    return Bench(case, plant)


def test_a_push_that_rises_moves_a_mass_by_the_cube_of_time_and_then_by_its_square() -> None:
    rise, push = 0.3, 5.0
    plant = GuidedPlant(PlantParameters(mass=0.25), GuidedHand(), [], MS, [Leg(0.0, push_rate=push / rise), Leg(rise)])
    positions = [0.0]
    plant.begin(0)
    for k in range(1, 501):
        plant.advance_to(k * MS, 0.0)
        positions.append(plant.position)
    assert positions[300] == pytest.approx(push / rise / 0.25 * rise**3 / 6.0, rel=1e-12)
    speed, start = push * rise / 2.0 / 0.25, positions[300]
    assert positions[500] == pytest.approx(start + speed * 0.2 + push / 0.25 * 0.02, rel=1e-12)
    energy = plant.energy()
    assert energy.user == pytest.approx(energy.stored, rel=1e-11)


def test_a_spring_whose_far_end_moves_carries_the_handle_as_a_forced_oscillator() -> None:
    omega = math.sqrt(300.0 / 0.25)
    plant = GuidedPlant(PlantParameters(mass=0.25), GuidedHand(stiffness=300.0), [], MS, [Leg(0.0, speed=0.1)])
    plant.begin(0)
    for k in range(1, 101):
        plant.advance_to(k * MS, 0.0)
    assert plant.position == pytest.approx(0.1 * (0.1 - math.sin(omega * 0.1) / omega), rel=1e-10)


def test_dry_friction_holds_the_handle_until_the_rising_push_is_as_large() -> None:
    friction = CoulombFriction(kinetic=1.0, static=1.0)
    plant = GuidedPlant(PlantParameters(mass=0.25), GuidedHand(), [friction], MS, [Leg(0.0, push_rate=10.0)])
    plant.begin(0)
    moved = []
    for k in range(1, 121):
        plant.advance_to(k * MS, 0.0)
        moved.append(plant.position)
    assert max(moved[:100]) == 0.0
    assert moved[119] == pytest.approx(10.0 / 0.25 * 0.02**3 / 6.0, rel=1e-6)


@pytest.mark.slow
def test_a_plain_wall_is_held_until_the_device_no_longer_damps_its_hold() -> None:
    """A sampled spring at delay 0 takes k T / 2 from the damping: it swings for ever at k = 2 b / T."""
    damping, rate = 4.0, 200.0
    leaning = Leaning(duration=settling_time(0.25, damping) * 10.0, allowance=1.0)
    bound = 2.0 * damping * rate
    found = largest_held(device("unprotected", rate, damping), leaning, 0.5 * bound, 2.0 * bound)
    assert 0.9 * bound < found.stiffness < bound
    assert found.failing == 0


def test_a_wall_is_judged_by_depth_ripple_and_energy() -> None:
    soft = held(device("guarded", 100.0, 2.0), 100.0, Leaning())
    assert soft.passed
    assert soft.share == pytest.approx(1.0, abs=0.01)
    hard = held(device("guarded", 100.0, 2.0), 1e5, Leaning())
    assert not hard.passed
    assert hard.share < 0.5
    loose = held(device("unprotected", 100.0, 0.1), 200.0, Leaning())
    assert not loose.passed
    assert loose.least < -1e-3


def test_the_certified_rest_of_a_spring_is_where_its_force_is_what_the_certificate_holds() -> None:
    """Undamped, c x = F + F_h with c = m / 2 T^2 or m / 6 T^2: x = (K s + F_h) / (c + K)."""
    hand = SlowHand(0.1)
    for delay, slope in ((0, 1250.0), (1, 1250.0 / 3.0)):
        response = displacement_response(0.01, 0.25, 5.0)
        depth, stiffness = certified_rest(response, delay, hand)
        assert depth == pytest.approx((300.0 * 0.03 + 5.0) / (slope + 300.0), rel=1e-9)
        assert stiffness == pytest.approx(300.0 * (0.03 - depth) / depth)
    assert certified_rest(displacement_response(0.01, 0.25, 20.0), 1, hand) == (0.03, 0.0)


def test_a_slow_hand_rests_in_a_plain_spring_where_the_springs_balance() -> None:
    found = enter(device("unprotected", 1000.0, 20.0), SpringDamperWall(stiffness=600.0), SlowHand(0.19))
    assert found.depth == pytest.approx(0.03 * 300.0 / 900.0, rel=1e-4)
    assert found.drag == 0.0
    assert found.least > -1e-4


def test_the_largest_rise_is_looked_for_at_entries_only() -> None:
    position = np.array([1.0, 1.0, -1.0, -1.0, -1.0, -1.0, -1.0, -1.0, -1.0, -1.0, -1.0])
    torque = np.array([0.0, 0.0, 0.0, 3.0, 4.0, 4.0, 4.0, 4.0, 4.0, 4.0, 9.0])
    assert largest_rise(torque, position) == 3.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rate", "delay", "hand_force", "stiffness"), [(1000, 1, 20, 9e3), (100, 1, 5, 160), (100, 0, 5, 500)]
)
def test_with_the_energy_of_a_start_a_hand_of_any_speed_is_held(
    rate: float, delay: int, hand_force: float, stiffness: float
) -> None:
    holds = 3.0 if delay else 1.0
    response = displacement_response(1.0 / rate, 0.25, hand_force)
    energy, each = start_energy(response, delay, stiffness), holds / rate**2 / 0.25
    assert energy == pytest.approx((each * hand_force) ** 2 / 4.0 / (0.5 / stiffness - each))
    bench, wall = device("guarded", rate, 0.5, hand_force, delay), SpringDamperWall(stiffness=stiffness)
    assert bench.case.parameters is not None
    allowed = bench.case.parameters.model_copy(update={"energy_allowance": energy})
    hand = SlowHand(0.02, free=1e-3, settling=1.5, rest=0.5)
    found = enter(replace(bench, case=replace(bench.case, parameters=allowed)), wall, hand)
    assert found.depth == pytest.approx(300.0 * 0.03 / (300.0 + stiffness), rel=0.02)
    assert found.least >= -energy
    assert enter(bench, wall, hand).depth > 0.025


def test_no_energy_is_enough_for_a_wall_beyond_the_certificate() -> None:
    assert start_energy(displacement_response(1e-3, 0.25, 5.0), 0, 0.26 / 2e-6) == math.inf
    assert start_energy(displacement_response(1e-3, 0.25, 0.0), 0, 1e9) == 0.0


@pytest.mark.slow
def test_from_nothing_no_law_holds_what_the_certificate_holds_at_rest_under_a_hand_that_may_pull() -> None:
    leaning = Leaning()
    bound = bound_from_nothing(1e-3, 1, 0.25, 20.0, leaning)
    assert 4900.0 < bound < 4960.0
    whole = np.ones((1, 12))
    for hand_force in (5.0, 20.0):
        of = (0.025, 0, 0.25, hand_force, leaning)
        greedy = leaning.push / float(depths_of(whole, *of)[0]) / 0.95
        best = best_from_nothing(*of)
        assert greedy <= best < bound_from_nothing(*of)
        found = largest_held(device("guarded", 40.0, 0.1, hand_force), Leaning(duration=10.0), 10.0, 200.0)
        assert 0.7 * best < found.stiffness < best


def test_a_wall_for_any_hand_needs_what_device_and_wall_do_not_have() -> None:
    damping, friction, stiffness, push = 2.0, 0.4, 3000.0, 9.0
    for delay in (0, 1):
        needed = (1 + delay) * (push - friction) ** 2 * 1e-3 / (4.0 * damping)
        had = push**2 / (2.0 * stiffness) + friction * push / stiffness
        found = energy_for_any_hand(damping, friction, 1e-3, delay, stiffness, push)
        assert found == pytest.approx(max(0.0, needed - had), rel=1e-12)
    assert found > 0.0
    assert energy_for_any_hand(damping, 20.0, 1e-3, 1, stiffness, push) == 0.0
    assert energy_for_any_hand(damping, friction, 1e-3, 0, 10.0, push) == 0.0
    assert energy_for_any_hand(damping, 9.5, 1e-3, 1, 1e12, push) == 0.0


def test_friction_and_damping_hold_a_wall_for_every_hand_with_what_friction_took_before() -> None:
    """At the force for which it is asked the energies are equal; none is needed for what friction holds alone."""
    damping, friction, stiffness, push = 0.5, 0.5, 2500.0, 8.0
    energy = energy_for_any_hand(damping, friction, 1e-3, 1, stiffness, push)
    stored = energy + push**2 / 2.0 / stiffness + friction * push / stiffness
    assert friction + math.sqrt(4.0 * damping * stored / 1e-3 / 2.0) == pytest.approx(push)
    assert energy_for_any_hand(damping, friction, 1e-3, 1, stiffness, friction) == 0.0


def test_no_wall_is_held_where_the_stiffest_to_try_is_below_the_softest() -> None:
    assert largest_held(device("guarded", 100.0, 0.1), Leaning(), 1000.0, 100.0) == (0.0, 0, 0)
