"""A plant whose holds are not ideal: periods that jitter, a torque that changes late and follows with a lag.

Independent of `canhaptic.sim`: m v' = u + h, tau u' = f - u, in closed form for constant f and h; the energy by Gauss's
rule, right to rounding. `climb` searches the hand, the periods and the changes that take most out.
"""

import math
import random
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

PARTS = 2  # of a hold, in each of which the hand's force is constant
_NODES = (0.06943184420297371, 0.33000947820757187, 0.66999052179242813, 0.93056815579702629)
_WEIGHTS = (0.17392742256872693, 0.32607257743127307, 0.32607257743127307, 0.17392742256872693)
_PANELS = 3


class Holds(NamedTuple):
    """What happens in each hold; the hand's force in each part of it [N]."""

    hand: list[list[float]]
    period: list[float]  # over the sample time
    change: list[float]  # of the torque, after the SYNC [s]


class Late:
    """A mass with a current loop."""

    def __init__(self, mass: float, lag: float, position: float, velocity: float) -> None:
        self.mass, self.lag, self.position, self.velocity = mass, lag, position, velocity
        self.torque = self.given = 0.0  # of the motor [N]; energy that it gave out [J]

    def move(self, held: float, hand: float, time: float) -> None:
        if time <= 0.0:
            return
        lag, rest = self.lag, self.torque - held
        force = (held + hand) / self.mass

        def at(t: float) -> tuple[float, float, float]:
            left = math.exp(-t / lag) if lag else 0.0
            swing = rest * lag / self.mass
            x = self.velocity * t + 0.5 * force * t * t + swing * (t - lag * (1.0 - left))
            return x, self.velocity + force * t + swing * (1.0 - left), held + rest * left

        for panel in range(_PANELS):
            for node, weight in zip(_NODES, _WEIGHTS, strict=True):
                _, speed, torque = at((panel + node) * time / _PANELS)
                self.given += weight * time / _PANELS * speed * torque
        moved, self.velocity, self.torque = at(time)
        self.position += moved


def least(
    controller: Any, holds: Holds, sample_time: float, delay: int, lag: float, start: tuple[float, float],
    cut: Callable[[float], float] = lambda torque: torque, mass: float = 0.25,
) -> tuple[float, float]:  # fmt: skip
    """Returns the least true sum of h_i after any hold, and the most that is booked for certain beyond it [J]."""
    plant, held, pending = Late(mass, lag, *start), 0.0, [0.0] * delay
    lowest = booked = beyond = 0.0
    for hand, period, change in zip(*holds, strict=True):
        balance = controller.step(plant.position, held)
        booked += balance.h_i
        beyond = max(beyond, booked - getattr(controller, "energy_resolution", 0.0) + plant.given)
        pending.append(cut(balance.torque))
        new, begin = pending.pop(0), 0.0
        for part in range(PARTS):
            end = sample_time * period * (part + 1) / PARTS
            middle = min(max(change, begin), end)
            plant.move(held, hand[part], middle - begin)
            plant.move(new, hand[part], end - middle)
            begin = end
        held = new
        lowest = min(lowest, -plant.given)
    return lowest, beyond


def climb(
    make: Callable[[], Any], rng: random.Random, sample_time: float, delay: int, *, pull: float, push: float,
    jitter: float = 0.0, window: float = 0.0, lag: float = 0.0, count: int = 40, steps: int = 120, **how: Any,
) -> tuple[float, float]:  # fmt: skip
    """Returns the worst of `least` that a search over hand, periods, changes and start finds."""
    choices: Sequence[float] = (-push, pull, 0.0, -0.3 * push)

    def drawn() -> Holds:
        hand: list[list[float]] = []
        while len(hand) < count:
            hand += [[rng.choice(choices)] * PARTS] * rng.randrange(1, 8)
        return Holds(
            [list(part) for part in hand[:count]],
            [1.0 + jitter * rng.choice((-1.0, 1.0)) for _ in range(count)],
            [window * rng.choice((0.0, 1.0)) for _ in range(count)],
        )

    def judged(holds: Holds, start: tuple[float, float]) -> tuple[float, float]:
        return least(make(), holds, sample_time, delay, lag, start, **how)

    holds, start = drawn(), (rng.uniform(-1e-3, 3e-3), -(10 ** rng.uniform(-2, 0)))
    best, beyond = judged(holds, start)
    for _ in range(steps):
        tried = Holds([list(part) for part in holds.hand], list(holds.period), list(holds.change))
        begin, force = start, rng.choice(choices)
        first = rng.randrange(count)
        for place in range(first, min(count, first + rng.randrange(1, 12))):
            kind = rng.randrange(4)
            if kind < 2:
                tried.hand[place] = [force] * PARTS if kind else [force, tried.hand[place][-1]]
            elif kind == 2:
                tried.period[place] = 1.0 + jitter * rng.choice((-1.0, 1.0))
            else:
                tried.change[place] = window * rng.choice((0.0, 1.0))
        if rng.random() < 0.2:
            begin = (start[0], start[1] * math.exp(0.4 * rng.gauss(0.0, 1.0)))
        found, more = judged(tried, begin)
        beyond = max(beyond, more)
        if found <= best:
            best, holds, start = found, tried, begin
    return best, beyond
