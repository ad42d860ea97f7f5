"""Loops of a batch compiled by numba, the controller, the plant and the figures in one; needs the extra `fast`."""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from operator import attrgetter
from typing import Any, Final

import numpy as np
from numba.core.errors import NumbaError
from numpy.typing import NDArray

from canhaptic.control.environments.environment import Environment
from canhaptic.control.environments.plain import tuple_type
from canhaptic.errors import InputError
from canhaptic.kernels import Buffer, Kernel, Matrix, Run
from canhaptic.kernels.compiler import compiled, fixed_tuple
from canhaptic.kernels.records import Records, records_of
from canhaptic.lab.batch.batch_case import NotBatchableError
from canhaptic.lab.batch.batch_reference import ContinuousModes
from canhaptic.lab.batch.closed_loop import (
    MOVED,
    Interruption,
    LinearPlants,
    begin_plant,
    plant_at,
    run_loop,
    states_in,
    step,
)
from canhaptic.lab.batch.event_plants import CALLS, Interrupted, Plants
from canhaptic.lab.batch.meter import Meter
from canhaptic.lab.batch.reference_kernel import TERMS, ReferenceMemory, ReferenceState, length_of
from canhaptic.lab.batch.rows import SceneRow
from canhaptic.lab.loop.axis_loop import Array
from canhaptic.sim.plant.effects.encoder_noise import gaussian, noise, uniform

Numbers = NDArray[np.int64]
_GAMMA: Final = np.uint64(0x9E3779B97F4A7C15)  # as in `encoder_noise`
_WHOLE: Final = 2.0**64

WIDTH = STATES = LENGTH = 0
"""Numbers of an environment, states of a plant and of a continuous run; bound anew for each kind of loop."""


def new_environment(*_numbers: float) -> Environment:
    """Placeholder of the NamedTuple of an environment."""
    raise NotImplementedError


def run_loops(
    table: Array, settings: Records, loops: Records, rest: Records, states: Records, memory: object, zeros: Array,
    meters: Records, plants: LinearPlants, rest_place: Records, places: Records, continuous: Records,
    references: Records, mode_flows: Array, mode_rates: Array, mode_starts: Array, state: Buffer,
    moved_state: Buffer, series: Matrix, outcomes: Numbers, cycles: int,
) -> int:  # fmt: skip
    """Run one loop after the other, from the place in `outcomes`, see `run_loop`; return how many are over.

    An interrupted loop continues at the next call: outcomes = [completed loops, reason of the return, 1 if the next
    loop has begun].
    """
    for i in range(outcomes[0], len(table)):
        environment = new_environment(*fixed_tuple(table[i], WIDTH))
        if outcomes[2] == 0:
            zeros[:] = 0.0
            states[0], places[0] = rest[0], rest_place[0]
            places[0].temperature = loops[i].signals.winding.ambient
            begin_plant(plants, i)
            for place in range(len(state)):
                state[place] = moved_state[place] = mode_starts[i % len(mode_starts), place]
        modes = i % len(mode_flows)
        outcome = run_loop(
            environment, Run(settings[i], states[0], memory), loops[i], meters[i], plant_at(plants, i), places[0],
            continuous[i], references[i],
            ReferenceMemory(mode_flows[modes], mode_rates[modes], state, moved_state, series), cycles,
        )  # fmt: skip
        if outcome != MOVED:
            outcomes[0], outcomes[1], outcomes[2] = i, outcome, 1
            return i
        outcomes[2] = 0
    return len(table)


def known_states(_moved: Buffer) -> int:
    """Replace `states_in`."""
    return STATES


def known_length(_state: Buffer) -> int:
    """Replace `length_of`."""
    return LENGTH


@lru_cache(maxsize=64)
def compiled_loops(
    kind: Any, kernel: Kernel, states: int, length: int, replaced: tuple[tuple[object, object], ...]
) -> Any:
    """Return `run_loops` compiled.

    Args:
        kind: Tuple type of the environment.
        kernel: Kernel of the algorithm.
        states: Number of states of the plant, if it is linear.
        length: Length of the state of the continuous run.
        replaced: Functions of the loop, each with its replacement.
    """
    instead = {
        new_environment: kind, "WIDTH": len(kind._fields), step: kernel.step, states_in: known_states, "STATES": states,
        length_of: known_length, "LENGTH": length, noise: compiled_noise, uniform: compiled_uniform,
        **dict(replaced),
    }  # fmt: skip
    return compiled(run_loops, instead, keep=True, calls=CALLS)


