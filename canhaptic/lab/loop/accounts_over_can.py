"""One scene under several algorithms, each over its simulated drives: the account of every run."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, TypedDict

from canhaptic.cycle import run
from canhaptic.errors import CanHapticError, InputError, ParameterError
from canhaptic.registry import load
from canhaptic.scene.build import build
from canhaptic.scene.experiment_account import experiment_account
from canhaptic.scene.models import Scene

Progress = Callable[[int], None]


def known_algorithms(table: Mapping[str, str], kind: str, algorithms: Sequence[str] | None) -> list[str]:
    """Requested names, each known; all of them for None.

    Args:
        table: Name -> "module:Class".
        kind: Kind of the algorithms, for the message.
        algorithms: Requested names.

    Raises:
        ParameterError: One is unknown.
    """
    for name in algorithms or ():
        load(table, name, kind)
    return list(dict.fromkeys(algorithms or table))


def accounts_over_can(
    scene: Scene, names: Sequence[str], cycles: int, under: Callable[[Scene, str], Scene], progress: Progress | None
) -> dict[str, dict[str, Any]]:
    """Return the account of a run under each algorithm, with its `status` and a `remark`; a refused one has no more.

    Args:
        scene: Scene with all its drives simulated in this process.
        names: Names of the algorithms.
        cycles: SYNCs of each run.
        under: (scene, name) -> the scene under that algorithm; may refuse with a ParameterError.
        progress: Called with the number of cycles done so far, of all runs together.

    Raises:
        InputError: The drives are not simulated in this process.
    """
    if not scene.simulated:
        raise InputError(f"{scene.source}: compare needs bus.interface: virtual and a `simulation`; add them")
    found = {}
    for number, name in enumerate(names):
        report = None if progress is None else partial(_count, progress, number * cycles)
        found[name] = _account(scene, name, cycles, under, report)
    return found


class Heading(TypedDict):
    """Heading of a comparison."""

    scene: str
    config_hash: str
    path: str  # "can", or "direct" without a bus
    rate: float  # [Hz]
    delay: int  # [holds]
    cycles: int
    duration: float  # [s]


def heading_of(scene: Scene, cycles: int, path: str = "can") -> Heading:
    """Heading of a comparison."""
    return {
        "scene": scene.source,
        "config_hash": scene.config_hash(),
        "path": path,
        "rate": 1.0 / scene.bus.sample_time,
        "delay": scene.bus.delay,
        "cycles": cycles,
        "duration": cycles * scene.bus.sample_time,
    }


def _count(progress: Progress, before: int, cycles: int) -> None:
    progress(before + cycles)


def _account(
    scene: Scene, name: str, cycles: int, under: Callable[[Scene, str], Scene], progress: Progress | None
) -> dict[str, Any]:
    try:
        experiment = build(under(scene, name), "free")
    except ParameterError as error:
        return {"status": "refused", "remark": str(error)}
    status, remark = "completed", ""
    with experiment:
        try:
            run(experiment.cycle, cycles, progress=progress)
        except CanHapticError as error:
            status, remark = "stopped", str(error)
        return {**experiment_account(experiment, status, 0.0), "remark": remark}
