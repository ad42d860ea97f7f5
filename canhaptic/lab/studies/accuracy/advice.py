"""From the ladder to advice: the Pareto front, the cheapest setting within a tolerance, what each effect is worth.

All choices rest on errors and evaluations, which are the same in every run; times only sort the effects.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

from canhaptic.lab.studies.accuracy.accuracy_choice import LEAST_ORDER
from canhaptic.lab.studies.accuracy.accuracy_table import Row
from canhaptic.lab.studies.accuracy.candidates import OURS

_CLOCK: Final = 0.05
"""Time per period below which a saving is not distinguished from zero [us]."""


def meets(row: Row, tolerance: float) -> bool:
    """Whether the position of a row keeps the tolerance [m or rad]."""
    return row["status"] == "ok" and float(row["position_error"]) <= tolerance


def cheapest(rows: Sequence[Row], tolerance: float) -> Row | None:
    """Return the row with the fewest evaluations that keeps the tolerance; of equals the more exact."""
    good = [row for row in rows if meets(row, tolerance)]
    return min(good, key=lambda row: (row["evaluations"], row["position_error"]), default=None)


def pareto(rows: Sequence[Row], price: str, floor: float) -> list[bool]:
    """Return for each row whether no other is both cheaper and at least as exact.

    Args:
        rows: Rows of the ladder.
        price: Key of what they cost.
        floor: Error of the position below which all are equal [m or rad].
    """
    points = [
        (max(row["position_error"], floor), row[price])
        if row["status"] == "ok" and row.get(price) is not None
        else None
        for row in rows
    ]
    best = front([point for point in points if point is not None])
    return [point in best for point in points]


def front(points: Sequence[tuple[float, float]]) -> set[tuple[float, float]]:
    """Return the points of which no other is as small in both and smaller in one."""
    return {(x, y) for x, y in set(points) if not any(a <= x and b <= y and (a < x or b < y) for a, b in points)}


def advice(rows: Sequence[Row], effects: Sequence[Row], tolerance: float, orders: Sequence[Row] = ()) -> dict[str, Any]:
    """Return what to write into the scene, and on what grounds.

    Args:
        rows: Rows of the ladder.
        effects: Rows of the scene's effects, each left out in turn.
        tolerance: Tolerance of the position [m or rad].
        orders: Orders of the methods, declared and fitted.
    """
    ours = [row for row in rows if row["method"] == OURS]
    doubt = next((_doubt(row) for row in orders if row["method"] == OURS), "")
    lasting = [row for row in ours if meets(row, tolerance) and _lasts(row, ours, tolerance)]
    chosen = None if doubt else cheapest(lasting, tolerance)
    cheaper = [
        {"method": row["method"], "setting": row["setting"], "evaluations": row["evaluations"]}
        for row in rows
        if row["method"] != OURS and meets(row, tolerance) and chosen and row["evaluations"] < chosen["evaluations"]
    ]
    best = min(
        (row for row in ours if row["status"] == "ok"), key=lambda row: float(row["position_error"]), default=None
    )
    return {
        "tolerance": tolerance,
        "chosen": chosen and dict(chosen),
        "line": chosen and line(chosen["accuracy"]),
        "doubt": doubt,
        "most_exact": best and dict(best),
        "cheaper_elsewhere": sorted(cheaper, key=lambda row: int(row["evaluations"])),
        "effects": [dict(row) for row in sorted(effects, key=_worth, reverse=True)],
    }


def _doubt(row: Row) -> str:
    if row["fitted"] is None or row["declared"] is None or row["fitted"] >= LEAST_ORDER * row["declared"]:
        return ""
    return (
        f"errors fall with an order of {row['fitted']:.2g} in the substep where {row['declared']} is declared, so that "
        "none of them tells what another scene or a longer run would show; raise the rate, or give finer substeps"
    )


def _lasts(row: Row, ours: Sequence[Row], tolerance: float) -> bool:
    """Whether every finer setting keeps the tolerance too: errors of events and substeps may cancel by luck."""
    own = row["accuracy"]
    finer = [other for other in ours if all(other["accuracy"][key] >= own[key] for key in own)]
    return all(meets(other, tolerance) for other in finer)


def line(accuracy: Mapping[str, int]) -> str:
    """Return the line that sets an accuracy in a scene."""
    return "accuracy: {" + ", ".join(f"{key}: {value}" for key, value in accuracy.items()) + "}"


def _worth(row: Row) -> float:
    worth = row.get("error_per_microsecond")
    return -1.0 if worth is None else float(worth)


def error_per_microsecond(error: float, saved: float | None) -> float | None:
    """Return the error that leaving an effect out causes for each microsecond that it saves.

    Args:
        error: Error of the position [m or rad].
        saved: Per period [us]; None where it was not measured. What the clock does not tell from none counts as that.
    """
    return None if saved is None else error / max(saved, _CLOCK)


def rank_agreement(one: Sequence[float], other: Sequence[float]) -> float | None:
    """Return Spearman's rank correlation; None for fewer than three pairs."""
    count = len(one)
    if count < 3:
        return None
    a, b = _ranks(one), _ranks(other)
    mean = 0.5 * (count - 1)
    top = sum((x - mean) * (y - mean) for x, y in zip(a, b, strict=True))
    size = math.sqrt(sum((x - mean) ** 2 for x in a) * sum((y - mean) ** 2 for y in b))
    return top / size if size else None


def _ranks(values: Sequence[float]) -> list[float]:
    """Return the rank of each value; equal values share the mean of theirs."""
    order = sorted(range(len(values)), key=values.__getitem__)
    ranks = [0.0] * len(values)
    start = 0
    while start < len(order):
        end = start
        while end + 1 < len(order) and values[order[end + 1]] == values[order[start]]:
            end += 1
        for place in range(start, end + 1):
            ranks[order[place]] = 0.5 * (start + end)
        start = end + 1
    return ranks
