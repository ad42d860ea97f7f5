"""Quantities as text: units of an axis in "m" or "rad", values with an SI prefix, and counts with a noun.

Nothing here needs pydantic: the writer process of a log starts without it.
"""

import math
import re
from typing import Final, Literal

_PREFIXES: Final = {-15: "f", -12: "p", -9: "n", -6: "u", -3: "m", 0: "", 3: "k", 6: "M", 9: "G"}
_UNPREFIXED: Final = {"1", "", "%", "rad"}  # units that do not take a prefix well

Motion = Literal["m", "rad"]
"""Unit of the position of an axis: "m" for a linear axis, "rad" for a rotary one."""


def effort_unit(motion: str) -> str:
    """Return the unit of force or torque of an axis whose position is in "m" or in "rad"."""
    return "N" if motion == "m" else "N*m"


def damping_unit(motion: str) -> str:
    """Return the unit of damping of an axis whose position is in "m" or in "rad"."""
    return "N*s/m" if motion == "m" else "N*m*s/rad"


def stiffness_unit(motion: str) -> str:
    """Return the unit of stiffness of an axis whose position is in "m" or in "rad"."""
    return "N/m" if motion == "m" else "N*m/rad"


def mass_unit(motion: str) -> str:
    """Return the unit of mass or inertia of an axis whose position is in "m" or in "rad"."""
    return "kg" if motion == "m" else "kg*m^2"


DEGREE: Final = math.pi / 180.0
_DEGREES: Final = re.compile(r"^[^#\n]*\d *deg\b", re.MULTILINE)


def uses_degrees(scene: str) -> bool:
    """Return whether the text of a scene gives an angle in degrees."""
    return _DEGREES.search(scene) is not None


def place(value: float, unit: str, digits: int = 4, *, in_degrees: bool = False) -> str:
    """Return a position [m or rad] with its unit, an angle in degrees if the scene gives angles so."""
    return f"{value / DEGREE:.{digits}g} deg" if in_degrees and unit == "rad" else si(value, unit, digits)


def counted(number: int | str, noun: str) -> str:
    """Return a count with its noun, such as `1 cycle` or `2 cycles`."""
    return f"{number} {noun}{'s' * (str(number) != '1')}"


def prefixes_of(unit: str) -> list[tuple[float, str]]:
    """Return scale and name of every SI prefix that suits a unit, largest first."""
    if unit in _UNPREFIXED:
        return [(1.0, "")]
    largest = 0 if unit == "s" else max(_PREFIXES)
    return [(10.0**power, prefix) for power, prefix in sorted(_PREFIXES.items(), reverse=True) if power <= largest]


def si(value: float, unit: str, digits: int = 4) -> str:
    """Return a value with a prefixed unit, such as `12.34 mJ`.

    Args:
        value: Value in `unit`.
        unit: SI unit; "1" or "" for a pure number.
        digits: Significant digits.
    """
    if unit in _UNPREFIXED:
        return f"{value:.{digits}g}" + (f" {unit}" if unit not in {"1", ""} else "")
    value = value + 0.0  # no minus zero
    if value == 0.0 or not math.isfinite(value):
        return f"{value:g} {unit}"
    if unit.startswith("kg"):
        value, unit = 1e3 * value, unit[1:]
    exponent = 3 * math.floor(math.floor(math.log10(abs(value))) / 3)
    exponent = min(max(exponent, min(_PREFIXES)), max(_PREFIXES))
    number = f"{value / 10.0**exponent:.{digits}g}"
    if abs(float(number)) >= 1000.0 and exponent < max(_PREFIXES):  # 999.96 rounded up
        exponent += 3
        number = f"{value / 10.0**exponent:.{digits}g}"
    if "e" in number:  # below the smallest prefix
        return f"{value:.{digits - 1}e} {unit}"
    return f"{_pad_digits(number, digits)} {_PREFIXES[exponent]}{unit}"


def _pad_digits(number: str, digits: int) -> str:
    """Append zeros up to the given number of digits, so that a column of numbers lines up: 1.5 -> 1.500."""
    shown = sum(letter.isdigit() for letter in number.lstrip("-0."))
    if shown >= digits:
        return number
    return number + ("" if "." in number else ".") + "0" * (digits - shown)
