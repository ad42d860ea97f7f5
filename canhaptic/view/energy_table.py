"""Tables of a run for a terminal, from the dictionary that `run --json` prints: `run --full` and `inspect`."""

import textwrap
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Final

from rich.console import Group, RenderableType
from rich.text import Text

from canhaptic.axis_units import counted, damping_unit, effort_unit, place, si
from canhaptic.control.verdict import BY_CONSTRUCTION, PASSIVE_TOLERANCE, Verdict
from canhaptic.quantities import ACCOUNT, TRUTH
from canhaptic.view.run_lines import (
    Result,
    account_lines,
    failure_text,
    first_active,
    heading,
    headlines,
    line,
    losses,
    mass_text,
    ordered,
    rests_on,
    uncertainty,
)  # fmt: skip
from canhaptic.view.table import Cell, Styled, Table, in_lines

_HEAD_WIDTH: Final = 18  # of the name of a port above its figures; longer ones go on in the next line
_NOTHING: Final = "-   "
_NOT_KNOWN: Final = "not known   "

_VERDICTS: Final[dict[Verdict, Styled]] = {
    "yes": Styled("yes   ", "bold green"),
    "in doubt": Styled("in doubt   ", "bold yellow"),
    "no": Styled("NO   ", "bold red"),
}
_ROUNDING: Final = 1e-9
"""Fraction of the largest damping below which the least damping is shown as 0."""
_Shown = str | Callable[[Result], str | Styled]
_CONTACTS_SHOWN: Final = 8
_EVENTS_SHOWN: Final = 20
_EVENTS_TOLD: Final = 4  # on one screen
_LINE: Final = 98  # letters of an event on one screen
_NAME_WIDTH: Final = 24  # of a text where two logs are shown; a longer one goes on in the next line


def energy_report(*results: Result) -> RenderableType:
    """Return the first line of each port, energy table, timing line, link line and method line of a run.

    Args:
        results: Accounts of one run or of several, which share the table.
    """
    parts: list[RenderableType] = []
    for result in results:
        said = headlines(result) if result.get("cycles", 1) else [Text(" the log holds no cycle", style="bold red")]
        parts += [*([_header(result)] if "file" in result else []), *said, *account_lines(result), heading(result)]
    if any(result.get("ports") and result.get("cycles", 1) for result in results):
        table = energy_table(*results)
        if len(results) > 1:  # short lines, so that the columns fit next to each other
            table = replace(table, rows=[[_in_lines(cell) for cell in row] for row in table.rows])
        parts.append(table)
    for result in results:
        if not result.get("cycles", 1):
            continue
        parts += [Text(f" {result['file']}")] if len(results) > 1 else []
        parts += [line(name, result[name]) for name in ("timing", "link", "method") if result.get(name)]
    return Group(*parts)


def energy_table(*results: Result) -> Table:
    """Return the account of every port of one run or of several, one column each, as `run --json` prints it.

    A log that holds no cycle has no column.
    """
    places = [(result, name) for result in results if result.get("cycles", 1) for name in ordered(result["ports"])]
    ports = [result["ports"][name] for result, name in places]
    heads = [in_lines(name, _HEAD_WIDTH) for _, name in places]
    if len(results) > 1:
        files = (in_lines(Path(result["file"]).name, _HEAD_WIDTH) for result, _ in places)
        heads = [f"{file}\n{head}" for file, head in zip(files, heads, strict=True)]
    rows = list(_port_rows(ports).values())
    rows += _count_rows(ports, "branches", lambda name: _BRANCHES.get(name, f"cycles {name}"))
    for key in _IF_ANY:
        if any(port.get(key) for port in ports):
            rows.append([ACCOUNT[key].title, *(_cell(key, port) for port in ports)])
    rows += _count_rows(ports, "limits", "cycles limited by: {}".format)
    truths = [(result.get("truth") or {}).get(name, {}) for result, name in places]
    if any(truths):
        rows.append([])
        rows += [[row.title, *(_cell(key, truth) for truth in truths)] for key, row in TRUTH.items()]
    return Table("", ["energy account", *heads], rows, keys=1)


