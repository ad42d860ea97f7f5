"""Where simulators of haptic rigs usually fail, in addition to `test_hard_scenes`; each against a reference."""

import math

import numpy as np
import pytest

from canhaptic.errors import EventLimitError
from canhaptic.sim.plant.plant import Plant
from tests.plant.plant_scenes import (
    MASS,
    MS,
    make_plant,
    run,
)

CURRENT = {"type": "current_loop", "time_constant": 5e-5}


@pytest.mark.parametrize("depth", [1e-4, 1e-9, 1e-12])
def test_grazing_contact_inside_one_hold_is_not_missed(depth):
    """At constant torque the mass rises to its apex `depth` beyond a stop and falls back within one hold."""
    period, torque, stiffness = 20 * MS, -2.5, 1e4
    deceleration = -torque / MASS
    speed = deceleration * 8e-3  # the apex is reached 8 ms into the hold
    apex = speed**2 / (2 * deceleration)
    stop = {"type": "hard_stop", "position": apex - depth, "stiffness": stiffness}
    plant = make_plant(stop, user=None, damping=0.0, initial_velocity=speed, period=period)
    run(plant, [torque])

    enter_speed = math.sqrt(2 * deceleration * depth)
    pace = math.sqrt(stiffness / MASS)
    contact = 2 * math.atan2(enter_speed * pace, deceleration) / pace
    flight = 20e-3 - (speed - enter_speed) / deceleration - contact
    assert plant.events == 2
    assert plant.position == pytest.approx(
        apex - depth - enter_speed * flight - deceleration * flight**2 / 2, abs=1e-8 * apex
    )
    assert plant.velocity == pytest.approx(-enter_speed - deceleration * flight, rel=1e-8)


def test_a_stop_just_out_of_reach_is_not_touched():
    deceleration, speed = 10.0, 0.08
    apex = speed**2 / (2 * deceleration)
    stop = {"type": "hard_stop", "position": apex * (1 + 1e-9), "stiffness": 1e6}
    plant = make_plant(stop, user=None, damping=0.0, initial_velocity=speed, period=20 * MS)
    run(plant, [-2.5])
    assert plant.events == 0
    assert plant.position == pytest.approx(speed * 0.02 - deceleration * 0.02**2 / 2, abs=1e-15)


STOPS = [
    {"type": "hard_stop", "position": 1e-9, "stiffness": 1e10},
    {"type": "hard_stop", "position": -1e-9, "side": "lower", "stiffness": 1e10},
]


@pytest.mark.slow
def test_more_events_than_the_cap_end_the_run_with_state_and_remedy():
    """An elastic ball between two stops 2 nm apart: a million impacts in one hold."""
    plant = make_plant(*STOPS, user=None, damping=0.0, initial_velocity=10.0, mass=1e-6)
    with pytest.raises(EventLimitError, match=r"before 0\.001 s: got more than 1000 changes of mode") as caught:
        run(plant, [0.0] * 2)
    assert "raise accuracy.max_events" in str(caught.value)
    assert "upper_stop touching, lower_stop apart; position 1." in str(caught.value)
    assert plant.events == 1001
    with pytest.raises(EventLimitError):
        make_plant(*STOPS, user=None, damping=0.0, initial_velocity=10.0, mass=1e-6).run(np.zeros(2))


@pytest.mark.slow
def test_the_cap_counts_per_sample_time_however_it_is_cut():
    """Eight impacts a millisecond, 16 changes of mode: 20 are enough for it whole, in pieces, and ten at a time."""
    stops = [dict(stop, position=1e-3 * (1 if stop["position"] > 0 else -1)) for stop in STOPS]  # type: ignore[operator]

    def ball(most: int) -> Plant:
        plant = make_plant(
            *stops, user=None, damping=0.0, initial_velocity=16.0, mass=1e-6, accuracy={"max_events": most}
        )
        plant.begin(0)
        return plant

    def fly(plant: Plant, pieces: list[int]) -> int:
        for now in pieces:
            plant.advance_to(now, 0.0)
        return plant.events

    for pieces in ([k * MS for k in range(1, 21)], [k * MS // 7 for k in range(1, 141)], [10 * MS, 20 * MS]):
        assert 300 < fly(ball(20), pieces) < 340
        with pytest.raises(EventLimitError, match="more than 10 changes"):
            fly(ball(10), pieces)


def test_the_cap_is_no_larger_late_in_a_run():
    """A ball that is at rest for 20 ms, then thrown: more than four changes in the next hold."""
    stops = [dict(stop, position=1e-3 * (1 if stop["position"] > 0 else -1)) for stop in STOPS]  # type: ignore[operator]
    plant = make_plant(*stops, user=None, damping=0.0, mass=1e-6, accuracy={"max_events": 4})
    with pytest.raises(EventLimitError, match=r"before 0\.02\d s: got more than 4 changes"):
        run(plant, [0.0] * 20 + [0.016] + [0.0] * 8)


def test_a_force_at_the_very_edge_of_stiction_holds_and_a_hair_more_slides():
    friction = {"type": "coulomb_friction", "kinetic": 0.3, "static": 0.5}
    still, sliding = make_plant(friction, user=None), make_plant(friction, user=None)
    run(still, [0.5] * 10)
    run(sliding, [0.5 * (1 + 1e-9)] * 10)
    assert still.position == 0.0
    assert sliding.position == pytest.approx(0.5 * (0.2 / MASS) * 0.01**2, rel=2e-3)


def test_a_stop_met_while_already_beyond_it_pushes_back():
    plant = make_plant(
        {"type": "hard_stop", "position": 0.0, "stiffness": 1e4, "damping": 10}, user=None, initial_position=1e-3
    )
    run(plant, [0.0] * 100)
    assert plant.position < 0.0
    assert plant.velocity < 0.0


def test_a_late_sync_moves_the_plant_by_the_time_that_passed():
    """A SYNC that comes 137 us late, and one that is lost: the plant knows only time."""
    effects = [{"type": "coulomb_friction", "kinetic": 0.3, "static": 0.5}, CURRENT]
    punctual, late = make_plant(*effects), make_plant(*effects)
    for plant in (punctual, late):
        plant.begin(0)
    for k in range(1, 300):
        punctual.advance_to(k * MS, 1.5)
        if k % 10 != 5:
            late.advance_to(k * MS + (137_000 if k % 10 == 2 else 0), 1.5)
    assert late.position == pytest.approx(punctual.position, rel=1e-9)
    assert late.energy().user == pytest.approx(punctual.energy().user, rel=1e-9)


def test_the_error_of_an_event_falls_with_every_event_bit():
    stop = {"type": "hard_stop", "position": 0.01, "stiffness": 1e5, "damping": 100}
    ends = [
        run(make_plant(stop, user=None, initial_velocity=0.3, accuracy={"event_bits": bits}), [0.0] * 50)[-1]
        for bits in (8, 12, 16, 24)
    ]
    errors = [abs(end - ends[-1]) for end in ends[:-1]]
    assert errors[0] > 4 * errors[1] > 16 * errors[2] > 0.0
