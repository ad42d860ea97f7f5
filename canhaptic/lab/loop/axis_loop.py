"""Loops without a bus: the case of one torque axis, made from a scene, and the result, a record of every hold.

`loop_case` makes a case from a scene. `under` exchanges the algorithm of a scene: common parameters are kept, and
properties that it needs and the scene does not declare are taken from the simulated plant.

`microseconds_per_step` measures the time of a step. Times are valid for one machine at one moment; they compare the
columns of one table and are never a pass mark.
"""

from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Final, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from canhaptic.audit.why.ripple import variation
from canhaptic.control.balance import Branch, EnergyBalance, residual
from canhaptic.control.environments import Environment
from canhaptic.control.ledger import Ledger, LedgerSummary
from canhaptic.control.passivity import Controller, LoopProperties, build_controller
from canhaptic.drive.clock import ProcessorClock
from canhaptic.drive.profile.causality import IMPEDANCE
from canhaptic.errors import InputError, ParameterError
from canhaptic.kernels import new
from canhaptic.scene.components import ComponentOf, ComponentSpec
from canhaptic.scene.far_side import build_plant
from canhaptic.scene.method import simulation_of
from canhaptic.scene.models import ALGORITHM, FAR, AxisScene, AxisSimulation, MechanismScene, Port, Scene
from canhaptic.scene.parts import controller_of
from canhaptic.sim.plant.plant import Plant
from canhaptic.units import Parameters

Array = NDArray[np.float64]

FURTHEST: Final = 1e3
"""Distance from the origin that counts as divergence where the range of the motion is unknown [m or rad]."""
_APART: Final = (Branch.FREE.value, Branch.EXIT.value)


@dataclass(frozen=True, slots=True)
class LoopCase:
    """One algorithm, one environment, one plant, and the loop between them.

    `loop` holds the assumptions of the algorithm; all other values are those of the simulation.
    """

    environment: Environment
    algorithm: str
    parameters: Parameters | None
    loop: LoopProperties
    make_plant: Callable[[], Plant]
    sample_time_ns: int
    delay: int  # whole holds, 0 or 1
    counts_per_unit: float | None = None  # None: ideal encoder
    torque_quantum: float | None = None  # None: ideal torque [N or N*m]
    torque_limit: float | None = None  # largest torque of the drive [N or N*m]
    device_damping: float = 0.0  # certain damping of the device [N*s/m or N*m*s/rad]
    own: type[Any] | None = None  # user-defined algorithm, in place of `algorithm`
    device_friction: float = 0.0  # certain Coulomb friction of the device in motion [N or N*m]
    simulation: AxisSimulation | None = None  # description of the plant; None where a compiled loop cannot move it

    def controller(self) -> Controller:
        """Return the algorithm, at rest."""
        if self.own is not None:
            controller: Controller = self.own(self.environment, self.parameters, self.loop)
            return controller
        return build_controller(self.environment, self.algorithm, self.parameters, self.loop)


class Reach(NamedTuple):
    """Range of positions; an axis outside of it has diverged."""

    lowest: float = -FURTHEST  # [m or rad]
    highest: float = FURTHEST

    @classmethod
    def around(cls, motion: Array) -> "Reach":
        """Return a reach of ten times the range of a known motion, shape (n,) [m or rad], around its centre."""
        lowest, highest = float(motion.min()), float(motion.max())
        centre, furthest = 0.5 * (lowest + highest), 10.0 * max(highest - lowest, 5e-3)
        return cls(centre - furthest, centre + furthest)


EVERYWHERE: Final = Reach()


