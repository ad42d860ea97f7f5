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

from canhaptic.axis_units import si
from canhaptic.control.verdict import PASSIVE_TOLERANCE
from canhaptic.files import scene_title
from canhaptic.lab.studies import Row
from canhaptic.lab.studies.accuracy.plant_solvers import FLOOR, LEFT_OUT, OURS
from canhaptic.lab.studies.columns import Column, columns_in, shown, table_of, texts_of
from canhaptic.sim.plant.propagator import Array
from canhaptic.view.table import Table

_WIDTH, _LABEL = 78, 15  # columns of a line, and of its label
_DOT, _KEPT = "\u00b7", "\u00a0"  # the last: a space at which no line ends
_GAP, _BETWEEN = "\t", f" {_DOT} "
LEAST_ORDER: Final = 0.5
"""Fraction of the declared order of convergence: if errors fall more slowly, no setting is advised or chosen."""
_NEARER: Final = 0.8
"""Fraction of the scene's present error: only changes with an error below it are named."""
_SHOWN: Final = 4
_KEPT_BY: Final = "guarded"
_IDLE: Final = "sends no torque"


def accuracy_report(result: Row, *, tables: bool = False) -> RenderableType:
    """Return what is said of a study and, if requested or if it has no advice, its tables, for a terminal."""
    *told, head = sections(result).values()
    if told and not tables:
        head = [*head[:2], *result["remarks"], "all tables: --tables"]
    lines = [*(line for part in told for line in (*part, "")), *head]
    shown = [Text(f" {part}") for line in lines for part in wrapped(line)]
    return Group(*shown, *(accuracy_tables(result) if tables or not told else ()))


def sections(result: Row) -> dict[str, list[str]]:
    """Return what is said of a study, by title; last, without a title, the heading of its tables."""
    told = {"Advice": advice_lines(result), "Prices": price_lines(result)} if "advice" in result else {}
    return {**told, "": heading(result)}


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
    for row in effects_of(result):
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
        what, to = change(row)
        now = f"now {result['now'].get(what, 'as it is')}: {_loop_price(base, result, what)}"
        lines.setdefault(what, [now]).append(f"{to}: {_loop_price(row, result, what)}")
    return lines


def effects_of(result: Row) -> Sequence[Row]:
    """Return the rows of the effects that were left out, the dearest first; none without advice."""
    found: Sequence[Row] = (result.get("advice") or {"effects": ()})["effects"]
    return found


def base_loop(result: Row) -> Row | None:
    """Return the row of the loop with the scene's own settings; None if that loop does not complete."""
    return next((row for row in result["loop"][:1] if row["status"] == "ok"), None)


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


def _loop_price(row: Row, result: Row, what: str) -> str:
    """Return the time of the control thread, the bus load if it differs, and the distance from the continuous axis."""
    if _renders_nothing(row):
        return _IDLE
    spent = row.get("control_thread_us")
    parts = [] if spent is None else [_time(spent)]
    if what == "sample rate":
        parts.append(f"{bus_load(row)}{'' if row['bus_fits'] else ', cycle too long'}")
    stable = row["status"] == "ok"
    parts.append(length(row["position_error"], result["unit"]) if stable else str(row["status"]))
    return ", ".join(filter(None, parts))


def bus_load(row: Row, before: str = "bus ") -> str:
    """Return the load of the bus of a row of the loop; "" for a line of EtherCAT, whose load is not computed."""
    return "" if row["bus_load"] is None else f"{before}{100.0 * row['bus_load']:.0f} %"


def _renders_nothing(row: Row) -> bool:
    return row["status"] == "ok" and row.get("largest_torque") == 0.0


def _time(microseconds: float) -> str:
    """Return a time in microseconds, with three figures."""
    return f"{microseconds:,.0f} us" if microseconds >= 100.0 else f"{microseconds:.2g} us"


def markdown(result: Row) -> str:
    """Return the report as Markdown, with every table."""
    lines = []
    for title, part in sections(result).items():
        lines += (
            [f"### {title}", "", *(f"- {plain(line)}" for line in part), ""]
            if title
            else [f"{line}  " for line in part]
        )
    return "\n".join([*lines, "", *(table.markdown() for table in accuracy_tables(result, wide=True)), ""])


def plain(line: str) -> str:
    """Return a line with a colon after its label."""
    return line.replace(_GAP, ": ")


