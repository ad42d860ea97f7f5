"""Encoder noise: white Gaussian error of each reading, as of an analogue (sine-cosine) encoder before quantisation.

States added: none; the error is a function of seed and tick, so that repeated readings at one time agree.
Exact. Energy: none. Typical: 0.1..1 count. Source: Box and Muller, Ann. Math. Stat. 29, 1958; the generator is
splitmix64 (Steele, Lea, Flood, OOPSLA 2014).
"""

import math
from typing import Annotated, Final, Literal

from canhaptic.sim.plant.assembly import EffectParameters, PlantModel
from canhaptic.units import quantity

_MASK: Final = (1 << 64) - 1
_GAMMA: Final = 0x9E3779B97F4A7C15  # golden ratio, splitmix64


class EncoderNoise(EffectParameters):
    """Noise on the measured position."""

    type: Literal["encoder_noise"] = "encoder_noise"
    deviation: Annotated[float, quantity("m", "rad", gt=0.0, le=1e3)]
    """Standard deviation of the error."""

    def add_to(self, scene: PlantModel) -> None:
        """Add the error of the reading."""
        scene.claim("encoder noise", self.type)
        scene.encoders.append(self)

    def read(self, position: float, tick: int, seed: int) -> float:
        """Return the reading with its error [m or rad]."""
        return position + noise(self.deviation, seed, tick)


def noise(deviation: float, seed: int, tick: int) -> float:
    """Return the error of the reading at a tick [m or rad]."""
    base = _mix(seed * _GAMMA + tick)
    return gaussian(deviation, (_mix(base + _GAMMA) + 1) / (_MASK + 2), _mix(base + 2 * _GAMMA) / (_MASK + 1))


def uniform(seed: int, tick: int) -> float:
    """Return a number in [0, 1), determined by seed and tick."""
    return _mix(_mix(seed * _GAMMA + tick) + _GAMMA) / (_MASK + 1)


def gaussian(deviation: float, first: float, second: float) -> float:
    """Return a normal deviate from two uniform ones: first in (0, 1], second in [0, 1)."""
    return deviation * math.sqrt(-2.0 * math.log(first)) * math.cos(2.0 * math.pi * second)


def _mix(value: int) -> int:
    """Return 64 well-mixed bits of an integer (the finaliser of splitmix64)."""
    value &= _MASK
    value = ((value ^ (value >> 30)) * 0xBF58476D1CE4E5B9) & _MASK
    value = ((value ^ (value >> 27)) * 0x94D049BB133111EB) & _MASK
    return value ^ (value >> 31)
