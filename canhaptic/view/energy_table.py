"""The account of a run as tables for a terminal, from the same dictionary that `run --json` prints.

The first line of a port: the word that is shown of it, where it comes from, and what to do about it.
"""

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import IO, Any, Final, Literal, TypeVar

from rich.console import Console, ConsoleOptions, Group, RenderableType
from rich.padding import Padding
from rich.segment import Segment
from rich.table import Table as TerminalTable
from rich.text import Text

from canhaptic.axis_units import damping_unit, effort_unit
from canhaptic.control.verdict import PASSIVE_TOLERANCE, Headline, PortResult, Verdict
from canhaptic.result import TruthResult
from canhaptic.view.si import si
from canhaptic.view.table import Cell, Styled, Table, in_lines
from canhaptic.view.terminal import visible

STYLES: Final[dict[Headline, str]] = {
    "yes": "bold green",
    "no contact": "bold",
    "dry run": "bold",
    "in doubt": "bold yellow",
    "nothing rendered": "bold red",
    "no": "bold red",
}
_WORDS: Final[dict[Headline, str]] = {
    "no": "NO",
    "nothing rendered": "NOTHING RENDERED",
    "dry run": "dry run, no torque was sent",
}


def headline_text(name: str, port: PortResult) -> Text:
    """Return the first line of a port that has an account of its own.

    Args:
        name: Name of the port.
        port: Its account, with verdicts.
    """
    word = port["verdict"]
    text = Text(f" {name}: ")
    text.append(f"passive: {_WORDS.get(word, word)}" if word in ("yes", "no", "in doubt") else _WORDS.get(word, word),
                style=STYLES[word])  # fmt: skip
    text.append("".join(f"{separator}{reason}" for separator, reason in _reasons(port)))
    return text.append("".join(f" · {figure}" for figure in _first_figures(port)))


def _first_figures(port: PortResult) -> list[str]:
    """Return the figures of the first line: energies, the part of a wall that was there, and what guarantees them."""
    if port["verdict"] in ("no contact", "dry run"):
        return []
    found = [f"{si(port['in'], 'J', 3)} in, {si(port['out'], 'J', 3)} out"] if "in" in port else []
    share = port["rendered"]["stiffness"] if "rendered" in port else None
    if share is not None:
        found.append("stiffness as requested" if share > _WHOLE else f"stiffness {100.0 * share:.3g} % of requested")
    certificate = port.get("certificate", "none")
    if port["verdict"] == "yes" and certificate not in ("none", "exact"):
        found.append(f"guarantee rests on: {certificate.replace('_', ' ')}")
    return found


def _reasons(port: PortResult) -> list[tuple[str, str]]:
    """Return what follows the word, each with what separates it from the words before."""
    word, plant = port["verdict"], port.get("plant_passive")
    found: list[tuple[str, str]] = []
    if word == "yes":
        allowance, at_handle = port.get("energy_allowance", 0.0), port["passive"] != "yes"
        is_ours = "why" in port and "yes" in (port["passive"], port.get("passive_at_handle"))
        found += [(", ", port["why"])] if is_ours else []
        found += [(", ", f"within {si(allowance, 'J', 3)}")] if allowance else []
        found += [(", ", "at the handle")] if at_handle and _is_at_handle(port) else []
    said = (port["passive"], port.get("passive_at_handle"))
    if word in ("yes", "no") and plant is not None and word not in said:
        is_misled = word == "no" and "yes" in said
        known = "the account says yes, so that a declaration is false" if is_misled else "the account alone cannot tell"
        found.append((", ", f"by the plant; {known}"))
    if word == "no":
        found += [(", ", f"for certain from {port['active_since']:.4g} s on")] if "active_since" in port else []
        found += [(", ", "before this part already")] if port.get("active_before") else []
        found += [(", ", f"first below zero at {_first_active(port).strip()}")] if "first_active" in port else []
    if word == "in doubt":
        found.append((": ", f"the account is certain to +-{si(port.get('energy_resolution', 0.0), 'J', 3)}"))
        found += [("; ", port["why"])] if "why" in port else []
    if word == "nothing rendered" and "advice" in port:
        found.append((": ", port["advice"]))
    if "contradicted" in port:
        names = " and ".join(name.replace("_", " ") for name in port["contradicted"])
        found.append(("; ", f"contradicts its certificates ({names}): one of {', '.join(port['suspects'])} is wrong"))
    return found


