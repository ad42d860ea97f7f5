"""Tables of the rows of a study: each column has a heading, a key of the rows, and the kind of its values."""

import math
from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple

from canhaptic.axis_units import damping_unit, effort_unit, mass_unit, si
from canhaptic.lab.studies import Row
from canhaptic.view.table import Cell, Styled, Table


class Column(NamedTuple):
    """A column of a table."""

    head: str
    key: str  # of the rows
    kind: str = ""  # see `shown`


def shown(value: Any, kind: str, motion: str) -> str:
    """Return a value as text with its unit.

    Args:
        value: Value of a row.
        kind: Unit of the value on a linear axis, "%" for a share, or a format of Python such as ".3g".
        motion: Unit of the motion of the axis, m or rad.
    """
    return _SHOWN[kind](value, motion) if kind in _SHOWN else format(value, kind)


_SHOWN: Final[dict[str, Callable[[Any, str], str]]] = {
    "m": lambda value, motion: si(value, motion, 3) if motion == "m" else f"{1e3 * value:.3g} mrad",
    "N": lambda value, motion: si(value, effort_unit(motion), 3),
    "N*s/m": lambda value, motion: f"{value:.3g} {damping_unit(motion)}",
    "kg": lambda value, motion: "-" if math.isnan(value) else si(value, mass_unit(motion), 3),
    "J": lambda value, _: si(value, "J", 3),
    "s": lambda value, _: si(value, "s", 3),
    "us": lambda value, _: si(1e-6 * value, "s", 3),
    "%": lambda value, _: f"{100.0 * value:.3g} %",
    "+%": lambda value, _: f"+{100.0 * value:.0f} %",
}


def texts_of(columns: Sequence[Column], row: Row, motion: str) -> list[str]:
    """Return the cells of a row; a value that it lacks is empty."""
    values = ((column, row.get(column.key)) for column in columns)
    return ["" if value is None else shown(value, column.kind, motion) for column, value in values]


def columns_in(columns: Sequence[Column], rows: Sequence[Row]) -> list[Column]:
    """Return the columns of which at least one row has a value."""
    return [column for column in columns if any(row.get(column.key) is not None for row in rows)]


def table_of(
    title: str, columns: Sequence[Column], rows: Sequence[Row], motion: str, keys: int, bold: str = ""
) -> Table:
    """Return a table of rows; columns without a value are left out.

    Args:
        title: Title of the table.
        columns: Its columns.
        rows: Its rows.
        motion: Unit of the motion of the axis, m or rad.
        keys: Number of leading columns that name a row.
        bold: Key of the rows whose name is bold if they have it.
    """
    known = columns_in(columns, rows)
    cells: list[list[Cell]] = []
    for row in rows:
        texts, style = texts_of(known, row, motion), "bold" if row.get(bold) else ""
        cells.append([*(Styled(text, style) for text in texts[:keys]), *texts[keys:]])
    return Table(title, [column.head for column in known], cells, keys=keys)
