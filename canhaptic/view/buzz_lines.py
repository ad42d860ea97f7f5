"""What `inspect --why` found, in lines for a terminal, and the one line of `run`."""

from collections.abc import Mapping
from math import degrees
from typing import TYPE_CHECKING, Any, Final

from canhaptic.axis_units import effort_unit, si

if TYPE_CHECKING:
    from canhaptic.audit.why.causes import Why

_SHOWN: Final = 3  # causes
_LEAST: Final = 0.25  # weight of a cause after the first


def buzz_line(name: str, why: "Why", unit: str) -> str:
    """Return one line: `handle buzzes at 43 Hz, 88 N peak to peak`."""
    swing = f"{si(why['torque'], effort_unit(unit), 3)} peak to peak" if why["torque"] else "without torque"
    return f"{name} buzzes at {why['frequency']:.3g} Hz, {swing}, {si(why['amplitude'], unit, 3)} of motion"


def why_lines(whys: Mapping[str, "Why"], units: Mapping[str, str]) -> list[str]:
    """Return the lines of all axes; one line where nothing buzzes."""
    lines = []
    for name, why in whys.items():
        lines.append(f" {buzz_line(name, why, units.get(name, 'm'))}")
        parts = [why["kind"], f"{100.0 * why['share']:.3g} % of the torque", f"{why['ripple']:.3g} times the way of it"]
        if why["torque"]:
            fed = "gives energy" if why["phase"] < 0.0 else "takes energy out"
            parts.append(f"the torque {fed}, {abs(degrees(why['phase'])):.2g} degrees from the motion")
        if why["chatter"] >= 1.0:
            parts.append(f"{why['chatter']:.3g} contacts/s")
        lines.append(f"   {'; '.join(parts)}")
        for number, cause in enumerate(why["causes"][:_SHOWN]):
            if number and cause["weight"] < _LEAST:
                break
            lines.append(f"   {number + 1}. {cause['cause']} ({cause['weight']:.0%}): {cause['evidence']}")
            if cause["value"] is not None:
                lines.append(f"      calmer: --set {cause['key']}={cause['value']}")
        lines += [f"   not in the log: {signal}" for signal in why["missing"]]
    return lines or [" nothing buzzes"]


def trial_lines(trials: Mapping[str, Any], units: Mapping[str, str]) -> list[str]:
    """Return the outcome of `--try` for each axis."""
    lines = []
    for name, trial in trials.items():
        unit = effort_unit(units.get(name, "m"))
        values = ", ".join(f"{when} {si(trial[when], unit, 3)}" for when in ("log", "twin", "changed"))
        lines.append(f" {name}: ripple, rms: {values}   with {trial['key']}={trial['value']}")
        lines.append(f"   {trial['text']}")
    return lines
