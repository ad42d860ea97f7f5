"""Judge many scenes in one call: run their loops (`run_batch`), or solve linear ones (`spectral_radius`).

Neither the engine nor the size of the parts changes a figure. `InterpretedLoops` runs the loops in Python, where numba
is missing and as the reference for compiled loops.

A wall in permanent contact makes the loop linear. With z = [q, v, previous q, delayed torque] one hold is a matrix; the
loop is stable if all its eigenvalues are inside the unit circle. This maps 10^4 scenes without running one; a scene
with events must be run.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np

from canhaptic.control.environments import Environment
from canhaptic.errors import EventLimitError, ParameterError
from canhaptic.kernels import Run, list_of_zeros
from canhaptic.lab.batch import WORTH_COMPILING, Engine, cases, chosen_engine, closed_loop, continuous_run
from canhaptic.lab.batch.cases import NotBatchableError
from canhaptic.lab.batch.plants import Plants, Stopped, loop_replacements
from canhaptic.lab.batch.varied import scene_with
from canhaptic.lab.figures.figures import ALL, METRICS, last_rows, metrics_of, sums_of
from canhaptic.lab.figures.meter import BRIEF, Meter
from canhaptic.lab.loop.axis_loop import environment_of, viscous_friction
from canhaptic.scene.models import AxisSimulation, Scene
from canhaptic.sim.plant.propagator import Array, flow_changes
from canhaptic.sim.plant.user import UserParameters


class InterpretedLoops:
    """Runs loops one after the other, in Python.

    Attributes:
        meters: Meter of each scene.
        references: State of each scene's continuous run.
    """

    def __init__(self, job: cases.LoopJob) -> None:
        self._kernel, self._rows, self._modes, self._cycles, instead = job
        self._instead = {**instead, closed_loop.step: self._kernel.step}
        self.meters = [Meter() for _ in self._rows]
        self.references = [continuous_run.ReferenceState() for _ in self._rows]

    def run(self, some: Sequence[int], plants: Plants, stopped: Stopped) -> None:
        """Run the loops of the given scenes; `meters` then holds their sums.

        Args:
            some: Indices of the scenes.
            plants: Plants of the scenes.
            stopped: Called for each plant that cannot be advanced: (plants, index of the scene, SYNC it cannot reach).
        """
        motors_at: Any = self._instead.get(closed_loop.motors_at, closed_loop.motors_at)
        for number, i in enumerate(some):
            row, kernel = self._rows[i], self._kernel
            run = Run(row.settings, kernel.state(), kernel.memory(row.settings, list_of_zeros))
            continuous = continuous_run.Continuous(
                self._modes.settings[i], self.references[i], reference_memory_of(self._modes, i)
            )
            cycle = closed_loop.run_in_python(
                self._instead, closed_loop.Control(row.environment, run), [row.loop], motors_at(plants, number),
                continuous, self.meters[i], self._cycles,
            )  # fmt: skip
            if cycle:
                stopped(plants, i, cycle)


def reference_memory_of(modes: cases.ContinuousModes, row: int) -> continuous_run.ReferenceMemory:
    """Return the matrices and buffers of one scene's continuous run, as lists."""
    flows, rates, starts = (values[row % len(values)].tolist() for values in modes[1:])
    return continuous_run.ReferenceMemory(
        flows, rates, starts, list(starts), [[0.0] * len(starts) for _ in range(continuous_run.TERMS)]
    )


_MOST: Final = 8192
"""Scenes that are laid out in memory at a time."""
_FORCES: Final = ("continuous", "force_squares", "force_worst")
_TRAVELS: Final = ("continuous_travel", "continuous_rest")
_COMPARED: Final = (*_TRAVELS, "position_squares", "position_worst", *_FORCES)
"""Sums that need a continuous run; `_FORCES` need its force as well, `_TRAVELS` its travel."""


