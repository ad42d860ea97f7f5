"""Make the loops of a batch from one scene and the values of the keys that vary.

`BatchCase` holds what the loops share and the numbers in which they differ; `scene_rows` turns these into the objects
that the kernels of each scene take. `continuous_modes` gives the matrices of the continuous environment that a loop is
compared with; `why_not_continuous` names the reason where an environment has no solution in closed form.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import repeat
from math import inf
from typing import Any, NamedTuple, cast

import numpy as np

from canhaptic.control.environments import plain, plain_with
from canhaptic.control.environments.damper_wall import DamperWall
from canhaptic.control.environments.free_space import FreeSpace
from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.control.environments.two_sided_wall import TwoSidedWall
from canhaptic.control.environments.viscous_medium import ViscousMedium
from canhaptic.control.passivity import ALGORITHMS
from canhaptic.drive.profile.causality import IMPEDANCE
from canhaptic.errors import EventLimitError, InputError, ParameterError
from canhaptic.kernels import Kernel
from canhaptic.lab.batch import closed_loop
from canhaptic.lab.batch import plants as event_plant
from canhaptic.lab.batch.closed_loop import LinearPlants, LoopSettings, Losses
from canhaptic.lab.batch.continuous_run import ReferenceSettings
from canhaptic.lab.batch.varied import scene_with, split_key
from canhaptic.lab.figures.figures import CONTINUOUS, last_rows
from canhaptic.lab.figures.meter import MeterSettings
from canhaptic.lab.loop.axis_loop import EVERYWHERE, Array, LoopCase, Reach, loop_case
from canhaptic.lab.reference import readings_per_hold
from canhaptic.registry import load
from canhaptic.scene.components import ComponentSpec
from canhaptic.scene.method import simulation_of
from canhaptic.scene.models import AxisSimulation, Scene
from canhaptic.sim.plant.propagator import flow_changes


class NotBatchableError(InputError, NotImplementedError):
    """Raised if a scene cannot run in a batch; it can still be run by itself."""


Numbers = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class BatchCase:
    """The common part of many loops, and the numbers that vary between them.

    `numbers` holds the values that vary, by name, each of shape (n_scenes,) or one number:

    * `environment.NAME`, `passivity.NAME` and `loop.NAME`: a field of that model;
    * `counts_per_unit`, `torque_quantum`, `torque_limit`: the drive;
    * `last_from`, `damping_per_time`, `is_brief`: the meter;
    * `seed`: the seed of all random numbers; `plant`: the index in `plants`.

    A name that is absent keeps the value of the common case.
    """

    common: LoopCase
    numbers: Numbers
    linear: event_plant.LinearMotion | None  # motion of linear plants; None: the plants have events
    plants: Sequence[event_plant.PlantValues] = ()  # distinct plants with events
    signals: Sequence[ComponentSpec] = ()  # effects on torque and encoder
    losses: Losses = field(default_factory=Losses)  # lost frames
    reach: Reach = EVERYWHERE

    def number(self, section: str, name: str, absent: float = 0.0) -> Array | float:
        """Return a field of a model: one value for each scene where it varies, else one number."""
        model = getattr(self.common, section)
        found: Array | float = self.numbers.get(f"{section}.{name}", getattr(model, name, absent))
        return found

    def part(self, rows: slice) -> "BatchCase":
        """Return the batch of some of its scenes, by their rows."""
        some: Any = (v if v is None or len(v) == 1 else v[rows] for v in self.linear or ())
        linear = self.linear and event_plant.LinearMotion(*some)
        numbers = {name: v[rows] if isinstance(v, np.ndarray) else v for name, v in self.numbers.items()}
        return replace(self, numbers=numbers, linear=linear)


class SceneRow(NamedTuple):
    """One scene as the objects that its kernels take."""

    environment: Any  # plain object
    settings: Any  # constants of the algorithm
    loop: LoopSettings


def kernel_of(algorithm: str) -> Kernel | None:
    """Return the kernel of an algorithm; None for a user-defined class that has none."""
    kernel: Kernel | None = getattr(load(ALGORITHMS, algorithm, "passivity algorithm"), "kernel", None)
    return kernel


def scene_rows(case: BatchCase, kernel: Kernel, count: int) -> Iterator[SceneRow]:
    """Yield for every scene the objects that its kernels take.

    Args:
        case: Common part and varied numbers of the scenes.
        kernel: Kernel of the algorithm.
        count: Number of scenes.
    """
    common, before = case.common, list[Any]()
    known: Any = None
    given = {"environment": common.environment, "passivity": common.parameters, "loop": common.loop}
    models = [_models(section, model, case.numbers, count) for section, model in given.items()]
    for loop, *parts in zip(loops_of(case, count), *models, strict=True):
        if known is None or any(part is not last for part, last in zip(parts, before, strict=True)):
            known = parts[0], kernel.settings(*parts)
        before = parts
        yield SceneRow(known[0], known[1], loop)


def _models(section: str, model: Any, numbers: Numbers, count: int) -> Iterator[Any]:
    """Yield a model's plain object for every scene; all scenes share one object if none of its numbers varies."""
    own = {name.removeprefix(f"{section}."): v for name, v in numbers.items() if name.startswith(f"{section}.")}
    columns = {name: values.tolist() for name, values in own.items() if isinstance(values, np.ndarray)}
    fields = {**vars(model), **{name: v for name, v in own.items() if name not in columns}}
    if not columns:
        yield from repeat(plain_with(type(model), fields) if own else plain(model), count)
    for row in zip(*columns.values(), strict=True):
        yield plain_with(type(model), {**fields, **dict(zip(columns, row, strict=True))})


