"""The estimate of mass and friction against motions in closed form."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canhaptic.commission.laws import OpenLoop, doublet, sweep
from canhaptic.commission.mass_and_friction import _Array, estimate
from canhaptic.errors import ControlError

TIME = 1e-3


def moved(mass: float, damping: float, torques: _Array) -> _Array:
    """Positions of a mass with viscous damping under held torques, each hold in closed form."""
    position = velocity = 0.0
    positions = [position]
    for torque in torques:
        if damping == 0.0:
            position += velocity * TIME + 0.5 * torque / mass * TIME**2
            velocity += torque / mass * TIME
        else:
            final, rate = torque / damping, damping / mass
            decay = -np.expm1(-rate * TIME)
            position += final * TIME + (velocity - final) * decay / rate
            velocity += (final - velocity) * decay
        positions.append(position)
    return np.array(positions)


@settings(max_examples=40, deadline=None)
@given(
    mass=st.floats(0.01, 10.0),
    damping=st.one_of(st.just(0.0), st.floats(0.1, 5.0)),
    half_base=st.sampled_from([2, 10, 20, 40]),
)
def test_mass_and_damping_are_those_of_the_closed_form(mass: float, damping: float, half_base: int) -> None:
    torques = np.array(sweep(1.0, 2.0, 8.0, 2.0, TIME))
    found = estimate(moved(mass, damping * mass, torques), np.concatenate([[0.0], torques]), TIME, half_base)
    assert found is not None
    assert found.mass == pytest.approx(mass, rel=1e-6)
    assert found.damping == pytest.approx(damping * mass, abs=1e-3 * mass)
    assert abs(found.friction) < 1e-4
    assert found.residual < 1e-3


@pytest.mark.parametrize("count", [1e-6, 1e-5])
def test_an_encoder_of_finite_counts_widens_the_stated_error_and_stays_within_it(count: float) -> None:
    torques = np.array(sweep(0.5, 2.0, 8.0, 4.0, TIME))
    positions = np.round(moved(0.25, 0.1, torques) / count) * count
    found = estimate(positions, np.concatenate([[0.0], torques]), TIME, 20)
    assert found is not None
    assert abs(found.mass - 0.25) < 4.0 * found.mass_error + 1e-4
    assert found.mass_error < 0.01


def test_an_axis_that_did_not_move_gives_no_estimate() -> None:
    assert estimate(np.zeros(1000), np.ones(1000), TIME, 20) is None


def test_too_short_a_record_gives_no_estimate() -> None:
    assert estimate(np.arange(50.0), np.ones(50), TIME, 20) is None


def test_a_doublet_brings_a_free_mass_back() -> None:
    positions = moved(0.25, 0.0, np.array(doublet(1.0, 40)))
    assert positions[-1] == pytest.approx(0.0, abs=1e-15)
    assert np.ptp(positions) > 1e-3


def test_torque_goes_when_the_axis_goes_too_far_and_stays_away() -> None:
    law = OpenLoop([1.0] * 5, travel=0.1)
    assert [law.step(q, 0.0).torque for q in (0.0, 0.05, 0.11, 0.0)] == [1.0, 1.0, 0.0, 0.0]
    assert law.tripped


def test_torque_goes_when_the_axis_goes_too_fast() -> None:
    law = OpenLoop([1.0] * 5, largest_step=0.1)
    assert [law.step(q, 0.0).torque for q in (0.0, 0.2, 0.2)] == [1.0, 0.0, 0.0]


def test_a_lost_tpdo_ends_the_torque() -> None:
    law = OpenLoop([1.0] * 5)
    law.step(0.0, 0.0)
    assert law.hold().torque == 0.0
    assert law.step(0.0, 1.0).torque == 0.0


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_a_value_that_is_not_finite_raises(bad: float) -> None:
    with pytest.raises(ControlError, match="finite"):
        OpenLoop([1.0]).step(bad, 0.0)


def test_the_energy_put_in_is_booked_as_deficit() -> None:
    law = OpenLoop([1.0] * 3)
    law.step(0.0, 0.0)
    balance = law.step(0.01, 1.0)
    assert balance.h_i == pytest.approx(-0.01)
    assert balance.deficit == -balance.h_i
