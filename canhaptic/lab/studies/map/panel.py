"""One panel of a map as plain values, with what a picture and a page of it have in common."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from canhaptic.lab.loop.axis_loop import Array
from canhaptic.view.palette import BLUE, GREEN, GREY, ORANGE, PURPLE, SKY, VERMILION

_COLOURS: Final = (BLUE, GREEN, PURPLE, ORANGE, SKY, VERMILION, GREY)
_BLACK: Final = ("ours", "abbott_okamura", "eigenvalues", "certificate")
_FEW: Final = 8
_LOG_SPAN: Final = 8.0
"""Ratio of largest and least value from which an axis is logarithmic."""
CurveStyle = Literal["measured", "ours", "colgate", "abbott_okamura", "eigenvalues", "certificate"]
"""What a line is of."""


@dataclass(frozen=True, slots=True)
class PanelCurve:
    """One line of a panel; lines of one level of a key share their number."""

    label: str
    x: Array
    y: Array
    style: CurveStyle
    number: int = 0

    @property
    def colour(self) -> str:
        """As #RRGGBB; what holds at every level is black, and so is the algorithm that is meant for a rig."""
        return "#000000" if self.style in _BLACK else _COLOURS[self.number % len(_COLOURS)]


@dataclass(frozen=True, slots=True)
class Lines:
    """A panel of lines; both axes positive where logarithmic."""

    title: str
    x_label: str
    y_label: str
    lines: tuple[PanelCurve, ...]
    x_log: bool
    y_log: bool
    note: str = ""

    def marks(self) -> list[float]:
        """Return the values to mark along a logarithmic x; none where they are many."""
        return _few(np.concatenate([line.x for line in self.lines] or [np.empty(0)])) if self.x_log else []

    def has_something(self) -> bool:
        """Whether there is something to see."""
        return True


@dataclass(frozen=True, slots=True)
class Cells:
    """A panel of coloured cells, or of dots where the scenes are no grid."""

    title: str
    x_label: str
    y_label: str
    x: Array  # of the columns, (nx,); of each dot, (n,)
    y: Array  # of the rows, (ny,); of each dot, (n,)
    values: Array  # (ny, nx), or (n,); NaN is blank
    value_label: str
    x_log: bool
    y_log: bool
    value_log: bool = False
    limits: tuple[float, float] | None = None
    contour: float | None = None
    dots: bool = False
    more_is_worse: bool = False

    def marks(self) -> list[float]:
        """Return the values to mark along a logarithmic x; none where they are many, or no columns."""
        return _few(self.x) if self.x_log and not self.dots else []

    def has_something(self) -> bool:
        """Whether there is something to see."""
        return bool(np.isfinite(self.values).any())

    def edges(self) -> tuple[Array, Array]:
        """Return the edges of the cells along x and y, shapes (nx + 1,) and (ny + 1,)."""
        return _edges_of(self.x, log=self.x_log), _edges_of(self.y, log=self.y_log)


Panel = Lines | Cells


def _few(values: Array) -> list[float]:
    found: list[float] = np.unique(values).tolist()
    return found if len(found) <= _FEW else []


def _edges_of(values: Array, *, log: bool) -> Array:
    """Return the edges of cells around sorted values, shape (n + 1,): halfway between neighbours."""
    scaled = np.log(values) if log else values
    if len(values) == 1:
        half = np.array([0.5 if log else 0.5 * max(abs(float(values[0])), 1.0)])
        edges = np.concatenate([scaled - half, scaled + half])
    else:
        middle = 0.5 * (scaled[1:] + scaled[:-1])
        edges = np.concatenate([[2.0 * scaled[0] - middle[0]], middle, [2.0 * scaled[-1] - middle[-1]]])
    return np.asarray(np.exp(edges) if log else edges)


def common_limits(panels: Sequence[Panel | None]) -> tuple[float, float]:
    """Return limits of the colours that fit every panel of cells in a row."""
    cells = [panel for panel in panels if isinstance(panel, Cells)]
    if not cells:
        return 0.0, 1.0
    if cells[0].limits is not None:
        return cells[0].limits
    known = np.concatenate([panel.values[np.isfinite(panel.values)].ravel() for panel in cells])
    if not len(known):
        return (1.0, 10.0) if cells[0].value_log else (0.0, 1.0)
    low, high = float(known.min()), float(known.max())
    if cells[0].value_log:
        return low, max(high, 10.0 * low)
    return low, high if high > low else low + 1.0


def is_log(values: Array) -> bool:
    """Return whether an axis of these values is logarithmic."""
    return bool(values.min() > 0.0 and values.max() / values.min() >= _LOG_SPAN)


def positive(values: Array) -> Array:
    """Return values for a logarithmic axis: NaN where there is no place for them."""
    return np.where(values > 0.0, values, np.nan)
