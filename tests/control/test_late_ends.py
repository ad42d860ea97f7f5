"""Both ends of late torques (docs/theory/late_torques.md): plants that know no certificate, and what scenes may say."""

import math
from pathlib import Path

import numpy as np
import pytest

from canhaptic.control.certificates.scalar_bounds import displacement_response, end_of_late, hold_timing
from canhaptic.control.passivity import LoopProperties
from canhaptic.errors import ParameterError, SceneError
from canhaptic.scene.load import load_scene
from tools.attack.timing import distance, ends

DEMO = Path(__file__).resolve().parents[2] / "configs" / "demo.yaml"
LOOP = {"type": "current_loop", "time_constant": "300 us"}


def test_no_plant_goes_beyond_the_ends_and_some_would_with_a_smaller_bend() -> None:
    random = np.random.default_rng(3)
    assert min(distance(random, 1.0) for _ in range(150)) > -1e-3
    assert min(distance(random, 0.6) for _ in range(150)) < -1e-2


def test_the_ends_in_closed_form_are_those_of_many_times() -> None:
    random = np.random.default_rng(1)
    for _ in range(100):
        time, mass, most, force = 1e-3, random.uniform(0.05, 1.0), random.choice([0.0, 40.0]), random.uniform(0.1, 20.0)
        low, high = sorted(random.uniform(0.0, 0.9 * time, 2))
        timing = hold_timing(time, 0.0, high, 0.0, (low, 0.0))
        response, moved = displacement_response(time, mass, 5.0, 0.0, most, timing=timing), random.normal() * 1e-5
        y = most * time / mass
        swing = y / -math.expm1(-y) if y else 1.0
        least, _ = ends(moved, time, low, high, (force / mass, force / mass), swing)
        assert end_of_late(moved, time, high, force, response) == pytest.approx(least, rel=1e-3, abs=1e-12)


def test_a_known_lateness_leaves_what_a_hand_can_do_within_the_hold() -> None:
    timing = hold_timing(1.0, 0.0, 0.2, 0.0, (0.2, 0.0))
    response = displacement_response(1.0, 1.0, 4.0, timing=timing)
    assert end_of_late(0.0, 1.0, 0.2, 4.0, response) == pytest.approx(-0.5 * 4.0 * 0.2 * 0.8)
    assert end_of_late(1.0, 1.0, 0.2, 0.0, response) == pytest.approx(0.2)


def test_a_range_is_two_numbers_in_order_and_one_number_is_its_largest() -> None:
    loop = LoopProperties(sample_time=1e-3, torque_window=["100 us", 2e-4], current_lag=1e-4)
    assert loop.timing.late == pytest.approx(3e-4)
    assert loop.timing.early == pytest.approx(1e-4)
    assert LoopProperties(sample_time=1e-3, torque_window=2e-4).timing.early == 0.0
    for wrong, expected in (([3e-4, 1e-4], "exchange them"), ([1e-4] * 3, "got 3 numbers"), (["x", 1e-4], "got 'x'")):
        with pytest.raises(ParameterError, match=expected):
            LoopProperties(sample_time=1e-3, current_lag=wrong)


def test_a_simulated_lag_or_delay_gives_both_ends_and_contradicts_a_zero() -> None:
    lagging = f"simulation.effects=[{{type: current_loop, time_constant: {LOOP['time_constant']}}}]"
    late = ("bus.rpdo=event", "simulation.bus.delay=100 us")
    assert load_scene(DEMO, [lagging]).axes[0].loop.current_lag_least == pytest.approx(3e-4)
    assert load_scene(DEMO, late).axes[0].loop.torque_window_least == pytest.approx(2e-4)
    assert load_scene(DEMO, [lagging, "passivity.current_lag=[250 us, 1 ms]"]).axes[0].loop.timing.early < 2.5e-4
    for given, key in (((lagging,), "current_lag"), (late, "torque_window")):
        with pytest.raises(SceneError, match=rf"passivity.{key}: got 0 s, but the simulated drive and bus make it"):
            load_scene(DEMO, [*given, f"passivity.{key}=0 s"])
