"""One group of a scene in a loop without a bus, with the names of the batch.

Figures of one axis apply to a group as follows: energies are those of all its motors and of a mover; torques are
Euclidean norms, `torque_peak` is the largest of any motor. Travel, stiffness and comparisons with a continuous run are
NaN: a group has no position.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache
from math import nan
from typing import Any, Final

import numpy as np

from canhaptic.control.multi_axis.group_kernel import GroupKernel
from canhaptic.control.multi_axis.group_motion import GroupMotion
from canhaptic.errors import CanHapticError
from canhaptic.kernels import with_quick_fields
from canhaptic.kernels.binding import bound
from canhaptic.lab.batch.closed_loop import Signals
from canhaptic.lab.batch.engine import ChosenEngine
from canhaptic.lab.batch.group_case import GroupCase
from canhaptic.lab.batch.group_closed_loop import (
    GroupMeter,
    GroupRig,
    GroupRoom,
    LinearMotors,
    arrive,
    move_motors,
    run_group,
    step,
)
from canhaptic.lab.batch.group_loop import Motors
from canhaptic.lab.figures.figures import CONTINUOUS, METRICS, metrics_of, sums_of

_OF_A_POSITION: Final = ("travel", "stiffness_rendered.value", "stiffness_rendered.share", *CONTINUOUS)


def group_meter(case: GroupCase, cycles: int, engine: ChosenEngine = "python") -> GroupMeter:
    """Return the sums of a loop after its cycles, or when it diverged.

    Args:
        case: Case of the group, compiled where it can be.
        cycles: SYNCs.
        engine: Python takes every case.
    """
    if engine == "numba" and case.is_compilable:
        from canhaptic.lab.batch.compiled_group_loop import run_compiled

        return run_compiled(case, cycles, np.empty((0, 0)), {})
    meter, memory = GroupMeter(), with_quick_fields(case.kernel.memory(case.world, case.settings))
    motors, rig, replaced = _in_python(case)
    run = _python_loop(case.kernel, tuple(replaced.items()))
    fixed = (with_quick_fields(part) for part in (case.world, case.settings))
    try:
        run(*fixed, case.kernel.state(), memory, rig, motors, case.room(), GroupMotion(), meter, [], cycles)
    except CanHapticError:  # of a mechanism that is pushed where it cannot move
        meter.figures.diverged = 1.0
    return meter


def _in_python(case: GroupCase) -> tuple[Any, GroupRig, dict[object, object]]:
    """The motors at their start, their loop to the controller, and the replacements in it."""
    motors = case.motors
    if isinstance(motors, LinearMotors):
        return motors._replace(state=list(motors.state)), case.rig, {}
    if not isinstance(motors, Motors):
        return motors.made(listed=True), case.rig, motors.replacements()
    bare = [replace(loop, signals=Signals()) for loop in case.rig.loops]  # the plants have them
    return motors, case.rig._replace(loops=bare), {move_motors: _Moved(motors, case.period)}


@lru_cache(maxsize=16)
def _python_loop(kernel: GroupKernel, replaced: tuple[tuple[object, object], ...]) -> Callable[..., None]:
    found: Callable[..., None] = bound(run_group, {step: kernel.step, **dict(replaced)})
    return found


class _Moved:
    """Replaces `move_motors` for motors that do not move by one flow."""

    def __init__(self, motors: Motors, period: int) -> None:
        self._motors, self._period, self._done = motors, period, 0.0

    def __call__(self, _motors: Motors, room: GroupRoom, cycle: int) -> float:
        """Move them to a SYNC; return the work that they did in that hold [J]."""
        motors = self._motors
        if cycle:
            motors.advance_to(cycle * self._period, tuple(room.held))
        for i, at in enumerate(motors.positions()):
            arrive(room, i, at, cycle)
        room.read[:] = motors.encoders()
        before, self._done = self._done, motors.work()
        return self._done - before


def group_figures(meter: GroupMeter, metrics: Sequence[str] | None = None) -> dict[str, float]:
    """Figures made of sums; NaN for those of a position."""
    names, sums = list(METRICS if metrics is None else metrics), meter.figures
    own = [name for name in names if name not in _OF_A_POSITION]
    figures = metrics_of(own, {name: np.array([getattr(sums, name)]) for name in sums_of(own)})
    return {name: float(figures[name][0]) if name in figures else nan for name in names}