@dataclass(frozen=True)
class LoopRun:
    """Result of one run; row k belongs to SYNC k. Energies are sums since the start [J]."""

    rows: Array  # columns: true energy received; measured positions, true positions and torques of the motors; balance
    axes: int | None = None  # motors, whose columns have shape (n, axes); None: one, shape (n,)
    ended: str = ""  # "" if the run is complete, else "diverged" or "stopped"
    reason: str = ""  # why it was stopped
    engine: str = "python"  # python or numba; with ": " and the reason if it is not the requested one
    motion: Array = field(default_factory=lambda: np.empty((0, 1, 3)))  # true position, velocity, force of each axis
    resolution: float = 0.0  # uncertainty of the energy, where the drives show forces [J]

    @property
    def position(self) -> Array:
        """Positions that the controller received [m or rad]."""
        return self._of_motors(0)

    @property
    def true_position(self) -> Array:
        """True positions [m or rad]."""
        return self._of_motors(1)

    @property
    def torque(self) -> Array:
        """Torques applied in the hold that ended at SYNC k [N or N*m]."""
        return self._of_motors(2)

    @property
    def interaction(self) -> Array:
        """Energy received since the start, by the plant: the true sum of h_i, shape (n,) [J]."""
        return self.rows[:, 0]

    @cached_property
    def booked(self) -> Any:
        """Balances of the controller: an `EnergyBalance` whose fields are columns of shape (n,)."""
        return EnergyBalance(*self.rows[:, -len(EnergyBalance._fields) :].T)

    def balances(self) -> Iterator[EnergyBalance]:
        """Yield the balance of every SYNC."""
        for row in self.rows[:, -len(EnergyBalance._fields) :].tolist():
            balance = new(EnergyBalance, row)
            yield balance._replace(branch=int(balance.branch), certificate=int(balance.certificate))

    @cached_property
    def believed(self) -> Array:
        """Sum of h_i since the start, as booked by the controller, shape (n,) [J]."""
        return np.cumsum(self.booked.h_i)

    @cached_property
    def dissipated(self) -> Array:
        """Sum of h_r since the start, as booked by the controller, shape (n,) [J]."""
        return np.cumsum(self.booked.h_r)

    @property
    def damping(self) -> Array:
        """Rendered damping, NaN out of contact, shape (n,) [N*s/m or N*m*s/rad]."""
        return np.where(np.isin(self.booked.branch, _APART), np.nan, self.booked.damping_rendered)

    @cached_property
    def summary(self) -> LedgerSummary:
        """Energy account of the run: sums and extremes."""
        ledger = Ledger()
        for cycle, balance in enumerate(self.balances()):
            ledger.add(balance, cycle)
        return ledger.summary()

    @property
    def residual(self) -> float:
        """Largest residual of the balance of a hold, over the largest term of that hold (A1)."""
        booked = self.booked
        before: Any = np.concatenate([[0.0], booked.h_s])[:-1]
        terms = (before, booked.h_s, np.abs(booked.h_i), booked.h_r, booked.gen, booked.deficit, booked.leak)
        largest, left = np.max(terms, axis=0), np.abs(residual(booked, before))
        return float(np.divide(left, largest, out=np.zeros_like(left), where=largest > 0.0).max(initial=0.0))

    @property
    def least_interaction(self) -> float:
        """Least true sum of h_i after any hold, eq. 3 [J]."""
        return float(self.interaction.min(initial=0.0))

    @property
    def least_margin(self) -> float:
        """Least true sum of h_i minus booked sum of h_r after any hold, eq. 4 [J]."""
        return float((self.interaction - self.dissipated).min(initial=0.0))

    @property
    def believed_error(self) -> float:
        """Largest |accounted - true| sum of h_i after any hold [J]."""
        return float(np.abs(self.believed - self.interaction).max(initial=0.0))

    @property
    def variation(self) -> float:
        """Total variation of the torque, with the first step from zero [N or N*m]."""
        return variation(self.torque, 0.0)

    def _of_motors(self, which: int) -> Array:
        axes = self.axes or 1
        found = self.rows[:, 1 + which * axes : 1 + (which + 1) * axes]
        return found if self.axes else found[:, 0]


class Recorder:
    """Records every SYNC of a run, without a bus or over CAN.

    Args:
        axes: Number of motors; None for columns of shape (n,).
        tick: Called at every SYNC.
    """

    def __init__(self, axes: int | None = None, tick: Callable[[], None] | None = None) -> None:
        self._flat, self._axes, self._tick = array("d"), axes, tick

    def take(
        self, interaction: float, position: Sequence[float], true_position: Sequence[float], torque: Sequence[float],
        balance: EnergyBalance,
    ) -> None:  # fmt: skip
        """Record one SYNC, in the order of `LoopRun.rows`."""
        self._flat.extend((interaction, *position, *true_position, *torque, *balance))
        if self._tick is not None:
            self._tick()

    def run(self, ended: str = "", reason: str = "") -> LoopRun:
        """Return the rows recorded so far as a `LoopRun`."""
        width = 1 + 3 * (self._axes or 1) + len(EnergyBalance._fields)
        return LoopRun(np.array(self._flat).reshape(-1, width), self._axes, ended, reason)


