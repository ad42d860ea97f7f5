"""One loop with a record of every SYNC, by Python or compiled; the choice for a study, and the note about it."""

from collections.abc import Callable
from typing import Final

from canhaptic.lab.batch.batch_case import NotBatchableError
from canhaptic.lab.batch.cases import why_not_compiled
from canhaptic.lab.batch.engine import ChosenEngine
from canhaptic.lab.batch.event_plants import PlantValues
from canhaptic.lab.loop.axis_loop import LoopCase, LoopRun, Recorder, render

_OF_A_SUBSTEP: Final = 4
"""Cost of a substep, whose force is found by a secant, over that of a cycle."""


def render_by(
    engine: ChosenEngine, case: LoopCase, cycles: int, recorder: Recorder | None = None,
    progress: Callable[[], None] | None = None,
) -> LoopRun:  # fmt: skip
    """Run a case as `loop.render` does; `LoopRun.engine` names the engine, and why it differs from the requested one.

    Args:
        engine: "python" gives the bits of the path over CAN; "numba" differs from it by rounding, and runs in Python
            what cannot be compiled.
        case: Case to run.
        cycles: SYNCs.
        recorder: Defines divergence; 1 km by default.
        progress: Called once per cycle.

    Raises:
        EventLimitError: The plant had more events in one sample time than allowed.
        ParameterError: The algorithm needs a value that its loop does not give.
    """
    if engine == "python":
        return render(case, cycles, recorder, progress)
    reason = why_not_compiled(case)
    if not reason:
        from canhaptic.lab.batch.kept_rows import render_compiled

        try:
            return render_compiled(case, cycles, recorder or Recorder(), progress)
        except NotBatchableError as error:
            reason = str(error)
    return render(case, cycles, recorder, progress)._replace(engine=f"python: {reason}")


def work_of(case: LoopCase, cycles: int) -> float:
    """Cost of a run, in cycles of a light plant."""
    if case.simulation is None:
        return 0.0
    plant = PlantValues(case.simulation, case.sample_time_ns).scene()
    if not plant.efforts:
        return cycles
    accuracy = case.simulation.accuracy
    return float(cycles * _OF_A_SUBSTEP * (accuracy.substeps if accuracy else 1))