def march(
    case: cases.BatchCase,
    scenes: int,
    cycles: int,
    engine: Engine,
    metrics: Sequence[str],
    stopped: dict[int, str] | None = None,
) -> dict[str, Array]:
    """Run many loops; return each metric with shape (n_scenes,), in the order of the scenes.

    Args:
        case: Common part of the loops, and the numbers in which they differ.
        scenes: Number of scenes.
        cycles: Number of SYNCs of a run, the first included.
        engine: See `run_batch`.
        metrics: Names of `ALL`.
        stopped: Filled with the reason for each scene whose plant could not be advanced; its metrics are NaN.

    Raises:
        NotBatchableError: The algorithm is not written as a kernel, or numba cannot compile the environment.
    """
    names = list(metrics)
    failed: dict[int, str] = {}
    found: dict[str, Array] = {name: np.empty(scenes) for name in sums_of(names)}
    brief = float(BRIEF.union(_COMPARED).issuperset(found))
    period = np.asarray(case.number("loop", "sample_time"), dtype=float)
    last_from = np.vectorize(lambda time: float(last_rows(cycles, time).start), otypes=[float])(period)[()]
    case = replace(case, numbers={**case.numbers, "last_from": last_from, "is_brief": brief})
    chosen = chosen_engine(engine, scenes * cycles >= WORTH_COMPILING)
    for first in range(0, scenes, _MOST):
        part = slice(first, min(first + _MOST, scenes))
        sums, ended = _part(case.part(part), part.stop - first, cycles, chosen, found)
        for name, values in sums.items():
            if name in found:
                found[name][part] = values
        for row, error in ended.items():
            failed[first + row] = str(error).splitlines()[0]
    metrics_found = metrics_of(names, found)
    for values in metrics_found.values():
        values[list(failed)] = np.nan
    if stopped is not None:
        stopped |= failed
    return metrics_found


def _part(
    case: cases.BatchCase, count: int, cycles: int, engine: str, asked: Mapping[str, Array]
) -> tuple[dict[str, Array], dict[int, EventLimitError]]:
    kernel = cases.kernel_of(case.common.algorithm)
    if kernel is None:
        raise NotBatchableError(f"algorithm {case.common.algorithm} is not written as a kernel")
    modes = cases.no_modes(count)
    if not {*asked}.isdisjoint(_COMPARED) and not cases.why_not_continuous(case):
        forces, travels = (not {*asked}.isdisjoint(some) for some in (_FORCES, _TRAVELS))
        modes = cases.continuous_modes(case, count, cycles, with_force=forces, with_travel=travels)
    listed = engine == "python"
    rows = list(cases.scene_rows(case, kernel, count))
    instead = loop_replacements([plant.scene() for plant in case.plants[:1]])
    if modes.exist.any():
        instead[closed_loop.watch] = continuous_run.watch_continuous
    job = cases.LoopJob(kernel, rows, modes, cycles, instead)
    if listed:
        loops: Any = InterpretedLoops(job)
    else:
        from canhaptic.lab.batch.compiled_loops import CompiledLoops

        loops = CompiledLoops(job)
    stopped = cases.run_loops_of(case, loops, count, listed=listed)
    sums, runs = _columns(loops.meters), _columns(loops.references)
    compared = {
        **{name: sums[name] for name in _COMPARED if name in sums},
        "continuous_travel": runs["highest"] - runs["lowest"],
        "continuous_rest": runs["last_highest"] - runs["last_lowest"],
        "continuous": runs["variation"],
    }
    return sums | {name: np.where(modes.exist, values, np.nan) for name, values in compared.items()}, stopped


def _columns(found: Any) -> dict[str, Array]:
    if isinstance(found, np.ndarray):
        return {name: np.array(found[name]) for name in found.dtype.names or ()}
    return {name: np.array([getattr(one, name) for one in found]) for name in type(found[0]).__slots__}


