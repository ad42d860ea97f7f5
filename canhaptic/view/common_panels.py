"""The panels that all ports of a page share: durations within the cycle, and what was lost."""

from typing import Final

from bokeh.models import ColumnDataSource, DataRange1d, Range, Span
from bokeh.plotting import figure

from canhaptic.view.bokeh_style import add_hover, finished, new_panel
from canhaptic.view.palette import BLUE, GREEN, GREY, ORANGE, PURPLE, VERMILION

_TIMING_COLOURS: Final = (BLUE, GREEN, VERMILION, PURPLE)


def timing_panel(time: Range, source: ColumnDataSource, period: float) -> figure:
    """Return the panel of durations within the cycle.

    Args:
        time: The range that all panels share.
        source: Columns time and, for each duration, its name [s].
        period: Drawn across the panel [s].
    """
    panel = new_panel("timing", "s", time, 150)
    names = [name for name in source.data if name != "time"]
    for name, colour in zip(names, _TIMING_COLOURS, strict=True):
        label = name.replace("_", " ")
        panel.line("time", name, source=source, color=colour, line_width=1.0, legend_label=label, name=name)
    panel.add_layout(Span(location=period, dimension="width", line_color=GREY, line_dash="dashed"))
    add_hover(panel, names[0], {name.replace("_", " "): (name, "s") for name in names})
    return finished(panel)


def link_panel(time: Range, source: ColumnDataSource) -> figure:
    """Return the panel of what was lost, summed; every change is a row of `source`, so that its stairs are true."""
    panel = new_panel("lost", "", time, 130)
    panel.y_range = DataRange1d(start=-0.05, min_interval=1.0)
    names = [name for name in source.data if name != "time"]
    colours = (BLUE, VERMILION, GREEN, ORANGE, PURPLE, GREY)
    for number, name in enumerate(names):
        colour = colours[number % len(colours)]
        panel.step("time", name, source=source, mode="after", color=colour, legend_label=name, name=name)
    add_hover(panel, names[0], {name: (name, "") for name in names})
    return finished(panel)
