"""Contents of a sweep file, as plain values and as tables for a terminal.

Shares, extremes and medians of the completed scenes of a sweep, block by block: memory does not grow with them.
"""

import math
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray
from rich.console import Group, RenderableType
from rich.text import Text

from canhaptic.control.verdict import PASSIVE_TOLERANCE
from canhaptic.lab.loop.axis_loop import Array
from canhaptic.lab.studies import Row
from canhaptic.lab.studies.sweep.chunk import COMPLETED
from canhaptic.lab.studies.sweep.sweep_table import SweepTable
from canhaptic.lab.studies.sweep.vary import CONTROLLER
from canhaptic.view.si import si
from canhaptic.view.table import Table

_BLOCK: Final = 65_536
"""Rows looked at together."""
_DIGIT: Final = 16
"""Bits of a number that one look at the column settles."""
_SIGN: Final = np.uint64(1 << 63)


class Selected:
    """The completed scenes of one axis under one algorithm.

    Args:
        table: File of the sweep.
        axis: Name of the axis.
        controller: Number of the algorithm among the texts of its key; None for all scenes.
    """

    def __init__(self, table: SweepTable, axis: str, controller: int | None = None) -> None:
        self.table, self._axis, self._controller = table, axis, controller

    def count(self) -> int:
        """Return the number of scenes."""
        return sum(int(rows.sum()) for _, _, rows in self._blocks())

    def share(self, metric: str, holds: Callable[[Array], NDArray[np.bool_]], *, finite: bool = False) -> float | None:
        """Return the share of the scenes whose figure passes; None where there are none.

        Args:
            metric: Name of the figure.
            holds: Function from an array of figures to an array of truth values.
            finite: Whether only finite figures count.
        """
        true = count = 0
        for values in self._columns(metric, finite=finite):
            true, count = true + int(holds(values).sum()), count + len(values)
        return true / count if count else None

    def least(self, metric: str) -> float | None:
        """Return the least finite figure; None where there is none."""
        return min((float(values.min()) for values in self._columns(metric, finite=True) if len(values)), default=None)

    def median(self, metric: str) -> float | None:
        """Return the median of the finite figures; for an even number, the mean of the middle two."""
        count = sum(len(values) for values in self._columns(metric, finite=True))
        if not count:
            return None
        low, high = (self._ranked(metric, rank) for rank in ((count - 1) // 2, count // 2))
        return low if low == high else math.fsum((0.5 * low, 0.5 * high))

    def _ranked(self, metric: str, rank: int) -> float:
        """Return the finite figure that `rank` others come before: its bits from the first to the last, in turns."""
        known = np.uint64(0)
        for settled in range(0, 64, _DIGIT):
            left = np.uint64(64 - settled - _DIGIT)
            counts = np.zeros(1 << _DIGIT, dtype=np.int64)
            for values in self._columns(metric, finite=True):
                ordered = _ordered(values)
                if settled:
                    ordered = ordered[ordered >> np.uint64(64 - settled) == known]
                digit = (ordered >> left) & np.uint64((1 << _DIGIT) - 1)
                counts += np.bincount(digit.astype(np.int64), minlength=1 << _DIGIT)
            before = np.cumsum(counts)
            chosen = int(np.searchsorted(before, rank, side="right"))
            rank -= int(before[chosen] - counts[chosen])
            known = (known << np.uint64(_DIGIT)) | np.uint64(chosen)
        bits = known ^ _SIGN if known & _SIGN else ~known
        return float(np.array([bits], dtype=np.uint64).view(np.float64)[0])

    def _columns(self, metric: str, *, finite: bool = False) -> Iterator[Array]:
        for start, stop, rows in self._blocks():
            values = self.table.figure(self._axis, metric, start, stop)[rows]
            yield values[np.isfinite(values)] if finite else values

    def _blocks(self) -> Iterator[tuple[int, int, NDArray[np.bool_]]]:
        for start in range(0, len(self.table), _BLOCK):
            stop = min(len(self.table), start + _BLOCK)
            rows = np.asarray(self.table.status(start, stop) == COMPLETED)
            if self._controller is not None:
                rows &= self.table.numbers(CONTROLLER, start, stop) == self._controller
            yield start, stop, rows


def _ordered(values: Array) -> NDArray[np.uint64]:
    """Return whole numbers in the order of the values: the bits of a float, those of negative ones inverted."""
    bits = np.ascontiguousarray(values).view(np.uint64)
    return np.where(bits & _SIGN, ~bits, bits | _SIGN)


_MOST_REMARKS: Final = 20


def summary(table: SweepTable) -> Row:
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


def _figures(table: SweepTable, axis: str) -> Row:
    """Return shares and medians over the completed scenes, per algorithm."""
    if CONTROLLER not in table.keys:
        return {"of the scene": _shares(Selected(table, axis))}
    return {name: _shares(Selected(table, axis, index)) for index, name in enumerate(table.texts(CONTROLLER))}


def _shares(selected: Selected) -> Row:
    asked = set(selected.table.metrics)
    found: Row = {"scenes": selected.count()}
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


def summary_report(found: Row) -> RenderableType:
    """Return tables of a summary."""
    heading = Text(" ")
    heading.append(found["scene"], style="bold")
    heading.append(f"   {found['finished']} of {found['scenes']} scenes   {'  '.join(found['varied'])}")
    parts: list[RenderableType] = [heading, _counts(found), _shares_table(found)]
    return Group(*parts)


def _counts(found: Row) -> RenderableType:
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


def _shares_table(found: Row) -> Table:
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
