"""A hold that is taken without looking at its guards has no event, for all torques within the limit."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canhaptic.sim.plant.assembly import guard_bounds
from canhaptic.sim.plant.hybrid_automaton import HOLDS, GuardHorizon
from canhaptic.sim.plant.plant import Plant
from tests.drawn import examples
from tests.plant.plant_scenes import MS, make_plant, run
from tools.bench.plants.affine_judge import exponential
from tools.bench.plants.random_scenes import RandomScene, random_scene

STOP = {"type": "hard_stop", "position": 0.02, "stiffness": 1e6, "damping": 30}


@st.composite
def held_systems(draw: st.DrawFn) -> tuple[np.ndarray, np.ndarray, np.ndarray, float, int]:
    """Rates of [x, torque, one] with any spectrum, guards some way off, a state, a largest torque and a seed."""
    seed = draw(st.integers(0, 2**32))
    chance, size = np.random.default_rng(seed), draw(st.integers(2, 4))
    rates = np.zeros((size + 2, size + 2))
    rates[:size] = chance.normal(size=(size, size + 2)) * chance.choice([0.0, 0.05, 0.5], size=(size, size + 2))
    guards, state = chance.normal(size=(2, size + 2)), np.append(chance.normal(size=size), [0.0, 1.0])
    guards[:, -1] += draw(st.floats(1.0, 30.0))
    return rates, guards, state, draw(st.floats(0.0, 2.0)), seed


@pytest.mark.slow
@settings(max_examples=examples(80))
@given(held_systems())
def test_no_guard_is_reached_in_the_holds_that_are_promised(system):
    """Against torques at random and at their limits, by an exponential of its own at 9 instants of each hold."""
    rates, guards, state, largest, seed = system
    bounds = guard_bounds(guards, rates, 1.0)
    holds = GuardHorizon(guards, bounds.scaled, bounds.slack[0], exponential(rates)).holds(state, largest)
    flows, chance = [exponential(rates * (part / 8)) for part in range(9)], np.random.default_rng(seed)
    for _ in range(3):
        now = state.copy()
        for _ in range(holds):
            now[-2] = largest * chance.choice([-1.0, 1.0, chance.uniform(-1.0, 1.0)])
            assert all((guards @ flow @ now).min() > 0.0 for flow in flows)
            now = flows[-1] @ now


@pytest.mark.parametrize("largest", [0.0, 0.3])
def test_a_body_at_a_steady_speed_is_followed_almost_to_the_stop(largest):
    """x' = v, v' = u: the closest that torques can push it is v t + largest t^2 / 2."""
    rates = np.array([[0.0, 1.0, 0, 0], [0, 0, 1.0, 0], [0, 0, 0, 0], [0, 0, 0, 0]])
    guard, state = np.array([[-1.0, 0.0, 0.0, 20.0]]), np.array([0.0, 1.0, 0.0, 1.0])
    bounds = guard_bounds(guard, rates, 1.0)
    holds = GuardHorizon(guard, bounds.scaled, bounds.slack[0], exponential(rates)).holds(state, largest)
    reach = 20.0 if not largest else (math.sqrt(1.0 + 2.0 * largest * 20.0) - 1.0) / largest
    assert reach - 3.0 <= holds <= reach
    assert (
        GuardHorizon(guard * 0 + 1.0, bounds.scaled, bounds.slack[0] * 0, exponential(rates)).holds(state, 0) == HOLDS
    )
    assert GuardHorizon(guard, bounds.scaled, bounds.slack[0], exponential(rates)).holds(state * math.nan, 0) == 0


def without_looking_ahead(scene: RandomScene) -> tuple[np.ndarray, Plant]:
    """Returns the positions with every hold judged, and the plant."""
    plant = scene.build()
    plant._looks_ahead = False
    return run(plant, scene.torques), plant


@pytest.mark.slow_but("[0-3]")
@pytest.mark.parametrize("seed", range(40))
def test_looking_ahead_changes_no_event_of_a_random_scene(seed):
    scene = random_scene(seed)
    plant = scene.build()
    positions = run(plant, scene.torques)
    expected, judged = without_looking_ahead(scene)
    assert plant.events == judged.events
    assert np.abs(positions - expected).max() <= 1e-9 * np.abs(expected).max()


def test_a_torque_beyond_what_was_expected_is_judged():
    """Ten quiet holds, then torques that throw the handle onto the stop, first in whole and then in broken holds."""
    plant, judged = make_plant(STOP, user=None), make_plant(STOP, user=None)
    judged._looks_ahead = False
    torques = [0.001] * 20 + [40.0] * 20 + [-1.0] * 20
    assert np.abs(run(plant, torques) - run(judged, torques)).max() <= 1e-12
    assert plant.events == judged.events > 0
    for each in (plant, judged):
        each.reset()
        each.begin(0)
        for k in range(60):
            each.advance_to(k * MS + MS // 3, 0.0 if k < 30 else 60.0)
            each.advance_to((k + 1) * MS, 0.0)
    assert plant.position == pytest.approx(judged.position, abs=1e-12)
    assert plant.events == judged.events > 0


@pytest.mark.parametrize(("start", "limit", "largest"), [(1.0, 0.5, 0.0), (0.0, 0.04, 1.0)])
def test_a_swing_that_ends_every_hold_where_it_began_is_not_taken_for_rest(start, limit, largest):
    """x'' = -(2 pi)^2 x + u over T = 1: the guard x > -limit is broken half way, by the swing or by the torque."""
    rates = np.zeros((4, 4))
    rates[0, 1], rates[1, 0], rates[1, 2] = 1.0, -((2.0 * math.pi) ** 2), 1.0
    guard, state = np.array([[1.0, 0.0, 0.0, limit]]), np.array([start, 0.0, 0.0, 1.0])
    bounds = guard_bounds(guard, rates, 1.0)
    horizon = GuardHorizon(guard, bounds.scaled, bounds.slack[0], exponential(rates))
    assert horizon.holds(state, largest) == 0
    far = GuardHorizon(100.0 * guard + [[0, 0, 0, 9e3]], bounds.scaled, 100.0 * bounds.slack[0], exponential(rates))
    assert far.holds(state, largest) > 0
