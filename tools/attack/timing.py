"""Attacks the two ends of late torques on random plants, apart from the code of the certificates.

The statement, written down here alone (proof: docs/theory/late_torques.md, L1). In a hold of length T an axis of mass m
and damping 0 to B moves by D, under forces between -F_in and F_out. A torque changes late: p(t) falls from 1, and its
integral over the hold is theta, lo <= theta <= hi. X = integral of p v. With y = B T / m and s = y / (1 - exp(-y))

    X >= min over theta of   theta D / T - s F_out theta (T - theta) / 2m     (s D where D < 0)
    X <= max over theta of   theta D / T + s F_in theta (T - theta) / 2m      (s D where D > 0)

Forces that switch at random act on a fine grid; p is a step, a lag, or several steps. `python -m tools.attack.timing
--plants N` prints the least distance of X to both ends, in parts of their width: below 0 the statement is false. With
`--share 0.8` the term of the forces counts in part only, which must break.
"""

import argparse
from typing import Final

import numpy as np
from numpy.typing import NDArray

_GRID: Final = 1000
_THETAS: Final = 400


def ends(
    moved: float, time: float, low: float, high: float, accelerations: tuple[float, float], swing: float
) -> tuple[float, float]:
    """Returns both ends of X by trying many theta; accelerations F_out / m and F_in / m."""
    theta = np.linspace(low, high, _THETAS)
    room = 0.5 * swing * theta * (time - theta)
    least = theta / time * moved * (swing if moved < 0.0 else 1.0) - accelerations[0] * room
    most = theta / time * moved * (swing if moved > 0.0 else 1.0) + accelerations[1] * room
    return float(least.min()), float(most.max())


def _forces(random: np.random.Generator, out: float, inward: float) -> NDArray[np.float64]:
    """Returns the force in each piece of the grid: bang-bang of one to six parts, or any values."""
    parts = random.integers(1, 7)
    at = np.sort(random.integers(0, _GRID, parts - 1))
    kind = random.integers(3)
    values = random.uniform(-inward, out, parts) if kind == 2 else np.where(np.arange(parts) % 2 == kind, out, -inward)
    return np.repeat(values, np.diff([0, *at, _GRID]))


def _falling(random: np.random.Generator, time: float) -> NDArray[np.float64]:
    """Returns p at the middle of each piece of the grid."""
    at = (np.arange(_GRID) + 0.5) * time / _GRID
    start, lag = random.uniform(0.0, 0.9) * time, 10.0 ** random.uniform(-2.0, 0.0) * time
    if (kind := random.integers(3)) == 0:
        return np.asarray(at < start, dtype=np.float64)
    if kind == 1:
        return np.where(at < start, 1.0, np.exp(-np.maximum(0.0, at - start) / lag))
    steps = random.uniform(0.0, time, 4)
    return np.asarray(np.mean([at < step for step in steps], axis=0), dtype=np.float64)


def distance(random: np.random.Generator, share: float) -> float:
    """Returns how far X of one random plant stays within the ends, in parts of their width."""
    time, mass = 10.0 ** random.uniform(-3.5, -1.0), 10.0 ** random.uniform(-2.0, 0.5)
    out, inward = 10.0 ** random.uniform(-1.0, 1.5, 2)
    most = random.choice([0.0, 10.0 ** random.uniform(-2.0, 1.0)]) * mass / time
    damping = most * random.choice([0.0, random.random(), 1.0])
    step, rate = time / _GRID, damping / mass
    speed, speeds = random.normal() * 10.0 ** random.uniform(-2.0, 1.0) * (out + inward) * time / mass, []
    decay = np.exp(-rate * step)
    for force in _forces(random, out, inward):  # exact for a force that is constant in a piece; the mean speed in it
        rest = force / damping if damping else 0.0
        after = rest + (speed - rest) * decay if damping else speed + force / mass * step
        speeds.append(0.5 * (speed + after))
        speed = after
    p, moved = _falling(random, time), np.sum(speeds) * step
    theta, reached = np.sum(p) * step, np.sum(p * np.array(speeds)) * step
    low, high = theta * random.uniform(0.3, 1.0), min(time, theta * random.uniform(1.0, 2.0))
    if random.random() < 0.5:
        low = high = theta
    y = most * time / mass
    swing = y / -np.expm1(-y) if y > 0.0 else 1.0
    least, largest = ends(moved, time, low, high, (share * out / mass, share * inward / mass), swing)
    width = largest - least
    apart = min(reached - least, largest - reached)
    return float(apart / width if width > 0.0 else apart)


def main() -> None:
    """Attacks, and prints the least distance."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plants", type=int, default=5000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--share", type=float, default=1.0)
    asked = parser.parse_args()
    random = np.random.default_rng(asked.seed)
    distances = np.array([distance(random, asked.share) for _ in range(asked.plants)])
    broken = int(np.sum(distances < -1e-3))  # the grid itself is worth 1e-3
    print(f"{asked.plants} plants: least distance {distances.min():.4g} of the width, {broken} beyond the ends")


if __name__ == "__main__":
    main()