class CompiledLoops:
    """One loop after the other, compiled; see `InterpretedLoops`.

    Raises:
        NotBatchableError: numba cannot compile the environment.
    """

    def __init__(
        self,
        kernel: Kernel,
        rows: Sequence[SceneRow],
        modes: ContinuousModes,
        cycles: int,
        instead: Mapping[object, object],
    ) -> None:
        self._kernel, self._rows, self._modes, self._cycles = kernel, rows, modes, cycles
        self._settings, self._loops = records_of([row.settings for row in rows]), records_of([row.loop for row in rows])
        self._continuous = records_of(modes.settings)
        self._rest, self._place = records_of([kernel.state()]), records_of([Interruption()])
        self.meters: Any = np.repeat(records_of([Meter()]), len(rows))
        self.references = np.repeat(records_of([ReferenceState()]), len(rows))
        self._kind = tuple_type(rows[0].environment)
        numbers = attrgetter(*self._kind._fields)
        self._table = np.array([numbers(row.environment) for row in rows], dtype=float).reshape(len(rows), -1)
        self._instead = tuple(instead.items())
        size = modes.starts.shape[1]
        self._state, self._moved, self._series = np.empty(size), np.empty(size), np.zeros((TERMS, size))

    def run(self, some: Sequence[int], plants: Plants, interrupted: Interrupted) -> None:
        """Run some of the scenes; see `InterpretedLoops.run`."""
        for numbers in _alike(self._kernel, [self._rows[i] for i in some]):
            self._run_alike(np.asarray(some)[numbers], numbers, plants, interrupted)

    def _run_alike(self, some: Numbers, numbers: Numbers, plants: Plants, interrupted: Interrupted) -> None:
        memory, zeros = _memory(self._kernel, self._rows[some[0]].settings)
        meters, references, modes = self.meters[some], self.references[some], self._modes
        states, places, outcomes = self._rest.copy(), self._place.copy(), np.zeros(3, dtype=np.int64)
        linear = 0
        if isinstance(plants, LinearPlants):
            linear = len(plants.moved)
            plants = plants._replace(flows=_of(plants.flows, numbers), starts=_of(plants.starts, numbers))
        fixed = (
            self._table[some], self._settings[some], self._loops[some], self._rest, states, memory, zeros, meters,
        )  # fmt: skip
        compared = (
            self._continuous[some], references, *(_of(values, some) for values in modes[1:]), self._state, self._moved,
            self._series, outcomes, self._cycles,
        )  # fmt: skip
        while True:
            try:
                run = compiled_loops(self._kind, self._kernel, linear, len(self._state), self._instead)
                over = run(*fixed, plants, self._place, places, *compared)
            except (InputError, NumbaError) as error:
                raise NotBatchableError(
                    f"numba cannot compile {self._kind.__name__} under this algorithm: {str(error).splitlines()[-1]}"
                ) from error
            if over == len(some):
                break
            went_on = interrupted(plants, int(some[over]), places[0], int(outcomes[1]))
            if went_on is None:
                outcomes[0], outcomes[2] = over + 1, 0
            else:
                plants = went_on
        self.meters[some], self.references[some] = meters, references


def compiled_noise(deviation: float, seed: int, tick: int) -> float:
    """Replace `encoder_noise.noise`, in 64 bits."""
    base = _mixed(np.uint64(seed) * _GAMMA + np.uint64(tick))
    first, second = _mixed(base + _GAMMA), _mixed(base + _GAMMA + _GAMMA)
    return gaussian(deviation, (np.float64(first) + 1.0) / _WHOLE, np.float64(second) / _WHOLE)


def compiled_uniform(seed: int, tick: int) -> float:
    """Replace `encoder_noise.uniform`, in 64 bits."""
    return np.float64(_mixed(_mixed(np.uint64(seed) * _GAMMA + np.uint64(tick)) + _GAMMA)) / _WHOLE


def _mixed(value: np.uint64) -> np.uint64:
    value = (value ^ (value >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    value = (value ^ (value >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return value ^ (value >> np.uint64(31))


def _of(values: Array, some: Numbers) -> Array:
    """Part of some scenes; all of it where they share it."""
    return values if len(values) == 1 else values[some]


def _alike(kernel: Kernel, rows: Sequence[SceneRow]) -> list[Numbers]:
    """Return the numbers of the rows whose buffers have the same lengths, together."""
    lengths: dict[int, tuple[int, ...]] = {}
    found: dict[tuple[int, ...], list[int]] = {}
    for i, row in enumerate(rows):
        settings = row.settings
        if id(settings) not in lengths:
            lengths[id(settings)] = _lengths(kernel, settings)
        found.setdefault(lengths[id(settings)], []).append(i)
    return [np.array(some) for some in found.values()]


def _lengths(kernel: Kernel, settings: object) -> tuple[int, ...]:
    asked: list[int] = []

    def make_buffer(length: int) -> Buffer:
        asked.append(length)
        return []

    kernel.memory(settings, make_buffer)
    return tuple(asked)


def _memory(kernel: Kernel, settings: object) -> tuple[object, Array]:
    """Return the buffers of an algorithm, and the one array in which all of them lie."""
    whole, used = np.zeros(sum(_lengths(kernel, settings))), 0

    def make_buffer(length: int) -> Array:
        nonlocal used
        used += length
        return whole[used - length : used]

    return kernel.memory(settings, make_buffer), whole
