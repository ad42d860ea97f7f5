"""The look of tables on a terminal."""

from rich import box
from rich.markup import escape
from rich.table import Table


def plain_table(title: str, *columns: str) -> Table:
    """Returns an empty table with a title above and a line under its heads."""
    table = Table(title=escape(title), title_justify="left", title_style="bold", box=box.SIMPLE_HEAD)
    for column in columns:
        table.add_column(column, overflow="fold")
    return table
