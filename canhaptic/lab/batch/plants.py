"""The flow of many linear plants over one sample time, in arrays: mass, bearings and a hand that follows sinusoids.

    m v' = torque - b v + K (x_u - q) + D (v_u - v) + push   (`user` and `plant` of canhaptic.sim.plant)

States and their order are as in `Plant`, and so is the flow: exp(F T) by a series and doubling. The sum of a row
is taken term by term and not by a matrix product, so that a position may differ from that of `Plant` by a few units in
its last place per hold. Plants with other linear effects are made one by one, each distinct one once.

A plant with events in the loop of a batch: replacements of `closed_loop.move_plant`; kernels.

The modes, the stepper and the solution over substeps come from `canhaptic.sim.plant`, on arrays of all modes,
which are compiled before the loop begins.

Forces that are not piecewise affine, in the loop of a batch: `canhaptic.sim.plant.splitting` on arrays; kernels.

The force of a substep is found by the same secant, with `EventPlant` in the place of the plant.

Plants with events for many loops: the modes of one plant as kernels take them.

Scenes with the same plant share its modes, which cost a millisecond each.

Loops with plants that have events, grouped by plant.

Effects of a plant that change a number and not the motion: the encoder reading, and the acting torque.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import expm1, inf, prod, sqrt
from typing import Any, Final, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from canhaptic.control.certificates.certified_torque import doubt_of_late, end_gap, free_of_late, largest_of_late
from canhaptic.errors import EventLimitError, ParameterError
from canhaptic.kernels import Buffer, Indices
from canhaptic.kernels.records import Records, records_of
from canhaptic.lab.batch import closed_loop, mode_arrays
from canhaptic.lab.batch.closed_loop import Signals, Winding
from canhaptic.lab.batch.mode_arrays import Books, move
from canhaptic.lab.batch.varied import simulation_with
from canhaptic.lab.loop.axis_loop import Array
from canhaptic.scene.components import ComponentSpec
from canhaptic.scene.far_side import build_plant, effect_of
from canhaptic.scene.models import AxisSimulation
from canhaptic.sim.plant import splitting, stepper
from canhaptic.sim.plant.accuracy_parameters import AccuracyParameters
from canhaptic.sim.plant.assembly import PlantModel, collect
from canhaptic.sim.plant.effort_forces import RIPPLE, Bristle, Effort, bend, mean_force
from canhaptic.sim.plant.hybrid_automaton import HybridAutomaton
from canhaptic.sim.plant.propagator import TICKS, flow_changes
from canhaptic.sim.plant.splitting import fixed_point, mean_torque
from canhaptic.sim.plant.stepper import COUNTS, EVENTS, LIMIT, MISSING, MODE, NONE, ModeTables, StepperSettings, run
from canhaptic.sim.plant.user import UserParameters

_MOST_MODES: Final = 100
"""Modes of one plant at most; more would take longer to compile than a run."""


@dataclass(slots=True)
class EventState:
    """State of a plant kept from hold to hold, in addition to its state vector."""

    changes: int = 0  # of the timetable that are done
    force: float = 0.0  # of the efforts in the substep before [N or N*m]
    slope: float = -1.0  # of their residual there
    rippled: float = 0.0  # work of a torque ripple [J]
    is_stopped: bool = False  # by too many events
    began_work: float = 0.0  # of the motor at the start of the hold, a ripple's included [J]
    saved_work: float = 0.0  # at the start of the substep, with `EventPlant.saved`
    saved_mode: int = 0
    saved_events: int = 0
    start: float = 0.0  # position there [m or rad]
    begin: float = 0.0  # torque of the motor there [N or N*m]
    held: float = 0.0  # its mean over the substep [N or N*m]
    duration: float = 0.0  # of the substep [s]
    ticks: int = 0  # asked for
    passed: int = 0  # that passed
    limit: int = 0  # events at which the substep ends; -1: the first


class EventPlant(NamedTuple):
    """A plant with events, shared by many loops in turn; everything except the tables is changed in place."""

    tables: ModeTables
    settings: StepperSettings
    state: Any  # z = [states..., torque, 1]
    spare: Any
    books: tuple[Books]  # (Books,), the first work of which is that of the motor
    counts: Indices  # see `stepper`
    values: tuple[Buffer, Buffer]  # two buffers for the values of guards
    sines: Indices  # places of the hand's oscillators in the state: a cosine follows each sine
    change_ticks: Indices  # of the timetable, in order
    change_targets: Sequence[Indices]  # by change and mode: the mode that it leads to
    now: Sequence[EventState] | Records  # (EventState,)
    saved: Buffer  # z at the start of the substep
    efforts: Sequence[Effort] | Records  # `Effort` of each force that is solved over substeps
    bristles: Sequence[Bristle] | Records  # `Bristle` of each
    substep_ticks: int
    torque_place: int  # in z: of the torque of the motor,
    travel_place: int  # of the way in the substep,
    force_place: int  # of the sum of the forces


class EventPlants(NamedTuple):
    """One plant with events, used by many loops in turn."""

    plant: EventPlant
    start: Buffer  # state at the first SYNC, shape (n,)
    first: int  # number of the mode there


def begin_events(plants: EventPlants, row: int) -> None:
    """Reset the plant of a loop to its start."""
    plant, now = plants.plant, plants.plant.now[0]
    for place in range(len(plants.start)):
        plant.state[place] = plant.spare[place] = plants.start[place]
    plant.counts[MODE], plant.counts[EVENTS] = plants.first, 0
    plant.books[0].totals[0] = 0.0
    now.changes, now.force, now.slope, now.rippled = 0, 0.0, -1.0, 0.0
    for i in range(len(plant.bristles)):
        plant.bristles[i].deflection = 0.0


def events_at(plants: EventPlants, row: int) -> EventPlant:
    """Return the plant of a loop."""
    return plants.plant


def move_events(plant: EventPlant, torque: float, cycle: int) -> bool:
    """Move a plant to a SYNC under a constant torque [N or N*m]; return False at more events than allowed."""
    plant.state[len(plant.state) - 2] = torque
    return move_held(plant, cycle)


def move_held(plant: EventPlant, cycle: int) -> bool:
    """Move a plant to a SYNC under the torque held in its state; see `move_events`."""
    counts, now = plant.counts, plant.now[0]
    now.is_stopped, now.began_work = False, plant.books[0].totals[0] + now.rippled
    end = cycle * TICKS
    tick, left = end - TICKS, 0
    most = counts[EVENTS] + plant.settings.max_events + 1
    while now.changes < len(plant.change_ticks) and plant.change_ticks[now.changes] < end:
        at = plant.change_ticks[now.changes]
        if at > tick:
            left = run_ticks(plant, at - tick, most)
            tick = at
        if left:
            break
        counts[MODE] = plant.change_targets[now.changes][counts[MODE]]
        now.changes += 1
    if not left:
        left = run_ticks(plant, end - tick, most)
    if cycle % 1024 == 0:  # as in `Plant`
        tidy(plant)
    return left == 0


def run_ticks(plant: EventPlant, ticks: int, most: int) -> int:
    """Move by some ticks; return the ticks left at the limit of events."""
    return run_on(plant, ticks, most)


def run_on(plant: EventPlant, ticks: int, most: int) -> int:
    """Move by a number of ticks with only the stepper, through every event."""
    plant.counts[LIMIT] = most
    state, _, left = run(
        plant.tables, plant.settings, plant.state, plant.spare, plant.books, plant.counts, plant.values, ticks
    )
    for row in range(len(plant.state)):
        plant.state[row] = state[row]
    return left


def tidy(plant: EventPlant) -> None:
    """Restore the hand's oscillators to unit amplitude."""
    state = plant.state
    for i in range(len(plant.sines)):
        sine, cosine = state[plant.sines[i]], state[plant.sines[i] + 1]
        norm = sqrt(sine * sine + cosine * cosine)
        state[plant.sines[i]], state[plant.sines[i] + 1] = sine / norm, cosine / norm


