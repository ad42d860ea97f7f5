"""Users on a moving mass, exact for a hand force constant within a quarter of a hold. Judges by truth.

The hand force is limited to the declared one along the torque, so that a certificate is on trial and not the
user: outward always, inward too where a damper can make the torque negative. Energies are those of the plant, not the
controller's belief.
"""

import random
from typing import Any, NamedTuple

from canhaptic.control.balance import EnergyBalance
from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.control.passivity import LoopProperties
from canhaptic.control.passivity.guarded import Guarded, GuardedParameters
from tests.adversary.users import HAND_FORCE, Force, Mass

MASS, FRICTION, PUSH = 0.25, 0.1, 60.0
SUBSTEPS = 4


def guarded(
    stiffness: float,
    damping: float,
    rate: float,
    delay: int = 0,
    *,
    hand_force: float | None = HAND_FORCE,
    certain: float | None = None,
    count: float = 0.0,
    quantum: float = 0.0,
    **other: Any,
) -> Guarded:
    """A guarded wall below 0 with the plant known; `certain` is the device damping declared."""
    mass = other.pop("mass", MASS)
    most = other.pop("most", FRICTION)
    return Guarded(
        SpringDamperWall(stiffness=stiffness, damping=damping),
        GuardedParameters(**{"hand_force": hand_force, "hand_push": hand_force, **other}),
        LoopProperties(
            sample_time=1.0 / rate,
            delay=delay,
            moving_mass=mass,
            device_damping=certain,
            device_damping_bound=most,
            encoder_count=count,
            torque_quantum=quantum,
        ),
    )


class Loss(NamedTuple):
    """Frames lost at random, either way; never more than `most` cycles in a row."""

    share: float
    most: int = 2


class Truth(NamedTuple):
    """What the plant says. Energies in [J]."""

    least: float  # of sum(h_i)
    least_with_damping: float  # of sum(h_i) + (b/T) sum(dq^2) with the true b
    least_margin: float  # of sum(h_i) - sum(h_r), as booked
    believed_error: float  # largest |booked - true| sum(h_i)
    error_bound: float  # of trap 12, at the end
    positions: list[float]  # true, at the samples
    torques: list[float]  # applied in the hold that begins there


class _Energies:
    """The true energies of a run, and those that the controller books [J]."""

    def __init__(self) -> None:
        self.true = self.least = self.with_damping = self.least_with_damping = 0.0
        self.booked = self.worst = self.margin = self.least_margin = 0.0

    def book(self, balance: EnergyBalance) -> None:
        self.booked += balance.h_i
        self.worst = max(self.worst, abs(self.booked - self.true))
        self.margin += balance.h_i - balance.h_r
        self.least_margin = min(self.least_margin, self.margin)

    def move(self, torque: float, moved: float, dissipation: float) -> None:
        self.true -= torque * moved
        self.with_damping += dissipation * moved * moved
        self.least = min(self.least, self.true)
        self.least_with_damping = min(self.least_with_damping, self.true + self.with_damping)


def run(
    controller: Any, user: Force, rate: float, cycles: int, *, delay: int = 0, damping: float = FRICTION,
    hand_force: float = HAND_FORCE, push: float = PUSH, count: float = 0.0, quantum: float = 0.0,
    loss: Loss | None = None, position: float = 0.003, seed: int = 0,
) -> Truth:  # fmt: skip
    """Runs a user against a controller; `user` is a force law (t, q, v, torque) -> force."""
    rng, energies, sample_time = random.Random(seed), _Energies(), 1.0 / rate
    mass = Mass(MASS, damping, sample_time / SUBSTEPS, position)
    held, lost_in_a_row, variation = 0.0, 0, 0.0
    pending: list[float | None] = [0.0] * delay
    positions: list[float] = []
    torques: list[float] = []
    for cycle in range(cycles):
        start = mass.position
        tpdo = rpdo = True
        if loss and cycle > 2 and lost_in_a_row < loss.most:
            tpdo, rpdo = rng.random() >= loss.share, rng.random() >= loss.share
        lost_in_a_row = 0 if tpdo and rpdo else lost_in_a_row + 1
        seen = round(start / count) * count if count else start
        balance = controller.step(seen, held) if tpdo else controller.sample_lost()
        if tpdo:
            energies.book(balance)
        command = round(balance.torque / quantum) * quantum if quantum else balance.torque
        pending.append(command if rpdo else None)
        before, arriving = held, pending.pop(0)
        held = held if arriving is None else arriving
        variation += abs(held - before)
        for part in range(SUBSTEPS):
            hand = user((cycle + part / SUBSTEPS) * sample_time, mass.position, mass.velocity, held)
            mass.advance(held + max(-push, min(hand_force, hand)))
        energies.move(held, mass.position - start, damping / sample_time)
        positions.append(start)
        torques.append(held)
        assert abs(mass.position) < 100.0, "diverged"
    bound, e = 0.5 * count * (variation + abs(held)), energies
    return Truth(e.least, e.least_with_damping, e.least_margin, e.worst, bound, positions, torques)