def finished(run: LoopRun, cycles: int, reach: Reach) -> LoopRun:
    """Return a run with `ended` and `reason` filled in: it diverged, was stopped, or is complete.

    Args:
        run: Run, with its reason if the controller stopped it.
        cycles: Number of SYNCs that were requested.
        reach: Range of positions that do not count as divergence.
    """
    last = run.rows[-1:, 1 + (run.axes or 1) :][:, : run.axes or 1]
    if not ((last > reach.lowest) & (last < reach.highest)).all():
        return replace(run, ended="diverged", reason="")
    if not run.reason and len(run.rows) < cycles:
        return replace(run, ended="stopped", reason="a position or a torque is not finite")
    return run


def cycles_of(scene: Scene, duration: float | None) -> int:
    """Return the number of SYNCs in a duration [s], at least 2; None: the duration of the scene."""
    return max(2, round((duration or scene.run.duration or 5.0) / scene.bus.sample_time))


def require_design_room(margin: float, tolerance: float) -> None:
    """Refuse a margin or a tolerance of a design that is out of range.

    Raises:
        InputError: A value is out of range.
    """
    if not 0.0 <= margin <= 10.0 or not 0.0 < tolerance < 1.0:
        raise InputError(
            f"got margin {margin:g} and tolerance {tolerance:g}, expected 0 <= margin <= 10, 0 < tolerance < 1"
        )


def require_single_axes(scene: Scene, command: str) -> None:
    """Refuse a scene with groups, admittance displays or a far side.

    Args:
        scene: Scene of the study.
        command: Command of the study, for the message.

    Raises:
        InputError: A group renders on an axis, or an axis is an admittance display or coupled with a far side.
    """
    require_near(scene)
    for port in scene.ports:
        if port.section or port.causality.holds:
            raise InputError(
                f"{scene.source}: {port.name}: is no torque axis by itself; {command} judges one such axis at a time; "
                "use canhaptic run, touch, compare, sweep, design, accuracy, check or inspect"
            )


def require_near(scene: Scene) -> None:
    """Refuse a scene whose torques come from a far side or a world.

    Raises:
        InputError: An axis is coupled with one.
    """
    for name in (axis.parameters.name for axis in scene.axes if axis.guard == FAR):
        raise InputError(
            f"{scene.source}: axis {name} is coupled with a far side or a world, expected an environment in this "
            "scene: a study runs one loop by itself; canhaptic run runs both sides"
        )


def parts_of(scene: Scene) -> dict[str, Scene]:
    """Split a scene into its ports: name -> scene with only that port."""
    return {port.name: scene.alone(port) for port in scene.ports}


def mechanism_moved(scene: Scene) -> MechanismScene | None:
    """Return the mechanism of a scene with one port; None where each of its axes has a separate plant.

    Raises:
        InputError: The mechanism also moves other axes, or not all axes of the port.
    """
    names = [axis.parameters.name for axis in scene.axes]
    if not scene.mechanisms:
        return None
    (of, *others) = scene.mechanisms
    if others or set(of.axes) != set(names):
        raise InputError(
            f"{scene.source}: group {scene.ports[0].name!r} moves the axes {', '.join(names)}, its mechanism "
            f"{', '.join(of.axes)}; expected the same axes: use canhaptic run, which moves all of them"
        )
    return of


def at_rate(scene: Scene, rate: float) -> Scene:
    """Return a scene at another rate [Hz], without a check of the bus load.

    `torque_window` is limited to half a hold, so that a torque always acts in the first half of its hold.

    Raises:
        ParameterError: The rate is out of range.
    """
    bus = type(scene.bus)(**{**scene.bus.model_dump(), "rate": rate})
    time, axes = bus.sample_time, []
    for axis in scene.axes:
        window = axis.loop.torque_window and min(axis.loop.torque_window, 0.5 * time)
        axes.append(replace(axis, loop=axis.loop.model_copy(update={"sample_time": time, "torque_window": window})))
    return replace(scene, bus=bus, axes=tuple(axes))


