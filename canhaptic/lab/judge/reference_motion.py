"""Motion of the states found by a reference method, and the difference of two motions."""

from typing import NamedTuple

import numpy as np

from canhaptic.lab.judge.reference_elements import Floats
from canhaptic.lab.judge.reference_model import MOTOR_WORK, USER_WORK
from canhaptic.sim.plant.plant_motion import Motion
from canhaptic.sim.plant.propagator import Array


class MotionError(NamedTuple):
    """Largest difference of two motions at the end of any hold."""

    position: float  # [m or rad]
    force: float  # mean net force on the motor's body over a hold [N or N*m]
    energy: float  # work of the motor, work of the user or kinetic energy, whichever differs most [J]

    @property
    def is_finite(self) -> bool:
        """Whether all values are finite."""
        return bool(np.isfinite(self.position) and np.isfinite(self.force) and np.isfinite(self.energy))


def motion_of(states: list[Floats]) -> Motion:
    """Return the motion of states at the ends of holds."""
    table = np.array(states, dtype=float).reshape(len(states), -1)
    return Motion(table[:, 0], table[:, 1], table[:, MOTOR_WORK], table[:, USER_WORK])


def difference(one: Motion, other: Motion, mass: float, sample_time: float) -> MotionError:
    """Difference of two motions; infinite where one of them is not finite.

    Args:
        one: A motion.
        other: Another over the same holds.
        mass: Mass of the motor's body [kg or kg*m^2].
        sample_time: Sample time [s].
    """
    with np.errstate(all="ignore"):
        kicks = np.diff(one.velocity - other.velocity, prepend=0.0) * (mass / sample_time)
        kinetic = 0.5 * mass * (one.velocity**2 - other.velocity**2)
        works = (one.motor - other.motor, one.user - other.user, kinetic)
        largest = [_largest(one.position - other.position), _largest(kicks), max(_largest(work) for work in works)]
    return MotionError(*largest)


def _largest(values: Array) -> float:
    return float(np.abs(values).max(initial=0.0)) if np.all(np.isfinite(values)) else float("inf")