def _port_rows(ports: Sequence[Result]) -> dict[str, list[Cell]]:
    """Return the rows of ports by the name of the figure, but for those that no port has."""
    rows = dict[str, list[Cell]]()
    for name, (title, cell) in PORT_ROWS.items():
        rows[name] = [title, *(_cell(cell, port) for port in ports)]
    return {name: row for name, row in rows.items() if any(cell != _NOTHING for cell in row[1:])}


def _in_lines(cell: Cell) -> Cell:
    return in_lines(cell, _NAME_WIDTH) if type(cell) is str else cell


def _cell(cell: _Shown, port: Result) -> str | Styled:
    try:
        if not isinstance(cell, str):
            return cell(port)
        first, _, rest = cell.partition(".")
        value = port[first][rest] if rest else port[first]
        return _NOT_KNOWN if value is None else energy(value)
    except (KeyError, TypeError):  # an axis in a group, another version, or a quantity that this run did not have
        return _NOTHING


def _count_rows(ports: Sequence[Result], key: str, label: Callable[[str], str]) -> list[list[Cell]]:
    """Return a row for each kind of event that was counted at any port."""
    names = dict.fromkeys(name for port in ports for name, count in port.get(key, {}).items() if count)
    return [
        [label(name), *(f"{port[key].get(name, 0)}   " if port.get(key) else _NOTHING for port in ports)]
        for name in names
    ]


def energy(value: float) -> str:
    """Return an energy [J] as text, with the unit padded so that the numbers of a column line up."""
    number, _, unit = si(value, "J").partition(" ")
    return f"{number} {unit:<2}"


def _margin(port: Result) -> Styled:
    margin, at = port["margin"]["value"], port["margin"]["time"]
    place = f" at {at:.4g} s   " if margin < 0.0 else ", never negative"
    return Styled(f"{si(margin, 'J')}{place}", "green" if margin >= -PASSIVE_TOLERANCE else "red")


def _hold(port: Result) -> str:
    return _NOTHING if port["hold"] == BY_CONSTRUCTION else f"{port['hold']}   "


def _silent(port: Result) -> str | Styled:
    """Return the number of cycles in contact without torque; in red if it is all of them, as nothing was rendered."""
    contact = port["contact"]
    if contact["holds"] and contact["without_torque"] == contact["holds"]:
        return Styled("all   ", "bold red")
    return f"{contact['without_torque']} of {contact['holds']}   " if contact["holds"] else _NOTHING


def _resolution(port: Result) -> str:
    """Return the largest possible error of the account's energy."""
    resolution = port["energy_resolution"]
    if resolution and port.get("books_least"):
        return f"{uncertainty(port)}   "
    return f"+-{energy(resolution)}" if resolution else "rounding error only   "


def _certificates(port: Result) -> str:
    names = port.get("certificates", [port["certificate"]])
    return f"{rests_on(*names, hand_force=port.get('hand_force'))}   " if names else "no torque   "


def _damping(port: Result) -> str:
    rendered = port["damping_rendered"]
    unit = damping_unit(port["unit"])
    if rendered["most"] is None:
        return _NOT_KNOWN
    least, most = f"{rendered['least']:.3g}", f"{rendered['most']:.3g}"
    if abs(rendered["least"]) < _ROUNDING * rendered["most"]:
        least = "0"
    return f"{most} {unit}" if least == most else f"{least}..{most} {unit}"


def _friction(port: Result) -> str | Styled:
    """Return the force by which the motion exceeded what the declared friction and hand permit."""
    excess = port["friction_excess"]
    return Styled(f"{excess:.3g} {effort_unit(port['unit'])}   ", "bold red") if excess else "none   "


