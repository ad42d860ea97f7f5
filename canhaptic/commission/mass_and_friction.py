"""Mass, friction and lateness of the torque, estimated from torques and positions; what their uncertainty costs.

The equation of motion m a + b v + c sign(v) + f = tau also holds for weighted means over time. Under a triangle of
base 2 n T the mean acceleration is exactly (q(j+2n) - 2 q(j+n) + q(j)) / (n T)^2, for any motion in between. The mean
of the torque, constant between SYNCs, is exact as well. The equations are then linear in m, b, c and f.

The lateness is measured by reversals of the torque while the axis is fastest, timed against the commands.

The safe end of each measured interval is declared. It makes the wall softer, which an energy allowance can offset.
"""

import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from canhaptic.commission.session import OpenLoop, Session, StepVerdict, reversals
from canhaptic.commission.which_hold import HoldTimes, as_declared, report_hold, time_the_hold
from canhaptic.drive.can.bus_budget import shortest_answer
from canhaptic.drive.can.pdo_map import choose_map
from canhaptic.scene import hints
from canhaptic.scene.first_contact import ALLOWANCES, share_of_wall, with_declared
from canhaptic.scene.models import AxisScene

_Array = NDArray[np.float64]

_FEWEST_EQUATIONS: Final = 20
_RANGES: Final = 6
"""Ranges of speed; friction is found separately in each."""
_FEWEST_RANGES: Final = 3
_FEWEST_OF_A_RANGE: Final = 8
"""Windows in each direction that a range of speed needs."""
_OVERLAP: Final = 2.0
"""Windows begin every quarter of their length: n of them hold the information of n / 4 that do not overlap."""
_LATE: Final = range(-2, 6)
"""Holds after which a torque may act, counted from where it is booked: later or, read back late, earlier."""
_REST: Final = 1.5  # holds next to the best whole number of them
_STILL: Final = 1e-12  # [m or rad] in one sample time: the sign of the speed is then 0


class Dynamics(NamedTuple):
    """Mass and friction as seen at the encoder; each value with its standard deviation."""

    mass: float  # [kg or kg*m^2]
    mass_error: float
    damping: float  # [N*s/m or N*m*s/rad]
    damping_error: float
    friction: float  # Coulomb friction [N or N*m]
    friction_error: float
    offset: float  # constant load, such as weight: the torque that holds it [N or N*m]
    residual: float  # rms of what the four do not explain [N or N*m]
    offset_error: float = 0.0


