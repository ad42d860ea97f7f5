"""Loops of a batch run by Python, one after the other: where numba is not installed, and to judge compiled ones by."""

from collections.abc import Sequence
from types import FunctionType
from typing import Any

from canhaptic.kernels import Kernel, list_of_zeros
from canhaptic.study.batch.closed_loop import run_loop
from canhaptic.study.batch.meter import Meter
from canhaptic.study.batch.rows import SceneRow
from canhaptic.study.loop import Array


def run_interpreted(
    kernel: Kernel, rows: Sequence[SceneRow], flows: Array, starts: Array, positions: Array, torques: Array, cycles: int
) -> list[Meter]:
    """Returns the meter of every scene.

    Args:
        kernel: Of the algorithm.
        rows: The scenes.
        flows: Of the plants, shape (n, states, states + 2), n = 1 where all have the same.
        starts: Of the plants, shape (n, states + 2).
        positions: In the continuous environment, shape (n_scenes, cycles); of no columns without references [m or rad].
        torques: Of that [N or N*m].
        cycles: SYNCs.
    """
    names = {**run_loop.__globals__, "step": kernel.step}
    run = FunctionType(run_loop.__code__, names)
    meters = []
    for i, row in enumerate(rows):
        meter, memory = Meter(), kernel.memory(row.settings, list_of_zeros)
        flow: Any = flows[i % len(flows)].tolist()
        plant = starts[i % len(starts)].tolist()
        moved = [0.0] * (len(plant) - 2)
        run(
            row.environment, row.settings, row.loop, kernel.state(), memory, meter, flow, plant, moved,
            positions[i].tolist(), torques[i].tolist(), cycles,
        )  # fmt: skip
        meters.append(meter)
    return meters
