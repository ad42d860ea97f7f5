"""Pages of the documentation that are made from data say what the data says."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from canhaptic.errors import InputError
from canhaptic.scene.json_schema import scene_schema
from canhaptic.scene.layout import SECTIONS
from canhaptic.scene.models import RunParameters
from tools import accuracy_gallery, make_configuration, make_how_it_works, make_link_policy, make_words
from tools.page_part import with_part

CONFIGURATION = make_configuration.PAGE.read_text(encoding="utf-8")


def test_the_page_of_the_link_policy_is_current() -> None:
    page = make_link_policy.PAGE.read_text(encoding="utf-8")
    assert page == make_link_policy.page(), "run: python -m tools.make_link_policy"


def test_the_table_of_quantities_is_current() -> None:
    assert make_words.PAGE.read_text(encoding="utf-8") == make_words.page(), "run: python -m tools.make_words"


def test_the_part_of_a_page_that_shows_what_accuracy_costs_is_current() -> None:
    page = accuracy_gallery.PAGE.read_text(encoding="utf-8")
    assert page == accuracy_gallery.page(), "run: python -m tools.accuracy_gallery --page"


def test_a_page_without_the_part_that_is_made_says_what_to_write(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("# A page\n")
    with pytest.raises(InputError, match=r"page.md: no part between <!-- trace: begin -->"):
        with_part(page, "trace", "text\n")


def test_the_page_of_the_configuration_is_current() -> None:
    assert make_configuration.page() == CONFIGURATION, "run: python -m tools.make_configuration"


def test_the_trace_of_a_cycle_is_current() -> None:
    page = make_how_it_works.PAGE.read_text(encoding="utf-8")
    assert make_how_it_works.page() == page, "run: python -m tools.make_how_it_works"


ROW = r"^\| (?:\*\*)?\[?`(\w+)`"
"""The key of a row, bold in a first rig, a link where a word explains it."""


def keys_in(text: str) -> list[str]:
    """The names in code spans."""
    return re.findall(r"`(\w+)`", text)


def keys_of(schema: Any, named: dict[str, Any]) -> Iterator[str]:
    """Every key that a JSON schema accepts, at any depth, but for `type` and `algorithm`, which are in titles."""
    if isinstance(schema, list):
        for part in schema:
            yield from keys_of(part, named)
    elif isinstance(schema, dict) and schema:
        if "$ref" in schema:
            yield from keys_of(named[schema["$ref"].removeprefix("#/$defs/")], named)
        for name, inside in schema.get("properties", {}).items():
            if name not in ("type", "algorithm"):
                yield name
            yield from keys_of(inside, named)
        for part in ("anyOf", "oneOf", "prefixItems", "items", "additionalProperties"):
            yield from keys_of(schema.get(part), named)


@pytest.fixture(scope="module")
def schema_of_scenes() -> dict[str, Any]:
    schema = scene_schema()
    assert set(schema["properties"]) == set(SECTIONS)
    return schema


@pytest.mark.slow
@pytest.mark.parametrize("section", SECTIONS)
def test_every_key_that_a_scene_may_have_is_in_its_section_of_the_page(section: str, schema_of_scenes: dict[str, Any]):
    parts = re.split(r"^## ", CONFIGURATION, flags=re.MULTILINE)
    above, own = parts[1], [part for part in parts if re.match(rf"`{section}\b", part)]
    assert section in re.findall(ROW, above, re.MULTILINE)
    listed = set(re.findall(ROW, "".join(own), re.MULTILINE))
    listed |= {key for keys in re.findall(r"^As in .*: (`.*)$", "".join(own), re.MULTILINE) for key in keys_in(keys)}
    schema = schema_of_scenes["properties"][section]
    if section == "axes":  # whose own environment and passivity are those of the sections of that name
        own_sections: dict[str, Any] = {"environment": {}, "passivity": {}}
        schema = {"properties": {**schema["items"]["properties"], **own_sections}}
    expected = set(keys_of(schema, schema_of_scenes["$defs"]))
    assert expected <= listed
    assert expected or section in RunParameters.model_fields


def test_every_key_of_the_page_is_explained_and_has_a_value() -> None:
    rows = re.findall(rf"{ROW}[^|]* \|(.*)\|$", CONFIGURATION, re.MULTILINE)
    assert len(rows) > 250
    for name, cells in rows:
        value, words = [cell.strip() for cell in re.split(r"(?<!\\)\|", cells)]
        assert words, f"{name}: give its field a docstring"
        assert value, f"{name}: no kind of value"
    assert re.findall(r"^\| `\w+` \| m or rad: > 0", CONFIGURATION, re.MULTILINE)
    assert "inside it" not in CONFIGURATION


def test_what_is_as_in_an_earlier_section_is_in_its_table() -> None:
    parts = re.findall(r"^### (.*?)\n(.*?)(?=^##)", CONFIGURATION, re.MULTILINE | re.DOTALL)
    again = re.findall(r"^As in (.*): (`\w+`(?:, `\w+`)*)\.$", CONFIGURATION, re.MULTILINE)
    assert len(again) > 30
    for where, keys in again:
        text = "".join(part for title, part in parts if title == where)
        assert set(keys_in(keys)) <= set(re.findall(ROW, text, re.MULTILINE)), where


def test_the_31_keys_of_a_first_rig_are_bold_and_no_other() -> None:
    bold = re.findall(r"^\| \*\*\[?`(\w+)`", CONFIGURATION, re.MULTILINE)
    sections = {"bus", "axes", "environment", "passivity"}
    assert set(bold) == {path.split(".")[-1] for path in make_configuration.first_rig()} - {"type", "algorithm"}
    assert len(set(bold) - sections) == 31
