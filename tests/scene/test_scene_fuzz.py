"""Any content of a scene file or an override: a scene, or SceneError with at least one fault, and nothing else."""

import string
from pathlib import Path

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from canhaptic.errors import SceneError
from canhaptic.scene.load import load_scene, scene_from_mapping
from tests.drawn import examples
from tests.scene.scene_text import SCENE, SHIPPED_EDS

FAST = settings(
    max_examples=examples(100), suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow]
)

SCALARS = (
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.text(max_size=12)
    | st.sampled_from(
        ["100 N/m", "1 kHz", "-1", "1e400", "m", "rad", "virtual", "unprotected", "cia402_servo.eds", "\0", "1 N*m"]
    )
)
VALUES = st.recursive(
    SCALARS,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=6), inner, max_size=3),
    max_leaves=6,
)
TREE = yaml.safe_load(SCENE)


def paths(value: object, path: tuple[str, ...] = ()) -> list[tuple[str, ...]]:
    """Returns the path of every entry of the scene."""
    entries = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [p for key, entry in entries for p in [(*path, str(key)), *paths(entry, (*path, str(key)))]]


PATHS = paths(TREE)


def accepts_or_refuses(path: Path, overrides: list[str]) -> None:
    faults = ["none"]
    try:
        load_scene(path, overrides)
    except SceneError as error:
        faults = list(error.faults)
    assert faults  # what is wrong has a place
    assert all(fault and fault.isprintable() for fault in faults)


@FAST
@given(content=st.binary(max_size=200))
def test_any_bytes(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "scene.yaml"
    path.write_bytes(content)
    accepts_or_refuses(path, [])


@FAST
@given(text=st.text(alphabet="abc01.-+:[]{},#&*!?|>'\"%@`<~ \n\t=e_", max_size=80))
def test_any_text_that_looks_like_yaml(tmp_path: Path, text: str) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text(text, encoding="utf-8")
    accepts_or_refuses(path, [])


@FAST
@given(data=st.data())
def test_a_scene_with_bytes_changed(tmp_path: Path, data: st.DataObject) -> None:
    content = bytearray(SCENE.encode())
    for _ in range(data.draw(st.integers(1, 4))):
        place = data.draw(st.integers(0, len(content) - 1))
        piece = data.draw(st.sampled_from([b"", b":", b"\n", b" ", b"[", b"{", b"- ", b"\xff", b"9", b"'", b"*x"]))
        content[place : place + data.draw(st.integers(0, 12))] = piece
    path = tmp_path / "scene.yaml"
    path.write_bytes(bytes(content))
    accepts_or_refuses(path, [])


@FAST
@given(changes=st.lists(st.tuples(st.sampled_from(PATHS), VALUES), min_size=1, max_size=3))
def test_a_scene_with_any_value_anywhere(tmp_path: Path, changes: list[tuple[tuple[str, ...], object]]) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text(SCENE, encoding="utf-8")
    overrides = [f"{'.'.join(place)}={yaml.safe_dump(value, default_flow_style=True)}" for place, value in changes]
    accepts_or_refuses(path, overrides)


@FAST
@given(overrides=st.lists(st.text(alphabet=string.printable, max_size=30), max_size=3))
def test_any_override(tmp_path: Path, overrides: list[str]) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text(SCENE, encoding="utf-8")
    accepts_or_refuses(path, overrides)


@FAST
@given(values=st.dictionaries(st.sampled_from([*TREE, "other"]), VALUES, max_size=7))
def test_any_plain_values(values: dict[str, object]) -> None:
    with pytest.raises(SceneError):
        scene_from_mapping({**values, "axes": values.get("axes")})


def test_the_scene_under_test_is_valid(tmp_path: Path) -> None:
    assert SHIPPED_EDS.is_file()
    path = tmp_path / "scene.yaml"
    path.write_text(SCENE, encoding="utf-8")
    assert load_scene(path).axes
