"""Plants for loops without a bus: linear ones in arrays, and those with events as kernels.

`linear_motion` gives the transition matrices of many linear plants (mass, bearings, a hand that follows sinusoids):

    m v' = torque - b v + K (x_u - q) + D (v_u - v) + push   (`user` and `plant` of canhaptic.sim.plant)

The states and exp(F T), by a series and doubling, are as in `Plant`. Each row is summed term by term, so that a
position may differ from that of `Plant` by a few units in its last place per hold.

`EventMotors` are the motors of plants with events, a current loop, or forces over substeps that are not piecewise
affine. The modes, the stepper and the secant over a substep are those of `canhaptic.sim.plant`, on arrays. All modes
are computed before a loop starts (about a millisecond each), and scenes with equal plants share them.

`signals_of` gives the effects that change a number and not the motion: the encoder reading and the acting torque.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import expm1, inf, prod, sqrt
from typing import Any, Final, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from canhaptic.control.certificates import certified_torque
from canhaptic.errors import EventLimitError, ParameterError
from canhaptic.kernels import Buffer, Indices
from canhaptic.kernels.records import Records, records_of
from canhaptic.lab.batch import closed_loop, mode_arrays
from canhaptic.lab.batch.closed_loop import Room, Signals, Winding
from canhaptic.lab.batch.mode_arrays import Books, move
from canhaptic.lab.batch.varied import simulation_with
from canhaptic.lab.loop.axis_loop import Array
from canhaptic.scene.components import ComponentSpec
from canhaptic.scene.far_side import build_plant, effect_of
from canhaptic.scene.models import AxisSimulation
from canhaptic.sim.plant import AccuracyParameters, splitting, stepper
from canhaptic.sim.plant.assembly import PlantModel, collect
from canhaptic.sim.plant.hybrid_automaton import HybridAutomaton
from canhaptic.sim.plant.propagator import TICKS, flow_changes
from canhaptic.sim.plant.splitting import RIPPLE, Bristle, Effort, bend, fixed_point, mean_force, mean_torque
from canhaptic.sim.plant.stepper import COUNTS, EVENTS, LIMIT, MISSING, MODE, NONE, ModeTables, StepperSettings, run
from canhaptic.sim.plant.user import UserParameters

_MOST_MODES: Final = 100
"""Largest number of modes of a plant; computing more would take longer than a run."""


@dataclass(slots=True)
class EventState:
    """State of a plant kept from hold to hold, in addition to its state vector."""

    changes: int = 0  # scheduled mode changes that are done
    force: float = 0.0  # sum of the efforts in the previous substep [N or N*m]
    slope: float = -1.0  # slope of their residual there
    rippled: float = 0.0  # work of a torque ripple [J]
    is_stopped: bool = False  # whether there were too many events
    saved_work: float = 0.0  # work, mode and events at the start of the substep, with `EventPlant.saved`
    saved_mode: int = 0
    saved_events: int = 0
    start: float = 0.0  # position at the start of the substep [m or rad]
    begin: float = 0.0  # motor torque there [N or N*m]
    held: float = 0.0  # mean motor torque over the substep [N or N*m]
    duration: float = 0.0  # of the substep [s]
    ticks: int = 0  # requested ticks of the substep
    passed: int = 0  # ticks until its first event, or all
    limit: int = 0  # number of events at which the substep ends; -1: the next one


class EventPlant(NamedTuple):
    """A plant with events, used by many loops in turn; everything except the tables is changed in place."""

    tables: ModeTables
    settings: StepperSettings
    state: Any  # z = [states..., torque, 1]
    spare: Any
    books: tuple[Books]  # (Books,); its first work is that of the motor
    counts: Indices  # see `stepper`
    values: tuple[Buffer, Buffer]  # two buffers for the values of guards
    sines: Indices  # indices of the hand's sines in the state; a cosine follows each sine
    change_ticks: Indices  # ticks of the scheduled mode changes, ascending
    change_targets: Sequence[Indices]  # for each change and mode, the mode that it leads to
    now: Sequence[EventState] | Records  # (EventState,)
    saved: Buffer  # z at the start of the substep
    efforts: Sequence[Effort] | Records  # forces that are solved over substeps
    bristles: Sequence[Bristle] | Records  # bristle state of each of these forces
    substep_ticks: int  # ticks of a substep
    torque_place: int  # index of the motor torque in z
    travel_place: int  # index of the displacement in the substep
    force_place: int  # index of the sum of the forces
    start: Buffer  # z at the first SYNC
    first: int  # mode at the first SYNC


class EventMotors(NamedTuple):
    """Motors whose plants have events."""

    plants: tuple[EventPlant, ...]
    owners: Indices  # index of each motor's plant
    forces: Indices  # index of each motor's torque in the state of that plant
    places: Indices  # index of its position there


def event_motors_at(motors: EventMotors, row: int) -> EventMotors:
    """Replace `closed_loop.motors_at` for one plant that many loops use in turn."""
    plant = motors.plants[0]
    now = plant.now[0]
    for place in range(len(plant.start)):
        plant.state[place] = plant.spare[place] = plant.start[place]
    plant.counts[MODE], plant.counts[EVENTS] = plant.first, 0
    plant.books[0].totals[0] = 0.0
    now.changes, now.force, now.slope, now.rippled = 0, 0.0, -1.0, 0.0
    for i in range(len(plant.bristles)):
        plant.bristles[i].deflection = 0.0
    return motors


def move_event_motors(motors: EventMotors, room: Room, each: range, cycle: int) -> bool:
    """Replace `closed_loop.move_motors`; return False if a plant had too many events."""
    for i in each:
        motors.plants[motors.owners[i]].state[motors.forces[i]] = room.acting[i]
    for k in range(len(motors.plants)):
        if not move_held(motors.plants[k], cycle):
            return False
    return True


def event_position_of(motors: EventMotors, i: int) -> float:
    """Replace `closed_loop.position_of`."""
    at: float = motors.plants[motors.owners[i]].state[motors.places[i]]
    return at


def booked_work(motors: EventMotors, work: float) -> float:
    """Replace `closed_loop.work_of` where the stepper integrates the work of the motors."""
    total = 0.0
    for k in range(len(motors.plants)):
        plant = motors.plants[k]
        total += plant.books[0].totals[0] + plant.now[0].rippled
    return total


def move_held(plant: EventPlant, cycle: int) -> bool:
    """Move a plant to a SYNC under the torques in its state; return False if it had too many events."""
    counts, now = plant.counts, plant.now[0]
    now.is_stopped = False
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
    """Advance by a number of ticks; return the ticks left if the limit of events was reached, else 0."""
    return run_on(plant, ticks, most)


def run_on(plant: EventPlant, ticks: int, most: int) -> int:
    """Advance by a number of ticks with the stepper, through every event; see `run_ticks`."""
    plant.counts[LIMIT] = most
    state, _, left = run(
        plant.tables, plant.settings, plant.state, plant.spare, plant.books, plant.counts, plant.values, ticks
    )
    for row in range(len(plant.state)):
        plant.state[row] = state[row]
    return left


def tidy(plant: EventPlant) -> None:
    """Restore the hand's sines and cosines to unit amplitude."""
    state = plant.state
    for i in range(len(plant.sines)):
        sine, cosine = state[plant.sines[i]], state[plant.sines[i] + 1]
        norm = sqrt(sine * sine + cosine * cosine)
        state[plant.sines[i]], state[plant.sines[i] + 1] = sine / norm, cosine / norm