def estimate(positions: _Array, applied: _Array, sample_time: float, half_base: int) -> Dynamics | None:
    """Estimate mass and friction by least squares; None when the axis moved too little.

    Args:
        positions: Position at each SYNC, shape (n,) [m or rad]; not a number after skipped SYNCs.
        applied: Torque of the hold that ended there, shape (n,) [N or N*m].
        sample_time: Sample time [s].
        half_base: Half the base of the triangle [sample times]; longer is quieter and smooths fast motion.
    """
    starts = _windows(positions, half_base, 0, max(1, half_base // 2))
    if starts is None:
        return None
    solved = _solve(*_equations(positions, applied, sample_time, half_base, starts))
    if solved is None:
        return None
    (m, b, c, f), (m_error, b_error, c_error, f_error), rest = solved
    return Dynamics(m, m_error, b, b_error, c, c_error, f, rest, f_error)


def mass_of_late_torque(
    positions: _Array, applied: _Array, sample_time: float, half_base: int
) -> tuple[float, float] | None:
    """Return the mass and its standard deviation where it is not known when the torque acts [kg or kg*m^2].

    With damping b, a torque that acts d later than booked makes the mass of `estimate` too large by b d. So the torque
    is delayed by the whole holds that explain the motion best, and its changes have a column of their own for the rest,
    as in `estimate_lateness`. The deviation holds the masses of all delays that explain the motion about as well.
    Arguments as for `estimate`; None: too little motion, or another lateness than any drive has.
    """
    starts = _windows(positions, half_base, 0, max(1, half_base // 2))
    if starts is None:
        return None
    fits = list[tuple[float, float, float, float]]()  # rms acceleration not explained, mass, its error, rest of the lag
    for holds in _LATE:
        late = _delayed(applied, holds)
        matrix, torque = _equations(positions, late, sample_time, half_base, starts)
        changes = _in_windows(np.diff(late, prepend=0.0)[1:], starts, half_base)
        solved = _solve(np.column_stack([matrix, changes]), torque)
        if solved is not None:
            (mass, *_, rest), (error, *_, rest_error), residual = solved
            outside = abs(rest) - SURE * _OVERLAP * rest_error
            fits.append((residual / abs(mass), mass, _OVERLAP * error, outside))
    if not fits:
        return None
    # A likelihood ratio of two standard deviations; the windows hold less information than their number
    worst = min(fits)[0] * math.exp(0.5 * SURE**2 * _OVERLAP**2 / len(starts))
    likely = [of for of in fits if of[0] <= worst]
    own = [of for of in likely if of[3] <= _REST]  # slow motion does not tell delays apart, nor needs to
    if not own:
        return None
    _, mass, error, _ = min(own)
    possible = [of[1] for of in likely]
    return mass, max(error, max(possible) - mass, mass - min(possible))


def _delayed(applied: _Array, holds: int) -> _Array:
    """Return the torques so many holds later, 0 before the first and after the last."""
    late = np.zeros_like(applied)
    late[max(0, holds) : len(late) + min(0, holds)] = applied[max(0, -holds) : len(late) - max(0, holds)]
    return late


class FrictionCurve(NamedTuple):
    """Mass, and friction by speed while the axis moves; each value with its standard deviation."""

    mass: float  # [kg or kg*m^2]
    mass_error: float
    speeds: _Array  # mean of each range of speed, rising, shape (n,) [m/s or rad/s]
    frictions: _Array  # braking force there, by any law, shape (n,) [N or N*m]
    errors: _Array  # shape (n,)

    def least(self, damping: float, sure: float) -> float:
        """Return the least friction of any speed range, less the damping and `sure` standard deviations [N or N*m]."""
        return max(0.0, float((self.frictions - sure * self.errors - damping * self.speeds).min()))

    def falls_at_its_end(self, sure: float) -> bool:
        """Whether friction is still falling in the fastest range: friction at higher speed is then unknown."""
        if len(self.speeds) < _FEWEST_RANGES:
            return True
        last, before = self.frictions[-1], self.frictions[:-1] - sure * (self.errors[:-1] + self.errors[-1])
        return bool(last < before.min())


def friction_curve(positions: _Array, applied: _Array, sample_time: float, half_base: int) -> FrictionCurve | None:
    """Mass and friction by speed, or None when the axis moved too little in either direction.

    A friction that falls with speed (Stribeck) is neither c nor b v: fitted with one c for all speeds it makes the mass
    too large, and c exceeds the true friction at some speed. So the windows in which the axis moves one way are
    sorted by speed, and each range of speed has a friction of its own. Arguments as for `estimate`.
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
    solved = _solve(columns, torque[rows]) if within.shape[1] >= _FEWEST_RANGES else None
    if solved is None:
        return None
    (mass, *frictions, _), (mass_error, *errors, _), _ = solved
    means = [float(speed[some].mean()) for some in within.T]
    spread = _OVERLAP * np.array(errors)
    return FrictionCurve(mass, _OVERLAP * mass_error, np.array(means), np.array(frictions), spread)


class Sweep(NamedTuple):
    """What a sweep recorded, for `estimate` and `friction_curve`."""

    positions: _Array  # at each SYNC, shape (n,) [m or rad]
    applied: _Array  # torque that the drive says acted in the hold that ended there, shape (n,) [N or N*m]
    booked: _Array  # torque that was to act in it, shape (n,)
    sample_time: float
    half_base: int

    def dynamics(self, late: tuple[float, float] | None = None) -> tuple[Dynamics, FrictionCurve | None] | None:
        """Return mass and friction, the mass free of friction that falls with speed; None where it stays unclear.

        With damping b, a torque that acts d later than booked makes the mass too large by b d; with dry friction, by
        more, and the dry friction too small.

        Args:
            late: Lateness of the booked torque and its standard deviation [s]; None: not known.
        """
        if late is None:
            return self._of(self.applied)
        ends = [self._of(_delayed_by(self.booked, lag / self.sample_time)) for lag in (late[0], late[0] + late[1])]
        if ends[0] is None or ends[1] is None:
            return None
        (found, curve), (later, _) = ends[0], ends[1]
        return found._replace(mass_error=math.hypot(found.mass_error, found.mass - later.mass)), curve

    def _of(self, applied: _Array) -> tuple[Dynamics, FrictionCurve | None] | None:
        record = self.positions, applied, self.sample_time, self.half_base
        found, curve = estimate(*record), friction_curve(*record)
        if found is not None and curve is not None:
            found = found._replace(mass=curve.mass, mass_error=curve.mass_error)
        return (found, curve) if found is not None and found.mass > SURE * found.mass_error else None


def _delayed_by(torques: _Array, holds: float) -> _Array:
    """Return the mean torque of each hold where each acts so many holds later, whole or not."""
    whole = math.floor(holds)
    return (1.0 - holds + whole) * _delayed(torques, whole) + (holds - whole) * _delayed(torques, whole + 1)


def _one_way(
    positions: _Array, half_base: int, stride: int, count: int = 8, slowest: float = 0.0
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Starts of the windows in which the axis moves one way in every part, and that direction, 1 or -1.

    Args:
        positions: Position at each SYNC, shape (n,) [m or rad].
        half_base: Half the length of a window, in sample times.
        stride: Distance from window to window, in sample times.
        count: Parts of a window.
        slowest: Least motion in a part, relative to the fastest tenth of all windows.
    """
    starts = _unbroken(positions, half_base, np.arange(0, len(positions) - 2 * half_base, max(1, stride)))
    if not len(starts):
        return starts, starts
    ends = starts[:, None] + np.linspace(0, 2 * half_base, min(count, 2 * half_base) + 1).astype(int)[None, :]
    parts = np.diff(positions[ends], axis=1)
    least = max(_STILL, slowest * float(np.quantile(np.abs(parts).max(axis=1), 0.9)))
    ways = (parts >= least).all(axis=1).astype(np.int64) - (parts <= -least).all(axis=1)
    return starts[ways != 0], ways[ways != 0]


def _unbroken(positions: _Array, half_base: int, starts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Starts of the windows without a position that is not a number: a sample time there was longer than it counts."""
    missing = np.concatenate([[0], np.cumsum(~np.isfinite(positions))])
    unbroken: NDArray[np.int64] = starts[missing[starts + 2 * half_base + 1] == missing[starts]]
    return unbroken


def estimate_lateness(
    positions: _Array, applied: _Array, sample_time: float, half_base: int
) -> tuple[float, float] | None:
    """Return the delay of the torque after its SYNC, and its standard deviation [s].

    The delay is the time for which the previous torque still acts in each hold: window and lag together. A torque that
    changes by d in a hold has a mean lower by (delay / T) d, and one more column of `estimate` finds the delay. The
    torque should reverse while the axis is fastest (`reversals`): friction that reverses or sticks in a window would be
    mistaken for a late torque. Whole holds are taken off first: the column is for a part of one. Arguments as for
    `estimate`; None when the motion was too small.
    """
    first = _late_part(positions, applied, sample_time, half_base)
    whole = 0 if first is None else round(first[0] / sample_time)
    if not whole or whole not in _LATE:
        return first
    rest = _late_part(positions, _delayed(applied, whole), sample_time, half_base)
    return first if rest is None else (whole * sample_time + rest[0], rest[1])


def _late_part(positions: _Array, applied: _Array, sample_time: float, half_base: int) -> tuple[float, float] | None:
    """Return the delay of the torque, less than a hold, and its standard deviation [s]."""
    # A window about a reversal is short; in one with less than a fifth of the fastest motion the axis sticks or turns.
    starts, ways = _one_way(positions, half_base, half_base // 4, 4, 0.2)
    if len(starts) < _FEWEST_EQUATIONS:
        return None
    matrix, torque = _equations(positions, applied, sample_time, half_base, starts)
    matrix[:, 2] = ways  # a coarse encoder shows no direction in some holds
    changes = _in_windows(np.diff(applied, prepend=applied[0])[1:], starts, half_base) / sample_time
    solved = _solve(np.column_stack([matrix, changes]), torque)
    return None if solved is None else (solved[0][-1], solved[1][-1])


def mass_within(positions: _Array, applied: _Array, sample_time: float, half_base: int) -> tuple[float, float] | None:
    """Return the mass that a torque moves within a short time, and its standard deviation [kg or kg*m^2].

    A torque that changes faster than a shaft twists moves the rotor alone: with a spring k between rotor m and load M,
    acceleration over torque at the angular frequency w is 1 / (m - k M / (M w^2 - k)). Above the resonance
    w^2 = k (1 / m + 1 / M) the apparent mass is below m and tends to m; at low frequency it is m + M or more. A late
    torque has a column of its own, as in `estimate_lateness`. Arguments as for `estimate`.
    """
    starts = _windows(positions, half_base, 1, 1)
    if starts is None:
        return None
    matrix, torque = _equations(positions, applied, sample_time, half_base, starts)
    changes = _in_windows(np.diff(applied, prepend=applied[0])[1:], starts, half_base)
    used = (0, 2, 3) if np.ptp(matrix[:, 2]) > 0.0 else (0, 3)  # too short for damping; friction only where it turns
    solved = _solve(np.column_stack([matrix[:, used], changes]), torque)
    return None if solved is None else (solved[0][0], _OVERLAP * solved[1][0])


def _windows(positions: _Array, half_base: int, first: int, every: int) -> NDArray[np.int64] | None:
    """Return where the windows without a gap begin; None where there are too few, or the axis did not move."""
    starts = _unbroken(positions, half_base, np.arange(first, len(positions) - 2 * half_base, every))
    is_enough = len(starts) >= _FEWEST_EQUATIONS and np.nanmin(positions) != np.nanmax(positions)
    return starts if is_enough else None


def _equations(
    positions: _Array, applied: _Array, sample_time: float, half_base: int, starts: NDArray[np.int64]
) -> tuple[_Array, _Array]:
    """Return the regression columns of m, b, c and f, shape (n, 4), and the mean torque of each window, shape (n,)."""
    step = np.diff(positions)
    middle, end = positions[starts + half_base], positions[starts + 2 * half_base]
    acceleration = (end - 2.0 * middle + positions[starts]) / (half_base * sample_time) ** 2
    velocity = (_in_windows(step, starts, half_base) + _within_holds(positions, starts, half_base)) / sample_time
    direction = _in_windows(_directions(step, half_base // 2), starts, half_base)
    matrix = np.column_stack([acceleration, velocity, direction, np.ones(len(starts))])
    return matrix, _in_windows(applied[1:], starts, half_base)


def _within_holds(positions: _Array, starts: NDArray[np.int64], half_base: int) -> _Array:
    """Return the mean displacement of a hold under the triangle, less that under its steps, shape (n,) [m or rad].

    `_in_windows` weighs whole holds; within one, the triangle weighs the speed that rises. With the acceleration a of
    a hold, this adds a T / (12 n^2) to the mean speed, and the a T of half a triangle are the change of speed in it.
    Without it, the torque of a damped axis seems early.
    """
    middle, end = starts + half_base, starts + 2 * half_base
    first = 4.0 * positions[starts + 1] - 3.0 * positions[starts] - positions[starts + 2]
    last = 3.0 * positions[end] - 4.0 * positions[end - 1] + positions[end - 2]
    change: _Array = 2.0 * (positions[middle + 1] - positions[middle - 1]) - first - last
    return change / (24.0 * half_base**2)


def _directions(steps: _Array, near: int) -> _Array:
    """Return the direction of motion in each hold, 1, -1 or 0: that of the nearest hold in which a count was passed.

    A slow axis passes a count of a coarse encoder in a few holds only; in the others it moves all the same. Without one
    within `near` holds it stands still.
    """
    passed = np.flatnonzero(np.abs(steps) > _STILL)
    if not len(passed):
        return np.zeros(len(steps))
    holds = np.arange(len(steps))
    after = np.searchsorted(passed, holds).clip(max=len(passed) - 1)
    before = (after - 1).clip(min=0)
    nearest = np.where(np.abs(passed[before] - holds) < np.abs(passed[after] - holds), passed[before], passed[after])
    directions: _Array = np.where(np.abs(nearest - holds) <= near, np.sign(steps[nearest]), 0.0)
    return directions


def _in_windows(values: _Array, starts: NDArray[np.int64], half_base: int) -> _Array:
    """Return the mean of each window under a triangle that rises and falls over `half_base` holds each, shape (n,)."""
    rising = np.arange(half_base) + 0.5
    weights = np.concatenate([rising, rising[::-1]]) / half_base**2  # their sum is 1
    means: _Array = values[starts[:, None] + np.arange(2 * half_base)[None, :]] @ weights
    return means


def _solve(matrix: _Array, torque: _Array) -> tuple[list[float], list[float], float] | None:
    """Least-squares solution, its standard deviations and the rms residual.

    The torque is known, and acceleration, the first column, is not: the counts of a coarse encoder disturb it, and as
    a regressor it would make the mass too small. So acceleration is fitted by the torque and the other columns. None
    where they do not separate the unknowns.
    """
    columns = np.column_stack([torque, -matrix[:, 1:]])
    scale = np.linalg.norm(columns, axis=0)
    used = scale > 0.0
    normed, unknowns = columns[:, used] / scale[used], int(np.count_nonzero(used))
    if not used[0] or np.linalg.matrix_rank(normed) < unknowns:
        return None
    solution, *_ = np.linalg.lstsq(normed, matrix[:, 0], rcond=None)
    rest = matrix[:, 0] - normed @ solution
    variance = float(rest @ rest) / max(1, len(torque) - unknowns)
    values, spread = np.zeros(len(scale)), np.zeros((len(scale), len(scale)))
    values[used] = solution / scale[used]
    spread[np.ix_(used, used)] = np.linalg.inv(normed.T @ normed) * variance / np.outer(scale[used], scale[used])
    if not values[0]:
        return None
    mass = 1.0 / values[0]
    values = values * mass  # of a ratio to 1 / mass, to the first order in its errors
    variances = np.diag(spread) + values**2 * spread[0, 0] - 2.0 * values * spread[0]
    errors = np.abs(mass) * np.sqrt(np.maximum(variances, 0.0))
    values[0], errors[0] = mass, mass**2 * spread[0, 0] ** 0.5
    return values.tolist(), errors.tolist(), abs(mass) * variance**0.5


LEAST_JITTER: Final = 0.01
"""Jitter of SYNCs that is declared at least [sample times]: a calm run is no proof of a calm machine."""
SURE: Final = 2.0
"""Standard deviations beyond which a value counts as impossible."""
_SAFE_LAG: Final = 3.0
"""Standard deviations around a measured lag that are declared: with coarse encoders 2 left one lag in 200 above."""
_KEPT: Final = 0.9
"""Least fraction of the wall stiffness that must remain if the safe ends of a measurement are declared."""


def is_dear(axis: AxisScene, fastest: float, best: Mapping[str, float], ends: Mapping[str, float]) -> bool:
    """Whether declaring the safe ends of measured intervals, not the best estimates, costs too much wall stiffness.

    With late torques jitter costs more: both have the one that a rig declares at least.
    """
    jitter = {"sync_jitter": axis.loop.sync_jitter or LEAST_JITTER}
    return share_of_wall(axis, fastest, {**jitter, **ends}) < _KEPT * share_of_wall(axis, fastest, {**jitter, **best})


def needed_allowance(
    axis: AxisScene, fastest: float, best: Mapping[str, float], ends: Mapping[str, float]
) -> float | None:
    """Return the energy allowance [J] that keeps enough wall stiffness with the safe ends declared; None: none does.

    It is twice the smallest sufficient one of `ALLOWANCES`, because part of it may be spent before a contact.
    """
    if not hasattr(axis.passivity.parameters, "energy_allowance"):
        return None
    return _twice_the_least(lambda each: not is_dear(axis, fastest, best, {**ends, "energy_allowance": each}))


def _twice_the_least(is_enough: Callable[[float], bool]) -> float | None:
    return next((2.0 * each for each in ALLOWANCES if is_enough(each)), None)


def propose_allowance(session: Session, axis: int, known: Mapping[str, float]) -> None:
    """Propose the energy allowance with which a wall engages at a hand's speed, unless a sufficient one is declared.

    Args:
        session: Commissioning session.
        axis: Index of the axis.
        known: Measured values of `passivity`, SI.
    """
    scene, key = session.axes[axis], "passivity.energy_allowance"
    hand_force, declared = (getattr(scene.passivity.parameters, name, None) for name in ("hand_force", key[10:]))
    mine = [value for value in session.report.values if value.axis == scene.parameters.name]
    if hand_force is None or declared is None or key in [each.key for each in mine]:
        return
    timing = {each.key[10:]: each.value for each in mine if isinstance(each.value, float)}
    values: dict[str, float] = {"sync_jitter": LEAST_JITTER, **known}
    trial = with_declared(scene, {**values, **{name: timing[name] for name in _TIMES if name in timing}})
    losses = getattr(scene.passivity.parameters, "max_consecutive_losses", 0)
    energy = 0.0 if declared else hints.advised_allowance(trial.loop, hand_force, losses)

    def is_enough(allowance: float) -> bool:
        return share_of_wall(trial, _SLOW * session.speed(axis), {key[10:]: allowance}) >= _KEPT

    if not is_enough(max(declared, energy)):  # a coarse encoder needs more
        needed = _twice_the_least(is_enough)
        energy = needed if needed is not None and needed <= hints.LARGEST_ADVISED else energy
    if energy >= 1e-6:  # 0.2 kg at 3 mm/s; less lets no wall engage sooner that anybody would feel
        session.propose(axis, key, energy, "J", hints.allowance_words(energy, trial.loop, scene.parameters.unit))


_SLOW: Final = 0.1
"""Speed of a slow hand, as a part of the largest speed of the tests: 5 cm/s or 0.5 rad/s."""
_TIMES: Final = ("sync_jitter", "torque_window", "current_lag")
_ITEM: Final = "torque lag"
_DOUBLETS: Final = (32, 64, 128, 256, 512)
"""Number of doublets in the first, second, ... test; testing ends when the hold is known and the wall can be judged."""
_PASSED: Final = 60.0  # counts
_OVER: Final = 1.1
_OF_A_HOLD: Final = 0.95  # sample times of uncertainty at which a hold can still be found
_EARLY: Final = 3.0  # standard deviations below 0 from which on a torque acts before its SYNC


def time_the_torque(
    session: Session, axis: int, most: float, mass: float, known: Mapping[str, float] | None = None
) -> tuple[float, float] | None:
    """Find the hold in which a torque acts, measure how late it acts, and propose upper bounds of that lateness.

    The test is repeated, longer each time, while the hold is unclear or the uncertainty costs too much of the wall.

    Args:
        session: Commissioning session.
        axis: Index of the axis.
        most: Largest torque [N or N*m].
        mass: First estimate of the mass, in the units of the encoder as configured [kg or kg*m^2].
        known: Measured values of `passivity`, SI; None: without a mass, only the hold is determined.

    Returns:
        Lateness after the beginning of the declared hold, and its standard deviation [s]; None: unclear.

    Raises:
        RigError: Drive or link failed.
    """
    declared = session.axes[axis].loop.device_friction_bound or 0.0
    friction = 0.5 * (known or {}).get("device_friction_bound", declared)
    torque, longest = _reversal(session, axis, most, mass, friction)
    name = session.axes[axis].parameters.name
    if not session.agreed(f"{name}: hands off. Reversals of {session.shown(axis, torque)}. Start now?", _ITEM, [axis]):
        return None
    before: int | None = None  # the hold by the test before
    counts = [count for count in _DOUBLETS if 3 * longest * count * session.sample_time <= 60.0]
    for count in counts:
        law = session.play_within(axis, _ITEM, partial(reversals, longest=longest, count=count), torque)
        if session.stop_requested():
            session.not_tried(_ITEM, [axis])
            return None
        measured = None if law.tripped else _lateness(session, axis, law, longest // 3)
        if measured is None:
            text = f"{law.tripped or 'too little motion'}; raise --travel or --torque"
            session.found(axis, _ITEM, "", "unclear", StepVerdict.UNKNOWN, text)
            return None
        times = time_the_hold(session, axis, law, longest // 3)
        is_last, hold = count == counts[-1], times.hold
        is_told, before = times.is_sure or (hold is not None and (is_last or hold == before)), hold
        is_over = is_told or not _may_be_told(times, counts[-1] / count)
        later = hold if is_told and hold and hold > 0 else 0  # the hold is declared, and the lag is that within it
        late = measured[0] - later * session.sample_time, measured[1]
        if is_last or (is_over and (known is None or _is_resolved(session, axis, late, known))):
            report_hold(session, axis, times if is_told else times._replace(hold=None))
            if known is not None:
                _declare_lag(session, axis, late, known)
            return measured
        seen = f"+- {SURE * late[1] * 1e6:.2g} us costs too much of the wall" if is_over else "in which hold is unclear"
        session.dialogue.tell(f"  {name}: {_ITEM}: {seen}")
    return None


def _declare_lag(session: Session, axis: int, late: tuple[float, float], known: Mapping[str, float]) -> None:
    declared = session.axes[axis].loop.current_lag or 0.0
    is_kept = late[0] <= SURE * late[1] and _at_most(late) <= declared
    is_kept = is_kept and not _is_lost(session, axis, declared, known)
    _report(session, axis, late, is_kept=is_kept)
    if late[0] >= -_EARLY * late[1]:
        _propose(session, axis, None if is_kept else _at_most(late), known, _at_least(session, axis, late))


def _may_be_told(times: HoldTimes, longer: float) -> bool:
    """Whether a test that is so many times longer may tell the hold: its uncertainty falls with the root."""
    return times.motion is None or times.motion.high - times.motion.low <= _OF_A_HOLD * math.sqrt(longer)


def _at_most(late: tuple[float, float]) -> float:
    """Lag to declare, from a measured one and its standard deviation [s]: a lag above it makes a certificate false."""
    return _OVER * (max(0.0, late[0]) + _SAFE_LAG * late[1])


def _at_least(session: Session, axis: int, late: tuple[float, float]) -> float | None:
    """Lower end of the lag to declare [s]; None: 0. The window may take up its largest value of the lateness."""
    window = session.axes[axis].loop.torque_window or 0.0
    return max(0.0, (late[0] - _SAFE_LAG * late[1]) / _OVER - window) or None


def _earliest(session: Session, axis: int) -> float | None:
    """Earliest time at which a torque can act on a real bus [s], by its frames on the wire; None: not known."""
    parameters, bus = session.axes[axis].parameters, session.scene.bus_of(session.axes[axis])
    if session.experiment.pace == "free" or bus.rpdo != "event":
        return None
    dictionary = parameters.dictionary()
    return shortest_answer(bus.bitrate, choose_map(dictionary, parameters))


def _is_resolved(session: Session, axis: int, late: tuple[float, float], known: Mapping[str, float]) -> bool:
    """Whether a longer test is useless: the bound to declare keeps the wall, or the least measured lag loses it too."""
    least = max(0.0, late[0] - SURE * late[1])
    return not _is_lost(session, axis, _at_most(late), known) or _is_lost(session, axis, least, known)


def _is_lost(session: Session, axis: int, lag: float, known: Mapping[str, float]) -> bool:
    """Return whether a lag [s] costs more of the wall than it may."""
    without, lagging = ({**known, "current_lag": value} for value in (0.0, lag))
    return is_dear(session.axes[axis], session.speed(axis), without, lagging)


def _reversal(session: Session, axis: int, most: float, mass: float, friction: float) -> tuple[float, int]:
    """Return the torque of the test [N or N*m], and the cycles of its longest part, within half of the limits."""
    travel, speed, time = 0.25 * session.travels[axis], 0.5 * session.speed(axis), session.sample_time
    wanted = min(math.sqrt(travel * mass / most), speed * mass / most) / time
    # The first part of the longest doublet is, for a coarse encoder, long enough to pass some counts
    cycles = max(
        16, min(max(60, session.cycles(math.sqrt(_PASSED * session.count(axis) * mass / most))), round(wanted))
    )
    allowed = friction + mass * min(travel / (cycles * time) ** 2, speed / (cycles * time))
    quantum = session.drives[axis].scaling.torque_quantum
    return max(1, math.floor(min(most, allowed) / quantum)) * quantum, cycles


def _lateness(session: Session, axis: int, law: OpenLoop, half_base: int) -> tuple[float, float] | None:
    """Return lateness and standard deviation [s], relative to the torques sent: a measured torque is late itself."""
    acted = as_declared(session, axis, law)
    positions = law.regular_positions() / session.encoder_ratios[axis]
    return estimate_lateness(positions, np.asarray(acted, dtype=np.float64), session.sample_time, half_base)


def _report(session: Session, axis: int, late: tuple[float, float], *, is_kept: bool) -> None:
    """Report the lateness against the declared values, and whether these are kept."""
    declared = (session.axes[axis].loop.torque_window or 0.0) + (session.axes[axis].loop.current_lag or 0.0)
    value, error, timing = late[0], SURE * late[1], session.axes[axis].loop.timing
    configured = f"at most {declared * 1e6:.3g} us" if declared else "none"
    found = f"{value * 1e6:.3g} +- {error * 1e6:.2g} us"
    if value < -_EARLY * late[1]:
        text = "acts before its SYNC: declare rpdo: event, and commission again"
        session.found(axis, _ITEM, configured, found, StepVerdict.FAILED, text)
    elif value <= error:
        found = f"not measurable (resolution +- {error * 1e6:.2g} us)"
        declares = f"current_lag {_at_most(late) * 1e6:.3g} us is safe"
        text = "configured value kept" if is_kept else declares
        session.found(axis, _ITEM, configured, found, StepVerdict.AGREES if is_kept else StepVerdict.MEASURED, text)
    else:
        text = "declare the range that this test found, or guarded is not passive"
        good = value - error <= declared and timing.early <= value + error
        session.judged(axis, _ITEM, configured, found, good=good, text=text)


def _propose(session: Session, axis: int, lag: float | None, known: Mapping[str, float], least: float | None) -> None:
    """Propose window and lag, and an energy allowance where they would cost too much of the wall.

    Args:
        session: Commissioning session.
        axis: Index of the axis.
        lag: Lag to declare [s]; None: the configured one is right.
        known: Measured values of `passivity`, SI.
        least: Lower end of the lag [s]; None: 0.
    """
    scene = session.axes[axis]
    if window := scene.loop.torque_window:  # 0 only in a simulation without delay, and never declared of a real drive
        session.propose(
            axis, "passivity.torque_window", window, "s", "an allowance: the measured lag is in current_lag",
            _earliest(session, axis),
        )  # fmt: skip
    comment = f"{_OVER:g} times the upper confidence limit" if lag is not None else "more than this test resolves"
    session.propose(axis, "passivity.current_lag", lag, "s", comment, least)
    if lag is None or not _is_lost(session, axis, lag, known):
        return
    without, lagging = ({**known, "current_lag": value} for value in (0.0, lag))
    allowance = needed_allowance(scene, session.speed(axis), without, lagging)
    text = f"current_lag {lag * 1e6:.3g} us leaves no energy to start a contact"
    if allowance is None:
        return session.found(axis, "wall", "", "not rendered", StepVerdict.DIFFERS, f"{text}; render a softer wall")
    session.found(axis, "wall", "", f"needs energy_allowance {allowance:.3g} J", StepVerdict.MEASURED, text)
    session.propose(axis, "passivity.energy_allowance", allowance, "J", f"{text}; this much may be given out")
