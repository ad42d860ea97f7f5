"""Which wall does a hand feel on a real rig, and what can it take out? `python -m tools.bench.rigs [--quick]`.

Twelve rigs with friction, late and uneven torques, counts and a torque quantum, on the plant of `tools/attack`, which
shares nothing with the package's own. Declared as a commissioning declares (0.9 m, 0.8 to 1.2 b, friction 0.45 to 1.2
of the true one), or not: upper bounds alone.

    felt   largest stiffness within 10 % and with a ripple below 5 % of the depth, for a hand of 400 N/m that comes at
           0.1 m/s to 5 N (fast), 0.02 m/s to 5 N (slow) or 0.1 m/s to 12 N
    taken  the most energy that hands which pull with 20 N and push with 60 N take out at the handle, from a wall of
           0.05 m / T^2; of `guarded` the least sum that it promises must stay above minus its allowance
"""

import argparse
import math
import os
import random
from collections.abc import Callable, Iterator
from functools import partial
from multiprocessing import Pool
from typing import Any, Final, NamedTuple

from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.control.passivity import Controller, LoopProperties, build_controller
from canhaptic.control.passivity.guarded import GuardedParameters
from canhaptic.view.picture_style import BLUE, ORANGE, VERMILION, drawing, save_picture
from tools.attack.plant import BEFORE, DISSIPATED, MOTOR, TAKEN_IN, Rig, V, X, energy_of, move_one
from tools.bench.report import Row, picture_place, publish

PARTS: Final = 8
"""Parts of a hold with one torque and one force of the hand each."""
LIMIT: Final = 60.0  # of the torque [N]
QUANTUM: Final = 0.02  # of the torque command [N]
GRIP: Final = 400.0, 4.0  # of the hand [N/m, N*s/m]
HANDS: Final = {"fast": (0.1, 5.0), "slow": (0.02, 5.0), "12 N": (0.1, 12.0)}
"""Speed of approach [m/s] and force at rest [N]."""
WALLS: Final[tuple[float, ...]] = tuple(round(float(10.0 ** (0.1 * step)), 1) for step in range(20, 53))  # [N/m]
PULL, PUSH = 20.0, 60.0  # of an attacking hand [N]
LAWS: Final = {
    "unprotected": ("unprotected", 0.0, True, False),
    "passivity observer": ("passivity_observer", 0.0, True, False),
    "guarded, F_h 5 N": ("guarded", 5.0, True, False),
    "guarded, F_h 20 N": ("guarded", 20.0, True, False),
    "guarded, F_h 5 N, not commissioned": ("guarded", 5.0, False, False),
    "guarded, F_h 20 N, not commissioned": ("guarded", 20.0, False, False),
    "guarded, F_h 5 N, not commissioned, allowance": ("guarded", 5.0, False, True),
    "guarded, F_h 20 N, not commissioned, allowance": ("guarded", 20.0, False, True),
}
"""Algorithm, declared pull of the hand [N], whether commissioned, whether with the allowance by the law."""


class Machine(NamedTuple):
    """A rig as it is; SI."""

    mass: float
    damping: float
    friction: float
    resolution: float  # of the encoder
    rate: float = 1000.0
    is_event: bool = False  # torques act within a window after the SYNC, in place of one sample late


RIGS: Final = {
    "direct drive": Machine(0.05, 0.05, 0.05, 1e-6),
    "capstan": Machine(0.1, 0.1, 0.3, 3.1e-6),
    "capstan, event": Machine(0.1, 0.1, 0.3, 3.1e-6, is_event=True),
    "belt, 2000 counts": Machine(0.15, 0.5, 1.0, 31e-6),
    "belt, 2000 counts, event": Machine(0.15, 0.5, 1.0, 31e-6, is_event=True),
    "belt, 20000 counts": Machine(0.15, 0.5, 1.0, 3.1e-6),
    "belt, 20000 counts, event": Machine(0.15, 0.5, 1.0, 3.1e-6, is_event=True),
    "gear": Machine(0.5, 2.0, 3.0, 3.1e-6),
    "gear, event": Machine(0.5, 2.0, 3.0, 3.1e-6, is_event=True),
    "spindle, 2000 counts": Machine(0.5, 2.0, 5.0, 31e-6),
    "belt at 500 Hz": Machine(0.15, 0.5, 1.0, 3.1e-6, 500.0),
    "belt at 250 Hz": Machine(0.15, 0.5, 1.0, 3.1e-6, 250.0),
}


