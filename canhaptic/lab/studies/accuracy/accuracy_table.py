"""The tables and the advice of a study of accuracy, for a terminal and as Markdown.

The advice is the cheapest setting within a tolerance; the tables show the Pareto front and the cost of each effect. All
choices depend on errors and evaluations, which are equal in every run; times only sort the effects.
"""

import textwrap
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from rich.console import Group, RenderableType
from rich.text import Text

from canhaptic.axis_units import effort_unit, mass_unit, si
from canhaptic.control.verdict import PASSIVE_TOLERANCE
from canhaptic.files import scene_title
from canhaptic.lab.studies import Row
from canhaptic.lab.studies.accuracy.plant_solvers import FLOOR, LEFT_OUT, OURS
from canhaptic.sim.plant.propagator import Array
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
LEAST_ORDER: Final = 0.5
"""Fraction of the declared order of convergence: if errors fall more slowly, no setting is advised or chosen."""
_NEARER: Final = 0.8
"""Fraction of the scene's present error: only changes with an error below it are named."""
_SHOWN: Final = 4
_WIDE_HEADS: Final = ("processor time per simulated s", "largest over least")
_KEPT_BY: Final = "guarded"
_IDLE: Final = "sends no torque"


def accuracy_report(result: Row, *, tables: bool = False) -> RenderableType:
    """Return the answer, the heading and, if requested, the tables, for a terminal; for displays always the table."""
    if is_of_display(result):
        return Group(*(Text(f" {line}") for line in display_heading(result)), display_accuracy_table(result))
    said = [*advice_lines(result), "", *price_lines(result), ""]
    said += heading(result) if tables else [*heading(result)[:2], *result["remarks"], "all tables: --tables"]
    shown = [Text(f" {part}") for line in said for part in wrapped(line)]
    return Group(*shown, *(accuracy_tables(result) if tables else ()))


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
    """Return one line with time and error for each relevant setting, that of the scene first."""
    plant = {**_plant_prices(result), "other methods": _method_prices(result), "left out": _effect_prices(result)}
    measured = "processor time (its spread) of a run with its modes" if result["workload"] else "evaluations"
    loop = _loop_prices(result)
    said = [f"plant: {measured} per period, and largest position error", *_price_lines(plant)]
    if loop:
        said.append("loop: time of the control thread per cycle, and largest distance from the continuous-time loop")
    if result.get("run_us") is not None:
        share = f"{100.0 * result['run_share']:.2g} % of real time"
        said.append(f"whole run: {_time(result['run_us'])} a cycle on one processor, drives and plants too: {share}")
    return [*said, *_price_lines(loop)]


def _price_lines(prices: Mapping[str, Sequence[str]]) -> list[str]:
    return [f"{label}{_GAP}{_BETWEEN.join(entries)}" for label, entries in prices.items() if entries]


def _plant_prices(result: Row) -> dict[str, list[str]]:
    """Return the settings of the plant solver: event bits with the scene's substeps, substeps with its event bits."""
    own = tuple(result["now"]["accuracy"][key] for key in ("event_bits", "substeps"))
    ours = {(row["accuracy"]["event_bits"], row["accuracy"]["substeps"]): _price(row, result)
            for row in result["plant"] if row["method"] == OURS}  # fmt: skip
    if own not in ours:
        return {}
    if len(ours) == 1:
        return {"settings": [f"now exact: {ours[own]}"]}
    lines: dict[str, list[str]] = {}
    for name, place in (("event bits", 0), ("substeps", 1)):
        others = sorted({key for key in ours if key[1 - place] == own[1 - place] and key != own}, reverse=not place)
        entries = [f"now {own[place]}: {ours[own]}", *(f"{key[place]}: {ours[key]}" for key in others)]
        lines[name] = entries if others else []
    return lines


def _method_prices(result: Row) -> list[str]:
    """Return for each other method its cheapest setting within the tolerance, else its most accurate one."""
    entries = []
    for method in dict.fromkeys(row["method"] for row in result["plant"] if row["method"] != OURS):
        rows = [row for row in result["plant"] if row["method"] == method]
        good = cheapest(rows, result["tolerance"]) or _most_exact(rows)
        why = ", ".join(dict.fromkeys(str(row["status"]).partition(":")[0] for row in rows))
        entries.append(f"{method}, {good['setting']}: {_price(good, result)}" if good else f"{method}: {why}")
    return entries


