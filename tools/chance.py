"""Draws of one random stream, which the scenes of every campaign are made of."""

import math
from collections.abc import Sequence
from typing import TypeVar

import numpy as np

_Drawn = TypeVar("_Drawn")
EXACT = 17
"""Digits that change no number."""


class Chance:
    """One stream.

    Args:
        seed: Numbers that seed it.

    Attributes:
        generator: Generator of the draws.
    """

    def __init__(self, *seed: int) -> None:
        self.generator = np.random.default_rng(seed)

    def decades(self, low: float, high: float, digits: int = 4) -> float:
        """Returns a number that is as often between 1 and 10 as between 10 and 100."""
        return float(f"{10.0 ** self.generator.uniform(math.log10(low), math.log10(high)):.{digits}g}")

    def drawn(self, probability: float) -> bool:
        """Returns True with this probability."""
        return bool(self.generator.random() < probability)

    def one_of(self, names: Sequence[_Drawn]) -> _Drawn:
        """Returns one of some things, each as often as the others."""
        return names[int(self.generator.integers(len(names)))]