_IF_ANY: Final = ("energy_allowance", "supplied", "uncertainty")
"""Rows shown if not zero."""
_BRANCHES: Final = {
    "free": "cycles out of contact", "start": "cycles at the start of a contact",
    "exit": "cycles at the end of a contact",
    "exact": "cycles in contact, energy balanced exactly", "fallback": "cycles in contact, energy not balanced",
    "sticky": "cycles that held back a hand moving out", "depleted": "cycles limited by an empty energy budget",
    "held": "cycles without a new position",
}  # fmt: skip
"""Name of a branch of the algorithm -> label of its row."""
_CELLS: Final[dict[str, _Shown]] = {
    **dict.fromkeys(("in", "out", "dissipated", "stored"), ""),
    "surplus": "surplus.end",
    "surplus.max": "surplus.max",
    **dict.fromkeys(("recovered", "leaked", "deficit", "least_interaction"), ""),
    "first_active": lambda port: f"{first_active(port)}   ",
    "passive": lambda port: _VERDICTS[port["passive"]],
    "least_at_handle": "",
    "passive_at_handle": lambda port: _VERDICTS[port["passive_at_handle"]],
    "margin": _margin,
    "damping_rendered": _damping,
    "rendered.damping": lambda port: f"{100.0 * port['rendered']['damping']:.3g} %   ",
    "rendered.stiffness": lambda port: f"{100.0 * port['rendered']['stiffness']:.3g} %   ",
    "mass": lambda port: f"{mass_text(port)}   ",
    "contact.without_torque": _silent,
    "energy_resolution": _resolution,
    "longest_hold": lambda port: f"{counted(port['longest_hold'], 'cycle')}   ",
    "uncommanded_cycles": lambda port: f"{port['uncommanded_cycles'] or '-'}   ",
    "friction_excess": _friction,
    "algorithm": lambda port: f"{port['algorithm']}   ",
    "certificates": _certificates,
    "hold": _hold,
}
PORT_ROWS: Final = {name: (ACCOUNT[name].title, cell or name) for name, cell in _CELLS.items()}
"""Title of each row by its name, and the path of an energy in the account or a function that formats a figure."""


_BRIEF: Final = ("in", "out", "dissipated", "stored", "surplus", "least_interaction", "first_active", "margin",
                 "rendered.stiffness", "mass", "energy_resolution", "certificates")  # fmt: skip
"""Rows of a table that fits on a screen."""


def brief_table(*results: Result) -> Table:
    """Return the rows of the energy table that say most; of several ports in one run each is a row."""
    whole = energy_table(*results)
    places = [(result, name) for result in results if result.get("cycles", 1) for name in ordered(result["ports"])]
    known = _port_rows([result["ports"][name] for result, name in places])
    if len(results) == 1 < len(places):
        shown = [name for name in known if ACCOUNT[name].short]
        cells = zip(*(known[name][1:] for name in shown), strict=True)
        rows: list[list[Cell]] = [[name, *of] for (_, name), of in zip(places, cells, strict=True)]
        return Table("", [whole.columns[0], *(ACCOUNT[name].short for name in shown)], rows, keys=1)
    return replace(whole, rows=[known[name] for name in _BRIEF if name in known])


def _brief(result: Result) -> Iterator[RenderableType]:
    """Yield what `inspect` found of each port, as far as it fits on a screen."""
    runs = [result, *result.get("others", ())]
    for run in runs:
        said = headlines(run) if run.get("cycles", 1) else [Text(" the log holds no cycle", style="bold red")]
        first = [_header(run)] if "file" in run else []
        yield from (*first, *said, *account_lines(run), heading(run), *losses(run))
    if any(run.get("ports") and run.get("cycles", 1) for run in runs):
        yield brief_table(*runs)
    for run in runs:
        file = _file_of(run, runs)
        for name, contacts in run.get("contacts", {}).items():
            if contacts:
                yield Text(f"{file} {name}: {_hardest(contacts, run['ports'][name])}")
        told = _told(run)
        for event in told[:_EVENTS_TOLD]:
            kind = event["kind"].replace("unrestored", "not restored")
            words = f"{file} {event['time']:.4f} s {' '.join(filter(None, (kind, event['port'])))}: {event['text']}"
            yield Text(f" {textwrap.shorten(words, _LINE, placeholder=' ...')}")
        if len(told) > _EVENTS_TOLD:
            yield Text(f"{file} and {counted(len(told) - _EVENTS_TOLD, 'further event')}")
    if checks := _checks_table(result.get("checks", [])).rows:
        yield replace(_checks_table(result["checks"]), rows=checks)


def _hardest(contacts: Sequence[Result], port: Result) -> str:
    """Return the number of contacts, and the one with the largest torque."""
    number, most = max(enumerate(contacts, 1), key=lambda contact: contact[1]["peak_torque"])
    force = si(most["peak_torque"], effort_unit(port["unit"]), 3)
    which = f"the hardest, number {number}, " if len(contacts) > 1 else ""
    when = f"at {most['start']:.4f} s: {force} for {si(most['duration'], 's', 3)}"
    return f"{counted(len(contacts), 'contact')}, {which}{when}"


