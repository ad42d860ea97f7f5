"""The bar of a page that says of every account whether it was passive."""

import html
from collections.abc import Mapping
from typing import Final, Literal

from canhaptic.control.verdict import PortResult, Verdict
from canhaptic.view.palette import GREEN, ORANGE, VERMILION

_SUMS: Final[dict[Literal["passive", "passive_at_sensor", "passive_at_handle"], str]] = {
    "passive": "at the motor",
    "passive_at_sensor": "at the sensor",
    "passive_at_handle": "at the handle",
}
_COLOURS: Final[dict[Verdict, str]] = {"yes": GREEN, "in doubt": ORANGE, "no": VERMILION}


def verdict_bar(ports: Mapping[str, PortResult]) -> str:
    """Returns a bar of HTML with the verdicts of every account, by name of the port."""
    verdicts: dict[str, Verdict] = {}
    for name, port in ports.items():
        for key, sum_of in _SUMS.items():
            if key in port:
                verdicts[f"{name}: passive {sum_of}"] = port[key]
    style = "display:inline-block;color:white;font-weight:bold;padding:3px 14px;margin-right:6px;border-radius:3px"
    return "".join(
        f"<span class='verdict' style='{style};background:{_COLOURS[word]}'>"
        f"{html.escape(name)}: {word if word != 'no' else 'NO'}</span>"
        for name, word in verdicts.items()
    )
