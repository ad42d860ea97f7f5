"""The account of one hold at a force sensor against the energy of random and of built holds (AD1)."""

import numpy as np
import pytest
from numpy.typing import NDArray

from canhaptic.control.admittance.port import AdmittanceProperties, Port

_TIME, _SLEW, _ACCELERATION = 1e-3, 2000.0, 20.0
_STEPS = 200
Array = NDArray[np.float64]


def _settings(*, is_mean: bool, count: float = 0.0, error: float = 0.0, latency: int = 0) -> AdmittanceProperties:
    return AdmittanceProperties(
        sample_time=_TIME, sampling="mean" if is_mean else "point", latency=latency, force_slew=_SLEW,
        handle_acceleration=_ACCELERATION, force_error=error, encoder_count=count, speed_limit=1.0,
        acceleration_limit=1.0,
    )  # fmt: skip


def _slopes(random: np.random.Generator, holds: int) -> Array:
    """Returns slopes in [-1, 1], shape (holds, steps): constant, one change, many changes, noise."""
    times = np.linspace(0.0, 1.0, _STEPS, endpoint=False)
    kinds = [
        np.repeat(random.choice([-1.0, 1.0], (holds, 1)), _STEPS, axis=1),
        np.where(times < random.random((holds, 1)), 1.0, -1.0) * random.choice([-1.0, 1.0], (holds, 1)),
        random.uniform(-1.0, 1.0, (holds, _STEPS)),
        np.repeat(random.uniform(-1.0, 1.0, (holds, 10)), _STEPS // 10, axis=1),
    ]
    return np.choose(random.integers(0, 4, (holds, 1)), kinds)


def _integrated(slopes: Array, start: Array, scale: float) -> Array:
    """Returns values at the ends of the steps, shape (holds, steps + 1): exact for slopes constant in a step."""
    return start[:, None] + scale * _TIME / _STEPS * np.concatenate(
        [np.zeros((len(start), 1)), np.cumsum(slopes, axis=1)], axis=1
    )


def _energies(force: Array, speed: Array) -> tuple[Array, Array, Array]:
    """Returns (energy, way, mean force) of holds in which force and speed are piecewise linear."""
    step = _TIME / _STEPS
    f0, f1, v0, v1 = force[:, :-1], force[:, 1:], speed[:, :-1], speed[:, 1:]
    energy = step * ((f0 + f1) * (v0 + v1) / 4.0 + (f1 - f0) * (v1 - v0) / 12.0)
    return energy.sum(1), (step * (v0 + v1) / 2.0).sum(1), (step * (f0 + f1) / 2.0).sum(1) / _TIME


def _booked(settings: AdmittanceProperties, first: float, last: float, mean: float, way: float) -> tuple[float, float]:
    """Returns (energy booked at least, its doubt)."""
    port = Port(settings)
    port.begin(0.0, first)
    energy = port.book(way, mean if settings.is_mean else last).energy
    return energy, port.uncertainty


@pytest.mark.slow_but("True")
@pytest.mark.parametrize("is_mean", [False, True])
def test_no_random_hold_gives_less_than_is_booked(is_mean: bool) -> None:
    random, reached = np.random.default_rng(4), 0.0
    holds = 6_000
    force = _integrated(_slopes(random, holds), random.uniform(-20.0, 20.0, holds), _SLEW)
    speed = _integrated(
        _slopes(random, holds), random.choice([0.0, 0.01, 0.3], holds) * random.normal(size=holds), 20.0
    )
    settings = _settings(is_mean=is_mean)
    for true, way, mean, first, last in zip(*_energies(force, speed), force[:, 0], force[:, -1], strict=True):
        low, uncertainty = _booked(settings, first, last, mean, way)
        assert low <= true + 1e-15
        assert true <= low + 2.0 * uncertainty + 1e-15
        reached = max(reached, abs(true - low - uncertainty) / uncertainty)
    assert reached >= (0.99 if is_mean else 0.7)


def test_a_built_hold_reaches_the_bound_of_two_samples() -> None:
    times = np.linspace(0.0, 1.0, _STEPS, endpoint=False)[None, :]
    force = _integrated(np.where(times < 0.5, 1.0, -1.0), np.zeros(1), _SLEW)  # up and back: no change at the ends
    speed = _integrated(np.zeros((1, _STEPS)), np.full(1, 5.0), 0.0)
    (true,), (way,), _ = _energies(force, speed)
    low, uncertainty = _booked(_settings(is_mean=False), 0.0, 0.0, 0.0, way)
    assert abs(true - low - uncertainty) / uncertainty > 0.99


@pytest.mark.parametrize(("share", "is_certain"), [(1.0, True), (0.9, False)])
def test_a_force_that_bends_as_declared_leaves_its_line_by_no_more(share: float, is_certain: bool) -> None:
    """F = -b t (T - t) / 2 at a constant speed brings in -b v T^3 / 12, and both samples show zero."""
    bend, speed = 0.5 * _SLEW / _TIME, 0.3
    settings = _settings(is_mean=False).model_copy(update={"force_bend": share * bend, "handle_acceleration": 1e-9})
    low, uncertainty = _booked(settings, 0.0, 0.0, 0.0, speed * _TIME)
    true = -bend * speed * _TIME**3 / 12.0
    assert uncertainty == pytest.approx(-share * true)
    assert uncertainty < 0.2 * _booked(_settings(is_mean=False), 0.0, 0.0, 0.0, speed * _TIME)[1]
    assert (low <= true + 1e-15) == is_certain


def test_an_encoder_in_counts_costs_half_a_count_times_the_change_of_the_force() -> None:
    random, count = np.random.default_rng(8), 1e-5
    settings = _settings(is_mean=True, count=count)
    port = Port(settings)
    force = np.cumsum(random.normal(0.0, 0.05, 3000)) + 5.0
    way = np.cumsum(random.normal(0.0, 3e-5, 3000))
    true = booked = position = 0.0
    port.begin(0.0, 0.0)
    for value, place in zip(force.tolist(), way.tolist(), strict=True):
        true += value * (place - position)
        position = place
        booked += port.book(round(place / count) * count, value).energy
        assert booked <= true + 1e-12
    assert true - booked < 0.05  # 3000 holds at 5 N: a count of each would be 0.15 J


@pytest.mark.parametrize("latency", [0, 1, 2, 3])
def test_a_late_force_is_booked_with_the_way_of_its_own_time(latency: int) -> None:
    random = np.random.default_rng(latency)
    settings = _settings(is_mean=True, latency=latency)
    port, force = Port(settings), random.uniform(-5.0, 5.0, 400)
    way = np.cumsum(random.normal(0.0, 1e-4, 400))
    port.begin(0.0, 0.0)
    booked = 0.0
    for k in range(400):
        booked += port.book(way[k], force[k - latency] if k >= latency else 0.0).energy
    steps = np.diff(np.concatenate([[0.0], way]))
    assert booked + port.uncertainty == pytest.approx(float((force * steps)[: 400 - latency].sum()), abs=1e-9)


def test_lost_samples_are_booked_with_their_doubt() -> None:
    random = np.random.default_rng(3)
    holds = 4000
    slopes = np.repeat(random.uniform(-1.0, 1.0, holds // 20), 20)
    force = 5.0 + np.concatenate([[0.0], np.cumsum(slopes * _SLEW * _TIME)])
    speed = 0.2 * np.sin(np.arange(holds + 1) * 0.02)
    steps = _TIME * ((force[:-1] + force[1:]) * (speed[:-1] + speed[1:]) / 4.0 + np.diff(force) * np.diff(speed) / 12.0)
    way = np.cumsum(_TIME * (speed[:-1] + speed[1:]) / 2.0)
    settings, booked, true = _settings(is_mean=False), 0.0, 0.0
    port = Port(settings)
    port.begin(0.0, force[0])
    for k in range(holds):
        true += steps[k]
        if random.random() < 0.2:
            port.missed += 1
            continue
        booked += port.book(way[k], force[k + 1]).energy
        assert booked <= true + 1e-12
