"""The pieces of a step written out for a compiler give what those of numpy give."""

import numpy as np
import pytest

from canhaptic.lab.batch import mode_arrays
from canhaptic.sim.plant import stepper


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e3])
def test_largest_term_and_stored_energy_are_those_of_numpy(scale):
    chance = np.random.default_rng(7)
    guards, storage = chance.normal(size=(3, 5)), chance.normal(size=(5, 5))
    state = scale * chance.normal(size=5)
    for guard in range(3):
        expected = stepper.largest_term(guards, guard, state)
        assert mode_arrays.largest_term(guards.tolist(), guard, state.tolist()) == pytest.approx(expected, rel=1e-14)
    expected = stepper.stored(storage, state)
    assert mode_arrays.stored(storage.tolist(), state.tolist()) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(
    ("parabola", "expected"),
    [((1.0, -1.0, 2.0, 10.0), 0.75), ((0.0, 1.0, -3.0, 2.0), -4.0), ((3.0, 1.0, 1.0, 5.0), 3.0)],
)
def test_the_least_value_of_a_parabola(parabola, expected):
    assert stepper.least(*parabola) == expected