def environment_of(axis: AxisScene) -> Environment:
    """Return the environment of an axis.

    Raises:
        ParameterError: A group renders on the axis.
    """
    if axis.group:
        raise ParameterError(
            f"{axis.parameters.name}: group {axis.group!r} renders on this axis, expected an axis outside groups"
        )
    return cast(Environment, axis.environment.parameters)


def loop_case(axis: AxisScene, scene: Scene) -> LoopCase:
    """Return the case of an axis: its loop without a bus, with quantisation, delay and torque limit of the scene."""
    simulation, given, time, under = simulation_of(axis), axis.parameters, scene.bus.sample_time_ns, axis.passivity
    quantum = None if given.rated_torque is None else given.rated_torque * 1e-3
    friction = sum(float(getattr(effect.parameters, "kinetic", 0.0)) for effect in simulation.effects)
    damping = axis.loop.device_damping
    if damping is None:
        damping = simulation.plant.damping + viscous_friction(simulation)
    return LoopCase(
        environment_of(axis), under.name, under.parameters, axis.loop, lambda: build_plant(simulation, time), time,
        scene.bus.delay, given.counts_per_unit, quantum, given.torque_limit, damping, under.own, friction, simulation,
    )  # fmt: skip


def viscous_friction(simulation: AxisSimulation) -> float:
    """Return the viscous damping that effects add to the plant [N*s/m or N*m*s/rad]."""
    viscous = (effect.parameters for effect in simulation.effects if effect.name == "viscous_friction")
    return sum((float(getattr(effect, "damping", 0.0)) for effect in viscous), 0.0)


PLANT_OF: Final = {"moving_mass": "mass", "device_damping": "damping", "device_damping_bound": "damping"}
"""Declared property of the loop -> parameter of the simulated plant with its true value."""


def chosen_algorithms(
    algorithms: Sequence[str] | None, table: ComponentOf = ALGORITHM, own: Sequence[str] = ()
) -> list[str]:
    """Return the requested algorithms without repetitions; for None all of them, `guarded` first.

    Args:
        algorithms: Requested names.
        table: Algorithms of the ports.
        own: Names of user-defined algorithms, which are permitted as well; for None they come before the others.

    Raises:
        ParameterError: A name is unknown.
    """
    chosen = list(dict.fromkeys(algorithms or (*own, "guarded", *table.table)))
    for name in chosen:
        if name not in own:
            table.model_named(name)
    return chosen


def with_algorithm(port: Port, name: str) -> Port:
    """Return a port under another algorithm; parameters that both have (alpha, ...) are kept.

    An algorithm of an admittance display takes its default parameters.

    Raises:
        ParameterError: The algorithm needs parameters that the scene does not give.
    """
    if port.passivity.name == name:
        return port
    given, model = port.passivity.parameters, port.algorithms.model_named(name)
    kept = type(given).model_fields.keys() if port.causality is IMPEDANCE else ()
    try:
        parameters = model().model_copy(update={key: getattr(given, key) for key in model.model_fields if key in kept})
    except ValueError as error:
        raise ParameterError(
            f"{name}: needs parameters that the scene does not give; compare it on a scene that has them"
        ) from error
    return port._replace(passivity=ComponentSpec(name, parameters))


class UnderAlgorithm(NamedTuple):
    """A scene under one algorithm, or the reason why there is none."""

    scene: Scene | None  # None if it is refused
    remark: str = ""  # reason of the refusal, or note on the properties taken from the plant
    from_plant: tuple[str, ...] = ()  # names of these properties

    def permitted(self) -> Scene:
        """Return the scene, or raise if it is refused.

        Raises:
            InputError: The scene is refused.
        """
        if self.scene is None:
            raise InputError(self.remark)
        return self.scene


