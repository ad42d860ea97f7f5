"""First lines of a run on a terminal: the verdict and key figures of each port, how the run ended, any problem."""

import os
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import IO, Any, Final

from rich.console import Console, ConsoleOptions, Group, RenderableType
from rich.padding import Padding
from rich.segment import Segment
from rich.table import Table as TerminalTable
from rich.text import Text

from canhaptic.axis_units import counted, mass_unit, place, si
from canhaptic.control.verdict import (
    BY_CERTIFICATE,
    EARLY,
    GUARANTEEING,
    LATE,
    NO_PULL,
    ROUNDING,
    Headline,
    PortResult,
)
from canhaptic.quantities import ACCOUNT
from canhaptic.view.terminal import visible

_INDENT: Final = "    "
_PLAIN_WIDTH: Final = 100  # columns, where there is no terminal to ask
Result = Mapping[str, Any]
"""The account of a run, as `run --json` prints it."""
_SHOWN_AT_ZERO: Final = frozenset({"deadlines_missed", "missing", "missed_tpdos", "skipped_syncs", "success_rate"})
_CLOSE: Final = 0.005
"""Difference from one of a rendered share that is as requested: a damper's force distorts the share a little."""
_RENDERED: Final = {"detents": "notch force", "coulomb_surface": "friction"}
"""What the rendered share refers to, for an environment without a stiffness."""
_LABELS: Final = {
    "success_rate": "TPDOs received", "skipped_syncs": "SYNCs skipped", "missed_tpdos": "TPDOs missed",
    "missing": "TPDOs missed", "received": "frames received", "sent": "frames sent",
}  # fmt: skip
"""Displayed name of each counter and figure of the link."""
_MORE_ENERGY: Final = "raise energy_allowance, or declare the damping of the device"
_RAN_IN: Final = {"cycle": "the cycle", "process": "a process of its own"}
_LOSSES: Final = ("skipped_syncs", "missed_tpdos", "missing")
"""Link counters that indicate a problem if they are not zero."""
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


class SafeConsole(Console):
    """A rich console that escapes control characters in texts and indents the further lines of a text that is too long.

    Its own colours and styles are kept.
    """

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterator[Segment]:
        """Yield the segments to show."""
        options = options or self.options
        if isinstance(renderable, Text) and options.max_width == self.width and not options.no_wrap:
            renderable = self._indented(renderable)
        for segment in super().render(renderable, options):
            yield segment if segment.control else Segment(visible(segment.text), segment.style)

    def _indented(self, text: Text) -> Text:
        lines: list[Text] = []
        for whole in text.split("\n", allow_blank=True):
            first, *rest = [whole] if whole.cell_len <= self.width else whole.wrap(self, self.width - len(_INDENT))
            lines += [first, *(Text(_INDENT).append_text(line) for line in rest)]
        return Text("\n", end=text.end).join(lines)


def make_console(file: IO[str] | None = None) -> Console:
    """Return a console on standard output or `file`: as wide as COLUMNS, else the terminal, else 100 columns."""
    console = SafeConsole(highlight=False, file=file)
    if console.is_terminal or os.environ.get("COLUMNS", "").isdecimal():
        return console
    return SafeConsole(highlight=False, width=_PLAIN_WIDTH, file=file)


def failure_text(result: Result) -> str:
    """Return in words after how many cycles a run failed; "" for any other run."""
    after = f" after {counted(result['cycles'], 'cycle')}" if "cycles" in result else ""
    return f"FAILED{after}; until then" if str(result.get("status", "")).startswith("failed") else ""


def headline_text(name: str, port: PortResult, failure: str = "") -> Text:
    """Return the first line of a port with its own account: one judgement, its reason, and one number.

    Args:
        name: Name of the port.
        port: Account of the port, with verdicts.
        failure: The run's `failure_text`, shown before the verdict.
    """
    word = port["verdict"]
    text = Text(f" {name}: ")
    text.append(f"{failure} " if failure else "", style="bold red")
    where = "passive at the handle" if _is_at_handle_alone(port) else "passive"
    where += " with the far side" * port.get("with_far", False)
    text.append(f"{where}: {_WORDS.get(word, word)}" if word in ("yes", "no", "in doubt") else _WORDS.get(word, word),
                style=STYLES[word])  # fmt: skip
    reason, number = _reason(port), _number(port)
    text.append(f"{', ' if word in ('yes', 'no') else ': '}{reason}" if reason else "")
    return text.append(f" · {number}" if number else "")


_MASS_OFF: Final = 0.05  # of the mass felt from the requested one, beyond which the guard's part is explained


