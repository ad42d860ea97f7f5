"""Attacks the port to a far side: random pairs of rigs, hands and networks, with plants and a network of its own.

    python -m tools.attack.far --runs 1000
    python -m tools.attack.far --mutants              # every line of the rule broken in turn: each must be found

Nothing of `canhaptic.sim` is used. The energies come from the plants, at every step of their solver for one side (what
came in at its motor, less sent, plus received) and at every SYNC of either for both, on a clock that neither side has.
A run is false where either is below -1e-9 J. In a mutant one line of the rule is wrong; it is found by one false run.
"""

import argparse
import json
import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache, partial
from typing import Any, Final, Literal, NamedTuple, cast

import numpy as np

from canhaptic.control.certificates.certified_torque import taken_under_way
from canhaptic.control.passivity import LoopProperties
from canhaptic.control.passivity.guarded import GuardedParameters, certain_energy, memory_of
from canhaptic.far import port as far_port
from canhaptic.far.parameters import Coupling, FarParameters, FromFar
from canhaptic.far.port import FarState, settings_of
from canhaptic.kernels import Buffer, Run
from canhaptic.kernels.compiler import compiled
from canhaptic.kernels.records import records_of

MUTANTS: Final = {
    "packet as quantum": 1,
    "not taken off": 2,
    "no reserve for the queue": 3,
    "one hold forgotten": 4,
    "hand forgotten": 5,
    "counts forgotten": 6,
    "commands booked": 7,
    "sent booked as leak": 8,
    "rule not clamped at 0": 9,
    "own packets reflected": 10,
    "restart inside a session": 11,
}
"""Line of the rule that is wrong -> its number."""
FALSE: Final = -1e-9
"""Energy below which a run is false [J]."""
GIVEN: Final = -1e-3
"""Energy below which one side has given out what the other had put in [J]."""
_PICO = 1e-12
_BOX: Final = 4096
_ANY = 0


class Rig(NamedTuple):
    """One side: what is really there, and what its hand does; SI."""

    time: float  # from SYNC to SYNC
    jitter: float  # of it, as a part
    delay: int  # holds until a torque acts
    mass: float
    damping: float
    friction: float
    encoder: float
    wall: float
    wall_stiffness: float
    wall_damping: float
    wall_most: float
    hand_stiffness: float
    hand_damping: float
    hand_most: float
    intent: int  # 1 sines, 2 jumps, 3 pulls along the torque
    a1: float
    w1: float
    a2: float
    w2: float
    phase: float


class Way(NamedTuple):
    """The network in one direction."""

    delay: float
    jitter: float
    loss: float
    burst: float
    double: float
    out_from: float
    out_to: float


def certain(state: Any) -> float:
    """Replaces `port.certain`: at -6 the encoder's counts are forgotten."""
    energy = state.h_s - state.axis.h_dis
    return energy if state.at_rest == -6 else certain_energy(state, energy)


def needed(run: Any) -> float:
    """Replaces `port.needed`: the number of a mutant is in `alpha`, which a port does not use."""
    ahead, bound, memory, mutant = run.settings.ahead, run.state.bound, run.memory.bound, run.settings.alpha
    if mutant == 3.0:
        return 0.0
    holds = ahead.delay + ahead.losses - (1 if mutant == 4.0 else 0)
    up = taken_under_way(ahead, bound, memory, 1.0, ahead.hand_speed, holds, _ANY)
    down = taken_under_way(ahead, bound, memory, -1.0, ahead.hand_speed, holds, _ANY)
    return up[0] + down[0] if mutant == 9.0 else up[1] + down[1]


def deduct(run: Any, given: float) -> None:
    """Replaces `port.deduct`."""
    if run.settings.alpha != 2.0:
        run.state.h_s -= given
    if run.settings.alpha == 8.0:
        run.state.unrecovered += given


def step(_environment: Any, _run: Any, _position: float, _torque: float) -> Any:
    """Placeholder of the port."""
    raise NotImplementedError


