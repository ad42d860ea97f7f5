"""The attacked rig as kernels: one or two masses, friction, current loop, late torques, cut torques, uneven holds.

It shares nothing with `canhaptic.sim`. Between two events the motion is the closed solution of m v' = F - b v - s f_c;
the torque is a staircase of its means over `STEPS` parts of a hold, so that what came in is exact for that staircase.
"""

import math
from typing import Any, Final, NamedTuple

from canhaptic.kernels import Buffer

STEPS: Final = 24
"""Parts of a hold with one torque each."""
_SHAFT_STEPS: Final = 16
"""Steps of the shaft in each part."""
X, V, LOAD_X, LOAD_V, MOTOR, BEFORE, TAKEN_IN, DISSIPATED, STRAIN = range(9)
"""Places in the state of a plant: positions and velocities, torque of the motor, last torque, energies [J], bristles.
"""


class Rig(NamedTuple):
    """What is really there; SI."""

    sample_time: float
    mass: float  # rigid with the encoder
    damping: float = 0.0
    friction: float = 0.0  # dry
    lag: float = 0.0  # of the current loop
    window: float = 0.0  # for which the torque before still acts
    jitter: float = 0.0  # a hold lasts (1 +- this) sample times
    limit: float = math.inf  # cuts a torque after it was computed
    rate_limit: float = math.inf  # of its rise [1/s]
    load: float = 0.0  # second mass, on a shaft, where the hand is
    shaft_stiffness: float = 0.0
    shaft_damping: float = 0.0
    delay: int = 0  # holds between computing a torque and its hold
    turns: bool = False  # the words of the hand depend on where the handle is
    bristles: float = 0.0  # stiffness by which dry friction gives way; 0: none
    creeps: bool = False  # as Dahl has it, and not at once where they slide
    overshoot: float = (
        0.0  # part of a change of torque that acts beyond it within `window`, in place of the torque before
    )


class Hand(NamedTuple):
    """What the hand may do: a wall is solid below 0; where the outside changes, by the effort where the handle is."""

    pull: float  # out of the wall, at most [N]
    push: float  # into it, at most [N]
    speed: float  # at the start, at most [m/s]


def hold(rig: Rig, state: Buffer, torque: float, hand: float, duration: float) -> None:
    """Moves the plant through one hold of `duration` [s] with one force of the hand [N]."""
    parts = STEPS if rig.lag > 0.0 or rig.window > 0.0 or rig.load > 0.0 else 1
    step = duration / parts
    for part in range(parts):
        move(rig, state, torque, hand, part * step, step)
    state[BEFORE] = torque


def hold_in_words(
    environment: Any, rig: Rig, words: Hand, state: Buffer, torque: float, hand: float, duration: float
) -> None:
    """The same with a hand that keeps its words wherever the handle is: what it may not, it does not."""
    step = duration / STEPS
    for part in range(STEPS):
        force = kept_to(environment, words, state[X], hand)
        force = kept_to(environment, words, state[X] + state[V] * step, force)
        move(rig, state, torque, force, part * step, step)
    state[BEFORE] = torque


def kept_to(environment: Any, words: Hand, position: float, force: float) -> float:
    """Returns a force [N] cut to the words: along the effort's torque the pull, against it, or without one, the push.

    Without an effort, or beyond it, either way the larger of both.
    """
    most = max(words.push, words.pull)
    effort = 0.0
    if environment.contact(position):
        effort = environment.effort(environment.true_state(position, 0.0, 0.0))
    low, high = -most, most
    if effort < 0.0:
        high, low = words.pull, -words.push
    elif effort > 0.0:
        low, high = -words.pull, words.push
    return min(max(force, low), high)


