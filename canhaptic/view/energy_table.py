"""Every figure of the account of a run as a table, from the same dictionary that `run --json` prints."""

from collections.abc import Callable, Sequence
from typing import Final

from rich.console import Group, RenderableType

from canhaptic.axis_units import damping_unit, effort_unit
from canhaptic.control.verdict import PASSIVE_TOLERANCE, Verdict
from canhaptic.view.run_lines import Result, first_active, guaranteed_for, heading, headlines, line, mass_text, ordered
from canhaptic.view.si import counted, si
from canhaptic.view.table import Cell, Styled, Table, in_lines

_HEAD_WIDTH: Final = 18  # of the name of a port above its figures; longer ones go on in the next line
_NOTHING: Final = "-   "

_VERDICTS: Final[dict[Verdict, Styled]] = {
    "yes": Styled("yes   ", "bold green"),
    "in doubt": Styled("in doubt   ", "bold yellow"),
    "no": Styled("NO   ", "bold red"),
}
_ROUNDING: Final = 1e-9
"""Part of the largest damping below which the least is none."""


def energy_report(result: Result) -> RenderableType:
    """Return the first line of each port, energy table, timing line, link line and method line of a run."""
    parts = [*headlines(result), heading(result)]
    if result.get("ports"):
        parts.append(energy_table(result))
    for name in ("timing", "link", "method"):
        if result.get(name):
            parts.append(line(name, result[name]))
    return Group(*parts)


def energy_table(result: Result) -> Table:
    """Return the account of every port, one column each, as `run --json` prints it."""
    names = ordered(result["ports"])
    ports = [result["ports"][name] for name in names]
    rows: list[list[Cell]] = [[label, *(_cell(cell, port) for port in ports)] for label, cell in _PORT_ROWS]
    rows = [row for row in rows if any(cell != _NOTHING for cell in row[1:])]
    rows += [
        [_BRANCHES.get(branch, f"cycles {branch}"), *(_count_text(port, "branches", branch) for port in ports)]
        for branch in _counted(ports, "branches")
    ]
    rows += [
        [label, *(_cell(_plain(of_group), port) for port in ports)]
        for of_group, label in _OF_GROUPS.items()
        if any(port.get(of_group) for port in ports)
    ]
    rows += [
        [f"cycles limited by: {limit}", *(_count_text(port, "limits", limit) for port in ports)]
        for limit in _counted(ports, "limits")
    ]
    truth = result.get("truth") or {}
    if any(name in truth for name in names):
        rows.append([])
        rows += [
            [label, *(_cell(true, truth[name]) if name in truth else "-" for name in names)]
            for label, true in _TRUTH_ROWS
        ]
    return Table("", ["energy account", *(in_lines(name, _HEAD_WIDTH) for name in names)], rows, keys=1)


def _cell(cell: Callable[[Result], str | Styled], port: Result) -> str | Styled:
    try:
        return cell(port)
    except (KeyError, TypeError):  # an axis in a group, another version, or a quantity that this run did not have
        return _NOTHING


def _counted(ports: Sequence[Result], key: str) -> list[str]:
    """Return the names of the events at any port."""
    return list(dict.fromkeys(name for port in ports for name, count in port.get(key, {}).items() if count))


def _count_text(port: Result, key: str, name: str) -> str:
    return f"{port[key].get(name, 0)}   " if port.get(key) else _NOTHING


def energy(value: float) -> str:
    """Return an energy [J] with its unit padded, so that numbers in a column line up."""
    number, _, unit = si(value, "J").partition(" ")
    return f"{number} {unit:<2}"


def _margin(port: Result) -> Styled:
    margin, at = port["margin"]["value"], port["margin"]["time"]
    place = f" at {at:.4g} s   " if margin < 0.0 else ", never negative"
    return Styled(f"{si(margin, 'J')}{place}", "green" if margin >= -PASSIVE_TOLERANCE else "red")


def _uncommanded(port: Result) -> str:
    count = port.get("uncommanded_cycles", 0)
    return f"{count}   " if count else _NOTHING


def _share(name: str) -> Callable[[Result], str]:
    def share(port: Result) -> str:
        part = port["rendered"][name]
        return _NOTHING if part is None else f"{100.0 * part:.3g} %   "

    return share


