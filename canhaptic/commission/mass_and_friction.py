"""Mass and friction from torque and position, without differentiating noise.

Over any weight w(t) the equation of motion m a + b v + c sign(v) + f = tau holds for the weighted means. With a
triangle of base 2 n T the mean acceleration is (q(j+2n) - 2 q(j+n) + q(j)) / (n T)^2 exactly, for any motion in
between; of the torque, constant between SYNCs, the mean is exact as well. What remains is linear in m, b, c and f.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

_Array = NDArray[np.float64]

_FEWEST_EQUATIONS: Final = 20
_STILL: Final = 1e-12  # [m or rad] in one sample time: the sign of the speed is then 0


class Dynamics(NamedTuple):
    """What moves with the encoder; each value with one standard deviation."""

    mass: float  # [kg or kg*m^2]
    mass_error: float
    damping: float  # [N*s/m or N*m*s/rad]
    damping_error: float
    friction: float  # Coulomb friction [N or N*m]
    friction_error: float
    offset: float  # constant load, such as weight [N or N*m]
    residual: float  # rms of what the four do not explain [N or N*m]


def estimate(positions: _Array, applied: _Array, sample_time: float, half_base: int) -> Dynamics | None:
    """Returns the least-squares estimate, or None when too little moved to tell.

    Args:
        positions: At each SYNC, shape (n,) [m or rad].
        applied: Torque of the hold that ended there, shape (n,) [N or N*m].
        sample_time: [s]
        half_base: Half the base of the triangle, in sample times; longer is quieter and blurs fast motion.
    """
    starts = np.arange(0, len(positions) - 2 * half_base, max(1, half_base // 2))
    if len(starts) < _FEWEST_EQUATIONS or np.ptp(positions) == 0.0:
        return None
    solved = _solve(*_equations(positions, applied, sample_time, half_base, starts))
    if solved is None:
        return None
    (m, b, c, f), (m_error, b_error, c_error, _), rest = solved
    return Dynamics(m, m_error, b, b_error, c, c_error, f, rest)


def estimate_lateness(
    positions: _Array, applied: _Array, sample_time: float, half_base: int
) -> tuple[float, float] | None:
    """Returns by how much the torque comes later than the SYNC it belongs to, and one standard deviation [s].

    It is the time for which the torque before acts on in every hold: window and lag together. Of a hold in which the
    torque has changed by d, a mean torque less by late d / T acts, so that one more column of `estimate` finds it.
    Arguments as of `estimate`; None when too little moved to tell.
    """
    starts = np.arange(1, len(positions) - 2 * half_base, max(1, half_base // 4))
    step, weights = np.diff(positions), np.arange(2 * half_base)[None, :]
    if len(starts):  # dry friction that turns or sticks in between would be taken for a late torque
        moving = step[starts[:, None] + weights]
        starts = starts[(moving > _STILL).all(axis=1) | (moving < -_STILL).all(axis=1)]
    if len(starts) < _FEWEST_EQUATIONS:
        return None
    matrix, torque = _equations(positions, applied, sample_time, half_base, starts)
    window = starts[:, None] + weights
    changes = (np.diff(applied, prepend=applied[0])[1:][window] @ _triangle(half_base)) / sample_time
    solved = _solve(np.column_stack([matrix, changes]), torque)
    return None if solved is None else (solved[0][-1], solved[1][-1])


def _equations(
    positions: _Array, applied: _Array, sample_time: float, half_base: int, starts: NDArray[np.int64]
) -> tuple[_Array, _Array]:
    """Returns the columns of m, b, c and f, and the mean torques that they add up to."""
    holds = _triangle(half_base)  # weights of the 2 n holds, sum 1
    step = np.diff(positions)
    window = starts[:, None] + np.arange(2 * half_base)[None, :]
    middle, end = positions[starts + half_base], positions[starts + 2 * half_base]
    acceleration = (end - 2.0 * middle + positions[starts]) / (half_base * sample_time) ** 2
    velocity = (step[window] @ holds) / sample_time
    direction = np.where(np.abs(step) > _STILL, np.sign(step), 0.0)[window] @ holds
    matrix = np.column_stack([acceleration, velocity, direction, np.ones(len(starts))])
    return matrix, applied[1:][window] @ holds


def _triangle(half_base: int) -> _Array:
    """Returns the mean weight of each hold under a triangle that rises and falls over `half_base` holds each."""
    rising = np.arange(half_base) + 0.5
    return np.concatenate([rising, rising[::-1]]) / half_base**2


def _solve(matrix: _Array, torque: _Array) -> tuple[list[float], list[float], float] | None:
    """Returns the least-squares solution, its standard deviations and the rms of the rest.

    None where the columns of the matrix do not tell the unknowns apart.
    """
    scale = np.linalg.norm(matrix, axis=0)
    used = scale > 0.0
    normed, unknowns = matrix[:, used] / scale[used], int(np.count_nonzero(used))
    if np.linalg.matrix_rank(normed) < unknowns:
        return None
    solution, *_ = np.linalg.lstsq(normed, torque, rcond=None)
    rest = torque - normed @ solution
    variance = float(rest @ rest) / max(1, len(torque) - unknowns)
    values, errors = np.zeros(matrix.shape[1]), np.zeros(matrix.shape[1])
    values[used] = solution / scale[used]
    errors[used] = np.sqrt(np.diag(np.linalg.inv(normed.T @ normed)) * variance) / scale[used]
    return values.tolist(), errors.tolist(), variance**0.5