def _effect_prices(result: Row) -> list[str]:
    """Return the error and the saving of leaving each effect out."""
    entries = []
    for row in (result["advice"] or {"effects": ()})["effects"]:
        if row.get("position_error") is not None:
            saved, spent = row["us_saved_per_period"], row["evaluations_saved_per_period"]
            price = f"{spent:.3g} evaluations" if saved is None or saved <= 0.0 else _time(saved)
            entries.append(f"{row['effect']}: error {length(row['position_error'], result['unit'])}, saves {price}")
    return entries


def _loop_prices(result: Row) -> dict[str, list[str]]:
    """Return the settings of the loop; none if the loop renders nothing, because nothing was compared."""
    base = base_loop(result)
    if base is None or not base["largest_torque"]:
        return {}
    lines: dict[str, list[str]] = {}
    for row in (row for row in result["loop"] if not row["is_scene"]):
        group = row["group"]
        now = f"now {result['now'].get(group, 'as it is')}: {_loop_price(base, result, group)}"
        lines.setdefault(group, [now]).append(f"{row['setting']}: {_loop_price(row, result, group)}")
    return lines


def base_loop(result: Row) -> Row | None:
    """Return the row of the loop with the scene's own settings; None if that loop does not complete."""
    return next((row for row in result["loop"] if row["is_scene"] and row["status"] == "ok"), None)


def _price(row: Row, result: Row) -> str:
    """Return the time, or the evaluations if nothing was timed, and the error."""
    if row["status"] != "ok":
        return str(row["status"]).partition(":")[0]
    spent = row.get("us_per_period")
    cost = f"{row['evaluations_per_period']:.3g} evaluations" if spent is None else f"{_time(spent)}{_spread(row)}"
    return f"{cost}, {length(max(row['position_error'], _floor(result)), result['unit'])}"


def _spread(row: Row) -> str:
    """Return the spread of the repeats, " (+7 %)", or that there was a single one."""
    repeats = row.get("repeats", 0)  # an earlier release does not tell
    return f" (+{100.0 * row['spread']:.0f} %)" if repeats > 1 else " (once)" if repeats else ""


def _loop_price(row: Row, result: Row, group: str) -> str:
    """Return the time of the control thread, the bus load if it differs, and the distance from the continuous axis."""
    if _renders_nothing(row):
        return _IDLE
    spent = row.get("control_thread_us")
    parts = [] if spent is None else [_time(spent)]
    if group == "sample rate":
        parts.append(f"{bus_load(row)}{'' if row['bus_fits'] else ', cycle too long'}")
    stable = row["status"] == "ok"
    parts.append(length(row["position_error"], result["unit"]) if stable else str(row["status"]))
    return ", ".join(filter(None, parts))


def bus_load(row: Row, before: str = "bus ") -> str:
    """Return the load of the bus of a row of the loop; "" for a line of EtherCAT, whose load is not computed."""
    return "" if row["bus_load"] is None else f"{before}{100.0 * row['bus_load']:.0f} %"


def _renders_nothing(row: Row) -> bool:
    return row["status"] == "ok" and not row["largest_torque"]


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
        f"{scene_title(result['scene'])}, {part_of(result)}: "
        f"{result['holds']} sample times at {si(result['rate'], 'Hz', 3)}"
        f", {result['status']}"
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
        cost = f"{result['log_us']:.1f} us" if result["log_us"] else "less than the spread of its measurement"
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
        why = "the study was stopped before its end" if result["status"] == "stopped" else "nothing was compared"
        return [f"no advice: {why}"]
    within = f"within {length(advice['tolerance'], unit)}"
    chosen, best = advice["chosen"], advice["most_exact"]
    if chosen is None:
        reached = "" if best is None else f"; the most exact setting reaches {length(best['position_error'], unit)}"
        lines = [f"{within}: no advice: {advice['doubt'] or 'no setting of the plant keeps it'}{reached}"]
    else:
        error = _position(chosen, unit, _floor(result))
        lines = [
            f"cheapest {within}: {chosen['setting']} (evaluations per period {chosen['evaluations_per_period']:.3g}, "
            f"errors {error} and {si(chosen['energy_error'], 'J', 2)}). In the scene:",
            f"    {advice['line']}",
        ]
    lines.append(_loop_advice(result))
    for other in advice["cheaper_elsewhere"][:1]:
        lines.append(f"fewer evaluations, but not available to a scene: {other['method']}, {other['setting']}")
    if idle := [effect["effect"] for effect in advice["effects"] if effect.get("position_error") == 0.0]:
        lines.append(f"changed nothing in this time: {', '.join(idle)}")
    lines += [f"{effect['effect']}: {effect['remark']}" for effect in advice["effects"] if effect["remark"]]
    return [line for line in lines if line]


