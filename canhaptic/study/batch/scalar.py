"""One scene at a time, with the names of the batch: for scenes that do not fit it, and to judge it by."""

from typing import Final

import numpy as np

from canhaptic.errors import ControlError
from canhaptic.scene.models import Scene
from canhaptic.sim.plant import Plant
from canhaptic.study.batch.axis import SampledAxis
from canhaptic.study.batch.meter import METRICS, Meter, metrics_of, sums_of
from canhaptic.study.loop import LoopCase
from canhaptic.study.scenes import loop_case

FURTHEST: Final = 1e3
"""Distance from the origin that counts as divergence [m or rad], as in `canhaptic.study.loop.Recorder`."""


def run_scalar(scene: Scene, cycles: int) -> dict[str, float]:
    """Returns the figures of one scene by the names of `METRICS`.

    Args:
        scene: With a simulated first axis, which is the one that is run.
        cycles: SYNCs.

    Raises:
        InputError: The axis is not simulated.
        ParameterError: The algorithm cannot do without something that its loop does not say.
    """
    return run_case(loop_case(scene.axes[0], scene), cycles)


def run_case(case: LoopCase, cycles: int) -> dict[str, float]:
    """Returns the figures of one loop by the names of `METRICS`; see `run_scalar`."""
    meter = metered(case, cycles)
    names = list(METRICS)
    sums = {name: np.array([getattr(meter, name)]) for name in sums_of(names)}
    return {name: float(values[0]) for name, values in metrics_of(names, sums).items()}


def metered(case: LoopCase, cycles: int) -> Meter:
    """Returns the meter of a loop after its cycles, or when it diverged."""
    plant = case.make_plant()
    axis = axis_of(case)
    meter = axis.meter
    plant.begin(0)
    for k in range(cycles):
        if k:
            plant.advance_to(k * case.sample_time_ns, axis.held)
        try:
            axis.sync_with(plant.encoder_position, plant.position, _interaction(plant))
        except ControlError:
            axis.out = True
        if axis.out:
            meter.diverged = 1.0
            break
    return meter


def axis_of(case: LoopCase) -> SampledAxis:
    """Returns the axis of a loop, at rest."""
    return SampledAxis(
        case.controller(),
        case.environment,
        delay=case.delay,
        counts_per_unit=case.counts_per_unit,
        torque_quantum=case.torque_quantum,
        torque_limit=case.torque_limit,
        furthest=FURTHEST,
    )


def _interaction(plant: Plant) -> float:
    return 0.0 - plant.energy().motor