def allowance_of(machine: Machine, hand_force: float) -> float:
    """Returns h F_h^2 / 4 [J], h = T^2 / m, three times that one sample late; at most 1 mJ."""
    h = (1.0 if machine.is_event else 3.0) / machine.rate**2 / (0.9 * machine.mass)
    return min(1e-3, 0.25 * h * (hand_force + 1.2 * machine.friction) ** 2)


def loop_of(machine: Machine, commissioned: bool) -> LoopProperties:
    """Returns what is declared of a rig."""
    certain = {"device_damping": 0.8 * machine.damping, "device_friction": 0.45 * machine.friction}
    return LoopProperties(
        sample_time=1.0 / machine.rate, delay=0 if machine.is_event else 1, moving_mass=0.9 * machine.mass,
        device_damping_bound=1.2 * machine.damping, device_friction_bound=1.2 * machine.friction, sync_jitter=0.02,
        torque_window=4e-4 if machine.is_event else 0.0, current_lag=1e-4, encoder_count=machine.resolution,
        torque_quantum=QUANTUM, torque_limit=LIMIT, **(certain if commissioned else {}),
    )  # fmt: skip


def controller_of(machine: Machine, law: str, stiffness: float) -> Controller:
    """Returns a law that renders a spring below 0."""
    name, hand_force, commissioned, allowed = LAWS[law]
    parameters = None
    if name == "guarded":
        allowance = allowance_of(machine, hand_force) if allowed else 0.0
        parameters = GuardedParameters(hand_force=hand_force, hand_push=PUSH, energy_allowance=allowance)
    wall = SpringDamperWall(stiffness=stiffness, damping=0.0, position=0.0)
    return build_controller(wall, name, parameters, loop_of(machine, commissioned))


class Played(NamedTuple):
    """A run, SYNC by SYNC, and the least sums of energy [J]."""

    depths: list[float]
    torques: list[float]
    promised: float  # of what came in and what the device is declared to dissipate
    at_handle: float  # the same with all that it does


Force = Callable[[float, float, float, float], float]
"""(time, position, velocity, torque of the wall) -> force of the hand; SI."""


def play(machine: Machine, controller: Controller, force: Force, seconds: float, start: float, certain: bool) -> Played:
    """Runs a hand against a wall; the commands come late, the holds are uneven, the counts are coarse."""
    rig = Rig(1.0 / machine.rate, machine.mass, machine.damping, machine.friction, lag=8e-5)
    state, draw, coming = [0.0] * 8, random.Random(1), [0.0] * (0 if machine.is_event else 1)
    state[X], torque, path, least, lowest, time = start, 0.0, 0.0, 0.0, 0.0, 0.0
    depths, torques, late = [], [], 3e-4 if machine.is_event else 0.0
    for _ in range(round(seconds * machine.rate)):
        reading = machine.resolution * round(state[X] / machine.resolution)
        asked = controller.step(reading, torque).torque
        asked = math.copysign(QUANTUM * math.floor(min(LIMIT, abs(asked)) / QUANTUM + 1e-9), asked)
        coming.append(asked)
        torque = coming.pop(0)
        length = rig.sample_time * (1.0 + draw.uniform(-0.015, 0.015)) / PARTS
        for part in range(PARTS):
            path += _move(rig, state, torque, late - part * length, length, force(time, state[X], state[V], torque))
            time += length
        state[BEFORE] = torque
        dry = machine.friction * path
        sure = 0.8 * (state[DISSIPATED] - dry) + 0.45 * dry if certain else 0.0
        least, lowest = min(least, state[TAKEN_IN] + sure), min(lowest, state[TAKEN_IN] + state[DISSIPATED])
        depths.append(-state[X])
        torques.append(torque)
        if abs(state[X]) > 0.5:
            break
    return Played(depths, torques, least, lowest)


