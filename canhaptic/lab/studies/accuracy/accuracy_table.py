"""A study of accuracy as tables, for a terminal and as Markdown for a page of documentation.

From the ladder to advice: the Pareto front, the cheapest setting within a tolerance, the cost of each effect.

All choices depend on errors and evaluations, which are equal in every run; times only sort the effects.
"""

import math
import textwrap
from collections.abc import Mapping, Sequence
from typing import Final

from rich.console import Group, RenderableType
from rich.text import Text

from canhaptic.axis_units import effort_unit
from canhaptic.control.verdict import PASSIVE_TOLERANCE
from canhaptic.lab.studies import Row
from canhaptic.lab.studies.accuracy.accuracy_choice import FLOOR, LEAST_ORDER
from canhaptic.lab.studies.accuracy.admittance_accuracy import display_accuracy_table, display_heading
from canhaptic.lab.studies.accuracy.plant_solvers import OURS
from canhaptic.view.si import si
from canhaptic.view.table import Cell, Styled, Table

PLANT_HEADS: Final = (
    "method", "setting", "position", "force", "energy", "evals /\nperiod", "events", "us /\nperiod", "times\nwork", "",
)  # fmt: skip
LOOP_HEADS: Final = (
    "changed", "to", "position", "force", "energy", "energy\nunsure", "control\nthread", "of T", "bus\nload",
)  # fmt: skip
EFFECT_HEADS: Final = (
    "left out", "order", "position", "force", "energy", "evals\nsaved", "us\nsaved", "error\nper us",
)  # fmt: skip

_WIDTH, _LABEL = 78, 15  # columns of a line, and of its label
_DOT, _KEPT = "\u00b7", "\u00a0"  # the last: a space at which no line ends
_GAP, _BETWEEN = "\t", f" {_DOT} "
_TIME_OF: Final = ("evaluations", "time")  # whether it was measured
_NEARER: Final = 0.8
"""Part of the scene's own error below which a change is worth naming."""
_SHOWN: Final = 4
_CLOCK: Final = 0.1
"""Time of a cycle below which a difference of two runs is not distinguished from zero [us]."""
_WIDE_HEADS: Final = ("wall time per simulated s", "median over least")


def accuracy_report(result: Row, *, tables: bool = False) -> RenderableType:
    """Return the answer, the heading and, if requested, the tables, for a terminal; of displays always the table."""
    if is_of_display(result):
        return Group(*(Text(f" {line}") for line in display_heading(result)), display_accuracy_table(result))
    lines = [*advice_lines(result), "", *price_lines(result), ""]
    if not tables:
        said = [*lines, *heading(result)[:2], *result["remarks"], "every row: --tables"]
        return Group(*(Text(f" {part}") for line in said for part in wrapped(line)))
    shown = [Text(f" {part}") for line in (*lines, *heading(result)) for part in wrapped(line)]
    return Group(*shown, *accuracy_tables(result))


def is_of_display(result: Row) -> bool:
    """Whether a study is about an admittance display."""
    return "tolerance" not in result


def wrapped(line: str) -> list[str]:
    """Return a line wrapped to 80 columns, with a hanging indent."""
    label, found, text = line.partition(_GAP)
    indent = " " * (_LABEL if found else len(line) - len(line.lstrip()))
    if found:
        whole = " ".join(f"{entry} {_DOT}".replace(" ", _KEPT) for entry in text.split(_BETWEEN))
        line = f"{label:<{_LABEL}}{whole[: 1 - len(_BETWEEN)]}"
    wrapper = textwrap.TextWrapper(_WIDTH, "", indent, break_long_words=False, break_on_hyphens=False)
    return [part.replace(_KEPT, " ") for part in wrapper.wrap(line)] or [""]


def price_lines(result: Row) -> list[str]:
    """Return the time and error of each relevant setting, one line each, the scene's own first."""
    unit, floor = result["unit"], _floor(result)
    lines = [*_plant_prices(result, unit, floor), *_method_prices(result, unit, floor), *_effect_prices(result)]
    loop = _loop_prices(result)
    said = [f"{label}{_GAP}{_BETWEEN.join(entries)}" for label, entries in lines if entries]
    said = [f"plant: {_TIME_OF[bool(result['workload'])]} a period, and largest error of the position", *said]
    if loop:
        said.append("loop: time of the control thread in a cycle, and distance from the continuous axis")
    return [*said, *(f"{label}{_GAP}{_BETWEEN.join(entries)}" for label, entries in loop)]


