"""The loop of a group compiled by numba, its motors and its controller in one; needs the extra `fast`."""

from functools import lru_cache
from typing import Any

import numpy as np

from canhaptic.control.multi_axis.compiled_group import compiled_world
from canhaptic.control.multi_axis.group_kernel import GroupKernel
from canhaptic.control.multi_axis.group_motion import GroupMotion, World
from canhaptic.kernels.compiler import compiled
from canhaptic.kernels.records import Records, record_of, records_of
from canhaptic.study.batch.group_case import GroupCase
from canhaptic.study.batch.group_closed_loop import GroupMeter, run_group, step
from canhaptic.study.batch.group_events import EventMotorsPlan, event_replacements


def run_records(
    world: World, tables: Records, settings: Records, states: Records, memories: Records, rig: Records,
    motors: Any, room: Records, followed: Records, meters: Records, cycles: int,
) -> None:  # fmt: skip
    """Calls `run_group` with what lies in records of shape (1,)."""
    whole = World(world.mechanism, world.geometry, world.mover, tables[0], world.functions)
    run_group(
        whole, settings[0], states[0], memories[0], rig[0], motors[0], room[0], followed[0], meters[0], cycles
    )  # fmt: skip


@lru_cache(maxsize=16)
def _compiled_loop(kernel: GroupKernel, parts: tuple[type, ...], *, has_events: bool) -> Any:
    """Returns `run_records` compiled once in a process for each size of group."""
    instead = {step: kernel.step, **(event_replacements() if has_events else {})}
    return compiled(run_records, instead, keep=True, parts=parts)


def compiled_meter(case: GroupCase, cycles: int) -> GroupMeter:
    """Returns the sums of a loop; see `group_scalar.group_meter`.

    Raises:
        ParameterError: A part of the world is given as functions in Python.
    """
    world = case.world
    bare, tables = compiled_world(world)
    plan = case.motors if isinstance(case.motors, EventMotorsPlan) else None
    parts = type(world.mechanism), type(world.geometry), type(world.functions)
    run = _compiled_loop(case.kernel, parts, has_events=plan is not None)
    motors: Any = (plan.made(listed=False),) if plan else record_of(case.motors)
    meters = records_of([GroupMeter()])
    run(
        bare, tables, record_of(case.settings), records_of([case.kernel.state()]),
        record_of(case.kernel.memory(world, case.settings)), record_of(case.rig), motors,
        record_of(case.room()), records_of([GroupMotion()]), meters, cycles,
    )  # fmt: skip
    found = GroupMeter()
    _fill(found, meters[0])
    return found


def _fill(into: object, record: Any) -> None:
    """Gives a dataclass the numbers of a record."""
    for name in record.dtype.names:
        if isinstance(record[name], np.void):
            _fill(getattr(into, name), record[name])
        else:
            setattr(into, name, record[name].item())