def _move(rig: Rig, state: list[float], torque: float, left: float, step: float, hand: float) -> float:
    """Moves the plant through a part of a hold; returns its path. `left`: of the window, at its beginning [s]."""
    share = min(1.0, max(0.0, left / step))
    demand, kept = share * state[BEFORE] + (1.0 - share) * torque, math.exp(-step / rig.lag)
    mean = demand + (state[MOTOR] - demand) * (1.0 - kept) * rig.lag / step
    state[MOTOR] = demand + (state[MOTOR] - demand) * kept
    before, kinetic = state[X], energy_of(rig, state)
    move_one(rig, state, mean + hand, step)
    moved = state[X] - before
    state[TAKEN_IN] -= mean * moved
    state[DISSIPATED] += (mean + hand) * moved - (energy_of(rig, state) - kinetic)
    return abs(moved)


def leaning(stiffness: float, speed: float, most: float) -> Force:
    """Returns a hand whose far end comes at a speed and stops where it presses with a force at rest."""
    end, (spring, damper) = -(most / GRIP[0] + most / stiffness), GRIP

    def force(time: float, position: float, velocity: float, _torque: float) -> float:
        goal = max(end, 2e-3 - speed * time)
        return spring * (goal - position) + damper * ((-speed if goal > end else 0.0) - velocity)

    return force


def is_felt(machine: Machine, law: str, hand: str, stiffness: float) -> bool:
    """Whether a hand feels a wall, at rest."""
    speed, most = HANDS[hand]
    seconds = (2e-3 + most / GRIP[0] + most / stiffness) / speed + 0.7
    certain = LAWS[law][2]
    found = play(
        machine, controller_of(machine, law, stiffness), leaning(stiffness, speed, most), seconds, 2e-3, certain
    )
    last = slice(-round(0.25 * machine.rate), None)
    depths, torques = found.depths[last], found.torques[last]
    depth = sum(depths) / len(depths)
    if depth <= 0.0 or len(found.depths) < round(seconds * machine.rate):
        return False
    share, ripple = sum(torques) / len(torques) / depth / stiffness, (max(depths) - min(depths)) / depth
    return abs(share - 1.0) <= 0.1 and ripple <= 0.05


def felt(machine: Machine, law: str, hand: str) -> float:
    """Returns the largest stiffness that is felt [N/m]; 0: none. By bisection, after every fifth wall."""
    coarse = [place for place in range(0, len(WALLS), 4) if is_felt(machine, law, hand, WALLS[place])]
    if not coarse:
        return 0.0
    best = coarse[-1]
    for step in (2, 1):
        if best + step < len(WALLS) and is_felt(machine, law, hand, WALLS[best + step]):
            best += step
    return WALLS[best]


def attackers() -> Iterator[Force]:
    """Hands that take energy out where they can, within `PULL` and `PUSH`."""
    for seed in range(6):
        draw, told = random.Random(seed), [0.0, 0.0]

        def random_telegraph(time: float, x: float, _v: float, _f: float, draw: random.Random = draw,
                             told: list[float] = told) -> float:  # fmt: skip
            if time >= told[0]:
                told[:] = [time + draw.choice([2e-3, 8e-3, 0.03, 0.1]), draw.choice([PULL, -draw.uniform(5.0, PUSH)])]
            return PULL if x < -0.02 else -10.0 if x > 4e-3 else told[1]

        yield random_telegraph
    for threshold in (3.0, 10.0, 25.0):

        def loads_and_pulls(_t: float, x: float, v: float, torque: float, most: float = threshold) -> float:
            return PULL if torque > most or (v > 0.0 and torque > 0.3) or x < -0.05 else -min(PUSH, 2.0 * most + 10.0)

        yield loads_and_pulls


def taken(machine: Machine, law: str) -> tuple[float, float]:
    """Returns the most that attacking hands take out at the handle, and the least sum promised [J]."""
    stiffness = 0.05 * machine.mass * machine.rate**2
    runs = [
        play(machine, controller_of(machine, law, stiffness), force, 0.8, 1e-3, LAWS[law][2]) for force in attackers()
    ]
    return max(0.0, -min(run.at_handle for run in runs)), min(run.promised for run in runs)


