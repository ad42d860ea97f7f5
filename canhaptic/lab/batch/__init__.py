"""Many scenes at once: the engine of a sweep, compiled where numba is installed and interpreted otherwise.

    reason = why_not_batchable(scene)            # "" or the reason by name
    run_batch(scene, {"environment.stiffness": k, "bus.rate": rates}, cycles=1000, engine="auto")
    run_scalar(scene, cycles=1000)               # the same names, one scene, any plant

**One source.** The kernels of a controller (`canhaptic.kernels`), the plant and the sums of the figures run in one loop
(`closed_loop`): in machine code, or in Python with the same bits (but for the functions of the C library, sine and
exponential, whose last bit is that of its library). A linear plant moves by its flow over a hold (`plants`), one with
events by the stepper of `canhaptic.sim.plant` (`event_plant`). Scenes are computed one after the other, and none
depends on another.

Compiling takes some 10 s once for each algorithm and environment; the machine code is kept (`compiler`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from canhaptic.errors import ParameterError
from canhaptic.lab.batch.cases import (
    NotBatchableError,
    batch_case,
    check_values,
    why_not_batchable,
    why_not_beforehand,
    why_not_compared,
)
from canhaptic.lab.batch.engine import Engine
from canhaptic.lab.batch.marching import march
from canhaptic.lab.batch.radius import spectral_radius
from canhaptic.lab.batch.scalar import run_scalar
from canhaptic.lab.batch.varied import BATCH_KEYS, scene_with
from canhaptic.lab.figures.figures import ALL, CONTINUOUS, METRICS
from canhaptic.lab.loop.axis_loop import Array
from canhaptic.scene.models import Scene

__all__ = [
    "ALL",
    "BATCH_KEYS",
    "CONTINUOUS",
    "METRICS",
    "NotBatchableError",
    "run_batch",
    "run_scalar",
    "scene_with",
    "spectral_radius",
    "why_not_batchable",
    "why_not_compared",
]

_DELAY: Final = "loop.delay"


def run_batch(
    scene: Scene,
    varied: Mapping[str, Array],
    cycles: int,
    engine: Engine = "auto",
    metrics: Sequence[str] | None = None,
    *,
    seeds: Array | None = None,
    stopped: dict[int, str] | None = None,
) -> Mapping[str, Array]:
    """Return the figures of many scenes, each of shape (n_scenes,); the order of the scenes does not matter.

    Args:
        scene: Common part of the scenes; `why_not_batchable(scene)` must be "".
        varied: Key of `BATCH_KEYS` -> value of each scene, shape (n_scenes,), in SI.
        cycles: SYNCs, at least 2.
        engine: "numba" needs the extra `fast`; "auto" takes it where it is installed and worthwhile, else "python".
        metrics: Names of `ALL`; None for `METRICS`. Those of
            `CONTINUOUS` march a continuous run with every loop and are NaN where it has no closed form.
        seeds: Seed of everything random in each scene, shape (n_scenes,); by default that of the scene.
        stopped: Called with the numbers of scenes whose plant could not be advanced, and why; their figures are NaN.

    Raises:
        ParameterError: A key that cannot vary inside a batch, a value out of its range, an unknown metric.
        NotBatchableError: The scene cannot run in a batch.
    """
    names = list(METRICS) if metrics is None else list(metrics)
    unknown = [name for name in names if name not in ALL]
    if unknown or cycles < 2:
        raise ParameterError(f"run_batch: got metrics {unknown} and {cycles} cycles; expected {list(ALL)}, 2 or more")
    arrays = {key: np.asarray(values, dtype=float) for key, values in varied.items()}
    reason = why_not_beforehand(scene)
    if reason:
        raise NotBatchableError(f"{scene.source}: {reason}; run such scenes one by one with run_scalar")
    count = check_values(scene, arrays)
    found = {name: np.empty(count) for name in names}
    delays = arrays.pop(_DELAY, None)
    for delay in [None] if delays is None else sorted({*delays.tolist()}):
        rows = np.arange(count) if delays is None else np.flatnonzero(delays == delay)
        of_delay = scene if delay is None else scene_with(scene, {_DELAY: delay})
        case = batch_case(of_delay, {key: np.ascontiguousarray(values[rows]) for key, values in arrays.items()})
        if seeds is not None:
            case = replace(case, numbers={**case.numbers, "seed": seeds[rows].astype(float)})
        ended: dict[int, str] = {}
        for name, values in march(case, len(rows), cycles, engine, names, ended).items():
            found[name][rows] = values
        if stopped is not None:
            stopped |= {int(rows[row]): reason for row, reason in ended.items()}
    return found
