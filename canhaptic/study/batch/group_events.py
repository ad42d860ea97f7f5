"""Motors of a group whose plants have events, stops or dry friction, in the loop of the group.

Plants of their own side by side are one `EventPlant` each; a stage is one plant of several motors. All modes that a
plant can enter are compiled beforehand, so that the loop is never interrupted.
"""

from collections.abc import Callable, Sequence
from math import prod
from typing import Any, Final, NamedTuple

import numpy as np

from canhaptic.kernels import Indices
from canhaptic.kernels.records import records_of
from canhaptic.sim.plant.accuracy_parameters import AccuracyParameters
from canhaptic.sim.plant.assembly import PlantModel
from canhaptic.sim.plant.stepper import MISSING, MODE, NONE
from canhaptic.study.batch.closed_loop import MOVED
from canhaptic.study.batch.event_plant import EventState, move_held
from canhaptic.study.batch.event_plants import EventModes, by_its_way, is_booked
from canhaptic.study.batch.group_closed_loop import GroupRoom, move_motors

_MOST_MODES: Final = 100
"""Modes of one plant at most; more would take longer to compile than a run."""


class EventMotors(NamedTuple):
    """Motors whose plants have events."""

    plants: Any  # `EventPlant` of each
    owners: Indices  # of each motor: number of its plant
    forces: Indices  # place of its torque in the state of that
    places: Indices  # place of its position


class EventMotorsPlan(NamedTuple):
    """What motors with events are made of."""

    models: Sequence[Callable[[], PlantModel]]
    accuracy: Sequence[AccuracyParameters | None]
    owners: Sequence[int]
    forces: Sequence[int]
    places: Sequence[int]

    def made(self, *, listed: bool) -> EventMotors:
        """Returns them at their start.

        Args:
            listed: Whether Python runs the loop, on lists.
        """
        plants = []
        for model, accuracy in zip(self.models, self.accuracy, strict=True):
            modes = EventModes(model(), accuracy, listed=listed)
            modes.complete()
            found = modes.plants([EventState()] if listed else records_of([EventState()]))
            found.plant.counts[MODE], found.plant.counts[MISSING] = found.first, NONE
            plants.append(found.plant)
        whole: Callable[[Sequence[int]], Any] = list if listed else np.array
        return EventMotors(tuple(plants), *(whole(part) for part in (self.owners, self.forces, self.places)))


def why_not_events(model: PlantModel) -> str:
    """Returns "" when a plant can move in the loop of a group, else the reason by name."""
    if model.efforts:
        return "a force that is solved over substeps"
    if is_booked(model) or model.commands or model.encoders:
        return "a current loop, or an effect on torque or encoder"
    modes = prod(len(part.modes) for part in model.parts)
    return "" if modes <= _MOST_MODES else f"a plant of {modes} modes, expected {_MOST_MODES} at most"


def move_event_motors(motors: EventMotors, room: GroupRoom, cycle: int) -> float:
    """Takes the place of `move_motors`; positions are NaN where a plant had too many events."""
    work, count, is_moved = 0.0, len(room.held), True
    if cycle:
        for i in range(count):
            motors.plants[motors.owners[i]].state[motors.forces[i]] = room.held[i]
        for k in range(len(motors.plants)):
            if move_held(motors.plants[k], cycle) != MOVED:
                is_moved = False
    for i in range(count):
        at = motors.plants[motors.owners[i]].state[motors.places[i]] if is_moved else float("nan")
        room.moved[i] = at - room.true[i] if cycle else 0.0
        room.true[i] = room.read[i] = at
        work += room.held[i] * room.moved[i]
    return work


def event_replacements() -> dict[Any, Any]:
    """Returns what the loop of a group calls in the place of other functions for motors with events."""
    return {**by_its_way(), move_motors: move_event_motors}
