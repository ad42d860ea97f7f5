"""What every environment keeps. A new one needs a line in its table and an example in `cases`."""

import math
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canhaptic.control.environments import ENVIRONMENTS, knows_turns, outside_of, plain
from canhaptic.control.environments.coulomb_surface import CoulombSurface
from canhaptic.control.environments.detents import Detents
from canhaptic.control.environments.hardening_wall import HardeningWall
from canhaptic.control.environments.own_environment import Environment
from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.control.environments.two_sided_wall import TwoSidedWall
from canhaptic.errors import ParameterError
from canhaptic.registry import load
from tests.control.cases import EVERY, EXAMPLES
from tests.drawn import examples

every_environment = pytest.mark.parametrize("environment", [pair[0] for pair in EVERY.values()], ids=EVERY)
positions = st.floats(-0.03, 0.03)


def test_every_environment_of_the_table_has_an_example_of_its_class():
    assert set(EXAMPLES) == set(ENVIRONMENTS)
    for name, pair in EXAMPLES.items():
        assert all(type(environment) is load(ENVIRONMENTS, name, "environment") for environment in pair)


def touched(environment, position):
    """The true state at a position reached from 1 mm away, or None out of contact."""
    return environment.true_state(position, 1e-3, 0.0) if environment.contact(position) else None


@every_environment
@given(position=positions)
def test_stored_energy_is_never_negative_and_effort_is_its_gradient(environment, position):
    state = touched(environment, position)
    if state is None:
        return
    step = 1e-7
    slope = (environment.stored_energy(state + step) - environment.stored_energy(state - step)) / (2.0 * step)
    assert environment.stored_energy(state) >= 0.0
    assert environment.effort(state) == pytest.approx(slope, rel=1e-5, abs=1e-4)
    assert environment.stored_energy(0.0) == 0.0


@every_environment
@given(position=positions)
def test_the_state_of_an_energy_stores_that_energy_on_the_same_branch(environment, position):
    state = touched(environment, position)
    if state is None or environment.stored_energy(state) == 0.0:
        return
    back = environment.state_of_energy(environment.stored_energy(state), state)
    assert back == pytest.approx(state, rel=1e-6, abs=1e-6)
    assert environment.stored_energy(back) == pytest.approx(environment.stored_energy(state), rel=1e-9)


@every_environment
@given(position=positions, sample_time=st.floats(1e-5, 0.1))
def test_relaxation_never_stores_more(environment, position, sample_time):
    state = touched(environment, position)
    if state is None:
        return
    relaxed = environment.relaxed(state, sample_time)
    assert environment.stored_energy(relaxed) <= environment.stored_energy(state)
    assert environment.relaxes or relaxed == state


@every_environment
@given(position=positions)
def test_a_linear_stiffness_tells_the_whole_storage(environment, position):
    state = touched(environment, position)
    if state is None or environment.linear_stiffness is None:
        return
    assert environment.stored_energy(state) == pytest.approx(0.5 * environment.linear_stiffness * state * state)


@every_environment
@given(position=positions)
def test_a_true_state_is_admissible_and_so_is_the_nearest_to_any(environment, position):
    state = touched(environment, position)
    if state is None:
        return
    assert environment.admissible(state, state) == state
    for other in (-0.02, 0.0, 0.02):
        nearest = environment.admissible(other, state)
        assert environment.admissible(nearest, state) == nearest


@pytest.mark.parametrize("name", sorted(EXAMPLES))
@settings(max_examples=examples(50))
@given(position=positions)
def test_the_mirror_image_has_the_mirrored_effort(name, position):
    one, other = EXAMPLES[name]
    state = touched(one, position)
    if state is None:
        assert other.contact(-position) == 0  # type: ignore[attr-defined]
        return
    image = other.true_state(-position, -1e-3, 0.0)  # type: ignore[attr-defined]
    assert other.effort(image) == pytest.approx(-one.effort(state), rel=1e-9, abs=1e-9)  # type: ignore[attr-defined]


def test_detents_rest_at_every_pitch_and_peak_a_quarter_beside():
    detents = Detents(peak=2.0, pitch=0.01)
    assert detents.contact(0.02) == detents.contact(-0.01) == 0
    assert detents.contact(0.015) != detents.contact(0.025)
    state = detents.true_state(0.0225, 0.0, 0.0)
    assert detents.effort(state) == pytest.approx(2.0)
    assert detents.stored_energy(0.005) == pytest.approx(2.0 * 0.01 / math.pi)


