"""Table of every command, printed on a terminal or as Markdown, HTML, CSV or JSON; no cell is ever cropped."""

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

_ROOM: Final = 14  # columns for text of several words


class Styled(NamedTuple):
    """A cell with a style."""

    text: str
    style: str = ""  # words of rich, such as "bold red"; the classes of the cell in HTML


Cell = str | int | float | Styled | None
"""Value of a cell: a float is shown with four digits, NaN as a dash, None as an empty cell."""


@dataclass(frozen=True)
class Table:
    """Rows under a title and headings.

    Args:
        title: Title above the table; "" for none.
        columns: Headings; line breaks are kept on a terminal only.
        rows: Rows with one cell per column; an empty row draws a line on a terminal.
        keys: Number of leading columns that name a row. The other columns are figures, aligned right and not folded:
            if they do not fit, a terminal shows several tables with the same keys. None: every column is text.

    Raises:
        ValueError: The number of cells of a row is not the number of columns.
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
        """Return a JSON list with one object per row and headings as keys; numbers that are not finite become null."""
        return json.dumps([dict(zip(self._heads(), row, strict=True)) for row in self._plain()], allow_nan=False)

    def csv(self) -> str:
        """Return headings and rows as CSV, with all digits of the numbers."""
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows([self._heads(), *self._plain()])
        return text.getvalue()

    def _heads(self) -> list[str]:
        return [" ".join(head.split()) for head in self.columns]

    def _plain(self) -> list[list[str | int | float | None]]:
        return [[_plain(cell) for cell in row] for row in self.rows if row]

    def markdown(self) -> str:
        """Return title and table as Markdown; bold cells stay bold."""
        lines = [f"### {self.title.strip()}", ""] if self.title else []
        lines += [_markdown_row([*map(Styled, self._heads())])]
        lines += ["|" + "---|" * len(self.columns), *(_markdown_row(row) for row in map(_styled, self.rows) if row)]
        return "\n".join(lines) + "\n"

    def html(self) -> str:
        """Return a `<table>`; the style of a cell becomes its classes, with `key` in the columns that name a row."""
        heads = "".join(self._html_cell("th", index, Styled(head)) for index, head in enumerate(self._heads()))
        cells = ("".join(self._html_cell("td", *cell) for cell in enumerate(_styled(row))) for row in self.rows if row)
        rows = "".join(f"<tr>{row}</tr>" for row in cells)
        title = f"<caption>{html.escape(self.title.strip())}</caption>" if self.title else ""
        return f"<table>{title}<thead><tr>{heads}</tr></thead><tbody>{rows}</tbody></table>"

    def _html_cell(self, kind: str, index: int, cell: Styled) -> str:
        classes = f"{'key ' if self.keys is None or index < self.keys else ''}{cell.style}".strip()
        return f'<{kind} class="{classes}">{html.escape(cell.text)}</{kind}>'

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Render one table, or several if the columns do not fit the width."""

        def fits(indices: Sequence[int], space: int) -> bool:
            table = self._drawn(indices, space)
            return Measurement.get(console, options.update(width=_ENDLESS), table).maximum <= options.max_width

        every = range(len(self.columns))
        space = 0 if self.keys is not None and not fits(every, 1) and fits(every, 0) else 1
        parts = [every] if self.keys is None else self._parts(self.keys, lambda some: fits(some, space))
        for number, indices in enumerate(parts):
            fold = self.keys is None or not fits(indices, space)
            whole = self._words(options.max_width) if fold else []
            yield self._drawn(indices, space, "" if number else self.title, fold=fold, whole=whole)

    def _parts(self, named: int, fits: Callable[[Sequence[int]], bool]) -> Iterator[Sequence[int]]:
        """Yield the column indices of each table."""
        keys = list(range(min(named, len(self.columns))))
        taken = list(keys)
        for index in range(len(keys), len(self.columns)):
            if len(taken) > len(keys) and not fits([*taken, index]):
                yield taken
                taken = list(keys)
            taken.append(index)
        yield taken

    def _words(self, width: int) -> list[int]:
        """Return the columns of single words, such as keys, if these fit unbroken and leave room for the others."""
        rows = filter(None, map(_styled, self.rows))
        texts = [[Styled(head), *cells] for head, *cells in zip(self.columns, *rows, strict=True)]
        found = [n for n, cells in enumerate(texts) if not any(" " in cell.text.strip() for cell in cells)]
        taken = sum(max(len(cell.text) for cell in texts[n]) for n in found)
        return found if taken + _ROOM * (len(texts) - len(found)) + 2 * len(texts) <= width else []

    def _drawn(
        self, indices: Sequence[int], space: int, title: str = "", *, fold: bool = False, whole: Sequence[int] = ()
    ) -> TerminalTable:
        drawn = TerminalTable(
            title=Text(title) if title else None, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD,
            pad_edge=self.keys is None, padding=(0, space, 0, space if self.keys is None else 0),
        )  # fmt: skip
        for index in indices:
            side: Literal["left", "right"] = "left" if self.keys is None or index < self.keys else "right"
            is_whole = not fold or index in whole
            drawn.add_column(Text(self.columns[index]), justify=side, no_wrap=is_whole, overflow="fold")
        rows = list(map(_styled, self.rows))
        named = {*range(self.keys or 0)}
        said = [{at for at, cell in enumerate(row) if cell.text.strip() != "-"} - named for row in rows]
        is_told = any(not here.isdisjoint(indices) for here in said)
        for row, here in zip(rows, said, strict=True):
            if is_told and here and here.isdisjoint(indices):
                continue  # the row belongs to another part
            if row:
                drawn.add_row(*(Text(row[index].text, row[index].style) for index in indices))
            else:
                drawn.add_section()
        return drawn


def in_lines(text: str, width: int) -> str:
    """Break a text into lines of at most `width` characters, after a separator if possible."""
    return "\n".join(re.findall(rf".{{1,{width}}}(?:(?<=[/_.\s-])|$)|.{{1,{width}}}", text))


def _plain(cell: Cell) -> str | int | float | None:
    if isinstance(cell, Styled):
        return cell.text
    return None if isinstance(cell, float) and not math.isfinite(cell) else cell


def _styled(row: Sequence[Cell]) -> list[Styled]:
    return [cell if isinstance(cell, Styled) else Styled(shown(cell)) for cell in row]


def shown(cell: str | int | float | None) -> str:
    """Return the text of a cell."""
    if isinstance(cell, float):
        return "-" if math.isnan(cell) else f"{cell:.4g}"
    return "" if cell is None else str(cell)


def _markdown_row(row: Sequence[Styled]) -> str:
    cells = (cell.text.strip().replace("|", "\\|").replace("\n", " ") for cell in row)
    marked = (f"**{text}**" if text and "bold" in cell.style else text for text, cell in zip(cells, row, strict=True))
    return "| " + " | ".join(marked) + " |"
