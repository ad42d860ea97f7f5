"""Forces that are not piecewise affine, in the loop of a batch: `canhaptic.sim.plant.splitting` on arrays; kernels.

The force of a substep is found by the same secant, with `EventPlant` in the place of the plant.
"""

from typing import Final

from canhaptic.lab.batch.event_plant import EventPlant, run_on
from canhaptic.sim.plant.effort_forces import RIPPLE, bend, mean_force
from canhaptic.sim.plant.splitting import fixed_point, mean_torque
from canhaptic.sim.plant.stepper import EVENTS, MISSING, MODE, NONE

_UNKNOWN_SLOPE: Final = -1.0


def run_substeps(plant: EventPlant, ticks: int, most: int) -> int:
    """Replace `event_plant.run_ticks`: move in substeps that end at their first event at the latest."""
    counts, now = plant.counts, plant.now[0]
    while ticks:
        ticks -= substep(plant, min(ticks, plant.substep_ticks), most)
        if counts[MISSING] != NONE or now.is_stopped or (ticks and counts[EVENTS] >= most):
            return max(ticks, 1)
    return 0


def substep(plant: EventPlant, ticks: int, most: int) -> int:
    """Move by `ticks` or to the first event; return the ticks that passed."""
    state, now = plant.state, plant.now[0]
    now.start, now.held = state[0], state[plant.torque_place]
    force = solve(plant, ticks, most)
    if plant.counts[MISSING] != NONE or now.is_stopped:
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


def solve(plant: EventPlant, ticks: int, most: int) -> float:
    """Force consistent with its own motion; the plant is left at the end of that motion."""
    counts, now = plant.counts, plant.now[0]
    for row in range(len(plant.state)):
        plant.saved[row] = plant.state[row]
    now.saved_mode, now.saved_events, now.saved_work = counts[MODE], counts[EVENTS], plant.books[0].totals[0]
    now.begin, now.ticks = now.held, ticks
    now.limit, now.is_stopped = -1, False
    force, now.slope, found = fixed_point(plant, now.force, now.slope)
    if not found:
        now.limit = most
        force, now.slope, _ = fixed_point(plant, now.force, _UNKNOWN_SLOPE)
    return force


def residual_of_plant(plant: EventPlant, force: float) -> float:
    """Replace `splitting.residual`; 0 where the plant cannot be moved on, which ends the search."""
    state, counts, now = plant.state, plant.counts, plant.now[0]
    if counts[MISSING] != NONE or now.is_stopped:
        return 0.0
    for row in range(len(state)):
        state[row] = plant.saved[row]
    counts[MODE], counts[EVENTS], plant.books[0].totals[0] = now.saved_mode, now.saved_events, now.saved_work
    state[plant.force_place], state[plant.travel_place] = force, 0.0
    limit = now.limit if now.limit >= 0 else counts[EVENTS] + 1
    left = run_on(plant, now.ticks, limit)
    if counts[MISSING] != NONE:
        return 0.0
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
