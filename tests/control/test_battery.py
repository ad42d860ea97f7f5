"""What every algorithm keeps on every environment. A new one needs a line in its table and nothing here."""

import math
from collections import deque

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canhaptic.control.balance import AT_REST, Branch, residual
from canhaptic.control.passivity import LITERATURE
from canhaptic.errors import ControlError
from tests.control.cases import EVERY, SUMS, algorithms, controller

pytestmark = pytest.mark.parametrize("environment", sorted(EVERY))
UNPROTECTED_START = {"unprotected", "passivity_observer", *LITERATURE}  # the penetration, as the ledger says
UNDERFLOW = 1e-40  # J: below it squares and differences are no longer normal numbers
LAST_BIT = 1e-30  # J: a sum reads positions, whose last bit is 1e-18 m
every_algorithm = pytest.mark.parametrize("algorithm", algorithms())

tiny_or_large = st.one_of(
    st.floats(-0.02, 0.02), st.sampled_from([0.0, 0.004, -0.004, 1e-9, -1e-9, 0.02, -0.02]), st.floats(-1e-6, 1e-6)
)
share = st.one_of(st.just(1.0), st.just(1.0), st.floats(0.0, 1.0), st.floats(-3.0, 3.0))
offset = st.one_of(st.just(0.0), st.just(0.0), st.floats(-5.0, 5.0))
moves = st.lists(st.tuples(tiny_or_large, st.booleans(), share, offset), min_size=1, max_size=40)


def largest(balance, before):
    terms = (before, balance.h_s, balance.h_i, balance.h_pas, balance.h_r, balance.gen, balance.deficit, balance.leak)
    return max(abs(term) for term in terms)


def drive(made, delay, script):
    """Yields (balance, balance before) under positions and applied torques that follow no law."""
    pending = deque([0.0] * (delay + 1))
    position, before = 0.0, AT_REST
    for target, relative, scale, extra in script:
        position = position + 0.1 * target if relative else target
        balance = made.step(position, pending.popleft() * scale + extra)
        pending.append(max(-1e3, min(1e3, balance.torque)))
        yield balance, before
        before = balance


@pytest.mark.slow_but("1-*-spring_damper_wall", "0-guarded-*", "1-internal_dissipation-detents")
@every_algorithm
@pytest.mark.parametrize("delay", [0, 1, pytest.param(3, marks=pytest.mark.slow)])
@settings(max_examples=5)
@given(script=moves)
def test_every_joule_of_every_hold_has_a_name(environment, algorithm, delay, script):
    made = controller(algorithm, EVERY[environment][0], delay)
    for balance, before in drive(made, delay, script):
        rounding = LAST_BIT if environment in SUMS else UNDERFLOW
        assert abs(residual(balance, before.h_s)) <= 1e-12 * largest(balance, before.h_s) + rounding
        for loss in (balance.h_r, balance.gen, balance.deficit, balance.leak, balance.paid, balance.h_s):
            assert loss >= 0.0
        surplus = before.h_dis + balance.gen + balance.deficit - balance.h_pas
        assert balance.paid == min(balance.leak, max(0.0, surplus))
        assert balance.h_dis == pytest.approx(surplus - balance.paid, rel=1e-12, abs=1e-300)
        assert balance.h_m == balance.h_i - balance.h_pas


@pytest.mark.slow_but(
    "guarded-coulomb_surface", "guarded-spring_damper_wall", "unprotected-detents", "internal_*-spring_*"
)
@every_algorithm
@settings(max_examples=8)
@given(script=moves)
def test_mirrored_motion_gives_the_mirrored_torque_and_the_same_energies(environment, algorithm, script):
    one, other = (controller(algorithm, side, 1) for side in EVERY[environment])
    mirrored = [(-target, relative, scale, -extra) for target, relative, scale, extra in script]
    for (balance, _), (image, _) in zip(drive(one, 1, script), drive(other, 1, mirrored), strict=True):
        assert image.torque == pytest.approx(-balance.torque, rel=1e-9, abs=1e-12)
        assert image.h_s == pytest.approx(balance.h_s, rel=1e-9, abs=1e-15)
        assert image.h_dis == pytest.approx(balance.h_dis, rel=1e-9, abs=1e-15)
        assert image.branch == balance.branch


def tapping(made, delay, cycles=400):
    pending, balances = deque([0.0] * (delay + 1)), []
    for k in range(cycles):
        balance = made.step(0.012 * math.sin(2.0 * math.pi * k / 97.0), pending.popleft())
        pending.append(balance.torque)
        balances.append(balance)
    return balances


