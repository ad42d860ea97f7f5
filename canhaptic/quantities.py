"""The quantities that a user sees: one table of units, titles, meaning and colours, from which all else is made.

The table is `quantities.toml`. Tables on a terminal, keys of `--json`, columns of logs and exported files, pictures,
pages, figures of `compare` and `sweep`, limits of `check` and `inspect --check` take unit and title from it. Programs
compare ids, never titles.
"""

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple, TypeVar, cast

from canhaptic.axis_units import Motion

BLUE, VERMILION, GREEN, ORANGE = "#0072B2", "#D55E00", "#009E73", "#E69F00"
PURPLE, SKY = "#CC79A7", "#56B4E9"
GREY, PALE = "#4D4D4D", "#8C8C8C"
ALARM: Final = VERMILION
"""Colour of what a user must look at: energy that was given out, a fault. No quantity has it."""

_ROTARY: Final = {
    "m": "rad", "m/s": "rad/s", "N": "N*m", "N/m": "N*m/rad", "N*s/m": "N*m*s/rad", "kg": "kg*m^2", "J/N": "J/(N*m)",
}  # fmt: skip
"""Unit of a linear axis -> that of a rotary one, where they differ."""


class QuantityRow(NamedTuple):
    """Definition of one quantity."""

    unit: str  # of a linear axis; "1": a share or a count, "": a number of `compare`, a word
    title: str  # as a user reads it; a limit may have one place {} for the value that it depends on
    sentence: str = ""  # what it is; "": the title says it
    symbol: str = ""  # in the paper
    better: Literal["", "less", "near one", "not negative"] = ""  # which value is better; "": neither
    colour: str = ""  # of its line in a picture; "": none
    key: str = ""  # key of the scene that a limit is compared with
    source: str = "own definition"  # of a figure
    short: str = ""  # title in a narrow column; "": none

    def unit_on(self, motion: Motion) -> str:
        """Return the unit for an axis in "m" or "rad"."""
        return _ROTARY.get(self.unit, self.unit) if motion == "rad" else self.unit


_COLOURS: Final = {
    "blue": BLUE, "vermilion": VERMILION, "green": GREEN, "orange": ORANGE, "purple": PURPLE, "sky": SKY, "grey": GREY,
}  # fmt: skip
_TABLES: Final = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))


def _rows(name: str) -> dict[str, QuantityRow]:
    rows = {}
    for path, fields in _TABLES[name].items():
        if "same_as" in fields:
            table, _, other = fields.pop("same_as").partition(".")
            fields = _TABLES[table][other] | fields
        rows[path] = QuantityRow(**fields | {"colour": _COLOURS.get(fields.get("colour", ""), "")})
    return rows


ACCOUNT: Final = _rows("account")
"""Quantities of a port, by their path in the account of `run --json`; those of a cycle are columns of a log."""
TRUTH: Final = _rows("truth")
"""Energies of the simulated plant, by their key in the section `truth` of `run --json`."""
LIMITS: Final = _rows("limit")
"""Limits of a scene that `check` prints. One with a key is compared with the value of that key, in its unit."""
FIGURES: Final = _rows("figure")
"""Figures of `compare`, `sweep` and `map`, by their names."""
SUMMARY: Final = _rows("summary")
"""What `compare` and `sweep` say of whole runs."""
ARENA: Final = _rows("arena")
"""Figures of the arena."""
STANDING: Final = _rows("standing")
"""Columns of the arena's ranking, over all cases of an algorithm; less is better."""

OLD_COLUMNS: Final = {
    "interaction": "h_i", "dissipated": "h_r", "stored": "h_s", "surplus": "h_dis", "generated": "gen",
    "leaked": "leak", "effort_requested": "effort_asked", "velocity_command": "torque_command",
}  # fmt: skip
"""Column of a log -> its name before 0.4. One release writes both, and logs of earlier ones have the old name alone."""
NEW_COLUMNS: Final = {old: new for new, old in OLD_COLUMNS.items() if new != "velocity_command"}
"""Column of a log before 0.4 -> its name; a torque that is commanded keeps its name."""
OLD_FIGURES: Final = {
    "surplus.end": "surplus_end", "force_ripple": "force_variation", "force_ripple.ratio": "force_variation.ratio",
    "accounted_margin": "believed_margin", "accounted_error": "believed_error",
}  # fmt: skip
"""Figure of `compare` and `sweep` -> its name before 0.4, which is still read."""
OLD_KEYS: Final = {"requested": "asked", "uncertainty": "unsure", "accounted_error": "believed_error"}
"""Key of `--json` -> its name before 0.4; one release writes both."""


_NEW_KEYS: Final = {old: new for new, old in OLD_KEYS.items()}
_Values = TypeVar("_Values", bound=Mapping[str, Any])


def with_old_names(values: _Values) -> _Values:
    """Return values of `--json` with their keys, and the same under the names of releases before 0.4."""
    old = {OLD_KEYS[name]: value for name, value in values.items() if name in OLD_KEYS}
    return cast("_Values", {**values, **old})


def row_of(table: Mapping[str, QuantityRow], path: str) -> QuantityRow:
    """Return the row of a figure such as `surplus.end`, by its own path or the first part of it.

    Args:
        table: `ACCOUNT` or `TRUTH`.
        path: Path of the figure; its last part may be a name of an earlier release.

    Raises:
        KeyError: The table has neither.
    """
    head, dot, last = path.rpartition(".")
    path = head + dot + _NEW_KEYS.get(last, last)
    return table[path if path in table else path.partition(".")[0]]


def figure_name(name: str) -> str:
    """Return the present name of a figure that may have one of an earlier release."""
    return next((new for new, old in OLD_FIGURES.items() if old == name), name)
