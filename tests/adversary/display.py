"""A drive written apart from the package: exact under forces that a hand chooses inside the holds.

M v' = f + F,  f = c (r - v) + f_I,  f_I' = k (r - v)          state (q, v, f_I); F and r constant in a substep
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

Array = NDArray[np.float64]
Hand = Callable[["AttackedDrive", float], float]
"""(drive, command) -> force of the next substep [N]."""


@dataclass
class AttackedDrive:
    """The drive, its energy at the sensor, and what a sensor would show."""

    mass: float
    gain: float
    integral: float
    sample_time: float
    substeps: int
    state: Array = field(default_factory=lambda: np.zeros(3))
    energy: float = 0.0  # [J] that came in
    impulse: float = 0.0  # [N*s]
    force: float = 0.0  # in the last substep

    def __post_init__(self) -> None:
        m, c, k = self.mass, self.gain, self.integral
        rates = np.array([[0, 1, 0, 0, 0], [0, -c / m, 1 / m, 1 / m, c / m], [0, -k, 0, 0, k], [0] * 5, [0] * 5], float)
        self.flow_of = cache(lambda lasts: expm(rates * lasts * self.sample_time / self.substeps))

    def hold(self, command: float, hand: Hand, lasts: float = 1.0) -> None:
        """Moves on by one hold of so many sample times."""
        step, flow = lasts * self.sample_time / self.substeps, self.flow_of(lasts)
        for _ in range(self.substeps):
            self.force = hand(self, command)
            before = self.state[0]
            self.state = (flow @ np.array([*self.state, self.force, command]))[:3]
            self.energy += self.force * (self.state[0] - before)
            self.impulse += self.force * step

    @property
    def reserve(self) -> float:
        """V [J]."""
        kept = 0.5 * self.mass * self.state[1] ** 2
        return kept + (self.state[2] ** 2 / (2.0 * self.integral) if self.integral else 0.0)


def greedy(strength: float, share: float) -> Hand:
    """Returns a hand that holds the speed at a share of the command, as the worst one does without an integral."""

    def pull(drive: AttackedDrive, command: float) -> float:
        step = drive.sample_time / drive.substeps
        torque = drive.gain * (command - drive.state[1]) + drive.state[2]
        wanted = drive.mass * (share * command - drive.state[1]) / step - torque
        return min(strength, max(-strength, wanted))

    return pull


def bang_bang(strength: float, random: np.random.Generator) -> Hand:
    """Returns a hand that pushes or pulls with all its strength, for random times."""
    sign = [1.0]

    def pull(_drive: AttackedDrive, _command: float) -> float:
        if random.random() < 0.03:
            sign[0] = -sign[0]
        return strength * sign[0]

    return pull


def negative_damper(damping: float, strength: float) -> Hand:
    """Returns a hand that pushes along the motion, and starts it."""

    def pull(drive: AttackedDrive, command: float) -> float:
        return min(strength, max(-strength, damping * drive.state[1] + (2.0 if drive.state[1] == 0.0 else 0.0)))

    return pull


def feed_and_take(strength: float, feed: float, take: float) -> Hand:
    """Returns a hand that pushes for a while, then brakes hard: it takes what the drive carries."""
    clock = [0.0]

    def pull(drive: AttackedDrive, command: float) -> float:
        step = drive.sample_time / drive.substeps
        clock[0] += step
        if clock[0] % (feed + take) < feed:
            return strength
        torque = drive.gain * (command - drive.state[1]) + drive.state[2]
        wanted = drive.mass * (0.5 * command - drive.state[1]) / step - torque
        return min(strength, max(-strength, wanted))

    return pull


def spring_and_mass(stiffness: float, damping: float, mass: float, strength: float) -> Hand:
    """Returns a hand of a grip spring with a mass behind it, pushed to and fro."""
    far = [0.0, 0.0]
    clock = [0.0]

    def pull(drive: AttackedDrive, _command: float) -> float:
        step = drive.sample_time / drive.substeps
        force = stiffness * (far[0] - drive.state[0]) + damping * (far[1] - drive.state[1])
        clock[0] += step
        own = strength * math.sin(2.0 * math.pi * 1.3 * clock[0])
        far[1] += (own - force) / mass * step
        far[0] += far[1] * step
        return force

    return pull
