"""One scene at a time, with the names of the batch: for scenes that do not fit it, and as its reference."""

from collections.abc import Sequence
from dataclasses import asdict
from math import inf

import numpy as np

from canhaptic.control.balance import EnergyBalance
from canhaptic.control.environments.plain import plain
from canhaptic.errors import ControlError
from canhaptic.lab.batch.closed_loop import LoopSettings
from canhaptic.lab.batch.group_case import group_case
from canhaptic.lab.batch.group_scalar import group_figures, group_meter
from canhaptic.lab.batch.meter import Meter, MeterSettings, compare, take
from canhaptic.lab.figures.figures import CONTINUOUS, METRICS, last_rows, metrics_of, sums_of
from canhaptic.lab.loop.axis_loop import FURTHEST, DivergedError, LoopCase
from canhaptic.lab.loop.scenes import loop_case, plant_parts
from canhaptic.lab.reference.continuous_reference import ContinuousReference, continuous_reference
from canhaptic.scene.models import Scene
from canhaptic.sim.plant.direct_rig import DirectRig


def run_scalar(scene: Scene, cycles: int, metrics: Sequence[str] | None = None) -> dict[str, float]:
    """Return the figures of one scene by the names of `METRICS`.

    Args:
        scene: Scene with a simulated first axis, which is run; or with one group of axes.
        cycles: SYNCs.
        metrics: Names of `ALL`; None for `METRICS`, which need no continuous run.

    Raises:
        InputError: The axis is not simulated, or a continuous run is requested and it has none.
        ParameterError: The algorithm needs a value that its loop does not give.
    """
    if scene.groups:
        return group_figures(group_meter(group_case(scene), cycles), metrics)
    axis = scene.axes[0]
    case, names, continuous = loop_case(axis, scene), list(METRICS if metrics is None else metrics), None
    if any(name in CONTINUOUS for name in names):
        plant, user, effects, seed = plant_parts(axis)
        step = scene.bus.sample_time_ns
        continuous = continuous_reference(case.environment, plant, user, effects, step, cycles, seed)
    return run_case(case, cycles, names, continuous)


def run_case(
    case: LoopCase, cycles: int, metrics: Sequence[str] | None = None, continuous: ContinuousReference | None = None
) -> dict[str, float]:
    """Return the figures of one loop by the names of `METRICS`; see `run_scalar`."""
    meter = _metered(case, cycles, continuous)
    names = list(METRICS if metrics is None else metrics)
    found = asdict(meter) | _sums_of_continuous(continuous, case.sample_time_ns)
    sums = {name: np.array([found[name]]) for name in sums_of(names)}
    return {name: float(values[0]) for name, values in metrics_of(names, sums).items()}


def _sums_of_continuous(continuous: ContinuousReference | None, sample_time_ns: int) -> dict[str, float]:
    if continuous is None:
        return {}
    position = continuous.position
    rest = float(np.ptp(position[last_rows(len(position), sample_time_ns * 1e-9)]))
    return {
        "continuous_travel": continuous.travel,
        "continuous_rest": rest,
        "continuous": continuous.variation,
    }


def _metered(case: LoopCase, cycles: int, continuous: ContinuousReference | None = None) -> Meter:
    """Return the meter of a loop after its cycles, or when it diverged."""
    plant, controller, loop, meter = case.make_plant(), case.controller(), loop_settings(case, cycles), Meter()
    environment = plain(case.environment)
    expected = (
        None if continuous is None else zip(continuous.position.tolist(), continuous.torque.tolist(), strict=True)
    )

    def step(position: float, held: float) -> EnergyBalance:
        true_position = plant.position
        if expected is not None:
            compare(meter, true_position, held, *next(expected))
        balance = controller.step(position, held)
        cycle, interaction = int(meter.cycles), 0.0 - plant.energy().motor
        take(environment, loop.meter, meter, cycle, position, true_position, held, interaction, balance)
        if not -loop.furthest < true_position < loop.furthest:
            raise DivergedError(f"the axis is at {true_position:g}")
        return balance

    rig = DirectRig(
        plant, step, case.sample_time_ns, case.delay, case.counts_per_unit, case.torque_quantum, case.torque_limit
    )
    try:
        rig.run(cycles)
    except ControlError:
        meter.diverged = 1.0
    return meter


def loop_settings(case: LoopCase, cycles: int) -> LoopSettings:
    """Loop between plant and controller in a run of some cycles."""
    period = case.sample_time_ns * 1e-9
    meter = MeterSettings(float(last_rows(cycles, period).start), case.device_damping / period, case.device_friction)
    return LoopSettings(
        case.delay, case.counts_per_unit or 0.0, case.torque_quantum or 0.0, case.torque_limit or inf, FURTHEST, meter
    )
