"""Many scenes at once: what a sweep runs, in arrays where the scene allows it and one by one where not.

    reason = why_not_batchable(scene)            # "" or the reason by name
    run_batch(scene, {"environment.stiffness": k, "bus.rate": rates}, cycles=1000, engine="auto")
    run_scalar(scene, cycles=1000)               # the same names, one scene

**One source.** No formula of a controller is written here a second time. The batch form of a loop is made from the
source of the very classes that run on a rig: `lowering` interprets `step` (and `__init__`) of the controller, the
environment, the encoder, the delay and the meter with placeholders in the place of numbers, turns every branch on
data into a selection, and folds every branch on what the scene fixes. Lists whose place data choose become rows, loops
that data end become loops (`rings`). What comes out is one list of elementary operations (`graph`), which is written
out twice: as NumPy calls on chunks of scenes that fit the cache, and as a loop over scenes that numba compiles to
vector instructions. Both do the same IEEE operations in the same order as the scalar class, so that their results are
its results bit for bit, but for the sign of zero (and the sine of `detents`, whose last bit is that of its library);
what the plant adds is stated in `plants`. The scalar classes know nothing of it and cost nothing more.

The other ways were weighed: classes compiled by numba would have to be written for it (no deques, no None, no frozen
models) and gain nothing without it; pure step functions for both would hand the whole state in and out of every scalar
step, and still need a second form of every branch for NumPy.

Worth it from about a hundred scenes on: a cycle costs a few hundred NumPy calls, whoever shares them. Compiling takes
1 to 2 s, some 10 s for `guarded` with a coarse encoder, once for each structure in a process.
"""

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from canhaptic.errors import ParameterError
from canhaptic.scene.models import Scene
from canhaptic.study.batch.cases import batch_case, check_values, why_not_batchable, why_not_beforehand
from canhaptic.study.batch.engine import Engine
from canhaptic.study.batch.marching import march
from canhaptic.study.batch.nodes import NotBatchableError
from canhaptic.study.batch.radius import spectral_radius
from canhaptic.study.batch.scalar import run_scalar
from canhaptic.study.batch.varied import BATCH_KEYS, scene_with
from canhaptic.study.figures import ALL, CONTINUOUS, METRICS
from canhaptic.study.loop import Array

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
]

_DELAY: Final = "loop.delay"


def run_batch(
    scene: Scene,
    varied: Mapping[str, Array],
    cycles: int,
    engine: Engine = "auto",
    metrics: Sequence[str] | None = None,
) -> Mapping[str, Array]:
    """Returns the figures of many scenes, each of shape (n_scenes,); the order of the scenes changes nothing.

    Args:
        scene: What all have in common; `why_not_batchable(scene)` must be "".
        varied: Key of `BATCH_KEYS` -> value of each scene, shape (n_scenes,), in SI.
        cycles: SYNCs, at least 2.
        engine: "numba" needs the extra `fast`; "auto" takes it where it is installed and pays. Both give the same bits.
        metrics: Names of `ALL`; None for `METRICS`. Fewer are faster: what nobody asked for is not computed. Those of
            `CONTINUOUS` march a continuous run beside every loop and are NaN where it has no closed form.

    Raises:
        ParameterError: A key that cannot vary inside a batch, a value out of its range, an unknown metric.
        NotBatchableError: The scene cannot run in arrays.
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
        for name, values in march(case, len(rows), cycles, engine, names).items():
            found[name][rows] = values
    return found
