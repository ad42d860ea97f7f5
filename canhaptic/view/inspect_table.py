"""What `canhaptic inspect` prints: header, energy table, contacts, events, checks, comparison."""

from typing import TYPE_CHECKING, Final

from rich.console import Group, RenderableType
from rich.text import Text

from canhaptic.audit.inspection import ContactStretch, LogComparison, LoggedEvent
from canhaptic.audit.port_record import ImpossibleValue
from canhaptic.audit.recompute import Recomputed
from canhaptic.audit.user_checks import Outcome
from canhaptic.axis_units import effort_unit
from canhaptic.view.energy_table import energy, energy_report
from canhaptic.view.run_lines import Result
from canhaptic.view.si import counted, si
from canhaptic.view.table import Cell, Styled, Table, in_lines

if TYPE_CHECKING:
    from canhaptic.audit.rederive import Rederived

_CONTACTS_SHOWN: Final = 8
_EVENTS_SHOWN: Final = 20
_NAME_WIDTH: Final = 24  # of a quantity; longer ones go on in the next line


def inspection_report(result: Result) -> RenderableType:
    """Return everything that `inspect` found, for a terminal."""
    parts: list[RenderableType] = [_header(result)] if "file" in result else []
    parts.append(energy_report(result))
    parts += [_finding_line(finding) for finding in result.get("findings", ())]
    parts += inspection_tables(result)
    for mismatch in result.get("recomputed", []):
        parts.append(_recomputed_line(mismatch))
    if "rederived" in result:
        parts.append(_rederived_line(result["rederived"]))
    for other in result.get("others", ()):
        parts += [Text(), _header(other), energy_report(other)]
    if "comparison" in result:
        parts.append(_comparison(result["comparison"]))
    return Group(*parts)


def inspection_tables(result: Result) -> list[Table]:
    """Return contacts, events and check, as far as there are any."""
    tables = []
    for name, contacts in result.get("contacts", {}).items():
        port = result["ports"][name]
        tables.append(_contacts_table(name, contacts, port["unit"], port.get("state_unit", port["unit"])))
    tables += [_events_table(result.get("events", [])), _checks_table(result.get("checks", []))]
    return [table for table in tables if table.rows]


def _header(result: Result) -> Text:
    return Text(f" {result['file']}   {si(result['rate'], 'Hz', 3)}   {result['from']:.6g} s to {result['to']:.6g} s")


def _contacts_table(name: str, contacts: list[ContactStretch], unit: str, depth_unit: str) -> Table:
    hardest = sorted(contacts, key=lambda contact: -contact["peak_torque"])[:_CONTACTS_SHOWN]
    shown = f", the {_CONTACTS_SHOWN} hardest" if len(contacts) > _CONTACTS_SHOWN else ""
    rows: list[list[Cell]] = [
        [
            f"{contact['start']:.4f} s", si(contact["duration"], "s"), si(contact["depth"], depth_unit),
            si(contact["peak_torque"], effort_unit(unit)), energy(contact["energy"]),
        ]
        for contact in sorted(hardest, key=lambda contact: contact["start"])
    ]  # fmt: skip
    title = f" {name}: {counted(len(contacts), 'contact')}{shown}"
    return Table(title, ("start", "duration", "depth", "peak", "energy taken in"), rows, keys=0)


def _events_table(events: list[LoggedEvent]) -> Table:
    more = f", the first {_EVENTS_SHOWN}" if len(events) > _EVENTS_SHOWN else ""
    rows: list[list[Cell]] = [
        [
            f"{event['time']:.4f} s", event["sync_index"], event["kind"].replace("unrestored", "not restored"),
            event["port"], event["text"],
        ]
        for event in events[:_EVENTS_SHOWN]
    ]  # fmt: skip
    title = f" {counted(len(events), 'event')}{more}"
    return Table(title, ("time", "cycle", "kind", "port", "what"), rows)


def _checked(check: Outcome) -> str:
    value = check["value"]
    if value == "no contact":
        return "no contact, so nothing was tested"
    since = f", first below zero at {check['first_active']:.4g} s" if "first_active" in check else ""
    return f"{value}{since}" if isinstance(value, str) else f"{value:.9g}"


def _checks_table(checks: list[Outcome]) -> Table:
    """Return the outcome of every check."""
    rows: list[list[Cell]] = [
        [
            check["check"], check["name"],
            _checked(check),
            Styled("holds", "green") if check["holds"] else Styled("FAILS", "bold red"),
        ]
        for check in checks
    ]  # fmt: skip
    return Table(" checks", ("check", "value of", "is", ""), rows)


def _finding_line(finding: ImpossibleValue) -> Text:
    rows = f"{finding['rows']} row{'s are' if finding['rows'] != 1 else ' is'}"
    words = f" {finding['dataset']}: {rows} {finding['what']}, first in cycle {finding['cycle']}"
    return Text(words, style="bold red")


def _recomputed_line(recomputed: Recomputed) -> Text:
    if recomputed["mismatch"] is None and recomputed["unchecked_rows"]:
        lost = f"{recomputed['missing_rows']} rows are missing"
        skipped = "a SYNC was skipped, and only the bus log has the length of its hold: add --bus-log"
        rows = counted(recomputed["rows"], "cycle")
        words = f" {recomputed['port']}: the first {rows} recomputed, equal bit for bit; after them "
        return Text(words + (lost if recomputed["missing_rows"] else skipped), style="bold red")
    mismatch = recomputed["mismatch"]
    if mismatch is None:
        return Text(f" {recomputed['port']}: recomputed, every output equal bit for bit", style="green")
    words = (
        f" {recomputed['port']}: recomputed {mismatch['quantity']} of cycle {mismatch['cycle']} is "
        f"{mismatch['recomputed']!r}, logged was {mismatch['logged']!r}"
    )
    return Text(words, style="bold red")


def _rederived_line(rederived: "Rederived") -> Text:
    if not rederived["differences"]:
        words = (
            f" from the frames alone: {counted(rederived['cycles'], 'cycle')}, samples and account bit for bit equal"
        )
        return Text(words, style="green")
    lines = (
        f" {found['port']}: from the frames, {found['quantity']} of cycle {found['cycle']} is {found['rederived']!r}, "
        f"logged was {found['logged']!r}"
        for found in rederived["differences"]
    )
    return Text("\n".join(lines), style="bold red")


def _comparison(comparison: LogComparison) -> RenderableType:
    first, second = comparison["rows"]
    if comparison["identical"]:
        return Text(f" identical: {counted(first, 'cycle')}, every quantity equal bit for bit", style="green")
    count = len(comparison["differences"])
    parts: list[RenderableType] = [Text(f" different: {first} and {counted(second, 'cycle')}", style="bold red")]
    if comparison["missing"]:
        parts.append(Text(f" only in one of them: {', '.join(comparison['missing'])}"))
    if count:
        parts.append(_differences_table(f" {count} quantit{'y differs' if count == 1 else 'ies differ'}", comparison))
    return Group(*parts)


def _differences_table(title: str, comparison: LogComparison) -> Table:
    rows: list[list[Cell]] = [
        [
            in_lines(found["name"], _NAME_WIDTH), found["cycle"], f"{found['first']:.9g}", f"{found['second']:.9g}",
            f"{found['largest']:.3g}" + ("" if found["unit"] == "1" else f" {found['unit']}"),
        ]
        for found in comparison["differences"]
    ]  # fmt: skip
    return Table(title, ("quantity", "cycle", "first log", "second log", "largest difference"), rows, keys=1)
