"""Programs that ask for the torque of an axis themselves, most of them for what gives energy out.

Drawn from a generator of its own, so that a seed keeps what the other modules draw for it.
"""

import itertools
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np

from canhaptic.scene.build import Experiment
from canhaptic.signals import Sample

_SHARE: Final = 0.12
"""Share of the scenes of one axis under `guarded` whose torque a program asks for."""
_Law = Callable[[float, float, float], float]
"""(position, displacement in the last hold, time) -> torque asked for [N or N*m]."""


def _random(size: float, chance: np.random.Generator) -> _Law:
    return lambda position, moved, time: float(chance.uniform(-size, size))


def _along(size: float, chance: np.random.Generator) -> _Law:
    """Returns a law that pushes along every motion: it never takes energy in by itself."""
    return lambda position, moved, time: size * float(np.sign(moved))


def _in_turn(size: float, chance: np.random.Generator) -> _Law:
    turns = itertools.cycle((size, -size))
    return lambda position, moved, time: next(turns)


def _earn_and_spend(size: float, chance: np.random.Generator) -> _Law:
    """Returns a law that brakes for a while and then gives all of it out."""
    period = float(chance.uniform(0.05, 0.4))
    return lambda position, moved, time: size * float(np.sign(moved)) * (-1.0 if time % period < 0.6 * period else 1.0)


def _unstable_spring(size: float, chance: np.random.Generator) -> _Law:
    stiffness, place = 10.0 ** float(chance.uniform(1.5, 4.0)), float(chance.uniform(-5e-3, 5e-3))
    return lambda position, moved, time: float(stiffness * (position - place))


def _late_wall(size: float, chance: np.random.Generator) -> _Law:
    """Returns a wall at 0 that sees positions some holds old."""
    stiffness: float = 10.0 ** float(chance.uniform(2.0, 4.0))
    seen = deque[float](maxlen=int(chance.integers(1, 8)))

    def law(position: float, moved: float, time: float) -> float:
        seen.append(position)
        return max(0.0, -stiffness * seen[0])

    return law


PROGRAMS: Final[dict[str, Callable[[float, np.random.Generator], _Law]]] = {
    "random": _random,
    "along": _along,
    "in_turn": _in_turn,
    "earn_and_spend": _earn_and_spend,
    "unstable_spring": _unstable_spring,
    "late_wall": _late_wall,
}


def draw_program(seed: int, values: dict[str, Any], tags: set[str], outward: tuple[int, ...]) -> tuple[int, ...]:
    """Puts a program in the place of the environment of some scenes; returns the direction out of it, of each axis.

    Args:
        seed: Of the scene.
        values: Changed.
        tags: Changed.
        outward: Of the scene without it.
    """
    chance = np.random.default_rng([seed, 29])
    if "groups" in values or "algorithm:guarded" not in tags or chance.random() >= _SHARE:
        return outward
    tags -= {tag for tag in tags if tag.startswith("environment:")}
    tags.add(f"program:{list(PROGRAMS)[int(chance.integers(len(PROGRAMS)))]}")
    values["guard"] = "certificates"
    if values["passivity"].get("hand_push") is None and values["passivity"].get("hand_force") is not None:
        values["passivity"]["hand_push"] = 5.0
        tags.add("declares:hand_push")
    return (0,)


class Program:
    """The torque that a program asks for at each SYNC.

    Args:
        seed: Of the scene.
        name: Of the program.
        period: Sample time [s].
    """

    def __init__(self, seed: int, name: str, period: float) -> None:
        chance = np.random.default_rng([seed, 31])
        self._law = PROGRAMS[name](10.0 ** float(chance.uniform(-0.5, 1.5)), chance)
        self._period, self._before = period, 0.0

    def torque(self, index: int, position: float) -> float:
        """Returns the torque [N or N*m] of a SYNC at a position [m or rad]."""
        moved, self._before = position - self._before, position
        return self._law(position, moved, index * self._period)


class Asking:
    """Asks for the torque of each turn; for `Cycle.turn`.

    Args:
        experiment: A scene for a program.
        seed: Of the scene.
        name: Of the program.

    Attributes:
        asked: Largest torque that was asked for [N or N*m].
    """

    def __init__(self, experiment: Experiment, seed: int, name: str) -> None:
        self._controllers: Sequence[Any] = [port.controller for port in experiment.cycle.ports]
        self._program = Program(seed, name, experiment.rig.bus.sample_time)
        self.asked = 0.0

    def __call__(self, samples: Sequence[Sample]) -> None:
        """Asks for the torque of the first axis."""
        torque = self._program.torque(samples[0].sync_index, samples[0].position)
        self._controllers[0].ask(torque)
        self.asked = max(self.asked, abs(torque))