def loops_of(case: BatchCase, count: int) -> list[LoopSettings]:
    """Return each scene's loop settings: delay, encoder, torque limit, meter, signal effects and losses."""
    common, is_random = case.common, case.signals or case.losses.exists
    period = case.number("loop", "sample_time")
    values = {
        "counts_per_unit": common.counts_per_unit or 0.0,
        "torque_quantum": common.torque_quantum or 0.0,
        "torque_limit": common.torque_limit or inf,
        "last_from": 0.0,
        "damping_per_time": common.device_damping / period,
        "damping": case.number("environment", "damping"),
        "is_brief": 0.0,
        "seed": 0.0,
    }
    values |= {name: case.numbers[name] for name in values if name in case.numbers}
    values = {"period": period, **values} if is_random else {"period": 0.0, **values, "seed": 0.0}
    varies = any(isinstance(value, np.ndarray) for value in values.values())
    columns = (np.broadcast_to(value, (count if varies else 1,)).tolist() for value in values.values())
    rows = [
        LoopSettings(
            common.delay, counts, quantum, limit, *case.reach,
            MeterSettings(last_from, per_time, common.device_friction, brief == 1.0, limit, damping),
            event_plant.signals_of(case.signals, time, int(seed)), replace(case.losses, seed=int(seed)),
        )
        for time, counts, quantum, limit, last_from, per_time, damping, brief, seed in zip(*columns, strict=True)
    ]  # fmt: skip
    return rows if varies else rows * count


def linear_plants(motion: event_plant.LinearMotion, *, listed: bool) -> LinearPlants:
    """Return the linear plants of many scenes as kernels take them.

    Args:
        motion: Motion of the plants.
        listed: Whether to use lists, for loops that Python runs, instead of arrays.
    """
    size = motion.starts.shape[1]
    flows = np.ascontiguousarray(motion.flows[:, : size - 2])
    found = flows, motion.starts, np.zeros(size), np.zeros(size - 2), np.zeros(1, dtype=np.int64)
    return LinearPlants(*(array.tolist() for array in found) if listed else found)


