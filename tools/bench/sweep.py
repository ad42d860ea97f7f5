"""How many loops a second does a sweep judge, and does the border it finds for `unprotected` agree with Colgate's?

Every row is a whole loop: servo and hand, encoder, algorithm, delay, and the figures gathered on the way; no trajectory
is kept. Rates are of one core's time, so that other work on the machine counts little. `five figures` are diverged,
least interaction, margin, believed error and peak torque. MuJoCo's rollout moves the same plant under torques given
beforehand and has no controller in it. Peers: `pip install -e .[bench]`.
"""

from collections.abc import Callable
from time import perf_counter, process_time
from typing import Any

import numpy as np

from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.control.environments.two_sided_wall import TwoSidedWall
from canhaptic.lab.batch.cases import BatchCase
from canhaptic.lab.batch.marching import Loops, decay_per_hold, march
from canhaptic.lab.figures.figures import METRICS
from canhaptic.sim.plant.plant import PlantParameters
from canhaptic.sim.plant.user import UserParameters
from tools.bench.plants.peers import mujoco_rollout
from tools.bench.plants.scenes import easy
from tools.bench.report import Row, publish
from tools.bench.standard_cases import PLANT, USER_S, loop_in_arrays, standard_case
from tools.bench.sweep_events import FIVE, event_rows, start_rows

SCENES, CYCLES, RATE, REPEATS = 10_000, 1000, 1000.0, 3
FIGURE = f"{SCENES} scenes x {CYCLES} cycles"
PLAIN, ENCODER = "five figures", "five figures, encoder of 10 um"
WITH_LOSSES = "five figures, encoder of 10 um, one sample late, two losses declared"
ERROR = "five figures and position error"
TARGETS = {
    ("guarded", PLAIN): 10.0,
    ("guarded", ENCODER): 5.0,
    ("guarded", WITH_LOSSES): 5.0,
    ("guarded", ERROR): 10.0,
}
"""[1e6 cycles/s]"""
Array = Any


def stability_map(
    algorithm: str, scenes: int, encoder_count: float = 0.0, *, every_key: bool = False, **named: Any
) -> BatchCase:
    """Returns a map of stiffness over damping, or one in which the plant and the hand differ too."""
    rng = np.random.default_rng(1)
    wall = SpringDamperWall(stiffness=1000.0, damping=5.0)
    case = standard_case(wall, algorithm, RATE, USER_S, encoder_count=encoder_count, **named)
    numbers = {
        "environment.stiffness": 10.0 ** rng.uniform(2.0, 5.0, scenes),
        "environment.damping": 10.0 ** rng.uniform(-1.0, 2.0, scenes),
    }
    varied = {}
    if every_key:
        mass = rng.uniform(0.1, 1.0, scenes)
        numbers["loop.moving_mass"] = mass
        varied = {
            "simulation.plant.mass": mass,
            "simulation.plant.damping": rng.uniform(0.05, 0.5, scenes),
            "simulation.user.stiffness": rng.uniform(100.0, 600.0, scenes),
            "simulation.user.motion.frequency": rng.uniform(0.5, 3.0, scenes),
        }
    return loop_in_arrays(case, PLANT, USER_S, numbers, varied)


def rate_of(case: BatchCase, metrics: tuple[str, ...]) -> float:
    """Returns the cycles per second of one core's time [1e6/s], compiled beforehand: the best of some repeats."""
    march(case, SCENES, 3, "numba", metrics)
    best = 0.0
    for _ in range(REPEATS):
        begin = process_time()
        march(case, SCENES, CYCLES, "numba", metrics)
        best = max(best, SCENES * CYCLES / (process_time() - begin) / 1e6)
    return best


def kinds_of(algorithm: str) -> dict[str, tuple[BatchCase, tuple[str, ...]]]:
    """Returns what is timed of an algorithm: maps, and the figures asked of each."""
    plain = stability_map(algorithm, SCENES)
    found = {
        PLAIN: (plain, FIVE),
        f"all {len(METRICS)} figures": (plain, tuple(METRICS)),
        "five figures, plant and hand differ": (stability_map(algorithm, SCENES, every_key=True), FIVE),
        ENCODER: (stability_map(algorithm, SCENES, 1e-5), FIVE),
        ERROR: (plain, (*FIVE, "position_error.rms")),
    }
    if algorithm == "guarded":
        found[WITH_LOSSES] = stability_map(algorithm, SCENES, 1e-5, delay=1, max_consecutive_losses=2), FIVE
    return found


def rate_rows() -> list[Row]:
    """Returns cycles per second of compiled loops, of MuJoCo's rollout and the loops that Python runs."""
    rollout = mujoco_rollout(easy(CYCLES))
    peer = max(_in_core_time(rollout) for _ in range(3)) / 1e6 if rollout else None
    name = "MuJoCo rollout, one thread" if rollout else "MuJoCo rollout: peer absent"
    rows = []
    for algorithm in ("unprotected", "guarded"):
        for kind, (case, metrics) in kinds_of(algorithm).items():
            rate = rate_of(case, metrics)
            target = TARGETS.get((algorithm, kind))
            asked, met = ("", None) if target is None else (f">= {target:g}", rate >= target)
            ratio = rate / peer if peer else None
            label = f"{FIGURE}: {algorithm}, numba, {kind}"
            rows.append(Row(label, rate, "M cycles/s", name, peer, ratio, asked, met))
        few = stability_map(algorithm, 50)
        begin = process_time()
        march(few, 50, CYCLES, "python", FIVE)
        rate = 50 * CYCLES / (process_time() - begin) / 1e6
        rows.append(Row(f"50 scenes x {CYCLES} cycles: {algorithm}, python, {PLAIN}", rate, "M cycles/s", name, peer))
    return rows


