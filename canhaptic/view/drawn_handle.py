"""Handles on live pages: along a line, as a knob, or in a plane with the links of a five-bar; and what they may touch.

Each is drawn from a data source with one row: the place `x`, `y` of the handle, and of a five-bar its links as lines.
"""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from bokeh.models import BasicTicker, ColumnDataSource, CustomJS, CustomJSTickFormatter, Range1d
from bokeh.plotting import figure

from canhaptic.axis_units import prefixes_of
from canhaptic.logs.hdf5 import Array
from canhaptic.view.picture_style import GREY, PALE

MIDDLE: Final = "#808080"  # grey that is seen on light and dark pages
WIDE: Final[dict[str, Any]] = {"sizing_mode": "stretch_width", "min_border_left": 90, "min_border_right": 40}
MATERIAL: Final[dict[str, Any]] = {"fill_color": MIDDLE, "fill_alpha": 0.3, "line_color": MIDDLE, "level": "underlay"}
Span = tuple[float, float]
SI_VALUE: Final = """
const of_axis = typeof ticks != "undefined", shown = of_axis ? ticks : [value];  // else at the pointer
const largest = Math.max(...shown.map(Math.abs));
if (!isFinite(largest)) return "-";
if (largest == 0) return `0 ${unit}`;
const [scale, prefix] = prefixes.find(([scale]) => largest >= scale * (1 - 1e-9)) ?? prefixes.at(-1);
if (!of_axis) return `${(value / scale).toPrecision(5)} ${prefix}${unit}`;
const step = ticks.length > 1 ? Math.abs(ticks[1] - ticks[0]) : largest;
const digits = Math.min(12, Math.max(0, Math.ceil(-Math.log10(step / scale) - 1e-9)));
return `${(tick / scale).toFixed(digits)} ${prefix}${unit}`;
"""
_EQUAL: Final = """
const [[left, right], [bottom, top]] = plane.tags, {inner_width: width, inner_height: height} = plane;
const scale = Math.max((right - left) / width, (top - bottom) / height);
const moved = Math.abs((left + right - scale * width) / 2 - plane.x_range.start);
const grown = Math.abs((bottom + top - scale * height) / 2 - plane.y_range.start);
if (moved + grown < 0.02 * (right - left)) return;  // ticks of another width would change the width again
plane.x_range.setv({start: (left + right - scale * width) / 2, end: (left + right + scale * width) / 2});
plane.y_range.setv({start: (bottom + top - scale * height) / 2, end: (bottom + top + scale * height) / 2});
"""


def si_ticks(unit: str) -> CustomJSTickFormatter:
    """Return a formatter for the ticks of an axis; the largest tick decides on the SI prefix of all."""
    return CustomJSTickFormatter(args={"prefixes": prefixes_of(unit), "unit": unit}, code=SI_VALUE)


def _empty(across: Span, along: Span, **look: Any) -> figure:
    ranges: Any = {"x_range": Range1d(*across), "y_range": Range1d(*along), "tools": "", "toolbar_location": None}
    return figure(output_backend="canvas", **ranges, **look)


def new_plane(
    source: ColumnDataSource, colour: str, across: Span, along: Span, links: Sequence[float] = (), *, unit: str,
    equal: bool = True, **look: Any,
) -> figure:  # fmt: skip
    """Return a drawing without tools of a handle in a plane, or on a line of it; material goes below it.

    Args:
        source: Data source of the handle; the hand is drawn where it has `hand_x`.
        colour: Colour of the handle.
        across: Range within which it moves from left to right [unit].
        along: The same from bottom to top [unit].
        links: Links of a five-bar, as of `five_bar`; drawn with their motors, for which the ranges have room.
        unit: SI unit of the axes.
        equal: Whether both directions have one scale, at any width; `tags` of the figure are then the two ranges.
        look: Further properties of the figure.
    """
    ranges = reach_of(links, across, along)
    plane = _empty(ranges[0], ranges[1], **WIDE, **look)
    plane.xaxis.ticker = BasicTicker(desired_num_ticks=4)
    plane.xaxis.formatter = plane.yaxis.formatter = si_ticks(unit)
    if equal:
        plane.tags = list(ranges)
        for changed in ("inner_width", "inner_height", "tags"):
            plane.js_on_change(changed, CustomJS(args={"plane": plane}, code=_EQUAL))
    if links:
        plane.multi_line("link_x", "link_y", source=source, line_color=MIDDLE, line_width=5, line_cap="round")
        plane.scatter([-links[0], links[0]], [0.0, 0.0], size=14, color=MIDDLE)
    if "hand_x" in source.data:
        plane.segment("x", "y", "hand_x", "hand_y", line_color=PALE, line_width=3, source=source)
        plane.scatter("hand_x", "hand_y", marker="cross", size=22, line_color=GREY, line_width=2, source=source)
    plane.scatter("x", "y", size=22, fill_color=colour, line_color="white", source=source)
    return plane


