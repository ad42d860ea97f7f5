"""Every algorithm on the admittance displays of one scene, over its simulated drives: the accounts, and the truth."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final, TypedDict

from rich.console import Group, RenderableType
from rich.text import Text

from canhaptic.control.admittance import DISPLAY_ALGORITHMS, DISPLAY_GROUP_ALGORITHMS
from canhaptic.control.verdict import PortResult
from canhaptic.lab.loop.accounts_over_can import Heading, accounts_over_can, heading_of, known_algorithms
from canhaptic.lab.loop.algorithms import display_group_under, display_under
from canhaptic.lab.loop.scenes import cycles_of, parts_of
from canhaptic.result import TruthResult
from canhaptic.scene.models import Scene
from canhaptic.view.si import si
from canhaptic.view.table import Table


class DisplayRunCompared(TypedDict, total=False):
    """A display under one algorithm; of one that was refused there are only status and remark."""

    status: str
    remark: str
    account: PortResult
    truth: TruthResult


class DisplaysCompared(Heading):
    """All displays of a scene, by algorithm."""

    axes: dict[str, dict[str, DisplayRunCompared]]


_ROWS: Final[tuple[tuple[str, Callable[[DisplayRunCompared], str]], ...]] = (
    ("status", lambda of: of["status"]),
    ("energy in", lambda of: si(of["account"]["in"], "J")),
    ("energy out", lambda of: si(of["account"]["out"], "J")),
    ("energy resolution", lambda of: si(of["account"]["energy_resolution"], "J")),
    ("passive (eq. 3)", lambda of: of["account"]["passive"]),
    ("weakest certificate", lambda of: of["account"]["certificate"].replace("_", " ")),
    ("true interaction", lambda of: si(of["truth"]["interaction"], "J")),
    ("least true interaction", lambda of: si(of["truth"]["least_interaction"], "J")),
)


def display_algorithms(algorithms: Sequence[str] | None) -> list[str]:
    """Return the names asked for; see `known_algorithms`."""
    return known_algorithms(DISPLAY_ALGORITHMS, "admittance algorithm", algorithms)


def compare_displays(
    scene: Scene,
    algorithms: Sequence[str] | None = None,
    *,
    duration: float | None = None,
    progress: Callable[[int], None] | None = None,
) -> DisplaysCompared:
    """Return the account of every axis, and of every group, under each algorithm, as plain values.

    Args:
        scene: Whose axes are admittance displays, with drives simulated in this process.
        algorithms: Names of `DISPLAY_ALGORITHMS`; by default all, where there are only groups those of groups.
        duration: [s]; by default the scene's.
        progress: Called with the number of cycles done so far, of all runs together.

    Raises:
        InputError: The drives are not simulated in this process.
        ParameterError: An unknown algorithm.
    """
    names, cycles = display_algorithms(algorithms), cycles_of(scene, duration)
    if algorithms is None and all(axis.group for axis in scene.axes):
        names = list(DISPLAY_GROUP_ALGORITHMS)
    runs = accounts_over_can(scene, names, cycles, _scene_under, progress)
    axes = list(parts_of(scene))
    return {
        **heading_of(scene, cycles),
        "axes": {axis: {name: _of_axis(axis, found) for name, found in runs.items()} for axis in axes},
    }


def _scene_under(scene: Scene, name: str) -> Scene:
    groups = tuple(display_group_under(group, name) for group in scene.groups)
    axes = tuple(axis if axis.group else display_under(axis, name) for axis in scene.axes)
    return replace(scene, axes=axes, groups=groups)


def _of_axis(axis: str, found: Mapping[str, Any]) -> DisplayRunCompared:
    if "ports" not in found:
        return {"status": found["status"], "remark": found["remark"]}
    status = f"{found['status']}: {found['remark']}" if found["remark"] else found["status"]
    return {"status": status, "account": found["ports"][axis], "truth": found["truth"][axis]}


def display_comparison_report(result: DisplaysCompared) -> RenderableType:
    """Return one table for each axis, one column for each algorithm."""
    parts: list[RenderableType] = [
        Text(f" {result['cycles']} cycles over CAN at {result['rate']:g} Hz, delay {result['delay']} hold(s)")
    ]
    for axis, found in result["axes"].items():
        rows = [[label, *(_cell(cell, of) for of in found.values())] for label, cell in _ROWS]
        parts.append(Table("", [axis, *(name.replace("_", " ") for name in found)], rows, keys=1))
        refused = {name: of["remark"] for name, of in found.items() if "account" not in of}
        parts += [Text(f" {name}: {remark}") for name, remark in refused.items()]
    return Group(*parts)


def _cell(cell: Callable[[DisplayRunCompared], str], of: DisplayRunCompared) -> str:
    try:
        return cell(of)
    except KeyError:
        return "-"
