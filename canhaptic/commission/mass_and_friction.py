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
_RANGES: Final = 6
"""Ranges of speed; friction is found in each by itself."""
_FEWEST_RANGES: Final = 3
_FEWEST_OF_A_RANGE: Final = 8
"""Windows in each direction that a range of speed needs."""
_OVERLAP: Final = 2.0
"""Windows begin every quarter of their length: n of them tell as much as n / 4 that do not overlap."""
_PARTS: Final = 8
"""Parts of a window; the axis must move on in each."""
_REVERSAL_PARTS: Final = 4
"""The same of a window about a reversal of the torque, which is short."""
_SLOWEST: Final = 0.2
"""Part of the fastest motion below which a window says nothing of a late torque: the axis sticks or turns in it."""
_STILL: Final = 1e-12  # [m or rad] in one sample time: the sign of the speed is then 0


class Dynamics(NamedTuple):
    """Mass and friction that move with the encoder; each value with one standard deviation."""

    mass: float  # [kg or kg*m^2]
    mass_error: float
    damping: float  # [N*s/m or N*m*s/rad]
    damping_error: float
    friction: float  # Coulomb friction [N or N*m]
    friction_error: float
    offset: float  # constant load, such as weight [N or N*m]
    residual: float  # rms of what the four do not explain [N or N*m]


