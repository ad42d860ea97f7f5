"""Panels of `scope` for what buzzes: a lane of states over the shown time, and the spectrum of the same time."""

from typing import Any, Final

import numpy as np
from bokeh.models import ColumnDataSource, FactorRange, HoverTool, Range
from bokeh.plotting import figure

from canhaptic.audit.why.ripple import spectrum
from canhaptic.logs.hdf5 import Array
from canhaptic.view.picture_style import BLUE
from canhaptic.view.series import News
from canhaptic.view.state_lanes import LANES, codes_of, spans

_KEPT: Final = ("applied", "command", "branch", "certificate")
_LOOKS: Final = 5
"""Looks between two spectra, and between two drawings of the lanes: one a second."""


class StatePanels:
    """Lane of states and spectrum of an axis, of the rows in the shown time.

    Args:
        name: Name of the axis.
        limit: Largest torque [N or N*m].
        unit: Unit of the torque.
        time: Time range of the page.
        period: Sample time [s].
        panel: An empty panel over time, for the spectrum over frequency.
    """

    def __init__(self, name: str, limit: float, unit: str, time: Range, period: float, panel: figure) -> None:
        self._limit, self._period, self._looks = limit, period, 0
        self._rows: dict[str, Array] = {key: np.zeros(0) for key in ("time", *_KEPT)}
        self._lanes = ColumnDataSource({key: [] for key in ("lane", "left", "right", "state", "colour")})
        self._lines = ColumnDataSource({"frequency": [], "amplitude": []})
        lanes = figure(
            x_range=time, y_range=FactorRange(*LANES[::-1]), height=140, sizing_mode="stretch_width", tools="",
            min_border_left=90, min_border_right=40, name=f"{name}: states", output_backend="canvas",
        )  # fmt: skip
        bars = lanes.hbar(
            y="lane", left="left", right="right", height=0.8, color="colour", line_alpha=0, source=self._lanes,
            name="states",
        )  # fmt: skip
        lanes.add_tools(HoverTool(renderers=[bars], tooltips=[("@lane", "@state"), ("from", "@left{0.0000} s")]))
        lanes.toolbar.logo, lanes.yaxis.axis_label = None, f"{name}: states"
        panel.line("frequency", "amplitude", source=self._lines, color=BLUE, name="spectrum")
        panel.add_tools(HoverTool(tooltips=[("", "@frequency{0.0} Hz"), (unit, "@amplitude")], mode="vline"))
        self.panels: dict[str, figure] = {"states": lanes, "spectrum": panel}

    def take(self, news: News, rows: dict[str, Array], window: float) -> None:
        """Keep the new rows; once a second draw those of the last `window` [s]."""
        new: dict[str, Any] = {"time": news.time, **{key: rows[key] for key in _KEPT}}
        kept = {key: np.concatenate([self._rows[key], values]) for key, values in new.items()}
        shown = kept["time"] >= kept["time"][-1] - window
        self._rows = {key: values[shown] for key, values in kept.items()}
        self._looks += 1
        if self._looks % _LOOKS == 1:
            self._draw()

    def _draw(self) -> None:
        time, applied, command, branch, certificate = (self._rows[key] for key in ("time", *_KEPT))
        gaps = np.rint(np.diff(time, prepend=time[0] - self._period) / self._period)
        codes = codes_of(branch.astype(int), certificate.astype(int), command, self._limit, gaps)
        found = spans(time, self._period, codes)
        self._lanes.data = {
            "lane": [span.lane for span in found],
            "left": [span.start for span in found],
            "right": [span.end for span in found],
            "state": [span.state for span in found],
            "colour": [span.colour for span in found],
        }
        lines, sizes = spectrum(self._period, applied)
        self._lines.data = {"frequency": lines[1:], "amplitude": sizes[1:]}
