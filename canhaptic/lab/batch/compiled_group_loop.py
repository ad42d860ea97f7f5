"""The loop of a group compiled by numba, its motors and its controller in one; needs the extra `fast`."""

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np

from canhaptic.control.multi_axis.group_kernel import GroupKernel
from canhaptic.control.multi_axis.group_motion import GroupMotion, World, why_not_world
from canhaptic.errors import ParameterError
from canhaptic.kernels.compiler import compiled
from canhaptic.kernels.records import Records, arrays_of, record_of, records_of
from canhaptic.lab.batch.compiled_loops import compiled_noise, compiled_uniform
from canhaptic.lab.batch.group_case import GroupCase
from canhaptic.lab.batch.group_closed_loop import GroupMeter, LinearMotors, run_group, step
from canhaptic.lab.loop.axis_loop import Array
from canhaptic.sim.plant.effects.encoder_noise import noise, uniform


def compiled_world(world: World) -> tuple[Any, Records]:
    """A world for compiled kernels, and its tables.

    Raises:
        ParameterError: A part of it is given as functions in Python.
    """
    if reason := why_not_world(world):
        raise ParameterError(
            f"a compiled group: {reason}, expected mechanisms, geometries and storages that scenes can name"
        )
    bare = World(arrays_of(world.mechanism), arrays_of(world.geometry), world.mover, 0, world.functions)  # type: ignore[arg-type]
    return bare, record_of(world.tables)


def run_records(
    world: World, tables: Records, settings: Records, states: Records, memories: Records, rig: Records,
    motors: Any, room: Records, followed: Records, meters: Records, rows: Any, cycles: int,
) -> None:  # fmt: skip
    """Call `run_group` with records of shape (1,)."""
    whole = World(world.mechanism, world.geometry, world.mover, tables[0], world.functions)
    run_group(
        whole, settings[0], states[0], memories[0], rig[0], motors[0], room[0], followed[0], meters[0], rows, cycles
    )  # fmt: skip


@lru_cache(maxsize=16)
def _compiled_loop(kernel: GroupKernel, parts: tuple[type, ...], replaced: tuple[tuple[object, object], ...]) -> Any:
    """Return `run_records` compiled once in a process for each size of group."""
    instead = {step: kernel.step, noise: compiled_noise, uniform: compiled_uniform, **dict(replaced)}
    return compiled(run_records, instead, keep=True, parts=parts)


def _motors(motors: Any) -> tuple[Any, dict[object, object]]:
    """The motors at their start, and the functions that they replace in the loop."""
    if isinstance(motors, LinearMotors):
        return record_of(motors), {}
    return (motors.made(listed=False),), motors.replacements()


def run_compiled(case: GroupCase, cycles: int, rows: Array, instead: Mapping[object, object]) -> GroupMeter:
    """Sums of a loop after its cycles, or when it diverged.

    Args:
        case: Case that can be compiled.
        cycles: SYNCs.
        rows: Rows for the replacement of `take_group`, shape (cycles, columns).
        instead: Functions of the loop, each with its replacement.
    """
    world = case.world
    bare, tables = compiled_world(world)
    motors, replaced = _motors(case.motors)
    parts = type(world.mechanism), type(world.geometry), type(world.functions)
    run = _compiled_loop(case.kernel, parts, (*replaced.items(), *instead.items()))
    meters = records_of([GroupMeter()])
    run(
        bare, tables, record_of(case.settings), records_of([case.kernel.state()]),
        record_of(case.kernel.memory(world, case.settings)), record_of(case.rig), motors,
        record_of(case.room()), records_of([GroupMotion()]), meters, rows, cycles,
    )  # fmt: skip
    found = GroupMeter()
    _fill(found, meters[0])
    return found


def _fill(into: object, record: Any) -> None:
    """Copy the numbers of a record into a dataclass."""
    for name in record.dtype.names:
        if isinstance(record[name], np.void):
            _fill(getattr(into, name), record[name])
        else:
            setattr(into, name, record[name].item())
