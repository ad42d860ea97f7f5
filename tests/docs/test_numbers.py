"""Measured numbers in the pages are those of the committed results, and a mark that points at nothing is refused."""

import json
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from canhaptic.errors import InputError
from tests.docs.documents import ROOT, pages
from tools import fill_numbers
from tools.fill_numbers import filled, value_at, written

CYCLE = json.loads((ROOT / "docs" / "results" / "cycle.json").read_text(encoding="utf-8"))["rows"]


def test_the_numbers_of_the_pages_are_those_of_the_results() -> None:
    texts = {page: page.read_text(encoding="utf-8") for page in fill_numbers.pages()}
    stale = [page.name for page, text in texts.items() if filled(text, page.name) != text]
    assert stale == [], "run: python -m tools.fill_numbers"


def test_no_line_of_a_page_begins_with_a_mark() -> None:
    lines = [(page.name, line) for page in fill_numbers.pages() for line in page.read_text("utf-8").splitlines()]
    assert [(name, line) for name, line in lines if line.startswith("<!--n ")] == [], "it would end the paragraph there"


def test_the_tool_looks_at_the_pages_that_the_tests_look_at_and_at_the_costs_of_effects() -> None:
    assert fill_numbers.pages() == [*pages(), ROOT / "canhaptic" / "sim" / "plant" / "effects" / "README.md"]


def test_a_stale_number_is_replaced_and_nothing_else() -> None:
    mark = "<!--n cycle#one axis, full stack, best of 7#value @ .0f-->"
    text = f"# It is\n\n`{mark}1<!--/n-->` and {mark}1<!--/n--> a second\n\n```\n{mark}1<!--/n-->\n```\n"
    expected = text.replace(f" {mark}1<", f" {mark}{CYCLE[0]['value']:.0f}<")
    assert filled(text, "page.md") == expected != text


@pytest.fixture
def results(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A tree with one result of known numbers."""
    folder = tmp_path / "docs" / "results"
    folder.mkdir(parents=True)
    rows = [
        {"row": "cycle, p99", "value": 12.0, "peer": "a", "ratio": 2.0},
        {"row": "cycle, p99", "value": 12.0, "peer": "b", "ratio": 0.5},
        {"row": "page with --html", "value": 0.000123456, "peer": "", "ratio": None},
    ]
    (folder / "demo.json").write_text(json.dumps({"machine": {"cores": "2"}, "part": {"n": 7}, "rows": rows}))
    monkeypatch.setattr(fill_numbers, "ROOT", tmp_path)
    fill_numbers._result.cache_clear()
    yield
    fill_numbers._result.cache_clear()


@pytest.mark.usefixtures("results")
@pytest.mark.parametrize(
    ("mark", "shown"),
    [
        ("demo#cycle, p99#value", "12"),
        ("demo#cycle, p99#value @ .2f", "12.00"),
        ("demo#cycle, p99~b#ratio @ %", "50 %"),
        ("demo#*html#value @ s", "123 us"),
        ("demo#*html#value @ .1e", "1.2e-04"),
        ("demo#machine#cores", "2"),
        ("demo#part#n", "7"),
    ],
)
def test_a_number_is_written_as_its_mark_says(mark: str, shown: str) -> None:
    assert written(mark) == shown


@pytest.mark.usefixtures("results")
@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("<!--n nothing#a-->1<!--/n-->", "page.md:1: no result nothing.json"),
        ("\n<!--n demo#none#value-->1<!--/n-->", "page.md:2: demo#none#value: nothing is called 'none'"),
        ("<!--n demo#cycle, p99#ratio-->1<!--/n-->", "2 rows have this name and differ in it"),
        ("<!--n demo#part-->1<!--/n-->", "expected a number or a text"),
        ("<!--n demo#*html#ratio-->1<!--/n-->", "expected a number or a text"),
        ("<!--n demo#page with --html#value-->1<!--/n-->", "has -- in it"),
        ("<!--n demo#part#n-->7 and no end", "half a mark"),
        ("<!--n demo#part#n-->7 <!--n demo#part#n-->7<!--/n-->", "not closed"),
    ],
)
def test_a_mark_that_points_at_nothing_or_is_open_is_refused(text: str, said: str) -> None:
    with pytest.raises(InputError, match=re.escape(said)):
        filled(text, "page.md")


def test_large_numbers_of_results_are_written_without_exponent() -> None:
    assert written("cycle#one axis, full stack, best of 7#value") == f"{round(CYCLE[0]['value'], -2):.0f}"
    assert value_at("cycle#full stack / canopen#ratio") == CYCLE[2]["ratio"]