def _loop_advice(result: Row) -> str:
    """Return the changes, best first, that fit the bus and bring the rendered axis closer to the continuous one."""
    base, best, unit = base_loop(result), result["advice"]["most_exact"], result["unit"]
    if base is None:
        return ""
    floor = max(_floor(result), 2.0 * best["position_error"] if best else 0.0)  # the plant's own error
    if base["largest_torque"] == 0.0 or base["position_error"] <= floor:
        time = si(result["holds"] / result["rate"], "s", 3)
        return f"loop: the hand does not reach the wall within {time}; try a longer --duration"

    same = _without_effect(result)

    def is_nearer(row: Row) -> bool:
        is_idle = _renders_nothing(row) or row["setting"] in same
        return bool(
            row["status"] == "ok" and not is_idle and row["position_error"] < _NEARER * base["position_error"] - floor
        )

    def lasts(row: Row) -> bool:
        """Whether it is no coarser than the scene, and every finer one is nearer too: one motion may be luck."""
        if row["fineness"] is None:
            return True
        finer = [r for r in result["loop"] if r["group"] == row["group"] and (r["fineness"] or 0.0) > row["fineness"]]
        return bool(row["fineness"] > 1.0 and all(is_nearer(other) for other in finer if other["status"] == "ok"))

    judged = result.get("judged", "")
    named = (row for row in result["loop"] if row["setting"] != "unprotected")  # no advice: it removes the protection
    nearer = sorted((row for row in named if row["bus_fits"] and is_nearer(row) and lasts(row)), key=_error)
    if not nearer:
        none = "no single change that fits the bus brings it clearly closer to the continuous-time loop"
        return f"loop: {judged or none}"
    said = f"{judged}: " if judged else ""
    distance = length(base["position_error"], unit)
    best_first = "; ".join(_change(row, base, unit) for row in nearer[:_SHOWN])
    return f"loop: {said}{distance} from the continuous-time loop. Changes that bring it closer: {best_first}"


def _change(row: Row, base: Row, unit: str) -> str:
    """Return a change of the loop in words, with its error and what it costs."""
    given = max(0.0, row["energy_given_out"])
    out = f", gives out {si(given, 'J', 2)}" if given > PASSIVE_TOLERANCE else ""
    if row["group"] == "algorithm" and base["setting"] == _KEPT_BY:
        out = f"{out}, leaves {_KEPT_BY} and its guarantee"
    price = ", ".join(filter(None, (length(row["position_error"], unit), bus_load(row))))
    return f"{row['group']}: {row['setting']} ({price}{out})"


def _without_effect(result: Row) -> set[str]:
    """Return the algorithms whose run is that without protection to the last digit: they did nothing."""
    rows = [row for row in result["loop"] if row["status"] == "ok" and (row["group"] == "algorithm" or row["is_scene"])]
    plain = next((row for row in rows if row["setting"] == "unprotected"), None)
    keys = ("position_error", "force_error", "energy_error", "largest_torque", "energy_given_out")
    return {row["setting"] for row in rows if plain and all(row[key] == plain[key] for key in keys)}


def _error(row: Row) -> float:
    return float(row["position_error"])


def _most_exact(rows: Sequence[Row]) -> Row | None:
    return min((row for row in rows if row["status"] == "ok"), key=_error, default=None)


def length(value: float, unit: str) -> str:
    """Return a position or length as text with its unit."""
    return si(value, "m", 3) if unit == "m" else f"{value:.3g} rad"