def _is_at_handle(port: PortResult) -> bool:
    return "yes" in (port.get("passive_at_handle"), port.get("plant_passive_at_handle"))


_PLAIN_WIDTH: Final = 100  # columns, where there is no terminal to ask
_HEAD_WIDTH: Final = 18  # of the name of a port above its figures; longer ones go on in the next line
_NOTHING: Final = "-   "

_VERDICTS: Final[dict[Verdict, Styled]] = {
    "yes": Styled("yes   ", "bold green"),
    "in doubt": Styled("in doubt   ", "bold yellow"),
    "no": Styled("NO   ", "bold red"),
}
_ROUNDING: Final = 1e-9
"""Part of the largest damping below which the least is none."""
_SHOWN_AT_ZERO: Final = frozenset({"deadlines_missed", "missing", "missed_tpdos", "skipped_syncs", "success_rate"})

_WHOLE: Final = 0.995
"""Rendered share of a stiffness above which the wall is whole; a damper adds to the effort while the hand goes in."""
_LOSSES: Final = ("skipped_syncs", "missed_tpdos", "missing")
"""What is amiss on a link where it is not zero."""

_Result = Mapping[str, Any]
_Port = TypeVar("_Port", PortResult, TruthResult)
_Energy = Literal[
    "in", "out", "stored", "dissipated", "recovered", "leaked", "deficit", "least_interaction", "least_at_handle",
    "supplied", "unsure",
]  # fmt: skip
_Counts = Literal["branches", "limits"]
_TrueEnergy = Literal["interaction", "least_interaction", "least_at_handle", "believed_error"]


class SafeConsole(Console):
    """A console that shows every text with `visible`; its own colours and styles go through."""

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterator[Segment]:
        """Yield the parts of what is shown."""
        for segment in super().render(renderable, options):
            yield segment if segment.control else Segment(visible(segment.text), segment.style)


def make_console(file: IO[str] | None = None) -> Console:
    """Return a console on standard output, as wide as COLUMNS says, else the terminal; 100 columns without either."""
    console = SafeConsole(highlight=False, file=file)
    if console.is_terminal or os.environ.get("COLUMNS", "").isdecimal():
        return console
    return SafeConsole(highlight=False, width=_PLAIN_WIDTH, file=file)


def print_energy(result: _Result, console: Console | None = None, *, full: bool = False) -> None:
    """Print the account of a run.

    Args:
        result: As `run --json` prints it.
        console: Where to; standard output by default.
        full: Whether to print every figure.
    """
    shown = energy_report(result) if full else brief_report(result)
    (console or make_console()).print(shown)


def brief_report(result: _Result) -> RenderableType:
    """Return the first line of each port, how the run ended, and what went wrong on the link or is not exact."""
    parts: list[RenderableType] = [*_headlines(result), _heading(result)]
    link, method = result.get("link") or {}, result.get("method", "")
    amiss = [_words(key, value) for key, value in link.items() if key in _LOSSES and value]
    late = (result.get("timing") or {}).get("deadlines_missed", 0)
    if amiss or late:
        parts.append(_line("link", ", ".join([*amiss, *([f"deadlines missed {late}"] if late else [])])))
    if " order " in method or " error" in method.lower():
        parts.append(_line("method", method))
    return Group(*parts, Text(" every figure: --full, or `canhaptic inspect` of an energy log", style="dim"))


def energy_report(result: _Result) -> RenderableType:
    """Return the first line of each port, energy table, timing line, link line and method line of a run."""
    parts = [*_headlines(result), _heading(result)]
    if result.get("ports"):
        parts.append(energy_table(result))
    for name in ("timing", "link", "method"):
        if result.get(name):
            parts.append(_line(name, result[name]))
    return Group(*parts)


def _headlines(result: _Result) -> list[RenderableType]:
    ports = {name: result["ports"][name] for name in _ordered(result.get("ports", {}))}
    return [headline_text(name, of) for name, of in ports.items() if "verdict" in of]


def _ordered(ports: Mapping[str, PortResult]) -> list[str]:
    """Return the names of the ports, each group before its axes."""
    names: dict[str, None] = {}
    for name, port in ports.items():
        if port.get("group") in ports:
            names[port["group"]] = None
        names[name] = None
    return list(names)


