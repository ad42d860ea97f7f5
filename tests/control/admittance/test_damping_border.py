"""The least damping against a spring to ground, against the eigenvalues of the sampled loop."""

import pytest

from canhaptic.control.admittance.declared_hand import damping_border
from tools.bench.admittance import _GAIN, _MASS, _is_stable


@pytest.mark.parametrize(
    ("stiffness", "rate", "delay", "mass"),
    [(1e3, 1000, 1, 0.5), (5e3, 1000, 1, 0.5), (5e3, 250, 1, 0.5), (5e3, 250, 0, 0.5), (2e4, 1000, 1, 0.5)],
)
def test_the_border_is_that_of_the_sampled_loop(stiffness: float, rate: int, delay: int, mass: float) -> None:
    lag = (delay + 0.5) / rate
    border, hand = damping_border(_MASS, _GAIN, mass, stiffness, lag), (stiffness, 1e-6, 1e6, 0.0)
    assert _is_stable(rate, delay, mass, 1.02 * border, hand)
    assert not _is_stable(rate, delay, mass, 0.98 * border, hand)
    assert border <= stiffness * (lag + (_MASS - mass) / _GAIN)


def test_a_heavy_mass_needs_no_damping() -> None:
    assert damping_border(_MASS, _GAIN, 6.5, 1e3, 6e-3) == 0.0