def _plant_prices(result: Row, unit: str, floor: float) -> list[tuple[str, list[str]]]:
    """Return our settings: event bits at the substeps that the scene has, and substeps at its event bits."""
    now = result["now"]["accuracy"]
    ours = {(row["accuracy"]["event_bits"], row["accuracy"]["substeps"]): row
            for row in result["plant"] if row["method"] == OURS}  # fmt: skip
    own = (now["event_bits"], now["substeps"])
    if own not in ours:
        return []
    if len(ours) == 1:
        return [("settings", [f"now exact: {_price(ours[own], unit, floor)}"])]
    lines = []
    for name, place in (("event bits", 0), ("substeps", 1)):
        others = sorted({key for key in ours if key[1 - place] == own[1 - place] and key != own}, reverse=not place)
        entries = [f"now {own[place]}: {_price(ours[own], unit, floor)}"]
        entries += [f"{key[place]}: {_price(ours[key], unit, floor)}" for key in others]
        lines.append((name, entries if others else []))
    return lines


def _method_prices(result: Row, unit: str, floor: float) -> list[tuple[str, list[str]]]:
    """Return of each other method the cheapest setting within the tolerance, else the most exact one."""
    entries = []
    for method in dict.fromkeys(row["method"] for row in result["plant"] if row["method"] != OURS):
        rows = [row for row in result["plant"] if row["method"] == method and row["status"] == "ok"]
        good = cheapest(rows, result["tolerance"]) or min(
            rows, key=lambda row: float(row["position_error"]), default=None
        )
        entries.append(f"{method}, {good['setting']}: {_price(good, unit, floor)}" if good else f"{method}: unstable")
    return [("other methods", entries)]


def _effect_prices(result: Row) -> list[tuple[str, list[str]]]:
    """Return the error and the saving of leaving each effect out."""
    entries = []
    for row in (result["advice"] or {"effects": ()})["effects"]:
        if row.get("position_error") is not None:
            saved = row["us_saved_per_period"]
            price = (
                f"{row['evaluations_saved_per_period']:.3g} evaluations" if saved is None else _time(max(saved, 0.0))
            )
            entries.append(f"{row['effect']}: errs by {length(row['position_error'], result['unit'])}, saves {price}")
    return [("left out", entries)]


def _loop_prices(result: Row) -> list[tuple[str, list[str]]]:
    """Return the loop's settings; none where it renders nothing, and nothing was compared."""
    base = base_loop(result)
    if base is None or not base["largest_torque"]:
        return []
    now, lines = result["now"], []
    for group in dict.fromkeys(row["group"] for row in result["loop"] if not row["is_scene"]):
        rows = [row for row in result["loop"] if row["group"] == group]
        lines.append((group, [f"now {now.get(group, 'as it is')}: {_loop_price(base, result, group)}"]))
        lines[-1][1].extend(f"{row['setting']}: {_loop_price(row, result, group)}" for row in rows)
    return lines


def base_loop(result: Row) -> Row | None:
    """Return the row of the loop with the scene's own settings; None where it does not complete."""
    return next((row for row in result["loop"] if row["is_scene"] and row["status"] == "ok"), None)


def _price(row: Row, unit: str, floor: float) -> str:
    """Return time, or evaluations where nothing was timed, and error."""
    if row["status"] != "ok":
        return str(row["status"]).partition(":")[0]
    spent = row.get("us_per_period")
    cost = f"{row['evaluations_per_period']:.3g} evaluations" if spent is None else _time(spent)
    return f"{cost}, {length(max(row['position_error'], floor), unit)}"


def _loop_price(row: Row, result: Row, group: str) -> str:
    """Return time of the control thread, load of the bus where it differs, and distance from the continuous axis."""
    spent = row.get("control_thread_us")
    parts = [] if spent is None else [_time(spent)]
    if group == "sample rate":
        parts.append(f"bus {100.0 * row['bus_load']:.0f} %{'' if row['bus_fits'] else ', does not fit'}")
    stable = row["status"] == "ok"
    return ", ".join([*parts, length(row["position_error"], result["unit"]) if stable else str(row["status"])])