def force(rig: Rig, x: float, v: float, torque: float, t: float) -> float:
    """Returns the force of hand and wall [N]; neither is ever stronger than declared."""
    out = 0.0
    if rig.intent == 3 and math.sin(rig.w2 * t + rig.phase) > 0.0:
        out = rig.hand_most if torque > 0.0 else -rig.hand_most if torque < 0.0 else 0.0
    elif rig.hand_stiffness > 0.0:
        if rig.intent == 2:
            aim = rig.a1 if math.sin(rig.w1 * t + rig.phase) > 0.0 else rig.a2
        else:
            aim = rig.a1 * math.sin(rig.w1 * t + rig.phase) + rig.a2 * math.sin(rig.w2 * t)
        out = min(max(rig.hand_stiffness * (aim - x) - rig.hand_damping * v, -rig.hand_most), rig.hand_most)
    if rig.wall_stiffness > 0.0 and x > rig.wall:
        out += max(-rig.wall_most, min(0.0, -rig.wall_stiffness * (x - rig.wall) - rig.wall_damping * v))
    return out


def acceleration(rig: Rig, x: float, v: float, torque: float, t: float) -> float:
    """Returns the acceleration of the mass [m/s^2]."""
    return (torque + force(rig, x, v, torque, t) - rig.damping * v - rig.friction * math.tanh(v / 4e-3)) / rig.mass


def advance(rig: Rig, plant: Any, torque: float, now: float, end: float) -> float:
    """Moves one plant to `end` under a held torque (RK4); returns the least that came in on the way [J], at most 0."""
    steps = 1 + int((end - now) / 1e-4)
    h, least, t = (end - now) / steps, 0.0, now
    begin = plant[0]
    for _ in range(steps):
        x, v = plant[0], plant[1]
        k1v = acceleration(rig, x, v, torque, t)
        x2, v2 = x + 0.5 * h * v, v + 0.5 * h * k1v
        k2v = acceleration(rig, x2, v2, torque, t)
        x3, v3 = x + 0.5 * h * v2, v + 0.5 * h * k2v
        k3v = acceleration(rig, x3, v3, torque, t)
        x4, v4 = x + h * v3, v + h * k3v
        k4v = acceleration(rig, x4, v4, torque, t)
        plant[0] = x + h * (v + 2.0 * v2 + 2.0 * v3 + v4) / 6.0
        plant[1] = v + h * (k1v + 2.0 * k2v + 2.0 * k3v + k4v) / 6.0
        t += h
        least = min(least, -torque * (plant[0] - begin))
    plant[2] -= torque * (plant[0] - begin)
    return least


def take_packets(state: Any, box: Any, count: int, seen: float, now: float, mutant: int) -> tuple[int, float]:
    """Gives a port what has arrived; returns how many packets are under way, and the newest number seen."""
    place = 0
    while place < count:
        if box[place, 0] > now:
            place += 1
            continue
        state.received = state.received + box[place, 4] if mutant == 1 else max(state.received, box[place, 4])
        state.wanted = max(state.wanted, box[place, 5])
        state.linked = True
        state.far_ready = state.far_ready or box[place, 6] > 0.0
        state.far_wall = box[place, 2] + 0.02 * math.sin(0.3 * box[place, 1])  # walls that appear, jump and go
        state.far_side = 1.0 if math.sin(0.011 * box[place, 1]) > 0.3 else -1.0 if box[place, 1] % 7 == 0 else 0.0
        if box[place, 1] > seen:
            seen, state.far_position, state.far_velocity = box[place, 1], box[place, 2], box[place, 3]
        count -= 1
        for column in range(7):
            box[place, column] = box[count, column]
    return count, seen


def copies_of(random: Any, way: Way, now: float, bad: bool) -> tuple[int, bool]:
    """Returns how often a packet arrives, and whether a burst of losses goes on."""
    if way.loss > 0.0:
        leave, draw = 1.0 / way.burst, random.random()
        bad = draw > leave if bad else draw < leave * way.loss / (1.0 - way.loss)
    if bad or way.out_from <= now < way.out_to:
        return 0, bad
    return (2 if random.random() < way.double else 1), bad


