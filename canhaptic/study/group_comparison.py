"""Every group algorithm on one scene, over its simulated drives: the accounts of its groups, and what truly happened.

There is no continuous reference: what a group adds to its network is judged by the plant's own energies alone.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Final

from rich.console import Group, RenderableType
from rich.text import Text

from canhaptic.axis_units import damping_unit
from canhaptic.control.balance import PASSIVE_TOLERANCE
from canhaptic.control.multi_axis import GROUP_ALGORITHMS
from canhaptic.cycle import run
from canhaptic.errors import CanHapticError, InputError, ParameterError
from canhaptic.registry import load
from canhaptic.scene.build import build
from canhaptic.scene.experiment_account import experiment_account
from canhaptic.scene.models import Scene
from canhaptic.study.algorithms import group_under
from canhaptic.study.scenes import cycles_of
from canhaptic.view.si import si
from canhaptic.view.table_style import FigureTable

_NOTHING: Final = "-"


def compare_groups(
    scene: Scene,
    algorithms: Sequence[str] | None = None,
    *,
    duration: float | None = None,
    progress: Callable[[int], None] | None = None,
) -> dict[str, Any]:
    """Returns the accounts of every group of a scene under each algorithm, as plain values.

    Args:
        scene: With groups, and all its drives simulated in this process. Axes that render by themselves keep their
            own algorithm.
        algorithms: Names of `GROUP_ALGORITHMS`; all of them by default.
        duration: [s]; by default the scene's.
        progress: Called with the number of cycles done so far, of all runs together.

    Raises:
        InputError: The drives are not simulated in this process.
        ParameterError: An unknown algorithm.
    """
    if not scene.simulated:
        raise InputError(f"{scene.source}: compare needs bus.interface: virtual and a `simulation`; add them")
    names = group_algorithms(algorithms)
    cycles = cycles_of(scene, duration)
    runs = {}
    for number, name in enumerate(names):
        runs[name] = _run(scene, name, cycles, None if progress is None else partial(_count, progress, number * cycles))
    return {
        "scene": scene.source,
        "config_hash": scene.config_hash(),
        "path": "can",
        "rate": 1.0 / scene.bus.sample_time,
        "delay": scene.bus.delay,
        "cycles": cycles,
        "duration": cycles * scene.bus.sample_time,
        "groups": {
            group.name: {
                "axes": list(group.axes),
                "network": group.network.name,
                "unit": scene.axis(group.axes[0]).parameters.unit,
                "algorithms": {name: _of_group(group.name, found) for name, found in runs.items()},
            }
            for group in scene.groups
        },
    }


def _count(progress: Callable[[int], None], before: int, cycles: int) -> None:
    progress(before + cycles)


def group_algorithms(algorithms: Sequence[str] | None) -> list[str]:
    """Returns the names asked for, each known; all of them for None.

    Raises:
        ParameterError: One is unknown.
    """
    for name in algorithms or ():
        load(GROUP_ALGORITHMS, name, "group algorithm")
    return list(dict.fromkeys(algorithms or GROUP_ALGORITHMS))


def _run(scene: Scene, name: str, cycles: int, progress: Callable[[int], None] | None) -> dict[str, Any]:
    try:
        chosen = replace(scene, groups=tuple(group_under(group, name) for group in scene.groups))
        experiment = build(chosen, "free")
    except ParameterError as error:
        return {"status": "refused", "remark": str(error)}
    status, remark = "completed", ""
    with experiment:
        try:
            run(experiment.cycle, cycles, progress=progress)
        except CanHapticError as error:
            status, remark = "stopped", str(error)
        return {**experiment_account(experiment, status, 0.0), "remark": remark}


def _of_group(name: str, found: Mapping[str, Any]) -> dict[str, Any]:
    account: dict[str, Any] = {"status": found["status"], "remark": found["remark"]}
    if "ports" not in found:
        return account
    return account | {**found["ports"][name], "truth": found["truth"].get(name)}


# --- the table ----------------------------------------------------------------------------------------------------


def group_comparison_report(result: Mapping[str, Any]) -> RenderableType:
    """Returns one table per group: a column per algorithm, a row per figure."""
    heading = Text(" ")
    heading.append(str(result["scene"]), style="bold")
    heading.append(
        f"   {si(result['rate'], 'Hz', 3)}, delay {result['delay']}, {result['duration']:.4g} s, over the CAN path"
    )
    parts: list[RenderableType] = [heading]
    for name, group in result["groups"].items():
        parts.append(Text(f" {name}: {group['network']} on {', '.join(group['axes'])}"))
        parts.append(_table(group))
        parts += [
            Text(f" {algorithm}: {account['remark']}", style="yellow")
            for algorithm, account in group["algorithms"].items()
            if account["remark"]
        ]
    return Group(*parts)


def _table(group: Mapping[str, Any]) -> FigureTable:
    table = FigureTable(pad_edge=False, padding=(0, 1, 0, 0))
    table.add_column("", no_wrap=True)
    for name in group["algorithms"]:
        table.add_column(name.replace("_", "\n"), justify="right", no_wrap=True, min_width=10)
    for label, read in _ROWS.items():
        cells = [_cell(read, account, group["unit"]) for account in group["algorithms"].values()]
        if any(str(cell) != _NOTHING for cell in cells):
            table.add_row(label, *cells)
    return table


def _cell(read: Callable[[Mapping[str, Any], str], str | float], account: Mapping[str, Any], unit: str) -> Text:
    try:
        value = read(account, unit)
    except (KeyError, TypeError):  # refused, or nothing to measure
        return Text(_NOTHING)
    if isinstance(value, str):
        return Text(value, style={"yes": "green", "in doubt": "yellow", "no": "red"}.get(value, ""))
    return Text(si(value, "J", 3), style="red" if value < -PASSIVE_TOLERANCE else "")


def _damping(account: Mapping[str, Any], unit: str) -> str:
    rendered = account["damping_rendered"]
    return f"{rendered['least']:.3g}..{rendered['most']:.3g} {damping_unit(unit)}"


_ROWS: Final[dict[str, Callable[[Mapping[str, Any], str], str | float]]] = {
    "": lambda account, _: str(account["status"]),
    "passive (eq. 3)": lambda account, _: str(account["passive"]),
    "least true sum(h_i)": lambda account, _: float(account["truth"]["least_interaction"]),
    "least margin of (4)": lambda account, _: float(account["margin"]["value"]),
    "believed - true": lambda account, _: float(account["truth"]["believed_error"]),
    "in": lambda account, _: float(account["in"]),
    "out": lambda account, _: float(account["out"]),
    "dissipated": lambda account, _: float(account["dissipated"]),
    "surplus at most": lambda account, _: float(account["surplus"]["max"]),
    "damping rendered": _damping,
    "weakest certificate": lambda account, _: str(account["certificate"]).replace("_", " "),
}
