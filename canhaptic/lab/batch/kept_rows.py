"""One loop compiled with its plant, with a record of every SYNC: for studies that need rows and not sums.

Each SYNC is written into a row, and the rows are passed to the recorder of the loop that Python runs. A
linear plant moves by sums in another order than in `Plant`, so that numbers differ from those of `loop.render` by
rounding; where the last bit counts, take that.
"""

from collections.abc import Callable
from dataclasses import replace
from math import inf
from typing import Final, cast

import numpy as np

from canhaptic.control.balance import EnergyBalance
from canhaptic.control.environments.environment import Environment
from canhaptic.errors import EventLimitError
from canhaptic.kernels import Kernel, Matrix, new
from canhaptic.lab.batch.batch_reference import no_modes
from canhaptic.lab.batch.cases import loop_alone
from canhaptic.lab.batch.compiled_loops import CompiledLoops
from canhaptic.lab.batch.event_loops import loop_replacements, run_event_plants, uninterrupted
from canhaptic.lab.batch.meter import MeterSettings, compare, diverge, miss, take
from canhaptic.lab.batch.rows import kernel_of, linear_plants, scene_rows
from canhaptic.lab.loop.axis_loop import Array, DivergedError, LoopCase, LoopRun, Recorder

_OWN: Final = 4  # numbers of a row in front of those of the balance
_BRANCH, _CERTIFICATE = (EnergyBalance._fields.index(name) for name in ("branch", "certificate"))


def keep(
    environment: Environment, settings: MeterSettings, rows: Matrix, cycle: int, position: float,
    true_position: float, torque: float, interaction: float, balance: EnergyBalance,
) -> None:  # fmt: skip
    """Replace `meter.take`: write a row."""
    row = rows[cycle]
    row[0], row[1], row[2], row[3] = position, true_position, torque, interaction
    row[4], row[5], row[6], row[7], row[8] = balance.torque, balance.h_i, balance.h_pas, balance.h_m, balance.h_r
    row[9], row[10], row[11], row[12], row[13] = balance.h_s, balance.h_dis, balance.gen, balance.deficit, balance.leak
    row[14], row[15], row[16], row[17] = balance.paid, balance.branch, balance.damping_rendered, balance.certificate
    row[18] = balance.state


def compare_nothing(
    rows: Matrix, position: float, torque: float, continuous_position: float, continuous_torque: float
) -> None:
    """Replace `meter.compare`: no-op."""


def miss_nothing(
    environment: Environment, settings: MeterSettings, rows: Matrix, cycle: int, true_position: float, torque: float,
    interaction: float,
) -> None:  # fmt: skip
    """Replace `meter.miss`: no frame is lost here."""


def diverge_silently(rows: Matrix) -> None:
    """Replace `meter.diverge`: the rows end."""


_KEEPING: Final[dict[object, object]] = {
    take: keep,
    miss: miss_nothing,
    compare: compare_nothing,
    diverge: diverge_silently,
}


def render_compiled(
    case: LoopCase, cycles: int, recorder: Recorder, progress: Callable[[], None] | None = None
) -> LoopRun:
    """Run a case compiled; see `loop.render`.

    Args:
        case: Case for which `cases.why_not_compiled` is "".
        cycles: SYNCs.
        recorder: Defines divergence.
        progress: Called once per cycle when the loop is over; may raise.

    EventLimitError: The plant had more events in one sample time than allowed.
        EventLimitError: The plant had more events in one sample time than are allowed.
        NotBatchableError: numba cannot compile the environment.
        ParameterError: The algorithm needs a value that its loop does not give.
    """
    case.controller()  # refuses what cannot be built
    for position, true_position, torque, interaction, *booked in _rows(case, cycles).tolist():
        booked[_BRANCH], booked[_CERTIFICATE] = int(booked[_BRANCH]), int(booked[_CERTIFICATE])
        try:
            recorder.take(position, true_position, torque, new(EnergyBalance, booked), 0.0 - interaction)
        except DivergedError:
            return recorder.run("diverged")._replace(engine="numba")
        if progress is not None:
            progress()
    run = recorder.run()
    if len(run.position) < cycles:
        run = run._replace(ended="stopped", reason="a position or a torque is not finite")
    return run._replace(engine="numba")


def _rows(case: LoopCase, cycles: int) -> Array:
    """Rows of all SYNCs up to the end of the loop."""
    batch, kernel = replace(loop_alone(case), furthest=inf), cast(Kernel, kernel_of(case.algorithm))
    rows = [*scene_rows(batch, kernel, batch.numbers, 1)]
    instead: dict[object, object] = {**_KEEPING, **loop_replacements(batch.plants)}
    loops = CompiledLoops(kernel, rows, no_modes(1), cycles, instead)
    loops.meters = np.full((1, cycles, _OWN + len(EnergyBalance._fields)), np.nan)
    if batch.plants:
        stopped: dict[int, EventLimitError] = {}
        run_event_plants(loops, batch.plants, np.zeros(1), stopped, listed=False)
        if stopped:
            raise stopped[0]
    else:
        loops.run([0], linear_plants(batch, batch.numbers, 1, listed=False), uninterrupted)
    found: Array = loops.meters[0]
    return found[np.isfinite(found[:, 0])]
