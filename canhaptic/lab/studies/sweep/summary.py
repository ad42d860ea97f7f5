"""What the file of a sweep holds, as plain values and as tables for a terminal."""

from collections import Counter
from typing import Any, Final

import numpy as np
from rich.console import Group, RenderableType
from rich.text import Text

from canhaptic.control.verdict import PASSIVE_TOLERANCE
from canhaptic.lab.studies.sweep.points import CONTROLLER
from canhaptic.lab.studies.sweep.selected import Selected
from canhaptic.lab.studies.sweep.sweep_table import SweepTable
from canhaptic.view.si import si
from canhaptic.view.table import Table

_MOST_REMARKS: Final = 20

_Summary = dict[str, Any]


def summary(table: SweepTable) -> _Summary:
    """Return the account of a sweep as plain values: what `canhaptic sweep --json` prints."""
    done = table.done()
    counts: Counter[tuple[str, str, str]] = Counter()
    for status, engine, remark, number in table.remarks():
        counts[status, engine, remark] += number
    finished = sum(stop - start for start, stop in map(table.span, np.flatnonzero(done).tolist()))
    return {
        "file": str(table.path),
        "scene": table.note("source"),
        "varied": [varied["given"] for varied in table.identity["varied"]],
        "samples": table.identity["samples"],
        "scenes": len(table),
        "finished": finished,
        "status": _by(counts, 0),
        "engines": _by(counts, 1),
        "remarks": [
            {"status": status, "engine": engine, "remark": remark, "scenes": number}
            for (status, engine, remark), number in counts.most_common()
            if remark
        ][:_MOST_REMARKS],
        "figures": {axis: _figures(table, axis) for axis in table.axes},
    }


def _by(counts: Counter[tuple[str, str, str]], part: int) -> dict[str, int]:
    found: Counter[str] = Counter()
    for kind, number in counts.items():
        found[kind[part]] += number
    return dict(found)


def _figures(table: SweepTable, axis: str) -> dict[str, Any]:
    """Return shares and medians over the completed scenes, per algorithm."""
    if CONTROLLER not in table.keys:
        return {"of the scene": _shares(Selected(table, axis))}
    return {name: _shares(Selected(table, axis, index)) for index, name in enumerate(table.texts(CONTROLLER))}


def _shares(selected: Selected) -> dict[str, Any]:
    asked = set(selected.table.metrics)
    found: dict[str, Any] = {"scenes": selected.count()}
    if "least_interaction" in asked:
        found["passive"] = selected.share("least_interaction", lambda values: values >= -PASSIVE_TOLERANCE)
    if "margin" in asked:
        found["margin_kept"] = selected.share("margin", lambda values: values >= -PASSIVE_TOLERANCE)
        found["least_margin"] = selected.least("margin")
    if "diverged" in asked:
        found["diverged"] = selected.share("diverged", lambda values: values == 1.0)
    if "spectral_radius" in asked:
        found["stable"] = selected.share("spectral_radius", lambda values: values < 1.0, finite=True)
    if "stiffness_rendered.share" in asked:
        found["stiffness_rendered"] = selected.median("stiffness_rendered.share")
    if "mass_felt.share" in asked:
        found["mass_felt"] = selected.median("mass_felt.share")
    if "guard_acts" in asked:
        found["guard_acts"] = selected.median("guard_acts")
    return found


def summary_report(found: _Summary) -> RenderableType:
    """Return tables of a summary."""
    heading = Text(" ")
    heading.append(found["scene"], style="bold")
    heading.append(f"   {found['finished']} of {found['scenes']} scenes   {'  '.join(found['varied'])}")
    parts: list[RenderableType] = [heading, _counts(found), _shares_table(found)]
    return Group(*parts)


def _counts(found: _Summary) -> RenderableType:
    lines = [Text(f" computed by: {_listed(found['engines'])}"), Text(f" status:      {_listed(found['status'])}")]
    style = {"refused": "yellow", "failed": "red"}
    lines += [
        Text(
            f" {entry['scenes']} {entry['status']} ({entry['engine']}): {entry['remark']}",
            style.get(entry["status"], ""),
        )
        for entry in found["remarks"]
    ]
    return Group(*lines)


def _listed(counts: dict[str, int]) -> str:
    return ", ".join(f"{number} {name}" for name, number in counts.items()) or "nothing yet"


_COLUMNS: Final = {
    "passive": "true sum(h_i) >= 0",
    "margin_kept": "margin (4) kept",
    "least_margin": "least margin",
    "diverged": "diverged",
    "stable": "linear loop stable",
    "stiffness_rendered": "stiffness, median",
    "mass_felt": "mass felt, median",
    "guard_acts": "guard acts, median",
}


def _shares_table(found: _Summary) -> Table:
    entries = {(axis, name): entry for axis, of in found["figures"].items() for name, entry in of.items()}
    shown = [key for key in _COLUMNS if any(key in entry for entry in entries.values())]
    rows = [
        [f"{axis}, {name}", str(entry["scenes"]), *(_cell(key, entry.get(key)) for key in shown)]
        for (axis, name), entry in entries.items()
    ]
    return Table("", ["axis, algorithm", "scenes", *(_COLUMNS[key] for key in shown)], rows, keys=1)


def _cell(key: str, value: float | None) -> str:
    if value is None:
        return "-"
    return si(value, "J", 3) if key == "least_margin" else f"{100.0 * value:.3g} %"
