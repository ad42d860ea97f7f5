"""Do the signs in the torques of `guarded` accuse a true drive, and how often do they find a false one?

Closed loops of 5 s without a bus, each with the watch that `guarded` has with `hold_dither`: a wall, a hand on a slow
sine with tremor, an encoder in counts, and by chance a shaft to a second mass, backlash in it, LuGre friction, a lag of
the current, lost positions, a drive that saturates. True are drives that act in their hold; then the same loops with
drives that act at once or one SYNC late. `--runs N` true ones from `--seed` on; a loop without 64 signs, as of one that
rests, proves nothing and does not count.
"""

import argparse
import math
import os
from functools import partial
from multiprocessing import Pool
from typing import Final, NamedTuple

import numpy as np
from numba import njit

from canhaptic.control.passivity.hold_dither import HoldWatch
from tools.bench.report import Row, publish
from tools.chance import EXACT, Chance

_WANTED: Final = 5000
_HOLDS: Final = 5000
_PERIOD: Final = 1e-3
_SUBSTEPS: Final = 20
_FALSE: Final = 200  # loops of each kind of false drive


class Loop(NamedTuple):
    """One drawn loop."""

    mass: float
    lag: float
    load: float
    shaft: float
    gap: float
    friction: float  # LuGre, Coulomb [N]
    tremor: float
    resolution: float
    lost: float
    limit: float
    amplitude: float
    stiffness: float
    damping: float
    motion: float


def drawn(seed: int, amplitude: float | None = None) -> Loop:
    """Returns the loop of a seed."""
    chance = Chance(seed, 35)
    generator, decades = chance.generator, partial(chance.decades, digits=EXACT)

    def perhaps(value: float) -> float:
        return value if generator.random() < 0.5 else 0.0

    mass, shaft = decades(0.05, 0.5), perhaps(decades(2e3, 1e6))
    return Loop(
        mass, perhaps(float(generator.uniform(0.0, 1e-3))), decades(0.03, 0.5) if shaft else 0.0, shaft,
        perhaps(decades(1e-6, 1e-4)) if shaft else 0.0, perhaps(decades(0.02, 1.0)), perhaps(decades(0.02, 1.0)),
        decades(1e-7, 1e-5), perhaps(decades(1e-3, 0.05)), decades(0.3, 2.0) if generator.random() < 0.2 else 20.0,
        decades(0.02, 0.3) if amplitude is None else amplitude, decades(100.0, 2000.0), perhaps(decades(0.1, 5.0)),
        decades(0.2, 5.0),
    )  # fmt: skip


@njit
def _advance(state: np.ndarray, loop: Loop, torque: float, begin: float) -> None:
    """Advances position and velocity of motor and load, bristle and torque of the motor, by one hold."""
    step = _PERIOD / _SUBSTEPS
    keeps = math.exp(-step / loop.lag) if loop.lag > 0.0 else 0.0
    for number in range(_SUBSTEPS):
        time = begin + number * step
        x, v, y, w, bristle, drive = state
        drive = torque + (drive - torque) * keeps
        force = drive - 0.1 * v
        if loop.friction > 0.0:
            stiff = 1e4
            curve = loop.friction * (1.0 + 0.3 * math.exp(-((v / 0.02) ** 2)))
            bristle = (bristle + step * v) / (1.0 + step * stiff * abs(v) / curve)
            force -= stiff * bristle
        at, speed = (y, w) if loop.shaft > 0.0 else (x, v)
        hand = 300.0 * (0.01 * math.sin(2.0 * math.pi * loop.motion * time) - 0.008 - at) - 5.0 * speed
        hand += loop.tremor * math.sin(2.0 * math.pi * 9.3 * time)
        if loop.shaft > 0.0:
            wound = x - y
            wound = math.copysign(max(0.0, abs(wound) - loop.gap / 2.0), wound)
            between = loop.shaft * wound + (2.0 * (v - w) if wound != 0.0 else 0.0)
            w += step * (between + hand) / loop.load
            y += step * w
            force -= between
        else:
            force += hand
        v += step * force / loop.mass
        x += step * v
        state[:] = (x, v, y, w, bristle, drive)


@njit
def _walk(loop: Loop, shift: int, chance: np.ndarray, lost: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the position and the sign of each hold, for a coin in (0, 1) and a lost position each."""
    holds = len(chance)
    positions, signs, sent, state = np.zeros(holds), np.zeros(holds, np.int64), np.zeros(holds + 2), np.zeros(6)
    state[0] = state[2] = 1e-3 * chance[0]
    before = 0.0
    for hold in range(holds):
        position = round(state[0] / loop.resolution) * loop.resolution
        torque = 0.0
        if lost[hold]:
            torque = sent[hold + 1]
        elif position < 0.0:
            torque = max(0.0, -loop.stiffness * position - loop.damping * (position - before) / _PERIOD)
            if torque >= 2.0 * loop.amplitude:
                signs[hold] = 1 if chance[hold] < 0.5 else -1
                torque -= loop.amplitude * (1.0 - signs[hold])
        before = position
        positions[hold] = position
        sent[hold + 2] = min(torque, loop.limit)
        _advance(state, loop, sent[hold + 1 - shift], (hold + 1000.0 * chance[1]) * _PERIOD)
    return positions, signs


def found_in(seed: int, shift: int = 0, amplitude: float | None = None) -> str | None:
    """Returns what the signs say of a loop whose drive acts by `shift` SYNCs after its hold; None without a look."""
    loop, chance = drawn(seed, amplitude), np.random.default_rng([seed, 36])
    lost = chance.random(_HOLDS) < loop.lost
    positions, signs = _walk(loop, shift, chance.random(_HOLDS), lost)
    watch, was_lost = HoldWatch(1, tells_late=loop.lag <= 0.25 * _PERIOD), False
    for position, sign, is_lost in zip(positions.tolist(), signs.tolist(), lost.tolist(), strict=True):
        if is_lost:
            was_lost = True
            continue
        if was_lost:
            watch.begin_anew()
        was_lost = False
        watch.take(position, sign)
    return watch.found if watch.looks else None


def _true(seed: int) -> str | None:
    return found_in(seed)


def main() -> None:
    """Runs, prints, publishes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=2 * _WANTED)
    parser.add_argument("--seed", type=int, default=0, help="the first one")
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    arguments = parser.parse_args()
    seeds, rows = range(arguments.seed, arguments.seed + arguments.runs), []
    with Pool(arguments.jobs) as pool:
        said = pool.map(_true, seeds, 16)
        asked, alarms = (
            sum(one is not None for one in said),
            [seed for seed, one in zip(seeds, said, strict=True) if one],
        )
        rows.append(Row("true loops", asked, "1", target=">= 5000", met=asked >= _WANTED))
        rows.append(Row("false alarms", len(alarms), "1", target="0", met=not alarms))
        for amplitude in (0.02, 0.1, 0.3):
            for shift, name in ((-1, "at once"), (1, "a SYNC late")):
                tries = [(seed, shift, amplitude) for seed in range(_FALSE)]
                found = [one for one in pool.starmap(found_in, tries, 16) if one is not None]
                rows.append(Row(f"found, {name}, {amplitude:g} N", sum(map(bool, found)) / len(found), "1"))
    print("false alarms:", alarms)
    publish("hold_signs", rows, ("canhaptic", "numpy"))


if __name__ == "__main__":
    main()