def run_loops_of(case: BatchCase, loops: Any, count: int, *, listed: bool) -> dict[int, EventLimitError]:
    """Run all loops of a batch, by plant; return the error of each loop whose plant could not be advanced.

    Args:
        case: The scenes.
        loops: `InterpretedLoops` or `CompiledLoops`.
        count: Number of scenes.
        listed: Whether Python runs the loops.
    """
    if case.linear is not None:
        loops.run(range(count), linear_plants(case.linear, listed=listed), closed_loop.nothing)
        return {}
    which, stopped = np.broadcast_to(case.numbers["plant"], (count,)), dict[int, EventLimitError]()
    for number in np.unique(which).tolist():
        plant = case.plants[int(number)]
        modes = event_plant.EventModes(plant.scene(), plant.simulation.accuracy, listed=listed)

        def stop(plants: Any, loop: int, cycle: int, modes: event_plant.EventModes = modes) -> None:
            stopped[loop] = modes.error(plants, cycle)

        loops.run(np.flatnonzero(which == number).tolist(), modes.motor(), stop)
    return stopped


def why_not_continuous(case: BatchCase) -> str:
    """Return "" if the continuous runs can be computed in step with the loops, else the reason why not."""
    if not isinstance(
        case.common.environment, SpringDamperWall | TwoSidedWall | DamperWall | ViscousMedium | FreeSpace
    ):
        return f"{type(case.common.environment).__name__} has no flow in closed form"
    known = case.linear is not None and case.linear.rates is not None
    return "" if known else "the plant has effects that are not in arrays"


class _Linear(NamedTuple):
    """Plant and continuous wall of many scenes: y' = F y in each mode, y = [states of the plant..., 1]."""

    rates: tuple[Array, ...]  # by mode, each of shape (n, k, k) [1/s]
    start: Array  # shape (n, k)
    lower: Array  # surface of the wall below, -inf for none, shape (n,) [m or rad]
    upper: Array  # surface of the wall above, inf for none
    stiffness: Array  # [N/m or N*m/rad]
    damping: Array  # [N*s/m or N*m*s/rad]
    everywhere: bool  # whether the damper acts in every mode


class ContinuousModes(NamedTuple):
    """Continuous environments of several scenes; the state is y = [states of the plant..., 1], of length k."""

    settings: list[ReferenceSettings]  # one for each scene
    flows: Array  # by mode: y after a step, shape (n, 3, k, k)
    rates: Array  # by mode: y' = F y, shape (n, 3, k, k) [1/s]
    starts: Array  # y at the first SYNC, shape (n, k)

    @property
    def exist(self) -> Any:
        """Whether each scene has continuous modes, shape (n,)."""
        return np.array([settings.exists for settings in self.settings])


class LoopJob(NamedTuple):
    """Loops that share one algorithm and one kind of plant."""

    kernel: Kernel  # algorithm
    rows: Sequence[SceneRow]  # one for each scene
    modes: ContinuousModes  # continuous environments to compare with
    cycles: int  # SYNCs of a run
    instead: Mapping[object, object]  # function of the loop -> its replacement


def no_modes(count: int) -> ContinuousModes:
    """Placeholder for scenes without continuous environments."""
    nothing = np.zeros((1, 3, 1, 1))
    return ContinuousModes([ReferenceSettings()] * count, nothing, nothing, np.zeros((1, 1)))