def _number(port: PortResult) -> str:
    """Return the figure that says most about a judgement: what was rendered, what is uncertain, or what is missing."""
    word = port["verdict"]
    if word == "in doubt":
        return f"{ACCOUNT['energy_resolution'].title} {uncertainty(port)}"
    if word == "no":
        least = port.get("least_interaction", 0.0)
        return f"{ACCOUNT['least_interaction'].title} {si(least, 'J', 3)}" if least < -ROUNDING else ""
    if word != "yes":
        return ""
    share, what = port.get("mass", {}).get("share"), ACCOUNT["mass"].title
    if share is None and "rendered" in port:
        share, what = port["rendered"]["stiffness"], _RENDERED.get(port.get("environment", ""), "stiffness")
    if share is not None:
        return f"{what} as requested" if abs(share - 1.0) < _CLOSE else f"{what} {100.0 * share:.3g} % of requested"
    return f"{ACCOUNT['interaction'].title} {si(port['in'] - port['out'], 'J', 3)}" if "in" in port else ""


def advice_lines(port: PortResult) -> list[str]:
    """Return what a person at the rig should act on: a false declaration, torque that was missing, cut or early."""
    found = []
    if "contradicted" in port:
        names = " and ".join(name.replace("_", " ") for name in port["contradicted"])
        found.append(f"contradicts its certificates ({names}): one of {', '.join(port['suspects'])} is wrong")
    if port["verdict"] == "no" and "yes" in (port["passive"], port.get("passive_at_handle")):
        found.append("the account says yes, so a declaration is false")
    if port["verdict"] in ("no contact", "dry run"):
        return found
    if "none" in port.get("certificates", ()) and port.get("algorithm", "guarded") not in GUARANTEEING:
        alone = ", so this holds for this run alone" * (port["verdict"] == "yes")
        found.append(f"no guarantee: {port['algorithm']} has none{alone}")
    contact, share = port.get("contact", {}), port.get("mass", {}).get("share")
    if (ended := contact.get("no_torque_after")) is not None:
        found.append(f"no torque after {ended:.4g} s: no energy left for one; {_MORE_ENERGY}")
    if beyond := contact.get("beyond_limit"):
        found.append(f"cut by torque_limit in {counted(beyond, 'cycle')}")
    if port.get("certificate", "none") not in ("none", "exact") and abs((share or 1.0) - 1.0) > _MASS_OFF:
        found.append("guard limited the speed: raise environment.mass or damping, lower force.slew, or move further")
    return [*found, *([f"hold: {port['hold']}"] if port.get("hold") in (EARLY, LATE) else [])]


def uncertainty(port: Result) -> str:
    """Return the largest error of the account's energy; a display books the least energy that can have come in."""
    largest = si(port.get("energy_resolution", 0.0), "J", 3)
    return f"+{largest}, -0 J" if port.get("books_least") else f"+-{largest}"


def account_lines(result: Result) -> list[RenderableType]:
    """Return what the account alone says of each port that the simulated plant judged otherwise, and why."""
    ports = [(name, of) for name, of in result.get("ports", {}).items() if "verdict" in of and _is_by_plant(of)]
    return [Text(f" {name}: by the account: {of['passive']}, {of.get('why', '')}".rstrip(", ")) for name, of in ports]


def _is_by_plant(port: PortResult) -> bool:
    """Return whether the simulated plant has a verdict on a port that its account has not."""
    said = port["passive"], port.get("passive_at_handle")
    return port["verdict"] in ("yes", "no") and "plant_passive" in port and port["verdict"] not in said


def _is_at_handle_alone(port: PortResult) -> bool:
    """Return whether a port is shown as passive because it is so at the handle, though not known at the motor."""
    at_handle = port.get("passive_at_handle"), port.get("plant_passive_at_handle")
    return port["verdict"] == "yes" != port["passive"] and "yes" in at_handle


def _reason(port: PortResult) -> str:
    """Return on what the judgement rests."""
    word, why = port["verdict"], port.get("why", "")
    if word == "yes":
        return ", ".join(_grounds(port))
    if word == "no":
        return "by the simulated plant" if _is_by_plant(port) else _since(port)
    if word == "in doubt":
        return why
    if word == "no contact" and "reach" in port:
        shown = partial(place, unit=port.get("unit", "m"), digits=3, in_degrees=port.get("in_degrees", False))
        wall = f", the wall begins at {shown(port['wall'])}" if "wall" in port else ""
        return f"the handle stayed between {' and '.join(map(shown, port['reach']))}{wall}"
    return port.get("advice", "") if word == "nothing rendered" else ""


