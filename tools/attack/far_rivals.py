"""Other couplings of two rigs over a network, each tuned by its paper, on the plants of `tools.attack.far`.

    python -m tools.attack.far_rivals

- gains: springs between the positions, with the damping that the delay asks for (Nuno et al. 2008).
- TDPA: time-domain passivity of both channels with drift compensation (Ryu, Artigas, Preusche 2010; Chawda 2014).
- waves: wave variables that send integral and energy of the wave (Niemeyer, Slotine 2004).
- two-layer: tanks that send quanta of energy, and a controller of their level (Franken et al. 2011).
- plain gains: the springs without that damping.

All of them book the held torque times the measured displacement. A handle is moved against a stop behind the network.
"""

import math
from functools import cache
from typing import Any, Final

import numpy as np

from canhaptic.kernels.compiler import compiled
from tools.attack.far import Rig, Way, advance, copies_of, lateness, measured, next_due

NAMES: Final = ("gains", "TDPA", "waves", "two-layer", "plain gains")
CELLS: Final = ((0.0, 0.0), (10.0, 5.0), (40.0, 0.0), (40.0, 20.0), (100.0, 0.0), (300.0, 0.0), (300.0, 20.0))
"""Round trips [ms] and losses [%] of the table."""
_BOX: Final = 4096
_MASS, _TIME, _WALL = 0.25, 1e-3, 0.03
_MOST_DAMPING: Final = 0.3 * _MASS / _TIME  # that a sampled damper one SYNC late renders without swinging [N*s/m]
_LIMIT: Final = 20.0
_LEVEL: Final = 0.06


def gains(s: int, at: Any, got: Any, q: float, v: float, k: float, d: float, trip: float) -> float:
    """Returns the torque of a spring and a damper to the far position, with damping of k times half the round trip."""
    stiffness = min(k, 2.0 * _MOST_DAMPING / trip) if trip > 0.0 else k
    return float(-stiffness * (q - got[1]) - d * (v - got[2]) - 0.5 * stiffness * trip * v)


def tdpa(s: int, at: Any, got: Any, q: float, v: float, k: float, d: float, trip: float) -> float:
    """Returns the torque of a side; `at` holds what came in and out of its port, and the slave's reference."""
    if s == 0:
        f, work = -got[3], -at[1] * at[2]
        at[4], at[5] = at[4] + max(0.0, work), at[5] + max(0.0, -work)
        short = got[4] - at[5]
        if short < 0.0 and abs(v) > 1e-4:
            f -= min(-short / (v * v * _TIME), _MOST_DAMPING) * v
        return float(f)
    speed = got[2]
    f = k * (at[3] - q) + d * (speed - v)
    power = f * speed * _TIME
    at[4], at[5] = at[4] + max(0.0, -power), at[5] + max(0.0, power)
    spare = got[4] - at[5]
    if spare < 0.0 and abs(f) > 1e-3:
        speed, at[5] = speed + spare / (f * _TIME), got[4]
    back = 0.1 * (got[1] - at[3]) / _TIME  # drift: as fast as what is left over pays
    if f * back > 0.0:
        back = math.copysign(min(abs(back), max(0.0, spare) / (abs(f) * _TIME)), back)
        at[5] += f * back * _TIME
    at[3] += (speed + back) * _TIME
    return float(f)


def waves(s: int, at: Any, got: Any, q: float, v: float, k: float, d: float, trip: float) -> float:
    """Returns the torque of a side; `at` holds integral and energy of the waves that were used, and that were sent."""
    b = math.sqrt(k * _MASS)
    wave = (got[5] - at[6]) / (5.0 * _TIME)
    most = math.sqrt(max(0.0, 2.0 * (got[4] - at[7]) / _TIME))
    wave = math.copysign(min(abs(wave), most), wave)
    at[6], at[7] = at[6] + wave * _TIME, at[7] + 0.5 * wave * wave * _TIME
    if s == 0:
        f, out = -(b * v - math.sqrt(2.0 * b) * wave), math.sqrt(2.0 * b) * v - wave
    else:
        f = 0.5 * (k * (at[3] - q) + b * (math.sqrt(2.0 / b) * wave - v))  # the damper is matched to the wave
        at[3] += _TIME * (math.sqrt(2.0 * b) * wave - f) / b
        out = wave - math.sqrt(2.0 / b) * f
    at[8], at[4] = at[8] + out * _TIME, at[4] + 0.5 * out * out * _TIME
    return f


def two_layer(s: int, at: Any, got: Any, q: float, v: float, k: float, d: float, trip: float) -> float:
    """Returns the torque of a side; `at` holds its tank, and what it sends of it."""
    at[9] += -at[1] * at[2] + got[6]
    got[6], at[8] = 0.0, max(0.0, 0.01 * at[9])
    at[9] -= at[8]
    f = -k * (q - got[1]) - d * (v - got[2])
    if at[9] <= 0.0:
        f = 0.0
    elif f * v > 0.0:
        f = math.copysign(min(abs(f), at[9] / (abs(v) * _TIME)), f)
    if s == 0 and at[9] < _LEVEL:
        f -= min(40.0 * (_LEVEL - at[9]) / _LEVEL, _MOST_DAMPING) * v
    return float(f)


