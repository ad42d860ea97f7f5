"""Writes docs/configuration.md from the schema of a scene: `python -m tools.make_configuration`.

Keys, units, ranges, defaults and words are those of the models, as `canhaptic configs --schema` prints them.
"""

import json
import re
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path
from textwrap import fill
from typing import Any, Final

import yaml

from canhaptic.cli.check_eds import survey_of
from canhaptic.scene.json_schema import Schema, scene_schema
from canhaptic.scene.scene_text import starter_scene
from tools.page_part import write_page

ROOT: Final = Path(__file__).resolve().parent.parent
PAGE: Final = ROOT / "docs" / "configuration.md"
WORDS: Final = PAGE.with_name("words.md")
_INTRODUCTION: Final = """\
---
search:
  boost: 2
---

# Configuration

For everybody who writes a scene file.

Every key of a scene file. The keys in **bold** are all that a first rig needs: `canhaptic new` writes them. A key that
is a link is explained in [words](words.md). This page is made from the models by `python -m tools.make_configuration`.

The second column has unit, range and default. Plain numbers are SI (or the unit given here). A text may carry a unit,
which is checked for dimension: `1 kHz`, `100 N/m`, `50 us`. Where two units are given, the first is of a linear axis
(`unit: m`), the second of a rotary one (`unit: rad`). A key without a default may be left out, unless it is required;
where the words say None, they say what leaving it out (or `null`) means. A key that is not listed is an error that
names the nearest one. Any value can be replaced from the command line: `--set environment.stiffness="500 N/m"`,
`--set axes.0.node_id=5`, and a part of a sum by its place or its type: `--set environment.detents.pitch="10 deg"`.
`--set passivity=unprotected` and `--set environment=damper_wall` (in full:
`passivity.algorithm=`, `environment.type=`) choose another type: keys that only the old one has are dropped and named,
and keys that the new one needs are listed with an example. With real drives nothing is dropped: it is an error.

`canhaptic configs --schema` prints the same as JSON Schema, for editors.

Where to go next: [words](words.md), and the [passivity guide](passivity_guide.md).
"""
_HEAD: Final = "| key | value; default | |\n|---|---|---|"
_LAST: Final = ("groups", "simulation")
"""Sections behind those that they refer to."""
_LIMITS: Final = {"exclusiveMinimum": ">", "minimum": ">=", "exclusiveMaximum": "<", "maximum": "<="}
_KINDS: Final = {"boolean": "`true`, `false`", "string": "text", "object": "mapping"}
_MANY: Final = {"any": "numbers", "number": "numbers", "integer": "integers", "text": "texts", "keys": "mappings"}
_ELSEWHERE: Final = ("axes[].environment", "axes[].passivity", "simulation.axes")
"""Keys whose own keys are those of another section."""


def page() -> str:
    """Returns the text of the page."""
    return _Page(scene_schema()).text()


class _Page:
    """The page of one schema."""

    def __init__(self, schema: Schema) -> None:
        self._schema = schema
        self._first = first_rig()
        self._where: dict[tuple[str, ...], str] = {}  # the heading below which a row was shown first, by row

    def text(self) -> str:
        """Returns the whole page."""
        sections = self._schema["properties"]
        top = [_row(name, of, name in self._schema["required"], name in self._first) for name, of in sections.items()]
        parts = [_INTRODUCTION, "\n## Top level\n\nThe sections of a scene, and what belongs to none.\n", *_table(top)]
        for name, of in sorted(sections.items(), key=lambda section: section[0] in _LAST):
            if self._mappings(of):
                parts.append(f"\n## `{name}`\n\n{fill(of.get('description', ''), 120)}\n")
                parts.extend(self._below([name], of))
        return re.sub(r"\n{3,}", "\n\n", "\n".join(parts)).rstrip() + "\n"

    def _below(self, paths: Sequence[str], schema: Schema) -> Iterator[str]:
        """Yields the tables of everything below keys of the same kind."""
        several = self._mappings(schema)
        listed = [path + "[]" * _is_list(schema) for path in paths]
        common = _common(several) if len(several) > 1 and all(map(_chosen, several)) else []
        heading = ", ".join(f"`{path}`" for path in listed)
        if common:
            title = f"{heading}: with every `{_chosen(several[0]).partition(':')[0]}`"
            yield f"\n### {title}\n"
            yield from self._keys(listed[0], several[0], common, title)
        for each in several:
            kind = f"`{_chosen(each)}`" if _chosen(each) else each.get("title", "")
            title = f"{heading}: {kind}" if len(several) > 1 else heading if "." in paths[0] else ""
            about = " ".join(each.get("description", "").split("\n\n")[0].split())
            yield f"\n### {title}\n\n{about}\n" if title else ""
            own = [key for key in each["properties"] if key not in common]
            yield from self._keys(listed[0], each, own, title or heading)

    def _keys(self, path: str, schema: Schema, keys: Sequence[str], title: str) -> Iterator[str]:
        """Yields the table of some keys, the names of those that an earlier table has, and what is below them."""
        shown = {key: schema["properties"][key] for key in keys if key not in ("type", "algorithm")}
        found, again = dict[tuple[str, ...], str](), dict[str, list[str]]()
        for key, of in shown.items():
            whole = f"{path}.{key}".replace("[]", "")
            row = _row(key, of, key in schema.get("required", ()), is_of_first_rig=False)
            if row in self._where:
                again.setdefault(self._where[row], []).append(f"`{key}`")
            else:
                found[row] = f"**{row[0]}**" if whole in self._first else row[0]
                self._first.discard(whole)
        self._where |= dict.fromkeys(found, title)
        yield from _table([(key, *row[1:]) for row, key in found.items()])
        yield from (f"As in {where}: {', '.join(names)}.\n" for where, names in again.items())
        inner = {key: self._mappings(of) for key, of in shown.items() if f"{path}.{key}" not in _ELSEWHERE}
        for key, mappings in inner.items():
            same = [other for other in inner if mappings and inner[other] == mappings]
            if same and same[0] == key:
                yield from self._below([f"{path}.{other}" for other in same], shown[key])

    def _mappings(self, schema: Schema) -> list[Schema]:
        """Returns every mapping with keys of its own that a value may be, or have in a list."""
        if "$ref" in schema:
            return self._mappings(self._schema["$defs"][schema["$ref"].removeprefix("#/$defs/")])
        if "properties" in schema:
            return [schema]
        inner = [*schema.get("anyOf", ()), *schema.get("oneOf", ()), *schema.get("prefixItems", ())]
        inner += [schema["items"]] if isinstance(schema.get("items"), dict) else []
        found: list[Schema] = []
        for part in inner:
            known = [(each.get("title"), _chosen(each)) for each in found]
            found += [each for each in self._mappings(part) if (each.get("title"), _chosen(each)) not in known]
        return found


