"""Kinematics between motor axes and task space: one mechanism a file, and the table that names them."""

from typing import Final

_HERE: Final = "canhaptic.control.mechanisms"

KINEMATICS: Final[dict[str, str]] = {
    "identity": f"{_HERE}.kinematics:Identity",
    "transmission": f"{_HERE}.transmission:Transmission",
    "planar_2r": f"{_HERE}.planar_2r:Planar2R",
    "five_bar": f"{_HERE}.five_bar:FiveBar",
}
"""Name in a scene -> "module:Class"; the class is the parameter model and the mechanism in one (`Kinematics`).

A user-defined mechanism is `kinematics.UserFunction(forward, jacobian, at, limit)`, in Python only.
"""
