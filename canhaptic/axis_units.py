"""Units of mass, damping, stiffness and force for a unit of position, and counts with their nouns, without pydantic."""

from typing import Literal

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


def counted(number: int | str, noun: str) -> str:
    """Return a count with its noun, such as `1 cycle` or `2 cycles`."""
    return f"{number} {noun}{'s' * (str(number) != '1')}"