def _is_list(schema: Schema) -> bool:
    parts = [part for part in schema.get("anyOf", [schema]) if part != {"type": "null"}]
    return any(part.get("type") == "array" and part.get("title") != "a sum" for part in parts)


def _chosen(schema: Schema) -> str:
    """Returns `type: NAME` of a mapping that is chosen by a name."""
    for selector in ("type", "algorithm"):
        name = schema["properties"].get(selector, {}).get("const")
        if name is not None:
            return f"{selector}: {name}"
    return ""


def _common(choices: Sequence[Schema]) -> list[str]:
    """Returns the keys that mean the same in every choice."""
    first, *others = (choice["properties"] for choice in choices)
    return [key for key, of in first.items() if all(other.get(key) == of for other in others)]


def first_rig() -> set[str]:
    """Returns the paths of the keys that `canhaptic new` writes for a rig with one axis, without list signs."""
    generic, _ = survey_of(ROOT / "eds" / "cia402_servo.eds")
    return set(_paths(yaml.safe_load(starter_scene(generic, simulate=False)), ""))


def _paths(node: Any, path: str) -> Iterator[str]:
    for each in node if isinstance(node, list) else [node]:
        for key, inner in each.items() if isinstance(each, dict) else ():
            yield f"{path}{key}"
            yield from _paths(inner, f"{path}{key}.")


def _row(name: str, schema: Schema, is_required: bool, is_of_first_rig: bool) -> tuple[str, ...]:
    unit, value = _value(schema)
    default = "required" if is_required else schema.get("taken") or _default(schema)
    key = f"**{_linked(name)}**" if is_of_first_rig else _linked(name)
    values = "; ".join(part for part in (f"{unit}: {value}" if unit not in ("", "1") else value, default) if part)
    return key, values, schema.get("description", "")


def _linked(name: str) -> str:
    """Returns a key as code, linked to the word that explains it."""
    return f"[`{name}`](words.md#{_explained()[name]})" if name in _explained() else f"`{name}`"


@cache
def _explained() -> dict[str, str]:
    """Returns the anchor of each word that names a key, by key."""
    rows = re.findall(r'^\| <a id="([\w-]+)"></a>(.*)', WORDS.read_text(encoding="utf-8"), re.MULTILINE)
    return {key: anchor for anchor, row in rows for key in re.findall(r"`(?:\w+(?:\[\])?\.)?(\w+)`", row)}


def _table(rows: Sequence[tuple[str, ...]]) -> Iterator[str]:
    """Yields a table of keys; nothing where there are none."""
    lines = ["| " + " | ".join(cell.replace("|", "\\|").replace("\n", " ") for cell in row) + " |" for row in rows]
    if lines:
        yield "\n".join([_HEAD, *lines]) + "\n"


def _value(schema: Schema) -> tuple[str, str]:
    """Returns unit and accepted values of a key."""
    if "unit" in schema:
        number = schema["anyOf"][0]
        limits = ", ".join(f"{sign} {number[key]:g}" for key, sign in _LIMITS.items() if key in number)
        closed = re.fullmatch(r">= (\S+), <= (\S+)", limits)
        return schema["unit"], f"{closed[1]} to {closed[2]}" if closed else limits or "any"
    if "const" in schema or "enum" in schema:
        return "", ", ".join(f"`{_plain(value)}`" for value in schema.get("enum") or [schema["const"]])
    if parts := [part for part in (schema.get("anyOf") or schema.get("oneOf") or ()) if part != {"type": "null"}]:
        found = [_value(part) for part in parts]
        return found[0][0], " or ".join(dict.fromkeys(value for _, value in found))
    if schema.get("type") == "array":
        fixed = schema.get("prefixItems", ()) if "items" not in schema else ()
        unit, each = _value(fixed[0] if fixed else schema.get("items", {}))
        count = f"{len(fixed)} values" if fixed else "list"
        many = f"{len(fixed) or 'list of'} {_MANY.get(each)}"
        return unit, many if each in _MANY else f"{count}, each {each}" if each else count
    if "$ref" in schema or "properties" in schema:
        return "", "keys"
    kind = str(schema.get("format") or schema.get("type", ""))
    return "", _KINDS.get(kind, kind)


def _default(schema: Schema) -> str:
    default = schema.get("default")
    if default is None:
        return ""
    return "its defaults" if isinstance(default, dict) and default else f"`{_plain(default)}`"


def _plain(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_plain, value)) + "]"
    return value if isinstance(value, str) else json.dumps(value)


if __name__ == "__main__":
    write_page(PAGE, page)
