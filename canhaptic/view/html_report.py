"""`inspect --html`: one file with linked panels that any browser opens without a network; drawn by Bokeh.

Bokeh is imported when a report is written, not before. Colours are those of Okabe and Ito, as in the pictures.
"""

import html
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from canhaptic.audit.extent import rows_between, rows_to_draw
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.signals import CycleTiming
from canhaptic.view.decimate import decimate
from canhaptic.view.html_page import require_bokeh, write_page
from canhaptic.view.series import PortSeries
from canhaptic.view.si import si

if TYPE_CHECKING:
    from canhaptic.view.html_panels import Panels

_BUCKETS: Final = 1000
_LINK_POINTS: Final = 4000
_NS_PER_US: Final = 1000.0
_STYLE: Final = (
    "<style>body{font-family:system-ui,sans-serif;margin:12px 18px;color:#222}"
    "table.account td,table.account th{padding:1px 14px 1px 0;text-align:right}"
    "table.account th:first-child,table.account td:first-child{text-align:left}</style>"
)


def write_html(
    log: EnergyLog,
    path: Path,
    result: dict[str, Any],
    start: float | None = None,
    stop: float | None = None,
    other: EnergyLog | None = None,
) -> None:
    """Writes a run as one self-contained page.

    Args:
        log: An open energy log.
        path: The page.
        result: What `inspect` returned for the same rows.
        start: Time of the first SYNC to draw [s]; from the beginning by default.
        stop: Time of the first SYNC not to draw [s]; to the end by default.
        other: A second run, drawn over the first in thin dashed lines.

    Raises:
        InputError: The log holds no cycle there, Bokeh is not installed, or the page cannot be written.
    """
    rows = rows_to_draw(log, start, stop)
    require_bokeh()
    from canhaptic.view.html_panels import Panels

    panels = Panels(float(result["from"]), float(result["to"]))
    further = rows_between(other, start, stop) if other is not None and other.rows else None
    tabs = []
    for name in log.ports:
        second = PortSeries(other, name, further) if other and further and name in other.ports else None
        wall = log.attributes.get(f"{name}.wall_position")
        tabs.append(panels.port(PortSeries(log, name, rows), second, wall))
    common = [_timing(log, rows, panels), _link(log, rows, panels)]
    page = panels.page(_heading(log, result, other), tabs, [panel for panel in common if panel is not None])
    write_page(page, f"{log.path.name} - canhaptic", path)


def _timing(log: EnergyLog, rows: slice, panels: "Panels") -> Any:
    parts = {name: log.timing.read(name, rows.start, rows.stop) / _NS_PER_US for name in CycleTiming._fields}
    if not any(values.any() for values in parts.values()):
        return None  # in lock-step virtual time stands still within a cycle
    shown = np.unique(np.concatenate([decimate(values, _BUCKETS) for values in parts.values()]))
    time = log.timing["sync_index"][rows][shown] * log.sample_time
    columns = {name: values[shown].astype(np.float32) for name, values in parts.items()}
    return panels.timing({"time": time, **columns}, log.sample_time_ns / _NS_PER_US)


def _link(log: EnergyLog, rows: slice, panels: "Panels") -> Any:
    """Missed TPDOs and dropped cycles, summed: a flat line at zero is a good link."""
    lost = {
        f"{name}: TPDOs missed": np.cumsum(port.read("fresh", rows.start, rows.stop) == 0)
        for name, port in log.ports.items()
        if name not in log.groups
    }
    lost["cycles not in the log"] = np.cumsum(log.timing.read("dropped_before", rows.start, rows.stop), dtype=np.int64)
    count = rows.stop - rows.start
    picks = [np.array([0, count - 1])]
    for total in lost.values():
        changes = np.flatnonzero(np.diff(total, prepend=0))
        picks.append(changes[:: max(1, len(changes) // _LINK_POINTS)])
    shown = np.unique(np.concatenate(picks))
    time = log.timing["sync_index"][rows][shown] * log.sample_time
    return panels.link({"time": time} | {name: total[shown].astype(np.float32) for name, total in lost.items()})


def _heading(log: EnergyLog, result: dict[str, Any], other: EnergyLog | None) -> str:
    facts = [
        f"<b>{html.escape(log.path.name)}</b>",
        html.escape(str(result["status"])),
        f"{result['cycles']} cycles at {si(result['rate'], 'Hz', 3)}",
        f"configuration {result['config_hash'][:12]}",
        f"link {100.0 * result['link']['success_rate']:.6g} %" if "success_rate" in result["link"] else "",
        f"over it, dashed: <b>{html.escape(other.path.name)}</b>" if other is not None else "",
    ]
    rows = [f"<tr><th>port</th>{''.join(f'<th>{title}</th>' for title in _ACCOUNT)}</tr>"]
    for name, port in result["ports"].items():
        cells = "".join(f"<td>{_cell(value, port)}</td>" for value in _ACCOUNT.values())
        rows.append(f"<tr><td><b>{html.escape(name)}</b></td>{cells}</tr>")
    line = " &nbsp; ".join(fact for fact in facts if fact)
    return f"{_STYLE}<p>{line}</p><table class='account'>{''.join(rows)}</table>"


def _cell(value: Callable[[dict[str, Any]], float], port: dict[str, Any]) -> str:
    try:
        return si(value(port), "J")
    except KeyError:  # an axis in a group: its account is the group's
        return "-"


_ACCOUNT: Final[dict[str, Any]] = {
    "in": lambda port: port["in"],
    "out": lambda port: port["out"],
    "dissipated": lambda port: port["dissipated"],
    "stored at end": lambda port: port["stored"],
    "surplus, most": lambda port: port["surplus"]["max"],
    "deficit": lambda port: port["deficit"],
    "least margin": lambda port: port["margin"]["value"],
    "least interaction": lambda port: port["least_interaction"],
}
