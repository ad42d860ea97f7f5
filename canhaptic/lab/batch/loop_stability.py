"""Stability of the sampled loop of servo, hand and a two-sided spring-damper: eigenvalues of many scenes at once.

A wall in permanent contact is linear, and so is the loop around it: with z = [q, v, q before, torque that
waits] one hold is a matrix, and the loop decays where its eigenvalues are inside the unit circle. For maps of 10^4
scenes before one is run; a scene with events needs a run.
"""

from typing import NamedTuple

import numpy as np

from canhaptic.errors import ParameterError
from canhaptic.sim.plant.propagator import Array, flow_changes


class Loops(NamedTuple):
    """Many loops; each entry a number or of shape (n_loops,)."""

    mass: Array | float  # [kg or kg*m^2]
    damping: Array | float  # of bearings and hand together [N*s/m or N*m*s/rad]
    hand_stiffness: Array | float  # [N/m or N*m/rad]
    wall_stiffness: Array | float  # [N/m or N*m/rad]
    wall_damping: Array | float  # on the backward difference of the position [N*s/m or N*m*s/rad]


def loop_matrices(loops: Loops, sample_time: Array | float, delay: int) -> Array:
    """Return the matrix of one hold of each loop, shape (n_loops, 3 + delay, 3 + delay).

    Args:
        loops: Broadcast against each other.
        sample_time: T, one or of shape (n_loops,) [s].
        delay: Whole holds between computing a torque and its hold, 0 or 1.

    Raises:
        ParameterError: A mass or sample time that is not positive, or another delay.
    """
    columns = [np.atleast_1d(value) for value in (*loops, sample_time)]
    mass, damping, hand, stiffness, viscosity, period = np.broadcast_arrays(*columns)
    if delay not in (0, 1) or not np.all(period > 0.0) or not np.all(mass > 0.0):
        raise ParameterError(
            f"stability of a loop: got delay {delay}, least sample time {period.min()} s and least mass {mass.min()}, "
            "expected delay 0 or 1, sample time > 0 and mass > 0"
        )
    rates = np.zeros((len(mass), 3, 3))  # of [q, v, held torque]
    rates[:, 0, 1] = 1.0
    rates[:, 1] = np.stack([-hand / mass, -damping / mass, 1.0 / mass], axis=1)
    change = flow_changes(rates * period[:, None, None])
    size = 3 + delay  # [q, v, q before] and, with a delay, the torque that waits
    matrices = np.zeros((len(mass), size, size))
    law = np.zeros((len(mass), size))  # torque computed from the state at a SYNC
    law[:, 0], law[:, 2] = -stiffness - viscosity / period, viscosity / period
    held = law
    if delay:
        held = np.zeros_like(law)
        held[:, 3] = 1.0
        matrices[:, 3] = law
    matrices[:, :2, :2] = np.eye(2) + change[:, :2, :2]
    matrices[:, :2] += change[:, :2, 2:] * held[:, None, :]
    matrices[:, 2, 0] = 1.0
    return matrices


def decay_per_hold(loops: Loops, sample_time: Array | float, delay: int) -> Array:
    """Return the largest absolute eigenvalue of each loop, shape (n_loops,); below 1 it is stable."""
    radii: Array = np.abs(np.linalg.eigvals(loop_matrices(loops, sample_time, delay))).max(axis=1)
    return radii
