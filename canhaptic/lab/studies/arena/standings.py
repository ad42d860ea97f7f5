"""One row an algorithm: its figures over all cases, its rank in each, and who gives out energy where."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from canhaptic.control.verdict import PASSIVE_TOLERANCE
from canhaptic.lab.studies.arena.arena_cases import CaseFigures, rounded

AT_DAMPING: Final = 10.0
"""Whose borders are rows of a result [N*s/m]."""
Standing = dict[str, Any]
"""algorithm, cases, and one value a column of `COLUMNS`; None where there is nothing to measure."""


class Column(NamedTuple):
    """One figure of the table."""

    what: str
    unit: str
    value: Callable[[Sequence[CaseFigures]], float | None]
    is_ranked: bool = True  # whether less is better


def _count(cases: Iterable[CaseFigures], figure: str) -> float:
    return float(sum(case[figure] > PASSIVE_TOLERANCE for case in cases))


def _combined(
    figure: str, by: Callable[[Sequence[float]], Any] = np.median
) -> Callable[[Sequence[CaseFigures]], float | None]:
    """Return the function from cases to one number: a figure of those that were completed, combined."""

    def of(cases: Sequence[CaseFigures]) -> float | None:
        values = [case[figure] for case in cases if case["status"] == "completed" and case[figure] is not None]
        return rounded(float(by(values))) if values else None

    return of


def _most_given_out(cases: Sequence[CaseFigures]) -> float:
    return max((case["energy_given_out"] for case in cases if case["status"] == "completed"), default=0.0)


COLUMNS: Final[dict[str, Column]] = {
    "given_out": Column("cases that gave out more than 1 uJ", "1", lambda c: _count(c, "energy_given_out")),
    "beyond_device": Column(
        "cases that gave out more than 1 uJ beyond what the device takes", "1",
        lambda c: _count(c, "energy_beyond_device"),
    ),
    "most_given_out": Column("most energy given out, completed runs", "J", _most_given_out),
    "diverged": Column("runs that diverged", "1", lambda c: float(sum(case["status"] == "diverged" for case in c))),
    "position_error": Column("position error rms over travel, median", "1", _combined("position_error")),
    "force_variation": Column("force variation over the continuous one, median", "1", _combined("force_variation")),
    "stiffness_error": Column("stiffness rendered less 1, median size", "1", _combined("stiffness_error")),
    "limit_cycle": Column("limit cycle, mean", "m", _combined("limit_cycle", np.mean)),
    "rate_hardness": Column("rate-hardness over stiffness, median", "1", _combined("rate_hardness"), is_ranked=False),
    "drag": Column("drag in free motion, mean", "N", _combined("drag", np.mean)),
}  # fmt: skip
"""Key -> figure; in each that is ranked less is better."""


def standings(algorithms: Sequence[str], cases: Sequence[CaseFigures]) -> list[Standing]:
    """Return one row an algorithm.

    Args:
        algorithms: In the order of the rows.
        cases: Figures of the cases of all algorithms.
    """
    rows = []
    for name in algorithms:
        built = [case for case in cases if case["algorithm"] == name and case["status"] != "refused"]
        row: Standing = {"algorithm": name, "cases": len(built)}
        rows.append(row | {key: column.value(built) if built else None for key, column in COLUMNS.items()})
    return rows


def ranks(rows: Sequence[Standing]) -> dict[str, dict[str, int]]:
    """Return the rank of each algorithm in each ranked figure: one more than how many are better."""
    found: dict[str, dict[str, int]] = {row["algorithm"]: {} for row in rows}
    for key, column in COLUMNS.items():
        known = {row["algorithm"]: row[key] for row in rows if row[key] is not None}
        if column.is_ranked:
            for name, value in known.items():
                found[name][key] = 1 + sum(other < value for other in known.values())
    return found


def given_out(algorithms: Sequence[str], cases: Sequence[CaseFigures]) -> dict[str, dict[str, dict[str, float]]]:
    """Return who gives out energy where: algorithm -> scene -> number of cases beyond the device, and the most [J]."""
    found: dict[str, dict[str, dict[str, float]]] = {}
    for name in algorithms:
        of_scene: dict[str, list[float]] = {}
        for case in cases:
            if case["algorithm"] == name and case["status"] != "refused":
                of_scene.setdefault(case["scene"], []).append(case["energy_beyond_device"])
        found[name] = {
            scene: {"cases": float(sum(e > PASSIVE_TOLERANCE for e in energies)), "most": max(energies)}
            for scene, energies in of_scene.items()
        }
    return found


def result_rows(found: Mapping[str, Any]) -> list[tuple[str, float, str]]:
    """Return an arena as (name, value, unit), for a file of results."""
    rows = [
        (f"{row['algorithm']}: {column.what}", row[key], column.unit)
        for key, column in COLUMNS.items()
        for row in found["standings"]
        if row[key] is not None
    ]
    for name, places in found["ranks"].items():
        rows += [(f"rank of {name}: {COLUMNS[key].what}", float(rank), "1") for key, rank in places.items()]
    for border in (border for border in found.get("borders", ()) if border["damping"] == AT_DAMPING):
        late = ", one sample late" if border["delay"] else ""
        where = f"wall of {border['damping']:g} N*s/m{late}"
        rows += [
            (f"{border['algorithm']}: stiffest {word} {where}", border[key], "N/m")
            for key, word in (("passive", "passive"), ("near", "passive and near"))
        ]
    rows += [(f"{name}: time of a step", time, "us") for name, time in found.get("time_of_step", {}).items()]
    return rows