def new_knob(
    source: ColumnDataSource, colour: str, name: str, solid: Sequence[Span], notches: Sequence[float], size: int = 170
) -> figure:
    """Return a knob as a disc, which turns by the angle `x` of its source, with walls and notches at its rim.

    Args:
        source: Data source of the handle; the hand is drawn where it has `hand_x`.
        colour: Colour of the knob.
        name: Name of the drawing.
        solid: Walls, each from one angle to another [rad].
        notches: Angles of detents [rad].
        size: Width and height [pixels].
    """
    look: Any = {"width": size, "height": size, "align": "center", "min_border": 0, "frame_align": False}
    disc = _empty((-1.4, 1.4), (-1.4, 1.4), name=name, **look)
    disc.axis.visible, disc.grid.visible, disc.outline_line_alpha = False, False, 0.0
    for low, high in solid:
        edge = min(high, low + 6.28)
        disc.annular_wedge(0, 0, 1.05, 1.35, low, edge, fill_color=MIDDLE, fill_alpha=0.4, line_alpha=0)
    if len(notches):
        disc.ray(np.cos(notches), np.sin(notches), length=0.25, angle=notches, line_color=MIDDLE, line_width=2)
    disc.circle(0, 0, radius=1.0, fill_color=colour, fill_alpha=0.25, line_color=colour)
    if "hand_x" in source.data:
        disc.ray(0, 0, length=1.0, angle="hand_x", source=source, line_color=PALE, line_width=3)
    disc.ray(0, 0, length=1.0, angle="x", source=source, line_color=colour, line_width=6)
    return disc


def five_bar(
    links: Sequence[float] = (), angles: Sequence[float] = (), place: Sequence[float] = ()
) -> dict[str, list[list[float]]]:
    """Return the links of a five-bar as columns of its source; without links, empty lines.

    Args:
        links: Half the distance of the motors, and the length of the left and right proximal link [m].
        angles: Angles of the left and the right motor [rad].
        place: Place of the handle [m].
    """
    if not links:
        return {"link_x": [[]], "link_y": [[]]}
    half, left, right = links[0], links[1], links[-1]
    (first, second), (x, y) = angles, place
    across = [-half, left * np.cos(first) - half, x, right * np.cos(second) + half, half]
    up = [0.0, left * np.sin(first), y, right * np.sin(second), 0.0]
    return {"link_x": [list(map(float, across))], "link_y": [list(map(float, up))]}


def reach_of(links: Sequence[float], across: Span, along: Span) -> tuple[Span, Span]:
    """Return the ranges in which a handle that moves within others, and the links that carry it, are seen."""
    if not links:
        return across, along
    wide, low = links[0] + max(links[1:]), -0.2 * max(links[1:])
    return (min(across[0], -wide), max(across[1], wide)), (min(along[0], low), max(along[1], 1.2 * max(links[1:])))


def shade_of(inside: Array) -> Array:
    """Return the pixels of a shaded region, shape (n, m) of 32-bit RGBA, from where it is, shape (n, m)."""
    return np.where(inside, np.uint32(0x4D808080), np.uint32(0)).astype(np.uint32)
