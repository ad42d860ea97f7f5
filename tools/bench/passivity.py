"""What is rendered of a wall at each rate, and what does a step of each algorithm cost?

What must hold of passivity is in `passivity_sweep` and in `tests/control`: the identity of every hold, belief and
truth, stiffness at rest, limit cycle, order of the error, the root of eq. 8, and the figures of the paper.
"""

import math
from collections.abc import Iterator

from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.control.passivity import ALGORITHMS
from canhaptic.lab.batch.scalar import render
from canhaptic.lab.figures.figures import figures
from canhaptic.lab.loop.axis_loop import LoopCase, LoopRun, microseconds_per_step
from canhaptic.sim.plant.user import UserParameters
from tools.bench.report import Row, publish
from tools.bench.standard_cases import USER_S, standard_case, standard_reference

RATES = (40.0, 100.0, 500.0, 1000.0, 10_000.0)
LONGEST = 6.0  # of a step [us]


def rendered() -> Iterator[Row]:
    """What is rendered at each rate, k = 1000 and d = 5: stiffness at rest and damping in contact."""
    wall, hand = SpringDamperWall(stiffness=1000.0, damping=5.0), UserParameters(damping=3.0, push=-5.0)
    for delay in (0, 1):
        for rate in RATES:
            cycles = max(200, round(3.0 * rate))
            run = render(standard_case(wall, "guarded", rate, hand, delay=delay), cycles)
            found = figures(wall, run, standard_reference(wall, hand, rate, cycles), 1.0 / rate)
            share = found["stiffness_at_rest.share"]
            label = f"A2 rendered at {rate:g} Hz, delay {delay}"
            yield Row(f"{label}, of 1000 N/m", math.nan if share is None else share, "of asked")
            yield Row(f"{label}, of 5 N*s/m", found["damping_rendered.mean"] / 5.0, "of asked")


def cost() -> Iterator[Row]:
    """A12: one axis at 1 kHz with an encoder; each block of 250 steps at its least of 9 interleaved timings."""
    cases: dict[str, tuple[LoopCase, LoopRun]] = {}
    for algorithm in ALGORITHMS:
        wall = SpringDamperWall(stiffness=1000.0, damping=5.0)
        case = standard_case(wall, algorithm, 1000.0, USER_S, delay=1, declared_damping=0.1, encoder_count=1e-6)
        cases[algorithm] = case, render(case, 4000)
    for algorithm, time in microseconds_per_step(cases, 9).items():
        yield Row(
            f"A12 time of a step, {algorithm}, delay 1", time, "us", target=f"<= {LONGEST:g}", met=time <= LONGEST
        )


def main() -> None:
    """Measures and publishes the table."""
    publish("passivity", [*rendered(), *cost()], ["canhaptic", "numpy", "scipy"])


if __name__ == "__main__":
    main()
