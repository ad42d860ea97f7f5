"""Loops of a batch from a scene and the keys in which many scenes differ."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Final, cast

import numpy as np

from canhaptic.control.environments.plain import plain
from canhaptic.errors import ParameterError
from canhaptic.lab.batch.batch_case import BatchCase, floats_of
from canhaptic.lab.batch.closed_loop import Losses
from canhaptic.lab.batch.event_plants import PlantValues, distinct_plants
from canhaptic.lab.batch.plants import is_linear, plant_numbers, why_not_in_loop
from canhaptic.lab.batch.rows import kernel_of
from canhaptic.lab.batch.signal_effects import SignalEffects
from canhaptic.lab.batch.varied import scene_with, split_key
from canhaptic.lab.figures.figures import CONTINUOUS
from canhaptic.lab.loop.axis_loop import FURTHEST, Array, LoopCase
from canhaptic.lab.loop.scenes import loop_case
from canhaptic.scene.models import AxisSimulation, Scene
from canhaptic.scene.torque_history import simulation_of
from canhaptic.sim.drive.drive_parameters import SimulatedDriveParameters
from canhaptic.sim.plant.plant import PlantParameters
from canhaptic.sim.plant.user import UserParameters
from canhaptic.units import Parameters

_RATE: Final = "bus.rate"
_PLANT_DAMPING: Final = "simulation.plant.damping"


def why_not_batchable(scene: Scene) -> str:
    """Return "" when the whole loop of a scene can run in a batch, else the reason by name.

    "effect coulomb_friction has events", "scene has 2 axes, expected one", ...

    Args:
        scene: Validated; only its types matter, not its values.
    """
    reason = why_not_beforehand(scene)
    if reason:
        return reason
    try:
        batch_case(scene, {})
        case = loop_case(scene.axes[0], scene)
        case.controller()
    except ParameterError as error:
        return f"refused: {error}"
    return why_not_compiled(case)


def why_not_compiled(case: LoopCase) -> str:
    """Return "" when a loop can be compiled together with its plant, else the reason by name."""
    if case.simulation is None:
        return "the plant is not that of a scene"
    reason = _why_not_moved(case.simulation, case.algorithm, case.own)
    if reason:
        return reason
    if plain(case.environment) is case.environment:
        return f"environment {type(case.environment).__name__} has no plain form (it asks its base by super())"
    return "" if kernel_of(case.algorithm) else f"algorithm {case.algorithm} is not written as a kernel"


def why_not_compared(scene: Scene, metrics: Sequence[str]) -> str:
    """Reason why a batch lacks the quantities that metrics compare a scene with; empty where it has them."""
    if set(metrics).isdisjoint(CONTINUOUS) or is_linear(simulation_of(scene.axes[0])):
        return ""
    return "a plant with events has its continuous run by itself"


def why_not_beforehand(scene: Scene) -> str:
    """Return the answer of `why_not_batchable` as far as it does not depend on the algorithm."""
    if scene.groups:
        return f"group {scene.groups[0].name!r} renders on {len(scene.groups[0].axes)} axes together"
    if len(scene.axes) != 1:
        return f"scene has {len(scene.axes)} axes, expected one"
    simulation = scene.axes[0].simulation
    if simulation is None:
        return "axis is not simulated"
    return _why_not_moved(simulation, scene.axes[0].passivity.name, scene.axes[0].passivity.own)


def _why_not_moved(simulation: AxisSimulation, algorithm: str, own: type[Any] | None) -> str:
    if simulation.admittance is not None:
        return "an admittance display runs one by one"
    if own is not None:
        return f"algorithm {algorithm} is own code"
    if type(simulation.user) not in (UserParameters, type(None)):
        return "the hand is own code"
    return why_not_in_loop(simulation)


def batch_case(scene: Scene, varied: Mapping[str, Array]) -> BatchCase:
    """Return the loop of a scene of one axis with the numbers in which many scenes differ.

    Args:
        scene: Common part of the scenes, the delay included.
        varied: Key of `BATCH_KEYS` but `loop.delay` -> value of each scene.
    """
    axis = scene.axes[0]
    simulation = simulation_of(axis)
    case = loop_case(axis, scene)
    numbers = _numbers(case, simulation, scene.bus.sample_time_ns, varied)
    passivity = axis.passivity.parameters
    for key, values in varied.items():
        section, name = split_key(key)
        if section == "passivity":
            numbers[f"{'passivity' if name in type(passivity).model_fields else 'loop'}.{name}"] = values
        elif section == "environment":
            numbers[key] = values
        elif section == "axes.0":
            numbers |= _of_axis(name, values)
    return replace(_case(case, simulation, numbers, varied), losses=losses_of(scene))


def losses_of(scene: Scene) -> Losses:
    """Frames that the bus of a scene loses; none where it selects them by COB-ID, time or bus."""
    effects = scene.bus_effects
    if effects is None or not effects.drop or effects.ids or effects.during or effects.buses:
        return Losses()
    share, burst = effects.drop, effects.drop_burst
    after_heard = share if burst is None else share / (burst * (1.0 - share))
    after_lost = share if burst is None else 1.0 - 1.0 / burst
    to_drive, to_master = (effects.direction in ("both", name) for name in ("to_drive", "to_master"))
    return Losses(True, after_heard, after_lost, to_drive, to_master)


def not_in_loop(scene: Scene, *, is_batched: bool) -> str:
    """Bus effects that a loop without a bus leaves out, in words; "" for none."""
    if scene.bus_effects is None:
        return ""
    passed = ("drop",) if is_batched and losses_of(scene).exists else ()
    left_out = ", ".join(name for name in scene.bus_effects.named if name not in passed)
    return f"not in this loop: simulation.bus {left_out}; canhaptic run has it" if left_out else ""


def loop_in_arrays(
    case: LoopCase,
    plant: PlantParameters,
    user: UserParameters,
    numbers: Mapping[str, Array],
    varied: Mapping[str, Array] | None = None,
) -> BatchCase:
    """Return a loop that is not of a scene (an ideal encoder, an ideal torque) for many scenes.

    Args:
        case: Common part of the loops.
        plant: Moving mass of the plant.
        user: The hand.
        numbers: Varied numbers by the names of `BatchCase.numbers`.
        varied: Keys of `BATCH_KEYS` under `simulation.` and `bus.rate` -> value of each scene.
    """
    simulation = AxisSimulation(SimulatedDriveParameters(counts_per_unit=1.0), plant, user, (), 0)
    found = {**_numbers(case, simulation, case.sample_time_ns, varied or {}), **numbers}
    return _case(case, simulation, found, varied or {})


def loop_alone(case: LoopCase) -> BatchCase:
    """Return one loop for which `why_not_compiled` is ""."""
    simulation = cast(AxisSimulation, case.simulation)
    return _case(case, simulation, _numbers(case, simulation, float(case.sample_time_ns), {}), {})


def _numbers(
    case: LoopCase, simulation: AxisSimulation, sample_time_ns: float, varied: Mapping[str, Array]
) -> dict[str, Array | float | None]:
    numbers: dict[str, Array | float | None] = {
        **floats_of("environment", cast(Parameters, case.environment)),
        **floats_of("passivity", cast(Parameters, case.parameters)),
        **floats_of("loop", case.loop),
        "counts_per_unit": case.counts_per_unit,
        "torque_quantum": case.torque_quantum,
        "torque_limit": case.torque_limit,
        "last_from": 0.0,
        "friction": case.device_friction,
        "seed": float(simulation.seed),
    }
    period: Array | float = float(sample_time_ns)
    if _RATE in varied:
        period = np.rint(1e9 / varied[_RATE])
        numbers["loop.sample_time"] = period * 1e-9
    numbers["damping_per_time"] = _device_damping(case, simulation, varied) / (period * 1e-9)
    return numbers | (plant_numbers(simulation, period, varied) if is_linear(simulation) else {})


def _device_damping(case: LoopCase, simulation: AxisSimulation, varied: Mapping[str, Array]) -> Array | float:
    """Device damping that the meter counts as certain, as `loop_case` does."""
    if "passivity.device_damping" in varied:
        return varied["passivity.device_damping"]
    if _PLANT_DAMPING in varied and case.loop.device_damping is None:
        return varied[_PLANT_DAMPING] + (case.device_damping - simulation.plant.damping)
    return case.device_damping


def _case(
    case: LoopCase, simulation: AxisSimulation, numbers: dict[str, Any], varied: Mapping[str, Array]
) -> BatchCase:
    states = sum(name.startswith("start.") for name in numbers)
    plants: list[PlantValues] = []
    if not states:
        period = np.rint(1e9 / varied[_RATE]) if _RATE in varied else float(case.sample_time_ns)
        plants, numbers["plant"] = distinct_plants(simulation, period, varied)
    return BatchCase(
        case.environment, case.algorithm, cast(Parameters, case.parameters), case.loop, case.delay, FURTHEST,
        states + 2, numbers, SignalEffects.of(simulation.effects), plants,
    )  # fmt: skip


def _of_axis(name: str, values: Array) -> dict[str, Array]:
    if name == "counts_per_unit":
        return {"counts_per_unit": values, "loop.encoder_count": 1.0 / values}
    if name == "rated_torque":
        return {"torque_quantum": values * 1e-3, "loop.torque_quantum": values / 1000.0}
    return {"torque_limit": values, "loop.torque_limit": values}


def check_values(scene: Scene, varied: Mapping[str, Array]) -> int:
    """Check the scenes with the least and the largest value of each key; return the number of scenes.

    Raises:
        ParameterError: A key that cannot vary, values of different lengths, not finite or out of range, or an algorithm
            that cannot do without one.
    """
    lengths = {key: np.shape(values) for key, values in varied.items()}
    if len(set(lengths.values())) > 1 or any(len(shape) != 1 or shape[0] == 0 for shape in lengths.values()):
        raise ParameterError(f"varied: got shapes {lengths}, expected one (n_scenes,) for all, n_scenes > 0")
    rows = {0}
    for key, values in varied.items():
        split_key(key)
        if not np.isfinite(values).all():
            raise ParameterError(f"varied: got {key} that is not finite, expected numbers in SI")
        rows |= {int(np.argmin(values)), int(np.argmax(values))}
    for row in sorted(rows):
        one = scene_with(scene, {key: float(values[row]) for key, values in varied.items()})
        loop_case(one.axes[0], one).controller()
    return max([1, *(len(values) for values in varied.values())])
