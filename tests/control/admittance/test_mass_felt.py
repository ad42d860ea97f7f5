"""The mass felt at a display from its forces and positions, against motions whose mass is known in closed form."""

from collections.abc import Iterator
from math import cos, inf, pi, sin

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canhaptic.control.admittance.admittance_environment import AdmittanceMass
from canhaptic.control.motion_checks import MassAsked, MassFelt

T = 1e-3  # [s]


def asked(
    mass: float = 3.0, stiffness: float = 0.0, *, low: float = -inf, time: float = T, count: float = 1e-9
) -> MassAsked:
    return MassAsked(mass, stiffness, low, inf, time, count)


def swing(
    mass: float, damping: float, stiffness: float, *, time: float = T, holds: int = 1500
) -> Iterator[tuple[float, float]]:
    """Position and force of the hand of a mass on 5 cm to and fro and 1 cm at a higher frequency, in closed form."""
    for k in range(holds):
        position = speed = rise = 0.0
        for size, rate in ((0.05, 2.0 * pi), (0.01, 5.0 * pi)):
            position += size * sin(rate * k * time)
            speed += size * rate * cos(rate * k * time)
            rise -= size * rate * rate * sin(rate * k * time)
        yield position, mass * rise + damping * speed + stiffness * position + 0.3  # an offset of the sensor


@given(
    mass=st.floats(0.2, 20.0), damping=st.floats(0.0, 30.0), stiffness=st.floats(0.0, 300.0),
    time=st.sampled_from((5e-4, 1e-3, 2e-3, 1e-2)), count=st.sampled_from((0.0, 1e-6)),
)  # fmt: skip
def test_a_motion_in_closed_form_gives_its_mass_however_large_the_one_asked(
    mass: float, damping: float, stiffness: float, time: float, count: float
) -> None:
    fit = MassFelt(asked(2.0 * mass, stiffness, time=time, count=count))
    for k, (position, force) in enumerate(swing(mass, damping, stiffness, time=time, holds=round(2.5 / time))):
        fit.take(round(position / count) * count if count else position, -force, k)
    assert fit.mass == pytest.approx(mass, rel=0.02)


@given(mass=st.floats(0.5, 10.0), damping=st.floats(0.01, 10.0))
def test_a_display_that_follows_exactly_is_felt_as_the_mass_asked(mass: float, damping: float) -> None:
    environment, fit = AdmittanceMass(mass=mass, damping=damping), MassFelt(asked(mass))
    position = speed = 0.0
    for k in range(1500):
        force = 5.0 * cos(2.0 * pi * 1.3 * k * T)
        fit.take(position, -force, k)
        speed = environment.speed_after([], speed, force, position, T)
        position += T * speed
    assert fit.mass == pytest.approx(mass, rel=0.02)


@pytest.mark.parametrize("part", [0.5, 2.0])
def test_a_display_that_moves_by_less_or_more_than_asked_is_felt_heavier_or_lighter(part: float) -> None:
    fit = MassFelt(asked(3.0))
    for k, (position, force) in enumerate(swing(3.0, 0.0, 0.0)):
        fit.take(part * position, -force, k)
    assert fit.mass == pytest.approx(3.0 / part, rel=0.02)


def test_a_wall_is_not_felt_as_a_mass_and_a_gap_spoils_nothing() -> None:
    low, fit, without = -0.03, MassFelt(asked(low=-0.03)), MassFelt(asked())
    for k, (position, force) in enumerate(swing(3.0, 5.0, 0.0, holds=4000)):
        if not 1000 < k < 1500 and k % 301:  # a part of the run, and single samples, were lost
            push = force if position > low else -40.0
            fit.take(max(low, position), -push, k)
            without.take(max(low, position), -push, k)
    assert fit.mass == pytest.approx(3.0, rel=0.02)
    assert without.mass != pytest.approx(3.0, rel=0.1)


@pytest.mark.parametrize(
    ("size", "count", "holds"),
    [(0.0, 0.0, 1500), (1.0, 1e-2, 1500), (1e-4, 1e-6, 1500), (1.0, 1e-6, 600)],
    ids=["at rest", "a coarse encoder", "too small a motion", "too short a run"],
)
def test_a_motion_that_does_not_excite_the_mass_leaves_it_unknown(size: float, count: float, holds: int) -> None:
    fit = MassFelt(asked(count=count))
    for k, (position, force) in enumerate(swing(3.0, 5.0, 0.0, holds=holds)):
        place = size * position
        fit.take(round(place / count) * count if count else place, -force, k)
    assert fit.mass is None


def test_forces_that_no_mass_explains_leave_it_unknown() -> None:
    fit = MassFelt(asked())
    for k, (position, _) in enumerate(swing(3.0, 5.0, 0.0)):
        fit.take(position, 50.0 * sin(2.0 * pi * 7.7 * k * T), k)
    assert fit.mass is None


def test_a_constant_speed_shows_the_damper_alone() -> None:
    fit = MassFelt(asked(count=1e-6))
    for k in range(1500):
        fit.take(round(0.1 * k * T / 1e-6) * 1e-6, -0.5, k)
    assert fit.mass is None
