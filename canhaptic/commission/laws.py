"""Torques computed in advance, and the record of the axis's motion under them."""

import math
from collections.abc import Sequence
from typing import Annotated, Final

import numpy as np

from canhaptic.control.balance import AT_REST, Branch, Certificate, EnergyBalance
from canhaptic.errors import ControlError
from canhaptic.units import Parameters, quantity

NO_TORQUE: Final[tuple[float, ...]] = ()


class CommissioningLimits(Parameters):
    """Limits of commissioning."""

    torque: Annotated[float, quantity("1", gt=0.0, le=0.3)] = 0.1
    """Largest torque, as a part of the rated torque; never beyond `torque_limit` of the axis."""
    travel: Annotated[float, quantity("m", "rad", gt=0.0)] = 0.02
    """Distance from where a step began after which its torque is taken away."""
    speed: Annotated[float, quantity("m/s", "rad/s", gt=0.0)] = 0.5
    """Speed after which its torque is taken away."""


class OpenLoop:
    """A controller that renders nothing: it plays torques, one a cycle, and drops to zero when the axis goes too far.

    The energy that it puts in is booked as deficit: nothing here is passive, and the account says so.

    Args:
        torques: One per cycle [N or N*m]; zero after the last.
        travel: Largest distance from the first position [m or rad].
        largest_step: Largest displacement in one sample time [m or rad].

    Attributes:
        positions: Position at every SYNC since `reset` [m or rad].
        applied: Torque of the hold that ended there [N or N*m].
        sent: Torque returned there [N or N*m].
        tripped: Reason why the torque was removed; "" if it was not.
        has_gap: Whether a sample was lost: the positions then do not belong to consecutive SYNCs.
    """

    def __init__(self, torques: Sequence[float], travel: float = math.inf, largest_step: float = math.inf) -> None:
        self._torques = tuple(torques)
        self._travel = travel
        self._largest_step = largest_step
        self.reset()

    def reset(self) -> None:
        """Clear the record, and begin with the first torque."""
        self.positions: list[float] = []
        self.applied: list[float] = []
        self.sent: list[float] = []
        self.tripped = ""
        self.has_gap = False
        self._next = 0
        self._last = AT_REST

    def hold(self) -> EnergyBalance:
        """End the torques: a measurement with a gap is useless."""
        self.tripped, self.has_gap = self.tripped or "a TPDO was lost", True
        self._last = self._last._replace(torque=0.0, h_i=0.0, h_m=0.0, deficit=0.0, branch=Branch.HELD.value)
        return self._last

    def step(self, position: float, torque_applied: float) -> EnergyBalance:
        """Record the hold that ended and return the next torque.

        Raises:
            ControlError: The position or torque is not finite.
        """
        if not math.isfinite(position + torque_applied):
            raise ControlError(f"got position {position} and torque {torque_applied}, expected finite values")
        displacement = position - self.positions[-1] if self.positions else 0.0
        self.positions.append(position)
        self.applied.append(torque_applied)
        self._watch(position, displacement)
        torque = 0.0
        if self._next < len(self._torques) and not self.tripped:
            torque = self._torques[self._next]
            self._next += 1
        self.sent.append(torque)
        return self._book(torque, -torque_applied * displacement)

    def _watch(self, position: float, displacement: float) -> None:
        if abs(position - self.positions[0]) > self._travel:
            self.tripped = self.tripped or f"moved further than {self._travel:g}"
        elif abs(displacement) > self._largest_step:
            self.tripped = self.tripped or f"moved faster than {self._largest_step:g} in one sample time"

    def _book(self, torque: float, h_i: float) -> EnergyBalance:
        self._last = AT_REST._replace(
            torque=torque,
            h_i=h_i,
            h_m=h_i,
            deficit=-h_i,
            h_dis=self._last.h_dis - h_i,
            branch=Branch.DEPLETED.value if h_i else Branch.FREE.value,
            certificate=Certificate.NONE.value,
        )
        return self._last


def doublet(torque: float, cycles: int) -> list[float]:
    """Return +, -, -, + of a torque, `cycles` each: a free mass comes back to where and how it was."""
    return [torque] * cycles + [-torque] * (2 * cycles) + [torque] * cycles


def reversals(torque: float, longest: int, count: int) -> list[float]:
    """Return doublets of a torque [N or N*m] of both signs and many lengths, the same with every call.

    Args:
        torque: Size of the torque [N or N*m].
        longest: First part of the longest doublet, in cycles; the shortest is half as long.
        count: Number of doublets.
    """
    drawn = np.random.default_rng(1)
    lengths, signs = drawn.integers(longest // 2, longest + 1, count), drawn.choice([-1.0, 1.0], count)
    return [
        part for length, sign in zip(lengths, signs, strict=True) for part in doublet(float(sign * torque), int(length))
    ]


def sweep(amplitude: float, lowest: float, highest: float, duration: float, sample_time: float) -> list[float]:
    """Return a cosine whose frequency rises exponentially: a free mass swings about where it was, and ends at rest.

    Args:
        amplitude: Size of the torque [N or N*m].
        lowest: First frequency [Hz].
        highest: Last frequency [Hz].
        duration: Length of the sweep [s].
        sample_time: Sample time [s].
    """
    rate = math.log(highest / lowest) / duration
    torques = amplitude * np.cos(
        2.0 * np.pi * lowest * np.expm1(rate * np.arange(round(duration / sample_time)) * sample_time) / rate
    )
    turns = np.flatnonzero(np.diff(np.signbit(np.cumsum(torques))))
    return [float(torque) for torque in torques[: turns[-1] + 1 if len(turns) else None]]
