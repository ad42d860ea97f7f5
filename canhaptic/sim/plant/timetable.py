"""Changes of modes and states at scheduled times (ticks) instead of by a guard; they are made between two steps."""

from collections.abc import Callable
from functools import partial

from canhaptic.sim.plant.hybrid_automaton import HOLDS, HybridAutomaton
from canhaptic.sim.plant.propagator import TICKS

_Entry = tuple[float, Callable[[], None]]


class Timetable:
    """Runs a scene's solver and makes the scheduled changes in between.

    Args:
        machine: Automaton whose parts change mode.
        run: Function that moves the machine by some ticks without scheduled changes.

    Attributes:
        tick: Present tick; set before a run by a caller that advanced the machine without a change.
    """

    def __init__(self, machine: HybridAutomaton, run: Callable[[int], object]) -> None:
        self._run, scene = run, machine.scene
        entries: list[_Entry] = [(time, partial(machine.set_part_mode, *change)) for time, *change in scene.schedule]
        entries += [(time, partial(machine.set_states, values)) for time, values in scene.settings]
        ticks = [(round(time / machine.tick_time), change) for time, change in entries]
        self._entries = sorted(ticks, key=lambda entry: entry[0])
        self.reset()

    def reset(self) -> None:
        """Return to tick 0."""
        self.tick = self._done = 0

    def holds_from(self, tick: int) -> int:
        """Return the number of whole sample times after a tick without a change; at most `HOLDS`."""
        if self._done == len(self._entries):
            return HOLDS
        return min(HOLDS, max(0, self._entries[self._done][0] - tick) // TICKS)

    def run(self, ticks: int) -> None:
        """Move by `ticks`, with the changes on the way."""
        end = self.tick + ticks
        while self._done < len(self._entries) and self._entries[self._done][0] < end:
            tick, change = self._entries[self._done]
            if tick > self.tick:
                self._run(tick - self.tick)
                self.tick = tick
            change()
            self._done += 1
        self._run(end - self.tick)
        self.tick = end