def run_batch(
    scene: Scene,
    varied: Mapping[str, Array],
    cycles: int,
    engine: Engine = "auto",
    metrics: Sequence[str] | None = None,
    *,
    seeds: Array | None = None,
    stopped: dict[int, str] | None = None,
) -> Mapping[str, Array]:
    """Run many scenes of one axis; return each figure with shape (n_scenes,).

    Args:
        scene: Common part of the scenes; `why_not_batchable(scene)` must be "".
        varied: Key of `BATCH_KEYS` -> value of each scene, shape (n_scenes,), in SI.
        cycles: Number of SYNCs, at least 2.
        engine: "numba" needs the extra `fast`; "auto" takes it where it is installed and saves time, else "python".
        metrics: Names of `ALL`; None for `METRICS`. Those of `CONTINUOUS` also compute a continuous run for each scene,
            and are NaN where that has no closed form.
        seeds: Seed of the random numbers of each scene, shape (n_scenes,); by default the scene's seed.
        stopped: Filled with the reason for each scene whose plant could not be advanced; its figures are NaN.

    Raises:
        ParameterError: A key cannot vary inside a batch, a value is out of its range, or a metric is unknown.
        NotBatchableError: The scene cannot run in a batch.
    """
    names = list(METRICS) if metrics is None else list(metrics)
    unknown = [name for name in names if name not in ALL]
    if unknown or cycles < 2:
        raise ParameterError(f"run_batch: got metrics {unknown} and {cycles} cycles; expected {list(ALL)}, 2 or more")
    arrays = {key: np.asarray(values, dtype=float) for key, values in varied.items()}
    reason = cases.why_not_beforehand(scene)
    if reason:
        raise NotBatchableError(f"{scene.source}: {reason}; run such scenes one by one with run_scalar")
    count = cases.check_values(scene, arrays)
    found = {name: np.empty(count) for name in names}
    delays = arrays.pop("loop.delay", None)
    for delay in [None] if delays is None else sorted({*delays.tolist()}):
        rows = np.arange(count) if delays is None else np.flatnonzero(delays == delay)
        of_delay = scene if delay is None else scene_with(scene, {"loop.delay": delay})
        case = cases.batch_case(of_delay, {key: np.ascontiguousarray(values[rows]) for key, values in arrays.items()})
        if seeds is not None:
            case = replace(case, numbers={**case.numbers, "seed": seeds[rows].astype(float)})
        ended: dict[int, str] = {}
        for name, values in march(case, len(rows), cycles, engine, names, ended).items():
            found[name][rows] = values
        if stopped is not None:
            stopped |= {int(rows[row]): reason for row, reason in ended.items()}
    return found


class Loops(NamedTuple):
    """Parameters of many loops, each one number or of shape (n_loops,)."""

    mass: Array | float  # [kg or kg*m^2]
    damping: Array | float  # of bearings and hand together [N*s/m or N*m*s/rad]
    hand_stiffness: Array | float  # [N/m or N*m/rad]
    wall_stiffness: Array | float  # [N/m or N*m/rad]
    wall_damping: Array | float  # on the backward difference of the position [N*s/m or N*m*s/rad]


def loop_matrices(loops: Loops, sample_time: Array | float, delay: int) -> Array:
    """Return the matrix of one hold of each loop, shape (n_loops, 3 + delay, 3 + delay).

    Args:
        loops: Loops, broadcast against each other.
        sample_time: T, one or of shape (n_loops,) [s].
        delay: Whole holds between the computation of a torque and the hold in which it acts, 0 or 1.

    Raises:
        ParameterError: A mass or sample time is not positive, or the delay is neither 0 nor 1.
    """
    columns = [np.atleast_1d(value) for value in (*loops, sample_time)]
    mass, damping, hand, stiffness, viscosity, period = np.broadcast_arrays(*columns)
    if delay not in (0, 1) or not np.all(period > 0.0) or not np.all(mass > 0.0):
        raise ParameterError(
            f"stability of a loop: got delay {delay}, least sample time {period.min()} s and least mass {mass.min()}, "
            "expected delay 0 or 1, sample time > 0 and mass > 0"
        )
    rates = np.zeros((len(mass), 3, 3))  # of [q, v, held torque]
    rates[:, 0, 1] = 1.0
    rates[:, 1] = np.stack([-hand / mass, -damping / mass, 1.0 / mass], axis=1)
    change = flow_changes(rates * period[:, None, None])
    size = 3 + delay  # [q, v, q before] and, with a delay, the torque that waits
    matrices = np.zeros((len(mass), size, size))
    law = np.zeros((len(mass), size))  # torque computed from the state at a SYNC
    law[:, 0], law[:, 2] = -stiffness - viscosity / period, viscosity / period
    held = law
    if delay:
        held = np.zeros_like(law)
        held[:, 3] = 1.0
        matrices[:, 3] = law
    matrices[:, :2, :2] = np.eye(2) + change[:, :2, :2]
    matrices[:, :2] += change[:, :2, 2:] * held[:, None, :]
    matrices[:, 2, 0] = 1.0
    return matrices


