"""What commissioning found, row by row, and the values to paste."""

from collections.abc import Iterable
from enum import Enum
from typing import Any, Final, NamedTuple

from rich.markup import escape
from rich.table import Table

from canhaptic.view.table_style import plain_table


class StepVerdict(Enum):
    """Verdict of one row."""

    AGREES = "agrees"  # measured, and as configured
    DIFFERS = "differs"  # measured, and not as configured: paste the value found
    MEASURED = "measured"  # there was nothing to compare it with
    FAILED = "failed"  # do not put a hand on this rig
    UNKNOWN = "not verified"


class StepFinding(NamedTuple):
    """One thing that was looked at."""

    axis: str
    item: str
    configured: str
    found: str
    verdict: StepVerdict
    text: str = ""  # what it means, or what to do


class Value(NamedTuple):
    """A value to paste into the configuration."""

    axis: str
    key: str  # path in the axis, as `counts_per_unit` or `passivity.moving_mass`
    value: float | int | str
    unit: str
    comment: str = ""


_COLOURS: Final = {
    StepVerdict.AGREES: "green",
    StepVerdict.DIFFERS: "yellow",
    StepVerdict.FAILED: "bold red",
    StepVerdict.MEASURED: "cyan",
    StepVerdict.UNKNOWN: "dim",
}


class Report:
    """Grows step by step, so that what was found before something went wrong is kept."""

    def __init__(self) -> None:
        self.findings: list[StepFinding] = []
        self.values: list[Value] = []

    def add(self, finding: StepFinding) -> None:
        """Takes a row."""
        self.findings.append(finding)

    def propose(self, value: Value) -> None:
        """Takes a value to paste."""
        self.values.append(value)

    @property
    def failed(self) -> bool:
        """Whether anything says that this rig must not be used."""
        return any(finding.verdict is StepVerdict.FAILED for finding in self.findings)

    @property
    def differs(self) -> bool:
        """Whether the configuration is to be corrected."""
        return any(finding.verdict is StepVerdict.DIFFERS for finding in self.findings)

    def as_json(self) -> dict[str, Any]:
        """Returns the report as plain values."""
        return {
            "status": "failed" if self.failed else "differs" if self.differs else "ok",
            "findings": [{**row._asdict(), "verdict": row.verdict.value} for row in self.findings],
            "values": [value._asdict() for value in self.values],
        }

    def table(self) -> Table:
        """Returns the rows as a table for a terminal."""
        table = plain_table("commissioning", "axis", "what", "configured", "found", "verdict", "")
        for row in self.findings:
            verdict = f"[{_COLOURS[row.verdict]}]{row.verdict.value}[/]"
            table.add_row(*(escape(text) for text in row[:4]), verdict, escape(row.text))
        return table

    def snippet(self) -> str:
        """Returns the values to paste as YAML, axis by axis; "" when there are none."""
        axes = dict.fromkeys(value.axis for value in self.values)
        return "\n".join(_axis_snippet(axis, [v for v in self.values if v.axis == axis]) for axis in axes)


def _axis_snippet(axis: str, values: Iterable[Value]) -> str:
    lines, section = [f"# axis {axis}"], ""
    for value in sorted(values, key=lambda value: value.key.rpartition(".")[0]):  # YAML takes each section once
        head, _, key = value.key.rpartition(".")
        if head != section and head:
            lines += [f"{'  ' * depth}{name}:" for depth, name in enumerate(head.split("."))]
        section = head
        indent, comment = "  " * len(head.split(".")) if head else "", f"  # {value.comment}" if value.comment else ""
        number = f"{value.value:.6g}" if isinstance(value.value, float) else value.value  # whole where the drive has it
        lines.append(f"{indent}{key}: {number} {value.unit}".rstrip() + comment)
    return "\n".join(lines) + "\n"
