"""Writes the link policy into docs/troubleshooting.md, with the recorded faults: `python -m tools.make_link_policy`."""

import json
from pathlib import Path
from typing import Any, Final

from canhaptic.drive.profile.link_policy import READ_BACK_TABLE, STOP_TABLE, Action, StopReason
from tools.page_part import with_part, write_page

PAGE: Final = Path(__file__).resolve().parent.parent / "docs" / "troubleshooting.md"
RESULT: Final = PAGE.with_name("results") / "faults.json"
_MISSED: Final = {
    Action.RUN: "0",
    Action.HOLD: "1 to `bus.hold_cycles`",
    Action.RAMP: "up to `bus.stop_cycles`",
    Action.STOP: "`bus.stop_cycles`",
}
_INTRODUCTION: Final = """\
## Missed TPDOs

Counted per axis. One TPDO that comes in time sets the count back to zero. Axes of a group render together: each of
them counts the SYNCs at which the TPDO of any of them is missing.
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
beginning of the fault until the motor has no torque, and how many the settings allow. Where the drive ends in FAULT,
its own watchdog has acted. "Goes on": the fault did not end the run.
"""


def _measured() -> list[list[str]]:
    """Returns one row per recorded fault."""
    rows = json.loads(RESULT.read_text(encoding="utf-8"))["rows"]
    return [
        [
            row["row"],
            _ended(row["ended"]),
            row["drive"],
            *(_of_a_stop(row, key) for key in ("cycles_to_zero", "allowed")),
        ]
        for row in rows
    ]


def _ended(reason: str) -> str:
    return "goes on" if reason == StopReason.OPERATOR.name else reason


def _of_a_stop(row: dict[str, Any], key: str) -> str:
    return "-" if row["cycles_to_zero"] is None else str(row[key])


def page() -> str:
    """Returns the text of the page."""
    missed = [[_MISSED[action], action.name, action.value] for action in Action]
    stops = [
        [str(int(reason)), reason.name, rule.meaning, f"`{rule.error.__name__}`", rule.remedy]
        for reason, rule in STOP_TABLE.items()
    ]
    quiet = [[str(int(reason)), reason.name] for reason in StopReason if reason not in STOP_TABLE]
    words = " and ".join(f"{number} ({name})" for number, name in quiet)
    lines = [
        _INTRODUCTION,
        *_table(["TPDOs missed in a row", "action", "torque"], missed),
        _READ_BACK,
        *_table(
            [
                "`read_back`",
                "an old torque is held (COMMAND_LOST)",
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
        *_table(["fault", "ended by", "drive", "sample times", "allowed"], _measured()),
        "",
    ]
    return with_part(PAGE, "link policy", "\n".join(lines))


def _table(headings: list[str], rows: list[list[str]]) -> list[str]:
    return [f"| {' | '.join(cells)} |" for cells in (headings, ["---"] * len(headings), *rows)]


if __name__ == "__main__":
    write_page(PAGE, page)