def _time(microseconds: float) -> str:
    """Return a time in microseconds, with three figures."""
    return f"{microseconds:,.0f} us" if microseconds >= 100.0 else f"{microseconds:.2g} us"


def markdown(result: Row) -> str:
    """Return the report as Markdown, with every table."""
    if is_of_display(result):
        lines = [f"{line}  " for line in display_heading(result)]
        return "\n".join([*lines, "", display_accuracy_table(result).markdown()])
    lines = ["### Advice", "", *(f"- {line}" for line in advice_lines(result)), ""]
    lines += ["### Prices", "", *(f"- {line.replace(_GAP, ': ')}" for line in price_lines(result)), ""]
    lines += [*(f"{line}  " for line in heading(result)), ""]
    return "\n".join([*lines, *(table.markdown() for table in accuracy_tables(result, wide=True)), ""])


def heading(result: Row) -> list[str]:
    """Return the heading: the part studied, and its reference."""
    unit = result["unit"]
    lines = [
        f"{result['scene']}, {part_of(result)}: {result['holds']} sample times at {si(result['rate'], 'Hz', 3)}, "
        f"{result['status']}"
    ]
    reference = result["reference"]
    if reference:
        witness = reference["witness"]
        apart = "" if witness is None else f"; {witness['method']}: {length(witness['apart'], unit)} apart"
        lines.append(f"reference: {reference['method']}; travel {length(reference['travel'], unit)}{apart}")
        agreement = reference["rank_agreement"]
        if agreement is not None:
            lines.append(f"evaluations of the equations of motion rank like time: Spearman {agreement:.2f}")
    if result["workload"]:
        work = result["workload"]
        lines.append(f"fixed workload of this run: {si(work['seconds'], 's', 3)} ({work['what']})")
    if result["log_us"] is not None:
        cost = f"{result['log_us']:.1f} us" if result["log_us"] >= _CLOCK else f"less than {_CLOCK} us"
        lines.append(f"the energy log costs the control thread {cost} a cycle")
    engines = {row["engine"].partition(":")[0] for row in result["loop"] if "engine" in row}
    if engines:
        lines.append(f"the loops ran in {' and '.join(sorted(engines))}")
    return [*lines, *result["remarks"]]


def part_of(result: Row) -> str:
    """Return the axis or the group that was studied."""
    return f"{'group' if result.get('is_group') else 'axis'} {result['axis']}"


def advice_lines(result: Row) -> list[str]:
    """Return the answer, the line to put into the scene, and further advice."""
    advice, unit = result["advice"], result["unit"]
    if advice is None:
        return ["no advice: the study was stopped before its end"]
    within = f"within {length(advice['tolerance'], unit)}"
    chosen, best = advice["chosen"], advice["most_exact"]
    if chosen is None:
        reached = "" if best is None else f"; the most exact setting reaches {length(best['position_error'], unit)}"
        lines = [f"{within}: no advice: {advice['doubt'] or 'no setting of the plant keeps it'}{reached}"]
    else:
        lines = [
            f"{within}: {chosen['setting']} ({chosen['evaluations_per_period']:.3g} evaluations a period, error "
            f"{length(chosen['position_error'], unit)}, {si(chosen['energy_error'], 'J', 2)}); paste into the scene:",
            f"    {advice['line']}",
        ]
    lines.append(_loop_advice(result))
    for other in advice["cheaper_elsewhere"][:1]:
        lines.append(f"fewer evaluations, but not available to a scene: {other['method']}, {other['setting']}")
    return [line for line in (*lines, *_effect_advice(result)) if line]


def _effect_advice(result: Row) -> list[str]:
    """Return the effects that did nothing, and the effects that cannot be left out."""
    effects, lines = result["advice"]["effects"], []
    idle = [effect["effect"] for effect in effects if effect.get("position_error") == 0.0]
    if idle:
        lines.append(f"changed nothing in this time: {', '.join(idle)}")
    return [*lines, *(f"{effect['effect']}: {effect['remark']}" for effect in effects if effect["remark"])]


