"""One table has unit and title of every quantity that a user sees, and earlier names are read and written on."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import get_args, get_type_hints, is_typeddict

import pytest

from canhaptic import quantities
from canhaptic.audit.user_checks import check
from canhaptic.control.verdict import PortResult
from canhaptic.quantities import ACCOUNT, ALARM, ARENA, FIGURES, LIMITS, OLD_KEYS, TRUTH, row_of, with_old_names
from canhaptic.result import TruthResult
from canhaptic.units import parse_unit

TEXTS = {"unit", "state_unit", "environment", "read_back", "group", "axes", "suspects", "contradicted", "why", "advice",
         "verdict", "plant_passive", "plant_passive_at_handle", "passive_at_sensor", "certificate"}  # fmt: skip
PACKAGE = Path(quantities.__file__).parent
TITLES = {
    "title",
    "label",
    "what",
    "sentence",
    "remark",
    "x_label",
    "y_label",
    "value_label",
    "heading",
    "head",
    "text",
}
GETTERS = {"get_label", "get_title", "get_xlabel", "get_ylabel", "get_text"}
LAYOUT = {"format", "strip", "rstrip", "lstrip", "join", "ljust", "rjust", "center", "replace", "splitlines", "encode"}
READING = {name for name in dir(str) if name[0] != "_"} - LAYOUT
SEARCHING = {"match", "search", "fullmatch", "findall", "finditer", "get", "index", "count"}
_NAMES, _ANY = "|".join(sorted(TITLES - {"text"})), "|".join(sorted(READING | SEARCHING))
SUSPECT = re.compile(
    rf"""(?:\.|\[["'])(?:{_NAMES})\b(?!\()|[.\["']text\b[^,]*(?:[=!]=|\bin\b)|(?:[=!]=|\bin) [^,]*[.\["']text\b|"""
    rf"""[.\["']text\b.*\.(?:{_ANY})\(|\b(?:{_ANY})\(.*\.text\b|match .*\.text\b|\[[\w.]+\.text\]"""
    r"""|\.get_(?:label|title|xlabel|ylabel|text)\("""
)
"""A file without such a line need not be parsed."""
NO_TITLES = {
    "audit/why/causes.py": "`scene.text` is the YAML that was read",
    "view/table.py": "an empty cell is drawn empty, and a cell of one word is not broken",
}
TABLES = {"ACCOUNT": ACCOUNT, "TRUTH": TRUTH, "LIMITS": LIMITS, "FIGURES": FIGURES, "ARENA": ARENA}


def test_every_number_of_an_account_has_a_row() -> None:
    """A new one without a unit is found here, and not by who checks it."""
    hints = get_type_hints(PortResult, include_extras=True)
    flags = {name for name, hint in hints.items() if bool in (hint, *get_args(hint))}
    for name in set(hints) - TEXTS - flags:
        parts = next((get_type_hints(of) for of in (hints[name], *get_args(hints[name])) if is_typeddict(of)), {})
        for path in [f"{name}.{part}" for part in parts] or [name]:
            assert row_of(ACCOUNT, path).title, path
    assert set(get_type_hints(TruthResult)) == set(TRUTH)


@pytest.mark.parametrize("name", TABLES)
def test_a_row_has_a_unit_that_can_be_read_and_a_colour_that_is_no_alarm(name: str) -> None:
    for row in TABLES[name].values():
        for motion in ("m", "rad"):
            parse_unit(row.unit_on(motion).replace("(N*m)", "N/m") or "1")
        assert row.title
        assert row.colour != ALARM


def test_titles_of_one_table_differ() -> None:
    for rows in TABLES.values():
        titles = [row.title for row in rows.values()]
        assert {title for title in titles if titles.count(title) > 1} == set()


def is_title(node: ast.expr) -> bool:
    """Whether an expression is a title, a part of one, or one that a method has made of it."""
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
        return node.func.attr in GETTERS or (node.func.attr in dir(str) and is_title(node.func.value))
    if isinstance(node, ast.Subscript):
        return (isinstance(node.slice, ast.Constant) and node.slice.value in TITLES) or (
            isinstance(node.value, ast.Attribute) and is_title(node.value)
        )
    return isinstance(node, ast.Attribute) and node.attr in TITLES


def read_titles(source: str) -> Iterator[str]:
    for node in ast.walk(ast.parse(source)):
        match node:
            case ast.Call(func=ast.Attribute(attr=name, value=of)) if name in READING and is_title(of):
                yield ast.unparse(node)
            case ast.Call(func=ast.Attribute(attr=name), args=given) if name in SEARCHING and any(map(is_title, given)):
                yield ast.unparse(node)
            case ast.Compare() if any(map(is_title, (node.left, *node.comparators))):
                if not isinstance(node.comparators[0], ast.Constant) or node.comparators[0].value is not None:
                    yield ast.unparse(node)
            case ast.Subscript(slice=key) if is_title(key):
                yield ast.unparse(node)
            case ast.Match(subject=of) if is_title(of):
                yield ast.unparse(node)


@pytest.mark.slow
def test_nothing_computes_from_a_title() -> None:
    """A title can be worded anew, and no unit, colour or comparison changes with it."""
    found = {}
    for path in PACKAGE.rglob("*.py"):
        source = path.read_text(encoding="utf-8")
        if SUSPECT.search(source) and (read := list(read_titles(source))):
            found[path.relative_to(PACKAGE).as_posix()] = read
    assert {path: read for path, read in found.items() if path not in NO_TITLES} == {}
    assert set(NO_TITLES) <= set(found)


@pytest.mark.parametrize("known", [
    'hint.what.startswith("stiffness")', 'panel.get_title() == "x"', 'row["label"] in names', 'row.title[0] == "s"',
    'hint.what.lower().strip() == "x"', "NAMES[row.title]", "NAMES.get(row.title)", 're.match("x", hint.text)',
    '"x" in row.sentence', "row.title.index(' ')",
])  # fmt: skip
def test_what_computes_from_a_title_is_found(known: str) -> None:
    assert SUSPECT.search(known)
    assert list(read_titles(known)) != []


def test_a_figure_is_found_by_its_name_and_by_that_of_an_earlier_release() -> None:
    contact = with_old_names({"requested": 3.0, "sent": 1.0})
    assert contact == {"requested": 3.0, "sent": 1.0, "asked": 3.0}
    port = {"unit": "rad", "contact": contact, "mass": {"felt": 2.0}, **with_old_names({"uncertainty": 0.5})}
    result = {"ports": {"knob": port}, "truth": {"knob": with_old_names({"accounted_error": 0.1})}}
    for expression, unit in (
        ("contact.requested == 3 N*m", "N*m"), ("contact.asked == 3 N*m", "N*m"), ("mass.felt < 3 kg*m^2", "kg*m^2"),
        ("knob.uncertainty == 500 mJ", "J"), ("unsure == 500 mJ", "J"), ("believed_error < 1 J", "J"),
    ):  # fmt: skip
        assert [(of["holds"], of["unit"]) for of in check(result, expression)] == [(True, unit)], expression
    assert set(OLD_KEYS) <= {name.rpartition(".")[2] for name in (*ACCOUNT, *TRUTH)} | {"requested"}