def test_a_bristle_yields_at_the_friction_effort():
    surface = CoulombSurface(friction=1.5, stiffness=2000.0)
    assert surface.effort(surface.relaxed(0.01, 1e-3)) == pytest.approx(1.5)
    assert surface.effort(surface.relaxed(-0.01, 1e-3)) == pytest.approx(-1.5)


def test_bad_parameters_are_refused_with_value_and_limit():
    with pytest.raises(ParameterError, match="stiffness: got -1"):
        SpringDamperWall(stiffness=-1.0)
    with pytest.raises(ParameterError, match=r"lower 0\.2 lies above upper 0\.1"):
        TwoSidedWall(stiffness=1.0, lower=0.2, upper=0.1)
    with pytest.raises(ParameterError, match="pitch: got 0"):
        Detents(peak=1.0, pitch=0.0)
    with pytest.raises(ParameterError, match="stiffness: got nan"):
        SpringDamperWall(stiffness=math.nan)


ALL: list[Any] = [environment for pair in EXAMPLES.values() for environment in pair]


@pytest.mark.parametrize("environment", [environment for environment in ALL if knows_turns(environment)], ids=repr)
@given(position=positions, share=st.floats(1e-6, 1.0 - 1e-6))
def test_in_the_stretch_around_a_position_the_effort_points_one_way_and_the_contact_stays(environment, position, share):
    low, high = environment.one_way(position)
    assert low <= position <= high
    if not low < position < high:  # at its end, or without an effort
        return
    low, high = max(low, position - 0.02), min(high, position + 0.02)
    within = low + share * (high - low)
    efforts = [environment.effort(environment.true_state(at, 0.0, 0.0)) for at in (position, within)]
    assert environment.contact(within) == environment.contact(position) != 0
    assert efforts[0] * efforts[1] >= 0.0


def test_the_stretches_of_detents_end_at_rests_and_crests_and_those_of_a_slot_at_its_walls():
    detents = Detents(peak=2.0, pitch=0.01, position=0.002)
    assert detents.one_way(0.003) == pytest.approx((0.002, 0.007))
    assert detents.one_way(0.0071) == pytest.approx((0.007, 0.012))
    assert detents.one_way(0.002) == (0.002, 0.002)
    slot = TwoSidedWall(stiffness=500.0, lower=-0.01, upper=0.02)
    assert (slot.one_way(-0.011), slot.one_way(0.021)) == ((-math.inf, -0.01), (0.02, math.inf))
    assert slot.one_way(0.0) == (0.0, 0.0)


class Centre(Environment):
    def effort(self, state):
        return 200.0 * state


class Slides(Centre):
    def true_state(self, position, displacement, previous):
        return position - self.position - 0.001


class Follows(Slides):
    def one_way(self, position):
        return self.position - 1.0, self.position + 1.0


def test_the_way_out_of_ones_own_environment_is_known_as_far_as_its_contact_is_ours():
    ways = [(kind(side=side), outside, knows) for kind, side, outside, knows in (
        (Centre, "below", 1.0, True), (Centre, "above", -1.0, True), (Centre, "both", 0.0, True),
        (Slides, "below", 0.0, False), (Slides, "both", 0.0, False), (Follows, "both", 0.0, True),
    )]  # fmt: skip
    for environment, outside, knows in ways:
        for form in (environment, plain(environment)):
            assert (outside_of(form), knows_turns(form)) == (outside, knows)
    for medium in (plain(of) for of in ALL if type(of).__name__ in ("ViscousMedium", "CoulombSurface")):
        assert outside_of(medium) == 0.0
        assert medium.one_way(0.3) == (0.3, 0.3)
    assert Centre(position=0.1).one_way(0.3) == (0.1, math.inf)
    assert Centre(position=0.1).one_way(0.1) == (0.1, 0.1)


@pytest.mark.parametrize(("hardening", "expected"), [(0.0, 200.0), (1.0, None)])
def test_a_hardening_wall_is_linear_without_hardening_alone(hardening, expected):
    """The certificates rest on one stiffness, or on none."""
    assert HardeningWall(stiffness=200.0, hardening=hardening).linear_stiffness == expected
