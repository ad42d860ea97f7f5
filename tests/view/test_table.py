"""One table as every output: terminal, Markdown, HTML, CSV and JSON."""

import csv
import io
import json
import math
from html.parser import HTMLParser

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from canhaptic.view.table import Styled, Table, in_lines

WORDS = st.text(st.characters(codec="utf-8", exclude_categories=("C", "Z")), max_size=12)
CELLS = st.one_of(WORDS, st.integers(-9999, 9999), st.none(), st.builds(Styled, WORDS, st.just("bold red")))


@st.composite
def tables(draw: st.DrawFn) -> Table:
    width = draw(st.integers(1, 5))
    heads = draw(st.lists(WORDS.filter(bool), min_size=width, max_size=width, unique=True))
    rows = draw(st.lists(st.lists(CELLS, min_size=width, max_size=width), max_size=4))
    return Table(draw(WORDS), heads, rows, keys=draw(st.one_of(st.none(), st.integers(0, 2))))


def shown(cell: object) -> str:
    return cell.text if isinstance(cell, Styled) else "" if cell is None else str(cell)


def printed(table: Table, width: int) -> str:
    stream = io.StringIO()
    Console(file=stream, width=width, highlight=False).print(table)
    return stream.getvalue()


class Cells(HTMLParser):
    """Texts of the cells of a page, row by row."""

    def __init__(self) -> None:
        super().__init__()
        self.rows: list[list[str]] = []
        self._inside = False

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self._inside = True
            self.rows[-1].append("")

    def handle_endtag(self, tag: str) -> None:
        self._inside = self._inside and tag not in ("td", "th")

    def handle_data(self, data: str) -> None:
        if self._inside:
            self.rows[-1][-1] += data


@given(tables())
def test_html_and_csv_hold_every_cell_whatever_its_letters(table: Table) -> None:
    whole = [list(table.columns), *([shown(cell) for cell in row] for row in table.rows)]
    page = Cells()
    page.feed(table.html())
    assert page.rows == whole
    assert list(csv.reader(io.StringIO(table.csv()))) == whole


@given(tables())
def test_a_record_has_the_plain_value_of_every_column(table: Table) -> None:
    for row, record in zip(table.rows, json.loads(table.json()), strict=True):
        assert list(record) == list(table.columns)
        assert list(record.values()) == [cell.text if isinstance(cell, Styled) else cell for cell in row]


def test_what_is_no_finite_number_is_null_and_blank_for_programs_and_named_for_people() -> None:
    table = Table("", ("a", "b"), [[math.nan, math.inf]])
    assert json.loads(table.json()) == [{"a": None, "b": None}]
    assert table.csv() == "a,b\n,\n"
    assert '<td class="key">-</td><td class="key">inf</td>' in table.html()


@given(tables())
def test_markdown_has_one_line_a_row_and_as_many_cells_as_columns(table: Table) -> None:
    lines = [line for line in table.markdown().splitlines() if line.startswith("|")]
    assert len(lines) == 2 + len(table.rows)
    assert {line.replace("\\|", "").count("|") for line in lines} == {1 + len(table.columns)}


def test_markdown_keeps_a_title_as_heading_and_bold_cells_bold() -> None:
    table = Table(" of one wall", ("force", "us per\nstep"), [[Styled("2 N", "bold green"), "a|b"]])
    assert table.markdown() == "### of one wall\n\n| force | us per step |\n|---|---|\n| **2 N** | a\\|b |\n"


def test_a_row_of_another_length_is_refused_with_its_place() -> None:
    with pytest.raises(ValueError, match="walls: row 1 has 1 cells, expected 2"):
        Table("walls", ("a", "b"), [["1", "2"], ["3"]])


def test_an_empty_row_is_a_line_on_a_terminal_alone() -> None:
    table = Table("", ("what", "value"), [["in", 1.0], [], ["out", 0.123456]], keys=1)
    assert len(printed(table, 80).splitlines()) == 3 + 4
    assert table.html().count("<tr>") == 3
    assert table.csv() == "what,value\nin,1.0\nout,0.123456\n"
    assert "0.1235" in printed(table, 80)  # four digits for people, all of them for programs


def test_units_in_headings_and_brackets_in_cells_are_no_markup() -> None:
    text = printed(Table("[bold]", ("a way of [m]", "felt from [m/s]"), [["[red]1", "2"]]), 60)
    for words in ("[bold]", "a way of [m]", "felt from [m/s]", "[red]1"):
        assert words in text


@pytest.mark.parametrize("width", [20, 40, 100])
def test_figures_go_on_in_a_further_table_with_the_keys_and_are_not_folded(width: int) -> None:
    heads = ["name", *(f"quantity{number}" for number in range(9))]
    text = printed(Table("many", heads, [["axis1", *(f"{number}.125 mJ" for number in range(9))]], keys=1), width)
    assert max(map(len, text.splitlines())) <= width
    assert text.count("axis1") == text.count("name") == {20: 9, 40: 3, 100: 1}[width]
    assert all(f"{number}.125 mJ" in text for number in range(9))
    assert text.count("many") == 1


def test_words_are_folded_and_none_is_lost() -> None:
    text = printed(Table("", ("key", "why"), [["a", "one two three four five six seven"]]), 24)
    assert max(map(len, text.splitlines())) <= 24
    assert {"one", "four", "seven"} <= set(text.split())


@pytest.mark.parametrize(
    ("text", "lines"),
    [
        ("ports/handle/effort_asked", ["ports/handle/effort_", "asked"]),
        ("short", ["short"]),
        ("a" * 30, ["a" * 24, "a" * 6]),
        ("", []),
    ],
)
def test_a_long_name_is_broken_behind_a_separator_where_it_has_one(text: str, lines: list[str]) -> None:
    assert in_lines(text, 24).splitlines() == lines


@given(WORDS, st.integers(1, 20))
def test_a_broken_name_keeps_every_letter_and_the_width(text: str, width: int) -> None:
    lines = in_lines(text, width).split("\n")
    assert "".join(lines) == text
    assert all(len(line) <= width for line in lines)


def test_keys_stay_in_one_piece_beside_text_that_folds() -> None:
    rows = [["passivity.device_friction_bound", "0.00128 N*m", "must not be below the real value of dry friction " * 3]]
    out = io.StringIO()
    Console(file=out, width=80).print(Table("to set", ("key", "guess", "what belongs there"), rows))
    lines = out.getvalue().splitlines()
    assert sum("passivity.device_friction_bound" in line for line in lines) == 1
    assert max(map(len, lines)) <= 80
    narrow = io.StringIO()
    Console(file=narrow, width=30).print(Table("to set", ("key", "guess", "what belongs there"), rows))
    assert max(map(len, narrow.getvalue().splitlines())) <= 30


def test_a_row_of_dashes_is_left_out_of_the_table_in_which_it_says_nothing() -> None:
    rows = [["in", "1 J", "2 J"], ["stored", "3 J", "-"]]
    first, second = printed(Table("", ["account", "a" * 12, "b" * 12], rows, keys=1), 24).split("b" * 12)
    assert "stored" in first
    assert "stored" not in second
    assert "in " in second
