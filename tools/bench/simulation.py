"""What does the simulated plant cost, and what does it get wrong, against other simulators on the same plant?

The easy scene is a servo with a hand (four states, 1 kHz) that is given a new torque every millisecond; the stiff one
has a stop and a grip of 1e6 N/m and a current loop of 50 us. Each simulator runs in the loop that its user would write
in Python. Our time holds the exact energies of motor, hand and bearings too. Peers: `pip install -e .[bench]`.
"""

import math
import sys
from collections.abc import Callable
from time import perf_counter

import numpy as np

from canhaptic.sim.plant.plant import Plant, PlantParameters
from canhaptic.sim.plant.user import SinusoidMotion, UserParameters
from tools.bench.plants import precision
from tools.bench.plants.effects import effect_rows
from tools.bench.plants.imports import import_rows
from tools.bench.plants.linear_batch import LinearBatch
from tools.bench.plants.peers import PEERS, mujoco_rollout, mujoco_stick, peers, state_space
from tools.bench.plants.scenes import (
    KINETIC,
    PERIOD_NS,
    STATIC,
    Array,
    Scene,
    advance,
    easy,
    friction,
    located,
    stiff,
)
from tools.bench.plants.scenes import reference as reference_of
from tools.bench.report import Row, interleave, publish

HOLDS = 1000
REPEATS = 7
NOTES = {
    "MuJoCo": "whole run of one joint in C, called once a period",
    "Drake RK3": "LinearSystem in C++, fixed steps of one period, called once a period",
    "python-control discrete": "its `dynamics` called bare once a period: one NumPy product; "
    "ours books three exact energies besides",
    "Runge-Kutta 4 by hand": "position and velocity alone; ours books three exact energies besides",
}
FASTER = {
    "MuJoCo": 2.5,
    "MuJoCo RK4": 4.0,
    "Drake RK3": 5.0,
    "python-control discrete": 6.0,
    "scipy solve_ivp": 60.0,
    "motulator": 50.0,
    "Runge-Kutta 4 by hand": 2.0,
}
SCENES, CYCLES = 10_000, 1000


def easy_rows() -> list[Row]:
    """Returns time and error of the easy scene and of every peer, called from Python each period."""
    scene = easy(HOLDS)
    plant, torques, results = scene.plant(), scene.torques.tolist(), {}
    runs: dict[str, Callable[[], Array] | None] = {
        "canhaptic": _stepped(plant, torques),
        **peers(scene),
    }

    def timed(name: str, run: Callable[[], Array]) -> Callable[[], None]:
        def once() -> None:
            results[name] = run()

        return once

    present = {name: timed(name, run) for name, run in runs.items() if run is not None}
    times = {name: min(values) / HOLDS * 1e6 for name, values in interleave(present, REPEATS).items()}
    expected, ours = _extended(scene), times["canhaptic"]
    error = {name: _error(got, expected) for name, got in results.items()}
    rows = [
        Row("easy: error of the position", error["canhaptic"], "", target="<= 1e-12", met=error["canhaptic"] <= 1e-12)
    ]
    return [
        *rows,
        *(_peer_row(name, ours, times, error) for name in PEERS),
    ]


def _peer_row(name: str, ours: float, times: dict[str, float], error: dict[str, float]) -> Row:
    target = f">= {FASTER[name]:g}"
    if name not in times:
        return Row("easy: time per period", ours, "us", f"{name}: peer absent", target=target)
    ratio = times[name] / ours
    peer, met = f"{name} (error {error[name]:.1g})", ratio >= FASTER[name]
    return Row("easy: time per period", ours, "us", peer, times[name], ratio, target, met, NOTES.get(name, ""))


def stiff_rows() -> list[Row]:
    """Returns error, worst period and time against LSODA of the stiff scene at 1 ms."""
    scene = stiff(120)
    expected, torques = reference_of(scene), scene.torques.tolist()
    error = _error(advance(scene.plant(), torques), expected)
    rows = [Row("stiff: error of the position", error, "", target="<= 1e-8", met=error <= 1e-8)]
    worst, products = _worst_period(scene.plant(), torques)
    rows.append(Row(f"stiff: worst period, {products} products", worst, "us"))
    plant = scene.plant(event_bits=20)
    tolerance = next(
        r for r in (1e-4, 1e-5, 1e-6, 1e-7, 1e-8) if _error(located(scene, "LSODA", r, r * 1e-3), expected) <= 1e-6
    )
    times = interleave(
        {
            "python": _stepped(plant, torques),
            "LSODA": lambda: located(scene, "LSODA", tolerance, tolerance * 1e-3),
        },
        REPEATS,
    )
    each = {name: min(values) / len(torques) * 1e6 for name, values in times.items()}
    ratio, peer = each["LSODA"] / each["python"], f"LSODA, rtol {tolerance:g}, events located"
    label = f"stiff: per period at error <= 1e-6 (20 event bits: {_error(_stepped(plant, torques)(), expected):.1g})"
    rows.append(Row(label, each["python"], "us", peer, each["LSODA"], ratio, ">= 20", ratio >= 20.0))
    return rows


