"""Values replaced in the text of a scene: what is meant changes, and nothing else of what was written."""

from pathlib import Path

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from canhaptic.errors import InputError
from canhaptic.scene.load import load_scene, scene_from_text
from canhaptic.scene.scene_text import Change, edited_scene, edited_text, is_written
from tests.drawn import examples

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
TEXT = """\
# A rig.
axes:
  - name: left            # the first
    counts: 65536 1/rad   # TO SET: counts per radian
                          # here a guess
    # ratio: 1            # of the gear
  - {name: right, counts: 5}

passivity:
  mass: 1 kg  # TO SET: of the handle
# The end.
"""


def test_a_value_takes_its_place_and_its_mark_goes_with_all_of_its_comment() -> None:
    text = edited_text(TEXT, [Change(("axes", "0", "counts"), "7 1/rad", "measured")])
    assert text == TEXT.replace("65536 1/rad   # TO SET: counts per radian", "7 1/rad       # measured").replace(
        "                          # here a guess\n", ""
    )


def test_a_value_that_is_right_loses_its_mark_alone_and_none_is_added_where_it_is_not_written() -> None:
    changes = [Change(("passivity", "mass"), None, "measured"), Change(("passivity", "lag"), None, "measured")]
    assert edited_text(TEXT, changes) == TEXT.replace("TO SET: of the handle", "measured")


@pytest.mark.parametrize(
    ("path", "after"),
    [
        (("passivity", "lag"), "  mass: 1 kg  # TO SET: of the handle\n  lag: 3  # measured\n"),
        (("axes", "left", "lag"), "                          # here a guess\n    lag: 3  # measured\n"),
        (("axes", "left", "own", "lag"), "# here a guess\n    own:\n      lag: 3  # measured\n"),
        (("axes", "right", "lag"), "  - {lag: 3, name: right, counts: 5}\n"),
        (("axes", "1", "own", "lag"), "  - {own: {lag: 3}, name: right, counts: 5}\n"),
        (("axes", "1", "counts"), "  - {name: right, counts: 3}\n"),
        (("run", "lag"), "# TO SET: of the handle\nrun:\n  lag: 3  # measured\n# The end.\n"),
    ],
)
def test_a_value_is_added_behind_the_last_of_its_section(path: tuple[str, ...], after: str) -> None:
    text = edited_text(TEXT, [Change(path, "3", "measured")])
    assert after in text
    assert is_written(text, path)
    assert set(TEXT.splitlines()) - set(text.splitlines()) <= {"  - {name: right, counts: 5}"}


def test_a_text_without_a_last_line_end_gets_one() -> None:
    assert edited_text("a: 1", [Change(("b",), "2")]) == "a: 1\nb: 2\n"


@pytest.mark.parametrize("path", [("axes",), ("passivity", "mass", "lag"), ("axes", "2", "name")])
def test_what_is_no_single_value_is_refused(path: tuple[str, ...]) -> None:
    with pytest.raises(InputError, match=path[-1] if path != ("axes",) else "a whole section"):
        edited_text(TEXT, [Change(path, "3", "measured")])


@settings(max_examples=examples(100), deadline=None)
@given(
    values=st.dictionaries(st.sampled_from(["mass", "counts", "lag", "x"]), st.integers(1, 99), min_size=1),
    depth=st.sampled_from([("axes", "0"), ("axes", "0", "own", "deep"), ("axes", "1"), ("passivity",), ("new",), ()]),
)
def test_the_text_means_what_was_asked_for_and_every_other_line_stays(values: dict[str, int], depth: tuple[str, ...]):
    after = edited_text(TEXT, [Change((*depth, key), str(value), "measured") for key, value in values.items()])
    section = meant = yaml.safe_load(TEXT)
    for part in depth:
        section = section[int(part)] if isinstance(section, list) else section.setdefault(part, {})
    section.update(values)
    assert yaml.safe_load(after) == meant
    inline = "name: right" if depth == ("axes", "1") else "here a guess"  # its new values go into its one line
    kept = [line for line in TEXT.splitlines() if not any(f"{key}:" in line for key in values)]
    left = iter(after.splitlines())
    assert all(line in left for line in kept if "here a guess" not in line and inline not in line)  # in their order


def test_a_scene_is_written_with_its_overrides() -> None:
    scene = load_scene(CONFIGS / "demo.yaml", ["passivity.hand_force=2 N", "axes.handle.node_id=5"])
    text = edited_scene(scene, [Change(("passivity", "current_lag"), "90 us", "measured")], scene.source)
    again = scene_from_text(text, scene.source)
    assert again.axes[0].parameters.node_id == 5
    assert again.axes[0].loop.current_lag == pytest.approx(90e-6)
    assert again.axes[0].passivity.parameters.hand_force == 2.0  # type: ignore[attr-defined]
    assert text.count("#") == scene.text.count("#") + 1


@pytest.mark.slow
@pytest.mark.parametrize(("first", "second"), [("0", "1"), ("first", "second")])
def test_a_key_that_one_axis_gets_is_not_taken_over_by_another_through_an_anchor(first: str, second: str) -> None:
    scene, place = load_scene(CONFIGS / "two_handles.yaml"), str(CONFIGS / "mine.yaml")
    alone = edited_scene(scene, [Change(("axes", first, "product_code"), "402")], place)
    assert [axis.parameters.product_code for axis in scene_from_text(alone, place).axes] == [402, None]
    both = [Change(("axes", first, "product_code"), "402"), Change(("axes", second, "product_code"), "403")]
    own = scene_from_text(edited_scene(scene, both, place), place)
    assert [axis.parameters.product_code for axis in own.axes] == [402, 403]


def test_a_value_that_axes_share_by_an_anchor_is_written_for_all_of_them_or_refused() -> None:
    scene = load_scene(CONFIGS / "xy_box.yaml")
    first, second = (Change(("axes", str(axis), "passivity", "moving_mass"), f"0.{axis + 1} kg") for axis in (0, 1))
    again = scene_from_text(edited_scene(scene, [first, second], scene.source), scene.source)
    assert [axis.loop.moving_mass for axis in again.axes] == [0.1, 0.2]
    with pytest.raises(InputError, match="cannot be edited line by line: anchors"):
        edited_scene(scene, [first], scene.source)