def move(rig: Rig, state: Buffer, torque: float, hand: float, since: float, step: float) -> None:
    """Moves the plant through a part of a hold [s] that begins `since` its SYNC."""
    late = (rig.window - since) / step
    late = 1.0 if late > 1.0 else 0.0 if late < 0.0 else late
    if rig.overshoot > 0.0:
        late *= -rig.overshoot
    demand = late * state[BEFORE] + (1.0 - late) * torque
    mean = demand
    if rig.lag > 0.0:
        kept = math.exp(-step / rig.lag)
        mean = demand + (state[MOTOR] - demand) * (1.0 - kept) * rig.lag / step
        state[MOTOR] = demand + (state[MOTOR] - demand) * kept
    before, kinetic, hand_from = state[X], energy_of(rig, state), state[LOAD_X]
    if rig.load > 0.0:
        move_two(rig, state, mean, hand, step)
        by_hand = hand * (state[LOAD_X] - hand_from)
    elif rig.bristles > 0.0:
        move_on_bristles(rig, state, mean + hand, step)
        by_hand = hand * (state[X] - before)
    else:
        move_one(rig, state, mean + hand, step)
        by_hand = hand * (state[X] - before)
    by_motor = mean * (state[X] - before)
    state[TAKEN_IN] -= by_motor
    state[DISSIPATED] += by_motor + by_hand - (energy_of(rig, state) - kinetic)


def energy_of(rig: Rig, state: Buffer) -> float:
    """Returns the kinetic and elastic energy [J]."""
    found = 0.5 * rig.mass * state[V] * state[V]
    if rig.load > 0.0:
        twist = state[X] - state[LOAD_X]
        found += 0.5 * rig.load * state[LOAD_V] * state[LOAD_V] + 0.5 * rig.shaft_stiffness * twist * twist
    return found


def move_one(rig: Rig, state: Buffer, force: float, duration: float) -> None:
    """Moves one mass under a constant force [N], through every stop and start of dry friction."""
    left, rate = duration, rig.damping / rig.mass
    for _ in range(8):
        speed = state[V]
        sign = 1.0 if speed > 0.0 else -1.0 if speed < 0.0 else 0.0
        if sign == 0.0:
            if abs(force) <= rig.friction:
                return
            sign = 1.0 if force > 0.0 else -1.0
        drive = (force - sign * rig.friction) / rig.mass - rate * speed
        time = left
        if rig.friction > 0.0 and drive * speed < 0.0:
            reach = -speed / drive
            if rate * reach < 1.0:
                stop = reach if rate < 1e-9 else -math.log1p(-rate * reach) / rate
                time = stop if stop < left else left
        y = rate * time
        if y < 1e-4:
            first, second = time * (1.0 - 0.5 * y), time * time * (0.5 - y / 6.0)
        else:
            first = -math.expm1(-y) / rate
            second = (time - first) / rate
        state[X] += speed * time + drive * second
        state[V] = 0.0 if time < left else speed + drive * first
        left -= time
        if left <= 0.0:
            return


def move_on_bristles(rig: Rig, state: Buffer, force: float, duration: float) -> None:
    """Moves one mass under a constant force [N] on bristles that slide at the friction; leapfrog, 40 steps a radian."""
    most, steps = rig.friction / rig.bristles, 4 + int(40.0 * duration * math.sqrt(rig.bristles / rig.mass))
    step = duration / steps
    for _ in range(steps):
        strain = state[STRAIN]
        state[V] += 0.5 * (force - rig.bristles * strain - rig.damping * state[V]) / rig.mass * step
        moved = state[V] * step
        state[X] += moved
        if not rig.creeps:
            strain = min(max(strain + moved, -most), most)
        elif moved > 0.0:
            strain = most - (most - strain) * math.exp(-moved / most)
        else:
            strain = -most + (most + strain) * math.exp(moved / most)
        state[STRAIN] = strain
        state[V] += 0.5 * (force - rig.bristles * strain - rig.damping * state[V]) / rig.mass * step


def move_two(rig: Rig, state: Buffer, torque: float, hand: float, duration: float) -> None:
    """Moves rotor and load on a shaft; symplectic steps."""
    step = duration / _SHAFT_STEPS
    for _ in range(_SHAFT_STEPS):
        shaft = rig.shaft_stiffness * (state[X] - state[LOAD_X]) + rig.shaft_damping * (state[V] - state[LOAD_V])
        state[V] += (torque - shaft - rig.damping * state[V]) / rig.mass * step
        state[LOAD_V] += (hand + shaft) / rig.load * step
        state[X] += state[V] * step
        state[LOAD_X] += state[LOAD_V] * step


def cut(rig: Rig, torque: float, before: float) -> float:
    """Returns what limits behind the controller leave of a torque [N]."""
    rise = rig.rate_limit * rig.sample_time
    size = min(abs(torque), rig.limit)
    was = abs(before) if torque * before > 0.0 else 0.0
    if size > was + rise:
        size = was + rise
    return size if torque > 0.0 else -size