def accuracy_tables(result: Row, *, wide: bool = False) -> list[Table]:
    """Return every table; `wide` adds the time per simulated second and its spread to the table of the plant."""
    unit, floor, plant = result["unit"], _floor(result), result["plant"]
    rows = [[*_plant_cells(row, unit, floor), *(_wall(row) if wide else ())] for row in plant]
    orders = [[row["method"], _plain(row["declared"]), _fixed(row["fitted"], 2)] for row in result["orders"]]
    effects = [_effect_cells(row, unit) for row in (result["advice"] or {"effects": ()})["effects"]]
    felt = any(row["largest_torque"] for row in result["loop"])
    loop = [_loop_cells(row, unit) for row in result["loop"]] if felt else []
    found = [
        _table(" plant: largest error at any SYNC; bold and *: Pareto front of evaluations, the same on every machine",
               (*PLANT_HEADS, *(_WIDE_HEADS if wide else ())), rows, [row["pareto"] for row in plant]),
        _table(" order of the error in the step", ("method", "declared", "fitted"), orders),
        _table(" effects: what leaving one out does", EFFECT_HEADS, effects),
        _table(" loop: largest difference from the continuous-time loop, one thing changed; !: cycle too long",
               LOOP_HEADS, loop, [row["is_scene"] for row in result["loop"]]),
    ]  # fmt: skip
    return [table for table in found if table.rows]


def _table(title: str, heads: Sequence[str], rows: Sequence[list[str]], marked: Sequence[bool] = ()) -> Table:
    styles = [*("bold" if mark else "" for mark in marked), *[""] * len(rows)]
    cells: list[list[Cell]] = [[*(Styled(c, style) for c in row[:2]), *row[2:]] for row, style in zip(rows, styles)]  # noqa: B905 - styles may be more
    return Table(title, heads, cells, keys=2)


def _floor(result: Row) -> float:
    """Return the error of the position that counts as zero [m or rad]."""
    return FLOOR * float(result["reference"]["travel"]) if result["reference"] else 0.0


def _wall(row: Row) -> list[str]:
    """Return processor time per simulated second, and its spread."""
    if row.get("cpu_per_second") is None:
        return ["", ""]
    return [si(row["cpu_per_second"], "s", 3), f"+{100.0 * row['spread']:.0f} %"]


def _position(row: Row, unit: str, floor: float) -> str:
    """Return the error of the position, or at most the floor [m or rad], below which all count as equal."""
    return f"<= {length(floor, unit)}" if row["position_error"] <= floor else length(row["position_error"], unit)


def _plant_cells(row: Row, unit: str, floor: float) -> list[str]:
    if row["status"] != "ok":
        return [row["method"], row["setting"], row["status"].partition(":")[0], *[""] * 7]
    return [
        row["method"], row["setting"], _position(row, unit, floor), *_error_cells(row, unit)[1:],
        _fixed(row["evaluations_per_period"], 2), str(row["events"]) if row["accuracy"] else "",
        _short(row["us_per_period"], 4), _short(row["ratio"], 3),
        "*" if row["pareto"] else "",
    ]  # fmt: skip


def _effect_cells(row: Row, unit: str) -> list[str]:
    if row.get("position_error") is None:
        return [row["effect"], "-", *[""] * 6]
    worth = row["error_per_microsecond"]
    return [
        row["effect"], _plain(row["order"]), *_error_cells(row, unit), _fixed(row["evaluations_saved_per_period"], 2),
        _short(row["us_saved_per_period"], 3), "" if worth is None else length(worth, unit),
    ]  # fmt: skip


def _loop_cells(row: Row, unit: str) -> list[str]:
    thread = row.get("control_thread_us")
    load = f"{bus_load(row, '')}{'' if row['bus_fits'] else ' !'}"
    errors = _error_cells(row, unit) if row["status"] == "ok" else [row["status"].partition(":")[0], "", ""]
    errors = [_IDLE, "", ""] if _renders_nothing(row) else errors
    return [
        row["group"], row["setting"], *errors, si(row["energy_uncertainty"], "J", 3),
        "" if thread is None else f"{thread:.1f} us",
        "" if thread is None else f"{100.0 * row['thread_share']:.0f} %", load,
    ]  # fmt: skip


def _error_cells(row: Row, unit: str) -> list[str]:
    """Return the errors of position, force and energy."""
    force = si(row["force_error"], effort_unit(unit), 3)
    return [length(row["position_error"], unit), force, si(row["energy_error"], "J", 3)]


def _fixed(value: float | None, digits: int) -> str:
    return "" if value is None else f"{value:.{digits}f}"


def _short(value: float | None, digits: int) -> str:
    return "" if value is None else f"{value:.{digits}g}"


def _plain(value: int | None) -> str:
    return "exact" if value is None else str(value)


