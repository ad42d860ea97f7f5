"""Friction that brakes: no motion on bristles, or on friction of any size either way, exceeds the bound."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from canhaptic.control.certificates.scalar_bounds import (
    displacement_response,
    next_displacement,
    renderable_by_hand_force,
    start_energy,
)
from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.control.passivity import LoopProperties
from canhaptic.control.passivity.guarded import GuardedParameters, settings_of
from canhaptic.errors import SceneError
from canhaptic.scene.load import load_scene
from tests.commission.test_commissioning import DEMO

STEPS, PIECES, MOTIONS = 200, 8, 300
_Array = np.ndarray[Any, np.dtype[np.float64]]


def friction_either_way(share: float) -> Callable[..., tuple[_Array, _Array]]:
    """Sliding friction of full size inward and a share of it outward; sticks at rest."""

    def moved(v: _Array, z: _Array, force: _Array, most: _Array, stiffness: _Array, step: float) -> Any:
        r = np.where(v < 0.0, most, np.where(v > 0.0, -share * most, np.clip(-force, -most, most)))
        after = v + (force + r) * step
        after = np.where(v * after < 0.0, 0.0, after)
        return after, z, 0.5 * (v + after) * step

    return moved


def bristles(kind: str) -> Callable[..., tuple[_Array, _Array]]:
    """Bristles that slide at once (spring), creep (Dahl), or creep and damp (LuGre); leapfrog."""

    def moved(v: _Array, z: _Array, force: _Array, most: _Array, stiffness: _Array, step: float) -> Any:
        lim = most / stiffness
        damp = 0.4 * np.sqrt(stiffness) if kind == "lugre" else 0.0 * stiffness
        rate = v * (1.0 - np.sign(v) * z / lim)
        half = v + 0.5 * (force - np.clip(stiffness * z + damp * rate, -most, most)) * step
        way = half * step
        if kind == "spring":
            z = np.clip(z + way, -lim, lim)
        else:
            end = np.sign(way) * lim
            z = np.where(way == 0.0, z, end - (end - z) * np.exp(-np.abs(way) / lim))
        rate = half * (1.0 - np.sign(half) * z / lim)
        return half + 0.5 * (force - np.clip(stiffness * z + damp * rate, -most, most)) * step, z, way

    return moved


MODELS: dict[str, Callable[..., Any]] = {
    "none outward": friction_either_way(0.0), "a third outward": friction_either_way(0.3),
    "the same both ways": friction_either_way(1.0), "spring": bristles("spring"), "Dahl": bristles("dahl"),
    "LuGre": bristles("lugre"),
}  # fmt: skip


def excess(model: str, seed: int, softest: float, *, mended: bool = True) -> float:
    """Largest displacement beyond the bound over random motions, in units of F_c T^2 / m; T = m = 1."""
    random = np.random.default_rng(seed)
    n = MOTIONS
    most, pull = 10.0 ** random.uniform(-1.0, 1.0, n), random.choice([0.0, 1.0], n) * random.uniform(0.0, 2.0, n)
    torques = 10.0 ** random.uniform(-1.0, 1.0, (2, n)) * random.choice([0.0, 1.0, 1.0], (2, n))
    stiffness = softest * 10.0 ** random.uniform(0.0, 2.0, n)
    whole = torques[0] + pull + most
    v = np.where(random.random(n) < 0.7, -whole * random.random(n), whole * random.uniform(-3.0, 1.0, n))
    pushes = np.zeros((2 * PIECES, n))
    for motion in np.flatnonzero(random.random(n) < 0.6):
        first = int(random.integers(2 * PIECES))
        pushes[first : first + int(random.integers(1, PIECES)), motion] = -whole[motion] * 10.0 ** random.uniform(-1, 2)
    z = -most / stiffness * random.choice([1.0, 1.0, 0.3, -1.0], n)
    way, ways = np.zeros(n), []
    for step in range(2 * STEPS):
        force = torques[step // STEPS] + pull + pushes[step * PIECES // STEPS]
        v, z, moved = MODELS[model](v, z, force, most, stiffness, 1.0 / STEPS)
        way = way + moved
        if step % STEPS == STEPS - 1:
            ways.append(way)
            way = np.zeros(n)
    worst = -math.inf
    for k in range(n):
        of = displacement_response(
            1.0, 1.0, pull[k] + most[k], friction=(most[k], stiffness[k] if mended else math.inf)
        )
        if of.brake > 0.0:
            bound = next_displacement(ways[0][k], torques[0][k], torques[1][k], of, of.hand)
            worst = max(worst, (ways[1][k] - bound) / most[k])
    return worst


@pytest.mark.parametrize("model", MODELS)
def test_no_motion_on_friction_exceeds_the_bound(model: str) -> None:
    assert max(excess(model, seed, 10.0) for seed in range(3)) <= 1e-9


@pytest.mark.parametrize("model", ["spring", "Dahl"])
def test_soft_bristles_exceed_a_bound_that_does_not_know_them(model: str) -> None:
    assert max(excess(model, seed, 0.05, mended=False) for seed in range(4)) > 0.02
    assert max(excess(model, seed, 0.05) for seed in range(4)) == -math.inf  # of these nothing is gained


def test_friction_brakes_a_motion_outward_or_from_rest_and_pulls_one_inward() -> None:
    mass, most = 0.15, 1.2
    h, extra = 1e-6 / mass, most * (1e-6 / (8.0 * mass) + 1.5e-3 / math.sqrt(1e7 * mass) + 4e-7)
    of = displacement_response(1e-3, mass, 5.0 + most, friction=(most, 1e7))
    assert of.brake == pytest.approx(h * most - extra)
    at_rest = h * 5.0 + extra
    assert next_displacement(0.0, 0.0, 0.0, of, of.hand) == pytest.approx(at_rest)
    assert next_displacement(3e-5, 0.0, 0.0, of, of.hand) == pytest.approx(3e-5 + at_rest)
    assert next_displacement(-0.5 * of.brake, 0.0, 0.0, of, of.hand) == pytest.approx(at_rest)
    assert next_displacement(-3e-5, 0.0, 0.0, of, of.hand) == pytest.approx(-3e-5 + h * (5.0 + most))
    assert displacement_response(1e-3, mass, 5.0 + most, friction=(most, 1e5)).brake == 0.0  # they spring back too far
    pulls = displacement_response(1e-3, mass, 5.0 + most)
    gain = renderable_by_hand_force(of, 0, 5.0) / renderable_by_hand_force(pulls, 0, 5.0)
    assert 1.04 < gain < 1.12  # 1.12 were bristles rigid
    assert start_energy(pulls, 0, 1000.0) > 0.0


def test_only_a_declared_stiffness_and_cogging_make_friction_a_brake() -> None:
    wall, known = SpringDamperWall(stiffness=1000.0, damping=0.0, position=0.0), GuardedParameters(hand_force=2.0)
    loop = LoopProperties(sample_time=1e-3, moving_mass=0.15, device_damping_bound=0.1, device_friction_bound=1.2)
    both = {"device_cogging_bound": 0.2, "presliding_stiffness": 1e8}
    brakes = {
        keys: settings_of(wall, known, loop.model_copy(update={key: both[key] for key in keys})).declared.response.brake
        for keys in ((), ("device_cogging_bound",), ("presliding_stiffness",), tuple(both))
    }
    assert [value > 0.0 for value in brakes.values()] == [False, False, False, True]
    of = settings_of(wall, known, loop.model_copy(update=both))
    assert of.earned == settings_of(wall, known, loop).earned  # a contact begins inward
    with pytest.raises(SceneError, match="friction brakes only where"):
        load_scene(DEMO, ["passivity.presliding_stiffness=1e7"])