def _loop_advice(result: Row) -> str:
    """Return the changes that fit the bus and bring the rendered axis nearer to the continuous one, best first."""
    base = base_loop(result)
    if base is None:
        return ""
    floor, unit = _loop_floor(result), result["unit"]
    if base["largest_torque"] == 0.0 or base["position_error"] <= floor:
        time = si(result["holds"] / result["rate"], "s", 3)
        return f"loop: the hand does not reach the wall within {time}; try a longer --duration"

    def is_nearer(row: Row) -> bool:
        return bool(row["status"] == "ok" and row["position_error"] < _NEARER * base["position_error"] - floor)

    def lasts(row: Row) -> bool:
        """Whether it is no coarser than the scene, and every finer one is nearer too: one motion may be luck."""
        if row["fineness"] is None:
            return True
        finer = [r for r in result["loop"] if r["group"] == row["group"] and (r["fineness"] or 0.0) > row["fineness"]]
        return bool(row["fineness"] > 1.0 and all(is_nearer(other) for other in finer if other["status"] == "ok"))

    nearer = [row for row in result["loop"] if row["bus_fits"] and is_nearer(row) and lasts(row)]
    if not nearer:
        what = (
            result.get("judged", "")
            or "no single change that fits the bus brings it clearly nearer to the continuous axis"
        )
        return f"loop: {what}"
    words = []
    for row in sorted(nearer, key=lambda row: float(row["position_error"]))[:_SHOWN]:
        given = max(0.0, row["energy_given_out"])
        out = f", gives out {si(given, 'J', 2)}" if given > PASSIVE_TOLERANCE else ""
        load = f"bus {100.0 * row['bus_load']:.0f} %"
        words.append(f"{row['group']} {row['setting']} ({length(row['position_error'], unit)}, {load}{out})")
    judged = f"{result['judged']}: " if result.get("judged", "") else ""
    return f"loop: {judged}{length(base['position_error'], unit)} from the continuous axis; nearer: {'; '.join(words)}"


def _loop_floor(result: Row) -> float:
    """Return the error of the position that is the plant's own on the side of the loop [m or rad]."""
    best = result["advice"]["most_exact"] if result["advice"] else None
    return max(_floor(result), 2.0 * best["position_error"] if best else 0.0)


def length(value: float, unit: str) -> str:
    """Return a position with its unit."""
    return si(value, "m", 3) if unit == "m" else f"{value:.3g} rad"


def accuracy_tables(result: Row, *, wide: bool = False) -> list[Table]:
    """Return every table; `wide` adds times per simulated second and their spread to the plant's."""
    unit, floor, plant = result["unit"], _floor(result), result["plant"]
    more: Sequence[str] = _WIDE_HEADS if wide else ()
    rows = [[*_plant_cells(row, unit, floor), *(_wall(row) if wide else ())] for row in plant]
    title = " plant: largest error at any SYNC; bold and *: Pareto front of evaluations, the same on every machine"
    found = [_table(title, (*PLANT_HEADS, *more), rows, [row["pareto"] for row in plant])]
    orders = [[row["method"], _plain(row["declared"]), _fixed(row["fitted"], 2)] for row in result["orders"]]
    found.append(_table(" order of the error in the step", ("method", "declared", "fitted"), orders))
    effects = [_effect_cells(row, unit) for row in (result["advice"] or {"effects": ()})["effects"]]
    found.append(_table(" effects: what leaving one out does", EFFECT_HEADS, effects))
    felt = any(row["largest_torque"] for row in result["loop"])
    loop = [_loop_cells(row, unit) for row in result["loop"]] if felt else []
    title = " loop: largest difference from the continuous axis, one thing changed; !: the cycle does not fit"
    found.append(_table(title, LOOP_HEADS, loop, [row["is_scene"] for row in result["loop"]]))
    return [table for table in found if table.rows]


def _table(title: str, heads: Sequence[str], rows: Sequence[list[str]], marked: Sequence[bool] = ()) -> Table:
    styles = [*("bold" if mark else "" for mark in marked), *[""] * (len(rows) - len(marked))]
    cells: list[list[Cell]] = [
        [*(Styled(c, style) for c in row[:2]), *row[2:]] for row, style in zip(rows, styles, strict=True)
    ]
    return Table(title, heads, cells, keys=2)


def _floor(result: Row) -> float:
    """Return the error of the position that is none [m or rad]."""
    return FLOOR * float(result["reference"]["travel"]) if result["reference"] else 0.0