def continuous_modes(
    case: BatchCase, count: int, cycles: int, *, with_force: bool, with_travel: bool
) -> ContinuousModes:
    """Return the continuous environments of the given scenes.

    Args:
        case: The scenes; `why_not_continuous` must be "".
        count: Number of scenes.
        cycles: Number of SYNCs of the whole run.
        with_force: Whether the force is needed; it is sampled as often as in `continuous.continuous_reference`.
        with_travel: Whether the travel is needed.
    """
    linear = _linear(case, count)
    period = np.broadcast_to(np.asarray(case.number("loop", "sample_time"), dtype=float), (count,))
    readings, last_from = np.ones(count, dtype=np.int64), np.empty(count, dtype=np.int64)
    for value in np.unique(period):
        last_from[period == value] = last_rows(cycles, float(value)).start
        if with_force:
            readings[period == value] = readings_per_hold(round(float(value) * 1e9), cycles)
    angle = 0.5  # largest sum of the rates of a scene times its step [rad]
    steps = 2 ** np.ceil(np.log2(np.maximum(1.0, period * _fastest(linear) / (angle * readings))))
    step = period / (readings * steps)
    flows = {id(rates): _flows(rates, step) for rates in linear.rates}
    columns = (
        (steps * readings <= 4096).tolist(), linear.lower.tolist(), linear.upper.tolist(),
        linear.stiffness.tolist(), linear.damping.tolist(), [linear.everywhere] * count, [with_force] * count,
        [with_travel] * count,
        readings.tolist(), steps.astype(np.int64).tolist(), step.tolist(), last_from.tolist(),
    )  # fmt: skip
    settings = [ReferenceSettings(*row) for row in zip(*columns, strict=True)]
    flow = np.stack([flows[id(rates)] for rates in linear.rates], axis=1)
    return ContinuousModes(settings, flow, np.stack(linear.rates, axis=1), linear.start)


def _flows(rates: Array, step: Array) -> Array:
    """Return the transition matrices exp(F h) of many scenes, shape (n, k, k); equal scenes are computed once."""
    which: Any = slice(None)
    if (rates == rates[0]).all():
        step, which = np.unique(step, return_inverse=True)
    found: Array = (np.eye(rates.shape[1]) + flow_changes(rates[: len(step)] * step[:, None, None]))[which]
    return found


def _linear(case: BatchCase, count: int) -> _Linear:
    def number(name: str) -> Array:
        return np.array(np.broadcast_to(case.number("environment", name), (count,)), dtype=float)

    motion, environment = cast(event_plant.LinearMotion, case.linear), case.common.environment
    states = motion.starts.shape[1] - 2
    known, kept = cast(Array, motion.rates), [*range(states), states + 1]  # all but the held torque
    free = np.broadcast_to(known[:, kept][:, :, kept], (count, states + 1, states + 1)).copy()
    start = np.broadcast_to(motion.starts[:, kept], (count, states + 1)).copy()
    share = np.broadcast_to(known[:, 1, states], (count,))  # 1 / mass
    stiffness, damping = number("stiffness"), number("damping")
    lower, upper = np.full(count, -np.inf), np.full(count, np.inf)
    everywhere = isinstance(environment, ViscousMedium)
    if everywhere:
        free[:, 1, 1] -= share * damping
    elif isinstance(environment, TwoSidedWall):
        lower, upper = number("lower"), number("upper")
    elif isinstance(environment, SpringDamperWall | DamperWall):
        surface = number("position")
        lower, upper = (surface, upper) if environment.side == "below" else (lower, surface)
    rates = [free]
    for surface in (lower, upper):
        if not np.isfinite(surface).any():
            rates.append(free)  # a mode that nothing enters
            continue
        inside = free.copy()
        inside[:, 1, 0] -= share * stiffness
        inside[:, 1, 1] -= share * damping
        inside[:, 1, states] += share * stiffness * np.where(np.isfinite(surface), surface, 0.0)
        rates.append(inside)
    return _Linear(tuple(rates), start, lower, upper, stiffness, damping, everywhere)


def _fastest(linear: _Linear) -> Array:
    """Upper bound on the angular frequencies in each scene, of oscillation and of the hand's motion [rad/s]."""
    found = np.zeros(len(linear.lower))
    for rates in linear.rates:
        hand = np.abs(rates[:, 2:-1]).max(axis=(1, 2)) if rates.shape[1] > 3 else 0.0
        found = np.maximum(found, np.sqrt(np.abs(rates[:, 1, 0])) + np.abs(rates[:, 1, 1]) + hand)
    return found


