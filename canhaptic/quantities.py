"""The quantities that a user sees: one table of their units, titles, meaning and colours, from which all else is made.

Tables on a terminal, keys of `--json`, columns of logs and exported files, pictures, pages, figures of `compare` and
`sweep`, limits of `check` and `inspect --check` take unit and title from here. Programs compare ids, never titles.
"""

from typing import Any, Final, Literal, NamedTuple

from canhaptic.axis_units import Motion

BLUE, VERMILION, GREEN, ORANGE = "#0072B2", "#D55E00", "#009E73", "#E69F00"
PURPLE, SKY = "#CC79A7", "#56B4E9"
GREY, PALE = "#4D4D4D", "#8C8C8C"
ALARM: Final = VERMILION
"""Colour of what a user must look at: energy below zero, a fault. No quantity has it."""

_ROTARY: Final = {
    "m": "rad", "m/s": "rad/s", "N": "N*m", "N/m": "N*m/rad", "N*s/m": "N*m*s/rad", "kg": "kg*m^2", "J/N": "J/(N*m)",
}  # fmt: skip
"""Unit of a linear axis -> that of a rotary one, where they differ."""


class QuantityRow(NamedTuple):
    """Definition of one quantity."""

    unit: str  # of a linear axis; "1": a share or a count, "": a figure that is no quantity
    title: str  # as a user reads it; a limit may have one place {} for the value that it depends on
    sentence: str = ""  # what it is; "": the title says it
    symbol: str = ""  # in the paper
    better: Literal["", "less", "near one", "not negative"] = ""  # which value is better; "": neither
    colour: str = ""  # of its line in a picture; "": none
    old: tuple[str, ...] = ()  # ids in earlier releases
    key: str = ""  # key of the scene that a limit is compared with

    def unit_on(self, motion: Motion) -> str:
        """Return the unit for an axis in "m" or "rad"."""
        return _ROTARY.get(self.unit, self.unit) if motion == "rad" else self.unit


_STIFFNESS: Final = "environment.stiffness"
_DAMPING: Final = "environment.damping"
LIMITS: Final[dict[str, QuantityRow]] = {
    "stiffness_colgate": QuantityRow("N/m", "stiffness, Colgate's bound 2 b / T", key=_STIFFNESS),
    "stiffness_delayed": QuantityRow("N/m", "stiffness at delay {0}, 2 b / {1} T", key=_STIFFNESS),
    "stiffness_quantisation": QuantityRow("N/m", "stiffness, quantisation bound 2 f_c / count", key=_STIFFNESS),
    "stiffness_certified": QuantityRow("N/m", "stiffness, certified{0}", key=_STIFFNESS),
    "stiffness_held": QuantityRow("N/m", "stiffest wall held at a push of {0}", key=_STIFFNESS),
    "stiffness_pressed": QuantityRow(
        "N/m", "stiffness after repeated presses (dry friction per count)", key=_STIFFNESS
    ),
    "damping_colgate": QuantityRow("N*s/m", "damping, Colgate's bound b - k T / 2", key=_DAMPING),
    "damping_calm": QuantityRow("N*s/m", "damping, no ripple", key=_DAMPING),
    "damping_stable": QuantityRow("N*s/m", "damping, stable", key=_DAMPING),
    "approach_speed": QuantityRow("m/s", "slowest approach with torque in its first cycle"),
    "contact_energy": QuantityRow("J", "energy to feel slower contacts, {0}"),
    "coupling_stretch": QuantityRow("m", "stretch before a coupling pulls"),
    "stop_energy": QuantityRow("J", "energy out at a stop"),
    "stop_weight": QuantityRow("N", "weight at a stop"),
    "not_read": QuantityRow("", "stiffness and damping"),
    "force_uncertainty": QuantityRow("N", "force uncertainty of the account"),
    "first_mass": QuantityRow("kg", "mass felt at the first move, at least"),
    "unguarded_mass": QuantityRow("kg", "lightest mass that is passive without the guard"),
    "first_speed": QuantityRow("m/s", "speed of the first step from rest"),
    "jitter_allowed": QuantityRow("1", "SYNC jitter allowed", key="passivity.sync_jitter"),
    "carried_mass": QuantityRow("kg", "mass carried for the declared hand"),
    "unguarded_damping": QuantityRow("N*s/m", "damping that is passive without the guard"),
    "least_force": QuantityRow("N", "least force that moves it"),
    "offset_energy": QuantityRow("J/N", "energy from a sensor offset"),
    "stalled_energy": QuantityRow("J", "energy from a stalled master"),
    "frozen_energy": QuantityRow("J", "energy from a frozen sensor"),
}  # fmt: skip
"""Limits of a scene that `check` prints. One with a key is compared with the value of that key, in its unit."""

_RENAMED: Final = {"requested": "asked"}
"""Key of `--json` -> its name in releases before 0.4; one release writes both."""


def with_old_names(values: dict[str, Any]) -> dict[str, Any]:
    """Return values with the new keys, and the same under the names that earlier releases wrote."""
    return values | {old: values[new] for new, old in _RENAMED.items() if new in values}
