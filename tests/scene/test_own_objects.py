"""A class or an instance of a Python program, given where a scene names a part."""

from typing import Annotated

import pytest

import canhaptic
from canhaptic import Environment, extending
from canhaptic.errors import InputError
from canhaptic.extending import quantity


class MyWall(Environment):
    stiffness: Annotated[float, quantity("N/m", "N*m/rad", ge=0.0)] = 200.0

    def effort(self, state: float) -> float:
        return self.stiffness * state


@pytest.mark.slow
@pytest.mark.parametrize(("wall", "stiffness"), [(MyWall, 200.0), (MyWall(stiffness=300.0), 300.0)])
def test_a_class_or_an_instance_is_an_environment(wall: object, stiffness: float) -> None:
    result = canhaptic.simulate("demo", {"environment": wall}, duration=0.02, progress=False)
    (axis,) = result.scene.axes
    assert isinstance(axis.environment.parameters, MyWall)
    assert axis.environment.parameters.stiffness == stiffness
    assert [name.split(":")[1] for name in result.scene.own_code] == ["MyWall"]


def test_an_environment_has_one_class_under_all_its_names() -> None:
    assert canhaptic.Environment is extending.Environment is extending.OwnEnvironment


def test_an_object_without_parameters_is_refused() -> None:
    with pytest.raises(InputError, match=r"environment: got .*a function of your own"):
        canhaptic.simulate("demo", {"environment": object()}, progress=False)