DISPLAY_HEADS: Final = ("changed", "to", "position", "energy", "mass felt", "given out", "guard acts", "us per\ncycle")


def display_accuracy_table(result: Row) -> Table:
    """Return one row for each change of the scene."""
    return Table("", DISPLAY_HEADS, [_display_cells(row, result["unit"]) for row in result["loop"]], keys=2)


def display_heading(result: Row) -> list[str]:
    """Return the heading: the studied part, its reference, and the difference of the plant from a solver."""
    unit, reference = result["unit"], result["reference"]
    lines = [
        f"{scene_title(result['scene'])}, {result['axis']}: {result['holds']} sample times at {result['rate']:g} Hz, "
        f"{result['status']}",
        f"errors against an ideal display: travel {si(reference['travel'], unit)}, "
        f"energy {si(reference['energy'], 'J')}; certain to about {si(reference['apart'], unit, 2)}",
    ]
    for row in result["plant"]:
        text = row["status"]
        if row["status"] == "ok":
            energy = f", energy {si(row['energy_error'], 'J', 2)}" if "energy_error" in row else ""
            text = f"errors against DOP853: position {si(row['position_error'], unit, 2)}{energy}"
        lines.append(f"simulated plant of {row['axis']}: {text}")
    return lines


def _display_cells(row: Row, unit: str) -> list[str]:
    if "position_error" not in row:
        return [row["changed"], f"{row['to']}: refused", *[""] * (len(DISPLAY_HEADS) - 2)]
    return [
        row["changed"],
        row["to"] + ("" if row["status"] == "ok" else f" (ended: {row['status'][:40]})"),
        si(row["position_error"], unit, 3),
        si(row["energy_error"], "J", 3),
        "-" if np.isnan(row["mass_felt"]) else si(row["mass_felt"], mass_unit(unit), 3),
        si(row["given_out"], "J", 3),
        f"{100.0 * row['guard_acts']:.2g} %",
        f"{row['us_per_cycle']:.0f}",
    ]


_ADVICE_CLOCK: Final = 0.05
"""Saving per sample time that is not distinguished from zero [us]."""


def meets(row: Row, tolerance: float) -> bool:
    """Whether the error of the position in a row is within a tolerance [m or rad]."""
    return row["status"] == "ok" and float(row["position_error"]) <= tolerance


def cheapest(rows: Sequence[Row], tolerance: float) -> Row | None:
    """Return the row with the fewest evaluations within the tolerance; among equal ones the most accurate."""
    good = [row for row in rows if meets(row, tolerance)]
    return min(good, key=lambda row: (row["evaluations"], row["position_error"]), default=None)


def pareto(rows: Sequence[Row], price: str, floor: float) -> list[bool]:
    """Return for each row whether no other row is both cheaper and at least as accurate.

    Args:
        rows: Rows of the ladder.
        price: Key of their cost.
        floor: Error of the position below which all rows count as equal [m or rad].
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
    """Return the Pareto front: the points that no other point dominates."""
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
    chosen, best = None if doubt else cheapest(lasting, tolerance), _most_exact(ours)
    cheaper = [
        {key: row[key] for key in ("method", "setting", "evaluations")}
        for row in rows
        if row["method"] != OURS and meets(row, tolerance) and chosen and row["evaluations"] < chosen["evaluations"]
    ]
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
    """Whether every finer setting that ran keeps the tolerance too; errors of events and substeps may cancel."""
    own = row["accuracy"]
    ran = (other for other in ours if other["status"] != LEFT_OUT)
    finer = [other for other in ran if all(other["accuracy"][key] >= own[key] for key in own)]
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
        saved: Time saved per period [us], not counted below the clock's resolution; None: not measured.
    """
    return None if saved is None else error / max(saved, _ADVICE_CLOCK)


def rank_agreement(one: Sequence[float], other: Sequence[float]) -> float | None:
    """Return Spearman's rank correlation; None for fewer than three pairs, or if one of the lists is constant."""
    if len(one) < 3 or len(set(one)) == 1 or len(set(other)) == 1:
        return None
    return float(np.corrcoef(_ranks(one), _ranks(other))[0, 1])


def _ranks(values: Sequence[float]) -> Array:
    """Return the rank of each value; equal values share their mean rank."""
    _, place, counts = np.unique(values, return_inverse=True, return_counts=True)
    return (np.cumsum(counts) - 0.5 * counts)[place]
