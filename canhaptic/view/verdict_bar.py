"""The bar of a page that says of every account whether it was passive."""

import html
from collections.abc import Mapping
from typing import Final, Literal

from canhaptic.control.verdict import Headline, PortResult
from canhaptic.view.headline import headline_text
from canhaptic.view.palette import BLUE, GREEN, ORANGE, VERMILION

_SUMS: Final[dict[Literal["passive", "passive_at_sensor", "passive_at_handle"], str]] = {
    "passive": "at the motor",
    "passive_at_sensor": "at the sensor",
    "passive_at_handle": "at the handle",
}
_COLOURS: Final[dict[Headline, str]] = {
    "yes": GREEN,
    "in doubt": ORANGE,
    "no": VERMILION,
    "nothing rendered": VERMILION,
    "no contact": BLUE,
    "dry run": BLUE,
}


def verdict_bar(ports: Mapping[str, PortResult]) -> str:
    """Return a bar of HTML with the verdicts of every account, and the word of a port where that is another one."""
    said: list[tuple[str, Headline]] = []
    for name, port in ports.items():
        if "verdict" in port and port["verdict"] not in (port.get("passive", "yes"), port.get("passive_at_handle")):
            said.append((headline_text(name, port).plain.strip(), port["verdict"]))
        for key, sum_of in _SUMS.items():
            if key in port:
                word = port[key]
                said.append((f"{name}: passive {sum_of}: {word if word != 'no' else 'NO'}", word))
    style = "display:inline-block;color:white;font-weight:bold;padding:3px 14px;margin-right:6px;border-radius:3px"
    return "".join(
        f"<span class='verdict' style='{style};background:{_COLOURS[word]}'>{html.escape(text)}</span>"
        for text, word in said
    )