def _silent(port: Result) -> str | Styled:
    """Return how many holds of contact had no torque; a wall that renders nothing is absent."""
    contact = port["contact"]
    if contact["holds"] and contact["without_torque"] == contact["holds"]:
        return Styled("all   ", "bold red")
    return f"{contact['without_torque']} of {contact['holds']}   " if contact["holds"] else _NOTHING


def _resolution(port: Result) -> str:
    """Return how far the booked energy may be from the true one."""
    resolution = port["energy_resolution"]
    return f"+-{energy(resolution)}" if resolution else "rounding error only   "


def _certificates(port: Result) -> str:
    names = port.get("certificates", [port["certificate"]])
    return f"{guaranteed_for(*names)}   " if names else "no torque   "


def _damping(port: Result) -> str:
    rendered = port["damping_rendered"]
    unit = damping_unit(port["unit"])
    least, most = f"{rendered['least']:.3g}", f"{rendered['most']:.3g}"
    if abs(rendered["least"]) < _ROUNDING * rendered["most"]:
        least = "0"
    return f"{most} {unit}" if least == most else f"{least}..{most} {unit}"


def _surplus(which: str) -> Callable[[Result], str]:
    return lambda port: energy(port["surplus"][which])


def _friction(port: Result) -> str | Styled:
    """Return by how much an axis was faster than declared friction and hand permit."""
    excess = port["friction_excess"]
    return Styled(f"{excess:.3g} {effort_unit(port['unit'])}   ", "bold red") if excess else "none   "


def _plain(name: str) -> Callable[[Result], str]:
    return lambda port: energy(port[name])


_OF_GROUPS: Final[dict[str, str]] = {
    "supplied": "input from moving surfaces",
    "unsure": "uncertainty, taken off `in`",
}
"""Rows that only a group may have, shown where they are not zero."""
_BRANCHES: Final = {
    "free": "cycles out of contact", "start": "cycles that began a contact", "exit": "cycles that ended a contact",
    "exact": "cycles with the energy balance solved", "fallback": "cycles without a solution of the balance",
    "sticky": "cycles moving out, energy still coming in", "depleted": "cycles limited by an empty energy budget",
    "held": "cycles without a new position",
}  # fmt: skip
"""Rows of the counted branches."""
_PORT_ROWS: Final[tuple[tuple[str, Callable[[Result], str | Styled]], ...]] = (
    ("in", _plain("in")),
    ("out", _plain("out")),
    ("dissipated", _plain("dissipated")),
    ("stored at the end", _plain("stored")),
    ("energy created by sampling, not yet removed", _surplus("end")),
    ("  at its peak", _surplus("max")),
    ("recovered by the damper", _plain("recovered")),
    ("stored energy not returned", _plain("leaked")),
    ("energy returned beyond what was stored", _plain("deficit")),
    ("lowest net energy (in - out), at the motor", _plain("least_interaction")),
    ("  first below zero at", lambda port: f"{first_active(port)}   "),
    ("passive at the motor", lambda port: _VERDICTS[port["passive"]]),
    ("lowest net energy (in - out), at the handle", _plain("least_at_handle")),
    ("passive at the handle", lambda port: _VERDICTS[port["passive_at_handle"]]),
    ("smallest margin", _margin),
    ("damping rendered", _damping),
    ("damping rendered, of requested", _share("damping")),
    ("stiffness rendered, of requested", _share("stiffness")),
    ("mass felt", lambda port: f"{mass_text(port)}   "),
    ("cycles of contact without torque", _silent),
    ("uncertainty of the account", _resolution),
    ("longest time between torque updates", lambda port: f"{counted(port['longest_hold'], 'cycle')}   "),
    ("cycles not as commanded", _uncommanded),
    ("beyond declared friction and hand", _friction),
    ("passivity guaranteed for", _certificates),
    ("hold of a torque", lambda port: f"{port['hold']}   "),
)
_TRUTH_ROWS: Final[tuple[tuple[str, Callable[[Result], str | Styled]], ...]] = (
    ("net energy, from the plant", _plain("interaction")),
    ("lowest net energy, from the plant", _plain("least_interaction")),
    ("lowest at the handle, from the plant", _plain("least_at_handle")),
    ("largest error of the account", _plain("believed_error")),
)