def inspection_report(result: Result, *, full: bool = True) -> RenderableType:
    """Return what `inspect` found, for a terminal.

    Args:
        result: Account of a run, with what was found in its log.
        full: Whether to show every figure, contact and event, not what fits on a screen.
    """
    runs = [result, *result.get("others", ())]
    parts: list[RenderableType] = [energy_report(*runs)] if full else list(_brief(result))
    parts += [_finding_line(finding, _file_of(run, runs)) for run in runs for finding in run.get("findings", ())]
    parts += inspection_tables(result) if full else []
    parts += [_recomputed_line(port) for port in result.get("recomputed", ())]
    parts += [Text(f" {remark}") for remark in result.get("rederived", result).get("remarks", ())]
    if "rederived" in result:
        parts.append(_rederived_line(result["rederived"]))
    if "comparison" in result:
        parts.append(_comparison(result["comparison"]))
    return Group(*parts, *([] if full else [Text(" every figure, contact and event: --full", style="dim")]))


def inspection_tables(result: Result) -> list[Table]:
    """Return the tables of contacts, events and checks that have rows."""
    tables = []
    runs = [result, *result.get("others", ())]
    for run in runs:
        file = _file_of(run, runs)
        for name, contacts in run.get("contacts", {}).items():
            port = run["ports"][name]
            unit = port["unit"]
            depth = partial(place, unit=port.get("state_unit", unit), in_degrees=port.get("in_degrees", False))
            tables.append(_contacts_table(f"{file} {name}", contacts, unit, depth))
        tables.append(_events_table(_told(run), file))
    tables.append(_checks_table(result.get("checks", [])))
    return [table for table in tables if table.rows]


def _told(run: Result) -> list[Result]:
    """Return the events that a reader of a log should know of."""
    left = "unrestored" if run.get("truth") else ""  # in a simulated drive, which is gone
    return [event for event in run.get("events", []) if event["kind"] != left and not _is_known(event, run["ports"])]


def _is_known(event: Result, ports: Result) -> bool:
    """Return whether an event only says that a simulated drive acts in the hold which its scene declares."""
    port = ports.get(event["port"], {})
    return bool(event["kind"] == "hold" and ports.get(port.get("group"), port).get("hold") == BY_CONSTRUCTION)


def _file_of(run: Result, runs: Sequence[Result]) -> str:
    """Return the name of a run's log, where there are several."""
    return f" {Path(run['file']).name}" if len(runs) > 1 else ""


def _header(result: Result) -> Text:
    text = Text(" FAILED: ", style="bold red") if failure_text(result) else Text(" ")
    span = f"{si(result['rate'], 'Hz', 3)}   {result['from']:.6g} s to {result['to']:.6g} s"
    return text.append(f"{result['file']}   {span}", style="default")


def _contacts_table(name: str, contacts: Sequence[Result], unit: str, depth: Callable[[float], str]) -> Table:
    hardest = sorted(enumerate(contacts, 1), key=lambda contact: -contact[1]["peak_torque"])[:_CONTACTS_SHOWN]
    shown = f", the {_CONTACTS_SHOWN} hardest" if len(contacts) > _CONTACTS_SHOWN else ""
    rows: list[list[Cell]] = [
        [
            number, f"{contact['start']:.4f} s", si(contact["duration"], "s"),
            "not known" if contact["depth"] is None else depth(contact["depth"]),
            si(contact["peak_torque"], effort_unit(unit)), energy(contact["energy"]),
        ]
        for number, contact in sorted(hardest, key=lambda contact: contact[0])
    ]  # fmt: skip
    title = f"{name}: {counted(len(contacts), 'contact')}{shown}"
    return Table(title, ("contact", "start", "duration", "depth", "peak", "net energy in"), rows, keys=1)


