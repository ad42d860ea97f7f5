"""How many cycles a second a scene runs flat out, and the master of it alone."""

from collections.abc import Callable
from time import process_time
from typing import Any

from canhaptic.cycle import run
from canhaptic.scene.build import build
from canhaptic.scene.models import Scene


def cycles_per_second(scene: Scene, cycles: int = 4000, runs: int = 5) -> tuple[float, float]:
    """Returns the cycles in a second of processor time [1/s], of all and of the master alone; the best of the runs.

    Args:
        scene: With simulated drives; its start does not count.
        cycles: Of each run.
        runs: Of both kinds.
    """
    whole, master = 1e9, 1e9
    for _ in range(runs):
        whole = min(whole, _time(scene, cycles, is_master_alone=False))
        master = min(master, _time(scene, cycles, is_master_alone=True))
    return (cycles - 1) / whole, (cycles - 1) / master


def _time(scene: Scene, cycles: int, *, is_master_alone: bool) -> float:
    """Returns the processor time of a run from its first cycle on, of the simulated side or not [s]."""
    marks: list[float] = []
    spent = [0.0]

    def note(done: int) -> None:
        if done in (1, cycles):
            marks.append(process_time() - spent[0])

    with build(scene, "free") as experiment:
        if is_master_alone:
            drives: Any = experiment.far_side
            for simulated, name in ((drives, "process"), *((plant, "energy") for plant in experiment.plants)):
                setattr(simulated, name, _watched(getattr(simulated, name), spent))
        run(experiment.cycle, cycles, progress=note)
    return marks[1] - marks[0]


def _watched(function: Callable[..., Any], spent: list[float]) -> Callable[..., Any]:
    """Returns a function that adds its processor time to `spent` [s]."""

    def timed(*arguments: Any) -> Any:
        begin = process_time()
        result = function(*arguments)
        spent[0] += process_time() - begin
        return result

    return timed