def decay_per_hold(loops: Loops, sample_time: Array | float, delay: int) -> Array:
    """Return the largest absolute eigenvalue of each loop, shape (n_loops,); below 1 it is stable."""
    return np.asarray(np.abs(np.linalg.eigvals(loop_matrices(loops, sample_time, delay))).max(axis=1))


def _linear_loop(scene: Scene, varied: Mapping[str, Array]) -> tuple[AxisSimulation, Environment, float]:
    """Return simulation, environment and stiffness [N/m or N*m/rad] of a scene; refuse a loop that is not linear."""
    axis = scene.axes[0]
    if len(scene.ports[0].axes) > 1:
        raise ParameterError(f"{scene.source}: spectral radius: expected one axis, got several; run the scenes instead")
    simulation, environment = axis.simulation, environment_of(axis)
    if simulation is None or len(scene.axes) != 1:
        raise ParameterError(f"{scene.source}: spectral radius: expected one axis, simulated; give it `simulation`")
    stiffness = environment.linear_stiffness
    if stiffness is None or "environment.hardening" in varied:
        raise ParameterError(
            f"{scene.source}: spectral radius: {axis.environment.name} has no linear stiffness; run the scenes instead"
        )
    if simulation.user is not None and not simulation.user.has_equations:
        raise ParameterError(f"{scene.source}: spectral radius: own code or a recording moves the hand; run the scenes")
    for effect in simulation.effects:
        if effect.name not in ("viscous_friction", "tremor"):  # which moves the hand: no part in stability
            raise ParameterError(f"{scene.source}: spectral radius: effect {effect.name} is not modelled; leave it out")
    return simulation, environment, stiffness


def spectral_radius(scene: Scene, varied: Mapping[str, Array]) -> Array:
    """Return the largest |eigenvalue| of one hold of each linear sampled loop, shape (n_scenes,): stable below 1.

    The environment counts as permanently in contact (a wall: on both sides). It is rendered by `unprotected` with the
    velocity of the last hold, at the delay of the scene, without encoder steps and limits.

    Args:
        scene: Scene with one axis, a linear plant and hand, and an environment with a linear stiffness.
        varied: Key of `BATCH_KEYS` -> value of each scene, shape (n_scenes,), in SI.

    Raises:
        ParameterError: The scene has no linear loop, or a key cannot vary.
    """
    simulation, environment, stiffness = _linear_loop(scene, varied)
    count, user = cases.check_values(scene, varied), simulation.user or UserParameters()

    def number(key: str, value: float) -> Any:
        return varied.get(key, value)

    damping = number("simulation.plant.damping", simulation.plant.damping)
    damping = damping + number("simulation.user.damping", user.damping) + viscous_friction(simulation)
    loops = Loops(
        number("simulation.plant.mass", simulation.plant.mass),
        damping,
        number("simulation.user.stiffness", user.stiffness),
        number("environment.stiffness", stiffness),
        number("environment.damping", environment.damping),
    )
    period: Any = scene.bus.sample_time_ns * 1e-9
    if "bus.rate" in varied:
        period = np.rint(1e9 / varied["bus.rate"]) * 1e-9
    delays = np.broadcast_to(varied.get("loop.delay", float(scene.bus.delay)), (count,))
    columns, found = [np.broadcast_to(value, (count,)) for value in (*loops, period)], np.empty(count)
    for delay in np.unique(delays).tolist():
        rows = np.flatnonzero(delays == delay)
        *part, time = (column[rows] for column in columns)
        found[rows] = decay_per_hold(Loops(*part), time, int(delay))
    return found
