"""Cost of one step of an algorithm: its own run fed to a fresh controller, interleaved with the others.

Times are of this machine at this moment: for comparing the columns of one table, never a pass mark.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Final

from canhaptic.drive.clock import WallClock
from canhaptic.lab.loop.axis_loop import Case, LoopRun

_Block = list[tuple[float, float]]
"""(position, torque applied) of each step; of a group a list of each."""

_STEPS: Final = 2000
"""Steps of one timing, from the middle of a run, where contacts are."""
_BLOCK: Final = 250
"""Steps between two readings of the clock: short enough that some repeat of each block is not interrupted."""


def microseconds_per_step(cases: Mapping[str, tuple[Case, LoopRun]], repeats: int) -> dict[str, float]:
    """Return the time of a step [us]: each block of steps at its least over interleaved repeats.

    Args:
        cases: Algorithm -> its case and the run that it is fed with; one without steps is left out.
        repeats: Repeats of each, in turn A B C A B C, so that a drifting machine affects all alike.
    """
    blocks = {name: _blocks(run) for name, (_, run) in cases.items() if run.position.size}
    best = {name: [float("inf")] * len(of_run) for name, of_run in blocks.items()}
    for _ in range(repeats):
        for name, of_run in blocks.items():
            times = _times(cases[name][0].controller().step, of_run)
            best[name] = [min(pair) for pair in zip(best[name], times, strict=True)]
    steps = {name: sum(len(block) for block in of_run) for name, of_run in blocks.items()}
    return {name: sum(times) * 1e-3 / steps[name] for name, times in best.items()}


def _times(step: Callable[[float, float], object], blocks: Sequence[_Block]) -> list[int]:
    clock, times = WallClock(), []
    for block in blocks:
        begin = clock.now()
        for position, torque in block:
            step(position, torque)
        times.append(clock.now() - begin)
    return times


def _blocks(run: LoopRun) -> list[_Block]:
    begin = max(0, (len(run.position) - _STEPS) // 2)
    part = slice(begin, begin + _STEPS)
    pairs = list(zip(run.position[part].tolist(), run.torque[part].tolist(), strict=True))
    return [pairs[start : start + _BLOCK] for start in range(0, len(pairs), _BLOCK)]
