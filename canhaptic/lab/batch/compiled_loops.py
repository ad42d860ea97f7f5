"""Loops compiled by numba, each with its controller, plant and figures; needs the extra `fast`.

For studies that need every SYNC, `keep` writes rows (`compiled_rows`, `rows_together`). A compiled linear plant
adds its products in another order than `Plant`, so that its rows differ from those of `scalar.render` by rounding; use
`render` where the last bit matters.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from operator import attrgetter
from typing import Any, Final, cast

import numpy as np
from numba.core.errors import NumbaError
from numpy.typing import NDArray

from canhaptic.control.balance import EnergyBalance
from canhaptic.control.environments import Environment
from canhaptic.control.multi_axis.group_kernel import GroupModel, GroupMotion, why_not_world
from canhaptic.errors import InputError, ParameterError
from canhaptic.kernels import Buffer, Kernel, Matrix, Run
from canhaptic.kernels.compiler import compiled, fixed_tuple, tuple_type
from canhaptic.kernels.records import Records, arrays_of, record_of, records_of
from canhaptic.lab.batch import cases, closed_loop
from canhaptic.lab.batch.cases import NotBatchableError
from canhaptic.lab.batch.closed_loop import Control, motors_at, run_loop
from canhaptic.lab.batch.continuous_run import TERMS, Continuous, ReferenceMemory, ReferenceState, follow
from canhaptic.lab.batch.network_loop import Explained, NetworkLoop, TrueNetwork
from canhaptic.lab.batch.plants import CALLS, Plants, Stopped, loop_replacements
from canhaptic.lab.figures.meter import Meter, diverge, miss
from canhaptic.lab.loop.axis_loop import Array, LoopCase, Reach
from canhaptic.sim.plant import stepper
from canhaptic.sim.plant.effects.encoder_noise import gaussian, noise, uniform

Numbers = NDArray[np.int64]
_GAMMA: Final = np.uint64(0x9E3779B97F4A7C15)  # as in `encoder_noise`
_WHOLE: Final = 2.0**64

WIDTH = 0
"""Number of parameters of an environment; bound anew for each kind of loop."""


def new_environment(*_numbers: float) -> Environment:
    """Placeholder: the function that makes an environment's NamedTuple."""
    raise NotImplementedError


def own_step(
    environment: Environment, run: closed_loop.AxisRun, position: float, torque_applied: float
) -> EnergyBalance:
    """Placeholder: the step of an algorithm."""
    raise NotImplementedError


def step_with(environment: Any, run: closed_loop.AxisRun, position: float, torque_applied: float) -> EnergyBalance:
    """Replace `step`: pass the environment as plain numbers; its NamedTuple type exists in this process only."""
    return step_of_numbers(environment[0:], run, position, torque_applied)


def step_of_numbers(
    numbers: tuple[float, ...], run: closed_loop.AxisRun, position: float, torque_applied: float
) -> EnergyBalance:
    """Step the algorithm in an environment given by its numbers; the machine code is stored on disk."""
    return own_step(new_environment(*numbers), run, position, torque_applied)


def run_loops(
    table: Array, settings: Records, loops: Any, states: Records, memory: object, zeros: Array, meters: Records,
    plants: closed_loop.LinearPlants, rooms: Records, places: Records, continuous: Records, references: Records,
    mode_flows: Array, mode_rates: Array, mode_states: Any, moved: Buffer, series: Matrix, first: int, cycles: int,
) -> int:  # fmt: skip
    """Run the loops from index `first` on; return the index of a loop whose plant failed, else their number."""
    for i in range(first, len(table)):
        environment = new_environment(*fixed_tuple(table[i], WIDTH))
        zeros[:] = 0.0
        modes = i % len(mode_flows)
        reference = ReferenceMemory(mode_flows[modes], mode_rates[modes], mode_states[i], moved, series)
        if not run_loop(
            Control(environment, Run(settings[i], states[i], memory)), loops[i], motors_at(plants, i),
            rooms[i], places[i], Continuous(continuous[i], references[i], reference), meters[i], cycles,
        ):  # fmt: skip
            return i
    return len(table)


