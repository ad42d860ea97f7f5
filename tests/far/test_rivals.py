"""Other couplings on the plants of the attack: what they feel like without delay is known, and what delay costs."""

import pytest

from tools.attack.far_rivals import NAMES, figures

SERIES = 1000.0 * 5000.0 / 6000.0


@pytest.mark.slow
def test_without_delay_springs_in_series_are_felt_and_with_it_each_rival_drags_softens_or_gives_out() -> None:
    near = {name: figures(method, 0.0, 0.0) for method, name in enumerate(NAMES)}
    far = {name: figures(method, 0.1, 0.0) for method, name in enumerate(NAMES)}
    assert near["gains"][0] == pytest.approx(SERIES, rel=0.02)
    assert near["two-layer"][0] == pytest.approx(SERIES, rel=0.02)
    assert all(given < 1e-6 for _, _, given in near.values())
    assert far["gains"][0] is None  # its damping keeps the hand from the wall
    assert far["TDPA"][2] > 1e-3
    assert far["two-layer"][2] > 1e-3
    assert (far["waves"][0] or 0.0) < 0.5 * (near["waves"][0] or 0.0)
    assert min(drag for _, drag, _ in far.values()) > 0.5  # [N], more than `model` has at any delay
