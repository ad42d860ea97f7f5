"""The caps of a sampled damper against the roots of its characteristic polynomial, and eq. 19 within them."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from canhaptic.control.damping import damping_cap, largest_stable_damping, least_oscillating_damping, modulated_damping
from canhaptic.control.passivity.internal_dissipation import StoredModelParameters
from canhaptic.errors import ParameterError

MASS, SAMPLE_TIME = 0.3, 2e-3


def roots(damping, delay):
    """For a free mass under a held torque -d (q(k) - q(k-1)) / T, `delay` samples late."""
    g = damping * SAMPLE_TIME / (2.0 * MASS)
    polynomial = np.zeros(delay + 3)
    polynomial[0], polynomial[1] = 1.0, -1.0
    polynomial[-2] += g
    polynomial[-1] += g
    return np.roots(polynomial)


@pytest.mark.parametrize("delay", range(5))
def test_beyond_the_stability_limit_a_root_leaves_the_unit_circle(delay):
    limit = largest_stable_damping(delay, MASS, SAMPLE_TIME)
    assert max(abs(roots(0.99 * limit, delay))) < 1.0
    assert max(abs(roots(1.01 * limit, delay))) > 1.0


@pytest.mark.parametrize("delay", range(5))
def test_beyond_the_cap_the_slow_roots_leave_the_real_axis(delay):
    cap = least_oscillating_damping(delay, MASS, SAMPLE_TIME)
    below, above = roots(0.99 * cap, delay), roots(1.01 * cap, delay)
    slowest = max(below, key=abs)
    assert abs(slowest.imag) < 1e-9
    assert abs(max(above, key=lambda root: root.real).imag) > 1e-3


@pytest.mark.parametrize(("delay", "diverges", "ripples"), [(0, 2.0, 0.343), (1, 0.828, 0.180), (2, 0.536, 0.122)])
def test_the_measured_figures_are_met(delay, diverges, ripples):
    scale = SAMPLE_TIME / MASS
    assert largest_stable_damping(delay, MASS, SAMPLE_TIME) * scale == pytest.approx(diverges, abs=5e-4)
    assert least_oscillating_damping(delay, MASS, SAMPLE_TIME) * scale == pytest.approx(ripples, abs=5e-4)


def test_without_a_known_mass_nothing_is_capped():
    assert damping_cap(1, None, SAMPLE_TIME) == math.inf


@given(
    alpha=st.floats(1.0, 1e5),
    surplus=st.floats(-1e-2, 1e-2),
    model=st.floats(0.0, 100.0),
    cap=st.floats(0.0, 100.0),
    displacement=st.floats(-0.1, 0.1),
)
def test_the_modulated_damper_is_never_negative_above_the_cap_or_more_than_the_surplus(
    alpha, surplus, model, cap, displacement
):
    damping = modulated_damping(alpha, surplus, model, cap, displacement, SAMPLE_TIME)
    assert damping >= 0.0
    assert damping <= max(0.0, cap - model)
    if surplus <= 0.0:
        assert damping == 0.0
    assert damping * displacement**2 / SAMPLE_TIME <= max(0.0, surplus) * (1.0 + 1e-9) + 1e-300


@pytest.mark.parametrize("bare", [200.0, 200, "200"])
def test_alpha_without_its_unit_is_refused(bare):
    with pytest.raises(ParameterError, match=r"alpha.*200 s/m\^2"):
        StoredModelParameters(alpha=bare)


@pytest.mark.parametrize(("text", "value"), [("200 s/m^2", 200.0), ("5 s/rad^2", 5.0), (0, 0.0), ("0", 0.0)])
def test_alpha_with_its_unit_or_zero_is_taken(text, value):
    assert StoredModelParameters(alpha=text).alpha == value


@pytest.mark.parametrize("wrong", ["200 N/m", "-1 s/m^2", "nan s/m^2"])
def test_alpha_of_another_dimension_or_sign_is_refused(wrong):
    with pytest.raises(ParameterError, match="alpha"):
        StoredModelParameters(alpha=wrong)
