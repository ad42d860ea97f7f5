"""The motors of a five-bar in the loop of a group; kernels."""

from dataclasses import replace
from typing import Any, NamedTuple

from canhaptic.kernels.records import arrays_of, records_of
from canhaptic.lab.batch.group_closed_loop import GroupRoom, arrive, move_motors
from canhaptic.sim.plant.mechanism.five_bar_linkage import FiveBarMotion
from canhaptic.sim.plant.mechanism.five_bar_motion import (
    FiveBarStack,
    advance_five_bar,
    five_bar_stack,
    place_at,
)
from canhaptic.sim.plant.propagator import TICKS


class FiveBarMotors(NamedTuple):
    """A five-bar and its motors."""

    settings: Any  # (FiveBarSettings,)
    state: Any  # (FiveBarState,)
    stack: FiveBarStack
    left: int  # place of the left motor among those of the group
    right: int


class FiveBarPlan(NamedTuple):
    """A five-bar at its start, and the numbers of its two motors."""

    motion: FiveBarMotion  # at its start
    left: int
    right: int

    def made(self, *, listed: bool) -> FiveBarMotors:
        """The motors at their start; see `EventMotorsPlan.made`."""
        settings, state, stack = [self.motion.settings], [replace(self.motion.state)], five_bar_stack()
        if listed:
            return FiveBarMotors(settings, state, stack, self.left, self.right)
        return FiveBarMotors(records_of(settings), records_of(state), arrays_of(stack), self.left, self.right)

    def replacements(self) -> dict[object, object]:
        """Replacements in the loop of a group."""
        return {move_motors: move_five_bar}


def move_five_bar(motors: FiveBarMotors, room: GroupRoom, cycle: int) -> float:
    """Replace `move_motors`; NaN where the links were pushed through a singular pose."""
    state, settings = motors.state[0], motors.settings[0]
    if cycle:
        torques = (room.acting[motors.left], room.acting[motors.right])
        place = place_at(settings.links, state.left, state.right)
        advance_five_bar(settings, state, motors.stack, place, (cycle - 1) * TICKS, TICKS, torques)
        if state.stuck != 0.0:
            return float("nan")
    return arrive(room, motors.left, state.left, cycle) + arrive(room, motors.right, state.right, cycle)
