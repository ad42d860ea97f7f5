"""`inspect --html`: one file with linked panels that any browser opens without a network; drawn by Bokeh.

Bokeh is imported when a report is written, not before. Colours are those of Okabe and Ito, as in the pictures.
"""

import html
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from canhaptic.audit.extent import rows_between, rows_to_draw
from canhaptic.control.verdict import PortResult
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.signals import CycleTiming
from canhaptic.view.decimate import decimate
from canhaptic.view.html_page import require_bokeh, write_page
from canhaptic.view.series import PortSeries, losses
from canhaptic.view.si import si
from canhaptic.view.task_plane import task_plane
from canhaptic.view.verdict_bar import verdict_bar

if TYPE_CHECKING:
    from bokeh.plotting import figure

    from canhaptic.audit.inspection import Inspection
    from canhaptic.view.html_panels import Panels

_BUCKETS: Final = 1000
_LINK_POINTS: Final = 4000
_S_PER_NS: Final = 1e-9
_STYLE: Final = (
    "<style>body{font-family:system-ui,sans-serif;margin:12px 18px;color:#222}"
    "table.account td,table.account th{padding:1px 14px 1px 0;text-align:right}"
    "table.account th:first-child,table.account td:first-child{text-align:left}</style>"
)


def write_html(
    log: EnergyLog,
    path: Path,
    result: "Inspection",
    start: float | None = None,
    stop: float | None = None,
    others: Sequence[EnergyLog] = (),
) -> None:
    """Writes a run as one self-contained page.

    Args:
        log: An open energy log.
        path: The page.
        result: What `inspect` returned for the same rows.
        start: Time of the first SYNC to draw [s]; from the beginning by default.
        stop: Time of the first SYNC not to draw [s]; to the end by default.
        others: Further runs, drawn over the first in thin dashed lines.

    Raises:
        InputError: The log holds no cycle there, Bokeh is not installed, or the page cannot be written.
    """
    rows = rows_to_draw(log, start, stop)
    require_bokeh()
    from canhaptic.view.html_panels import Panels

    panels = Panels(result["from"], result["to"])
    further = [(other, rows_between(other, start, stop)) for other in others if other.rows]
    tabs = []
    for name in sorted(log.ports, key=lambda name: name not in log.groups):  # groups first: they have the account
        over = {one.path.name: PortSeries(one, name, of_one) for one, of_one in further if name in one.ports}
        tabs.append(panels.port(PortSeries(log, name, rows), over, task_plane(log, name, rows)))
    common = [_timing(log, rows, panels), _link(log, rows, panels)]
    heading = _heading(log, result, others, panels.empty)
    page = panels.page(heading, tabs, [panel for panel in common if panel is not None])
    write_page(page, f"{log.path.name} - canhaptic", path)


def _timing(log: EnergyLog, rows: slice, panels: "Panels") -> "figure | None":
    parts = {name: log.timing.read(name, rows.start, rows.stop) * _S_PER_NS for name in CycleTiming._fields}
    if not any(values.any() for values in parts.values()):
        return None  # in lock-step virtual time does not advance within a cycle
    shown = np.unique(np.concatenate([decimate(values, _BUCKETS) for values in parts.values()]))
    time = log.deadlines(rows.start, rows.stop)[shown] * log.sample_time
    columns = {name: values[shown].astype(np.float32) for name, values in parts.items()}
    return panels.timing({"time": time, **columns}, log.sample_time)


def _link(log: EnergyLog, rows: slice, panels: "Panels") -> "figure | None":
    """What was lost, summed; no panel where nothing was."""
    lost = {name: np.cumsum(values) for name, values in losses(log, rows.start, rows.stop).items()}
    if not any(total[-1] for total in lost.values()):
        panels.empty.append("lost")
        return None
    picks = [np.array([0, rows.stop - rows.start - 1])]
    for total in lost.values():
        changes = np.flatnonzero(np.diff(total, prepend=0))
        picks.append(changes[:: max(1, len(changes) // _LINK_POINTS)])
    shown = np.unique(np.concatenate(picks))
    time = log.deadlines(rows.start, rows.stop)[shown] * log.sample_time
    return panels.link({"time": time} | {name: total[shown].astype(np.float32) for name, total in lost.items()})


def _heading(log: EnergyLog, result: "Inspection", others: Sequence[EnergyLog], empty: Sequence[str]) -> str:
    facts = [
        f"<b>{html.escape(log.path.name)}</b>",
        html.escape(str(result["status"])),
        f"{result['cycles']} cycles at {si(result['rate'], 'Hz', 3)}",
        f"configuration {result['config_hash'][:12]}",
        f"TPDOs received {100.0 * result['link']['success_rate']:.6g} %",
        f"over it, dashed: <b>{html.escape(', '.join(one.path.name for one in others))}</b>" if others else "",
    ]
    rows = [f"<tr><th>port</th>{''.join(f'<th>{title}</th>' for title in _ACCOUNT)}</tr>"]
    for name, port in result["ports"].items():
        cells = "".join(f"<td>{_cell(value, port)}</td>" for value in _ACCOUNT.values())
        rows.append(f"<tr><td><b>{html.escape(name)}</b></td>{cells}</tr>")
    line = " &nbsp; ".join(fact for fact in facts if fact)
    left_out = f"<p>zero throughout, not drawn: {html.escape(', '.join(empty))}</p>" if empty else ""
    return (
        f"{_STYLE}<p>{line}</p>{verdict_bar(result['ports'])}<table class='account'>{''.join(rows)}</table>{left_out}"
    )


def _cell(value: Callable[[PortResult], float], port: PortResult) -> str:
    try:
        return si(value(port), "J")
    except KeyError:  # an axis in a group: its account is the group's
        return "-"


_ACCOUNT: Final[dict[str, Callable[[PortResult], float]]] = {
    "in": lambda port: port["in"],
    "out": lambda port: port["out"],
    "dissipated": lambda port: port["dissipated"],
    "stored at end": lambda port: port["stored"],
    "surplus, most": lambda port: port["surplus"]["max"],
    "deficit": lambda port: port["deficit"],
    "least margin": lambda port: port["margin"]["value"],
    "least interaction": lambda port: port["least_interaction"],
}
