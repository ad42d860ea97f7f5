"""The quantities that a user sees: one table of their units, titles, meaning and colours, from which all else is made.

Tables on a terminal, keys of `--json`, columns of logs and exported files, pictures, pages, figures of `compare` and
`sweep`, limits of `check` and `inspect --check` take unit and title from here. Programs compare ids, never titles.
"""

from collections.abc import Mapping
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

    unit: str  # of a linear axis; "1": a share or a count, "": a figure that is no quantity
    title: str  # as a user reads it; a limit may have one place {} for the value that it depends on
    sentence: str = ""  # what it is; "": the title says it
    symbol: str = ""  # in the paper
    better: Literal["", "less", "near one", "not negative"] = ""  # which value is better; "": neither
    colour: str = ""  # of its line in a picture; "": none
    key: str = ""  # key of the scene that a limit is compared with

    def unit_on(self, motion: Motion) -> str:
        """Return the unit for an axis in "m" or "rad"."""
        return _ROTARY.get(self.unit, self.unit) if motion == "rad" else self.unit


ACCOUNT: Final[dict[str, QuantityRow]] = {
    "in": QuantityRow("J", "energy in", "that the hand put in"),
    "out": QuantityRow("J", "energy out", "that the hand got back"),
    "interaction": QuantityRow(
        "J", "net energy (in - out)", "minus torque times displacement, summed", "h_i", colour=BLUE
    ),
    "dissipated": QuantityRow(
        "J", "dissipated", "turned into heat by the damper of the environment", "h_r", colour=ORANGE
    ),
    "stored": QuantityRow("J", "stored", "in the spring of the environment; the hand may get it back", "h_s"),
    "surplus": QuantityRow(
        "J", "surplus (energy created by sampling)", "created by sampling and not yet removed", "h_dis", "less", ORANGE,
    ),
    "surplus.max": QuantityRow("J", "  at its peak", better="less"),
    "recovered": QuantityRow("J", "surplus removed by extra damping", symbol="h_pas"),
    "paid": QuantityRow("J", "surplus removed with stored energy that was not returned"),
    "generated": QuantityRow("J", "energy created at the start of contacts", symbol="gen", better="less"),
    "leaked": QuantityRow(
        "J", "stored energy not returned", "given up by the algorithm: the spring got weaker", "leak", "less",
    ),
    "deficit": QuantityRow("J", "energy returned beyond what was stored", better="less", colour=PURPLE),
    "least_interaction": QuantityRow("J", "lowest net energy (in - out), at the motor", better="not negative"),
    "least_at_handle": QuantityRow("J", "lowest net energy (in - out), at the handle", better="not negative"),
    "least_certain": QuantityRow("J", "lowest net energy at the motor that is certain", better="not negative"),
    "least_certain_at_handle": QuantityRow(
        "J", "lowest net energy at the handle that is certain", better="not negative"
    ),
    "margin": QuantityRow(
        "J", "smallest margin (net energy less dissipated)", "eq. 4: more than a passive port needs",
        better="not negative", colour=GREEN,
    ),
    "margin.time": QuantityRow("s", "time of the smallest margin"),
    "margin.cycle": QuantityRow("1", "cycle of the smallest margin"),
    "damping_rendered": QuantityRow("N*s/m", "damping rendered", "by environment and algorithm together", colour=GREEN),
    "rendered.damping": QuantityRow("1", "damping rendered, of requested", better="near one"),
    "rendered.stiffness": QuantityRow("1", "stiffness rendered, of requested", better="near one"),
    "mass": QuantityRow("kg", "mass felt", "by the hand at an admittance display"),
    "mass.share": QuantityRow("1", "mass felt, of requested", better="near one"),
    "contact": QuantityRow("1", "cycles of contact"),
    "contact.without_torque": QuantityRow("1", "cycles of contact with zero command", better="less"),
    "contact.requested": QuantityRow("N", "effort requested in contact, summed"),
    "contact.sent": QuantityRow("N", "torque sent in contact, summed"),
    "contact.no_torque_after": QuantityRow("s", "time of the last torque"),
    "energy_resolution": QuantityRow("J", "uncertainty of the account", "largest error of its net energy", "", "less"),
    "read_back_bound": QuantityRow("J", "uncertainty from what the drive reports", better="less"),
    "uncertainty": QuantityRow("J", "uncertainty, taken off `in`", better="less"),
    "supplied": QuantityRow("J", "input from moving surfaces"),
    "device_dissipated": QuantityRow("J", "dissipated by the device, at least"),
    "energy_allowance": QuantityRow("J", "energy allowance", "that may be given out before any came in"),
    "longest_hold": QuantityRow("1", "longest time between torque updates", "in cycles", better="less"),
    "max_consecutive_losses": QuantityRow("1", "lost cycles that the certificates cover"),
    "uncommanded_cycles": QuantityRow("1", "cycles with another torque than commanded", better="less"),
    "limited_cycles": QuantityRow("1", "cycles cut by torque_limit"),
    "branches": QuantityRow("1", "cycles by how they were booked"),
    "limits": QuantityRow("1", "cycles by what limited them"),
    "friction_excess": QuantityRow("N", "force beyond declared friction and hand", better="less"),
    "hand_force": QuantityRow("N", "largest pull of the hand, as declared"),
    "peak_torque": QuantityRow("N", "largest torque"),
    "withheld_torque": QuantityRow("N", "largest torque that a dry run did not send"),
    "position": QuantityRow("m", "position", colour=BLUE),
    "wall": QuantityRow("m", "where the environment begins"),
    "reach": QuantityRow("m", "lowest and highest position"),
    "torque_applied": QuantityRow("N", "torque applied", colour=BLUE),
    "torque_command": QuantityRow("N", "requested, before limits", colour=ORANGE),
    "velocity_command": QuantityRow("m/s", "velocity commanded", colour=ORANGE),
    "effort_requested": QuantityRow("N", "effort requested by the environment"),
    "first_active": QuantityRow("s", "  first below zero at"),
    "first_active_contact": QuantityRow("1", "contact in which it was first below zero"),
    "active_since": QuantityRow("s", "below the allowance for certain since"),
    "active_at_handle_since": QuantityRow("s", "the same at the handle"),
    "passive": QuantityRow("", "passive at the motor"),
    "passive_at_handle": QuantityRow("", "passive at the handle"),
    "algorithm": QuantityRow("", "algorithm"),
    "certificates": QuantityRow("", "guarantee rests on"),
    "hold": QuantityRow("", "when a torque acts"),
}  # fmt: skip
"""Quantities of a port, by their path in the account of `run --json`; those of a cycle are columns of a log."""
TRUTH: Final[dict[str, QuantityRow]] = {
    "interaction": QuantityRow("J", "true net energy (plant)"),
    "least_interaction": QuantityRow("J", "lowest true net energy (plant)", better="not negative"),
    "least_at_handle": QuantityRow("J", "lowest true net energy at the handle (plant)", better="not negative"),
    "accounted_error": QuantityRow("J", "largest error of the account", "against the plant", "", "less"),
}  # fmt: skip
"""Energies of the simulated plant, by their key in the section `truth` of `run --json`."""


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

OLD_COLUMNS: Final = {
    "interaction": "h_i", "dissipated": "h_r", "stored": "h_s", "surplus": "h_dis", "generated": "gen",
    "leaked": "leak", "effort_requested": "effort_asked", "velocity_command": "torque_command",
}  # fmt: skip
"""Column of a log -> its name before 0.4. One release writes both, and logs of earlier ones have the old name alone."""
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