def _in_core_time(rollout: Callable[[], float]) -> float:
    """Returns the cycles per second of one core's time that a rollout on one thread makes."""
    begin, used = perf_counter(), process_time()
    rate = rollout()
    return rate * (perf_counter() - begin) / (process_time() - used)


def colgate_rows() -> list[Row]:
    """Returns how far the least device damping that keeps every spring-like hand stable is from k T / 2."""
    period, mass = 1.0 / RATE, 0.25
    hands = mass * (np.linspace(0.02, 0.3, 8) * np.pi / period) ** 2  # rings at 2 % to 30 % of the Nyquist frequency
    shares = np.linspace(0.9, 1.1, 41)
    stiffness, hand, share = (a.ravel() for a in np.meshgrid(np.geomspace(100.0, 2e4, 8), hands, shares, indexing="ij"))
    damping = share * stiffness * period / 2.0
    radii = decay_per_hold(Loops(mass, damping, hand, stiffness, 0.0), period, 0)
    marched = _grows(mass, damping, hand, stiffness)
    rows = []
    for name, stable in (("closed form", radii < 1.0), ("marching", ~marched)):
        border = _border(stable.reshape(8, 8, -1), shares)
        worst = float(np.abs(border - 1.0).max()) * 100.0
        rows.append(
            Row(f"border of unprotected, {name}: worst over 8 stiffnesses", worst, "%", "Colgate, b = k T / 2",
                target="<= 3", met=worst <= 3.0)
        )  # fmt: skip
    agreement = float(np.mean((radii < 1.0) == ~marched)) * 100.0
    rows.append(Row("border of unprotected: closed form and marching agree", agreement, "% of scenes"))
    return [*rows, *_damped_border(mass, period)]


def _border(stable: Array, shares: Array) -> Array:
    """Returns for each stiffness the least share of k T / 2 from which on every hand is stable."""
    for_all = stable.all(axis=1)
    return np.array([shares[np.flatnonzero(~row)[-1] + 1] if not row.all() else shares[0] for row in for_all])


def _grows(mass: float, damping: Array, hand: Array, stiffness: Array) -> Array:
    """Returns whether the travel of a loop in contact all the time still grows after half of a run."""
    wall = TwoSidedWall(stiffness=1.0, lower=0.0, upper=0.0)
    plant = PlantParameters(mass=mass, damping=0.1, initial_position=1e-3)
    user = UserParameters(stiffness=1.0)
    case = standard_case(wall, "unprotected", RATE, user, plant=plant)
    varied = {"simulation.plant.damping": damping, "simulation.user.stiffness": hand}
    arrays = loop_in_arrays(case, plant, user, {"environment.stiffness": stiffness}, varied)
    half, whole = (march(arrays, len(damping), n, "auto", ("travel",))["travel"] for n in (8000, 16000))
    return whole > half


def _damped_border(mass: float, period: float) -> list[Row]:
    """Returns the border where the wall has a damper too: Colgate's condition is for every passive hand."""
    hands = mass * (np.linspace(0.02, 0.999, 400) * np.pi / period) ** 2
    shares = []
    for stiffness, viscosity in ((1000.0, 0.5), (1000.0, 2.0), (10_000.0, 5.0)):
        bound = stiffness * period / 2.0 + viscosity
        least, most = 0.0, 2.0 * bound
        while most - least > 1e-6 * bound:
            middle = 0.5 * (least + most)
            stable = decay_per_hold(Loops(mass, middle, hands, stiffness, viscosity), period, 0).max() < 1.0
            least, most = (least, middle) if stable else (middle, most)
        shares.append(most / bound)
    note = (
        "a passive hand that makes the axis go to and fro at constant speed between two SYNCs reaches the condition; a "
        "spring makes it swing as a sine, for which at most 8 / pi^2 of it is needed: with a damper in the wall the "
        "condition does not apply to such hands but bounds them"
    )
    return [
        Row("border of unprotected with B > 0, hands that are springs: largest share", max(shares), "of k T / 2 + B",
            "Colgate, every passive hand", target="<= 1", met=max(shares) <= 1.0, note=note)
    ]  # fmt: skip


def main() -> None:
    """Measures every figure and publishes table and JSON."""
    makers: tuple[Callable[[], list[Row]], ...] = (
        rate_rows, event_rows, start_rows, colgate_rows
    )  # fmt: skip
    publish("sweep", [row for make in makers for row in make()], ["canhaptic", "numpy", "numba", "mujoco"])


if __name__ == "__main__":
    main()