def _events_table(events: Sequence[Result], file: str = "") -> Table:
    more = f", the first {_EVENTS_SHOWN}" if len(events) > _EVENTS_SHOWN else ""
    rows: list[list[Cell]] = [
        [
            f"{event['time']:.4f} s", event["sync_index"], event["kind"].replace("unrestored", "not restored"),
            event["port"], event["text"],
        ]
        for event in events[:_EVENTS_SHOWN]
    ]  # fmt: skip
    title = f"{file and file + ':'} {counted(len(events), 'event')}{more}"
    return Table(title, ("time", "cycle", "kind", "port", "what"), rows)


def _checks_table(checks: Sequence[Result]) -> Table:
    logs = [[Path(check["log"]).name] if "log" in check else [] for check in checks]
    rows: list[list[Cell]] = [
        [
            *log, check["check"], check["name"], _checked(check),
            Styled("holds", "green") if check["holds"] else Styled("FAILS", "bold red"),
        ]
        for log, check in zip(logs, checks, strict=True)
    ]  # fmt: skip
    return Table(" checks", (*(["log"] if any(logs) else []), "check", "value of", "is", ""), rows)


def _checked(check: Result) -> str:
    if check["value"] == "no contact":
        return "no contact, so nothing was tested"
    unit = f" {check['unit']}" if check.get("unit", "1") != "1" else ""
    since = f", first below zero at {check['first_active']:.4g} s" if "first_active" in check else ""
    return f"{check['value']}{since}" if isinstance(check["value"], str) else f"{check['value']:.9g}{unit}"


def _finding_line(finding: Result, file: str) -> Text:
    rows = f"{counted(finding['rows'], 'row')} {'is' if finding['rows'] == 1 else 'are'}"
    words = f"{file} {finding['dataset']}: {rows} {finding['what']}, first in cycle {finding['cycle']}"
    return Text(words, style="bold red")


def _recomputed_line(recomputed: Result) -> Text:
    mismatch, words = recomputed["mismatch"], f" {recomputed['port']}: recomputed"
    if mismatch is not None:
        words += f" {mismatch['quantity']} of cycle {mismatch['cycle']} is {mismatch['recomputed']!r}"
        return Text(f"{words}, but {mismatch['logged']!r} in the log", style="bold red")
    if not recomputed["unchecked_rows"]:
        return Text(f"{words}, every output equal bit for bit", style="green")
    behind = "a SYNC was skipped; only the bus log has the length of that hold: add --bus-log"
    if recomputed["missing_rows"]:
        missing = recomputed["missing_rows"]
        behind = f"{counted(missing, 'row')} {'is' if missing == 1 else 'are'} missing"
    words = f" {recomputed['port']}: the first {counted(recomputed['rows'], 'cycle')} recomputed, equal bit for bit"
    return Text(f"{words}; then {behind}", style="bold red")


def _rederived_line(rederived: Result) -> Text:
    if not rederived["differences"]:
        cycles = counted(rederived["cycles"], "cycle")
        words = f" from the frames alone: {cycles}, samples and account equal bit for bit"
        return Text(words, style="green")
    lines = (
        f" {found['port']}: from the frames, {found['quantity']} of cycle {found['cycle']} is {found['rederived']!r}, "
        f"but {found['logged']!r} in the log"
        for found in rederived["differences"]
    )
    return Text("\n".join(lines), style="bold red")


def _comparison(comparison: Result) -> RenderableType:
    first, second = comparison["rows"]
    if comparison["identical"]:
        return Text(f" identical: {counted(first, 'cycle')}, every quantity equal bit for bit", style="green")
    cycles = f"{first} and {counted(second, 'cycle')}" if first != second else f"both have {counted(first, 'cycle')}"
    parts: list[RenderableType] = [Text(f" different: {cycles}", style="bold red")]
    if comparison["missing"]:
        parts.append(Text(f" only in one of them: {', '.join(comparison['missing'])}"))
    rows: list[list[Cell]] = [
        [
            in_lines(found["name"], _NAME_WIDTH), found["cycle"], f"{found['first']:.9g}", f"{found['second']:.9g}",
            f"{found['largest']:.3g}" + ("" if found["unit"] == "1" else f" {found['unit']}"),
        ]
        for found in comparison["differences"]
    ]  # fmt: skip
    if rows:
        title = f" {len(rows)} quantit{'y differs' if len(rows) == 1 else 'ies differ'}"
        parts.append(Table(title, ("quantity", "cycle", "first log", "second log", "largest difference"), rows, keys=1))
    return Group(*parts)