def book_nothing(works: Any, state: Buffer, books: tuple[Books]) -> None:
    """Replace `stepper.book` where the motor's work is its torque times displacement."""


def book_motor(works: Any, state: Buffer, books: tuple[Books]) -> None:
    """Replace `stepper.book`: the work of the motor alone; `works` has shape (n, 2 n)."""
    only, size = books[0], len(state)
    move(works, state, only.rows)
    total = 0.0
    for i in range(size):
        total += only.rows[size + i] * only.rows[i]
    only.totals[0] += total


def booked_work(plant: EventPlant, interaction: float, torque: float, travel: float) -> float:
    """Replace `closed_loop.work_in` where the motor's work is booked."""
    booked: float = plant.books[0].totals[0] + plant.now[0].rippled
    return 0.0 - booked


def run_substeps(plant: EventPlant, ticks: int, most: int) -> int:
    """Replace `event_plant.run_ticks`: move in substeps that end at their first event at the latest."""
    counts, now = plant.counts, plant.now[0]
    while ticks:
        ticks -= substep(plant, min(ticks, plant.substep_ticks), most)
        if now.is_stopped or (ticks and counts[EVENTS] >= most):
            return max(ticks, 1)
    return 0


def substep(plant: EventPlant, ticks: int, most: int) -> int:
    """Move by `ticks` or to the first event; return the ticks that passed.

    The force is consistent with its own motion, at the end of which the plant is left.
    """
    state, counts, now = plant.state, plant.counts, plant.now[0]
    for row in range(len(state)):
        plant.saved[row] = state[row]
    now.saved_mode, now.saved_events, now.saved_work = counts[MODE], counts[EVENTS], plant.books[0].totals[0]
    now.start, now.begin, now.held = state[0], state[plant.torque_place], state[plant.torque_place]
    now.ticks, now.limit, now.is_stopped = ticks, -1, False
    force, now.slope, found = fixed_point(plant, now.force, now.slope)
    if not found:
        now.limit = most
        force, now.slope, _ = fixed_point(plant, now.force, -1.0)  # with an unknown slope
    if now.is_stopped:
        return 0
    travel = state[plant.travel_place]
    for i in range(len(plant.efforts)):
        effort, bristle = plant.efforts[i], plant.bristles[i]
        if effort.kind == RIPPLE:
            now.rippled += mean_force(effort, bristle, now.start, travel, now.duration, now.held) * travel
        bend(effort, bristle, travel, now.duration)
    now.force = force
    passed: int = now.passed
    return passed


