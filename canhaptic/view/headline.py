"""The first line of a port: the word that is shown of it, where it comes from, and what to do about it."""

from typing import Final

from rich.text import Text

from canhaptic.control.verdict import Headline, PortResult
from canhaptic.view.si import si

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
    return text


def _reasons(port: PortResult) -> list[tuple[str, str]]:
    """Return what follows the word, each with what separates it from the words before."""
    word, plant = port["verdict"], port.get("plant_passive")
    found: list[tuple[str, str]] = []
    if word == "yes":
        allowance, at_handle = port.get("energy_allowance", 0.0), port["passive"] != "yes"
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
    if word == "in doubt":
        found.append((": ", f"the account is certain to +-{si(port.get('energy_resolution', 0.0), 'J', 3)}"))
    if word == "nothing rendered" and "advice" in port:
        found.append((": ", port["advice"]))
    if "contradicted" in port:
        names = " and ".join(name.replace("_", " ") for name in port["contradicted"])
        found.append(("; ", f"contradicts its certificates ({names}): one of {', '.join(port['suspects'])} is wrong"))
    certificate = port.get("certificate", "none")
    if word == "yes" and certificate not in ("none", "exact"):
        found.append(("; ", f"guarantee rests on: {certificate.replace('_', ' ')}"))
    return found


def _is_at_handle(port: PortResult) -> bool:
    return "yes" in (port.get("passive_at_handle"), port.get("plant_passive_at_handle"))
