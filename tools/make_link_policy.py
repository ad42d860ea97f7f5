"""Writes the link policy into docs/troubleshooting.md, with the recorded faults: `python -m tools.make_link_policy`."""

import json
from pathlib import Path
from typing import Any, Final

from canhaptic.drive.safety.link_policy import READ_BACK_TABLE, STOP_TABLE, StopReason
from tools.page_part import with_part, write_page

PAGE: Final = Path(__file__).resolve().parent.parent / "docs" / "troubleshooting.md"
RESULT: Final = PAGE.with_name("results") / "faults.json"
_MISSED: Final = [
    ["0", "RUN", "the controller's torque"],
    ["1 to `bus.hold_cycles`", "HOLD", "the last torque held"],
    ["up to `bus.stop_cycles`", "ZERO", "zero in one hold; the declared weight on an axis that hangs from its brake"],
    ["`bus.stop_cycles`", "STOP", "zero and disable"],
]
_INTRODUCTION: Final = """\
## Missed TPDOs

Counted per axis. One TPDO that comes in time sets the count back to zero. Axes of a group render together: each of
them counts the SYNCs at which the TPDO of any of them is missing.
"""
_BUDGET: Final = """
Losses that never come so many in a row are counted by a budget, which rises by one with each SYNC whose sample or
torque is lost and falls by `bus.loss_limit` (10 %) with each SYNC. Lost are a TPDO that is missing, late, short or
answered twice with different content, and a torque that 0x6074 does not show. `bus.stop_cycles` of them beyond the
limit, or a quarter of the SYNCs of 1 s if that is less, but at least 10, end the run: FRAMES_LOST, or TPDO_CONTRADICTED
where different TPDOs answered. With 1 % of all frames lost by chance that happens less than once in a million hours;
with half of the SYNCs lost after 50 of them on average, at 40 Hz after 25. A run with 10 % of all frames lost ends:
that is a fifth of its samples and a tenth of its torques, and the uncertainty of a moving handle's energy then grows by
0.1 to 3 J a second, where 1 % makes 84 mJ a second at most (shipped scenes). `energy_uncertainty_limit` (by default
0.1 J/s while frames are lost) ends such a run too (ENERGY_UNCERTAIN). The SYNCs that this computer skips have a budget
of their own: those of 1 s beyond the same limit.
"""
_READ_BACK: Final = """
## What the read-back of the torque lets the rig judge

Bit 12 is judged only if the drive shows it once it is enabled; otherwise its meaning is unknown. The
statusword of every SYNC is in the energy log, and `canhaptic inspect` counts the cycles with bit 11.
"""
_STOPS: Final = """
## Stops

Each of these sends zero torque to every axis of the rig first, disables the drives second, and raises the exception
third. The number is in the energy log; the exception carries the last thousand cycles in `records`. No drive is enabled
again before the operator starts the rig anew.
"""


_MEASURED: Final = """
## From a fault to zero torque

The demo at 1 kHz, in contact, in lock-step with the simulated drive (`make bench Q=faults`): sample times from the
beginning of the fault until the motor has no torque, of those that the settings allow. With (drive) its own watchdog
acted.
"""


def _measured() -> list[str]:
    """Returns a table of the recorded faults that ended a run, and a sentence on the others."""
    rows = json.loads(RESULT.read_text(encoding="utf-8"))["rows"]
    ended = [row for row in rows if row["ended"] != StopReason.OPERATOR.name]
    endured = "; ".join(row["row"] for row in rows if row not in ended)
    return [
        *_table(["fault", "ended by", "sample times"], [_of_a_stop(row) for row in ended]),
        "",
        f"Endured: {endured}.",
    ]


def _of_a_stop(row: dict[str, Any]) -> list[str]:
    by = " (drive)" if row["drive"] == "FAULT" else ""
    times = "-" if row["cycles_to_zero"] is None else f"{row['cycles_to_zero']} of {row['allowed']}"
    return [row["row"], f"{row['ended']}{by}", times]


def page() -> str:
    """Returns the text of the page."""
    stops = [
        [str(int(reason)), reason.name, rule.meaning, f"`{rule.error.__name__}`", rule.remedy]
        for reason, rule in STOP_TABLE.items()
    ]
    quiet = [[str(int(reason)), reason.name] for reason in StopReason if reason not in STOP_TABLE]
    words = " and ".join(f"{number} ({name})" for number, name in quiet)
    lines = [
        _INTRODUCTION,
        *_table(["TPDOs missed in a row", "action", "torque"], _MISSED),
        _BUDGET,
        _READ_BACK,
        *_table(
            [
                "`read_back`",
                "an old torque is held (COMMAND_LOST)",
                "a torque was never commanded (TORQUE_CONTRADICTED)",
                "bit 12 goes out (NOT_FOLLOWING)",
                "bit 11 is on",
            ],
            [[name, *judged] for name, judged in READ_BACK_TABLE.items()],
        ),
        _STOPS,
        *_table(["number", "reason", "meaning", "exception", "what to do"], stops),
        "",
        f"The numbers {words} mean a running rig and a requested stop; nothing is raised.",
        _MEASURED,
        *_measured(),
        "",
    ]
    return with_part(PAGE, "link policy", "\n".join(lines))


def _table(headings: list[str], rows: list[list[str]]) -> list[str]:
    return [f"| {' | '.join(cells)} |" for cells in (headings, ["---"] * len(headings), *rows)]


if __name__ == "__main__":
    write_page(PAGE, page)
