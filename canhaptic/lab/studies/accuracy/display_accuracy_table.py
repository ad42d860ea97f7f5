"""A study of the accuracy of an admittance display as tables, on a terminal and as Markdown."""

from typing import Final, TypedDict

import numpy as np
from rich.console import Group, RenderableType
from rich.text import Text

from canhaptic.axis_units import mass_unit
from canhaptic.view.si import si
from canhaptic.view.table import Table


class DisplayReference(TypedDict):
    """The ideal display."""

    ended: str
    travel: float  # [m or rad]
    energy: float  # [J]
    apart: float  # with twice its sample time [m or rad]


class PlantRow(TypedDict, total=False):
    """How far the plant of an axis is from a solver."""

    axis: str
    status: str
    position_error: float  # [m or rad]
    energy_error: float  # [J]


class ChangeRow(TypedDict, total=False):
    """A display with one thing changed, against the ideal one; of a refused one no figures."""

    changed: str
    to: str
    status: str
    position_error: float  # [m or rad]
    energy_error: float  # [J]
    mass_felt: float  # [kg or kg*m^2]
    given_out: float  # [J]
    guard_acts: float  # part of the holds
    energy_unsure: float  # [J]
    us_per_cycle: float


class DisplayStudy(TypedDict):
    """The accuracy of one display, or group of displays."""

    scene: str
    axis: str
    unit: str
    rate: float  # [Hz]
    holds: int
    reference: DisplayReference
    plant: list[PlantRow]
    loop: list[ChangeRow]
    status: str


HEADS: Final = ("changed", "to", "position", "energy", "mass felt", "given out", "guard acts", "us per\ncycle")


def display_accuracy_report(result: DisplayStudy) -> RenderableType:
    """Return the tables of a study for a terminal."""
    return Group(*(Text(f" {line}") for line in heading(result)), display_accuracy_table(result))


def display_accuracy_markdown(result: DisplayStudy) -> str:
    """Return the same as Markdown."""
    return "\n".join([*(f"{line}  " for line in heading(result)), "", display_accuracy_table(result).markdown()])


def display_accuracy_table(result: DisplayStudy) -> Table:
    """Return one row for each change of the scene."""
    return Table("", HEADS, [_cells(row, result["unit"]) for row in result["loop"]], keys=2)


def heading(result: DisplayStudy) -> list[str]:
    """Return what was studied, against what, and how far the plant is from a solver."""
    unit, reference = result["unit"], result["reference"]
    lines = [
        f"{result['scene']}, {result['axis']}: {result['holds']} sample times at {result['rate']:g} Hz, "
        f"{result['status']}",
        f"against the ideal display: travel {si(reference['travel'], unit)}, energy {si(reference['energy'], 'J')}; "
        f"with twice its sample time it is {si(reference['apart'], unit, 2)} off",
    ]
    for row in result["plant"]:
        text = row["status"]
        if row["status"] == "ok":
            energy = f", energy {si(row['energy_error'], 'J', 2)}" if "energy_error" in row else ""
            text = f"position {si(row['position_error'], unit, 2)}{energy} off DOP853"
        lines.append(f"plant of {row['axis']}: {text}")
    return lines


def _cells(row: ChangeRow, unit: str) -> list[str]:
    if "position_error" not in row:
        return [row["changed"], f"{row['to']}: refused", *[""] * (len(HEADS) - 2)]
    return [
        row["changed"],
        row["to"] + ("" if row["status"] == "ok" else f" (ended: {row['status'][:40]})"),
        si(row["position_error"], unit, 3),
        si(row["energy_error"], "J", 3),
        "-" if np.isnan(row["mass_felt"]) else si(row["mass_felt"], mass_unit(unit), 3),
        si(row["given_out"], "J", 3),
        f"{100.0 * row['guard_acts']:.2g} %",
        f"{row['us_per_cycle']:.0f}",
    ]
