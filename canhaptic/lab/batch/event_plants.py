"""Plants with events for many loops: the modes of one plant as kernels take them, compiled when they are entered.

Scenes with the same plant share its modes, which cost some milliseconds each.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from canhaptic.control.certificates.late_torque import free_of_late, largest_of_late
from canhaptic.control.certificates.torque_bound import doubt_of_late, end_gap
from canhaptic.errors import EventLimitError
from canhaptic.kernels.records import Records, number_in, records_of
from canhaptic.lab.batch import closed_loop, event_plant
from canhaptic.lab.batch.event_plant import (
    EventPlant,
    EventPlants,
    EventState,
    begin_events,
    book_motor,
    book_nothing,
    booked_work,
    events_at,
    move_events,
)
from canhaptic.lab.batch.event_substeps import residual_of_plant, run_substeps
from canhaptic.lab.batch.varied import simulation_with
from canhaptic.lab.loop.axis_loop import Array
from canhaptic.scene.models import AxisSimulation
from canhaptic.scene.parts import effect_of
from canhaptic.sim.plant import splitting, stepper
from canhaptic.sim.plant.accuracy_parameters import AccuracyParameters
from canhaptic.sim.plant.assembly import PlantModel, collect
from canhaptic.sim.plant.effort_forces import Bristle, Effort
from canhaptic.sim.plant.hybrid_automaton import PRODUCTS_EACH, HybridAutomaton
from canhaptic.sim.plant.mode_arrays import Books, evaluate, flat_tables, largest_term, move, pace, stored
from canhaptic.sim.plant.propagator import TICKS
from canhaptic.sim.plant.stepper import COUNTS, EVENTS, LIMIT, MODE, NONE, ModeTables, StepperSettings

_PRODUCTS: Final = {
    getattr(stepper, function.__name__): function for function in (move, evaluate, pace, largest_term, stored)
}

CALLS: Final = (
    stepper.run, splitting.fixed_point, residual_of_plant, doubt_of_late, end_gap, free_of_late, largest_of_late,
)  # fmt: skip
"""Long functions, called from several places, and certificates that most loops reach at few SYNCs, or never."""


Plants = closed_loop.LinearPlants | EventPlants
"""What a loop of a batch moves."""
Interrupted = Callable[[Plants, int, closed_loop.Interruption, int], Plants | None]
"""(plants, number of a scene, its place, why) -> plants to go on with; None ends that scene."""


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
    """The modes of one plant, and its start.

    Args:
        scene: Model of the plant.
        accuracy: Accuracy; the defaults when None.
        listed: Whether Python runs the loop, on lists.
        is_booked: Whether the motor's work is booked; None: as the plant requires.
    """

    def __init__(
        self, scene: PlantModel, accuracy: AccuracyParameters | None, *, listed: bool, is_booked: bool | None = None
    ) -> None:
        accuracy = accuracy or AccuracyParameters()
        self._machine = machine = HybridAutomaton(scene, accuracy.max_events, accuracy.event_bits)
        self._settings = StepperSettings(
            accuracy.max_events, accuracy.event_bits, machine.tick_time, PRODUCTS_EACH * accuracy.max_events
        )
        self._start, self._first = machine.state.copy(), machine.modes.index(machine.mode)
        self._is_booked = works_are_booked(scene) if is_booked is None else is_booked
        self._substeps = accuracy.substeps
        self._listed = listed
        names = [*scene.names]
        extra = (names.index("travel"), names.index("effort")) if scene.efforts else (0, 0)
        self._places = (names.index(scene.motor_torque), *extra)
        changes = [(round(time / machine.tick_time), part, mode) for time, part, mode in scene.schedule]
        self._changes = sorted(changes, key=lambda change: change[0])
        self._change_targets: list[dict[int, int]] = [{} for _ in changes]
        self._form: Callable[[Any], Any] = (lambda array: array.tolist()) if listed else np.ascontiguousarray

    def plants(self, now: Sequence[EventState] | Records) -> EventPlants:
        """Return the plant at its start.

        Args:
            now: (`EventState`,), records where the loop is compiled.
        """
        form, names = self._form, self._machine.scene.names
        room = 2 * len(names) if self._is_booked else 0
        state, spare, began = (form(self._start.copy()) for _ in range(3))
        plant = EventPlant(
            self._tables(), self._settings, state, spare, began,
            (Books(form(np.zeros(len(self._machine.scene.works))), form(np.zeros(room))),),
            form(np.zeros(COUNTS, dtype=np.int64)), self._values(),
            form(np.array([place for place, name in enumerate(names) if name.endswith("_sine")], dtype=np.int64)),
            form(np.array([tick for tick, _, _ in self._changes], dtype=np.int64)), self._targets(), now,
            form(self._start.copy()), *self._efforts(), TICKS // self._substeps, *self._places,
        )  # fmt: skip
        return EventPlants(plant, form(self._start), self._first)

    def complete(self) -> None:
        """Compile every mode that can be entered."""
        machine, mode = self._machine, 0
        while mode < len(machine.modes):
            for guard, target in enumerate(list(machine.targets[mode])):
                if target == NONE:
                    machine.connect(mode, guard)
            for (_, part, part_mode), targets in zip(self._changes, self._change_targets, strict=True):
                targets[mode] = machine.number_with(mode, part, part_mode)
            mode += 1

    def completed(self, plants: EventPlants) -> EventPlants:
        """Return the same plant with the mode compiled that interrupted its loop."""
        mode, guard, change = (int(number_in(plants.plant.now[0], name)) for name in ("mode", "guard", "change"))
        if guard != NONE:
            self._machine.connect(mode, guard)
        else:
            _, part, part_mode = self._changes[change]
            self._change_targets[change][mode] = self._machine.number_with(mode, part, part_mode)
        plant = plants.plant._replace(tables=self._tables(), values=self._values(), change_targets=self._targets())
        return plants._replace(plant=plant)

    def error(self, plants: EventPlants, cycle: int) -> EventLimitError:
        """Reason why a loop was stopped in the hold before a SYNC."""
        machine, plant = self._machine, plants.plant
        where = f"plant before {cycle * TICKS * machine.tick_time:.9g} s"
        described = machine.described(int(plant.counts[MODE]), [float(value) for value in plant.state])
        used_up = plant.counts[EVENTS] < plant.counts[LIMIT]
        return EventLimitError(
            self._settings.max_events, described, where, self._settings.max_products if used_up else 0
        )

    def _tables(self) -> ModeTables:
        tables = flat_tables(self._machine.modes, self._machine.targets, len(self._machine.scene.works))
        size = len(self._machine.scene.names) if self._is_booked else 0
        return ModeTables(*map(self._form, tables._replace(works=tables.works[..., : 2 * size])))

    def _efforts(self) -> tuple[Any, Any]:
        """Return the efforts, and their bristles twice."""
        efforts = [getattr(effort, "effort", None) for effort in self._machine.scene.efforts]
        bristles = [Bristle() for _ in range(2 * len(efforts))]
        if self._listed:
            return efforts, bristles
        return records_of(efforts or [Effort(0)])[: len(efforts)], records_of(bristles or [Bristle()])[: len(bristles)]

    def _targets(self) -> Any:
        targets = np.full((len(self._changes), len(self._machine.modes)), NONE)
        for row, known in zip(targets, self._change_targets, strict=True):
            for mode, target in known.items():
                row[mode] = target
        return self._form(targets)

    def _values(self) -> Any:
        width = 2 * max(len(mode.exits) for mode in self._machine.modes) + len(self._machine.scene.names)
        return self._form(np.zeros(width)), self._form(np.zeros(width))


def by_its_way() -> dict[object, object]:
    """Replacements in a loop where the motor's work is its torque times displacement."""
    return {**_PRODUCTS, stepper.book: book_nothing}


def works_are_booked(scene: PlantModel) -> bool:
    """Whether the motor's work is more than its torque times displacement: by a current loop, or a ripple."""
    return scene.motor_torque != "torque" or any(effort.account == "motor" for effort in scene.efforts)


def replacements(scene: PlantModel) -> dict[object, object]:
    """Replacements in a loop of plants with events.

    Args:
        scene: Model of one of the plants.
    """
    found: dict[object, object] = {
        **by_its_way(), closed_loop.move_plant: move_events, closed_loop.begin_plant: begin_events,
        closed_loop.plant_at: events_at,
    }  # fmt: skip
    if scene.efforts:
        found |= {event_plant.run_ticks: run_substeps, splitting.residual: residual_of_plant}
    if works_are_booked(scene):
        return found | {stepper.book: book_motor, closed_loop.work_in: booked_work}
    return found