def _wall(row: Row) -> list[str]:
    """Return wall time per simulated second, and its spread."""
    if row.get("wall_per_second") is None:
        return ["", ""]
    return [si(row["wall_per_second"], "s", 3), f"+{100.0 * row['spread']:.0f} %"]


def _plant_cells(row: Row, unit: str, floor: float) -> list[str]:
    if row["status"] != "ok":
        return [row["method"], row["setting"], row["status"].partition(":")[0], *[""] * 7]
    position = f"<= {length(floor, unit)}" if row["position_error"] <= floor else length(row["position_error"], unit)
    return [
        row["method"], row["setting"], position, _force(row["force_error"], unit), si(row["energy_error"], "J", 3),
        _fixed(row["evaluations_per_period"], 2), str(row["events"]) if row["accuracy"] else "",
        _short(row["us_per_period"], 4), _short(row["ratio"], 3),
        "*" if row["pareto"] else "",
    ]  # fmt: skip


def _effect_cells(row: Row, unit: str) -> list[str]:
    if row.get("position_error") is None:
        return [row["effect"], "-", *[""] * 6]
    worth = row["error_per_microsecond"]
    order = "exact" if row["order"] is None else str(row["order"])
    return [
        row["effect"], order, length(row["position_error"], unit), _force(row["force_error"], unit),
        si(row["energy_error"], "J", 3), _fixed(row["evaluations_saved_per_period"], 2),
        _short(row["us_saved_per_period"], 3), "" if worth is None else length(worth, unit),
    ]  # fmt: skip


def _loop_cells(row: Row, unit: str) -> list[str]:
    thread = row.get("control_thread_us")
    load = f"{100.0 * row['bus_load']:.0f} %{'' if row['bus_fits'] else ' !'}"
    errors = [row["status"].partition(":")[0], "", ""]
    if row["status"] == "ok":
        energy = si(row["energy_error"], "J", 3)
        errors = [length(row["position_error"], unit), _force(row["force_error"], unit), energy]
    return [
        row["group"], row["setting"], *errors, si(row["energy_uncertainty"], "J", 3),
        "" if thread is None else f"{thread:.1f} us",
        "" if thread is None else f"{100.0 * row['thread_share']:.0f} %", load,
    ]  # fmt: skip


def _force(value: float, unit: str) -> str:
    return si(value, effort_unit(unit), 3)


def _fixed(value: float | None, digits: int) -> str:
    return "" if value is None else f"{value:.{digits}f}"


def _short(value: float | None, digits: int) -> str:
    return "" if value is None else f"{value:.{digits}g}"


def _plain(value: int | None) -> str:
    return "exact" if value is None else str(value)


_ADVICE_CLOCK: Final = 0.05
"""Time per period below which a saving is not distinguished from zero [us]."""


def meets(row: Row, tolerance: float) -> bool:
    """Whether the position of a row keeps the tolerance [m or rad]."""
    return row["status"] == "ok" and float(row["position_error"]) <= tolerance


def cheapest(rows: Sequence[Row], tolerance: float) -> Row | None:
    """Return the row with the fewest evaluations within the tolerance; among equals the more exact one."""
    good = [row for row in rows if meets(row, tolerance)]
    return min(good, key=lambda row: (row["evaluations"], row["position_error"]), default=None)


def pareto(rows: Sequence[Row], price: str, floor: float) -> list[bool]:
    """Return for each row whether no other row is both cheaper and at least as exact.

    Args:
        rows: Rows of the ladder.
        price: Key of their cost.
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
    """Return the points that no other point dominates."""
    return {(x, y) for x, y in set(points) if not any(a <= x and b <= y and (a < x or b < y) for a, b in points)}


def advice(rows: Sequence[Row], effects: Sequence[Row], tolerance: float, orders: Sequence[Row] = ()) -> Row:
    """Return the values to write into the scene, with the reason.

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
        f"errors fall with an order of {row['fitted']:.2g} in the substep where {row['declared']} is declared, so "
        "none of them predicts another scene or a longer run; raise the rate, or give finer substeps"
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
        saved: Time saved per period [us]; None: not measured. Savings below the clock's resolution count as that.
    """
    return None if saved is None else error / max(saved, _ADVICE_CLOCK)


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
