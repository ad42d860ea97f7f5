"""A fast mode that is at rest costs nothing; what swings too fast to follow is refused with a remedy."""

import math

import numpy as np
import pytest

from canhaptic.errors import EventLimitError
from canhaptic.lab.judge.reference_model import Model
from canhaptic.lab.judge.solvers import reference
from canhaptic.sim.plant.assembly import guard_bounds
from canhaptic.sim.plant.user import SinusoidMotion, UserParameters
from tests.plant.plant_scenes import MS, make_plant, run

PLACE, STIFFNESS = 1e-3, 1e9
STOP = {"type": "hard_stop", "position": PLACE, "stiffness": STIFFNESS}
HAND = UserParameters(stiffness=300, damping=3, motion=SinusoidMotion(amplitude=0.03, frequency=1.0))


@pytest.mark.parametrize("period", [25_000, MS, 25 * MS])
@pytest.mark.parametrize("mass", [1e-6, 1e-9, 1e-12])
def test_a_mass_that_rests_on_a_stiff_stop_costs_few_products(mass, period):
    """Pressed with 1 N from a tenth of the way on: m x'' + b x' + k x = 1 in closed form, at every SYNC."""
    damping, holds = 0.1, 20
    start = PLACE + 0.1 / STIFFNESS
    plant = make_plant(STOP, user=None, mass=mass, damping=damping, initial_position=start, period=period)
    positions = run(plant, [1.0] * holds)
    times = np.arange(holds + 1) * period * 1e-9
    decay = damping / (2.0 * mass)
    pace = complex(decay**2 - STIFFNESS / mass) ** 0.5
    slow, fast = pace - decay, -pace - decay
    depth = 1.0 - 0.9 * ((slow * np.exp(fast * times) - fast * np.exp(slow * times)) / (slow - fast)).real
    positions -= depth / STIFFNESS
    assert np.abs(positions - PLACE).max() <= 1e-11 * PLACE
    assert plant.events == 0
    assert plant.products <= 1000 + 8 * holds


@pytest.mark.slow
def test_a_hand_on_a_stiff_stop_meets_the_reference_at_every_sync():
    """1e-6 kg between a hand and 1e9 N/m, current loop and all: DOP853 follows every swing of 30 Mrad/s."""
    pytest.importorskip("scipy")
    plant = make_plant(dict(STOP, position=2e-6), user=HAND, mass=1e-6, damping=1.0, period=25_000)
    exact = reference(Model(plant.parameters, HAND, plant.effects), [0.5] * 16, 25_000)
    positions = run(plant, [0.5] * 16)
    assert plant.events >= 1
    assert np.abs(positions[1:] - exact.position).max() <= 1e-9 * 2e-6
    assert plant.products <= 100 * 16


@pytest.mark.parametrize("phase", [3.0, 3e3, 3e6, 3e9])
def test_the_bounds_hold_over_any_number_of_swings(phase):
    """cos(phase t + a) and its chord over [0, 1] in closed form, at 400 instants, from 30 states."""
    rates = np.array([[0.0, phase, 0.0], [-phase, 0.0, 0.0], [0.0, 0.0, 0.0]])
    bounds, chance = guard_bounds(np.array([[1.0, 0.0, 2.0]]), rates, 1.0), np.random.default_rng(1)
    for start in chance.uniform(0.0, 2.0 * math.pi, 30):
        speeds = np.abs(bounds.scaled @ [math.cos(start), -math.sin(start), 1.0])
        times = chance.uniform(0.0, 1.0, 400)
        line = math.cos(start) + times * (math.cos(phase + start) - math.cos(start))
        assert np.all(np.abs(np.cos(phase * times + start) - line) <= bounds.chord[0] @ speeds)
    assert np.isfinite(bounds.slack).all()


def test_what_swings_too_fast_to_follow_is_refused_with_a_remedy():
    """It starts where it swings for ever within the stop, without a damper: 30,000 rad a hold, 50 million in 25 ms."""
    few = {"max_events": 4}
    plant = make_plant(
        STOP, user=None, mass=1e-6, damping=0.0, initial_position=PLACE + 5e-10, accuracy=few, period=25 * MS
    )
    with pytest.raises(EventLimitError, match=r"before 0\.025 s: got more than 2048 products") as caught:
        run(plant, [1.0])
    assert "give it damping, more mass or less stiffness" in str(caught.value)
    assert "upper_stop touching" in str(caught.value)


def test_the_phase_of_the_fastest_swing_is_that_of_the_closed_form():
    plant = make_plant(STOP, user=None, mass=1e-6, damping=0.2)
    phase, mode = plant.scene.fastest_swing()
    pace = math.sqrt(STIFFNESS / 1e-6 - (0.2 / 2e-6) ** 2)  # and its damping lasts for 10 us of a sample time of 1 ms
    assert phase == pytest.approx(pace * 2e-6 / 0.2, rel=1e-9)
    assert mode == "upper_stop touching"
    assert make_plant().scene.fastest_swing()[0] == 0.0  # no guard looks at the hand's swing
    compliant = make_plant({"type": "shaft_compliance", "stiffness": 1e9, "load_mass": 1e-9})
    assert compliant.scene.fastest_swing()[0] == 0.0


@pytest.mark.parametrize("seed", range(6))
def test_no_hold_takes_more_products_than_its_fastest_swing_announces(seed):
    """Contacts of any mass and stiffness, met at speed: five products a radian, and a hundred for each event."""
    chance = np.random.default_rng(seed)
    mass, period = 10.0 ** chance.uniform(-9.0, 0.0), int(10.0 ** chance.uniform(4.4, 6.5))
    stiffness = mass * (10.0 ** chance.uniform(0.0, 2.5) / (period * 1e-9)) ** 2
    stop = {"type": "hard_stop", "position": PLACE, "stiffness": min(stiffness, 1e10)}
    speed = 0.5 * PLACE / (period * 1e-9)
    plant = make_plant(stop, user=None, mass=mass, damping=0.0, period=period, initial_velocity=min(speed, 1e3))
    phase, push = plant.scene.fastest_swing()[0], 2.0 * mass * speed / (period * 1e-9)
    plant.begin(0)
    for hold in range(1, 9):
        before, events = plant.products, plant.events
        plant.advance_to(hold * period, push)
        assert plant.products - before <= 100 * (1 + plant.events - events) + 5.0 * phase
    assert plant.events > 0
