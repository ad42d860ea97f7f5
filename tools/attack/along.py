"""Attacks the share that all declarations permit a group together, with coupled plants and hands of its own (G13).

Each plant is M v' = f + u - B v with a random coupled M >= diag(m) and damping between the declared bounds. The hand
pushes each motor with no more than its declared force, most often where it takes out most. The torques turn at random
in every hold. Printed is the least energy at the handle, h + dissipated, at four instants of every hold: below 0 the
statement is false (proof: docs/theory/torques_of_a_group.md).

    python -m tools.attack.along --runs 500                 # 60 holds each
    python -m tools.attack.along --runs 500 --times 1.2     # larger torques than certified, which must break
"""

import argparse
import math
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from canhaptic.control.multi_axis.along import share_in_sum
from canhaptic.control.multi_axis.group_account import (
    Accounting,
    AccountSettings,
    GroupAccount,
    QueuedTorques,
    account_memory,
    shares,
)
from canhaptic.control.multi_axis.group_certificates import axes_of, per_axis_limits
from canhaptic.control.passivity import LoopProperties

Vector: TypeAlias = NDArray[np.float64]

HOLDS: Final = 60
_PARTS: Final = 8
_TIME: Final = 1e-3
_TERMS: Final = 12


class Plant:
    """A random coupled group with its hand and its account, beginning in free motion."""

    def __init__(self, seed: int) -> None:
        self.random = random = np.random.default_rng(seed)
        count, self.delay = int(random.integers(2, 4)), int(random.integers(2))
        masses = random.uniform(0.05, 1.0, count)
        largest = random.uniform(0.05, 1.9, count) * masses / _TIME * random.choice([1e-3, 1e-2, 0.1, 1.0])
        least = largest * random.uniform(0.3, 1.0, count)
        coupling = random.normal(size=(count, count)) * random.choice([0.0, 0.3, 1.0, 3.0])
        self.damping = np.diag(random.uniform(least, largest))
        inertia = np.diag(masses) + coupling @ coupling.T * masses.min()
        self.inverse: Vector = np.linalg.inv(inertia)
        self.hand = float(random.choice([0.0, 0.5, 3.0]))
        loops = tuple(
            LoopProperties(sample_time=_TIME, delay=self.delay, moving_mass=m, device_damping=b,
                           device_damping_bound=most)
            for m, b, most in zip(masses.tolist(), least.tolist(), largest.tolist(), strict=True)
        )  # fmt: skip
        axes = axes_of(loops, self.hand, None)
        limits = per_axis_limits(axes, self.delay, 0)
        self.settings, self.memory = AccountSettings(axes, limits, moves=False), account_memory(limits)
        self.account, self.energy = GroupAccount(), float(random.choice([0.0, 1e-6, 1e-5, 1e-3]))
        self.queue = [[0.0] * count for _ in range(self.delay)]
        self.velocity = random.normal(size=count) * random.choice([0.0, 0.02, 0.3])
        self.flow, self.dissipated = self._flow(), 0.0

    def _flow(self) -> Vector:
        """Solution over a part of a hold of (way, velocity, constant force), by the series of the exponential."""
        count, step = len(self.velocity), _TIME / _PARTS
        rates = np.zeros((3 * count, 3 * count))
        rates[:count, count : 2 * count] = np.eye(count)
        rates[count : 2 * count, count:] = np.hstack([-self.inverse @ self.damping, self.inverse])
        term = total = np.eye(3 * count)
        for order in range(1, _TERMS):
            term = term @ rates * (step / order)
            total = total + term
        return total

    def send(self, times: float) -> Vector:
        """Asks for random torques, sends what is certified times `times`, and returns those that act now."""
        asked = self.random.normal(size=len(self.velocity)) * self.random.choice([1.0, 5.0, 30.0])
        if self.random.random() < 0.6:
            asked = np.abs(asked) * np.where(self.velocity < 0.0, -1.0, 1.0) * self.random.choice([-1.0, 1.0])
        rows = [*map(list, self.queue), [0.0] * len(asked)]
        at = Accounting(self.settings, self.account, self.memory, QueuedTorques(rows, 0, self.delay))
        permitted = [share_in_sum(at, asked.tolist(), self.energy, 0.0)]
        if self.random.random() < 0.5:  # whichever bound: another in each hold
            permitted.append(max(shares(at, asked.tolist(), self.energy)))
        self.queue.append((min(1.0, times * float(self.random.choice(permitted))) * asked).tolist())
        return np.array(self.queue.pop(0))

    def push(self, torques: Vector) -> Vector:
        """Returns forces of the hand on the motors: most often those that move along the torques most."""
        if self.random.random() < 0.7:
            return self.hand * np.sign(self.inverse @ torques)
        return self.hand * self.random.choice([-1.0, 0.0, 1.0], len(torques))

    def hold(self, torques: Vector) -> float:
        """Moves through one hold, books it, and returns the least energy at the handle in it [J]."""
        count, least = len(torques), math.inf
        state = np.concatenate([np.zeros(count), self.velocity, torques + self.push(torques)])
        powers = [float(self.velocity @ self.damping @ self.velocity)]
        for part in range(1, _PARTS + 1):
            state = self.flow @ state
            speed = state[count : 2 * count]
            powers.append(float(speed @ self.damping @ speed))
            if part % 2 == 0:  # Simpson
                self.dissipated += (powers[-3] + 4.0 * powers[-2] + powers[-1]) * _TIME / _PARTS / 3.0
                least = min(least, self.energy - float(torques @ state[:count]) + self.dissipated)
        moved, self.velocity = state[:count], state[count : 2 * count]
        self.energy -= float(torques @ moved)
        for i, damping in enumerate(self.settings.axes.damping):
            self.account.dissipated += damping * float(moved[i] ** 2)
            self.memory.displacement[i], self.memory.torques[i] = float(moved[i]), float(torques[i])
        return least


def least_energy(seed: int, times: float = 1.0) -> tuple[float, int]:
    """Returns the least energy at the handle of one plant [J], and the number of its holds with a torque."""
    plant = Plant(seed)
    least, held = plant.hold(np.zeros(len(plant.velocity))), 0  # what it moves in a first hold, the account knows then
    for _ in range(HOLDS):
        torques = plant.send(times)
        held += bool(np.any(torques))
        least = min(least, plant.hold(torques))
    return least, held


def main() -> None:
    """Attacks, and prints the least."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0, help="the first one")
    parser.add_argument("--times", type=float, default=1.0, help="torques are so many times what is certified")
    arguments = parser.parse_args()
    found = [
        (*least_energy(seed, arguments.times), seed) for seed in range(arguments.seed, arguments.seed + arguments.runs)
    ]
    least, _, seed = min(found)
    below = sum(energy < -1e-12 for energy, _, _ in found)
    print(f"{sum(held for _, held, _ in found)} holds with torque, least energy {least:.3g} J (seed {seed})")
    print(f"below 0: {below} of {len(found)} runs")


if __name__ == "__main__":
    main()