def _worst_period(plant: Plant, torques: list[float]) -> tuple[float, int]:
    """Returns the longest period [us] and its products; of each period the least time of the repeats counts."""
    least, most = [math.inf] * len(torques), 0
    for _ in range(REPEATS):
        plant.reset()
        plant.begin(0)
        for k, torque in enumerate(torques):
            before, begin = plant.products, perf_counter()
            plant.advance_to((k + 1) * PERIOD_NS, torque)
            least[k] = min(least[k], perf_counter() - begin)
            most = max(most, plant.products - before)
    return max(least) * 1e6, most


def stick_rows() -> list[Row]:
    """Returns the creep under 0.3 N on 0.5 N of static friction for 10 s."""
    effect = {"type": "coulomb_friction", "kinetic": KINETIC, "static": STATIC}
    plant = friction(1)._replace(effects=(effect,), user=UserParameters()).plant()
    creep = float(np.abs(advance(plant, [0.3] * 10_000)).max())
    slowest = 1e-3  # [m/s] width of a tanh in place of sign
    peers_creep = {
        "MuJoCo frictionloss": mujoco_stick(),
        "tanh friction, 1 mm/s": slowest * math.atanh(0.3 / STATIC) * 10.0,
    }
    rows = []
    for name, value in peers_creep.items():
        rows.append(
            Row(
                "stick: creep in 10 s",
                creep,
                "m",
                name if value is not None else f"{name}: peer absent",
                value,
                target="0",
                met=creep == 0.0,
            )
        )
    return rows


def sweep_rows() -> list[Row]:
    """Returns cycles per second of 10^4 linear scenes moved together."""
    rng = np.random.default_rng(1)
    kinds = []
    for mass, frequency in rng.uniform((0.05, 0.5), (1.0, 3.0), (SCENES // 10, 2)).tolist():
        user = UserParameters(stiffness=300, damping=3, motion=SinusoidMotion(amplitude=0.03, frequency=frequency))
        kinds.append(Plant(PlantParameters(mass=mass, damping=0.1), user, [], PERIOD_NS))
    torques = rng.uniform(-2.0, 2.0, (CYCLES, SCENES))
    best, peer, rollout = 0.0, 0.0, mujoco_rollout(easy(HOLDS))
    for _ in range(3):
        batch = LinearBatch(kinds * 10)
        begin = perf_counter()
        for row in torques:
            batch.advance(row)
        best = max(best, SCENES * CYCLES / (perf_counter() - begin) / 1e6)
        peer = max(peer, rollout() / 1e6 if rollout else 0.0)
    name = "MuJoCo rollout, one thread" if rollout else "MuJoCo rollout: peer absent"
    ratio = best / peer if peer else None
    return [
        Row("sweep: 10^4 scenes x 1000 cycles", best, "M cycles/s", target=">= 30", met=best >= 30.0),
        Row(
            "sweep: 10^4 scenes x 1000 cycles",
            best,
            "M cycles/s",
            name,
            peer or None,
            ratio,
            ">= 50",
            ratio >= 50.0 if ratio else None,
        ),
    ]


def _stepped(plant: Plant, torques: list[float]) -> Callable[[], Array]:
    """Returns a run from the start, each period called from Python; it reads the energies, which are booked by then."""

    def run() -> Array:
        plant.reset()
        positions = advance(plant, torques)
        plant.energy()
        return positions

    return run


def _error(got: Array, expected: Array) -> float:
    return float(np.abs(got - expected).max() / np.abs(expected).max())


def _extended(scene: Scene) -> Array:
    """Returns the positions of the easy scene from the series of its flow in 80-bit numbers, independent of ours."""
    a, b = (part.astype(np.longdouble) for part in state_space(scene))
    rates = np.zeros((5, 5), dtype=np.longdouble)
    rates[:4, :4], rates[:4, 4:] = a, b
    period = np.longdouble(1) / 1000
    flow, term = np.eye(5, dtype=np.longdouble), np.eye(5, dtype=np.longdouble)
    for order in range(1, 40):
        term = term @ rates * (period / order)
        flow = flow + term
    state, positions = np.array([0, 0, 0, 1, 0], dtype=np.longdouble), []
    for torque in scene.torques:
        state[4] = torque
        state = flow @ state
        positions.append(state[0])
    return np.array(positions, dtype=float)


def main() -> None:
    """Measures every figure and publishes table, JSON and picture."""
    rows = [*easy_rows(), *stiff_rows(), *stick_rows(), *sweep_rows()]
    rows += [*effect_rows(), *import_rows()]
    publish("simulation", rows, ["canhaptic", "numpy", "numba", "scipy", "mujoco", "drake", "control", "motulator"])
    if "--no-picture" not in sys.argv:
        precision.draw(precision.points())


if __name__ == "__main__":
    main()
