"""A run that moves faster than declared friction lets it is found, by the simulated plant; one that does not, never."""

import itertools
import random

import pytest

from canhaptic.control.motion_checks import FrictionDeclared, FrictionWatch
from canhaptic.lab.studies.design.contact_quality import PUSH, PUSH_RATE, GuidedHand
from canhaptic.sim.plant.effects.coulomb_friction import CoulombFriction
from canhaptic.sim.plant.plant import Plant, PlantParameters

MASS, PULL, PUSH_IN = 0.25, 0.2, 5.0
STIFFNESS = 400.0  # of the wall below 0 [N/m]


def excess(friction: float, declared: float, seed: int, *, count: float = 0.0, jitter: float = 0.0) -> float:
    """Largest excess [N] of a run of 2 s at a wall, under a hand within its bounds that changes its mind."""
    chance, period = random.Random(seed), 1_000_000
    effect = CoulombFriction(kinetic=friction, static=friction)
    plant = Plant(PlantParameters(mass=MASS, damping=0.1), GuidedHand(), [effect], period)
    watch = FrictionWatch(FrictionDeclared(declared, 0.9 * MASS, 1e-3, PULL, PUSH_IN, count, jitter))
    plant.begin(0)
    now, torque = 0, 0.0
    for k in range(2000):
        if k % 100 == 0:
            push = chance.choice((-PUSH_IN, -PUSH_IN, PULL)) * chance.uniform(0.5, 1.0)
            plant.set_states({PUSH: push if plant.position <= 0.0 else -PUSH_IN, PUSH_RATE: 0.0})
        now += round(period * (1.0 + jitter * chance.uniform(-1.0, 1.0)))
        plant.advance_to(now, torque)
        seen = round(plant.position / count) * count if count else plant.position
        asked = STIFFNESS * min(0.0, seen)
        watch.take(seen, torque, k, asked)
        torque = -chance.uniform(0.9, 1.0) * asked
    return watch.excess


@pytest.mark.slow_but("1e-06-0.0")
@pytest.mark.parametrize(("count", "jitter"), [(0.0, 0.0), (1e-6, 0.0), (0.0, 0.01)])
def test_a_run_with_the_friction_that_is_declared_contradicts_nothing(count: float, jitter: float) -> None:
    assert max(excess(0.5, 0.5, seed, count=count, jitter=jitter) for seed in range(4)) == 0.0


@pytest.mark.slow_but("1e-06")
@pytest.mark.parametrize("count", [0.0, 1e-6])
def test_a_wall_that_pushes_the_handle_out_too_fast_shows_that_the_friction_is_gone(count: float) -> None:
    found = [excess(0.05, 1.5, seed, count=count) for seed in range(4)]
    assert max(found) > 0.5
    assert max(found) < 1.45  # what is missing


def run_of(speeds: list[float], asked: float = -1.0, hand_force: float = 0.0) -> float:
    """Excess of a motion of 10 ms at each speed [m/s], without a torque."""
    watch, position, deadline = FrictionWatch(FrictionDeclared(0.5, 0.25, 1e-3, hand_force)), -1.0, 0
    watch.take(position, 0.0, deadline, asked)
    for speed in speeds:
        for _ in range(10):
            position, deadline = position + 1e-3 * speed, deadline + 1
            watch.take(position, 0.0, deadline, asked)
    return watch.excess


def test_what_is_missing_is_what_the_equation_of_motion_says() -> None:
    force = 0.25 * (3.0 - 1.0) / 0.01
    assert run_of([1.0, 3.0]) == pytest.approx(force + 0.5)
    assert run_of([1.0, 3.0], hand_force=40.0) == pytest.approx(force + 0.5 - 40.0)
    assert run_of([1.0, 3.0], hand_force=60.0) == 0.0
    assert run_of([3.0, 1.0]) == 0.0


def test_nothing_is_known_of_a_hand_out_of_contact_or_that_pushes_without_a_bound() -> None:
    assert run_of([1.0, 3.0], asked=0.0) == 0.0
    assert run_of([-1.0, -3.0]) == 0.0


def test_a_motion_begins_anew_behind_a_gap() -> None:
    watch = FrictionWatch(FrictionDeclared(0.5, 0.25, 1e-3, 0.0))
    for k in range(11):
        watch.take(0.001 * k, 0.0, k, -1.0)
    for k in range(11):
        watch.take(5.0 + 0.003 * k, 0.0, 30 + k, -1.0)
    assert watch.excess == 0.0


def test_errors_of_positions_times_and_of_late_torques_count_against_the_contradiction() -> None:
    """The equation of motion written anew, for torques that change in every hold, in and out of a contact."""
    found = 0
    for seed in range(60):
        draw = random.Random(seed)
        way, asked = draw.choice([1.0, -1.0]), draw.choice([1.0, -1.0])
        count, jitter, late = draw.choice([0.0, 1e-5]), draw.choice([0.0, 0.02]), draw.choice([0.0, 2e-4])
        known = FrictionDeclared(0.5, 0.25, 1e-3, 1.0, 4.0, count, jitter, late)
        watch, position, torques = FrictionWatch(known), 0.0, [draw.uniform(-3.0, 3.0) for _ in range(21)]
        watch.take(position, torques[0], 0, asked)
        speeds = draw.uniform(0.1, 1.0), draw.uniform(0.1, 1.5)
        for hold in range(20):
            position += way * speeds[hold // 10] * 1e-3
            watch.take(position, torques[hold + 1], hold + 1, asked)
        weights = [(hold + 0.5) / 10.0 for hold in range(10)]
        weights += [1.0 - weight for weight in weights]
        mean = sum(way * weight * torque for weight, torque in zip(weights, torques[1:], strict=True)) / 10.0
        mean += 3.0 * jitter * sum(map(abs, torques[1:])) / 10.0
        mean += sum(abs(after - before) for before, after in itertools.pairwise(torques)) * late / 0.01
        first, second = (0.01 * speeds[0] + count) / (1.0 - jitter), (0.01 * speeds[1] - count) / (1.0 + jitter)
        hand = 4.0 if way == asked else 1.0
        expected = 0.25 * (second - first) / 1e-4 - mean - hand * (1.0 + jitter) + 0.5 * (1.0 - jitter)
        assert watch.excess == pytest.approx(max(0.0, expected) if second > first else 0.0, abs=1e-9), seed
        found += watch.excess > 0.0
    assert found > 10