def move_all(rigs: Any, states: Any, plants: Any, acting: Any, now: float, end: float, out: Any) -> None:
    """Moves both plants to `end`, and notes the least energies."""
    for i in range(2):
        before = plants[i, 2]
        low = before + advance(rigs[0] if i == 0 else rigs[1], plants[i], acting[i], now, end)
        owed = (states[i].booked - states[i].sent) * _PICO
        out[1 + i] = min(out[1 + i], low + owed, plants[i, 2] + owed)
        out[3 + i] = min(out[3 + i], plants[i, 2])
    out[0] = min(out[0], plants[0, 2] + plants[1, 2])


def measured(rig: Rig, x: float) -> float:
    """Returns a position as an encoder reports it."""
    return round(x / rig.encoder) * rig.encoder if rig.encoder > 0.0 else x


def lateness(random: Any, way: Way) -> float:
    """Returns how late a packet arrives [s]."""
    if way.jitter > 0.0:
        return way.delay - way.jitter * math.log(1.0 - random.random())
    return way.delay


def post(random: Any, way: Way, box: Any, full: Any, to: int, now: float, state: Any, packet: Any) -> None:
    """Puts one copy of a packet on its way to one end; `packet` has number, position, speed, sent and the level."""
    if full[to] >= len(box):
        return
    row = box[full[to]]
    row[0], row[1], row[2], row[3], row[4] = now + lateness(random, way), packet[0], packet[1], packet[2], packet[3]
    row[5] = state.request
    row[6] = 1.0 if state.blend > 0.0 or certain(state) >= 0.4 * packet[4] else 0.0
    full[to] += 1


def next_due(due: Any, rigs: Any, random: Any) -> tuple[int, float]:
    """Returns the side whose SYNC is next, and its time; plans the SYNC after it."""
    s = 0 if due[0] <= due[1] else 1
    now, rig = due[s], rigs[0] if s == 0 else rigs[1]
    due[s] = now + rig.time * (1.0 + rig.jitter * (2.0 * random.random() - 1.0))
    return s, now


def torque_of(s: int, settings: Any, states: Any, first: Any, second: Any, position: float, applied: float) -> float:
    """Returns the next torque of one side's port."""
    if s == 0:
        balance = step(0.0, Run(settings[0], states[0], first), position, applied)
    else:
        balance = step(0.0, Run(settings[1], states[1], second), position, applied)
    return balance.torque  # type: ignore[no-any-return]


def run_pair(
    settings: Any, states: Any, rest: Any, first: Any, second: Any, rigs: Any, ways: Any, random: Any, length: float,
    mutant: int, out: Any, boxes: Any, plants: Any, room: Any, full: Any,
) -> None:  # fmt: skip
    """Runs one pair; `out` gets least of both, least of each side with S and R, least alone, torques and totals."""
    due, acting, waiting, newest, number, seen, bad = room[0], room[1], room[2], room[3], room[4], room[5], room[6]
    now, restart, packet = 0.0, 0.5 * length, room[7:].reshape(-1)
    seen[0] = seen[1] = -1.0
    due[1] = 0.37 * rigs[1].time
    while now < length:
        s, begins = next_due(due, rigs, random)
        move_all(rigs, states, plants, acting, now, begins, out)
        now, rig = begins, rigs[0] if s == 0 else rigs[1]
        if mutant == 11 and s == 1 and now > restart:
            restart = 1e9
            states[1] = rest[1]
            states[1].phase = 1
        state, position = states[s], measured(rig, plants[s, 0])
        full[s], seen[s] = take_packets(state, boxes[s], full[s], seen[s], now, mutant)
        applied, before = newest[s] if mutant == 7 else acting[s], state.sent
        torque = torque_of(s, settings, states, first, second, position, applied)
        out[5] = max(out[5], abs(torque))
        acting[s], waiting[s], newest[s] = (waiting[s] if rig.delay > 0 else torque), torque, torque
        way = ways[0] if s == 0 else ways[1]
        copies, is_bad = copies_of(random, way, now, bad[s] > 0.0)
        bad[s] = 1.0 if is_bad else 0.0
        packet[0], packet[1], packet[2], packet[4] = number[s], position, plants[s, 1], settings[s].level
        packet[3] = state.sent - (before if mutant == 1 else 0.0)
        for _ in range(copies):
            to = s if mutant == 10 and random.random() < 0.5 else 1 - s
            post(random, way, boxes[to], full, to, now, state, packet)
        number[s] += 1.0
    out[6], out[7] = states[0].sent * _PICO, states[1].sent * _PICO
    out[8] = max(states[0].blend, states[1].blend)


