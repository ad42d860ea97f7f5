"""What does an encoder leave of a stiff wall that is pressed to and fro? `python -m tools.bench.encoder`.

A Phantom Premium 1.5 as `configs/published` assumes it (75 g, 0.04 N of dry friction, of which 70 g and all of the
friction are declared, hand force 0), torques at once, `guarded`. The hand, 200 N/m and 3 N*s/m, comes at 0.02 m/s,
presses with about 1.4 N, a tenth more and less once a second, and trembles by 0.1 mm at 9 Hz. Share of the stiffness
asked in the last second of 6, 20 and 60 s, at 1, 2 and 4 kHz, and the least true sum of what came in and friction took.
"""

import argparse
import math
import os
from multiprocessing import Pool
from typing import Final, NamedTuple

from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.control.passivity import LoopProperties
from canhaptic.control.passivity.guarded import Guarded, GuardedParameters
from tools.attack.plant import TAKEN_IN, Rig, V, X, hold
from tools.bench.report import Row, picture_place, publish

MASS, DAMPING, FRICTION, LIMIT = 0.075, 0.01, 0.04, 8.5
RATES: Final = (1000.0, 2000.0, 4000.0)  # [Hz]
COUNTS: Final = (3e-6, 5e-6, 1e-5, 2e-5, 3e-5, 6e-5)  # [m]
WALLS: Final = (2600.0, 4000.0, 10_000.0)  # [N/m]
TIMES: Final = (6, 20, 60)  # [s]
PARTS: Final = 4
GOAL: Final = 0.95


class Case(NamedTuple):
    """One cell."""

    rate: float
    resolution: float  # of the encoder [m]
    stiffness: float


def shares(case: Case) -> tuple[Case, list[float], float]:
    """Returns the share of the wall at each time, and the least sum of energy [J]."""
    rate, count, stiffness = case
    loop = LoopProperties(
        sample_time=1.0 / rate, moving_mass=0.07, device_damping_bound=0.05, device_friction=FRICTION,
        device_friction_bound=0.0, torque_window=0.0, encoder_count=count, torque_limit=LIMIT,
    )  # fmt: skip
    controller = Guarded(SpringDamperWall(stiffness=stiffness, damping=0.0, position=0.0), GuardedParameters(), loop)
    rig, state, torque = Rig(1.0 / rate / PARTS, MASS, DAMPING, FRICTION), [0.0] * 8, 0.0
    state[X], path, least, asked, sent, found = 5e-3, 0.0, 0.0, 0.0, 0.0, []
    for at in range(round(TIMES[-1] * rate)):
        position, time = count * round(state[X] / count), at / rate
        torque = controller.step(position, torque).torque
        asked, sent = asked + min(LIMIT, stiffness * max(0.0, -position)), sent + torque
        goal = -7e-3 + max(0.0, 0.012 - 0.02 * time)
        goal += 7e-4 * math.sin(2.0 * math.pi * time) + 1e-4 * math.sin(18.0 * math.pi * time)
        for _ in range(PARTS):
            before = state[X]
            hold(rig, state, torque, 200.0 * (goal - before) - 3.0 * state[V], rig.sample_time)
            path += abs(state[X] - before)
        least = min(least, state[TAKEN_IN] + FRICTION * path)
        second, is_last = divmod(at + 1, round(rate))
        if is_last == 0:
            if second in TIMES:
                found.append(sent / asked if asked else 0.0)
            asked = sent = 0.0
    return case, found, least


def rows_of(case: Case, found: list[float], least: float) -> list[Row]:
    """Returns the figures of a cell."""
    rate, count, stiffness = case
    name, kept = f"{rate / 1000:g} kHz, {1e6 * count:g} um, {stiffness:g} N/m", FRICTION / count / stiffness
    goal = GOAL * min(1.0, kept)
    rows = [
        Row(f"{name}: after {time} s", share, "1", "f_c / count", min(1.0, kept), target=f">= {goal:.2f}",
            met=share >= goal)
        for time, share in zip(TIMES, found, strict=True)
    ]  # fmt: skip
    return [*rows, Row(f"{name}: least sum", least, "J", target=">= 0", met=least >= -1e-9)]


def draw(found: list[tuple[Case, list[float], float]]) -> None:
    """Draws the stiffness left after the longest time over the count, for each wall."""
    from matplotlib.figure import Figure

    walls = sorted({case.stiffness for case, _, _ in found})
    figure = Figure(figsize=(3.7 * len(walls), 3.8), layout="constrained")
    for plot, stiffness in zip(figure.subplots(1, len(walls), sharey=True, squeeze=False)[0], walls, strict=True):
        for number, rate in enumerate(RATES):
            those = sorted(
                (case.resolution, share[-1])
                for case, share, _ in found
                if case.rate == rate and case.stiffness == stiffness
            )
            plot.plot(
                [1e6 * count for count, _ in those], [1e-3 * stiffness * share for _, share in those],
                marker="osv"[number], ms=9 - 2 * number, ls="none", label=f"{rate / 1000:g} kHz, after 60 s",
            )  # fmt: skip
        line = [1e6 * COUNTS[0] * (COUNTS[-1] / COUNTS[0]) ** (step / 40) for step in range(41)]
        for factor, style in ((1.0, "k--"), (2.0, "k:")):
            kept = [1e-3 * min(stiffness, factor * FRICTION / (1e-6 * count)) for count in line]
            plot.plot(line, kept, style, lw=1, label=f"{'' if factor == 1.0 else '2 '}friction / count")
        plot.set(xscale="log", xlabel="count of the encoder [um]", title=f"{1e-3 * stiffness:g} kN/m asked")
        plot.set_xticks([1e6 * count for count in COUNTS], [f"{1e6 * count:g}" for count in COUNTS], minor=False)
        plot.minorticks_off()
        plot.grid(alpha=0.3)
    figure.axes[0].set_ylabel("stiffness that is left [kN/m]")
    figure.axes[0].set_ylim(bottom=0.0)
    figure.axes[-1].legend(fontsize=8)
    figure.savefig(picture_place("encoder.png"), dpi=120, metadata={"Software": None})


def main() -> None:
    """Runs, tells, draws, publishes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--quick", action="store_true", help="counts of 10 and 30 um, walls of 4 and 10 kN/m")
    arguments = parser.parse_args()
    counts, walls = ((1e-5, 3e-5), WALLS[1:]) if arguments.quick else (COUNTS, WALLS)
    cases = [Case(rate, count, stiffness) for stiffness in walls for count in counts for rate in RATES]
    with Pool(arguments.jobs) as pool:
        found = list(pool.imap(shares, cases))
    draw(found)
    publish("encoder", [row for one in found for row in rows_of(*one)], ("canhaptic", "numpy"))


if __name__ == "__main__":
    main()
