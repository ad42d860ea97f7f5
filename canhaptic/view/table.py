"""One table for every command: on a terminal, as Markdown, HTML, CSV and JSON; no cell is ever cropped."""

import csv
import html
import io
import json
import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple

from rich import box
from rich.console import Console, ConsoleOptions, RenderResult
from rich.measure import Measurement
from rich.table import Table as TerminalTable
from rich.text import Text

_ENDLESS: Final = 100_000  # columns, to measure what a table would take


class Styled(NamedTuple):
    """A cell with a style."""

    text: str
    style: str = ""  # words of rich, such as "bold red"; the classes of the cell in HTML


Cell = str | int | float | Styled | None
"""A float is shown with four digits, NaN as a dash; None is an empty cell."""


@dataclass(frozen=True)
class Table:
    """Rows under a title and headings.

    Args:
        title: Title above the table; "" for none.
        columns: Headings; a line break is kept on a terminal only.
        rows: Rows with one cell per column; a row without cells draws a line on a terminal.
        keys: Number of leading columns that name a row; the others are figures, right-aligned and not
            folded: where they do not fit, a terminal shows several tables, each with the keys. None: all are words.

    Raises:
        ValueError: A row has another number of cells than there are columns.
    """

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    keys: int | None = None

    def __post_init__(self) -> None:
        for number, row in enumerate(self.rows):
            if row and len(row) != len(self.columns):
                raise ValueError(f"{self.title}: row {number} has {len(row)} cells, expected {len(self.columns)}")

    def json(self) -> str:
        """Return a list with one object per row, headings as keys; a number that is not finite is null."""
        return json.dumps([dict(zip(self._heads(), row, strict=True)) for row in self._plain()], allow_nan=False)

    def csv(self) -> str:
        """Return headings and rows separated by commas, numbers with all their digits."""
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows([self._heads(), *self._plain()])
        return text.getvalue()

    def _heads(self) -> list[str]:
        return [" ".join(head.split()) for head in self.columns]

    def _plain(self) -> list[list[str | int | float | None]]:
        return [[_plain(cell) for cell in row] for row in self.rows if row]

    def markdown(self) -> str:
        """Return heading and table for a page of documentation; a bold cell stays bold."""
        lines = [f"### {self.title.strip()}", ""] if self.title else []
        lines += [_markdown_row([*map(Styled, self._heads())])]
        lines += ["|" + "---|" * len(self.columns), *(_markdown_row(row) for row in map(_styled, self.rows) if row)]
        return "\n".join(lines) + "\n"

    def html(self) -> str:
        """Return a `<table>`; the classes of a cell are its style, and `key` where it names its row."""
        heads = "".join(self._html_cell("th", index, Styled(head)) for index, head in enumerate(self._heads()))
        cells = ("".join(self._html_cell("td", *cell) for cell in enumerate(_styled(row))) for row in self.rows if row)
        rows = "".join(f"<tr>{row}</tr>" for row in cells)
        title = f"<caption>{html.escape(self.title.strip())}</caption>" if self.title else ""
        return f"<table>{title}<thead><tr>{heads}</tr></thead><tbody>{rows}</tbody></table>"

    def _html_cell(self, kind: str, index: int, cell: Styled) -> str:
        classes = f"{'key ' if self.keys is None or index < self.keys else ''}{cell.style}".strip()
        return f'<{kind} class="{classes}">{html.escape(cell.text)}</{kind}>'

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Render one table, or several below each other."""

        def fits(indices: Sequence[int], space: int) -> bool:
            table = self._drawn(indices, space)
            return Measurement.get(console, options.update(width=_ENDLESS), table).maximum <= options.max_width

        every = range(len(self.columns))
        space = 0 if self.keys is not None and not fits(every, 1) and fits(every, 0) else 1
        parts = [every] if self.keys is None else self._parts(self.keys, lambda some: fits(some, space))
        for number, indices in enumerate(parts):
            fold = self.keys is None or not fits(indices, space)
            yield self._drawn(indices, space, "" if number else self.title, fold=fold)

    def _parts(self, named: int, fits: Callable[[Sequence[int]], bool]) -> Iterator[Sequence[int]]:
        """Yield the columns of each table."""
        keys = list(range(min(named, len(self.columns))))
        taken = list(keys)
        for index in range(len(keys), len(self.columns)):
            if len(taken) > len(keys) and not fits([*taken, index]):
                yield taken
                taken = list(keys)
            taken.append(index)
        yield taken

    def _drawn(self, indices: Sequence[int], space: int, title: str = "", *, fold: bool = False) -> TerminalTable:
        drawn = TerminalTable(
            title=Text(title) if title else None, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD,
            pad_edge=self.keys is None, padding=(0, space, 0, space if self.keys is None else 0),
        )  # fmt: skip
        for index in indices:
            side: Literal["left", "right"] = "left" if self.keys is None or index < self.keys else "right"
            drawn.add_column(Text(self.columns[index]), justify=side, no_wrap=not fold, overflow="fold")
        for row in map(_styled, self.rows):
            if row:
                drawn.add_row(*(Text(row[index].text, row[index].style) for index in indices))
            else:
                drawn.add_section()
        return drawn


def in_lines(text: str, width: int) -> str:
    """Return a text in lines of at most `width` characters, broken behind a separator where there is one."""
    return "\n".join(re.findall(rf".{{1,{width}}}(?:(?<=[/_.\s-])|$)|.{{1,{width}}}", text))


def _plain(cell: Cell) -> str | int | float | None:
    if isinstance(cell, Styled):
        return cell.text
    return None if isinstance(cell, float) and not math.isfinite(cell) else cell


def _styled(row: Sequence[Cell]) -> list[Styled]:
    return [cell if isinstance(cell, Styled) else Styled(shown(cell)) for cell in row]


def shown(cell: str | int | float | None) -> str:
    """Return the words of a cell without its style."""
    if isinstance(cell, float):
        return "-" if math.isnan(cell) else f"{cell:.4g}"
    return "" if cell is None else str(cell)


def _markdown_row(row: Sequence[Styled]) -> str:
    cells = (cell.text.strip().replace("|", "\\|").replace("\n", " ") for cell in row)
    marked = (f"**{text}**" if text and "bold" in cell.style else text for text, cell in zip(cells, row, strict=True))
    return "| " + " | ".join(marked) + " |"
