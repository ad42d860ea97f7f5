"""Random scenes: any effects are combined, energies close and nothing hangs."""

import itertools
import math
from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st

from canhaptic.sim.plant.plant import Plant
from canhaptic.sim.plant.user import SinusoidMotion, UserParameters
from tests.drawn import examples
from tests.plant.plant_scenes import make_plant, residual


def rounded(largest: float) -> st.SearchStrategy[float]:
    return st.floats(-largest, largest).map(lambda value: round(value, 9))


def decades(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(math.log10(low), math.log10(high)).map(lambda exponent: float(10**exponent))


stops = st.fixed_dictionaries(
    {
        "type": st.just("hard_stop"),
        "position": rounded(0.02),
        "stiffness": decades(1e2, 1e8),
        "damping": st.just(0.0) | decades(1e-3, 1e4),
    }
)
shafts = st.fixed_dictionaries(
    {
        "type": st.just("shaft_compliance"),
        "stiffness": decades(1e3, 1e7),
        "damping": st.just(0.0) | decades(1e-2, 1e2),
        "load_mass": decades(1e-3, 1.0),
    }
)
levels = st.tuples(decades(1e-3, 1.0), st.floats(1.0, 3.0)).map(lambda t: {"kinetic": t[0], "static": t[0] * t[1]})
velocities = decades(1e-3, 0.1).map(lambda v: {"stribeck_velocity": v})
frictions = st.one_of(
    levels.map(lambda dry: {"type": "coulomb_friction", **dry}),
    st.tuples(levels, velocities).map(lambda t: {"type": "stribeck_friction", **t[0], **t[1]}),
    st.tuples(levels, velocities, decades(1e3, 1e8)).map(
        lambda t: {"type": "lugre_friction", **t[0], **t[1], "bristle_stiffness": t[2], "viscous": 0.1}
    ),
)
currents = decades(1e-6, 1e-2).map(lambda t: {"type": "current_loop", "time_constant": t})
coggings = decades(1e-3, 1.0).map(lambda a: {"type": "cogging", "amplitude": a, "pitch": 0.007})
users = st.none() | st.builds(
    UserParameters,
    stiffness=decades(1.0, 1e6),
    damping=st.just(0.0) | decades(1e-2, 1e3),
    rest=rounded(0.02),
    motion=st.none() | st.builds(SinusoidMotion, amplitude=decades(1e-4, 0.05), frequency=decades(0.1, 20.0)),
)


@st.composite
def scenes(draw: st.DrawFn) -> tuple[list[dict[str, Any]], UserParameters | None, int]:
    effects = [draw(part) for part in (stops, frictions, currents, coggings) if draw(st.booleans())]
    if draw(st.booleans()):
        effects += [
            draw(shafts),
            *([{"type": "backlash", "gap": draw(decades(1e-6, 1e-2))}] if draw(st.booleans()) else []),
        ]
    return effects, draw(users), draw(st.sampled_from([100_000, 1_000_000, 20_000_000]))


def energies(plant: Plant, torques: list[float]) -> tuple[list[float], float]:
    """Stored energy at every SYNC and the largest energy that was in play."""
    plant.begin(0)
    stored, largest = [0.0], 1e-9
    for k, torque in enumerate(torques):
        plant.advance_to((k + 1) * plant.sample_time_ns, torque)
        energy = plant.energy()
        stored.append(energy.stored)
        largest = max(largest, *map(abs, energy))
    return stored, largest


@settings(max_examples=examples(60))
@given(scenes(), st.lists(rounded(5.0), min_size=1, max_size=25), rounded(0.5))
def test_the_balance_closes_for_any_scene_and_torque(scene, torques, velocity):
    effects, user, period = scene
    plant = make_plant(*effects, user=user, period=period, initial_velocity=velocity)
    _, largest = energies(plant, torques)
    largest = max(largest, plant.stored_at_start)
    assert math.isfinite(plant.position)
    assert residual(plant) <= 1e-11 * largest + 1e-18


@settings(max_examples=examples(60))
@given(scenes(), rounded(0.5), rounded(0.02))
def test_energy_never_rises_in_any_scene_without_hand_and_torque(scene, velocity, position):
    effects, _, period = scene
    plant = make_plant(*effects, user=None, period=period, initial_velocity=velocity, initial_position=position)
    stored, _ = energies(plant, [0.0] * 25)
    start = plant.stored_at_start
    assert all(after - before <= 1e-12 * start + 1e-18 for before, after in itertools.pairwise(stored))
