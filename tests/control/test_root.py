"""The root of eq. 8 against 60-digit arithmetic (A8), and the nonlinear solve against the closed one."""

import math
from typing import Any

import mpmath
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from canhaptic.control.environments.detents import Detents
from canhaptic.control.passivity.internal_dissipation import (
    Balance,
    discriminant,
    solve_balance,
    solve_balance_nonlinear,
)
from tests.drawn import examples

mpmath.mp.dps = 60

stiffnesses = st.one_of(st.just(0.0), st.floats(1e-12, 1e8), st.sampled_from([1e-30, 1e-6, 1.0, 100.0, 1e6]))
efforts = st.one_of(st.floats(1e-9, 1e4), st.floats(-1e4, -1e-9))
displacements = st.one_of(st.floats(1e-15, 0.1), st.floats(-0.1, -1e-15), st.sampled_from([1e-15, -1e-15, 1e-9]))


class Stored:
    """An environment of which only the energy and the effort are asked."""

    def __init__(self, stored_energy, effort):
        self.stored_energy, self.effort = stored_energy, effort


def exact_root(stiffness, effort, energy):
    """Root nearest zero of k dx^2 / 2 + b dx = H in 60 digits; None without one."""
    k, b, h = mpmath.mpf(stiffness), mpmath.mpf(effort), mpmath.mpf(energy)
    if k == 0:
        return h / b
    under = b * b + 2 * k * h
    if under < 0:
        return None
    sign = 1 if b > 0 else -1
    return 2 * h / (b + sign * mpmath.sqrt(under))


def ulps(value, exact):
    return abs(mpmath.mpf(value) - exact) / mpmath.mpf(math.ulp(float(exact)))


@settings(max_examples=examples(400))
@given(stiffness=stiffnesses, effort=efforts, torque=st.floats(-1e3, 1e3), displacement=displacements)
def test_the_root_is_within_4_ulp_of_60_digits(stiffness, effort, torque, displacement):
    energy = -torque * displacement
    assume(abs(energy) > 1e-200)
    exact = exact_root(stiffness, effort, energy)
    found = solve_balance(stiffness, effort, energy, displacement)
    if exact is None:
        assert math.isnan(found)
    else:
        assert ulps(found, exact) <= 4


@settings(max_examples=examples(400))
@given(
    stiffness=st.floats(1e-3, 1e6),
    effort=efforts,
    steps=st.integers(-6, 6),
    scale=st.sampled_from([0, 1, 2**10, 2**26, 2**40]),
)
def test_near_the_double_root_no_digit_is_lost(stiffness, effort, steps, scale):
    energy = -effort * effort / (2.0 * stiffness)
    energy += steps * scale * math.ulp(energy)
    exact = exact_root(stiffness, effort, energy)
    found = solve_balance(stiffness, effort, energy, 1.0)
    assert math.isnan(found) == (exact is None)
    if exact is not None:
        assert ulps(found, exact) <= 4


def test_the_plain_discriminant_would_lose_half_the_digits_there():
    stiffness, effort = 777.7, 3.3
    energy = -effort * effort / (2.0 * stiffness) * (1.0 - 1e-15)
    exact = mpmath.mpf(effort) ** 2 + 2 * mpmath.mpf(stiffness) * mpmath.mpf(energy)
    plain = effort * effort + 2.0 * stiffness * energy
    assert abs(plain / exact - 1) > 1e-3
    assert abs(discriminant(effort, 2.0 * stiffness, energy) / exact - 1) < 1e-9


def test_ties_follow_the_motion_and_nothing_opposed_follows_it_whole():
    assert solve_balance(100.0, 0.0, 0.5, -1e-3) == pytest.approx(-0.1)
    assert solve_balance(100.0, 0.0, 0.5, 1e-3) == pytest.approx(0.1)
    assert solve_balance(0.0, 0.0, 0.0, 3e-4) == 3e-4
    assert solve_balance(100.0, 2.0, 0.0, 3e-4) == 0.0
    assert math.isnan(solve_balance(0.0, 0.0, 1e-6, 3e-4))
    assert math.isnan(solve_balance(100.0, 0.0, -1e-6, 3e-4))


@settings(max_examples=examples(200))
@given(
    stiffness=st.floats(1.0, 1e6),
    state=st.floats(-0.05, 0.05),
    damper=st.floats(-20.0, 20.0),
    torque=st.floats(-100.0, 100.0),
    displacement=st.floats(-0.01, 0.01),
)
def test_the_nonlinear_solve_finds_the_closed_root_of_a_linear_spring(stiffness, state, damper, torque, displacement):
    energy = -torque * displacement
    effort = stiffness * state + damper
    assume(abs(effort) > 1e-6)
    closed = solve_balance(stiffness, effort, energy, displacement)

    def gained(change):
        return 0.5 * stiffness * change * change + effort * change

    limit = 2.0 * abs(displacement)
    spring: Any = Stored(gained, lambda change: stiffness * change + effort)
    found = solve_balance_nonlinear(spring, Balance(0.0, 0.0, 0.0), energy, limit, 0.0)
    if math.isnan(closed):
        assert math.isnan(found)
    elif abs(closed) > limit:
        assert math.isnan(found) if energy < 0.0 else abs(found) == limit
    else:
        assert gained(found) == pytest.approx(energy, rel=1e-9, abs=1e-18)
        assert abs(found) <= abs(closed) * (1.0 + 1e-6) + 1e-12


def test_the_nonlinear_solve_needs_few_evaluations_and_never_more_than_its_bound():
    calls = []

    def gained(change):
        calls.append(change)
        return math.expm1(40.0 * change) - 0.1 * change

    steep: Any = Stored(gained, lambda change: 40.0 * math.exp(40.0 * change) - 0.1)
    root = solve_balance_nonlinear(steep, Balance(0.0, 0.0, 0.0), 1e9, 5.0, 0.0)
    assert gained(root) == pytest.approx(1e9, rel=1e-12)
    assert len(calls) <= 82


def test_the_root_beside_the_place_where_the_effort_reverses_is_found_to_the_rounding() -> None:
    """Detents absorb peak pitch / pi up to their crest; the root for a little less lies a few nanometres before it."""
    detents = Detents(peak=0.5, pitch=0.02, position=0.0)
    most = 0.5 * 0.02 / math.pi
    for lacking in (1e-4, 1e-8, 1e-11):
        begin = Balance(0.001, detents.stored_energy(0.001), 0.0)
        end = 0.001 + solve_balance_nonlinear(detents, begin, most * (1.0 - lacking) - begin.stored, 0.016, 1e-18)
        assert 0.001 < end < 0.01
        assert 0.01 - end == pytest.approx(0.02 / math.pi * math.sqrt(lacking), rel=1e-2)
