"""What one step of an algorithm costs: its own run fed to a fresh controller, interleaved with the others.

Times are of this machine at this moment: for comparing the columns of one table, never a pass mark.
"""

from collections.abc import Mapping
from typing import Final

from canhaptic.drive.clock import WallClock
from canhaptic.study.loop import LoopCase, LoopRun

_STEPS: Final = 2000
"""Steps of one timing, from the middle of a run, where contacts are."""


def microseconds_per_step(cases: Mapping[str, tuple[LoopCase, LoopRun]], repeats: int) -> dict[str, float]:
    """Returns the least time of a step over interleaved repeats [us].

    Args:
        cases: Algorithm -> what it is and the run that it is fed with.
        repeats: Of each, in turn A B C A B C, so that a drifting machine hits all alike.
    """
    clock, best = WallClock(), dict.fromkeys(cases, float("inf"))
    inputs = {name: _inputs(run) for name, (_, run) in cases.items()}
    for _ in range(repeats):
        for name, (case, _) in cases.items():
            step, pairs = case.controller().step, inputs[name]
            begin = clock.now()
            for position, torque in pairs:
                step(position, torque)
            best[name] = min(best[name], (clock.now() - begin) * 1e-3 / len(pairs))
    return best


def _inputs(run: LoopRun) -> list[tuple[float, float]]:
    begin = max(0, (len(run.position) - _STEPS) // 2)
    part = slice(begin, begin + _STEPS)
    return list(zip(run.position[part].tolist(), run.torque[part].tolist(), strict=True))
