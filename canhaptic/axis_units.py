"""Units of force and damping by the unit of a position: without pydantic, for readers and writers of logs."""

from typing import Literal

Motion = Literal["m", "rad"]
"""Whether an axis slides or turns, by the unit of its position."""


def effort_unit(motion: str) -> str:
    """Returns the unit of force or torque of an axis whose position is in "m" or in "rad"."""
    return "N" if motion == "m" else "N*m"


def damping_unit(motion: str) -> str:
    """Returns the unit of damping of an axis whose position is in "m" or in "rad"."""
    return "N*s/m" if motion == "m" else "N*m*s/rad"
