"""Environments given by their force or potential alone, against the closed forms of the built-in ones."""

import math
from typing import Annotated, Literal

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from canhaptic.control.environments.hardening_wall import HardeningWall
from canhaptic.control.environments.own_environment import Environment, integral, state_of
from canhaptic.errors import OwnCodeError, ParameterError
from canhaptic.units import quantity

STATES = st.floats(-0.1, 0.1)


class Hardening(Environment):
    """The force of `HardeningWall`."""

    stiffness: Annotated[float, quantity("N/m", ge=0.0)] = 300.0
    hardening: Annotated[float, quantity("N/m^3", ge=0.0)] = 2e5

    def effort(self, state: float) -> float:
        return self.stiffness * state + self.hardening * state**3


class Potential(Environment):
    """The potential of `HardeningWall`."""

    def potential(self, state: float) -> float:
        return 150.0 * state**2 + 5e4 * state**4


CLOSED = HardeningWall(stiffness=300.0, hardening=2e5)


@given(STATES)
def test_the_energy_of_a_force_is_its_integral(state: float) -> None:
    assert Hardening().stored_energy(state) == pytest.approx(CLOSED.stored_energy(state), rel=1e-12, abs=1e-300)


@given(STATES)
def test_the_force_of_a_potential_is_its_slope(state: float) -> None:
    assert Potential().effort(state) == pytest.approx(CLOSED.effort(state), rel=1e-7, abs=1e-9)


@given(st.floats(0.0, 10.0), st.sampled_from([-1.0, 1.0]))
def test_the_state_of_an_energy_is_that_of_the_closed_form(energy: float, like: float) -> None:
    own = Hardening().state_of_energy(energy, like * 0.01)
    assert own == pytest.approx(CLOSED.state_of_energy(energy, like), rel=1e-10, abs=1e-12)


@given(st.floats(0.001, 0.05), st.floats(0.1, 20.0), STATES)
@example(0.003413708754049141, 1.0, 0.08479088338993593)  # near the end of an interval: seen by neither rule
@example(0.0003, 5.0, 0.08)
def test_a_force_with_a_jump_is_integrated_too(edge: float, level: float, state: float) -> None:
    def step(x: float) -> float:
        return math.copysign(level, x) if abs(x) > edge else 0.0

    exact = level * max(0.0, abs(state) - edge)
    assert integral(step, state) == pytest.approx(exact, abs=1e-9)


def test_the_integral_of_a_force_that_is_no_number_ends_at_once() -> None:
    asked = 0

    def force(x: float) -> float:
        nonlocal asked
        asked += 1
        assert asked < 10_000
        return math.nan if x > 0.01 else x

    assert math.isnan(integral(force, 0.02))


def test_an_energy_that_no_state_stores_gives_the_farthest_state() -> None:
    state = state_of(lambda x: 1.0 - math.exp(-x * x), lambda x: 2.0 * x * math.exp(-x * x), 2.0, -0.5)
    assert state < -1e6


@pytest.mark.parametrize(("side", "felt"), [("both", (1, 1, 1)), ("below", (1, 0, 0)), ("above", (0, 0, 1))])
def test_it_is_felt_where_its_side_says(side: Literal["both", "below", "above"], felt: tuple[int, ...]) -> None:
    wall = Hardening(position=0.02, side=side)
    assert tuple(wall.contact(q) for q in (0.01, 0.02, 0.03)) == felt
    assert wall.true_state(0.05, 0.0, 0.0) == pytest.approx(0.03)
    assert wall.admissible(-0.01, 0.01) == (-0.01 if side == "both" else 0.0)


class Kinked(Environment):
    """A spring that gives way at `most`."""

    most: float = 3.0

    def effort(self, state: float) -> float:
        return max(-self.most, min(self.most, 300.0 * state))


@given(st.lists(STATES, min_size=1, max_size=6))
def test_the_energy_at_a_state_does_not_depend_on_the_states_asked_before(states: list[float]) -> None:
    wall = Kinked()
    found = [wall.stored_energy(state) for state in states]
    for state, energy in zip(states, found, strict=True):
        assert energy == Kinked(most=3.0).stored_energy(state)
        assert energy == pytest.approx(
            150.0 * min(abs(state), 0.01) ** 2 + 3.0 * max(0.0, abs(state) - 0.01), rel=5e-12, abs=1e-300
        )


def test_a_kink_costs_no_more_calls_than_a_smooth_force_once_it_was_found() -> None:
    calls = {"n": 0}

    class Counted(Kinked):
        def effort(self, state: float) -> float:
            calls["n"] += 1
            return super().effort(state)

    wall = Counted()
    wall.stored_energy(0.05)
    calls["n"] = 0
    for k in range(100):
        wall.stored_energy(0.05 - 1e-4 * k)
    assert calls["n"] <= 100 * 30


class Notches(Environment):
    """24 notches in a revolution, as one contact."""

    def effort(self, state: float) -> float:
        return 2.0 * math.sin(24.0 * state)


class NotchesByEnergy(Environment):
    def potential(self, state: float) -> float:
        return 2.0 / 24.0 * (1.0 - math.cos(24.0 * state))


@pytest.mark.parametrize("kind", [Notches, NotchesByEnergy])
def test_a_force_that_points_away_is_refused_with_its_place_and_the_remedy(kind: type[Environment]) -> None:
    with pytest.raises(ParameterError, match=r"effort\(0\.1\d+\) is -.*the sign of the state.*use `detents`"):
        kind()


def test_a_force_that_turns_between_the_places_looked_at_ends_the_run_there() -> None:
    class Narrow(Environment):
        def effort(self, state: float) -> float:
            return -5.0 if 0.0209 < state < 0.0213 else 100.0 * state

    wall = Narrow()
    assert wall.stored_energy(0.01) == pytest.approx(0.005)
    with pytest.raises(OwnCodeError, match="the sign of the state"):
        wall.stored_energy(0.021)


def test_an_environment_with_zones_of_its_own_may_turn() -> None:
    class Zones(Notches):
        def contact(self, position: float) -> int:
            return 1 + math.floor(position * 24.0 / math.tau)

    assert Zones().effort(0.2) < 0.0


def test_only_the_solid_side_of_a_wall_is_looked_at() -> None:
    class OneSided(Environment):
        side: Literal["both", "below", "above"] = "below"

        def effort(self, state: float) -> float:
            return -100.0 if state > 0.0 else 100.0 * state

    assert OneSided().effort(-0.1) == -10.0
