import mpmath
import numpy as np
import pytest
from scipy.linalg import expm

from canhaptic.sim.plant import LEVELS
from canhaptic.sim.plant.propagator import dyadic_flows


def servo_and_hand(stiffness: float, damping: float, mass: float, frequency: float) -> np.ndarray:
    """F of [q, v, sine, cosine, torque, one]."""
    omega = 2 * np.pi * frequency
    rates = np.zeros((6, 6))
    rates[0, 1] = 1
    rates[1] = np.array([-stiffness, -damping - 0.1, 0.03 * stiffness, 0.03 * damping * omega, 1, 0.2]) / mass
    rates[2, 3], rates[3, 2] = omega, -omega
    return rates


def exact_flow(rates: np.ndarray, step: float) -> np.ndarray:
    with mpmath.workdps(60):
        exact = mpmath.expm(mpmath.matrix(rates.tolist()) * mpmath.mpf(step), method="taylor")
        return np.array(exact.tolist(), dtype=float).reshape(rates.shape)


SCENES = [
    servo_and_hand(300, 3, 0.25, 1),
    servo_and_hand(60, 5, 0.25, 0.5),
    servo_and_hand(1e6, 20, 0.25, 8),
    servo_and_hand(1e6, 3, 1e-3, 8),
]


@pytest.mark.slow
@pytest.mark.parametrize("rates", SCENES)
@pytest.mark.parametrize("sample_time", [1e-4, 1e-3, 25e-3])
def test_every_dyadic_flow_agrees_with_sixty_digits(rates, sample_time):
    flows, _ = dyadic_flows(rates, [], sample_time)
    assert len(flows) == LEVELS + 1
    for level in (0, 1, 7, 20, LEVELS):
        expected = exact_flow(rates, sample_time * 0.5**level)
        # In units where both rates of the oscillator are equal; a phase x is not known better than eps * x.
        pace = np.sqrt(abs(rates[1, 0]))
        units = np.array([1.0, pace, 1.0, 1.0, abs(rates[1, 0]) / rates[1, 4], 1.0])
        error = np.abs(flows[level] - expected) * units / units[:, None]
        assert error.max() <= 1e-15 * max(1.0, pace * sample_time * 0.5**level)


def test_the_smallest_step_keeps_its_digits_beside_the_identity():
    flows, _ = dyadic_flows(SCENES[0], [], 1e-3)
    step = 1e-3 * 0.5**LEVELS
    assert flows[LEVELS][0, 1] == pytest.approx(step, rel=1e-8)
    assert flows[LEVELS][0, 4] == pytest.approx(step**2 / 0.5, rel=1e-8)


@pytest.mark.parametrize("rates", SCENES)
def test_the_work_form_equals_van_loans_block_exponential(rates):
    size, sample_time = len(rates), 1e-4
    velocity = np.eye(size)[1]
    power = 0.3 * np.outer(velocity, velocity)
    _, works = dyadic_flows(rates, [power], sample_time)
    block = np.block([[-rates.T, power], [np.zeros((size, size)), rates]])
    whole = expm(block * sample_time)
    expected = whole[size:, size:].T @ whole[:size, size:]
    assert np.allclose(works[0][0], expected, rtol=1e-9, atol=1e-12 * np.abs(expected).max())


@pytest.mark.slow
def test_the_work_form_agrees_with_sixty_digit_quadrature_of_the_power():
    rates, sample_time = SCENES[2], 1e-3
    velocity = np.eye(6)[1]
    _, works = dyadic_flows(rates, [np.outer(velocity, velocity)], sample_time)
    start = np.array([1e-3, 0.2, 0.3, 0.9, -2.0, 1.0])
    with mpmath.workdps(30):
        matrix, state = mpmath.matrix(rates.tolist()), mpmath.matrix(start.tolist())
        power = lambda t: (mpmath.expm(matrix * t, method="taylor") * state)[1] ** 2  # noqa: E731
        expected = float(mpmath.quad(power, mpmath.linspace(0, sample_time, 3), maxdegree=4))
    assert start @ works[0][0] @ start == pytest.approx(expected, rel=1e-13)
