"""The step of a group compiled by numba, as loops of groups compile it, with lists and tuples on the outside."""

from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import numpy as np

from canhaptic.control.multi_axis.group_kernel import GroupHold, GroupModel
from canhaptic.kernels import Buffer, Kernel, Run
from canhaptic.kernels.compiler import compiled
from canhaptic.kernels.records import Records, record_of, records_of
from canhaptic.lab.batch.compiled_loops import compiled_world


def step(world: GroupModel, run: Any, missed: int, positions: Buffer, torques_applied: Buffer) -> GroupHold:
    """Placeholder of the kernel of an algorithm."""
    raise NotImplementedError


def step_records(
    world: GroupModel, tables: Records, settings: Records, states: Records, memories: Records, missed: int,
    positions: Buffer, torques_applied: Buffer,
) -> GroupHold:  # fmt: skip
    """Calls the kernel with what lies in records of shape (1,), which cost less to hand over than records."""
    whole = GroupModel(world.mechanism, world.geometry, world.mover, tables[0], world.functions)
    return step(whole, Run(settings[0], states[0], memories[0]), missed, positions, torques_applied)


@cache
def compiled_step(kernel: Kernel, parts: tuple[type, ...]) -> Any:
    """Returns the step of an algorithm, compiled once in a process for each size of group.

    Args:
        kernel: Of the algorithm.
        parts: Classes of mechanism, geometry and functions of the network.
    """
    return compiled(step_records, {step: kernel.step}, keep=True, parts=parts)


def begin_compiled(kernel: Kernel, world: GroupModel, settings: Any) -> Callable[[], tuple[Any, ...]]:
    """Returns what begins a run; compiles first, which takes up to half a minute where it is not kept on disk.

    Raises:
        ParameterError: A part of the world is given as functions in Python.
    """
    bare, tables = compiled_world(world)
    call = compiled_step(kernel, (type(world.mechanism), type(world.geometry), type(world.functions)))
    fixed, state = record_of(settings), records_of([kernel.state()])
    memory = record_of(kernel.memory(world, settings))
    rows = memory[0]["group"]["commands"]["torques"].shape[1]

    def begin() -> tuple[Any, ...]:
        states, memories = state.copy(), memory.copy()
        positions, applied = np.zeros(rows), np.zeros(rows)
        commands = memories["group"]["commands"]
        sent, energy = commands["torques"][0], memories["group"]["ended"]["interactions"][0]
        torques, interactions = sent.tolist(), energy.tolist()

        def run(missed: int, at: Sequence[float], held: Sequence[float]) -> GroupHold:
            positions[:], applied[:] = at, held
            hold: GroupHold = call(bare, tables, fixed, states, memories, missed, positions, applied)
            torques[hold.place], interactions[:] = sent[hold.place].tolist(), energy.tolist()
            return hold

        def withhold(place: int) -> None:
            for ring in commands.dtype.names or ():
                commands[ring][0, place] = 0.0

        return run, torques, interactions, withhold

    begin()[0](0, [0.0] * rows, [0.0] * rows)
    return begin