def heading(result: Row) -> list[str]:
    """Return the heading: the part studied, and its reference."""
    lines = [
        f"{scene_title(result['scene'])}, {result['axis']}: {result['holds']} sample times at "
        f"{si(result['rate'], 'Hz', 3)}, {result['status']}",
        *_reference_lines(result),
    ]
    if work := result.get("workload"):
        lines.append(f"fixed workload of this run: {si(work['seconds'], 's', 3)} ({work['what']})")
    if result.get("log_us") is not None:
        cost = f"{result['log_us']:.1f} us" if result["log_us"] else "less than the spread of its measurement"
        lines.append(f"the energy log costs the control thread {cost} a cycle")
    engines = {row["engine"].partition(":")[0] for row in result["loop"] if "engine" in row}
    if engines:
        lines.append(f"the loops ran in {' and '.join(sorted(engines))}")
    return [*lines, *result.get("remarks", ())]


def _reference_lines(result: Row) -> list[str]:
    """Return what the errors are errors against, and how certain that is."""
    reference, unit = result["reference"], result["unit"]
    if not reference:
        return []
    if "method" not in reference:
        against = (
            f"errors against an ideal display: travel {si(reference['travel'], unit)}, "
            f"energy {si(reference['energy'], 'J')}; certain to about {si(reference['apart'], unit, 2)}"
        )
        return [against, *(f"simulated plant of {row['axis']}: {_plant_words(row, unit)}" for row in result["plant"])]
    witness, agreement = reference["witness"], reference["rank_agreement"]
    apart = "" if witness is None else f"; {witness['method']}: {length(witness['apart'], unit)} apart"
    lines = [f"reference: {reference['method']}; travel {length(reference['travel'], unit)}{apart}"]
    if agreement is not None:
        lines.append(f"evaluations of the equations of motion rank like time: Spearman {agreement:.2f}")
    return lines


def _plant_words(row: Row, unit: str) -> str:
    """Return the errors of a plant that was run by one method, or why it was not compared."""
    if row["status"] != "ok":
        return str(row["status"])
    energy = f", energy {si(row['energy_error'], 'J', 2)}" if "energy_error" in row else ""
    return f"errors against DOP853: position {si(row['position_error'], unit, 2)}{energy}"


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
        alike = (of for of in result["loop"] if change(of)[0] == change(row)[0])
        finer = [of for of in alike if (of["fineness"] or 0.0) > row["fineness"]]
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
    what, to = change(row)
    if what == "algorithm" and base["setting"] == _KEPT_BY:
        out = f"{out}, leaves {_KEPT_BY} and its guarantee"
    price = ", ".join(filter(None, (length(row["position_error"], unit), bus_load(row))))
    return f"{what}: {to} ({price}{out})"


def _without_effect(result: Row) -> set[str]:
    """Return the algorithms whose run is that without protection to the last digit: they did nothing."""
    ran = (row for row in result["loop"] if row["status"] == "ok")
    rows = [row for row in ran if row["is_scene"] or change(row)[0] == "algorithm"]
    plain = next((row for row in rows if row["setting"] == "unprotected"), None)
    keys = ("position_error", "force_error", "energy_error", "largest_torque", "energy_given_out")
    return {row["setting"] for row in rows if plain and all(row[key] == plain[key] for key in keys)}


def _error(row: Row) -> float:
    return float(row["position_error"])


def _most_exact(rows: Sequence[Row]) -> Row | None:
    return min((row for row in rows if row["status"] == "ok"), key=_error, default=None)


def length(value: float, unit: str) -> str:
    """Return a position or length as text with its unit."""
    return shown(value, "m", unit)


_ERRORS: Final = (
    Column("position", "position"), Column("force", "force_error", "N"), Column("energy", "energy_error", "J"),
)  # fmt: skip
_PLANT: Final = (
    Column("method", "method"), Column("setting", "setting"), *_ERRORS,
    Column("evals /\nperiod", "evaluations_per_period", ".2f"), Column("events", "events"),
    Column("us /\nperiod", "us_per_period", ".4g"), Column("times\nwork", "ratio", ".3g"), Column("", "mark"),
)  # fmt: skip
_WIDE: Final = (
    Column("processor time per simulated s", "cpu_per_second", "s"), Column("largest over least", "spread", "+%"),
)  # fmt: skip
_ORDERS: Final = Column("method", "method"), Column("declared", "declared"), Column("fitted", "fitted", ".2f")
_EFFECTS: Final = (
    Column("left out", "effect"), Column("order", "order"), *_ERRORS,
    Column("evals\nsaved", "evaluations_saved_per_period", ".2f"), Column("us\nsaved", "us_saved_per_period", ".3g"),
    Column("error\nper us", "error_per_microsecond", "m"),
)  # fmt: skip
_DRAWN: Final = (
    Column("control\nthread", "control_thread_us", "us"), Column("bus\nload", "bus"),
    Column("mass felt", "mass_felt", "kg"), Column("given out", "given_out", "J"),
)  # fmt: skip
"""Columns of the loop that the picture writes next to the errors."""
_LOOP: Final = (
    Column("changed", "changed"), Column("to", "to"), *_ERRORS, Column("energy\nunsure", "energy_uncertainty", "J"),
    _DRAWN[0], Column("of T", "thread_share", "%"), *_DRAWN[1:], Column("guard acts", "guard_acts", "%"),
    Column("us per\ncycle", "us_per_cycle", ".0f"),
)  # fmt: skip


