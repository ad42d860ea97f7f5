"""The estimate of mass and friction against motions in closed form."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canhaptic.commission.mass_and_friction import (
    Sweep,
    _Array,
    estimate,
    estimate_lateness,
    friction_curve,
    mass_of_late_torque,
)
from canhaptic.commission.session import Guard, OpenLoop, doublet, reversals, sweep
from canhaptic.errors import ControlError
from canhaptic.sim.plant.effects import Effect
from canhaptic.sim.plant.effects.coulomb_friction import CoulombFriction
from canhaptic.sim.plant.effects.stribeck_friction import StribeckFriction
from canhaptic.sim.plant.plant import Plant, PlantParameters
from tests.drawn import examples

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


@settings(max_examples=examples(40), deadline=None)
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


@pytest.mark.parametrize("count", [3e-4, 1e-3, 3e-3])
def test_counts_coarser_than_a_window_widen_the_error_and_make_no_mass_smaller(count: float) -> None:
    """2 N shake 0.25 kg by 3 mm in 40 ms: of one to ten counts, as many as the errors of the acceleration."""
    torques = np.array(sweep(2.0, 2.0, 8.0, 8.0, TIME))
    positions = np.round(moved(0.25, 0.1, torques) / count) * count
    found = estimate(positions, np.concatenate([[0.0], torques]), TIME, 20)
    assert found is not None
    assert found.mass == pytest.approx(0.25, rel=0.02)
    assert abs(found.damping - 0.1) < 4.0 * found.damping_error


@pytest.mark.slow_but("0.0--1", "1e-05-1", "0.0-3")
@pytest.mark.parametrize("late", [-1, 0, 1, 3])
@pytest.mark.parametrize("count", [0.0, 1e-5])
def test_a_mass_is_known_whenever_its_torque_acts(late: int, count: float) -> None:
    """A tenth of the speed is lost in each hold: each hold of lateness makes the mass of `estimate` a tenth larger."""
    torques = np.array([0.0, *reversals(1.0, 30, 32), *[0.0] * 5])
    positions = moved(0.05, 5.0, torques)
    positions = np.round(positions / count) * count if count else positions
    booked = np.concatenate([[0.0], np.roll(torques, -late)])
    found, blind = mass_of_late_torque(positions, booked, TIME, 30), estimate(positions, booked, TIME, 30)
    assert found is not None
    assert blind is not None
    assert found[0] == pytest.approx(0.05, rel=0.005)
    assert blind.mass == pytest.approx(0.05 * (1.0 + 0.1 * late), rel=0.05)


@pytest.mark.parametrize("holds", [0, 2])
def test_a_torque_of_a_damped_axis_does_not_seem_early(holds: int) -> None:
    """An eighth of the speed is lost in each hold; the torque acts so many holds after where it is booked."""
    torques = np.array([0.0, *reversals(1.0, 16, 128), *[0.0] * 5])
    positions = np.round(moved(0.25, 0.128 * 0.25 / TIME, torques) / 1e-7) * 1e-7
    late = estimate_lateness(positions, np.concatenate([[0.0], np.roll(torques, -holds)]), TIME, 5)
    assert late is not None
    assert abs(late[0] - holds * TIME) <= max(2.0 * late[1], 2e-3 * TIME)


@pytest.mark.parametrize(("half", "damping"), [(126, 0.02), (150, 0.0)])
def test_slow_motion_on_coarse_counts_tells_no_delays_apart_and_needs_not_to(half: int, damping: float) -> None:
    torques = np.array([0.0, *reversals(1.0, half, 8), *[0.0] * 5])
    positions = np.round(moved(0.5, damping, torques) / 1e-3) * 1e-3
    found = mass_of_late_torque(positions, np.concatenate([[0.0], torques]), TIME, half)
    assert found is not None
    assert abs(found[0] - 0.5) <= 2.0 * found[1] <= 0.02


def test_a_lateness_that_no_drive_has_gives_no_mass() -> None:
    torques = np.array([0.0, *reversals(1.0, 30, 32)])
    booked = np.concatenate([[0.0], np.roll(torques, -12)])
    assert mass_of_late_torque(moved(0.05, 5.0, torques), booked, TIME, 30) is None


def test_an_axis_that_did_not_move_gives_no_estimate() -> None:
    assert estimate(np.zeros(1000), np.ones(1000), TIME, 20) is None
    assert mass_of_late_torque(np.zeros(1000), np.ones(1000), TIME, 20) is None


def test_too_short_a_record_gives_no_estimate() -> None:
    assert estimate(np.arange(50.0), np.ones(50), TIME, 20) is None


def test_a_doublet_brings_a_free_mass_back() -> None:
    positions = moved(0.25, 0.0, np.array(doublet(1.0, 40)))
    assert positions[-1] == pytest.approx(0.0, abs=1e-15)
    assert np.ptp(positions) > 1e-3


def test_torque_goes_when_the_axis_goes_too_far_and_stays_away() -> None:
    law = OpenLoop([1.0] * 5, Guard(travel=0.1))
    assert [law.step(q, 0.0).torque for q in (0.0, 0.05, 0.11, 0.0)] == [1.0, 1.0, 0.0, 0.0]
    assert law.tripped


def test_torque_goes_when_the_axis_goes_too_fast() -> None:
    law = OpenLoop([1.0] * 5, Guard(step=0.1))
    assert [law.step(q, 0.0).torque for q in (0.0, 0.2, 0.2)] == [1.0, 0.0, 0.0]


def test_a_lost_tpdo_ends_the_torque() -> None:
    law = OpenLoop([1.0] * 5)
    law.step(0.0, 0.0)
    assert law.sample_lost().torque == 0.0
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


def swept(amplitude: float, damping: float, friction: Effect | None, count: float = 0.0) -> tuple[_Array, _Array]:
    """Positions and torques of 0.25 kg under a sweep, by the simulated plant."""
    plant = Plant(PlantParameters(mass=0.25, damping=damping), None, [friction] if friction else [], 1_000_000)
    torques = np.array(sweep(amplitude, 2.0, 8.0, 4.0, TIME))
    positions = np.concatenate([[0.0], plant.run(torques)])
    return np.round(positions / count) * count if count else positions, np.concatenate([[0.0], torques])


COULOMB = CoulombFriction(kinetic=0.5, static=0.8)
FALLING = {speed: StribeckFriction(kinetic=0.5, static=1.0, stribeck_velocity=speed) for speed in (0.005, 0.02, 0.1)}


@pytest.mark.slow_but("friction0-1.2-0.0-0.0")
@pytest.mark.parametrize("count", [0.0, 1e-5])
@pytest.mark.parametrize("damping", [0.0, 0.5])
@pytest.mark.parametrize("amplitude", [1.2, 2.0, 4.0])
@pytest.mark.parametrize("friction", [COULOMB, FALLING[0.005], FALLING[0.02]])
def test_mass_and_least_friction_are_those_of_the_plant_whatever_its_law(friction: Effect, amplitude, damping, count):
    """0.5 N brakes at every speed, viscous friction comes on top; nothing of it is beyond the plant's."""
    record = (*swept(amplitude, damping, friction, count), TIME, 20)
    found, curve = estimate(*record), friction_curve(*record)
    assert found is not None
    assert curve is not None
    assert curve.mass == pytest.approx(0.25, abs=3.0 * curve.mass_error + 1e-3)
    assert 0.9 * (curve.mass - 2.0 * curve.mass_error) < 0.25
    assert not curve.falls_at_its_end(2.0)
    sure = max(0.0, found.damping - 2.0 * found.damping_error)
    least = curve.least(sure, 2.0)
    assert least > 0.46
    speeds = np.linspace(curve.speeds[0], curve.speeds[-1], 200)
    braking = np.full_like(speeds, 0.5) + damping * speeds
    if isinstance(friction, StribeckFriction):
        braking += 0.5 * np.exp(-((speeds / friction.stribeck_velocity) ** 2))
    assert (least + sure * speeds <= 1.01 * braking).all()


