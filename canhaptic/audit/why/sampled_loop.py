"""The sampled wall on a rigid mass: whether it is stable, how fast it swings, and with which values it is calm.

Between two SYNCs the torque is constant, and the mass m with damping b moves exactly. The wall K x + d v, with v from
the last displacement, acts `delay` holds later, or between two holds. With z the shift by one SYNC:

    (z - 1) (z - e) z^(n+1) + T^2 / 2m (z + 1) (K z + d (z - 1) / T) = 0,    e = exp(-b T / m)

Colgate and Brown, "Factors affecting the Z-width of a haptic display", ICRA 1994. The current loop counts as a delay
of its time constant, which is its phase below the frequency 1 / lag.
"""

import cmath
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np


class Mode(NamedTuple):
    """The mode that grows fastest, or decays slowest."""

    growth: float  # of its amplitude [1/s]; below 0 it decays
    frequency: float  # [Hz]


@dataclass(frozen=True, slots=True)
class SampledLoop:
    """A wall, the mass that it pushes, and the delay of its torque."""

    stiffness: float  # [N/m or N*m/rad]
    damping: float  # of the wall [N*s/m or N*m*s/rad]
    delay: float  # holds from the computation of a torque to that in which it acts
    mass: float  # [kg or kg*m^2]
    lost: float  # damping of device and hand [N*s/m or N*m*s/rad]
    period: float  # [s]

    def slowest(self) -> Mode:
        """Return the mode that decays last."""
        n, part = int(self.delay), self.delay - int(self.delay)
        gain, rate = self.period**2 / (2.0 * self.mass), self.damping / self.period
        wall = np.polymul([1.0, 1.0], [self.stiffness + rate, -rate])
        decay = math.exp(-min(50.0, self.lost * self.period / self.mass))
        free = np.polymul([1.0, -1.0 - decay, decay], np.eye(1, n + 3)[0])
        roots = np.roots(np.polyadd(free, gain * np.polymul(wall, [1.0 - part, part])))
        worst = complex(roots[np.argmax(np.abs(roots))])
        size = max(abs(worst), 1e-300)
        return Mode(math.log(size) / self.period, abs(cmath.phase(worst)) / (2.0 * math.pi * self.period))

    @property
    def grows(self) -> bool:
        """Whether the loop is unstable."""
        return self.slowest().growth > 0.0

    def calm(self) -> bool:
        """Whether the loop stays stable with twice the stiffness and one and a half times the damping."""
        more = replace(self, stiffness=2.0 * self.stiffness, damping=1.5 * self.damping)
        return not self.grows and not more.grows

    def calmer(self) -> Iterator["SampledLoop"]:
        """Yield walls with less stiffness, then with more or less damping, in the order in which they are tried."""
        halves = [0.5**power for power in range(1, 8)]
        yield from (replace(self, stiffness=part * self.stiffness) for part in halves)
        least = self.stiffness * self.period * (self.delay + 0.5)
        yield from (replace(self, damping=share * least) for share in (2.0, 1.5))
        yield from (replace(self, damping=part * self.damping) for part in halves)
