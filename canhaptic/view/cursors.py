"""Two cursors over all panels of a port: drag one, and the line below says the values at both and their difference."""

from collections.abc import Mapping, Sequence
from typing import Final

from bokeh.models import ColumnDataSource, CustomJS, Div, Span
from bokeh.plotting import figure

from canhaptic.view.palette import PURPLE, SKY
from canhaptic.view.si import prefixes_of

_READ: Final = """
const times = source.data.time, at = (t) => {
  let low = 0, high = times.length - 1;
  while (low < high) { const middle = (low + high) >> 1; if (times[middle] < t) low = middle + 1; else high = middle; }
  return low;
};
const [a, b] = [at(first.location), at(second.location)];
const shown = (value, name) => {
  if (!isFinite(value)) return "-";
  if (value == 0) return `0 ${units[name]}`;
  const of = prefixes[name], [scale, prefix] = of.find(([s]) => Math.abs(value) >= s * (1 - 1e-9)) ?? of.at(-1);
  return `${(value / scale).toPrecision(5)} ${prefix}${units[name]}`;
};
const rows = names.filter(name => name in source.data).map(name => {
  const [x, y] = [source.data[name][a], source.data[name][b]];
  return `<tr><th style="text-align:left">${name}</th><td>${shown(x, name)}</td><td>${shown(y, name)}</td>`
       + `<td>${shown(y - x, name)}</td></tr>`;
});
readout.text = `<table class="cursors" style="border-spacing:14px 0"><tr><th></th><th>cursor 1, solid</th>`
             + `<th>cursor 2, dashed</th><th>difference</th></tr>${rows.join("")}</table>`;
"""
_NAMES: Final = ("time", "position", "command", "applied", "taken_in", "dissipated", "margin", "surplus", "damping")


def add_cursors(
    panels: Sequence[figure], source: ColumnDataSource, units: Mapping[str, str], whole: tuple[float, float]
) -> Div:
    """Adds two cursors to panels over time and returns the line that reads them.

    Args:
        panels: Panels that share one time axis.
        source: Columns of the port, ascending in time.
        units: SI unit of each column.
        whole: First and last time [s]; the cursors begin at a third and at two thirds.
    """
    start, stop = whole
    places = (start + (stop - start) / 3.0, start + 2.0 * (stop - start) / 3.0)
    cursors = [
        Span(
            location=place, dimension="height", line_color=colour, line_dash=dash, line_width=2, editable=True,
            name=f"cursor {number}",
        )
        for number, (place, colour, dash) in enumerate(zip(places, (PURPLE, SKY), ("solid", "dashed"), strict=True), 1)
    ]  # fmt: skip
    readout = Div(text="drag the two upright lines to read values and differences", name="cursors")
    known = {name: units[name] for name in _NAMES if name in units}
    arguments = {
        "first": cursors[0],
        "second": cursors[1],
        "source": source,
        "readout": readout,
        "names": list(known),
        "units": known,
        "prefixes": {name: prefixes_of(unit) for name, unit in known.items()},
    }
    for cursor in cursors:
        cursor.js_on_change("location", CustomJS(args=arguments, code=_READ))
        for panel in panels:
            panel.add_layout(cursor)
    return readout