def why_not_batchable(scene: Scene) -> str:
    """Return "" if the whole loop of a scene can run in a batch, else the reason, which names the part.

    For example "algorithm X is own code" or "scene has 2 axes, expected one".

    Args:
        scene: Valid scene; the result depends on the types in it, not on its numbers.
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
    """Return "" if a loop can be compiled together with its plant, else the reason, which names the part."""
    if case.simulation is None:
        return "the plant does not come from a scene"
    reason = _why_not_moved(case.simulation, case.algorithm, case.own)
    if reason:
        return reason
    if getattr(case.environment, "damps_by_place", False):
        return "environment is a sum, which no compiled loop renders"
    if plain(case.environment) is case.environment:
        return f"environment {type(case.environment).__name__} has no plain form (it calls its base class with super())"
    return "" if kernel_of(case.algorithm) else f"algorithm {case.algorithm} is not written as a kernel"


def why_not_compared(scene: Scene, metrics: Sequence[str]) -> str:
    """Return "" if a batch can compute some metrics of a scene, else the reason why not."""
    if set(metrics).isdisjoint(CONTINUOUS) or event_plant.is_linear(simulation_of(scene.axes[0])):
        return ""
    return "a plant with events has its continuous run by itself"


def why_not_beforehand(scene: Scene) -> str:
    """Return the reasons of `why_not_batchable` that can be found without building a controller."""
    if scene.groups:
        return f"group {scene.groups[0].name!r} renders on {len(scene.groups[0].axes)} axes together"
    if len(scene.axes) != 1:
        return f"scene has {len(scene.axes)} axes, expected one"
    simulation = scene.axes[0].simulation
    if simulation is None or scene.ports[0].causality is not IMPEDANCE:
        return "admittance displays run one by one" if simulation else "axis is not simulated"
    if scene.axes[0].environment.parts:
        return f"environment {scene.axes[0].environment.name} is a sum, which no compiled loop renders"
    if scene.axes[0].environment.own is not None:
        return f"environment {scene.axes[0].environment.name} is own code"
    return _why_not_moved(simulation, scene.axes[0].passivity.name, scene.axes[0].passivity.own)


def _why_not_moved(simulation: AxisSimulation, algorithm: str, own: type[Any] | None) -> str:
    if own is not None:
        return f"algorithm {algorithm} is own code"
    if simulation.user is not None and not simulation.user.has_equations:
        return "the hand is own code or a recording"
    return event_plant.why_not_in_loop(simulation)


def batch_case(scene: Scene, varied: Mapping[str, Array]) -> BatchCase:
    """Return the batch of a scene of one axis with varied keys.

    Args:
        scene: Common part of the scenes, with their common delay.
        varied: Key of `BATCH_KEYS`, except `loop.delay` -> value of each scene.
    """
    axis = scene.axes[0]
    passivity, numbers = axis.passivity.parameters, dict[str, Array | float]()
    for key, values in varied.items():
        section, name = split_key(key)
        if section == "passivity":
            numbers[f"{'passivity' if name in type(passivity).model_fields else 'loop'}.{name}"] = values
        elif section == "environment":
            numbers[key] = values
        elif section == "axes.0":
            numbers |= _of_axis(name, values)
    return replace(many_loops(loop_case(axis, scene), numbers, varied), losses=losses_of(scene))


def losses_of(scene: Scene) -> Losses:
    """Return the frame losses of a scene's bus; none if they are limited to some COB-IDs, times or buses."""
    effects = scene.bus_effects
    if effects is None or not effects.drop or effects.ids or effects.during or effects.buses:
        return Losses()
    share, burst = effects.drop, effects.drop_burst
    after_heard = share if burst is None else share / (burst * (1.0 - share))
    after_lost = share if burst is None else 1.0 - 1.0 / burst
    to_drive, to_master = (effects.direction in ("both", name) for name in ("to_drive", "to_master"))
    return Losses(True, after_heard, after_lost, to_drive, to_master)


