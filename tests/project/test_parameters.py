import contextlib
import math
from typing import Annotated, Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from canhaptic.errors import CanHapticError, ParameterError
from canhaptic.units import Parameters, parse_unit, quantity


class Wall(Parameters):
    stiffness: Annotated[float, quantity("N/m", "N*m/rad", ge=0.0, le=1e8)]
    rate: Annotated[float, quantity("Hz", gt=0.0)] = 1e3
    counts: Annotated[int, quantity("count", ge=1)] = 3
    pause: Annotated[float, quantity("s", ge=1.0)] | None = None


class Scene(Parameters):
    wall: Wall


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("100 N/m", 100.0),
        ("0.1 kN/m", 100.0),
        ("1e2", 100.0),
        ("100 N*m/rad", 100.0),
        ("1 N/mm", 1000.0),
        ("1 N*m/deg", 180.0 / math.pi),
        ("100 kg/s^2", 100.0),
    ],
)
def test_a_string_with_a_unit_is_read_in_si(text: str, value: float) -> None:
    assert Wall.model_validate({"stiffness": text}).stiffness == pytest.approx(value, rel=1e-15)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"stiffness": "1 Nm/rad"}, "unknown unit 'Nm'"),
        ({"stiffness": "1 m"}, "expected [N/m or N*m/rad]"),
        ({"stiffness": -1.0}, "got -1.0, expected 0 <= stiffness <= 1e8 [N/m or N*m/rad]"),
        ({"stiffness": 2e8}, "got 200000000.0, expected 0 <= stiffness <= 1e8 [N/m or N*m/rad]"),
        ({"stiffness": math.nan}, "got nan, expected 0 <= stiffness"),
        ({"stiffness": math.inf}, "got inf, expected 0 <= stiffness"),
        ({"stiffness": "inf"}, "not a number"),
        ({"stiffness": True}, "boolean"),
        ({"stiffness": None}, "got nothing, expected 0 <= stiffness"),
        ({"stiffness": 1.0, "pause": 0.5}, "got 0.5, expected 1 <= pause"),
        ({"stiffness": 1.0, "stifness": 1.0}, "unknown key; did you mean 'stiffness'?"),
        ({"stiffness": 1.0, "counts": 1.5}, "got 1.5, expected 1 <= counts"),
        ({}, "missing, expected 0 <= stiffness"),
    ],
)
def test_a_bad_value_is_refused_with_the_value_and_the_limit(values: dict[str, Any], words: str) -> None:
    with pytest.raises(ParameterError) as caught:
        Wall(**values)
    assert words in str(caught.value)
    assert "Wall." in str(caught.value)
    assert isinstance(caught.value, CanHapticError)
    assert isinstance(caught.value, ValueError)


def test_a_linear_unit_is_refused_on_a_rotary_axis_and_the_other_way_round() -> None:
    assert Wall.validated({"stiffness": "2 N*m/rad"}, "rad").stiffness == 2.0
    with pytest.raises(ParameterError, match=r"expected \[N\*m/rad\]"):
        Wall.validated({"stiffness": "2 N/m"}, "rad")
    with pytest.raises(ParameterError, match=r"expected \[N/m\]"):
        Wall.validated({"stiffness": "2 N*m/rad"}, "m")
    assert Wall.validated({"stiffness": "2 N/m"}).stiffness == Wall.validated({"stiffness": "2 N*m/rad"}).stiffness


def test_nested_faults_keep_their_path_and_come_all_at_once() -> None:
    with pytest.raises(ValidationError) as caught:
        Scene.model_validate({"wall": {"stiffness": -1.0, "rate": "1 m"}})
    assert [fault["loc"] for fault in caught.value.errors()] == [("wall", "stiffness"), ("wall", "rate")]


def test_parameters_are_frozen() -> None:
    wall = Wall(stiffness=1.0)
    with pytest.raises(ValidationError):
        wall.stiffness = 2.0


def test_the_json_schema_tells_unit_and_range() -> None:
    stiffness = Wall.model_json_schema()["properties"]["stiffness"]
    assert stiffness["unit"] == "N/m or N*m/rad"
    assert stiffness["anyOf"][0] == {"type": "number", "minimum": 0.0, "maximum": 1e8}


def test_quantity_refuses_to_annotate_what_is_not_a_number() -> None:
    class Bad(Parameters):
        name: Annotated[str, quantity("m")]

    with pytest.raises(TypeError, match="float or int"):  # the schema is built at the first use
        Bad(name="handle")


@given(st.floats(min_value=1e-9, max_value=1e9), st.sampled_from(["", "n", "u", "m", "k", "M"]))
def test_prefixes_scale_by_powers_of_ten(number: float, prefix: str) -> None:
    scale = {"": 1.0, "n": 1e-9, "u": 1e-6, "m": 1e-3, "k": 1e3, "M": 1e6}[prefix]
    assert parse_unit(f"{prefix}N/m")[0] * number == pytest.approx(scale * number, rel=1e-15)


@given(st.text(max_size=12))
def test_reading_a_unit_never_raises_anything_but_a_value_error(text: str) -> None:
    with contextlib.suppress(ValueError):
        parse_unit(text)
    with contextlib.suppress(ParameterError):
        Wall(stiffness=text)
