"""What a simulated force sensor shows, by numbers worked out by hand."""

import pytest

from canhaptic.sim.plant.velocity_drive import ForceReading, SimulatedForceSensor


def test_an_offset_of_a_sensor_that_integrates_is_integrated_too():
    reading = ForceReading(SimulatedForceSensor(sampling="impulse", gain=2.0, offset=0.5), 1)
    assert reading.take(0, 0.0, 0.0) == 0.0
    assert reading.take(100_000_000, 9.0, 0.2) == pytest.approx(2.0 * 0.2 + 0.5 * 0.1)
    assert reading.take(300_000_000, 9.0, 0.3) == pytest.approx(2.0 * 0.3 + 0.5 * 0.3)


def test_the_offset_of_a_point_is_added_to_the_force_and_of_a_mean_to_the_mean():
    for sampling, expected in (("point", 2.0 * 9.0 + 0.5), ("mean", 2.0 * 0.2 / 0.1 + 0.5)):
        reading = ForceReading(SimulatedForceSensor(sampling=sampling, gain=2.0, offset=0.5), 1)
        assert reading.take(100_000_000, 9.0, 0.2) == pytest.approx(expected)
