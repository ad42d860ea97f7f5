"""Loops of a batch run by Python, one after the other: where numba is not installed, and to judge compiled ones by."""

from collections.abc import Sequence
from types import FunctionType
from typing import Any

from canhaptic.kernels import Kernel, list_of_zeros
from canhaptic.study.batch.batch_reference import ContinuousModes
from canhaptic.study.batch.closed_loop import run_loop
from canhaptic.study.batch.meter import Meter
from canhaptic.study.batch.reference_kernel import TERMS, ReferenceMemory, ReferenceState
from canhaptic.study.batch.rows import SceneRow
from canhaptic.study.loop import Array


def run_interpreted(
    kernel: Kernel, rows: Sequence[SceneRow], flows: Array, starts: Array, modes: ContinuousModes, cycles: int
) -> tuple[list[Meter], list[ReferenceState]]:
    """Returns the meter of every scene, and what is remembered of its continuous run.

    Args:
        kernel: Of the algorithm.
        rows: The scenes.
        flows: Of the plants, shape (n, states, states + 2), n = 1 where all have the same.
        starts: Of the plants, shape (n, states + 2).
        modes: Of the continuous environments.
        cycles: SYNCs.
    """
    names = {**run_loop.__globals__, "step": kernel.step}
    run = FunctionType(run_loop.__code__, names)
    meters, references = [], []
    for i, row in enumerate(rows):
        meter, reference, memory = Meter(), ReferenceState(), kernel.memory(row.settings, list_of_zeros)
        flow: Any = flows[i % len(flows)].tolist()
        plant = starts[i % len(starts)].tolist()
        moved = [0.0] * (len(plant) - 2)
        run(
            row.environment, row.settings, row.loop, kernel.state(), memory, meter, flow, plant, moved,
            modes.settings[i], reference, reference_memory_of(modes, i), cycles,
        )  # fmt: skip
        meters.append(meter)
        references.append(reference)
    return meters, references


def reference_memory_of(modes: ContinuousModes, row: int) -> ReferenceMemory:
    """Returns the matrices and buffers of one scene as lists."""
    flows, rates, starts = (values[row % len(values)].tolist() for values in modes[1:])
    return ReferenceMemory(flows, rates, starts, list(starts), [[0.0] * len(starts) for _ in range(TERMS)])
