"""The scenes of a sweep by their global index: a grid, or a Latin hypercube that is the same on every machine.

Only integers and a division decide the hypercube (a keyed hash, sorted), so that neither a version of NumPy nor the
number of workers can change it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from canhaptic.errors import InputError
from canhaptic.lab.loop.axis_loop import Array
from canhaptic.lab.studies.sweep.vary import Value, Varied, listed

CONTROLLER: Final = "controller"
"""Name of the passivity algorithm among the varied keys; each point is judged under every one."""
_MOST_SCENES: Final = 100_000_000
Column = Array | list[Value]
"""Values of one key for consecutive scenes: numbers, or YAML texts."""

_Hashes = NDArray[np.uint64]
_SEED_STEP: Final = 0x9E3779B97F4A7C15
_MIX: Final = ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB))
_MANTISSA: Final = 53


@dataclass(frozen=True, slots=True)
class Points:
    """All scenes of a sweep.

    Attributes:
        varied: Keys with their values; the last one changes fastest in a grid.
        samples: Points of a Latin hypercube; 0 for the grid of all values.
        seed: Seed of the hypercube.
    """

    varied: tuple[Varied, ...]
    samples: int = 0
    seed: int = 0

    @property
    def shape(self) -> tuple[int, ...]:
        """Values per key of a grid; (algorithms, samples) or (samples,) of a hypercube."""
        if not self.samples:
            return tuple(len(varied.values) for varied in self.varied)
        return (*(len(varied.values) for varied in self.varied if varied.key == CONTROLLER), self.samples)

    def __len__(self) -> int:
        return math.prod(self.shape)

    def columns(self, start: int, stop: int) -> dict[str, Column]:
        """Return the values of scenes `start` to `stop` by key, each of length stop - start."""
        indices = np.unravel_index(np.arange(start, stop), self.shape)
        if not self.samples:
            return {v.key: _picked(v, index) for v, index in zip(self.varied, indices, strict=True)}
        found: dict[str, Column] = {}
        for order, varied in enumerate(self.varied):
            if varied.key == CONTROLLER:
                found[varied.key] = _picked(varied, indices[0])
            else:
                found[varied.key] = varied.at(_shares(self.samples, self.seed, order)[indices[-1]])
        return found


def make_points(varied: Sequence[Varied], controllers: Sequence[str] = (), samples: int = 0, seed: int = 0) -> Points:
    """Return the scenes of a sweep.

    Args:
        varied: Keys with their values.
        controllers: Passivity algorithms that every point is judged under; none: that of the scene.
        samples: Points of a Latin hypercube; 0 for a grid.
        seed: Seed of the hypercube.

    Raises:
        InputError: Nothing varies, a key twice, a range without a number in a grid, too many scenes.
    """
    keys = [one.key for one in varied]
    twice = sorted({key for key in keys if keys.count(key) > 1})
    if twice:
        raise InputError(f"--vary: {twice[0]} is given twice; give all its values at once")
    if controllers:
        varied = [listed(CONTROLLER, controllers), *varied]
    if not varied:
        raise InputError("nothing varies; give --vary KEY=LOW:HIGH:log:N or KEY=A,B,C, or --controllers A,B")
    for one in varied:
        if one.is_open and not samples:
            raise InputError(f"--vary {one}: has no number of values; add :N, or sample it with --sample lhs:N")
    points = Points(tuple(varied), samples, seed)
    if len(points) > _MOST_SCENES:
        raise InputError(
            f"got {len(points)} scenes, expected at most {_MOST_SCENES}; take fewer values, or --sample lhs:N"
        )
    return points


def scene_seed(base: int, index: int) -> int:
    """Return the seed of everything random in the scene of a global index: 0 to 10^9."""
    return int(scene_seeds(base, np.array([index]))[0])


def scene_seeds(base: int, indices: NDArray[np.intp]) -> Array:
    """Return the seeds of the scenes of some global indices, whole numbers of shape (n,)."""
    return (_hashed(base, 0xC0, indices.astype(np.uint64)) % np.uint64(1_000_000_001)).astype(float)


def _picked(varied: Varied, index: NDArray[np.intp]) -> Column:
    if varied.is_number:
        return np.array(varied.values, dtype=np.float64)[index]
    return [varied.values[i] for i in index.tolist()]


@lru_cache(maxsize=16)
def _shares(samples: int, seed: int, order: int) -> Array:
    """Return one point in each of n equal strata, shuffled, 0 <= share < 1, shape (samples,)."""
    numbers = np.arange(samples, dtype=np.uint64)
    strata = np.argsort(_hashed(seed, 2 * order, numbers), kind="stable")
    within = (_hashed(seed, 2 * order + 1, numbers) >> np.uint64(64 - _MANTISSA)) * 2.0**-_MANTISSA
    shares: Array = np.minimum((strata + within) / samples, np.nextafter(1.0, 0.0))
    return shares


def _hashed(seed: int, stream: int, numbers: _Hashes) -> _Hashes:
    """Return the finaliser of SplitMix64 (Steele, Lea, Flood, OOPSLA 2014) of seed, stream and each number."""
    mixed = np.array([seed * 1024 + stream], dtype=np.uint64)
    for value in (None, numbers):
        mixed = (mixed if value is None else mixed ^ value) + np.uint64(_SEED_STEP)
        for shift, factor in _MIX:
            mixed = (mixed ^ (mixed >> np.uint64(shift))) * np.uint64(factor)
        mixed ^= mixed >> np.uint64(31)
    return mixed