def _heading(result: _Result) -> Text:
    status = str(result.get("status", "unknown"))
    text = Text(" ")
    text.append(status, style="bold green" if status in {"ok", "complete", "completed"} else "bold yellow")
    if "cycles" in result:
        text.append(f"   {result['cycles']} cycles")
    if result.get("config_hash"):
        text.append(f"   configuration {str(result['config_hash'])[:12]}", style="dim")
    return text


def energy_table(result: _Result) -> Table:
    """Return the account of every port, one column each, as `run --json` prints it."""
    names = _ordered(result["ports"])
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


def _counted(ports: Sequence[_Result], key: _Counts) -> list[str]:
    """Return the names of what happened at some port."""
    return list(dict.fromkeys(name for port in ports for name, count in port.get(key, {}).items() if count))


def _count_text(port: _Result, key: _Counts, name: str) -> str:
    return f"{port[key].get(name, 0)}   " if port.get(key) else _NOTHING


def energy(value: float) -> str:
    """Return an energy [J] with its unit padded, so that numbers in a column line up."""
    number, _, unit = si(value, "J").partition(" ")
    return f"{number} {unit:<2}"


def _margin(port: PortResult) -> Styled:
    margin, at = port["margin"]["value"], port["margin"]["time"]
    place = f" at {at:.4g} s   " if margin < 0.0 else ", never negative"
    return Styled(f"{si(margin, 'J')}{place}", "green" if margin >= -PASSIVE_TOLERANCE else "red")


def _first_active(port: PortResult) -> str:
    contact = f" (contact {port['first_active_contact']})" if port.get("first_active_contact") else ""
    return f"{port['first_active']:.4g} s{contact}   "


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
    """Return by how much an axis was faster than the declared friction and hand let it be."""
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
    ("  first below zero at", _first_active),
    ("passive at the motor", _passive),
    ("lowest net energy at the handle", _plain("least_at_handle")),
    ("passive at the handle", _at_handle),
    ("smallest margin", _margin),
    ("damping rendered", _damping),
    ("damping rendered, of requested", _share("damping")),
    ("stiffness rendered, of requested", _share("stiffness")),
    ("cycles of contact without torque", _silent),
    ("the account is certain to", _resolution),
    ("longest time between torque updates", _longest_hold),
    ("cycles not as commanded", _uncommanded),
    ("beyond declared friction and hand", _friction),
    ("guarantee rests on", _certificates),
)
_TRUTH_ROWS: Final[tuple[tuple[str, Callable[[TruthResult], str]], ...]] = (
    ("net energy, from the plant", _true("interaction")),
    ("lowest net energy, from the plant", _true("least_interaction")),
    ("lowest at the handle, from the plant", _true("least_at_handle")),
    ("largest error of the account", _true("believed_error")),
)


def _line(name: str, content: Mapping[str, object] | str) -> Padding:
    """One part of the result in words: nested mappings are quantiles of durations [s]."""
    table = TerminalTable.grid(padding=(0, 2, 0, 0))
    table.add_column(no_wrap=True, style="bold", width=7)
    if not isinstance(content, Mapping):
        table.add_column()
        table.add_row(name, str(content))
        return Padding(table, (0, 1))
    nested = {key: value for key, value in content.items() if isinstance(value, Mapping)}
    shown = {key: value for key, value in content.items() if key not in nested and (value or key in _SHOWN_AT_ZERO)}
    words = [_words(key, value) for key, value in sorted(shown.items(), key=lambda item: item[0] != "success_rate")]
    table.add_column()
    label = name
    if words:
        table.add_row(label, ", ".join(words))
        label = ""
    for key, values in nested.items():
        quantiles = "   ".join(f"{quantile} {_value(key, value):>9}" for quantile, value in values.items())
        table.add_row(label, f"{key.replace('_', ' '):<17}  {quantiles}")
        label = ""
    return Padding(table, (0, 1))


def _words(name: str, value: object) -> str:
    return f"{name.replace('_', ' ')} {_value(name, value)}"


def _value(name: str, value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if not isinstance(value, float):
        return str(value)
    if name.endswith(("rate", "ratio", "share", "load")):
        return f"{100.0 * value:.6g} %" if value <= 1.0 else f"{value:.4g}"
    return f"{value:.6g}" if "per_second" in name or abs(value) >= 1000.0 else si(value, "s", 3)
