"""Every figure of the account of a run as a table, from the same dictionary that `run --json` prints."""

from collections.abc import Callable, Sequence
from typing import Final, Literal, TypeVar

from rich.console import Group, RenderableType

from canhaptic.axis_units import damping_unit, effort_unit
from canhaptic.control.verdict import PASSIVE_TOLERANCE, PortResult, Verdict
from canhaptic.result import TruthResult
from canhaptic.view.run_lines import Result, first_active, heading, headlines, line, mass_text, ordered
from canhaptic.view.si import si
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

_Port = TypeVar("_Port", PortResult, TruthResult)
_Energy = Literal[
    "in", "out", "stored", "dissipated", "recovered", "leaked", "deficit", "least_interaction", "least_at_handle",
    "supplied", "unsure",
]  # fmt: skip
_Counts = Literal["branches", "limits"]
_TrueEnergy = Literal["interaction", "least_interaction", "least_at_handle", "believed_error"]


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
        [f"cycles booked as {branch}", *(_count_text(port, "branches", branch) for port in ports)]
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


def _cell(cell: Callable[[_Port], str | Styled], port: _Port) -> str | Styled:
    try:
        return cell(port)
    except (KeyError, TypeError):  # an axis in a group, another version, or a quantity that this run did not have
        return _NOTHING


def _counted(ports: Sequence[Result], key: _Counts) -> list[str]:
    """Return the names of the events at any port."""
    return list(dict.fromkeys(name for port in ports for name, count in port.get(key, {}).items() if count))


def _count_text(port: Result, key: _Counts, name: str) -> str:
    return f"{port[key].get(name, 0)}   " if port.get(key) else _NOTHING


def energy(value: float) -> str:
    """Return an energy [J] with its unit padded, so that numbers in a column line up."""
    number, _, unit = si(value, "J").partition(" ")
    return f"{number} {unit:<2}"


def _margin(port: PortResult) -> Styled:
    margin, at = port["margin"]["value"], port["margin"]["time"]
    place = f" at {at:.4g} s   " if margin < 0.0 else ", never negative"
    return Styled(f"{si(margin, 'J')}{place}", "green" if margin >= -PASSIVE_TOLERANCE else "red")


def _longest_hold(port: PortResult) -> str:
    return f"{port['longest_hold']} cycles   " if "longest_hold" in port else _NOTHING


def _uncommanded(port: PortResult) -> str:
    count = port.get("uncommanded_cycles", 0)
    return f"{count}   " if count else _NOTHING


def _passive(port: PortResult) -> Styled:
    return _VERDICTS[port["passive"]]


def _at_handle(port: PortResult) -> str | Styled:
    verdict = port.get("passive_at_handle")
    return _NOTHING if verdict is None else _VERDICTS[verdict]


def _share(name: Literal["stiffness", "damping"]) -> Callable[[PortResult], str]:
    def share(port: PortResult) -> str:
        part = port["rendered"][name]
        return _NOTHING if part is None else f"{100.0 * part:.3g} %   "

    return share


def _silent(port: PortResult) -> str | Styled:
    """Return how many holds of contact had no torque; a wall that renders nothing is absent."""
    contact = port["contact"]
    if contact["holds"] and contact["without_torque"] == contact["holds"]:
        return Styled("all   ", "bold red")
    return f"{contact['without_torque']} of {contact['holds']}   " if contact["holds"] else _NOTHING


def _resolution(port: PortResult) -> str:
    """Return how far the booked energy may be from the true one."""
    resolution = port["energy_resolution"]
    return f"+-{energy(resolution)}" if resolution else "rounding   "


def _certificates(port: PortResult) -> str:
    names = port.get("certificates", [port["certificate"]])
    return ", ".join(str(name).replace("_", " ") for name in names) + "   " if names else "no torque   "


def _damping(port: PortResult) -> str:
    rendered = port["damping_rendered"]
    unit = damping_unit(port["unit"])
    least, most = f"{rendered['least']:.3g}", f"{rendered['most']:.3g}"
    if abs(rendered["least"]) < _ROUNDING * rendered["most"]:
        least = "0"
    return f"{most} {unit}" if least == most else f"{least}..{most} {unit}"


def _surplus(which: Literal["end", "max"]) -> Callable[[PortResult], str]:
    return lambda port: energy(port["surplus"][which])


def _friction(port: PortResult) -> str | Styled:
    """Return by how much an axis was faster than declared friction and hand permit."""
    excess = port["friction_excess"]
    return Styled(f"{excess:.3g} {effort_unit(port['unit'])}   ", "bold red") if excess else "none   "


def _true(name: _TrueEnergy) -> Callable[[TruthResult], str]:
    return lambda port: energy(port[name])


def _plain(name: _Energy) -> Callable[[PortResult], str]:
    return lambda port: energy(port[name])


_OF_GROUPS: Final[dict[Literal["supplied", "unsure"], str]] = {
    "supplied": "input from moving surfaces",
    "unsure": "uncertainty, taken off `in`",
}
"""Rows that only a group may have, shown where they are not zero."""
_PORT_ROWS: Final[tuple[tuple[str, Callable[[PortResult], str | Styled]], ...]] = (
    ("in", _plain("in")),
    ("out", _plain("out")),
    ("dissipated", _plain("dissipated")),
    ("stored at the end", _plain("stored")),
    ("energy created by sampling, not yet removed", _surplus("end")),
    ("  at its peak", _surplus("max")),
    ("recovered by the damper", _plain("recovered")),
    ("stored energy given up", _plain("leaked")),
    ("given out but never stored", _plain("deficit")),
    ("lowest net energy into the handle", _plain("least_interaction")),
    ("  first below zero at", lambda port: f"{first_active(port)}   "),
    ("passive at the motor", _passive),
    ("lowest net energy at the handle", _plain("least_at_handle")),
    ("passive at the handle", _at_handle),
    ("smallest margin", _margin),
    ("damping rendered", _damping),
    ("damping rendered, of requested", _share("damping")),
    ("stiffness rendered, of requested", _share("stiffness")),
    ("mass felt", lambda port: f"{mass_text(port)}   "),
    ("cycles of contact without torque", _silent),
    ("the account is certain to", _resolution),
    ("longest time between torque updates", _longest_hold),
    ("cycles not as commanded", _uncommanded),
    ("beyond declared friction and hand", _friction),
    ("guarantee rests on", _certificates),
    ("hold of a torque", lambda port: f"{port['hold']}   "),
)
_TRUTH_ROWS: Final[tuple[tuple[str, Callable[[TruthResult], str]], ...]] = (
    ("net energy, from the plant", _true("interaction")),
    ("lowest net energy, from the plant", _true("least_interaction")),
    ("lowest at the handle, from the plant", _true("least_at_handle")),
    ("largest error of the account", _true("believed_error")),
)
