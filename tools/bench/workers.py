"""How much faster are two workers than one? Interleaved sweeps in pools of one and two processes, both warm.

Warm: every worker has made the batch of the scene before the clock runs, as in a sweep of many chunks. Needs two idle
cores to say anything: it waits for them some minutes; a load of the machine that stays is published with the figure. 16
chunks of some 0.4 s of `guarded` behind an encoder, compiled: what a worker does for a chunk is worth far more than
bringing it there.
"""

import os
import tempfile
from pathlib import Path
from time import perf_counter

from canhaptic.drive.clock import WallClock
from canhaptic.lab.studies.runner import Pool
from canhaptic.lab.studies.sweep import sweep
from canhaptic.scene.load import load_scene
from tools.bench.demo import CONFIG
from tools.bench.report import Row, publish

TARGET = 1.8
ROUNDS = 3
CHUNK = 2500
VARY = ["environment.stiffness=1e2:1e5:log:400", "environment.damping=0:10:100"]
SCENES = 400 * 100
METRICS = ["margin", "least_interaction", "diverged", "stiffness_rendered.share"]
CYCLES = 2000
LOAD = 0.5
"""Mean number of busy processes up to which the machine counts as idle."""
PATIENCE = 240.0
"""Longest time to wait for that [s]."""


def seconds(pool: Pool, out: Path) -> float:
    """Returns the time of one sweep in a warm pool."""
    scene = load_scene(CONFIG, ["environment.position=0.05 m"])
    begin = perf_counter()
    sweep(
        scene, VARY, out, pool, force=True, in_flight=2 * pool.workers,
        controllers=["guarded"], cycles=CYCLES, chunk=CHUNK, metrics=METRICS, engine="numba",
    )  # fmt: skip
    return perf_counter() - begin


def load_at_rest() -> float:
    """Returns the load of the machine once it is idle, or after a while: what ran before still counts for minutes."""
    clock, begin = WallClock(spin_margin=0.0), perf_counter()
    while os.getloadavg()[0] >= LOAD and perf_counter() - begin < PATIENCE:
        clock.wait_until(clock.now() + 1_000_000_000)
    return os.getloadavg()[0]


def main() -> None:
    """Times both pools in turn and publishes the best of each."""
    load = load_at_rest()
    pools = {1: Pool(1), 2: Pool(2)}
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "sweep"
        for pool in pools.values():
            seconds(pool, out)
        times = {workers: float("inf") for workers in pools}
        for _ in range(ROUNDS):
            for workers, pool in pools.items():
                times[workers] = min(times[workers], seconds(pool, out))
    for pool in pools.values():
        pool.shutdown()
    ratio = times[1] / times[2]
    is_idle = load < LOAD
    note = "" if is_idle else f"not judged, no idle machine: load {load:.1f} before the first sweep"
    cycles = SCENES * CYCLES
    rows = [
        Row(
            "two workers over one",
            ratio,
            "",
            target=f">= {TARGET:g}",
            met=ratio >= TARGET if is_idle else None,
            note=note,
        ),
        Row("one worker", cycles / times[1] * 1e-6, "M cycles/s"),
        Row("two workers", cycles / times[2] * 1e-6, "M cycles/s"),
    ]
    publish("workers", rows, ["numpy"])


if __name__ == "__main__":
    main()
