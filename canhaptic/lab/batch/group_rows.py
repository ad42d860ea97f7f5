"""One group compiled with its motors, every SYNC of which is kept; see `kept_rows`."""

from math import inf
from typing import Final

import numpy as np

from canhaptic.control.balance import EnergyBalance
from canhaptic.control.multi_axis.group_controller import GroupBalance
from canhaptic.control.multi_axis.group_kernel import GroupHold
from canhaptic.kernels import Matrix, new
from canhaptic.lab.batch.engine import ChosenEngine
from canhaptic.lab.batch.group_case import group_case
from canhaptic.lab.batch.group_closed_loop import GroupMeter, GroupRig, GroupRoom, take_group
from canhaptic.lab.batch.group_loop import GroupRecorder, GroupSync, render_group
from canhaptic.lab.loop.axis_loop import Array, DivergedError, LoopRun
from canhaptic.scene.models import Scene

_BOOKED: Final = len(EnergyBalance._fields)
_BRANCH, _CERTIFICATE = (EnergyBalance._fields.index(name) for name in ("branch", "certificate"))


def keep_group(rig: GroupRig, room: GroupRoom, meter: GroupMeter, rows: Matrix, hold: GroupHold) -> None:
    """Replace `take_group`: write a row, first the energy that came in, then each motor, then the account."""
    row, account, motors = rows[int(meter.figures.cycles)], hold.account, len(room.held)
    meter.figures.cycles += 1.0
    row[0] = meter.supplied - meter.work
    for i in range(motors):
        row[1 + i], row[1 + motors + i], row[1 + 2 * motors + i] = room.seen[i], room.true[i], room.held[i]
    at = 1 + 3 * motors
    row[at], row[at + 1], row[at + 2], row[at + 3] = account.torque, account.h_i, account.h_pas, account.h_m
    row[at + 4], row[at + 5], row[at + 6], row[at + 7] = account.h_r, account.h_s, account.h_dis, account.gen
    row[at + 8], row[at + 9], row[at + 10] = account.deficit, account.leak, account.paid
    row[at + 11], row[at + 12] = account.branch, account.damping_rendered
    row[at + 13], row[at + 14] = account.certificate, account.state


def render_group_by(engine: ChosenEngine, scene: Scene, cycles: int, recorder: GroupRecorder) -> LoopRun:
    """Run the one group of a scene; see `render_group` and `rendering.render_by`.

    Raises:
        InputError: The motors of the group are not simulated, or move with others.
        ParameterError: The group cannot be built.
    """
    if engine == "python":
        return render_group(scene, cycles, recorder)
    case = group_case(scene)
    if case.why_not:
        return render_group(scene, cycles, recorder)._replace(engine=f"python: {case.why_not}")
    from canhaptic.lab.batch.compiled_group_loop import run_compiled

    motors = len(case.rig.loops)
    rows = np.empty((cycles, 1 + 3 * motors + _BOOKED))
    meter = run_compiled(case._replace(rig=case.rig._replace(furthest=inf)), cycles, rows, {take_group: keep_group})
    return _recorded(rows[: int(meter.figures.cycles)], motors, recorder, is_whole=meter.figures.cycles == cycles)


def _recorded(rows: Array, motors: int, recorder: GroupRecorder, *, is_whole: bool) -> LoopRun:
    """Record made of rows."""
    for interaction, *numbers in rows.tolist():
        seen, true, held = (numbers[i * motors : (i + 1) * motors] for i in range(3))
        booked = numbers[3 * motors :]
        booked[_BRANCH], booked[_CERTIFICATE] = int(booked[_BRANCH]), int(booked[_CERTIFICATE])
        balance = GroupBalance((), new(EnergyBalance, booked), ())
        try:
            recorder.take_group(GroupSync(seen, true, tuple(held), balance, interaction))
        except DivergedError:
            return recorder.run("diverged")._replace(engine="numba")
    run = recorder.run() if is_whole else recorder.run("stopped", "a position or a torque is not finite")
    return run._replace(engine="numba")