def residual_of_plant(plant: EventPlant, force: float) -> float:
    """Replace `splitting.residual`; 0 where the plant cannot be advanced, which ends the search."""
    state, counts, now = plant.state, plant.counts, plant.now[0]
    if now.is_stopped:
        return 0.0
    for row in range(len(state)):
        state[row] = plant.saved[row]
    counts[MODE], counts[EVENTS], plant.books[0].totals[0] = now.saved_mode, now.saved_events, now.saved_work
    state[plant.force_place], state[plant.travel_place] = force, 0.0
    left = run_on(plant, now.ticks, now.limit if now.limit >= 0 else counts[EVENTS] + 1)
    if left and now.limit >= 0:
        now.is_stopped = True
        return 0.0
    now.passed = now.ticks - left
    now.duration = now.passed * plant.settings.tick_time
    now.held = mean_torque(now.begin, state[plant.torque_place], state[len(state) - 2])
    total = 0.0
    for i in range(len(plant.efforts)):
        total += mean_force(
            plant.efforts[i], plant.bristles[i], now.start, state[plant.travel_place], now.duration, now.held
        )
    return total - force


CALLS: Final = (
    stepper.run, splitting.fixed_point, residual_of_plant, doubt_of_late, end_gap, free_of_late, largest_of_late,
)  # fmt: skip
"""Long functions, called from several places, and certificates that most loops reach at few SYNCs, or never."""


Plants = closed_loop.LinearPlants | EventPlants
"""Plants that a loop of a batch moves."""
Stopped = Callable[[Plants, int, int], None]
"""Takes plants, the number of a scene, and the SYNC to which its plant could not be moved."""


class PlantValues(NamedTuple):
    """One plant of a batch, before it is made."""

    simulation: AxisSimulation
    sample_time_ns: int

    def scene(self) -> PlantModel:
        """Model of the plant."""
        effects = [effect_of(effect) for effect in self.simulation.effects]
        return collect(self.simulation.plant, self.simulation.user, effects, self.sample_time_ns * 1e-9)


def distinct_plants(
    simulation: AxisSimulation, sample_time_ns: Array | float, varied: Mapping[str, Array]
) -> tuple[list[PlantValues], NDArray[np.intp]]:
    """Distinct plants, and the number of each scene's plant, shape (n_scenes,).

    Args:
        simulation: Common part of the scenes.
        sample_time_ns: One value, or one for each scene, shape (n_scenes,) [ns].
        varied: Keys under `simulation.` -> value of each scene.
    """
    keys = {key: values for key, values in varied.items() if key.startswith("simulation.")}
    count = max(np.size(sample_time_ns), *map(len, keys.values()), 1)
    columns = [np.broadcast_to(sample_time_ns, (count,)), *keys.values()]
    rows, which = np.unique(np.stack(columns, axis=1), axis=0, return_inverse=True)
    plants = [
        PlantValues(simulation_with(simulation, dict(zip(keys, row[1:], strict=True))), int(row[0]))
        for row in rows.tolist()
    ]
    return plants, which.ravel()