@lru_cache(maxsize=64)
def compiled_loops(kind: Any, kernel: Kernel, replaced: tuple[tuple[object, object], ...]) -> Any:
    """Compile `run_loops` for one algorithm and one kind of environment.

    Args:
        kind: Tuple type of the environment.
        kernel: Kernel of the algorithm.
        replaced: Functions of the loop, each with its replacement.
    """
    instead = {
        new_environment: kind, "WIDTH": len(kind._fields), closed_loop.step: step_with, own_step: kernel.step,
        noise: compiled_noise, uniform: compiled_uniform, **dict(replaced),
    }  # fmt: skip
    return compiled(run_loops, instead, keep=True, calls=CALLS, units=(step_of_numbers, follow, stepper.run))


class CompiledLoops:
    """Runs loops one after the other, compiled; same interface as `InterpretedLoops`.

    Raises:
        NotBatchableError: numba cannot compile the environment.
    """

    def __init__(self, job: cases.LoopJob) -> None:
        kernel, rows, modes, self._cycles, instead = job
        self._kernel, self._rows, self._modes = kernel, rows, modes
        self._settings = records_of([row.settings for row in rows])
        self._loops = records_of([row.loop for row in rows])[:, None]
        self._continuous = records_of(modes.settings)
        self.meters: Any = np.repeat(records_of([Meter()]), len(rows))
        self.references = np.repeat(records_of([ReferenceState()]), len(rows))
        self._kind = tuple_type(rows[0].environment)
        numbers = attrgetter(*self._kind._fields)
        self._table = np.array([numbers(row.environment) for row in rows], dtype=float).reshape(len(rows), -1)
        self._instead = tuple(instead.items())

    def run(self, some: Sequence[int], plants: Plants, stopped: Stopped) -> None:
        """Run some of the scenes; see `InterpretedLoops.run`."""
        for numbers in _alike(self._kernel, [self._rows[i] for i in some]):
            self._run_alike(np.asarray(some)[numbers], numbers, plants, stopped)

    def _run_alike(self, some: Numbers, numbers: Numbers, plants: Plants, stopped: Stopped) -> None:
        memory, zeros = _memory(self._kernel, self._rows[some[0]].settings)
        meters, references, modes = self.meters[some], self.references[some], self._modes
        begun = records_of([self._kernel.state()]), records_of([closed_loop.CycleState()])
        states, places, rooms = (np.repeat(one, len(some)) for one in (*begun, record_of(closed_loop.room_for(1))))
        size = modes.starts.shape[1]
        mode_states = np.array(np.broadcast_to(_of(modes.starts, some), (len(some), size)))
        if isinstance(plants, closed_loop.LinearPlants):
            plants = plants._replace(flows=_of(plants.flows, numbers), starts=_of(plants.starts, numbers))
        given = (
            self._table[some], self._settings[some], self._loops[some], states, memory, zeros, meters, plants, rooms,
            places, self._continuous[some], references, _of(modes.flows, some), _of(modes.rates, some), mode_states,
            np.empty(size), np.empty((TERMS, size)),
        )  # fmt: skip
        first = 0
        while first < len(some):
            try:
                run = compiled_loops(self._kind, self._kernel, self._instead)
                first = run(*given, first, self._cycles)
            except (InputError, NumbaError) as error:
                raise NotBatchableError(
                    f"numba cannot compile {self._kind.__name__} under this algorithm: {str(error).splitlines()[-1]}"
                ) from error
            if first < len(some):
                stopped(plants, int(some[first]), int(places[first]["cycle"]))
            first += 1
        self.meters[some], self.references[some] = meters, references


def compiled_noise(deviation: float, seed: int, tick: int) -> float:
    """Compute `encoder_noise.noise` with 64-bit integers, for machine code."""
    base = _mixed(np.uint64(seed) * _GAMMA + np.uint64(tick))
    first, second = _mixed(base + _GAMMA), _mixed(base + _GAMMA + _GAMMA)
    return gaussian(deviation, (np.float64(first) + 1.0) / _WHOLE, np.float64(second) / _WHOLE)