def accuracy_tables(result: Row, *, wide: bool = False) -> list[Table]:
    """Return every table; `wide` adds the time per simulated second and its spread to the table of the plant."""
    unit, floor = result["unit"], _floor(result)
    plant = [_plant_row(row, unit, floor) for row in result["plant"] if "method" in row]
    orders = [{**of, "declared": _order(of["declared"])} for of in result.get("orders", ())]
    effects = [_effect_row(of, unit) for of in effects_of(result)]
    loop = [] if all(map(_renders_nothing, result["loop"])) else [_loop_row(row, unit) for row in result["loop"]]
    to = "the continuous-time loop" if "advice" in result else "the ideal display"
    mark = "; !: cycle too long" if any("bus" in row for row in loop) else ""
    front = "bold and *: Pareto front of evaluations, the same on every machine"
    found = [
        table_of(f" plant: largest error at any SYNC; {front}", _PLANT + _WIDE * wide, plant, unit, 2, "pareto"),
        table_of(" order of the error in the step", _ORDERS, orders, unit, 2),
        table_of(" effects: what leaving one out does", _EFFECTS, effects, unit, 2),
        table_of(f" loop: largest difference from {to}, one thing changed{mark}", _LOOP, loop, unit, 2, "is_scene"),
    ]
    return [table for table in found if table.rows]


def _floor(result: Row) -> float:
    """Return the error of the position that counts as zero [m or rad]."""
    return FLOOR * float(result["reference"]["travel"]) if result["reference"] else 0.0


def _position(row: Row, unit: str, floor: float) -> str:
    """Return the error of the position, or at most the floor [m or rad], below which all count as equal."""
    return f"<= {length(floor, unit)}" if row["position_error"] <= floor else length(row["position_error"], unit)


def _plant_row(row: Row, unit: str, floor: float) -> Row:
    """Return a row of the ladder as its table shows it."""
    if row["status"] != "ok":
        return {"method": row["method"], "setting": row["setting"], "position": row["status"].partition(":")[0]}
    known = {"events": row["events"] if row["accuracy"] else None, "mark": "*" if row["pareto"] else None}
    return {**row, **known, "position": _position(row, unit, floor)}


def _effect_row(row: Row, unit: str) -> Row:
    """Return the row of an effect as its table shows it."""
    if row.get("position_error") is None:
        return {"effect": row["effect"], "order": "-"}
    return {**row, "order": _order(row["order"]), "position": length(row["position_error"], unit)}


def _loop_row(row: Row, unit: str) -> Row:
    """Return a row of the loop as table and picture show it."""
    what, to = change(row)
    found = {**row, "changed": what, "to": to}
    if "bus_load" in row:
        found["bus"] = f"{bus_load(row, '')}{'' if row['bus_fits'] else ' !'}"
    if _renders_nothing(row):
        return {**found, "position": _IDLE, "force_error": None, "energy_error": None}
    error = row.get("position_error")
    return {**found, "position": str(row["status"]).partition(":")[0] if error is None else length(error, unit)}


def change(row: Row) -> tuple[str, str]:
    """Return what a row of the loop changes, and to what; with why a run that has errors ended early."""
    is_short = row["status"] != "ok" and row.get("position_error") is not None
    return row["group"], f"{row['setting']} (ended: {row['status'][:40]})" if is_short else row["setting"]


def beside_errors(rows: Sequence[Row], unit: str) -> tuple[str, list[str]]:
    """Return what a picture writes next to the errors of the loop: its heading, and the text of each row."""
    known = [_loop_row(row, unit) for row in rows]
    drawn = columns_in(_DRAWN, known)
    texts = [", ".join(filter(None, texts_of(drawn, row, unit))) for row in known]
    return ", ".join(column.head.replace("\n", " ") for column in drawn), texts


def _order(value: int | None) -> str:
    return "exact" if value is None else str(value)


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