@pytest.mark.parametrize("late", [-1.0, 0.3, 2.0])
@pytest.mark.parametrize("friction", [None, COULOMB])
def test_a_swept_mass_and_its_friction_do_not_depend_on_when_the_torque_acts(late: float, friction: Effect | None):
    positions, torques = swept(4.0, 5.0, friction, 1e-5)
    holds = np.arange(len(torques)) + late
    booked = np.interp(holds, np.arange(len(torques)), torques, left=0.0, right=0.0)
    right = Sweep(positions, torques, torques, TIME, 20).dynamics()
    found = Sweep(positions, booked, booked, TIME, 20).dynamics((late * TIME, 1e-6))
    assert right is not None
    assert found is not None
    assert found[0].mass == pytest.approx(right[0].mass, rel=5e-3)
    assert found[0].damping == pytest.approx(5.0, rel=0.01)
    for curve in (right[1], found[1]):
        assert curve is not None
        assert curve.least(4.9, 2.0) <= (0.0 if friction is None else 0.5)


@pytest.mark.slow
def test_one_friction_for_all_speeds_would_make_the_mass_too_large() -> None:
    record = (*swept(1.2, 0.0, FALLING[0.02]), TIME, 20)
    found, curve = estimate(*record), friction_curve(*record)
    assert found is not None
    assert curve is not None
    assert 0.9 * (found.mass - 2.0 * found.mass_error) > 0.25
    assert curve.mass == pytest.approx(0.25, rel=0.02)


@pytest.mark.slow
def test_friction_that_still_falls_at_the_fastest_speed_is_said_to() -> None:
    curve = friction_curve(*swept(1.2, 0.0, FALLING[0.1]), TIME, 20)
    assert curve is not None
    assert curve.falls_at_its_end(2.0)
    assert curve.least(0.0, 2.0) > 0.6


def test_without_friction_there_is_none_for_certain() -> None:
    curve = friction_curve(*swept(1.2, 0.5, None, 1e-5), TIME, 20)
    assert curve is not None
    assert curve.least(0.45, 2.0) < 0.02
