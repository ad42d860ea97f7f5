"""No event is missed: the bound on guards is strict, and a run does not depend on how its time is cut."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canhaptic.lab.judge.reference_model import Model
from canhaptic.lab.judge.solvers import reference
from canhaptic.sim.plant import assembly
from canhaptic.sim.plant.assembly import GuardBounds, guard_bounds
from canhaptic.sim.plant.plant import Plant
from canhaptic.sim.plant.user import UserParameters
from tests.drawn import examples
from tests.plant.plant_scenes import MS, make_plant, run
from tools.bench.plants.affine_judge import exponential, judged
from tools.bench.plants.random_scenes import apart, random_scene


@st.composite
def linear_systems(draw: st.DrawFn) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
    """Rates with any spectrum, up to ||F|| T of a thousand; a guard; a state; a level."""
    chance = np.random.default_rng(draw(st.integers(0, 2**32)))
    size, stiffness = draw(st.integers(2, 5)), 10.0 ** draw(st.floats(-1.0, 3.0))
    rates = chance.normal(size=(size, size)) * chance.choice([0.0, 0.03, 1.0], size=(size, size))
    kind = draw(st.sampled_from(["any", "stable", "swinging", "nilpotent"]))
    if kind == "stable":
        rates -= (0.1 + np.abs(np.linalg.eigvals(rates).real).max()) * np.eye(size)
    if kind == "swinging":
        rates = rates - rates.T
    if kind == "nilpotent":
        rates = np.triu(rates, 1)
    rates *= stiffness / max(1.0, np.abs(rates).sum(axis=0).max())
    rates *= min(1.0, 30.0 / max(30.0, np.linalg.eigvals(rates).real.max()))
    return rates, chance.normal(size=(2, size)), chance.normal(size=size), draw(st.integers(0, 14))


@settings(max_examples=examples(60))
@given(linear_systems())
def test_the_bounds_hold_at_every_instant_of_a_step(system):
    """Chord and curvature of a guard along the flow, by an exponential of its own, at 17 instants of the step."""
    rates, guards, state, level = system
    bounds, step = guard_bounds(guards, rates, 1.0), 0.5**level
    speeds = np.abs(bounds.scaled @ state)
    off, moved = bounds.chord[level] @ speeds, bounds.spread[level] @ speeds
    begin, end = guards @ state, guards @ exponential(rates * step) @ state
    bend = bounds.bend @ (bounds.scaled @ state)
    assert np.all(off <= bounds.slack[level] * np.linalg.norm(bounds.scaled @ state) * (1 + 1e-12))
    for part in np.linspace(0.0, 1.0, 17):
        there = exponential(rates * (step * part)) @ state
        rounding = 1e-12 * (np.abs(guards) @ np.abs(there) + np.abs(begin) + np.abs(end))
        assert np.all(np.abs(guards @ there - begin - part * (end - begin)) <= off + rounding)
        steep = np.abs(guards) @ np.abs(rates @ rates) @ np.abs(there)
        assert np.all(np.abs(guards @ rates @ rates @ there - bend) <= moved + 1e-11 * steep + 1e-12)


def test_the_bounds_fall_as_the_square_of_the_step_and_as_the_step():
    rates = np.array([[0.0, 1.0, 0.0], [-9.0, -1.0, 2.0], [0.0, 0.0, 0.0]])
    bounds = guard_bounds(np.eye(3)[:1], rates, 0.1)
    speeds = np.abs(bounds.scaled @ np.ones(3))
    chord, spread = bounds.chord[:, 0] @ speeds, bounds.spread[:, 0] @ speeds
    assert np.allclose(chord[8:20] / chord[9:21], 4.0, rtol=0.02)
    assert np.allclose(spread[8:20] / spread[9:21], 2.0, rtol=0.02)


def servo() -> Plant:
    """0.15 kg that dry friction stops while the current is still rising; it then stays stuck for the whole 10 ms.

    The velocity falls below zero and rises again inside the hold; the soft hand makes it convex, then concave.
    """
    friction = {"type": "coulomb_friction", "kinetic": 2.7, "static": 3.8}
    loop = {"type": "current_loop", "time_constant": 2e-4}
    hand = UserParameters(stiffness=130.0, damping=0.84)
    return make_plant(friction, loop, user=hand, mass=0.15, period=10 * MS, initial_velocity=1.84e-3)


@pytest.mark.slow
@pytest.mark.parametrize("torques", [[3.5, -3.5], [3.2, 5.0, -5.0], [-2.9, 4.5, 4.5], [2.71, -1.0, 2.71]])
def test_a_servo_that_stops_inside_a_hold_is_right_to_a_nanometre(torques):
    plant = servo()
    expected = reference(Model(plant.parameters, plant.user, plant.effects), torques, plant.sample_time_ns)
    assert np.abs(run(plant, torques)[1:] - expected.position).max() <= 1e-9
    assert np.abs(plant.velocity - expected.velocity[-1]) <= 1e-7


@pytest.mark.slow
@pytest.mark.parametrize("count", [10, pytest.param(150, marks=pytest.mark.slow)])
def test_random_scenes_have_the_same_events_at_a_thirty_second_of_their_sample_time(count):
    """A guard that is crossed twice inside a step is seen by shorter steps; scenes are up to 600 events long."""
    scenes = [random_scene(seed) for seed in range(count)]
    assert {scene.seed: told for scene in scenes if (told := apart(scene))} == {}


def ends_only(*arguments: Any) -> GuardBounds:
    bounds = guard_bounds(*arguments)
    return bounds._replace(slack=0.0 * bounds.slack, chord=0.0 * bounds.chord)


def test_a_bound_that_is_too_small_is_caught(monkeypatch):
    """The bound by the ends of a step alone, as it was once: what the tests above are for."""
    assert abs(run(servo(), [3.5])[-1]) <= 1e-6
    monkeypatch.setattr(assembly, "guard_bounds", ends_only)
    assert abs(run(servo(), [3.5])[-1]) >= 1e-4


@pytest.mark.parametrize("count", [8, pytest.param(80, marks=pytest.mark.slow)])
def test_random_scenes_agree_with_an_independent_judge(count):
    """Events, positions, velocities and works, by the textbook equations and located events."""
    scenes = [random_scene(seed) for seed in range(1000, 1000 + count)]
    assert {scene.seed: told for scene in scenes if (told := judged(scene)[0])} == {}


@pytest.mark.slow_but("43")
@pytest.mark.parametrize("seed", [4, 5, 43, 168, 177])
def test_the_judge_finds_a_missed_event(monkeypatch, seed):
    """The same judge on a plant that looks at the ends of its steps only."""
    assert judged(random_scene(seed))[0] == ""
    monkeypatch.setattr(assembly, "guard_bounds", ends_only)
    assert "by the judge" in judged(random_scene(seed))[0]
