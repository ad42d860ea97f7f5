"""One scene at a time, with the names of the batch: for scenes that do not fit it, and to judge it by."""

from collections.abc import Sequence

import numpy as np

from canhaptic.errors import ControlError
from canhaptic.scene.models import Scene
from canhaptic.sim.plant.plant import Plant
from canhaptic.study.batch.axis import SampledAxis
from canhaptic.study.batch.meter import Meter
from canhaptic.study.figures import CONTINUOUS, METRICS, last_rows, metrics_of, sums_of
from canhaptic.study.loop import FURTHEST, LoopCase
from canhaptic.study.reference.continuous_reference import Reference, continuous_reference
from canhaptic.study.scenes import loop_case, plant_parts


def run_scalar(scene: Scene, cycles: int, metrics: Sequence[str] | None = None) -> dict[str, float]:
    """Returns the figures of one scene by the names of `METRICS`.

    Args:
        scene: With a simulated first axis, which is the one that is run.
        cycles: SYNCs.
        metrics: Names of `ALL`; None for `METRICS`, which need no continuous run beside the loop.

    Raises:
        InputError: The axis is not simulated, or has no continuous run that is asked for.
        ParameterError: The algorithm cannot do without something that its loop does not say.
    """
    axis = scene.axes[0]
    case, names, continuous = loop_case(axis, scene), list(METRICS if metrics is None else metrics), None
    if any(name in CONTINUOUS for name in names):
        plant, user, effects, seed = plant_parts(axis)
        step = scene.bus.sample_time_ns
        continuous = continuous_reference(case.environment, plant, user, effects, step, cycles, seed)
    return run_case(case, cycles, names, continuous)


def run_case(
    case: LoopCase, cycles: int, metrics: Sequence[str] | None = None, continuous: Reference | None = None
) -> dict[str, float]:
    """Returns the figures of one loop by the names of `METRICS`; see `run_scalar`."""
    meter = metered(case, cycles, continuous)
    names = list(METRICS if metrics is None else metrics)
    found = vars(meter) | _sums_of_continuous(continuous, case.sample_time_ns)
    sums = {name: np.array([found[name]]) for name in sums_of(names)}
    return {name: float(values[0]) for name, values in metrics_of(names, sums).items()}


def _sums_of_continuous(continuous: Reference | None, sample_time_ns: int) -> dict[str, float]:
    if continuous is None:
        return {}
    position = continuous.position
    rest = float(np.ptp(position[last_rows(len(position), sample_time_ns * 1e-9)]))
    return {
        "continuous_travel": continuous.travel,
        "continuous_rest": rest,
        "continuous": continuous.variation,
    }


def metered(case: LoopCase, cycles: int, continuous: Reference | None = None) -> Meter:
    """Returns the meter of a loop after its cycles, or when it diverged."""
    plant = case.make_plant()
    axis = axis_of(case, cycles)
    meter = axis.meter
    plant.begin(0)
    for k in range(cycles):
        if k:
            plant.advance_to(k * case.sample_time_ns, axis.held)
        if continuous is not None:
            meter.compare(plant.position, axis.held, float(continuous.position[k]), float(continuous.torque[k]))
        try:
            axis.sync_with(plant.encoder_position, plant.position, _interaction(plant))
        except ControlError:
            axis.out = True
        if axis.out:
            meter.diverged = 1.0
            break
    return meter


def axis_of(case: LoopCase, cycles: int) -> SampledAxis:
    """Returns the axis of a loop, at rest before a run of some cycles."""
    return SampledAxis(
        case.controller(),
        case.environment,
        delay=case.delay,
        counts_per_unit=case.counts_per_unit,
        torque_quantum=case.torque_quantum,
        torque_limit=case.torque_limit,
        furthest=FURTHEST,
        last_from=float(last_rows(cycles, case.sample_time_ns * 1e-9).start),
        damping_per_time=case.device_damping / (case.sample_time_ns * 1e-9),
        friction=case.device_friction,
    )


def _interaction(plant: Plant) -> float:
    return 0.0 - plant.energy().motor
