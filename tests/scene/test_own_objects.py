"""A class or an instance of a Python program, given where a scene names a part."""

from typing import Annotated

import pytest

import canhaptic
from canhaptic import Environment, extending
from canhaptic.errors import InputError, SceneError
from canhaptic.extending import quantity
from canhaptic.scene import own_code
from canhaptic.scene.load import load_scene


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


@pytest.mark.slow
def test_another_process_says_that_it_lacks_the_class(monkeypatch: pytest.MonkeyPatch) -> None:
    overrides = canhaptic.simulate("demo", {"environment": MyWall}, duration=0.01, progress=False).scene.overrides
    monkeypatch.setattr(own_code, "GIVEN", {})
    with pytest.raises(
        SceneError, match=r"MyWall: is a class or function of a Python program.*name it FILE\.py:MyWall"
    ):
        load_scene("demo", overrides)


def test_an_object_without_parameters_is_refused() -> None:
    with pytest.raises(InputError, match=r"environment: got .*a function of your own"):
        canhaptic.simulate("demo", {"environment": object()}, progress=False)
