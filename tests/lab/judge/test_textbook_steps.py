"""The textbook's explicit step, against the polynomial that it is for a linear equation."""

from typing import Any

import numpy as np
import pytest

from canhaptic.lab.judge.solvers import runge_kutta_4

A = np.array([[0.0, 1.0], [-4.0, -0.5]])


class _Linear:
    """x' = A x + (0, torque) t, as a model without switches."""

    def rates(self, time, state, torque, modes):
        return (A @ np.array(state) + np.array([0.0, torque * time])).tolist()


@pytest.mark.parametrize("step", [0.1, 1.0])
def test_a_step_is_the_taylor_polynomial_of_order_4(step):
    state, power = np.array([0.3, -0.7]), np.array([0.3, -0.7])
    expected = state.copy()
    for order in range(1, 5):
        power = A @ power * step / order
        expected += power
    model: Any = _Linear()
    found = runge_kutta_4(model, 5.0, state.tolist(), 0.0, (), step)
    assert found == pytest.approx(expected.tolist(), rel=1e-13)


def test_a_force_that_grows_with_time_is_integrated_exactly():
    still: Any = _Linear()
    still.rates = lambda time, state, torque, modes: [state[1], torque * time**2]
    assert runge_kutta_4(still, 2.0, [0.0, 0.0], 6.0, (), 0.5) == pytest.approx(
        [0.5 * (2.5**4 - 2.0**4) - 2.0 * 2.0**3 * 0.5, 2.0 * (2.5**3 - 2.0**3)], rel=1e-12
    )
