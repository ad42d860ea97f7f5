"""A plant with events in the loop of a batch: replacements of `closed_loop.move_plant`; kernels.

The modes, the stepper and what is solved over substeps are those of `canhaptic.sim.plant`, on arrays of all modes. A
mode that is not compiled yet interrupts the loop: the state goes back to the start of the hold, the caller compiles
the mode, and the hold is taken again, with the same bits.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt
from typing import Any, Final, NamedTuple

from canhaptic.kernels import Buffer, Indices
from canhaptic.kernels.records import Records
from canhaptic.lab.batch.closed_loop import MOVED
from canhaptic.sim.plant.effort_forces import Bristle, Effort
from canhaptic.sim.plant.mode_arrays import Books, move
from canhaptic.sim.plant.propagator import TICKS
from canhaptic.sim.plant.stepper import EVENTS, LIMIT, MISSING, MODE, NONE, ModeTables, StepperSettings, run

INCOMPLETE: Final = 1
"""A mode has to be compiled: `EventState.mode` and what leads out of it say which."""
STOPPED: Final = 2
"""There were more events in the hold than are allowed."""


_TIDY: Final = 1024
"""Sample times between two tidyings of rounding, as in `Plant`."""


@dataclass(slots=True)
class EventState:
    """State of a plant kept from hold to hold, in addition to its state vector."""

    changes: int = 0  # of the timetable that are done
    force: float = 0.0  # of the efforts in the substep before [N or N*m]
    slope: float = -1.0  # of their residual there
    rippled: float = 0.0  # work of a torque ripple [J]
    is_stopped: bool = False  # by too many events
    mode: int = NONE  # in which a further mode is missing
    guard: int = NONE  # that leads to it, or
    change: int = NONE  # of the timetable that does
    began_work: float = 0.0  # of the motor [J]
    began_mode: int = 0  # at the start of the hold, with `EventPlant.began`
    began_events: int = 0
    began_changes: int = 0
    began_force: float = 0.0
    began_slope: float = 0.0
    began_ripple: float = 0.0
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
    """A plant with events, used by many loops in turn; all but the tables is changed in place."""

    tables: ModeTables
    settings: StepperSettings
    state: Any  # z = [states..., torque, 1]
    spare: Any
    began: Buffer  # z at the start of the hold
    books: tuple[Books]  # (Books,), the first work of which is that of the motor
    counts: Indices  # see `stepper`
    values: tuple[Buffer, Buffer]  # two buffers for the values of guards
    sines: Indices  # places of the hand's oscillators in the state: a cosine follows each sine
    change_ticks: Indices  # of the timetable, in order
    change_targets: Sequence[
        Indices
    ]  # by change and mode: the mode that it leads to, or NONE when that is not compiled yet
    now: Sequence[EventState] | Records  # (EventState,)
    saved: Buffer  # z at the start of the substep
    efforts: Sequence[Effort] | Records  # `Effort` of each force that is solved over substeps
    bristles: Sequence[Bristle] | Records  # `Bristle` of each, and once more at the start of the hold
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
    plant.counts[MODE], plant.counts[EVENTS], plant.counts[MISSING] = plants.first, 0, NONE
    plant.books[0].totals[0] = 0.0
    now.changes, now.force, now.slope, now.rippled = 0, 0.0, -1.0, 0.0
    for i in range(len(plant.bristles)):
        plant.bristles[i].deflection = 0.0


def events_at(plants: EventPlants, row: int) -> EventPlant:
    """Return the plant of a loop."""
    return plants.plant


def move_events(plant: EventPlant, torque: float, cycle: int) -> int:
    """Move a plant to a SYNC under a constant torque [N or N*m]; return MOVED, INCOMPLETE or STOPPED."""
    plant.state[len(plant.state) - 2] = torque
    return move_held(plant, cycle)


def move_held(plant: EventPlant, cycle: int) -> int:
    """The same under the torque held in its state."""
    counts, now = plant.counts, plant.now[0]
    keep(plant)
    end = cycle * TICKS
    tick, left = end - TICKS, 0
    most = counts[EVENTS] + plant.settings.max_events + 1
    counts[MISSING] = NONE
    while now.changes < len(plant.change_ticks) and plant.change_ticks[now.changes] < end:
        at = plant.change_ticks[now.changes]
        if at > tick:
            left = run_ticks(plant, at - tick, most)
            tick = at
        if left or counts[MISSING] != NONE:
            break
        target = plant.change_targets[now.changes][counts[MODE]]
        if target == NONE:
            return interrupt(plant, NONE, now.changes)
        counts[MODE] = target
        now.changes += 1
    if not left and counts[MISSING] == NONE:
        left = run_ticks(plant, end - tick, most)
    if counts[MISSING] != NONE:
        return interrupt(plant, counts[MISSING], NONE)
    if cycle % _TIDY == 0:
        tidy(plant)
    return STOPPED if left else MOVED


def run_ticks(plant: EventPlant, ticks: int, most: int) -> int:
    """Move by some ticks; return those left at the limit of events, or before a missing mode."""
    return run_on(plant, ticks, most)


def run_on(plant: EventPlant, ticks: int, most: int) -> int:
    """The same by the stepper alone, through every event."""
    plant.counts[LIMIT] = most
    state, _, left = run(
        plant.tables, plant.settings, plant.state, plant.spare, plant.books, plant.counts, plant.values, ticks
    )
    for row in range(len(plant.state)):
        plant.state[row] = state[row]
    return left


def tidy(plant: EventPlant) -> None:
    """Bring the hand's oscillators back to unit amplitude."""
    state = plant.state
    for i in range(len(plant.sines)):
        sine, cosine = state[plant.sines[i]], state[plant.sines[i] + 1]
        norm = sqrt(sine * sine + cosine * cosine)
        state[plant.sines[i]], state[plant.sines[i] + 1] = sine / norm, cosine / norm


def keep(plant: EventPlant) -> None:
    """Save everything that a hold changes."""
    state, now = plant.state, plant.now[0]
    for row in range(len(state)):
        plant.began[row] = state[row]
    now.began_mode, now.began_events = plant.counts[MODE], plant.counts[EVENTS]
    now.began_changes, now.began_force, now.began_slope = now.changes, now.force, now.slope
    now.began_ripple, now.is_stopped = now.rippled, False
    count = len(plant.efforts)
    for i in range(count):
        plant.bristles[count + i].deflection = plant.bristles[i].deflection
    now.began_work = plant.books[0].totals[0]


def interrupt(plant: EventPlant, guard: int, change: int) -> int:
    """Return to the start of the hold, and record the missing mode."""
    state, counts, now = plant.state, plant.counts, plant.now[0]
    now.mode, now.guard, now.change = counts[MODE], guard, change
    for row in range(len(state)):
        state[row] = plant.began[row]
    counts[MODE], counts[EVENTS], counts[MISSING] = now.began_mode, now.began_events, NONE
    plant.books[0].totals[0], now.changes = now.began_work, now.began_changes
    now.force, now.slope, now.rippled = now.began_force, now.began_slope, now.began_ripple
    count = len(plant.efforts)
    for i in range(count):
        plant.bristles[i].deflection = plant.bristles[count + i].deflection
    return INCOMPLETE


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
