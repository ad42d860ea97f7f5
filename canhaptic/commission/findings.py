"""Findings of commissioning, row by row, and the values that follow from them."""

from collections.abc import Collection
from enum import Enum
from typing import Any, Final, NamedTuple, cast

from canhaptic.scene.edited_text import Change, is_written
from canhaptic.scene.models import LOOP_KEYS, Scene
from canhaptic.view.table import Cell, Styled, Table


class StepVerdict(Enum):
    """Verdict of one row."""

    AGREES = "agrees"  # measured, and as configured
    DIFFERS = "differs"  # measured, and not as configured: the value found is to be used
    MEASURED = "measured"  # there was nothing to compare it with
    FAILED = "failed"  # do not put a hand on this rig
    UNKNOWN = "not verified"


class StepFinding(NamedTuple):
    """One item that was checked."""

    axis: str
    item: str
    configured: str
    found: str
    verdict: StepVerdict
    text: str = ""  # what it means, or what to do


class Value(NamedTuple):
    """A value for the scene."""

    axis: str
    key: str  # path in the axis, as `counts_per_unit` or `passivity.moving_mass`
    value: float | int | str | None  # SI; None: the one that the scene has is right
    unit: str
    comment: str = ""

    @property
    def text(self) -> str | None:
        """Text of a value as in a scene; None: as the scene has it now."""
        factor, unit = _SHOWN_IN.get(self.unit, (1.0, self.unit))
        if not isinstance(self.value, float):  # whole where the drive has it
            return None if self.value is None else str(self.value)
        return f"{self.value * factor:.6g} {unit}".rstrip()


_SHOWN_IN: Final = {"s": (1e6, "us"), "1": (100.0, "%")}
"""Units of the package -> factor to those in which small values are written, and their names."""
_MENDED: Final = ("moving mass", "dry friction, least")
"""Findings whose failure is a wrong declaration, which the measured value replaces."""
_COLOURS: Final = {
    StepVerdict.AGREES: "green",
    StepVerdict.DIFFERS: "yellow",
    StepVerdict.FAILED: "bold red",
    StepVerdict.MEASURED: "cyan",
    StepVerdict.UNKNOWN: "dim",
}


class Report:
    """Grows step by step, so that earlier findings survive a later error."""

    def __init__(self) -> None:
        self.findings: list[StepFinding] = []
        self.values: list[Value] = []

    def add(self, finding: StepFinding) -> None:
        """Take a row."""
        self.findings.append(finding)

    def propose(self, value: Value) -> None:
        """Take a value."""
        self.values.append(value)

    @property
    def failed(self) -> bool:
        """Whether any finding forbids the use of this rig."""
        return any(finding.verdict is StepVerdict.FAILED for finding in self.findings)

    @property
    def differs(self) -> bool:
        """Whether the configuration is to be corrected."""
        return any(finding.verdict is StepVerdict.DIFFERS for finding in self.findings)

    def changes(self, scene: Scene) -> list[Change]:
        """Return the values as changes of a scene; of several axes of a group, the largest of what all share."""
        values: dict[tuple[str, ...], Value] = {}
        for value in self.values:
            path = _path(scene, value)
            before = values.get(path)
            if before is None or not isinstance(before.value, float) or before.value < cast(float, value.value):
                values[path] = value
        return [Change(path, value.text, value.comment or None) for path, value in values.items()]

    def unfinished(self, axes: Collection[str], items: Collection[str]) -> list[str]:
        """Reason why a scene with these values is not ready to run; empty where all is verified.

        Args:
            axes: Names of all axes.
            items: Items that must have been verified for each.
        """
        seen = {(row.axis, row.item) for row in self.findings if row.verdict is not StepVerdict.UNKNOWN}
        missing = [f"{axis}: {item}: not verified" for axis in axes for item in items if (axis, item) not in seen]
        return missing + [
            f"{row.axis}: {row.item}: {row.found}"
            for row in self.findings
            if row.verdict is StepVerdict.FAILED and row.item not in _MENDED
        ]

    def as_json(self) -> dict[str, Any]:
        """Return the report as plain values."""
        return {
            "status": "failed" if self.failed else "differs" if self.differs else "ok",
            "findings": [{**row._asdict(), "verdict": row.verdict.value} for row in self.findings],
            "values": [{**value._asdict(), "text": value.text} for value in self.values],
        }

    def table(self) -> Table:
        """Return the rows as a table for a terminal."""
        rows: list[list[Cell]] = [
            [*row[:4], Styled(row.verdict.value, _COLOURS[row.verdict]), row.text] for row in self.findings
        ]
        return Table("commissioning", ("axis", "what", "configured", "found", "verdict", ""), rows)

    def values_table(self, written: str) -> Table:
        """Return the values, with where they were written, as a table for a terminal."""
        rows: list[list[Cell]] = [
            [value.axis, value.key, value.text or "as it is", value.comment] for value in self.values
        ]
        return Table(written, ("axis", "key", "value", ""), rows)


def _path(scene: Scene, value: Value) -> tuple[str, ...]:
    """Place of a value in a scene, present or future."""
    index = [axis.parameters.name for axis in scene.axes].index(value.axis)
    own, group = ("axes", str(index), *value.key.split(".")), scene.axes[index].group
    head, _, key = value.key.rpartition(".")
    if head != "passivity" or is_written(scene.text, own):
        return own
    if group and key not in LOOP_KEYS:
        return ("groups", group, head, key)
    return own if group or len(scene.axes) > 1 or is_written(scene.text, own[:3]) else (head, key)