def under(scene: Scene, name: str) -> UnderAlgorithm:
    """Return a scene with all its ports under an algorithm.

    Properties that it needs of an axis and lacks are taken from the simulated plant.

    Raises:
        ParameterError: The algorithm refuses the scene even with these properties.
    """
    remark, from_plant = "", tuple[str, ...]()
    for port in scene.ports:
        chosen, taken = _able(scene, with_algorithm(port, name))
        scene = scene.with_port(chosen)
        if taken:
            loop = chosen.axes[0].loop
            shown = [f"{key} {getattr(loop, key):g}" for key in taken if key != "device_damping_bound"]
            remark, from_plant = f"taken from the simulated plant: {', '.join(shown)}", taken
    return UnderAlgorithm(scene, remark, from_plant)


def tried(scene: Scene, name: str) -> UnderAlgorithm:
    """Return a scene under an algorithm as `under` does, or the reason why the algorithm refuses it."""
    try:
        return under(scene, name)
    except ParameterError as error:
        return UnderAlgorithm(None, str(error).splitlines()[0])


def _able(scene: Scene, port: Port) -> tuple[Port, tuple[str, ...]]:
    """Return a port, and the names of the properties of its axis that were taken from its plant."""
    try:
        _build(scene, port)
        return port, ()
    except ParameterError:
        if len(port.axes) > 1:
            raise
    [axis] = port.axes
    from_plant = tuple(key for key in PLANT_OF if getattr(axis.loop, key) is None)
    values = {key: getattr(simulation_of(axis).plant, PLANT_OF[key]) for key in from_plant}
    port = port._replace(axes=(replace(axis, loop=axis.loop.model_copy(update=values)),))
    _build(scene, port)
    return port, from_plant


def _build(scene: Scene, port: Port) -> None:
    [with_it] = (of for of in scene.with_port(port).ports if of.name == port.name)
    controller_of(scene, with_it)


def is_display(scene: Scene) -> bool:
    """Return whether all axes of a scene are admittance displays."""
    return all(axis.parameters.admittance is not None for axis in scene.axes)


_BLOCK: Final = 250
"""Steps in a block that is timed: few enough that at least one repeat of each block is not interrupted."""


def microseconds_per_step(
    cases: Mapping[str, tuple[Any, LoopRun]], repeats: int, budget: float = float("inf")
) -> dict[str, float]:
    """Return the time of a step [us]: each block of steps counts with the least time of all repeats.

    Args:
        cases: Algorithm -> its case, and the run whose positions and torques are replayed; empty runs are omitted.
        repeats: Repeats of each algorithm, in turn (A B C A B C), so that a slow phase of the machine affects all.
        budget: Processor time of all repeats [s]; an algorithm that takes long replays fewer blocks, at least one, and
            no repeat begins when the time is used up.
    """
    pairs = {name: _middle_of(run) for name, (_, run) in cases.items() if run.position.size}
    best = {name: [float("inf")] * -(-len(of_run) // _BLOCK) for name, of_run in pairs.items()}
    clock, spent, share = ProcessorClock(), 0, 1e9 * budget / max(1, repeats * len(pairs))
    for repeat in range(repeats):
        if spent > 1e9 * budget:
            break
        for name, of_run in pairs.items():
            step, times = cases[name][0].controller().step, best[name]
            for place, start in enumerate(range(0, len(of_run), _BLOCK)):
                block = of_run[start : start + _BLOCK]
                begin = clock.now()
                for position, torque in block:
                    step(position, torque)
                taken = clock.now() - begin
                times[place], spent = min(times[place], taken), spent + taken
                if not repeat and sum(times[: place + 1]) > share:
                    pairs[name], best[name] = of_run[: start + _BLOCK], times[: place + 1]
                    break
    return {name: sum(times) * 1e-3 / len(pairs[name]) for name, times in best.items()}


def _middle_of(run: LoopRun) -> list[tuple[float, float]]:
    """Return (position, applied torque) of 2000 steps from the middle of a run; lists of them for a group."""
    begin = max(0, (len(run.position) - 2000) // 2)
    part = slice(begin, begin + 2000)
    return list(zip(run.position[part].tolist(), run.torque[part].tolist(), strict=True))
