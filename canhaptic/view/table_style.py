"""The look of tables on a terminal; no cell of any of them is ever cropped."""

from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import replace
from typing import Any

from rich import box
from rich.console import Console, ConsoleOptions, RenderableType, RenderResult
from rich.markup import escape
from rich.measure import Measurement
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from canhaptic.view.terminal import visible

_ENDLESS = 100_000  # columns, to measure what a table would take


class SafeConsole(Console):
    """A console that shows every text with `visible`; its own colours and styles go through."""

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterator[Segment]:
        """Yields the parts of what is shown."""
        for segment in super().render(renderable, options):
            yield segment if segment.control else Segment(visible(segment.text), segment.style)


def plain_table(title: str, *columns: str) -> Table:
    """Returns an empty table of words with a title above and a line under its heads; long cells are folded."""
    table = Table(title=escape(title), title_justify="left", title_style="bold", box=box.SIMPLE_HEAD)
    for column in columns:
        table.add_column(column, overflow="fold")
    return table


def in_lines(text: str, width: int) -> str:
    """Returns a text in lines of at most `width` letters, broken wherever that is."""
    return "\n".join(text[at : at + width] for at in range(0, len(text), width))


class FigureTable(Table):
    """A table of figures, which are not folded: where its columns do not fit, it becomes several tables.

    Each of them begins with the key columns. Only a column that does not fit next to the keys alone is folded.

    Args:
        keys: Columns at the left that say what a row is.
        options: Options of `rich.table.Table`.
    """

    def __init__(self, *, keys: int = 1, **options: Any) -> None:
        super().__init__(box=box.SIMPLE_HEAD, title_justify="left", title_style="bold", **options)
        self._keys = keys

    def add_column(self, header: RenderableType = "", footer: RenderableType = "", **options: Any) -> None:
        """Adds a column; a unit in its heading, such as [m/s], is no markup."""
        super().add_column(Text(header) if isinstance(header, str) else header, footer, **options)

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Renders one table, or several below each other."""
        for number, indices in enumerate(self._parts(console, options)):
            part = self._part(indices)
            part.title = None if number else self.title
            if _width(part, console, options) > options.max_width:
                part.columns = [replace(column, no_wrap=False, overflow="fold") for column in part.columns]
            yield from Table.__rich_console__(part, console, options)

    def _parts(self, console: Console, options: ConsoleOptions) -> Iterator[list[int]]:
        """Yields the columns of each table."""
        keys = list(range(min(self._keys, len(self.columns))))
        taken = list(keys)
        for index in range(len(keys), len(self.columns)):
            if len(taken) > len(keys) and _width(self._part([*taken, index]), console, options) > options.max_width:
                yield taken
                taken = list(keys)
            taken.append(index)
        yield taken

    def _part(self, indices: Sequence[int]) -> Table:
        part = copy(self)
        part.columns = [replace(self.columns[index], _index=place) for place, index in enumerate(indices)]
        return part


def _width(table: Table, console: Console, options: ConsoleOptions) -> int:
    """Returns how many columns of text a table would take if it could."""
    return Measurement.get(console, options.update(width=_ENDLESS), table).maximum