@cache
def _runner() -> Callable[..., None]:
    instead: dict[object, object] = {
        step: far_port.FarPort.kernel.step,
        far_port.needed: needed,
        far_port.certain: certain,
        far_port.deduct: deduct,
    }
    made: Callable[..., None] = compiled(run_pair, instead, keep=True)
    return made


def new_memory(settings: Any) -> Any:
    """Returns the memory of a port, at rest."""
    return memory_of(settings, lambda length: cast(Buffer, np.zeros(length)))


def drawn_rig(random: np.random.Generator) -> Rig:
    """Returns a random plant with its hand and its wall."""
    has_wall = random.random() < 0.6
    return Rig(
        time=float((1.0 + random.uniform(-1e-4, 1e-4)) / random.choice([250.0, 500.0, 1000.0, 2000.0, 4000.0])),
        jitter=float(random.choice([0.0, 0.0, 0.02, 0.1])), delay=int(random.integers(0, 2)),
        mass=random.uniform(0.1, 1.0), damping=random.uniform(0.0, 1.0),
        friction=float(random.choice([0.0, 0.1, 0.5])), encoder=float(random.choice([1e-7, 1e-6, 1e-5])),
        wall=random.uniform(-0.03, 0.05), wall_stiffness=10.0 ** random.uniform(2.0, 4.0) if has_wall else 0.0,
        wall_damping=random.uniform(0.0, 20.0), wall_most=float(random.choice([20.0, 200.0])),
        hand_stiffness=float(random.choice([0.0, 100.0, 1000.0])), hand_damping=random.uniform(0.0, 10.0),
        hand_most=random.uniform(2.0, 30.0), intent=int(random.integers(1, 4)),
        a1=random.uniform(-0.08, 0.08), w1=random.uniform(0.5, 30.0), a2=random.uniform(-0.08, 0.08),
        w2=random.uniform(2.0, 60.0), phase=random.uniform(0.0, 6.0),
    )  # fmt: skip


def declared(random: np.random.Generator, rig: Rig, coupling: Coupling) -> Any:
    """Returns the settings of a port whose scene says of a rig what is true."""
    strongest = rig.hand_most + (rig.wall_most if rig.wall_stiffness > 0.0 else 0.0)
    loop = LoopProperties(
        sample_time=rig.time, delay=rig.delay, moving_mass=0.9 * rig.mass, device_damping_bound=1.0,
        device_friction_bound=rig.friction, sync_jitter=rig.jitter, encoder_count=rig.encoder, torque_limit=20.0,
    )  # fmt: skip
    far = FarParameters(
        name="link", axis="axis", peer="loopback", coupling=coupling,
        level=10.0 ** random.uniform(-3.0, -0.5), from_far=FromFar(energy=1e3, power=1e4),
    )  # fmt: skip
    return settings_of(far, GuardedParameters(hand_force=strongest, hand_push=strongest), loop)


def drawn_way(random: np.random.Generator) -> Way:
    """Returns a random network in one direction."""
    begin = random.uniform(0.0, 6.0)
    return Way(
        float(random.choice([0.0, 0.005, 0.02, 0.05, 0.15, 0.25])),
        float(random.choice([0.0, 0.002, 0.02, 0.1])),
        float(random.choice([0.0, 0.01, 0.2, 0.5])),
        float(random.choice([1.0, 5.0, 100.0])),
        float(random.choice([0.0, 0.05])),
        begin,
        begin + float(random.choice([0.0, 0.5, 9.0])),
    )


