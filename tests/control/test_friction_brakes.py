"""Friction that brakes: no motion on bristles, or on friction of any size either way, exceeds the bound.

T1 to T3 are statements of docs/theory/dry_friction.md.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from canhaptic.control.certificates.scalar_bounds import (
    displacement_response,
    hold_timing,
    next_displacement,
    renderable_by_hand_force,
    start_energy,
)
from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.control.passivity import LoopProperties
from canhaptic.control.passivity.guarded import GuardedParameters, settings_of
from canhaptic.errors import SceneError
from canhaptic.scene.load import load_scene
from tests.commission.whole_session import DEMO

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


def pushes_until_spent(v: _Array, left: _Array, force: _Array, most: _Array, stiffness: _Array, step: float) -> Any:
    """The worst that T1 allows: full size against an inward motion, full size along an outward one until e is spent."""
    energy = 0.5 * most**2 / stiffness
    spent = most * np.maximum(v + (force + most) * step, 0.0) * step  # at most, in this step
    r = np.where(v < 0.0, most, np.where(left > spent, most, 0.0))
    after = v + (force + r) * step
    way = 0.5 * (v + after) * step
    return after, np.where(v < 0.0, energy, left - most * np.maximum(way, 0.0)), way


def two_springs(slope: Callable[[_Array], _Array]) -> Callable[..., tuple[_Array, _Array]]:
    """A bristle of 97 % of the slope and 3 % of the force, and one of 3 % and 97 %; `slope` of both from sigma."""

    def moved(v: _Array, z: _Array, force: _Array, most: _Array, stiffness: _Array, step: float) -> Any:
        if z.ndim == 1:
            z = np.stack([np.full_like(most, math.inf), np.full_like(most, math.inf)]) * np.sign(z - 1e-300)
        of, limits = slope(stiffness), np.array([[0.03], [0.97]]) * most
        slopes = np.array([[0.97], [0.03]]) * of
        z = np.clip(z, -limits / slopes, limits / slopes)
        half = v + 0.5 * (force - (slopes * z).sum(0)) * step
        z = np.clip(z + half * step, -limits / slopes, limits / slopes)
        return half + 0.5 * (force - (slopes * z).sum(0)) * step, z, half * step

    return moved


GIVEN_BACK = 0.03**2 / 0.97 + 0.97**2 / 0.03  # by two springs, over F_c^2 / 2 sigma with sigma their first slope
MODELS: dict[str, Callable[..., Any]] = {
    "none outward": friction_either_way(0.0), "a third outward": friction_either_way(0.3),
    "the same both ways": friction_either_way(1.0), "spring": bristles("spring"), "Dahl": bristles("dahl"),
    "LuGre": bristles("lugre"), "all that it may": pushes_until_spent,
    "two springs, by energy": two_springs(lambda sigma: sigma * GIVEN_BACK),
    "two springs, by slope": two_springs(lambda sigma: sigma),
}  # fmt: skip


def excess(
    model: str, seed: int, softest: float, *, mended: bool = True, damping: float = 0.0, jitter: float = 0.0,
    peak: float = 1.0,
) -> float:  # fmt: skip
    """Largest displacement beyond the bound over random motions, in units of F_c T^2 / m; T = m = 1.

    Args:
        model: Friction of the motions.
        seed: Of the motions.
        softest: Least sigma.
        mended: Whether the bound knows sigma.
        damping: Of the device, known.
        jitter: The first hold is shorter by it, the second longer, or the other way round.
        peak: F_c of the motions over the one of the bound.
    """
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
    early = jitter * random.choice([-1.0, 1.0], n)
    for step in range(2 * STEPS):
        long = (1.0 + (early if step < STEPS else -early)) / STEPS
        force = torques[step // STEPS] + pull + pushes[step * PIECES // STEPS]
        force = force - damping * (v + 0.5 * (force - damping * v) * long)  # of the middle of the step
        v, z, moved = MODELS[model](v, z, force, peak * most, stiffness, long)
        way = way + moved
        if step % STEPS == STEPS - 1:
            ways.append(way)
            way = np.zeros(n)
    worst = -math.inf
    for k in range(n):
        of = displacement_response(
            1.0, 1.0, pull[k] + most[k], damping, damping, timing=hold_timing(1.0, jitter, 0.0, 0.0),
            friction=(most[k], stiffness[k] if mended else math.inf),
        )  # fmt: skip
        if of.brake > 0.0:
            bound = next_displacement(ways[0][k], torques[0][k], torques[1][k], of, of.hand)
            worst = max(worst, (ways[1][k] - bound) / most[k])
    return worst


HOLD = [model for model in MODELS if model != "two springs, by slope"]


@pytest.mark.slow_but("LuGre", "all that it may", "spring", "a third outward")
@pytest.mark.parametrize("model", HOLD)
def test_no_motion_on_friction_exceeds_the_bound(model: str) -> None:
    assert max(excess(model, seed, 3.0) for seed in range(3)) <= 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("model", HOLD)
@pytest.mark.parametrize(("damping", "jitter"), [(0.0, 0.0), (0.7, 0.0), (3.0, 0.0), (0.0, 0.2), (1.0, 0.1)])
def test_no_motion_with_damping_and_uneven_holds_exceeds_the_bound(model: str, damping: float, jitter: float) -> None:
    for seed in range(8):
        assert excess(model, seed, 3.0, damping=damping, jitter=jitter) <= (1e-3 if damping else 1e-9)  # of the steps


def test_bristles_whose_first_slope_is_taken_for_sigma_exceed_the_bound() -> None:
    assert max(excess("two springs, by slope", seed, 10.0) for seed in range(3)) > 0.05


def test_a_static_peak_above_the_declared_friction_exceeds_the_bound() -> None:
    assert max(excess("all that it may", seed, 10.0, peak=2.0) for seed in range(3)) > 0.05


@pytest.mark.parametrize("y", [3.0, 5.0, 10.0])
def test_friction_that_gives_all_back_at_a_reversal_reaches_the_term_of_the_bound_in_closed_form(y: float) -> None:
    # T = m = F_c = 1: braked from -inward to rest, pushed until e is spent, then at the speed w = 1 / sqrt(y)
    w = 1.0 / math.sqrt(y)  # also the time of the push
    inward = -w + math.sqrt(w * w + 2.0 * w * (1.0 - 0.5 * w))  # so that D_0 = 0
    assert -0.5 * inward**2 + 0.5 * w * w + w * (1.0 - inward - w) == pytest.approx(0.0, abs=1e-12)
    response = displacement_response(1.0, 1.0, 1.0, friction=(1.0, y))
    bound = next_displacement(0.0, 0.0, 0.0, response, response.hand)
    assert w <= bound == pytest.approx(0.125 + w)
    assert w > 0.125 + 0.5 * w  # with half the term the bound were exceeded


@pytest.mark.slow
@pytest.mark.parametrize("model", ["spring", "Dahl"])
def test_soft_bristles_exceed_a_bound_that_does_not_know_them(model: str) -> None:
    assert max(excess(model, seed, 0.013, mended=False) for seed in range(4)) > 0.02
    assert max(excess(model, seed, 0.013) for seed in range(4)) == -math.inf  # of these nothing is gained


def test_friction_brakes_a_motion_outward_or_from_rest_and_pulls_one_inward() -> None:
    mass, most = 0.15, 1.2
    h, extra = 1e-6 / mass, most * (1e-6 / (8.0 * mass) + 1e-3 / math.sqrt(1e7 * mass))
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
