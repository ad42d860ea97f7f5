"""Attacks a rig behind which a slow program says what is there: random programs that stall, jump, owe, and lie.

    python -m tools.attack.worlds --runs 2000
    python -m tools.attack.worlds --mutants           # lines of the rule broken in turn: each must be found

Plants, hands and networks are those of `tools.attack.far`. The true energy of the plant is looked at in every step of
its solver with S and R (F1), and with the most that the program has given so far (F4), over all sessions. A program
that lies about its energy is held to F1 alone.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any, Final, NamedTuple

import numpy as np

from canhaptic.far import port as far_port
from canhaptic.far.parameters import Coupling
from canhaptic.far.port import FarState
from canhaptic.kernels import Run
from canhaptic.kernels.compiler import compiled
from canhaptic.kernels.records import records_of
from tools.attack.far import (
    MUTANTS,
    Rig,
    advance,
    attack,
    certain,
    copies_of,
    declared,
    deduct,
    drawn_rig,
    drawn_way,
    lateness,
    measured,
    needed,
    new_memory,
    step,
)

OF_A_WORLD: Final = {
    **{name: MUTANTS[name] for name in MUTANTS if MUTANTS[name] < 9},
    "program gives what it lacks": 20,
    "program forgets what it took": 21,
    "totals go on after the session": 22,
}
"""Line of the rule that is wrong -> its number."""
_PICO = 1e-12
_BOX: Final = 4096
_STIFFEST = 1e5  # [N/m]


class Program(NamedTuple):
    """What the program behind the rig does; SI."""

    period: float  # of a turn
    stall: float  # longest
    stalls: float  # share of the turns that stall
    jumps: float  # share of the turns in which something else is said
    work: float  # scale of the energy that it takes in or gives in a turn
    kind: int  # 0 books no energy, 1 takes in and gives at random, 2 gives and takes back
    budget: float
    lies: bool
    silence: float
    is_greedy: bool  # whether it asks for everything


def take(box: Any, count: int, now: float, keeps: Any, seen: float) -> tuple[int, float]:
    """Moves packets that have arrived out of a box: totals into `keeps`, and what the newest one says."""
    place = 0
    while place < count:
        if box[place, 0] > now:
            place += 1
            continue
        keeps[0], keeps[1] = max(keeps[0], box[place, 2]), max(keeps[1], box[place, 3])
        keeps[2] += box[place, 2]
        keeps[3] = now
        if box[place, 1] > seen:
            seen = box[place, 1]
            for column in range(4, 9):
                keeps[column] = box[place, column]
        count -= 1
        for column in range(9):
            box[place, column] = box[count, column]
    return count, seen


def post(random: Any, way: Any, box: Any, full: Any, to: int, now: float, copies: int, words: Any) -> None:
    """Puts copies of a packet on their way; `words` is its row without the time of arrival."""
    for _ in range(copies):
        late = lateness(random, way)
        if full[to] < len(box):
            row = box[full[to]]
            row[0] = now + late
            for column in range(8):
                row[1 + column] = words[column]
            full[to] += 1


def think(program: Program, random: Any, keeps: Any, mind: Any, now: float, mutant: int) -> None:
    """Lets the program take its turn; `mind` has H, S, the most of H, and then what it says (see `post`)."""
    work = program.work * (2.0 * random.random() - 1.0)
    if program.kind == 2:
        work = program.work * np.sign(np.sin(3.0 * now))
    mind[0] += 0.0 if program.kind == 0 or (mutant == 21 and work < 0.0) else work / _PICO
    mind[10] += 0.0 if program.kind == 0 else work / _PICO
    mind[2] = max(mind[2], mind[10])
    has = np.floor(mind[0] + keeps[0] + program.budget / _PICO)
    if program.lies or mutant == 20:
        has = mind[1] + 1e12 * random.random()
    mind[1] += max(0.0, min(keeps[1] - mind[1], has - mind[1]))
    if random.random() < program.jumps:
        drawn = random.random()
        mind[7] = 0.0 if drawn < 0.2 else 1.0 if drawn < 0.5 else -1.0 if drawn < 0.8 else 2.0
        mind[5], mind[6] = keeps[4] + 0.12 * (random.random() - 0.5), random.random() - 0.5
        mind[8], mind[9] = _STIFFEST * 1e4 ** (random.random() - 1.0), 20.0 * random.random()
        mind[8] = 0.0 if random.random() < 0.2 else mind[8]
    else:
        mind[5] += mind[6] * program.period
    owed = max(0.0, mind[1] - mind[0] - keeps[0])
    mind[3], mind[4] = mind[1], keeps[0] + (1e13 if program.is_greedy else owed)


def hear(state: Any, keeps: Any, now: float, silence: float, mutant: int) -> None:
    """Gives the port what has arrived."""
    state.received, state.wanted = (keeps[2] if mutant == 1 else keeps[0]), keeps[1]
    state.linked, state.far_ready = now - keeps[3] < silence, True
    state.far_position, state.far_velocity, state.far_side = keeps[4], keeps[5], keeps[6]
    state.world.stiffness, state.world.damping = keeps[7], keeps[8]


def note(rig: Rig, plant: Any, state: Any, acting: float, now: float, end: float, sums: Any, out: Any) -> None:
    """Moves the plant to `end`, and notes the least energies; `sums` has R - S and gifts of sessions that ended."""
    before = plant[2]
    low = before + advance(rig, plant, acting, now, end)
    owed = sums[0] + (state.booked - state.sent) * _PICO
    least = min(low, plant[2])
    out[1], out[2] = min(out[1], least + owed), min(out[2], least)
    out[0] = min(out[0], least + sums[1] + sums[2])


def run_world(
    settings: Any, states: Any, memory: Any, rig: Rig, ways: Any, program: Program, random: Any, length: float,
    mutant: int, out: Any, boxes: Any, plant: Any, full: Any, keeps: Any, mind: Any, room: Any,
) -> None:  # fmt: skip
    """Runs one rig and its program; `out` gets least energies with gifts, with S and R, alone; torque, S, R, ends."""
    sums, words, state = room[:3], room[3:], states[0]
    acting = waiting = newest = now = rig_due = number = turn = 0.0
    seen = seen_far = -1.0
    bad = bad_far = False
    due, keeps[0, 3] = 0.3 * program.period, -1e9
    while now < length:
        end = min(due, rig_due)
        note(rig, plant, state, acting, now, end, sums, out)
        now = end
        if due <= rig_due:
            full[1], seen_far = take(boxes[1], full[1], now, keeps[1], seen_far)
            think(program, random, keeps[1], mind, now, mutant)
            sums[2] = mind[2] * _PICO + program.budget
            due = now + program.period * (0.5 + random.random())
            due += program.stall * random.random() if random.random() < program.stalls else 0.0
            words[0], turn = turn, turn + 1.0
            words[1], words[2], words[3], words[4], words[5] = mind[3], mind[4], mind[5], mind[6], mind[7]
            words[6], words[7] = mind[8], mind[9]
            copies, bad_far = copies_of(random, ways[1], now, bad_far)
            post(random, ways[1], boxes[0], full, 0, now, copies, words)
            continue
        full[0], seen = take(boxes[0], full[0], now, keeps[0], seen)
        hear(state, keeps[0], now, program.silence, mutant)
        owed, phase, told = (state.booked - state.sent) * _PICO, state.phase, state.sent
        position = measured(rig, plant[0])
        applied = newest if mutant == 7 else acting
        torque = step(0.0, Run(settings[0], state, memory), position, applied).torque
        if phase != 0 and state.phase == 0:  # no session: totals of it are never continued
            sums[0], sums[1] = sums[0] + owed, sums[1] + sums[2]
            mind[2] = mind[10] = 0.0
            if mutant != 22:
                keeps[:], mind[:2] = 0.0, 0.0
                full[0] = full[1] = 0
                seen = seen_far = -1.0
            keeps[0, 3], sums[2] = -1e9, 0.0
            out[6] += 1.0
        out[3] = max(out[3], abs(torque))
        acting, waiting, newest = (waiting if rig.delay > 0 else torque), torque, torque
        words[:] = 0.0
        words[0], number = number, number + 1.0
        words[1], words[2], words[3] = state.sent - (told if mutant == 1 else 0.0), state.request, position
        copies, bad = copies_of(random, ways[0], now, bad)
        post(random, ways[0], boxes[1], full, 1, now, copies, words)
        rig_due = now + rig.time * (1.0 + rig.jitter * (2.0 * random.random() - 1.0))
        out[4], out[5] = max(out[4], state.sent * _PICO), max(out[5], state.booked * _PICO)


@cache
def _runner() -> Callable[..., None]:
    instead: dict[object, object] = {
        step: far_port.FarPort.kernel.step,
        far_port.needed: needed,
        far_port.certain: certain,
        far_port.deduct: deduct,
    }
    made: Callable[..., None] = compiled(run_world, instead, keep=True)
    return made


def drawn_program(random: np.random.Generator) -> Program:
    """Returns a random program."""
    return Program(
        period=1.0 / float(random.choice([5.0, 30.0, 60.0, 60.0, 120.0, 1000.0])),
        stall=float(random.choice([0.05, 0.5, 0.5, 1.5])), stalls=float(random.choice([0.0, 0.01, 0.06])),
        jumps=float(random.choice([0.02, 0.1, 0.5])), work=10.0 ** random.uniform(-4.0, 0.0),
        kind=int(random.integers(0, 3)), budget=float(random.choice([0.0, 0.0, 0.05])),
        lies=bool(random.random() < 0.15), silence=float(random.choice([0.1, 2.0])),
        is_greedy=bool(random.random() < 0.4),
    )  # fmt: skip


def run(seed: int, length: float, mutant: int = 0) -> Any:
    """Returns the figures of one random world (see `run_world`), F1 and F4 first; F4 is 0 where the program lies."""
    random = np.random.default_rng(seed)
    rig, program, ways = drawn_rig(random), drawn_program(random), (drawn_way(random), drawn_way(random))
    if random.random() < 0.3:
        rig = rig._replace(encoder=1e-4)
    told = declared(random, rig, Coupling(type="model", stiffness=_STIFFEST, damping=20.0))
    if mutant == 5:
        told = replace(told, ahead=replace(told.ahead, response=replace(told.ahead.response, hand=0.0, push=0.0)))
    told = replace(told, alpha=float(mutant), by_model=False, by_world=True, slew=0.01 * told.torque_limit)
    states, out = records_of([FarState()], plain=True), np.zeros(7)
    if mutant == 6:
        states["at_rest"] = -6
    _runner()(
        records_of([told], plain=True), states, new_memory(told), rig, ways, program, random, length, mutant, out,
        np.zeros((2, _BOX, 9)), np.zeros(3), np.zeros(2, np.int64), np.zeros((2, 9)), np.zeros(11),
        np.zeros(11),
    )  # fmt: skip
    if program.lies:
        out[0] = 0.0
    return out


def outcome(seed: int, length: float, mutant: int = 0) -> tuple[float, float, float]:
    """Returns the least energy of a world with its gifts, or with S and R; alone [J]; and the largest torque."""
    out = run(seed, length, mutant)
    return float(min(out[:2])), float(out[2]), float(out[3])


if __name__ == "__main__":
    attack(__doc__, outcome, OF_A_WORLD)
