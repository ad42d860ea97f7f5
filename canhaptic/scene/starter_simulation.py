"""Common parts of the starter scenes of both kinds of displays: guesses of timing, and the simulated machine."""

from string import Template
from typing import Final

from canhaptic.scene.guesses import TO_SET

JITTER: Final = f"  sync_jitter: 5 % # {TO_SET}: every hold lasts 1 / rate, give or take this (canhaptic commission)\n"

_TEXT: Final = Template("""
# The machine behind the simulated drive. Remove this section and name the real interface under `bus`.
simulation:
  drive:
    rated_torque: $rated N*m
$objects  plant:
    mass: $mass kg*m^2
    damping: $bearings N*m*s/rad
$between  user: # $hand
    stiffness: $stiffness N*m/rad
    damping: $hand_damping N*m*s/rad
    motion: {type: sinusoid, amplitude: $amplitude rad, frequency: $frequency Hz}
""")


def number(value: float) -> str:
    """Return a number of a starter scene: three digits are enough for a guess."""
    return f"{value:.3g}"


def simulated_machine(
    rated: float, objects: str, mass: float, bearings: float, limit: float, hand: str, between: str = "",
    motion: tuple[float, float] = (0.15, 0.5),
) -> str:  # fmt: skip
    """Return the section `simulation`.

    Args:
        rated: Rated torque [N*m].
        objects: Lines of `simulation.drive`.
        mass: Moved inertia [kg*m^2].
        bearings: Damping of the bearings [N*m*s/rad].
        limit: Torque limit, to which the hand is scaled [N*m].
        hand: Comment on the motion of the hand.
        between: Further lines, before the hand.
        motion: Amplitude [rad] and frequency [Hz] of the hand.
    """
    return _TEXT.substitute(
        rated=f"{rated:g}", objects=objects, mass=number(mass), bearings=number(bearings), between=between, hand=hand,
        amplitude=motion[0], frequency=motion[1],
        stiffness=number(3.0 * limit), hand_damping=number(0.25 * limit),
    )  # fmt: skip