def _grounds(port: PortResult) -> Iterator[str]:
    """Yield the grounds of a yes: plant, measurement or certificate, and the energy that may be given out."""
    names, allowance = port.get("certificates", ()), port.get("energy_allowance", 0.0)
    if _is_by_plant(port):
        yield "by the simulated plant"
    elif port.get("why") == BY_CERTIFICATE:
        yield f"{BY_CERTIFICATE}: {rests_on(*names, hand_force=port.get('hand_force'))}"
    elif "why" in port:
        yield port["why"]
    if allowance:
        yield f"within an allowance of {si(allowance, 'J', 3)}"


def _since(port: PortResult) -> str:
    """Return since when a port was not passive."""
    if port.get("active_before"):
        return "already before this part of the log"
    since, first = port.get("active_since"), first_active(port) if "first_active" in port else ""
    if since is None:
        return f"first below zero at {first}" if first else ""
    return f"for certain from {first if port.get('first_active') == since else f'{since:.4g} s'} on"


def rests_on(*certificates: str, hand_force: float | None = None) -> str:
    """Return in words the declarations on which the guarantee of the given certificates rests.

    Args:
        certificates: Their names.
        hand_force: Largest pull of the hand, as declared [N or N*m]; None: not known.
    """
    if "none" in certificates:
        return "no guarantee"
    words = {"hand_force": NO_PULL} if hand_force == 0.0 else {}
    declared = [name for name in certificates if name != "exact"]
    named = (words.get(name, name.replace("_", " ").removeprefix("declared ")) for name in declared)
    return ", ".join(named) or "needs no declaration"


def brief_report(result: Result) -> RenderableType:
    """Return the first line of each port, how the run ended, and any losses or inexact simulation."""
    parts: list[RenderableType] = [*headlines(result), *link_lines(result), heading(result), *losses(result)]
    return Group(*parts, Text(" all figures: --full, or `canhaptic inspect` with an energy log", style="dim"))


def link_lines(result: Result) -> Iterator[RenderableType]:
    """Yield what the link to a far side did: round trip, losses, energy to and fro, and what limited it."""
    if (far := result.get("far")) is None:
        return
    flows = f"{si(far['received'], 'J', 3)} received, {si(far['sent'], 'J', 3)} sent"
    text = f" {_state(far)}; {flows}"
    text += f"; {counted(far['refused'], 'packet')} refused" if far["refused"] else ""
    short, over = (counted(int(far[key]), "cycle") if far[key] else "" for key in ("limited", "cut"))
    said = [
        f"torque cut in {short} while its energy was lacking" * bool(short),
        f"more than from_far came in {over}" * bool(over),
    ]
    limited = f"; limited_by: far ({'; '.join(filter(None, said))})" if short or over else ""
    yield Text(text + limited, style="" if far["linked"] else "yellow")


def _state(far: Mapping[str, float]) -> str:
    trip = f"{1e3 * far['round_trip']:.3g} ms, " if far["round_trip"] >= 0.0 else ""
    state = f"link {trip}{100.0 * far['lost']:.2g} % lost" if far["linked"] else "link ended" * (far["sessions"] > 0)
    return f"{state or 'no link: no authentic packet came'}; {si(far['under_way'], 'J', 2)} under way"


def link_status(summary: Callable[[], Any]) -> Iterator[str]:
    """Yield at each call the state of a link in a few words, and whether the far side limited it since the call before.

    Args:
        summary: Returns the summary of the link so far.
    """
    before = 0
    while True:
        far: Mapping[str, float] = summary()._asdict()
        last, before = before, int(far["cut"] + far["limited"])
        yield _state(far) + "; limited_by: far" * (before > last)


def pair_lines(result: Result) -> Iterator[RenderableType]:
    """Yield what two logs of one link say together."""
    if (pair := result.get("pair")) is not None:
        word = (
            "yes" if pair["holds"] else "NO" if pair["agrees"] else "NO, a total arrived that the other log never sent"
        )
        text = f" both logs, by their packets: passive: {word}; least sum {si(pair['least'], 'J', 3)}"
        text += f" +-{si(pair['resolution'], 'J', 2)} over cuts of up to {counted(pair['widest'], 'SYNC')}"
        ends = f"; {si(pair['under_way'], 'J', 2)} under way at the end, {si(pair['given_up'], 'J', 2)} given up"
        yield Text(text + ends, style="" if pair["holds"] else "bold red")