def compiled_uniform(seed: int, tick: int) -> float:
    """Compute `encoder_noise.uniform` with 64-bit integers, for machine code."""
    return np.float64(_mixed(_mixed(np.uint64(seed) * _GAMMA + np.uint64(tick)) + _GAMMA)) / _WHOLE


def _mixed(value: np.uint64) -> np.uint64:
    value = (value ^ (value >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    value = (value ^ (value >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return value ^ (value >> np.uint64(31))


def _of(values: Array, some: Numbers) -> Array:
    """Return the rows of the given scenes, or the single row that all scenes share."""
    return values if len(values) == 1 else values[some]


def _alike(kernel: Kernel, rows: Sequence[cases.SceneRow]) -> list[Numbers]:
    """Return the indices of the rows, grouped by equal lengths of the algorithm's buffers."""
    lengths: dict[int, tuple[int, ...]] = {}
    found: dict[tuple[int, ...], list[int]] = {}
    for i, row in enumerate(rows):
        if id(row.settings) not in lengths:
            lengths[id(row.settings)] = _lengths(kernel, row.settings)
        found.setdefault(lengths[id(row.settings)], []).append(i)
    return [np.array(some) for some in found.values()]


def _lengths(kernel: Kernel, settings: object) -> tuple[int, ...]:
    asked: list[int] = []

    def make_buffer(length: int) -> Buffer:
        asked.append(length)
        return []

    kernel.memory(settings, make_buffer)
    return tuple(asked)


def _memory(kernel: Kernel, settings: object) -> tuple[object, Array]:
    """Return an algorithm's buffers, and the single array of which they are views."""
    ends = np.cumsum(_lengths(kernel, settings), dtype=np.int64)
    whole = np.zeros(ends[-1] if len(ends) else 0)
    parts = iter(np.split(whole, ends))
    return kernel.memory(settings, lambda _length: next(parts)), whole


def compiled_world(world: GroupModel) -> tuple[Any, Records]:
    """Return a group model without its tables, and the tables as a record, for compiled kernels.

    Raises:
        ParameterError: A part of the model is given as functions in Python.
    """
    if reason := why_not_world(world):
        raise ParameterError(
            f"a compiled group: {reason}, expected mechanisms, geometries and storages that scenes can name"
        )
    bare = GroupModel(arrays_of(world.mechanism), arrays_of(world.geometry), world.mover, 0, world.functions)  # type: ignore[arg-type]
    return bare, record_of(world.tables)


@lru_cache(maxsize=16)
def _compiled_loop(kernel: Kernel, parts: tuple[type, ...], replaced: tuple[tuple[object, object], ...]) -> Any:
    """Return `run_loop` for an algorithm of several motors; numba compiles it once for each number of them."""
    instead = {noise: compiled_noise, uniform: compiled_uniform, **dict(replaced)}
    return compiled(run_loop, instead, keep=True, parts=parts, units=(kernel.step, stepper.run))


def run_compiled(loop: NetworkLoop, cycles: int, sums: Any, meter: Any, instead: Mapping[object, object]) -> bool:
    """Run the compiled loop of a network; return False if its motors cannot be moved any further.

    Args:
        loop: Loop that can be compiled.
        cycles: Number of SYNCs.
        sums: Record of the sums of the shares.
        meter: What `take_sync` fills.
        instead: Function of the loop -> its replacement.
    """
    bare, tables = compiled_world(loop.world)
    world, parts = bare._replace(tables=tables[0]), (type(bare.mechanism), type(bare.geometry), type(bare.functions))
    buffers = loop.settings, loop.kernel.memory(loop.world, loop.settings), closed_loop.room_for(len(loop.loops))
    settings, memory, room = (record_of(one)[0] for one in buffers)
    state, place, motion = (
        records_of([one])[0] for one in (loop.kernel.state(), closed_loop.CycleState(), GroupMotion())
    )
    control, watched = Control(world, Run(settings, state, memory)), None
    if loop.explains:
        watched = TrueNetwork(world, motion, record_of(loop.true_memory())[0], sums)
    run = _compiled_loop(loop.kernel, parts, (*loop.replaced.items(), *instead.items()))
    loops, motors = records_of(loop.loops), loop.motors.made(False)
    return bool(run(control, loops, motors, room, place, watched, meter, cycles))


def sums_together(loop: NetworkLoop, cycles: int) -> Explained:
    """Return the sums of a network at the end of its loop, or when it diverged."""
    sums, found = records_of([Explained()])[0], Explained()
    is_moved = run_compiled(loop, cycles, sums, sums["figures"], {})
    _fill(found, sums)
    if not is_moved:
        diverge(found.figures)
    return found


def _fill(into: object, record: Any) -> None:
    """Copy the numbers of a record into a dataclass."""
    for name in record.dtype.names:
        if isinstance(record[name], np.void):
            _fill(getattr(into, name), record[name])
        else:
            setattr(into, name, record[name].item())


def write(row: Buffer, at: int, balance: EnergyBalance) -> None:
    """Write a balance into a row from index `at` on."""
    row[at], row[at + 1], row[at + 2], row[at + 3] = balance.torque, balance.h_i, balance.h_pas, balance.h_m
    row[at + 4], row[at + 5], row[at + 6], row[at + 7] = balance.h_r, balance.h_s, balance.h_dis, balance.gen
    row[at + 8], row[at + 9], row[at + 10] = balance.deficit, balance.leak, balance.paid
    row[at + 11], row[at + 12] = balance.branch, balance.damping_rendered
    row[at + 13], row[at + 14], row[at + 15] = balance.certificate, balance.state, balance.supplied


def keep(
    control: object, loops: closed_loop.Loops, room: closed_loop.Room, place: closed_loop.CycleState, rows: Matrix,
    balance: EnergyBalance,
) -> None:  # fmt: skip
    """Replace `take_sync`: write the row of a SYNC, in the order of `LoopRun.rows`."""
    row, motors = rows[place.cycle], len(room.held)
    row[0] = place.supplied - place.work
    for i in range(motors):
        row[1 + i], row[1 + motors + i], row[1 + 2 * motors + i] = room.seen[i], room.true[i], room.held[i]
    write(row, 1 + 3 * motors, balance)


_KEPT: Final[Mapping[object, object]] = {
    closed_loop.take_sync: keep,
    miss: closed_loop.nothing,
    diverge: closed_loop.nothing,
}
"""Replacements of functions of the loop that keep rows."""


def _no_rows(cycles: int, motors: int) -> Array:
    return np.full((1, cycles, 1 + 3 * motors + len(EnergyBalance._fields)), np.nan)


def _kept(rows: Array) -> Array:
    """Return the rows of the SYNCs that were reached."""
    found: Array = rows[0, np.isfinite(rows[0, :, 0])]
    return found


def rows_together(loop: NetworkLoop, cycles: int) -> Array:
    """Return the rows of all SYNCs of a network until its loop ends; see `LoopRun.rows`."""
    rows = _no_rows(cycles, len(loop.loops))
    run_compiled(loop, cycles, records_of([Explained()])[0], rows[0], _KEPT)
    return _kept(rows)


def compiled_rows(case: LoopCase, cycles: int, reach: Reach) -> Array:
    """Return the rows of all SYNCs of one axis until its loop ends; see `LoopRun.rows`.

    Args:
        case: Case to run; `cases.why_not_compiled` must be "".
        cycles: Number of SYNCs.
        reach: Range of positions that do not count as divergence.

    Raises:
        EventLimitError: The plant had more events in one sample time than are allowed.
        NotBatchableError: numba cannot compile the environment.
    """
    batch, kernel = replace(cases.many_loops(case, {}, {}), reach=reach), cast(Kernel, cases.kernel_of(case.algorithm))
    rows = [*cases.scene_rows(batch, kernel, 1)]
    instead = {**_KEPT, **loop_replacements([plant.scene() for plant in batch.plants[:1]])}
    loops = CompiledLoops(cases.LoopJob(kernel, rows, cases.no_modes(1), cycles, instead))
    loops.meters = _no_rows(cycles, 1)
    for error in cases.run_loops_of(batch, loops, 1, listed=False).values():
        raise error
    return _kept(loops.meters)
