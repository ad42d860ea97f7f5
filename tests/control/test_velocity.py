"""Adaptive windowing: every window fits, the cost is constant, and the damper of a coarse encoder grows quiet."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from canhaptic.control.damping import VelocityWindow, restart, update
from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.control.passivity import LoopProperties, build_controller
from canhaptic.control.passivity.internal_dissipation import StoredModelParameters
from canhaptic.errors import ParameterError
from tests.control.reference_loop import USER_S, continuous, sampled, variation

SAMPLE_TIME = 1e-3
counts = st.lists(st.integers(-3, 3), min_size=1, max_size=120)


class Ring(list):
    """Samples that count how often they are read."""

    reads = 0

    def __getitem__(self, place):
        self.reads += 1
        return super().__getitem__(place)


class AdaptiveWindow:
    """The velocity of one axis by the kernels; keeps their window and its samples."""

    def __init__(self, sample_time, tolerance, longest):
        self._sample_time, self._tolerance = sample_time, tolerance
        self.window, self.ring = VelocityWindow(), Ring([0.0] * (longest + 1))

    def restart(self, position):
        restart(self.window, self.ring, position)

    def update(self, position):
        update(self.window, self.ring, self._tolerance, self._sample_time, position)
        return self.window.velocity


def run(positions, tolerance=1.0, longest=16):
    window = AdaptiveWindow(SAMPLE_TIME, tolerance, longest)
    window.restart(positions[0])
    return window, [window.update(position) for position in positions[1:]]


@given(steps=counts)
def test_the_line_of_every_window_passes_all_its_samples_within_one_count(steps):
    positions = [float(x) for x in np.cumsum([0, *steps])]
    window = AdaptiveWindow(SAMPLE_TIME, 1.0, 16)
    window.restart(positions[0])
    for newest in range(1, len(positions)):
        slope = window.update(positions[newest]) * SAMPLE_TIME
        length = window.window.length
        assert 1 <= length <= 16
        for back in range(length + 1):
            line = positions[newest] - slope * back
            index = newest - back
            assert abs(line - (positions[index] if index >= 0 else positions[0])) <= 1.0 + 1e-9


@given(steps=counts)
def test_a_step_costs_a_bounded_number_of_samples_on_average(steps):
    positions = [float(x) for x in np.cumsum([0, *steps])]
    window, velocities = run(positions, longest=64)
    assert window.ring.reads <= 6 * len(velocities)


def test_the_average_cost_stays_bounded_over_a_long_noisy_run_and_a_slow_one():
    generator = np.random.default_rng(5)
    noisy = np.cumsum(generator.integers(-2, 3, 20_000)).astype(float)
    slow = np.round(50.0 * np.sin(2.0 * np.pi * np.arange(6000) / 3000.0))
    for positions, tolerance in ((noisy, 8.0), (slow, 1.0)):
        window, velocities = run(positions.tolist(), tolerance=tolerance, longest=200)
        assert window.ring.reads <= 3 * len(velocities)


def test_a_ramp_seen_through_counts_gives_its_speed():
    speed, count = 0.0137, 1e-5
    positions = [round(speed * k * SAMPLE_TIME / count) * count for k in range(400)]
    window = AdaptiveWindow(SAMPLE_TIME, count, 32)
    window.restart(0.0)
    velocities = [window.update(position) for position in positions[1:]]
    last = [(b - a) / SAMPLE_TIME for a, b in itertools.pairwise(positions)]
    assert max(abs(v - speed) for v in velocities[64:]) < 0.1 * speed
    assert max(abs(v - speed) for v in last[64:]) > 0.25 * speed


def test_at_rest_the_window_stays_within_its_longest():
    window = AdaptiveWindow(SAMPLE_TIME, 1.0, 16)
    lengths = []
    for _ in range(100):
        window.update(0.0)
        lengths.append(window.window.length)
    assert max(lengths) == 16
    assert min(lengths[16:]) >= 8


def test_a_sudden_motion_is_followed_at_once():
    positions = [0.0] * 50 + [0.02 * k for k in range(1, 4)]
    _, velocities = run(positions, tolerance=1e-4, longest=32)
    assert velocities[-3:] == pytest.approx([20.0] * 3)


def test_windowed_needs_the_encoder_count():
    with pytest.raises(ParameterError, match="encoder_count"):
        build_controller(
            SpringDamperWall(stiffness=100.0),
            "internal_dissipation",
            StoredModelParameters(velocity="windowed"),
            LoopProperties(sample_time=1e-3),
        )


@pytest.mark.slow
@pytest.mark.parametrize("delay", [pytest.param(0, marks=pytest.mark.slow), 1])
def test_at_10_khz_with_coarse_counts_the_window_quiets_the_force_twentyfold(delay):
    fine = np.arange(0.0, 1.0, 1e-4)
    position, torque = continuous(USER_S, 1000.0, 50.0, 0.0, fine)
    figures = {}
    for velocity in ("last", "windowed"):
        made = build_controller(
            SpringDamperWall(stiffness=1000.0, damping=50.0),
            "internal_dissipation",
            StoredModelParameters(velocity=velocity),
            LoopProperties(sample_time=1e-4, delay=delay, encoder_count=1e-4),
        )
        result = sampled(USER_S, made, 1e-4, 0.9999, delay, count=1e-4)
        error = math.sqrt(np.mean((result.position - np.interp(result.time, fine, position)) ** 2))
        figures[velocity] = variation(result.torque) / variation(torque), error
    assert figures["windowed"][0] < 0.05 * figures["last"][0]
    assert figures["windowed"][1] < min(0.5 * figures["last"][1], 0.3e-3)
