"""Hill climbing over the whole sequence of a hand's forces, and of the lengths of the holds, as one compiled kernel."""

import math
from collections.abc import Callable
from functools import lru_cache
from typing import Any, Final

import numpy as np

from canhaptic.control.environments import Environment, plain
from canhaptic.control.passivity import LoopProperties
from canhaptic.control.passivity.guarded import Guarded, GuardedParameters
from canhaptic.kernels import Buffer, Run
from canhaptic.kernels.compiler import compiled, fixed_tuple, tuple_type
from canhaptic.kernels.records import records_of
from tools.attack.plant import (
    BEFORE,
    DISSIPATED,
    LOAD_V,
    LOAD_X,
    TAKEN_IN,
    Hand,
    Rig,
    V,
    X,
    cut,
    hold,
    hold_in_words,
)

HOLDS: Final = 48
"""Cycles of one run."""
EVALUATIONS: Final = 240
"""Runs that one hand has tried when it is done."""
_ENOUGH: Final = 1e-3
"""Energy that came in from which on its rest counts [J]."""
_ROUNDING: Final = -1e-12
WIDTH = 0
"""Numbers of an environment; bound anew."""


def step(_environment: Any, _run: Any, _position: float, _torque: float) -> Any:
    """Placeholder of the algorithm."""
    raise NotImplementedError


def new_environment(*_numbers: float) -> Any:
    """Placeholder of the tuple type of an environment."""
    raise NotImplementedError


def measured(position: float, count: float) -> float:
    """Returns a position as an encoder of finite counts reports it."""
    return round(position / count) * count if count > 0.0 else position


def worst(
    environment: Any, run: Any, rig: Rig, hand: Hand, plant: Buffer, forces: Buffer, lengths: Buffer, start: Buffer,
    count: float, at_handle: bool,
) -> float:  # fmt: skip
    """Returns the least sum of energy after any hold of one run [J]; at the handle with what the device dissipated.

    Where that is not below zero: the least share that was left of what had come in, so that there is a slope to climb.
    """
    for place in range(len(plant)):
        plant[place] = 0.0
    plant[X] = plant[LOAD_X] = start[0]
    plant[V] = plant[LOAD_V] = start[1]
    least = waiting = acting = most = 0.0
    left = 1.0
    step(environment, run, measured(plant[X], count), 0.0)
    for k in range(len(forces)):
        if rig.turns:
            hold_in_words(environment, rig, hand, plant, acting, forces[k], lengths[k] * rig.sample_time)
        else:
            hold(rig, plant, acting, forces[k], lengths[k] * rig.sample_time)
        found = plant[TAKEN_IN] + (plant[DISSIPATED] if at_handle else 0.0)
        if found < least:
            least = found
        if found > most:
            most = found
        if most > _ENOUGH and found < left * most:
            left = found / most
        balance = step(environment, run, measured(plant[X], count), acting)
        torque = cut(rig, balance.torque, plant[BEFORE])
        if abs(torque) > start[2]:
            start[2] = abs(torque)
        if rig.delay > 0:
            acting, waiting = waiting, torque
        else:
            acting = torque
    return least if least < _ROUNDING else left


