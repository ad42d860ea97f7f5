"""Loops of a batch compiled by numba, the controller, the plant and the figures in one; needs the extra `fast`."""

from collections.abc import Sequence
from functools import lru_cache
from operator import attrgetter
from typing import Any

import numpy as np
from numba.core.errors import NumbaError

from canhaptic.control.environments.plain import tuple_type
from canhaptic.kernels import Buffer, Kernel
from canhaptic.kernels.compiler import compiled, fixed_tuple
from canhaptic.kernels.records import Records, records_of
from canhaptic.study.batch.batch_case import NotBatchableError
from canhaptic.study.batch.batch_reference import ContinuousModes
from canhaptic.study.batch.closed_loop import run_loop, states_in, step
from canhaptic.study.batch.meter import Meter
from canhaptic.study.batch.reference_kernel import TERMS, ReferenceMemory, ReferenceState, length_of
from canhaptic.study.batch.rows import SceneRow
from canhaptic.study.loop import Array

WIDTH = STATES = LENGTH = 0
"""Numbers of an environment, states of a plant and of a continuous run; bound anew for each kind of loop."""


def new_environment(*_numbers: float) -> Any:
    """Stands for the NamedTuple of an environment."""
    raise NotImplementedError


def run_loops(
    table: Array, settings: Records, loops: Records, rest: Records, states: Records, memory: Any, zeros: Array,
    meters: Records, flows: Array, starts: Array, plant: Any, moved: Any, continuous: Records, references: Records,
    mode_flows: Array, mode_rates: Array, mode_starts: Array, state: Any, moved_state: Any, series: Any, cycles: int,
) -> None:  # fmt: skip
    """Runs one loop after the other; see `run_loop`."""
    for i in range(len(table)):
        environment = new_environment(*fixed_tuple(table[i], WIDTH))
        zeros[:] = 0.0
        states[0] = rest[0]
        for place in range(len(plant)):
            plant[place] = starts[i % len(starts), place]
        for place in range(len(state)):
            state[place] = moved_state[place] = mode_starts[i % len(mode_starts), place]
        modes = i % len(mode_flows)
        run_loop(
            environment, settings[i], loops[i], states[0], memory, meters[i], flows[i % len(flows)], plant, moved,
            continuous[i], references[i],
            ReferenceMemory(mode_flows[modes], mode_rates[modes], state, moved_state, series), cycles,
        )  # fmt: skip


def known_states(_moved: Buffer) -> int:
    """Takes the place of `states_in`."""
    return STATES


def known_length(_state: Buffer) -> int:
    """Takes the place of `length_of`."""
    return LENGTH


@lru_cache(maxsize=64)
def compiled_loops(kind: Any, kernel: Kernel, states: int, length: int) -> Any:
    """Returns `run_loops` compiled.

    Args:
        kind: Tuple type of the environment.
        kernel: Of the algorithm.
        states: Of the plant.
        length: Of the state of the continuous run.
    """
    instead = {
        new_environment: kind, "WIDTH": len(kind._fields), step: kernel.step, states_in: known_states, "STATES": states,
        length_of: known_length, "LENGTH": length,
    }  # fmt: skip
    return compiled(run_loops, instead, keep=True)


def run_compiled(
    kernel: Kernel, rows: Sequence[SceneRow], flows: Array, starts: Array, modes: ContinuousModes, cycles: int
) -> tuple[Records, Records]:
    """Returns meters and references as records; see `run_interpreted` for the arguments."""
    settings, loops = records_of([row.settings for row in rows]), records_of([row.loop for row in rows])
    rest, states, continuous = records_of([kernel.state()]), records_of([kernel.state()]), records_of(modes.settings)
    meters, references = (np.repeat(records_of([kind()]), len(rows)) for kind in (Meter, ReferenceState))
    kind = tuple_type(rows[0].environment)
    numbers = attrgetter(*kind._fields)
    table = np.array([numbers(row.environment) for row in rows], dtype=float).reshape(len(rows), -1)
    plant, moved = np.empty(starts.shape[1]), np.empty(starts.shape[1] - 2)
    size = modes.starts.shape[1]
    state, moved_state, series = np.empty(size), np.empty(size), np.zeros((TERMS, size))
    run = compiled_loops(kind, kernel, len(moved), size)
    for some in _alike(kernel, rows):
        memory, zeros = _memory(kernel, rows[some[0]].settings)
        part, compared = meters[some], references[some]
        try:
            run(
                table[some], settings[some], loops[some], rest, states, memory, zeros, part, _of(flows, some),
                _of(starts, some), plant, moved, continuous[some], compared, _of(modes.flows, some),
                _of(modes.rates, some), _of(modes.starts, some), state, moved_state, series, cycles,
            )  # fmt: skip
        except NumbaError as error:
            raise NotBatchableError(
                f"numba cannot compile {kind.__name__} under this algorithm: {str(error).splitlines()[-1]}"
            ) from error
        meters[some], references[some] = part, compared
    return meters, references


def _of(values: Array, some: Any) -> Array:
    """Returns what belongs to some scenes; all of it where they share it."""
    return values if len(values) == 1 else values[some]


def _alike(kernel: Kernel, rows: Sequence[SceneRow]) -> list[Any]:
    """Returns the numbers of the rows whose buffers have the same lengths, together."""
    lengths: dict[int, tuple[int, ...]] = {}
    found: dict[tuple[int, ...], list[int]] = {}
    for i, row in enumerate(rows):
        settings = row.settings
        if id(settings) not in lengths:
            lengths[id(settings)] = _lengths(kernel, settings)
        found.setdefault(lengths[id(settings)], []).append(i)
    return [np.array(some) for some in found.values()]


def _lengths(kernel: Kernel, settings: Any) -> tuple[int, ...]:
    asked: list[int] = []

    def make_buffer(length: int) -> Buffer:
        asked.append(length)
        return []

    kernel.memory(settings, make_buffer)
    return tuple(asked)


def _memory(kernel: Kernel, settings: Any) -> tuple[Any, Array]:
    """Returns the buffers of an algorithm, and the one array in which all of them lie."""
    whole, used = np.zeros(sum(_lengths(kernel, settings))), 0

    def make_buffer(length: int) -> Any:
        nonlocal used
        used += length
        return whole[used - length : used]

    return kernel.memory(settings, make_buffer), whole