def drawn(random: np.random.Generator) -> tuple[list[Rig], list[Any], list[Way]]:
    """Returns two random rigs, their settings as declared, and the network both ways."""
    rigs: list[Rig] = []
    settings: list[Any] = []
    by_model = bool(random.random() < 0.5)
    stiffness, damping = 10.0 ** random.uniform(2.0, 4.0), random.uniform(0.0, 15.0)
    for _ in range(2):
        rigs.append(drawn_rig(random))
        kind: Literal["spring", "model"] = "model" if by_model and not settings else "spring"
        coupling = Coupling(type=kind, stiffness=stiffness, damping=damping)
        settings.append(declared(random, rigs[-1], coupling))
    return rigs, settings, [drawn_way(random) for _ in range(2)]


def run(seed: int, length: float, mutant: int = 0) -> Any:
    """Returns the figures of one random pair: see `run_pair`."""
    random = np.random.default_rng(seed)
    rigs, settings, ways = drawn(random)
    if mutant == 5:
        settings = [
            replace(one, ahead=replace(one.ahead, response=replace(one.ahead.response, hand=0.0, push=0.0)))
            for one in settings
        ]
    settings = [replace(one, alpha=float(mutant)) for one in settings]
    states = records_of([FarState(), FarState()], plain=True)
    if mutant == 6:
        states["at_rest"] = -6
    out, boxes = np.zeros(9), np.zeros((2, _BOX, 7))
    memories = [new_memory(one) for one in settings]
    _runner()(
        records_of(settings, plain=True), states, states.copy(), *memories, tuple(rigs), tuple(ways), random, length,
        mutant, out, boxes, np.zeros((2, 3)), np.zeros((10, 2)), np.zeros(2, np.int64),
    )  # fmt: skip
    return out


def outcome(seed: int, length: float, mutant: int = 0) -> tuple[float, float, float]:
    """Returns the least energy of a pair with S and R, the least of one side alone [J], and the largest torque."""
    out = run(seed, length, mutant)
    return float(min(out[:3])), float(min(out[3], out[4])), float(out[5])


Attacked = Callable[[int], tuple[float, float, float]]
"""Seed -> least energy as booked, least energy of one side alone [J], largest torque."""


def campaign(attacked: Attacked, seeds: range) -> dict[str, float]:
    """Returns how many of some seeds were false, the least energy [J], and how much crossed."""
    found = np.array([attacked(seed) for seed in seeds])
    false, gave, felt = (found[:, 0] < FALSE).sum(), (found[:, 1] < GIVEN).mean(), (found[:, 2] > 0.0).mean()
    least = min(0.0, float(found[:, 0].min()))
    return {"tried": len(found), "false": int(false), "least": least, "gave": float(gave), "with_torque": float(felt)}


def first_false(attacked: Attacked, seeds: range) -> int | None:
    """Returns after how many seeds one is false; None where none is."""
    return next((tried for tried, seed in enumerate(seeds, 1) if attacked(seed)[0] < FALSE), None)


def attack(about: str | None, attacked: Callable[..., tuple[float, float, float]], mutants: Mapping[str, int]) -> None:
    """Attacks as the command line says, and prints what was found.

    Args:
        about: What `--help` says.
        attacked: As `outcome`.
        mutants: Line of the rule that is wrong -> its number.
    """
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--length", type=float, default=4.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--mutants", action="store_true")
    asked = parser.parse_args()
    seeds = range(asked.seed, asked.seed + asked.runs)
    if not asked.mutants:
        print(json.dumps(campaign(partial(attacked, length=asked.length), seeds)))
    for name, number in mutants.items() if asked.mutants else ():
        found = first_false(partial(attacked, length=asked.length, mutant=number), seeds)
        print(f"{name:<32} {'NOT FOUND' if found is None else f'found after {found} runs'}", flush=True)


if __name__ == "__main__":
    attack(__doc__, outcome, MUTANTS)