class EventModes:
    """The modes of one plant, all that can be entered, and its start.

    Args:
        scene: Model of the plant.
        accuracy: Accuracy; the defaults when None.
        listed: Whether Python runs the loop, on lists.
        is_booked: Whether the motor's work is booked; None: as the plant requires.
    """

    def __init__(
        self, scene: PlantModel, accuracy: AccuracyParameters | None, *, listed: bool, is_booked: bool | None = None
    ) -> None:
        self._scene, self._accuracy, self._listed = scene, accuracy or AccuracyParameters(), listed
        self._machine = HybridAutomaton(scene, self._accuracy.max_events, self._accuracy.event_bits)
        self._is_booked = works_are_booked(scene) if is_booked is None else is_booked
        self._form: Callable[[Any], Any] = (lambda array: array.tolist()) if listed else np.ascontiguousarray

    def plants(self) -> EventPlants:
        """Return the plant at its start."""
        form, names, machine, accuracy = self._form, [*self._scene.names], self._machine, self._accuracy
        start, first = machine.state.copy(), machine.modes.index(machine.mode)
        ticks, targets = self._changes()
        flat = mode_arrays.flat_tables(machine.modes, machine.targets, len(self._scene.works))
        tables = flat._replace(works=flat.works[..., : 2 * len(names) * self._is_booked])
        counts = np.zeros(COUNTS, dtype=np.int64)
        counts[MODE], counts[MISSING] = first, NONE
        width = 2 * max(len(mode.exits) for mode in machine.modes) + len(names)
        plant = EventPlant(
            ModeTables(*map(form, tables)), machine.settings, form(start.copy()), form(start.copy()),
            (Books(form(np.zeros(len(self._scene.works))), form(np.zeros(2 * len(names) * self._is_booked))),),
            form(counts), (form(np.zeros(width)), form(np.zeros(width))),
            form(np.array([place for place, name in enumerate(names) if name.endswith("_sine")], dtype=np.int64)),
            form(ticks), form(targets), [EventState()] if self._listed else records_of([EventState()]),
            form(start.copy()), *self._efforts(), TICKS // accuracy.substeps, names.index(self._scene.motor_torque),
            *((names.index("travel"), names.index("effort")) if self._scene.efforts else (0, 0)),
        )  # fmt: skip
        return EventPlants(plant, form(start), first)

    def _changes(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Compile every mode that can be entered; return ticks and targets of the timetable."""
        machine, targets, mode = self._machine, list[list[int]](), 0
        timetable = ((round(time / machine.tick_time), part, into) for time, part, into in self._scene.schedule)
        changes = sorted(timetable, key=lambda change: change[0])
        while mode < len(machine.modes):
            for guard, target in enumerate(list(machine.targets[mode])):
                if target == NONE:
                    machine.connect(mode, guard)
            targets.append([machine.number_with(mode, part, into) for _, part, into in changes])
            mode += 1
        return np.array([tick for tick, _, _ in changes], dtype=np.int64), np.array(targets, dtype=np.int64).T.copy()

    def error(self, plants: EventPlants, cycle: int) -> EventLimitError:
        """Reason why a loop was stopped in the hold before a SYNC."""
        machine, plant, accuracy = self._machine, plants.plant, self._accuracy
        where = f"plant before {cycle * TICKS * machine.tick_time:.9g} s"
        described = machine.described(int(plant.counts[MODE]), [float(value) for value in plant.state])
        used_up = plant.counts[EVENTS] < plant.counts[LIMIT]
        return EventLimitError(accuracy.max_events, described, where, plant.settings.max_products if used_up else 0)

    def _efforts(self) -> tuple[Any, Any]:
        """Return the efforts, and their bristles."""
        efforts = [getattr(effort, "effort", None) for effort in self._scene.efforts]
        bristles = [Bristle() for _ in efforts]
        if self._listed:
            return efforts, bristles
        return records_of(efforts or [Effort(0)])[: len(efforts)], records_of(bristles or [Bristle()])[: len(efforts)]


def by_its_way() -> dict[object, object]:
    """Functions to replace in a loop where the motor's work is its torque times displacement."""
    products = ("move", "evaluate", "pace", "largest_term", "stored")
    return {stepper.book: book_nothing, **{getattr(stepper, name): getattr(mode_arrays, name) for name in products}}


def works_are_booked(scene: PlantModel) -> bool:
    """Whether the motor's work is more than its torque times displacement: by a current loop, or a ripple."""
    return scene.motor_torque != "torque" or any(effort.account == "motor" for effort in scene.efforts)


def loop_replacements(plants: Sequence[PlantValues]) -> dict[object, object]:
    """Replacements of functions of the loop for plants with events; none for linear ones."""
    if not plants:
        return {}
    scene = plants[0].scene()
    found: dict[object, object] = {
        **by_its_way(), closed_loop.move_plant: move_events, closed_loop.begin_plant: begin_events,
        closed_loop.plant_at: events_at,
    }  # fmt: skip
    if scene.efforts:
        found |= {run_ticks: run_substeps, splitting.residual: residual_of_plant}
    if works_are_booked(scene):
        return found | {stepper.book: book_motor, closed_loop.work_in: booked_work}
    return found


def run_event_plants(
    loops: Any, plants: Sequence[PlantValues], which: Array, stopped: dict[int, EventLimitError], *, listed: bool
) -> None:
    """Run every loop.

    Args:
        loops: `InterpretedLoops` or `CompiledLoops`.
        plants: Each different plant.
        which: Number of the plant of each loop, shape (n,).
        stopped: Called with the numbers of loops whose plants could not be advanced, and why.
        listed: Whether Python runs the loops.
    """
    for number in np.unique(which).tolist():
        plant = plants[int(number)]
        modes = EventModes(plant.scene(), plant.simulation.accuracy, listed=listed)

        def stop(plants: Any, loop: int, cycle: int, modes: EventModes = modes) -> None:
            stopped[loop] = modes.error(plants, cycle)

        loops.run(np.flatnonzero(which == number).tolist(), modes.plants(), stop)


def never_stopped(*_what: object) -> None:
    """Placeholder, never called by a loop of a linear plant."""


_TORQUE: Final = ("torque_saturation", "thermal_derating", "torque_quantisation")
SIGNAL_EFFECTS: Final = ("encoder_noise", "encoder_quantisation", *_TORQUE)
"""Names in a scene of effects that change a number and not the motion."""


def signals_of(effects: Sequence[ComponentSpec], sample_time: float, seed: int) -> Signals:
    """Return the signal effects of a plant as numbers.

    Args:
        effects: Effects of the plant, in the order in which they act.
        sample_time: Sample time [s].
        seed: Seed of everything random.
    """
    found: dict[str, Any] = {effect.name: effect.parameters for effect in effects}
    order = [effect.name for effect in effects if effect.name in _TORQUE]
    noise, encoder = found.get("encoder_noise"), found.get("encoder_quantisation")
    saturation, rounding = found.get("torque_saturation"), found.get("torque_quantisation")
    warms, winding = found.get("thermal_derating"), Winding()
    if warms is not None:
        winding = Winding(
            warms.torque_limit, warms.thermal_resistance * warms.copper_loss, warms.ambient, warms.hot,
            warms.hot - warms.warm, -expm1(-sample_time / warms.time_constant),
        )  # fmt: skip
    last = saturation is not None and order[0] == "thermal_derating"
    return Signals(
        noise.deviation if noise else 0.0, seed, encoder.count if encoder else 0.0, bool(order),
        saturation.limit if saturation else inf, last, rounding.quantum if rounding else 0.0, winding,
    )  # fmt: skip


_ANY_NS: Final = 1_000_000
"""A sample time, where it does not matter [ns]."""


class LinearMotion(NamedTuple):
    """How many plants move, each by its own flow; n = 1 where all are the same. States as in `Plant`."""

    flows: Array  # state after a hold, shape (n, k, k)
    starts: Array  # shape (n, k)
    rates: Array | None  # rates of change where they are known in closed form, shape (n, k, k) [1/s]


def is_linear(simulation: AxisSimulation) -> bool:
    """Whether one flow moves a plant, and the motor's work is the held torque times displacement.

    Raises:
        ParameterError: An effect does not fit the plant.
    """
    scene = PlantValues(simulation, _ANY_NS).scene()
    moves_by_flow = not (any(part.has_guards for part in scene.parts) or scene.efforts or scene.schedule)
    return moves_by_flow and not works_are_booked(scene)


def why_not_in_loop(simulation: AxisSimulation) -> str:
    """Return "" when a loop of a batch can move a plant, else the reason by name."""
    try:
        scene = PlantValues(simulation, _ANY_NS).scene()
    except ParameterError as error:
        return f"effect {error.part} does not stand alone ({error})"
    own = any(not hasattr(effort, "effort") for effort in scene.efforts)
    return "a force of the plant is own code" if own else why_not_events(scene)


def why_not_events(model: PlantModel) -> str:
    """Return "" when the modes of a plant are few enough to be compiled beforehand, else the reason by name."""
    modes = prod(len(part.modes) for part in model.parts)
    return "" if modes <= _MOST_MODES else f"a plant of {modes} modes, expected {_MOST_MODES} at most"


def linear_motion(
    simulation: AxisSimulation, sample_time_ns: Array | float, varied: Mapping[str, Array]
) -> LinearMotion:
    """Return how many plants move.

    Args:
        simulation: Common part of the scenes.
        sample_time_ns: One value, or one for each scene, shape (n_scenes,) [ns].
        varied: Keys under `simulation.` -> value of each scene.
    """
    keys = {key: values for key, values in varied.items() if key.startswith("simulation.")}
    is_known = all(effect.name in ("viscous_friction", "tremor", *SIGNAL_EFFECTS) for effect in simulation.effects)
    rates, starts = _in_arrays(simulation, keys) if is_known else (None, None)
    if rates is not None and (keys or not isinstance(sample_time_ns, float)):
        steps = rates * np.reshape(np.asarray(sample_time_ns) * 1e-9, (-1, 1, 1))
        return LinearMotion(np.eye(rates.shape[-1]) + flow_changes(steps), cast(Array, starts), rates)
    distinct, which = distinct_plants(simulation, sample_time_ns, keys)
    plants = [build_plant(*values) for values in distinct]
    flows, starts = np.array([p.whole_flow() for p in plants]), np.array([p.scene.initial_state() for p in plants])
    return LinearMotion(flows[which], starts[which], rates)


def _in_arrays(simulation: AxisSimulation, keys: Mapping[str, Array]) -> tuple[Array, Array]:
    """Return the rates of change [1/s], shape (n, k, k), and the states at the start, shape (n, k)."""
    user = simulation.user or UserParameters()

    def number(name: str, value: float) -> Any:
        return keys.get(f"simulation.{name}", value)

    plant = {
        name: number(f"plant.{name}", getattr(simulation.plant, name)) for name in type(simulation.plant).model_fields
    }
    hand = {name: number(f"user.{name}", getattr(user, name)) for name in ("stiffness", "damping", "push", "rest")}
    damping, rest = plant["damping"] + hand["damping"], hand["rest"]
    motions = []  # (amplitude, angular frequency, phase)
    if user.motion is not None:
        motion = {name: number(f"user.motion.{name}", getattr(user.motion, name)) for name in
                  ("amplitude", "frequency", "phase", "offset")}  # fmt: skip
        motions.append((motion["amplitude"], 2.0 * np.pi * motion["frequency"], motion["phase"]))
        rest = rest + motion["offset"]
    for effect in simulation.effects:
        found = cast(Any, effect.parameters)
        if effect.name == "tremor":
            motions.append((found.amplitude, 2.0 * np.pi * found.frequency, found.phase))
        elif effect.name == "viscous_friction":
            damping = damping + found.damping
    count = max([1, *(len(values) for values in keys.values())])
    size = 4 + 2 * len(motions)
    rates, start = np.zeros((count, size, size)), np.zeros((count, size))
    start[:, 0], start[:, 1], start[:, -1] = plant["initial_position"], plant["initial_velocity"], 1.0
    rates[:, 0, 1] = 1.0
    force = rates[:, 1]
    force[:, 0], force[:, 1], force[:, -2] = -hand["stiffness"], -damping, 1.0
    force[:, -1] = hand["stiffness"] * rest + hand["push"]
    for i, (amplitude, omega, phase) in enumerate(motions):
        sine, cosine = 2 + 2 * i, 3 + 2 * i
        force[:, sine], force[:, cosine] = hand["stiffness"] * amplitude, hand["damping"] * amplitude * omega
        rates[:, sine, cosine], rates[:, cosine, sine] = omega, -omega
        start[:, sine], start[:, cosine] = np.sin(phase), np.cos(phase)
    force /= np.reshape(plant["mass"], (-1, 1))
    return rates, start