def cell(place: tuple[str, str, str]) -> tuple[tuple[str, str, str], tuple[float, float]]:
    """Returns a cell of the table: a stiffness that is felt, or what attackers take."""
    rig, law, hand = place
    if hand == "attack":
        return place, taken(RIGS[rig], law)
    return place, (felt(RIGS[rig], law, hand), 0.0)


_MARKS = ((VERMILION, "X"), (ORANGE, "s"), *((colour, mark) for mark in "o|^" for colour in ("black", BLUE)))
"""Colour and mark of each law: black and blue are `guarded` for a pull of 5 and of 20 N."""


def rows_of(found: dict[tuple[str, str, str], tuple[float, float]]) -> Iterator[Row]:
    """Returns one row for each cell."""
    for (rig, law, hand), (value, promised) in found.items():
        if hand != "attack":
            yield Row(f"felt, {rig}: {law}, {hand} hand", value, "N/m")
            continue
        name, hand_force, _, allowed = LAWS[law]
        yield Row(f"taken out, {rig}: {law}", 1e3 * value, "mJ")
        if name == "guarded" and hand_force >= PULL:
            least = -allowance_of(RIGS[rig], hand_force) if allowed else 0.0
            met = promised >= least - 1e-9
            yield Row(f"promised sum, {rig}: {law}", promised, "J", target=f">= {least:.3g}", met=met)


def draw(found: dict[tuple[str, str, str], tuple[float, float]], rigs: list[str]) -> None:
    """Draws what is felt by hand and law, and what is taken out: a row for each rig, a mark for each law."""
    with drawing() as figure_type:
        figure = figure_type(figsize=(13.0, 9.0), dpi=110, layout="constrained")
        plots = figure.subplots(2, 2, sharey=True)
        laws = [law for law in LAWS if (rigs[0], law, "fast") in found]
        for plot, hand in zip(plots.flat, [*HANDS, "attack"], strict=True):
            scale, least = (1e3, 1e-3) if hand == "attack" else (1.0, 0.0)
            for law, (colour, mark) in zip(laws, _MARKS, strict=False):
                values = [max(least, scale * found.get((rig, law, hand), (0.0, 0.0))[0]) for rig in rigs]
                look: Any = {"linestyle": "none", "marker": mark, "markersize": 7.0, "color": colour}
                plot.plot(values, range(len(rigs)), label=law, **look)
            plot.set_xscale("log")
            plot.set_xlim((5e-4, 5e3) if hand == "attack" else (80.0, 2e5))
            speed, most = HANDS.get(hand, (0.0, 0.0))
            felt = f"largest wall felt by a hand at {speed:g} m/s up to {most:g} N [N/m]"
            plot.set_title("energy taken out by a hand that pulls 20 N, pushes 60 N [mJ]" if hand == "attack" else felt)
        plots[1][1].set_xticks([1e-3, 1e-2, 0.1, 1.0, 10.0, 100.0, 1000.0])
        plots[1][1].set_xticklabels(["none", "0.01", "0.1", "1", "10", "100", "1000"])
        plots[0][0].set_yticks(range(len(rigs)), rigs)
        plots[0][0].invert_yaxis()
        figure.legend(*plots[0][0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
        save_picture(figure, picture_place("rigs.png"))


def main() -> None:
    """Runs, tells, draws, publishes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="three rigs, the fast and the slow hand")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    arguments = parser.parse_args()
    rigs = ["capstan", "belt, 20000 counts", "belt at 250 Hz"] if arguments.quick else list(RIGS)
    hands = ["fast", "slow"] if arguments.quick else list(HANDS)
    places = [(rig, law, hand) for rig in rigs for law in LAWS for hand in [*hands, "attack"]]
    with Pool(arguments.jobs) as pool:
        found = dict(pool.imap(partial(cell), places))
    draw(found, rigs)
    publish("rigs", list(rows_of(found)), ("canhaptic", "numpy"))


if __name__ == "__main__":
    main()