def not_in_loop(scene: Scene, *, is_batched: bool) -> str:
    """Return a note that names the bus effects which a loop without a bus omits; "" for none."""
    if scene.bus_effects is None:
        return ""
    passed = ("drop",) if is_batched and losses_of(scene).exists else ()
    left_out = ", ".join(name for name in scene.bus_effects.named if name not in passed)
    return f"not in this loop: simulation.bus {left_out}; canhaptic run includes it" if left_out else ""


def many_loops(case: LoopCase, numbers: Numbers, varied: Mapping[str, Array]) -> BatchCase:
    """Return the batch of a loop with varied numbers.

    Args:
        case: Common part of the loops; `why_not_compiled` must be "".
        numbers: Varied numbers, with the names of `BatchCase.numbers`.
        varied: Key of `BATCH_KEYS` under `simulation.`, or `bus.rate` -> value of each scene.
    """
    simulation, period = cast(AxisSimulation, case.simulation), float(case.sample_time_ns)
    found: dict[str, Array | float] = {"seed": float(simulation.seed)}
    ticks: Array | float = np.rint(1e9 / varied["bus.rate"]) if "bus.rate" in varied else period
    if "bus.rate" in varied:
        found["loop.sample_time"] = ticks * 1e-9
    found["damping_per_time"] = _device_damping(case, simulation, varied) / (ticks * 1e-9)
    linear, plants = None, list[event_plant.PlantValues]()
    signals = [effect for effect in simulation.effects if effect.name in event_plant.SIGNAL_EFFECTS]
    if event_plant.is_linear(simulation):
        linear = event_plant.linear_motion(simulation, ticks, varied)
    else:
        plants, which = event_plant.distinct_plants(simulation, ticks, varied)
        found["plant"] = which.astype(float)
    return BatchCase(case, {**found, **numbers}, linear, plants, signals)


def _device_damping(case: LoopCase, simulation: AxisSimulation, varied: Mapping[str, Array]) -> Array | float:
    """Return the certain damping of the device, by the rule of `loop_case` [N*s/m or N*m*s/rad]."""
    if "passivity.device_damping" in varied:
        return varied["passivity.device_damping"]
    if "simulation.plant.damping" in varied and case.loop.device_damping is None:
        return varied["simulation.plant.damping"] + (case.device_damping - simulation.plant.damping)
    return case.device_damping


def _of_axis(name: str, values: Array) -> dict[str, Array]:
    if name == "counts_per_unit":
        return {"counts_per_unit": values, "loop.encoder_count": 1.0 / values}
    if name == "rated_torque":
        return {"torque_quantum": values * 1e-3, "loop.torque_quantum": values / 1000.0}
    return {"torque_limit": values, "loop.torque_limit": values}


def check_values(scene: Scene, varied: Mapping[str, Array]) -> int:
    """Check the scenes with the least and the largest value of each key; return the number of scenes.

    Raises:
        ParameterError: A key cannot vary, values differ in number, are not finite or out of range, or the algorithm
            needs a value that the scene does not give.
    """
    lengths = {key: np.shape(values) for key, values in varied.items()}
    if len(set(lengths.values())) > 1 or any(len(shape) != 1 or shape[0] == 0 for shape in lengths.values()):
        raise ParameterError(f"varied: got shapes {lengths}, expected one (n_scenes,) for all, n_scenes > 0")
    rows = {0}
    for key, values in varied.items():
        split_key(key)
        if not np.isfinite(values).all():
            raise ParameterError(f"varied: got a {key} that is not finite, expected numbers in SI")
        rows |= {int(np.argmin(values)), int(np.argmax(values))}
    for row in sorted(rows):
        one = scene_with(scene, {key: float(values[row]) for key, values in varied.items()})
        loop_case(one.axes[0], one).controller()
    return max([1, *(len(values) for values in varied.values())])