def book_nothing(works: Any, state: Buffer, books: tuple[Books]) -> None:
    """Replace `stepper.book` by nothing where the motor's work is its torque times displacement."""


def book_motor(works: Any, state: Buffer, books: tuple[Books]) -> None:
    """Replace `stepper.book`: accumulate only the work of the motor; `works` has shape (n, 2 n)."""
    only, size = books[0], len(state)
    move(works, state, only.rows)
    total = 0.0
    for i in range(size):
        total += only.rows[size + i] * only.rows[i]
    only.totals[0] += total


def run_substeps(plant: EventPlant, ticks: int, most: int) -> int:
    """Replace `run_ticks`: advance in substeps, each of which ends at its first event at the latest.

    A plant of the same loop that has no such forces needs none.
    """
    counts, now = plant.counts, plant.now[0]
    if not len(plant.efforts):
        return run_on(plant, ticks, most)
    while ticks:
        ticks -= substep(plant, min(ticks, plant.substep_ticks), most)
        if now.is_stopped or (ticks and counts[EVENTS] >= most):
            return max(ticks, 1)
    return 0


def substep(plant: EventPlant, ticks: int, most: int) -> int:
    """Advance by `ticks`, or to the first event; return the ticks that passed.

    The secant search leaves the plant at the end of the substep, with the force that its own motion produces.
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
    """Replace `splitting.residual`; return 0 where the plant cannot be advanced, which ends the search."""
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
    stepper.run, splitting.fixed_point, residual_of_plant,
    certified_torque.uncertainty_of_late, certified_torque.end_gap,
    certified_torque.free_of_late_torques, certified_torque.largest_of_late_torques,
    certified_torque.displacement_by_windows, certified_torque.taken_by_queue, certified_torque.torque_if_repeated,
    certified_torque.torque_below_older,
)  # fmt: skip
"""Functions that are called, not inlined: long ones with several callers, and certificates that are rarely needed."""


Plants = closed_loop.LinearPlants | EventMotors
"""Plants of the loops of a batch."""
Stopped = Callable[[Plants, int, int], None]
"""Called for a plant that cannot be advanced, with (plants, index of the scene, SYNC that it cannot reach)."""


class PlantValues(NamedTuple):
    """Description of one plant of a batch."""

    simulation: AxisSimulation
    sample_time_ns: int

    def scene(self) -> PlantModel:
        """Return the equations of the plant, with hand and effects."""
        effects = [effect_of(effect) for effect in self.simulation.effects]
        return collect(self.simulation.plant, self.simulation.user, effects, self.sample_time_ns * 1e-9)


def distinct_plants(
    simulation: AxisSimulation, sample_time_ns: Array | float, varied: Mapping[str, Array]
) -> tuple[list[PlantValues], NDArray[np.intp]]:
    """Return the distinct plants, and the index of each scene's plant, shape (n_scenes,).

    Args:
        simulation: Common part of the scenes.
        sample_time_ns: Sample time, common or one for each scene, shape (n_scenes,) [ns].
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
    """All modes that a plant can enter, and its start, as kernels take them.

    Args:
        scene: Model of the plant.
        accuracy: Accuracy; None for the defaults.
        listed: Whether to use lists, for a loop that Python runs, instead of arrays.
        is_booked: Whether the stepper integrates the motor's work; None: if the plant requires it.
    """

    def __init__(
        self, scene: PlantModel, accuracy: AccuracyParameters | None, *, listed: bool, is_booked: bool | None = None
    ) -> None:
        self._scene, self._accuracy, self._listed = scene, accuracy or AccuracyParameters(), listed
        self._machine = HybridAutomaton(scene, self._accuracy.max_events, self._accuracy.event_bits)
        self._is_booked = works_are_booked(scene) if is_booked is None else is_booked
        self._form: Callable[[Any], Any] = (lambda array: array.tolist()) if listed else np.ascontiguousarray

    def motor(self) -> EventMotors:
        """Return the motor of a plant that has only one, at its start."""
        plant = self.plant()
        places = [[0], [len(plant.state) - 2], [0]]
        return EventMotors((plant,), *(places if self._listed else np.array(places)))

    def plant(self) -> EventPlant:
        """Return the plant at its start."""
        form, names, machine, accuracy = self._form, [*self._scene.names], self._machine, self._accuracy
        start, first = machine.state.copy(), machine.modes.index(machine.mode)
        ticks, targets = self._changes()
        flat = mode_arrays.flat_tables(machine.modes, machine.targets, len(self._scene.works))
        tables = flat._replace(works=flat.works[..., : 2 * len(names) * self._is_booked])
        counts = np.zeros(COUNTS, dtype=np.int64)
        counts[MODE], counts[MISSING] = first, NONE
        width = 2 * max(len(mode.exits) for mode in machine.modes) + len(names)
        return EventPlant(
            ModeTables(*map(form, tables)), machine.settings, form(start.copy()), form(start.copy()),
            (Books(form(np.zeros(len(self._scene.works))), form(np.zeros(2 * len(names) * self._is_booked))),),
            form(counts), (form(np.zeros(width)), form(np.zeros(width))),
            form(np.array([place for place, name in enumerate(names) if name.endswith("_sine")], dtype=np.int64)),
            form(ticks), form(targets), [EventState()] if self._listed else records_of([EventState()]),
            form(start.copy()), *self._efforts(), TICKS // accuracy.substeps, names.index(self._scene.motor_torque),
            *((names.index("travel"), names.index("effort")) if self._scene.efforts else (0, 0)), form(start), first,
        )  # fmt: skip

    def _changes(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Compute every mode that can be entered; return ticks and targets of the scheduled mode changes."""
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

    def error(self, motors: EventMotors, cycle: int) -> EventLimitError:
        """Return the error of a loop that was stopped in the hold before a SYNC."""
        machine, plant, accuracy = self._machine, motors.plants[0], self._accuracy
        where = f"plant before {cycle * TICKS * machine.tick_time:.9g} s"
        described = machine.described(int(plant.counts[MODE]), [float(value) for value in plant.state])
        used_up = plant.counts[EVENTS] < plant.counts[LIMIT]
        return EventLimitError(accuracy.max_events, described, where, plant.settings.max_products if used_up else 0)

    def _efforts(self) -> tuple[Any, Any]:
        """Return the forces that are solved over substeps, and their bristle states."""
        efforts = [getattr(effort, "effort", None) for effort in self._scene.efforts]
        bristles = [Bristle() for _ in efforts]
        if self._listed:
            return efforts, bristles
        return records_of(efforts or [Effort(0)])[: len(efforts)], records_of(bristles or [Bristle()])[: len(efforts)]


def works_are_booked(scene: PlantModel) -> bool:
    """Return whether the motor's work must be integrated: with a current loop, or a torque ripple."""
    return scene.motor_torque != "torque" or any(effort.account == "motor" for effort in scene.efforts)


def by_its_way() -> dict[object, object]:
    """Return the replacements for a loop in which the motor's work is its torque times displacement."""
    products = ("move", "evaluate", "pace", "largest_term", "stored")
    return {stepper.book: book_nothing, **{getattr(stepper, name): getattr(mode_arrays, name) for name in products}}


def loop_replacements(scenes: Sequence[PlantModel]) -> dict[object, object]:
    """Return the replacements of functions of the loop for plants with events; an empty one without such plants."""
    if not scenes:
        return {}
    found: dict[object, object] = {
        **by_its_way(), closed_loop.move_motors: move_event_motors, closed_loop.position_of: event_position_of,
        closed_loop.motors_at: event_motors_at,
    }  # fmt: skip
    if any(scene.efforts for scene in scenes):
        found |= {run_ticks: run_substeps, splitting.residual: residual_of_plant}
    if any(map(works_are_booked, scenes)):
        found |= {stepper.book: book_motor, closed_loop.work_of: booked_work}
    return found


_TORQUE: Final = ("torque_saturation", "thermal_derating", "torque_quantisation")
SIGNAL_EFFECTS: Final = ("encoder_noise", "encoder_quantisation", *_TORQUE)
"""Names of the effects that change a reading or a torque and add no motion of their own."""


def signals_of(effects: Sequence[ComponentSpec], sample_time: float, seed: int) -> Signals:
    """Return the effects of a plant on encoder and torque, as numbers.

    Args:
        effects: Effects of the plant, in the order in which they act.
        sample_time: Sample time [s].
        seed: Seed of the random numbers.
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
"""Sample time for questions whose answer does not depend on it [ns]."""


class LinearMotion(NamedTuple):
    """Motion of the linear plants of many scenes; n = 1 where all are equal. States as in `Plant`."""

    flows: Array  # transition matrices over a hold, shape (n, k, k)
    starts: Array  # initial states, shape (n, k)
    rates: Array | None  # F of y' = F y where it is known in closed form, shape (n, k, k) [1/s]


def is_linear(simulation: AxisSimulation) -> bool:
    """Return whether a plant is linear, and the motor's work is the held torque times displacement.

    Raises:
        ParameterError: An effect does not fit the plant.
    """
    scene = PlantValues(simulation, _ANY_NS).scene()
    moves_by_flow = not (any(part.has_guards for part in scene.parts) or scene.efforts or scene.schedule)
    return moves_by_flow and not works_are_booked(scene)


def why_not_in_loop(simulation: AxisSimulation) -> str:
    """Return "" if a loop of a batch can move a plant, else the reason."""
    try:
        scene = PlantValues(simulation, _ANY_NS).scene()
    except ParameterError as error:
        return f"effect {error.part} cannot be simulated by itself ({error})"
    own = any(not hasattr(effort, "effort") for effort in scene.efforts)
    return "a force of the plant is own code" if own else why_not_events(scene)


def why_not_events(model: PlantModel) -> str:
    """Return "" if the modes of a plant are few enough to be computed before the loop, else the reason."""
    modes = prod(len(part.modes) for part in model.parts)
    return "" if modes <= _MOST_MODES else f"a plant of {modes} modes, expected {_MOST_MODES} at most"


def linear_motion(
    simulation: AxisSimulation, sample_time_ns: Array | float, varied: Mapping[str, Array]
) -> LinearMotion:
    """Return the motion of the linear plants of many scenes; each distinct one is computed once.

    Args:
        simulation: Common part of the scenes.
        sample_time_ns: Sample time, common or one for each scene, shape (n_scenes,) [ns].
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