def climb(
    numbers: Buffer, settings: Any, rest: Any, states: Any, memory: Any, zeros: Any, rig: Rig, hand: Hand,
    seed: int, evaluations: int, count: float, at_handle: bool,
    plant: Buffer, forces: Buffer, lengths: Buffer, start: Buffer, best: Buffer,
) -> float:  # fmt: skip
    """Returns the least sum that the best hand reached [J]; its forces are left in `best`."""
    environment = new_environment(*fixed_tuple(numbers, WIDTH))
    holds = len(forces)
    least = math.inf
    random = seed * 2654435761 % 4294967296 + 1
    for tried in range(evaluations):
        for k in range(holds):
            forces[k], lengths[k] = best[k], best[holds + k]
        start[0], start[1] = best[2 * holds], best[2 * holds + 1]
        random = mutate(rig, hand, random, tried < evaluations // 8, forces, lengths, start)
        zeros[:] = 0.0
        states[0] = rest[0]
        found = worst(
            environment, Run(settings, states[0], memory), rig, hand, plant, forces, lengths, start, count, at_handle
        )
        if found < least or (found == least and tried % 2):
            least = found
            for k in range(holds):
                best[k], best[holds + k] = forces[k], lengths[k]
            best[2 * holds], best[2 * holds + 1] = start[0], start[1]
    return least


def mutate(rig: Rig, hand: Hand, random: int, is_new: bool, forces: Buffer, lengths: Buffer, start: Buffer) -> int:
    """Changes forces and lengths of some holds, or of all; returns the random number to go on with.

    A stretch of holds takes one force and one length, or new ones every fourth hold on average.
    """
    random = drawn(random)
    kind, holds = random % 7, len(forces)
    if is_new or kind == 0:
        random = drawn(random)
        start[0] = 0.004 * share(random)
        random = drawn(random)
        start[1] = hand.speed * (2.0 * share(random) - 1.0)
    random = drawn(random)
    first = 0 if is_new else random % holds
    random = drawn(random)
    longest = holds if is_new or kind == 1 else 6
    last = holds if is_new else min(holds, first + 1 + random % longest)
    random = drawn(random)
    value, length = force_of(hand, rig.turns, random), length_of(rig, random // 11)
    for k in range(first, last):
        if is_new or kind == 2:
            random = drawn(random)
            if random % 4 == 0:
                random = drawn(random)
                value, length = force_of(hand, rig.turns, random), length_of(rig, random // 11)
        if is_new or kind != 3:
            forces[k] = value
        if is_new or kind != 4:
            lengths[k] = length
    return random


def length_of(rig: Rig, random: int) -> float:
    """Returns the length of a hold [sample times]: half of the time the longest or the shortest."""
    if random % 2:
        return 1.0 + rig.jitter * (1.0 if random % 4 == 1 else -1.0)
    return 1.0 + rig.jitter * (2.0 * share(random) - 1.0)


def drawn(random: int) -> int:
    """Returns the next number of a small generator (Lehmer, modulus 2^31 - 1)."""
    return random % 2147483647 * 48271 % 2147483647


def share(random: int) -> float:
    """Returns a number from 0 to 1."""
    return (random % 1000003) / 1000002.0


def force_of(hand: Hand, turns: bool, random: int) -> float:
    """Returns a force of the hand: half of the time one of its ends, or none."""
    kind = random % 8
    most = hand.push if turns and hand.push > hand.pull else hand.pull
    if kind == 0:
        return most
    if kind == 1:
        return -hand.push
    if kind == 2:
        return 0.0
    return -hand.push + (most + hand.push) * share(random // 8)


@lru_cache(maxsize=8)
def _compiled(kind: Any) -> Callable[..., float]:
    instead = {new_environment: kind, "WIDTH": len(kind._fields), step: Guarded.kernel.step}
    climber: Callable[..., float] = compiled(climb, instead, keep=True)
    return climber


class Attack:
    """A rig, what is declared of it, and the hands that try to get energy out of it.

    Args:
        rig: What is there.
        wall: What is rendered.
        declared: Of the loop.
        parameters: Of `guarded`.
        hand: What the hand may do; within what is declared, if that is to be true.

    Attributes:
        strongest: Largest torque that was rendered in any run [N]; a wall without torque proves nothing.
    """

    def __init__(
        self, rig: Rig, wall: Environment, declared: LoopProperties, parameters: GuardedParameters, hand: Hand
    ) -> None:
        environment = plain(wall)
        kind = tuple_type(environment)
        settings = Guarded.kernel.settings(environment, parameters, declared)
        self._numbers = np.array([getattr(environment, name) for name in kind._fields], dtype=float)
        self._settings = records_of([settings], plain=True)[0]  # one machine code for every rig
        self._rest = records_of([Guarded.kernel.state()])
        self._states = self._rest.copy()
        lengths: list[int] = []

        def count_numbers(length: int) -> Any:
            lengths.append(length)
            return []

        Guarded.kernel.memory(settings, count_numbers)
        self._zeros, used = np.zeros(sum(lengths)), 0

        def make_buffer(length: int) -> Any:
            nonlocal used
            used += length
            return self._zeros[used - length : used]

        self._memory = Guarded.kernel.memory(settings, make_buffer)
        self._climb = _compiled(kind)
        self._rig, self._hand, self._count = rig, hand, declared.encoder_count
        self._at_handle = bool(declared.device_damping or declared.device_friction)
        self.strongest = 0.0

    @property
    def is_ideal(self) -> bool:
        """Whether every torque acts from SYNC to SYNC as it was computed, on one mass without dry friction."""
        rig = self._rig
        return rig.limit > 1e3 and not (rig.friction or rig.lag or rig.window or rig.jitter or rig.load)

    def ignore_turns(self) -> None:
        """Certifies as if the hand pulled with no more than its pull either way, wherever the effort turns."""
        self._settings["turns"] = False

    def run(self, seed: int, evaluations: int = EVALUATIONS, holds: int = HOLDS) -> float:
        """Returns the least sum of energy that the hand of one seed reached [J]; 0 where none was below it."""
        room = np.zeros(9), np.zeros(holds), np.ones(holds), np.zeros(3), np.ones(2 * holds + 2)
        found = float(
            self._climb(
                self._numbers, self._settings, self._rest, self._states, self._memory, self._zeros, self._rig,
                self._hand, seed, evaluations, self._count, self._at_handle, *room,
            )
        )  # fmt: skip
        self.strongest = max(self.strongest, float(room[3][2]))
        return min(0.0, found)
