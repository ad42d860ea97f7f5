"""Loops with plants that have events, grouped by plant."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from canhaptic.errors import EventLimitError
from canhaptic.kernels.records import number_in, records_of
from canhaptic.lab.batch.closed_loop import Interruption
from canhaptic.lab.batch.event_plant import INCOMPLETE, EventState
from canhaptic.lab.batch.event_plants import EventModes, Interrupted, Plants, PlantValues, replacements
from canhaptic.lab.loop.axis_loop import Array


def run_event_plants(
    loops: Any, plants: Sequence[PlantValues], which: Array, stopped: dict[int, EventLimitError], *, listed: bool
) -> None:
    """Run every loop.

    Args:
        loops: `InterpretedLoops` or `CompiledLoops`.
        plants: Each different plant.
        which: Number of the plant of each loop, shape (n,).
        stopped: Called with the numbers of loops whose plants could not be moved on, and why.
        listed: Whether Python runs the loops.
    """
    for number in np.unique(which).tolist():
        plant = plants[int(number)]
        modes = EventModes(plant.scene(), plant.simulation.accuracy, listed=listed)
        some = np.flatnonzero(which == number).tolist()
        loops.run(
            some, modes.plants([EventState()] if listed else records_of([EventState()])), _going_on(modes, stopped)
        )


def _going_on(modes: EventModes, stopped: dict[int, EventLimitError]) -> Interrupted:
    def interrupted(plants: Any, loop: int, place: Interruption, outcome: int) -> Plants | None:
        if outcome == INCOMPLETE:
            return modes.completed(plants)
        stopped[loop] = modes.error(plants, int(number_in(place, "cycle")))
        return None

    return interrupted


def uninterrupted(*_what: object) -> None:
    """Placeholder, which no loop of a linear plant calls."""


def loop_replacements(plants: Sequence[PlantValues]) -> dict[object, object]:
    """Replacements of functions of the loop for plants with events; none for linear ones."""
    return replacements(plants[0].scene()) if plants else {}
