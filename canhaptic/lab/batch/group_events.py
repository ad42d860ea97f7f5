"""Motors of a group whose plants have events, current loops or forces over substeps, in the loop of the group.

Plants of their own side by side are one `EventPlant` each; a stage is one plant of several motors. All modes that a
plant can enter are compiled beforehand, so that the loop is never interrupted. All plants use the features of the
stepper that any of them needs, a booked work or substeps: one loop moves them all.
"""

from collections.abc import Callable, Sequence
from math import prod
from typing import Any, Final, NamedTuple

import numpy as np

from canhaptic.kernels import Indices
from canhaptic.kernels.records import records_of
from canhaptic.lab.batch import event_plant
from canhaptic.lab.batch.closed_loop import MOVED
from canhaptic.lab.batch.event_plant import EventPlant, EventState, book_motor, move_held, run_on
from canhaptic.lab.batch.event_plants import EventModes, by_its_way, works_are_booked
from canhaptic.lab.batch.event_substeps import residual_of_plant, run_substeps
from canhaptic.lab.batch.group_closed_loop import GroupRoom, arrive, move_motors
from canhaptic.sim.plant import splitting, stepper
from canhaptic.sim.plant.accuracy_parameters import AccuracyParameters
from canhaptic.sim.plant.assembly import PlantModel
from canhaptic.sim.plant.stepper import MISSING, MODE, NONE

_MOST_MODES: Final = 100
"""Modes of one plant at most; more would take longer to compile than a run."""


class EventMotors(NamedTuple):
    """Motors whose plants have events."""

    plants: Any  # `EventPlant` of each
    owners: Indices  # of each motor: number of its plant
    forces: Indices  # place of its torque in the state of that
    places: Indices  # place of its position


class EventMotorsPlan(NamedTuple):
    """Plants of motors with events, and the places of the motors in them."""

    models: Sequence[Callable[[], PlantModel]]
    accuracy: Sequence[AccuracyParameters | None]
    owners: Sequence[int]
    forces: Sequence[int]
    places: Sequence[int]

    def made(self, *, listed: bool) -> EventMotors:
        """The motors at their start.

        Args:
            listed: Whether Python runs the loop, on lists.
        """
        plants = []
        for model, accuracy in zip(self.models, self.accuracy, strict=True):
            modes = EventModes(model(), accuracy, listed=listed, is_booked=self.is_booked)
            modes.complete()
            found = modes.plants([EventState()] if listed else records_of([EventState()]))
            found.plant.counts[MODE], found.plant.counts[MISSING] = found.first, NONE
            plants.append(found.plant)
        whole: Callable[[Sequence[int]], Any] = list if listed else np.array
        return EventMotors(tuple(plants), *(whole(part) for part in (self.owners, self.forces, self.places)))

    @property
    def is_booked(self) -> bool:
        """Whether the work of a motor is more than its torque times displacement."""
        return any(works_are_booked(model()) for model in self.models)

    def replacements(self) -> dict[object, object]:
        """Replacements in the loop of a group."""
        found: dict[object, object] = {**by_its_way(), move_motors: move_event_motors}
        if any(model().efforts for model in self.models):
            found |= {event_plant.run_ticks: run_with_efforts, splitting.residual: residual_of_plant}
        return found | {stepper.book: book_motor, work_over: booked_over} if self.is_booked else found


def why_not_events(model: PlantModel) -> str:
    """Return "" when a plant can move in the loop of a group, else the reason by name."""
    modes = prod(len(part.modes) for part in model.parts)
    return "" if modes <= _MOST_MODES else f"a plant of {modes} modes, expected {_MOST_MODES} at most"


def run_with_efforts(plant: EventPlant, ticks: int, most: int) -> int:
    """Replace `event_plant.run_ticks` where some plants have forces over substeps."""
    return run_substeps(plant, ticks, most) if len(plant.efforts) else run_on(plant, ticks, most)


def work_over(plant: EventPlant, way: float) -> float:
    """Work of a motor in a hold [J], from its torque times displacement."""
    return way


def booked_over(plant: EventPlant, way: float) -> float:
    """Replace `work_over` where the work is booked."""
    now = plant.now[0]
    booked: float = plant.books[0].totals[0] + now.rippled - (now.began_work + now.began_ripple)
    return booked


def move_event_motors(motors: EventMotors, room: GroupRoom, cycle: int) -> float:
    """Replace `move_motors`; NaN where a plant had too many events."""
    work, count = 0.0, len(room.held)
    if cycle:
        for i in range(count):
            motors.plants[motors.owners[i]].state[motors.forces[i]] = room.acting[i]
        for k in range(len(motors.plants)):
            if move_held(motors.plants[k], cycle) != MOVED:
                return float("nan")
    for i in range(count):
        plant = motors.plants[motors.owners[i]]
        work += work_over(plant, arrive(room, i, plant.state[motors.places[i]], cycle))
    return work
