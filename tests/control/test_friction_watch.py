"""A run that moves faster than declared friction lets it is found, by the simulated plant; one that does not, never."""

import random

import pytest

from canhaptic.control.friction_watch import FrictionDeclared, FrictionWatch
from canhaptic.sim.plant.effects.coulomb_friction import CoulombFriction
from canhaptic.sim.plant.guided_hand import PUSH, PUSH_RATE, GuidedHand
from canhaptic.sim.plant.plant import Plant, PlantParameters

MASS, HAND = 0.25, 3.0


def excess(
    friction: float, declared: float, seed: int, *, most: float = HAND, count: float = 0.0, jitter: float = 0.0
) -> float:
    """Largest excess [N] of a run of 2 s under a hand that changes its mind, with random torques besides."""
    chance, period = random.Random(seed), 1_000_000
    effect = CoulombFriction(kinetic=friction, static=friction)
    plant = Plant(PlantParameters(mass=MASS, damping=0.1), GuidedHand(), [effect], period)
    watch = FrictionWatch(FrictionDeclared(declared, 0.9 * MASS, HAND, 1e-3, count, jitter))
    plant.begin(0)
    now, torque = 0, 0.0
    for k in range(2000):
        if k % 100 == 0:
            push = most * chance.choice((-1.0, 1.0)) * chance.uniform(0.5, 1.0)
            plant.set_states({PUSH: push, PUSH_RATE: -0.2 * push})
        if k % 7 == 0:
            torque = chance.uniform(-0.4, 0.4)
        now += round(period * (1.0 + jitter * chance.uniform(-1.0, 1.0)))
        plant.advance_to(now, torque)
        seen = round(plant.position / count) * count if count else plant.position
        watch.take(seen, torque)
    return watch.excess


@pytest.mark.parametrize(("count", "jitter"), [(0.0, 0.0), (1e-6, 0.0), (0.0, 0.01)])
def test_a_run_with_the_friction_that_is_declared_contradicts_nothing(count: float, jitter: float) -> None:
    assert max(excess(0.5, 0.5, seed, count=count, jitter=jitter) for seed in range(4)) == 0.0


@pytest.mark.parametrize("count", [0.0, 1e-6])
def test_a_run_of_a_hand_near_its_bound_shows_that_the_friction_is_gone(count: float) -> None:
    found = [excess(0.05, 1.5, seed, count=count) for seed in range(4)]
    assert max(found) > 0.5
    assert max(found) < 1.5  # what is missing, less what the mass may be more


def test_a_hand_far_from_its_bound_hides_it() -> None:
    assert excess(0.05, 1.5, 1, most=0.3 * HAND) == 0.0


def test_a_gap_is_no_motion() -> None:
    watch = FrictionWatch(FrictionDeclared(0.5, 0.25, 0.0, 1e-3))
    for k in range(20):
        watch.take(0.001 * k, 0.0)
    watch.restart()
    for k in range(25):
        watch.take(5.0 + 0.01 * k, 0.0)
    assert watch.excess == 0.0
    for k in range(20):
        watch.take(5.25 + 0.03 * k, 0.0)
    assert watch.excess > 0.0