def estimate(positions: _Array, applied: _Array, sample_time: float, half_base: int) -> Dynamics | None:
    """Least-squares estimate, or None when too little moved.

    Args:
        positions: Position at each SYNC, shape (n,) [m or rad].
        applied: Torque of the hold that ended there, shape (n,) [N or N*m].
        sample_time: Sample time [s].
        half_base: Half the base of the triangle, in sample times; longer is quieter and smooths fast motion.
    """
    starts = np.arange(0, len(positions) - 2 * half_base, max(1, half_base // 2))
    if len(starts) < _FEWEST_EQUATIONS or np.ptp(positions) == 0.0:
        return None
    solved = _solve(*_equations(positions, applied, sample_time, half_base, starts))
    if solved is None:
        return None
    (m, b, c, f), (m_error, b_error, c_error, _), rest = solved
    return Dynamics(m, m_error, b, b_error, c, c_error, f, rest)


class FrictionCurve(NamedTuple):
    """Mass, and friction by speed while the axis moves; each value with one standard deviation."""

    mass: float  # [kg or kg*m^2]
    mass_error: float
    speeds: _Array  # mean of each range of speed, rising, shape (n,) [m/s or rad/s]
    frictions: _Array  # braking force there, by any law, shape (n,) [N or N*m]
    errors: _Array  # shape (n,)

    def least(self, damping: float, sure: float) -> float:
        """Return the dry friction [N or N*m] that every range has besides a damping, less some standard deviations."""
        return max(0.0, float((self.frictions - sure * self.errors - damping * self.speeds).min()))

    def falls_at_its_end(self, sure: float) -> bool:
        """Whether friction is still falling in the fastest range: friction at higher speed is then unknown."""
        if len(self.speeds) < _FEWEST_RANGES:
            return True
        last, before = self.frictions[-1], self.frictions[:-1] - sure * (self.errors[:-1] + self.errors[-1])
        return bool(last < before.min())


def friction_curve(positions: _Array, applied: _Array, sample_time: float, half_base: int) -> FrictionCurve | None:
    """Mass and friction by speed, or None when too little moved both ways.

    A friction that falls with speed (Stribeck) is neither c nor b v: fitted with one c for all speeds it makes the mass
    too large, and c is above the truth at some speed. So the windows in which the axis moves one way throughout are
    sorted by speed, and each range of speed has a friction of its own. Arguments as of `estimate`.
    """
    starts, ways = _one_way(positions, half_base, half_base // 2)
    if len(starts) < _FEWEST_RANGES * 2 * _FEWEST_OF_A_RANGE:
        return None
    matrix, torque = _equations(positions, applied, sample_time, half_base, starts)
    speed = np.abs(matrix[:, 1])
    borders = np.quantile(speed, np.linspace(0.0, 1.0, _RANGES + 1)[1:-1])
    within = np.searchsorted(borders, speed)[:, None] == np.arange(_RANGES)[None, :]
    known = np.minimum((within & (ways > 0)[:, None]).sum(axis=0), (within & (ways < 0)[:, None]).sum(axis=0))
    within = within[:, known >= _FEWEST_OF_A_RANGE]
    rows = within.any(axis=1)
    columns = np.column_stack([matrix[rows, 0], within[rows] * ways[rows, None], np.ones(int(rows.sum()))])
    solved = _solve(columns, torque[rows]) if within.shape[1] else None
    if solved is None:
        return None
    (mass, *frictions, _), (mass_error, *errors, _), _ = solved
    means = [float(speed[some].mean()) for some in within.T]
    spread = _OVERLAP * np.array(errors)
    return FrictionCurve(mass, _OVERLAP * mass_error, np.array(means), np.array(frictions), spread)


def _one_way(
    positions: _Array, half_base: int, stride: int, count: int = _PARTS, slowest: float = 0.0
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Starts of the windows in which the axis moves one way in every part, and that direction, 1 or -1.

    Args:
        positions: Position at each SYNC, shape (n,) [m or rad].
        half_base: Half the length of a window, in sample times.
        stride: Distance from window to window, in sample times.
        count: Parts of a window.
        slowest: Least motion in a part, as a share of the fastest tenth of all.
    """
    starts = np.arange(0, len(positions) - 2 * half_base, max(1, stride))
    if not len(starts):
        return starts, starts
    ends = starts[:, None] + np.linspace(0, 2 * half_base, min(count, 2 * half_base) + 1).astype(int)[None, :]
    parts = np.diff(positions[ends], axis=1)
    least = max(_STILL, slowest * float(np.quantile(np.abs(parts).max(axis=1), 0.9)))
    ways = (parts >= least).all(axis=1).astype(np.int64) - (parts <= -least).all(axis=1)
    return starts[ways != 0], ways[ways != 0]


def estimate_lateness(
    positions: _Array, applied: _Array, sample_time: float, half_base: int
) -> tuple[float, float] | None:
    """Return the delay of the torque after its SYNC, and one standard deviation [s].

    It is the time for which the previous torque still acts in every hold: window and lag together. In a hold whose
    torque changes by d the mean torque is less by late d / T, so that one more column of `estimate` finds it.
    A torque that reverses while the axis is fastest shows most (`laws.reversals`): friction that turns or sticks within
    a window would be taken for a late torque. Arguments as of `estimate`; None when the motion was too small.
    """
    starts, ways = _one_way(positions, half_base, half_base // 4, _REVERSAL_PARTS, _SLOWEST)
    if len(starts) < _FEWEST_EQUATIONS:
        return None
    matrix, torque = _equations(positions, applied, sample_time, half_base, starts)
    matrix[:, 2] = ways  # a coarse encoder shows no direction in some holds
    window = starts[:, None] + np.arange(2 * half_base)[None, :]
    changes = (np.diff(applied, prepend=applied[0])[1:][window] @ _triangle(half_base)) / sample_time
    solved = _solve(np.column_stack([matrix, changes]), torque)
    return None if solved is None else (solved[0][-1], solved[1][-1])


def mass_within(positions: _Array, applied: _Array, sample_time: float, half_base: int) -> tuple[float, float] | None:
    """Return the mass that a torque moves within a short time, and one standard deviation [kg or kg*m^2].

    A torque that changes faster than a shaft twists moves the rotor alone: with a spring k between rotor m and load M,
    acceleration over torque at the angular frequency w is 1 / (m - k M / (M w^2 - k)), so that above the resonance
    w^2 = k (1 / m + 1 / M) the mass seen is below m, and rises to it; below it is that of rotor and load, or more. A
    late torque has a column of its own, as in `estimate_lateness`. Arguments as of `estimate`.
    """
    starts = np.arange(1, len(positions) - 2 * half_base)
    if len(starts) < _FEWEST_EQUATIONS or np.ptp(positions) == 0.0:
        return None
    matrix, torque = _equations(positions, applied, sample_time, half_base, starts)
    window = starts[:, None] + np.arange(2 * half_base)[None, :]
    changes = np.diff(applied, prepend=applied[0])[1:][window] @ _triangle(half_base)
    used = (0, 2, 3) if np.ptp(matrix[:, 2]) > 0.0 else (0, 3)  # too short for damping; friction only where it turns
    solved = _solve(np.column_stack([matrix[:, used], changes]), torque)
    return None if solved is None else (solved[0][0], _OVERLAP * solved[1][0])


def _equations(
    positions: _Array, applied: _Array, sample_time: float, half_base: int, starts: NDArray[np.int64]
) -> tuple[_Array, _Array]:
    """Columns of m, b, c and f, and the mean torques they sum to."""
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
    """Return the mean weight of each hold under a triangle that rises and falls over `half_base` holds each."""
    rising = np.arange(half_base) + 0.5
    return np.concatenate([rising, rising[::-1]]) / half_base**2


def _solve(matrix: _Array, torque: _Array) -> tuple[list[float], list[float], float] | None:
    """Least-squares solution, its standard deviations and the rms residual.

    None where the columns of the matrix do not separate the unknowns.
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
