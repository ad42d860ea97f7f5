"""An environment without pydantic is the environment: the same answers, bit for bit, from the same functions."""

from typing import Annotated, Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canhaptic.control.environments import ENVIRONMENTS, plain
from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.control.passivity import LoopProperties, build_controller
from canhaptic.registry import load
from canhaptic.units import Parameters, quantity

VALUES = {
    "stiffness": 321.5,
    "damping": 4.25,
    "position": -0.01,
    "lower": -0.03,
    "upper": 0.04,
    "hardening": 1e5,
    "relaxation_time": 0.05,
}
number = st.floats(-0.2, 0.2)


def made(name: str) -> Any:
    """Returns an environment of a type with a value for every number that it cannot do without."""
    kind = load(ENVIRONMENTS, name, "environment")
    needed = {field: VALUES.get(field, 0.5) for field, info in kind.model_fields.items() if info.is_required()}
    return kind(**needed)


@pytest.mark.parametrize("name", ENVIRONMENTS)
@given(position=number, displacement=number, previous=number, state=number, energy=st.floats(0.0, 5.0))
def test_every_environment_answers_as_its_model_does(
    name: str, position: float, displacement: float, previous: float, state: float, energy: float
) -> None:
    model = made(name)
    twin = plain(model)
    assert twin is not model
    assert not isinstance(twin, Parameters)
    for place in ("damping", "linear_stiffness", "relaxes"):
        assert getattr(twin, place) == getattr(model, place)
    assert twin.contact(position) == model.contact(position)
    asked = [
        ("true_state", (position, displacement, previous)),
        ("admissible", (state, position)),
        ("stored_energy", (state,)),
        ("effort", (state,)),
        ("state_of_energy", (energy, state)),
        ("relaxed", (state, 1e-3)),
    ]
    for question, values in asked:
        answers = [getattr(each, question)(*values).hex() for each in (twin, model)]
        assert answers[0] == answers[1], question


def test_a_controller_is_given_the_plain_form() -> None:
    loop = LoopProperties(sample_time=1e-3, moving_mass=0.2, device_damping_bound=0.0)
    controller: Any = build_controller(SpringDamperWall(stiffness=100.0), "guarded", None, loop)
    assert not isinstance(controller._environment, Parameters)


class Doubled(SpringDamperWall):
    """A wall of somebody's own that asks its base."""

    def effort(self, state: float) -> float:
        """Returns twice the effort of the wall."""
        return 2.0 * super().effort(state)


class Stiffened(SpringDamperWall):
    """A wall of somebody's own whose property asks its base."""

    @property
    def linear_stiffness(self) -> float:
        """Twice that of the wall."""
        return 2.0 * super().linear_stiffness


class Counting(SpringDamperWall):
    """A wall of somebody's own with a field, a property and a method that changes what it is computed from."""

    offset: Annotated[float, quantity("m")] = 0.25

    @property
    def surface(self) -> float:
        """Where it begins."""
        return self.position + self.offset

    def contact(self, position: float) -> int:
        """Returns 2 below the surface."""
        return self.model_zone(position)

    def model_zone(self, position: float) -> int:
        """Has a name as pydantic's own have."""
        return 2 if position < self.surface else 0


def test_a_model_that_asks_its_base_and_an_object_that_is_no_model_are_taken_as_they_are() -> None:
    doubled = Doubled(stiffness=10.0)
    assert plain(doubled) is doubled
    stiffened = Stiffened(stiffness=10.0)
    assert plain(stiffened).linear_stiffness == 20.0
    stranger = object()
    assert plain(stranger) is stranger


def test_an_environment_of_ones_own_keeps_what_it_overrides_and_adds() -> None:
    twin = plain(Counting(stiffness=10.0, position=1.0))
    assert not isinstance(twin, Parameters)
    assert (twin.contact(1.2), twin.contact(1.3), twin.surface, twin.effort(0.5)) == (2, 0, 1.25, 5.0)
