"""Many scenes at once: what a sweep runs, in arrays where the scene allows it and one by one where not.

    reason = why_not_batchable(scene)            # "" or the reason by name
    run_batch(scene, {"environment.stiffness": k, "bus.rate": rates}, cycles=1000, engine="auto")
    run_scalar(scene, cycles=1000)               # the same names, one scene

**One source.** No formula of a controller is written here a second time. The batch form of a loop is made from the
source of the very classes that run on a rig: `lowering` interprets `step` (and `__init__`) of the controller, the
environment, the encoder, the delay and the meter with placeholders in the place of numbers, turns every branch on
data into a selection, and folds every branch on what the scene fixes. What comes out is one list of elementary
operations (`graph`), which is written out twice: as NumPy calls on chunks of scenes that fit the cache, and as a loop
over scenes that numba compiles to vector instructions. Both do the same IEEE operations in the same order as the
scalar class, so that their results are its results bit for bit, but for the sign of zero; what the plant adds is
stated in `plants`. The scalar classes know nothing of it and cost nothing more.
"""

from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np

from canhaptic.scene.models import Scene
from canhaptic.study.batch.meter import METRICS
from canhaptic.study.batch.scalar import run_scalar
from canhaptic.study.batch.varied import BATCH_KEYS, scene_with
from canhaptic.study.loop import Array

__all__ = ["BATCH_KEYS", "METRICS", "run_batch", "run_scalar", "scene_with", "spectral_radius", "why_not_batchable"]

Engine = Literal["numpy", "numba", "auto"]


def why_not_batchable(scene: Scene) -> str:
    """Returns "" when the whole loop of a scene can run in arrays, else the reason by name.

    "effect coulomb_friction has events", "scene has 2 axes, expected one", ...

    Args:
        scene: Validated; none of its values matters, only what it names.
    """
    return "the batch form of this loop is not built"


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
        cycles: SYNCs.
        engine: "numba" needs the extra `fast`; "auto" takes it where it is installed.
        metrics: Names of `METRICS`; None for all. Fewer are faster: what nobody asked for is not computed.

    Raises:
        ParameterError: A key that cannot vary inside a batch, a value out of its range, a scene that is not batchable.
    """
    count = {len(values) for values in varied.values()}
    [number] = count
    rows = [
        run_scalar(scene_with(scene, {key: float(values[i]) for key, values in varied.items()}), cycles)
        for i in range(number)
    ]
    return {name: np.array([row[name] for row in rows]) for name in metrics or METRICS}


def spectral_radius(scene: Scene, varied: Mapping[str, Array]) -> Array:
    """Returns the largest |eigenvalue| of one hold of each linear sampled loop, shape (n_scenes,): stable below 1.

    The loop is closed by the environment as if it were touched all the time (a wall: of both sides), rendered by
    `direct` with the velocity of the last hold, at the delay of the scene, without encoder steps and torque limits.

    Args:
        scene: With a linear plant and hand, an environment with a linear stiffness, and one axis.
        varied: As for `run_batch`.

    Raises:
        ParameterError: The scene has no linear loop, or a key cannot vary.
    """
    raise NotImplementedError