@pytest.mark.slow_but("0-*-two_sided_wall", "1-guarded-layers", "1-guarded-viscoelastic_medium")
@every_algorithm
@pytest.mark.parametrize("delay", [0, 1])
def test_after_reset_the_run_repeats_bit_for_bit(environment, algorithm, delay):
    made = controller(algorithm, EVERY[environment][0], delay)
    first = tapping(made, delay)
    made.reset()
    assert tapping(made, delay) == first
    assert first[0] == AT_REST


@pytest.mark.slow_but("guarded-coulomb_surface", "unprotected-spring_*", "internal_*-spring_*")
@every_algorithm
def test_a_value_that_is_not_finite_raises_and_nothing_of_before_remains(environment, algorithm):
    made = controller(algorithm, EVERY[environment][0], 1)
    fresh = tapping(made, 1)
    for fault in (math.nan, math.inf, -math.inf):
        for values in ((fault, 0.0), (0.001, fault)):
            with pytest.raises(ControlError, match="finite"):
                made.step(*values)
            assert tapping(made, 1) == fresh, values


@pytest.mark.slow_but("0-*-spring_damper_wall", "1-guarded-*", "1-internal_dissipation-layers")
@pytest.mark.parametrize("algorithm", [name for name in algorithms() if name not in UNPROTECTED_START])
@pytest.mark.parametrize("delay", [0, 1])
def test_switched_on_in_contact_there_is_no_torque_while_the_user_rests(environment, algorithm, delay):
    made = controller(algorithm, EVERY[environment][0], delay)
    assert all(made.step(-0.015, 0.0).torque == 0.0 for _ in range(20))


@pytest.mark.slow_but("1-*-detents", "0-guarded-*", "1-internal_dissipation-layers")
@every_algorithm
@pytest.mark.parametrize("delay", [0, 1])
def test_a_user_at_rest_never_draws_energy(environment, algorithm, delay):
    made = controller(algorithm, EVERY[environment][0], delay)
    balance = tapping(made, delay)[-1]
    pending = deque([balance.torque] * (delay + 1))
    for _ in range(50):
        balance = made.step(-0.0101, pending.popleft())
        pending.append(balance.torque)
    assert balance.h_i == 0.0
    assert balance.gen == 0.0


@pytest.mark.slow_but(
    "*-spring_damper_wall", "guarded-detents", "guarded-coulomb_surface", "internal_dissipation-layers"
)
@every_algorithm
def test_a_lost_position_repeats_the_torque_and_books_it_with_the_next(environment, algorithm):
    made = controller(algorithm, EVERY[environment][0])
    position, balance, held = 0.01, AT_REST, 0.0
    for k in range(60):
        position -= 3e-4
        balance = made.step(position, held)
        held = balance.torque
        if k % 7 == 3:
            repeated = made.sample_lost()
            assert (repeated.torque, repeated.h_s, repeated.h_dis) == (held, balance.h_s, balance.h_dis)
            assert repeated.h_i == repeated.h_r == repeated.gen == repeated.leak == repeated.deficit == 0.0
            assert repeated.branch == Branch.HELD
            position -= 3e-4
            late = made.step(position - 3e-4, held)  # the same torque throughout: exact
            assert late.h_i == pytest.approx(held * 6e-4, rel=1e-9, abs=1e-15)
            assert abs(residual(late, balance.h_s)) <= 1e-12 * largest(late, balance.h_s)
            position, held = position - 3e-4, late.torque


@pytest.mark.slow_but("*-spring_damper_wall")
@every_algorithm
def test_before_the_first_position_there_is_nothing_to_repeat(environment, algorithm):
    made = controller(algorithm, EVERY[environment][0])
    assert made.sample_lost()._replace(branch=0) == AT_REST


@pytest.mark.slow_but("*-spring_damper_wall", "internal_dissipation-layers", "unprotected-viscoelastic_medium")
@pytest.mark.parametrize("algorithm", [name for name in algorithms() if name != "guarded"])
def test_a_reversal_hidden_by_a_lost_position_is_booked_at_its_worst(environment, algorithm):
    """Trap 13: out and back the displacement is near 0, and torque times displacement would be too.

    `guarded` charges it to its certificate and has tests of its own for that.
    """
    made = controller(algorithm, EVERY[environment][0], delay=1)
    for position in (0.006, 0.0, -0.006):
        made.step(position, 0.0)
    torques = [made.step(-0.008, 0.0).torque, made.step(-0.010, 0.0).torque]
    made.sample_lost()
    booked = made.step(-0.010, torques[1]).h_i
    assert booked <= -abs(torques[1] - torques[0]) * 0.002 + 1e-12