def take(box: Any, count: int, got: Any, now: float) -> int:
    """Takes what has arrived: the newest counts, of energies the largest, of quanta all; returns how many are left."""
    place = 0
    while place < count:
        row = box[place]
        if row[0] > now:
            place += 1
            continue
        if row[1] > got[0]:
            got[0], got[1], got[2], got[3], got[5] = row[1], row[2], row[3], row[4], row[6]
        got[4], got[6], count = max(got[4], row[5]), got[6] + row[6], count - 1
        for column in range(7):
            row[column] = box[count, column]
    return count


def torque_of(method: int, s: int, at: Any, got: Any, q: float, v: float, k: float, d: float, trip: float) -> float:
    """Returns the torque of one side by one method, within the limit."""
    if method == 1:
        f = tdpa(s, at, got, q, v, k, d, trip)
    elif method == 2:
        f = waves(s, at, got, q, v, k, d, trip)
    elif method == 3:
        f = two_layer(s, at, got, q, v, k, d, trip)
    else:
        f = gains(s, at, got, q, v, k, d, trip if method == 0 else 0.0)
    return min(max(f, -_LIMIT), _LIMIT)


def run_rival(
    method: int, rigs: Any, way: Way, random: Any, length: float, out: Any, boxes: Any, plants: Any, at: Any, got: Any,
    room: Any, full: Any, log: Any,
) -> None:  # fmt: skip
    """Runs one pair; `out` gets the least energy of both plants, `log` position and acting torque of the first."""
    due, acting, number, bad = room[0], room[1], room[2], room[3]
    k, d, trip, now, row = 1000.0, 8.0, 2.0 * (way.delay + way.jitter), 0.0, 0
    due[1] = 0.37 * rigs[1].time
    got[0, 0] = got[1, 0] = -1.0
    while now < length:
        s, begins = next_due(due, rigs, random)
        for i in range(2):
            advance(rigs[0] if i == 0 else rigs[1], plants[i], acting[i], now, begins)
        now = begins
        out[0] = min(out[0], plants[0, 2] + plants[1, 2])
        q = measured(rigs[0] if s == 0 else rigs[1], plants[s, 0])
        at[s, 2], at[s, 1] = q - at[s, 0], acting[s]  # what the torque that was held has moved
        at[s, 0], v = q, at[s, 2] / _TIME
        full[s] = take(boxes[s], full[s], got[s], now)
        f = torque_of(method, s, at[s], got[s], q, v, k, d, trip)
        acting[s], at[s, 10] = at[s, 10], f  # one SYNC late
        if s == 0 and row < len(log):
            log[row, 0], log[row, 1], row = q, acting[s], row + 1
        copies, is_bad = copies_of(random, way, now, bad[s] > 0.0)
        bad[s], number[s] = (1.0 if is_bad else 0.0), number[s] + 1.0
        for _ in range(copies):
            late = lateness(random, way)
            if full[1 - s] < len(boxes[s]):
                packet = boxes[1 - s, full[1 - s]]
                packet[0], packet[1], packet[2], packet[3], packet[4] = now + late, number[s], q, v, f
                packet[5], packet[6] = at[s, 4], at[s, 8]
                full[1 - s] += 1


@cache
def _runner() -> Any:
    return compiled(run_rival, {}, keep=True)


def figures(method: int, round_trip: float, loss: float) -> tuple[float | None, float, float]:
    """Returns what the hand feels at the last touch [N/m], the drag in free motion [N], and what was given out [J].

    Where the hand does not get to the wall, what it feels there is None.

    Args:
        method: Place in `NAMES`.
        round_trip: Of the network [s].
        loss: Share of packets that are lost, in bursts of 3.
    """
    one = Rig(
        time=_TIME, jitter=0.0, delay=1, mass=_MASS, damping=0.5, friction=0.0, encoder=1e-6, wall=_WALL,
        wall_stiffness=0.0, wall_damping=10.0, wall_most=1e9, hand_stiffness=400.0, hand_damping=6.0, hand_most=1e9,
        intent=1, a1=0.06, w1=math.pi, a2=0.0, w2=0.0, phase=0.0,
    )  # fmt: skip
    other = one._replace(time=_TIME * (1.0 - 1e-4), wall_stiffness=5000.0, hand_stiffness=0.0)
    way = Way(0.5 * round_trip, 0.05 * round_trip, loss, 3.0, 0.0, 1e9, 1e9)
    out, log = np.zeros(1), np.zeros((7000, 2))
    _runner()(
        method, (one, other), way, np.random.default_rng(5), 7.0, out, np.zeros((2, _BOX, 7)), np.zeros((2, 3)),
        np.zeros((2, 11)), np.zeros((2, 7)), np.zeros((4, 2)), np.zeros(2, np.int64), log,
    )  # fmt: skip
    position, torque = log[6000:].T
    pressed, free = position > 0.999 * position.max(), log[3100:3900, 1]
    felt = float(np.mean(-torque[pressed] / (position[pressed] - _WALL))) if position.max() > _WALL else None
    return felt, float(np.sqrt(np.mean(free**2))), 0.0 - float(out[0])


def main() -> None:
    """Prints what each method renders and gives out."""
    for method, name in enumerate(NAMES):
        for trip, loss in CELLS:
            felt, drag, given = figures(method, 1e-3 * trip, 0.01 * loss)
            there = "does not get there" if felt is None else f"felt {felt:.4g} N/m"
            print(f"{name:<10} {trip:4g} ms {loss:3g} % lost  {there}, drag {drag:.3g} N, given out {given:.4g} J")


if __name__ == "__main__":
    main()