def losses(result: Result) -> Iterator[RenderableType]:
    """Yield what was lost or late in a run, and how it was simulated if that was inexact."""
    link, method = result.get("link") or {}, result.get("method", "")
    amiss = [_words(key, value) for key, value in link.items() if key in _LOSSES and value]
    timing = result.get("timing") or {}
    late = timing.get("deadlines_missed", 0)
    if amiss or late:
        yield line("link", ", ".join([*amiss, *([f"deadlines missed {late}"] if late else [])]))
    if " order " in method or " error" in method.lower():
        yield line("method", method)
    if refused := {k: v for k, v in timing.items() if k.startswith("realtime_") and v != "granted"}:
        yield line("timing", refused)


def headlines(result: Result) -> list[RenderableType]:
    """Return the first line of each port that has a separate account, with what to act on below it."""
    failure = failure_text(result)
    ports = {name: result["ports"][name] for name in ordered(result.get("ports", {}))}
    found: list[RenderableType] = []
    for name, of in ports.items():
        if "verdict" in of:
            found += [headline_text(name, of, failure), *(Text(f"   {text}", "yellow") for text in advice_lines(of))]
    return found


def ordered(ports: Mapping[str, PortResult]) -> list[str]:
    """Return the names of the ports, with each group before its axes."""
    return list(
        dict.fromkeys(of for name, port in ports.items() for of in (port.get("group", name), name) if of in ports)
    )


def heading(result: Result) -> Text:
    """Return the status of the run, its number of cycles, its configuration, and where user code ran."""
    status = str(result.get("status", "unknown"))
    text = Text(" ")
    text.append(status, style="bold green" if status in {"ok", "complete", "completed"} else "bold yellow")
    if "cycles" in result:
        text.append(f"   {counted(result['cycles'], 'cycle')}")
    if (share := result.get("link", {}).get("success_rate")) is not None:
        text.append(f"   {100.0 * share:.6g} % of SYNCs answered", style="" if share == 1.0 else "yellow")
    if "energy_log" in result:
        text.append(f"   energy log {result['energy_log']}", style="bold red")
    if result.get("config_hash"):
        text.append(f"   scene checksum {str(result['config_hash'])[:12]}", style="dim")
    if code := result.get("own_code"):
        text.append(f"\n user code ran in {_RAN_IN.get(code['runs_in'], code['runs_in'])}")
        text.append(f", {counted(code['late_holds'], 'answer')} late" if "late_holds" in code else "")
    return text


def line(name: str, content: Mapping[str, object] | str) -> Padding:
    """Return one section of the result, such as `timing`, in words; nested mappings are quantiles of durations [s]."""
    rows = [str(content)]
    if isinstance(content, Mapping):
        nested = {key: value for key, value in content.items() if isinstance(value, Mapping)}
        flat = {key: value for key, value in content.items() if key not in nested and (value or key in _SHOWN_AT_ZERO)}
        words = [_words(key, value) for key, value in sorted(flat.items(), key=lambda item: item[0] != "success_rate")]
        rows = [", ".join(words)] if words else []
        for key, values in nested.items():
            if not any(values.values()):
                continue  # of a clock that stands still in a cycle, as in a replay
            quantiles = "   ".join(f"{quantile} {_value(key, value):>9}" for quantile, value in values.items())
            rows.append(f"{key.replace('_', ' '):<17}  {quantiles}")
    table = TerminalTable.grid(padding=(0, 2, 0, 0))
    table.add_column(no_wrap=True, style="bold", width=7)
    table.add_column()
    for number, row in enumerate(rows):
        table.add_row("" if number else name, row)
    return Padding(table, (0, 1))


def _words(name: str, value: object) -> str:
    return f"{_LABELS.get(name, name.replace('_', ' '))} {_value(name, value)}"


def _value(name: str, value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if not isinstance(value, float):
        return str(value)
    if name.endswith(("rate", "ratio", "share", "load")):
        return f"{100.0 * value:.6g} %" if value <= 1.0 else f"{value:.4g}"
    return f"{value:.6g}" if "per_second" in name or abs(value) >= 1000.0 else si(value, "s", 3)


def first_active(port: Result) -> str:
    """Return the first time at which the net energy of a port was below zero, and the contact if it is known."""
    contact = f" (contact {port['first_active_contact']})" if port.get("first_active_contact") else ""
    return f"{port['first_active']:.4g} s{contact}"


def mass_text(port: Result) -> str:
    """Return the mass felt at an admittance display, and its share of the requested mass."""
    mass, unit = port["mass"], mass_unit(port["unit"])
    if (felt := mass["felt"]) is None:
        return f"not known, {mass['requested']:.3g} {unit} requested"
    return f"{felt:.3g} {unit}, {100.0 * (mass['share'] or 0.0):.3g} % of requested"
