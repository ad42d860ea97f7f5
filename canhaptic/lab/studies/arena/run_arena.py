"""All of an arena: cases to workers, finished ones to the store as they come, then the rig, then the ranking."""

from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

from canhaptic.control.passivity import ALGORITHMS
from canhaptic.errors import InputError
from canhaptic.lab.loop.algorithms import chosen_algorithms
from canhaptic.lab.studies.arena.arena_cases import (
    CaseFigures,
    CaseGroup,
    entry_of,
    group_figures,
    is_own,
    label_of,
    scene_under,
)
from canhaptic.lab.studies.arena.arena_store import ArenaStore, code_hash
from canhaptic.lab.studies.arena.rig_figures import borders, impedances, mass_widths, theory, times_of_steps
from canhaptic.lab.studies.arena.standings import given_out, ranks, standings
from canhaptic.lab.studies.sweep.run_sweep import Progress
from canhaptic.lab.studies.sweep.workers import SerialExecutor
from canhaptic.package_data import shipped

RATES: Final = (100.0, 300.0, 1000.0, 3000.0, 8000.0)  # [Hz]
DELAYS: Final = (0, 1)
LONGEST: Final = 2.0  # [s] of one run
PER_DECADE: Final = 12
"""Stiffnesses in a decade of the K-B plot."""
_FEW: Final = 4
"""Groups under way at once."""
_LOOK: Final = 0.2  # [s] between two looks at a request to stop


@dataclass(frozen=True, slots=True)
class ArenaPlan:
    """Scenes, rates, delays and algorithms of an arena.

    Attributes:
        scenes: Files, of one simulated axis each.
        algorithms: Names, and `FILE.py:Class` of one's own.
        rates: [Hz].
        delays: Whole holds, 0 or 1.
        longest: Duration of a run at most [s].
        rig: Scene of the K-B plot.
        per_decade: Stiffnesses in a decade of the K-B plot; 0: nothing is measured on the rig.
        allow_code: Whether the files named may run.
    """

    scenes: tuple[Path, ...]
    algorithms: tuple[str, ...] = tuple(ALGORITHMS)
    rates: tuple[float, ...] = RATES
    delays: tuple[int, ...] = DELAYS
    longest: float = LONGEST
    rig: Path = shipped("configs") / "arena_rig.yaml"
    per_decade: int = PER_DECADE
    allow_code: bool = False

    def groups(self) -> list[CaseGroup]:
        """Return the cases, those that share a continuous run together."""
        return [
            CaseGroup(path, rate, self.delays, self.algorithms, self.longest, self.allow_code)
            for path in self.scenes
            for rate in self.rates
        ]

    def names(self) -> list[str]:
        """Return the names of the algorithms in results, each once."""
        return list(dict.fromkeys(map(label_of, self.algorithms)))

    def check(self) -> None:
        """Look at every scene and algorithm before anything runs.

        Raises:
            InputError: One cannot be used.
        """
        if not (self.scenes and self.algorithms and self.rates and self.delays):
            raise InputError("arena: got no scene, algorithm, rate or delay; leave the option out to take all")
        if not set(self.delays) <= {0, 1}:
            raise InputError(f"arena: got the delays {self.delays}, expected 0 (event) or 1 (synchronous)")
        if len(self.names()) < len(self.algorithms) or len({path.stem for path in self.scenes}) < len(self.scenes):
            raise InputError("arena: two scenes or two algorithms have one name; give each file another name")
        chosen_algorithms([name for name in self.algorithms if not is_own(name)] or None)
        for path in self.scenes:
            scene_under(path, "unprotected", allow_code=self.allow_code)
        for name in self.algorithms:
            if is_own(name):
                entry_of(name, self.scenes[0], self.allow_code)


def run_arena(
    plan: ArenaPlan,
    store: ArenaStore,
    executor: Executor | None = None,
    progress: Callable[[Progress], None] = lambda _: None,
    stop_requested: Callable[[], bool] = lambda: False,
) -> dict[str, Any] | None:
    """Return everything that was found as plain values; None where it was stopped, what is finished is then kept.

    Args:
        plan: What is run.
        store: Store of finished cases.
        executor: Where groups of cases run; None: in this thread.
        progress: Called with how many are finished.
        stop_requested: Asked now and then.

    Raises:
        InputError: A scene, an algorithm or the store cannot be used.
    """
    plan.check()
    groups = plan.groups()
    if not _run_cases(groups, store, executor, progress, stop_requested):
        return None
    cases = [case for group in groups for case in store.finished(group)]
    found: dict[str, Any] = {
        "canhaptic": version("canhaptic"),
        "code": code_hash(),
        "scenes": [path.stem for path in plan.scenes],
        "algorithms": plan.names(),
        "rates": list(plan.rates),
        "delays": list(plan.delays),
        "longest": plan.longest,
        "standings": (rows := standings(plan.names(), cases)),
        "ranks": ranks(rows),
        "given_out": given_out(plan.names(), cases),
        "cases": cases,
    }
    return found | (_of_rig(plan, stop_requested) if plan.per_decade else {})


def _run_cases(
    groups: Sequence[CaseGroup],
    store: ArenaStore,
    executor: Executor | None,
    progress: Callable[[Progress], None],
    stop_requested: Callable[[], bool],
) -> bool:
    """Run what is not in the store; return whether all is."""
    total = sum(len(group.delays) * len(group.algorithms) for group in groups)
    done = begun = sum(len(store.finished(group)) for group in groups)
    progress(Progress(done, total, begun))
    under_way: dict[Future[list[CaseFigures]], CaseGroup] = {}
    waiting, at_once = list(groups), 1 if executor is None else _FEW
    executor = executor or SerialExecutor()
    while (waiting or under_way) and not stop_requested():
        while waiting and len(under_way) < at_once:
            group = waiting.pop(0)
            known = [(case["delay"], case["algorithm"]) for case in store.finished(group)]
            under_way[executor.submit(group_figures, group, known)] = group
        ready, _ = wait(under_way, timeout=_LOOK, return_when=FIRST_COMPLETED)
        for future in ready:
            found = future.result()
            store.add(under_way.pop(future), found)
            done += len(found)
            progress(Progress(done, total, begun))
    for future in under_way:
        future.cancel()
    return not (waiting or under_way)


def _of_rig(plan: ArenaPlan, stop_requested: Callable[[], bool]) -> dict[str, Any]:
    """Return what is measured on the rig; what a request to stop leaves out is missing."""
    found: dict[str, list[dict[str, Any]]] = {"borders": [], "impedance": []}
    for name in plan.algorithms:
        for delay in plan.delays:
            if not stop_requested():
                found["borders"] += borders(plan.rig, name, delay, plan.per_decade, allow_code=plan.allow_code)
                found["impedance"] += impedances(plan.rig, name, delay, allow_code=plan.allow_code)
    return {
        "rig": plan.rig.stem,
        **found,
        "theory": {str(delay): theory(plan.rig, delay) for delay in plan.delays},
        "time_of_step": times_of_steps(plan.rig, plan.algorithms, allow_code=plan.allow_code),
        "m_width": mass_widths(plan.rig),
    }
