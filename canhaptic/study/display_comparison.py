"""Every algorithm on the admittance displays of one scene, over its simulated drives: the accounts, and the truth."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

from rich.console import Group, RenderableType
from rich.text import Text

from canhaptic.control.admittance import DISPLAY_ALGORITHMS
from canhaptic.cycle import run
from canhaptic.errors import CanHapticError, InputError, ParameterError
from canhaptic.registry import load
from canhaptic.scene.build import build
from canhaptic.scene.components import ComponentSpec
from canhaptic.scene.experiment_account import experiment_account
from canhaptic.scene.models import AxisScene, Scene
from canhaptic.study.scenes import cycles_of
from canhaptic.view.si import si
from canhaptic.view.table_style import FigureTable

_ROWS: Final[tuple[tuple[str, Callable[[Mapping[str, Any]], str]], ...]] = (
    ("status", lambda of: str(of["status"])),
    ("energy in", lambda of: si(of["account"]["in"], "J")),
    ("energy out", lambda of: si(of["account"]["out"], "J")),
    ("energy resolution", lambda of: si(of["account"]["energy_resolution"], "J")),
    ("passive (eq. 3)", lambda of: str(of["account"]["passive"])),
    ("weakest certificate", lambda of: str(of["account"]["certificate"]).replace("_", " ")),
    ("true interaction", lambda of: si(of["truth"]["interaction"], "J")),
    ("least true interaction", lambda of: si(of["truth"]["least_interaction"], "J")),
)


def display_algorithms(algorithms: Sequence[str] | None) -> list[str]:
    """Returns the names asked for, each known; all of them for None.

    Raises:
        ParameterError: One is unknown.
    """
    for name in algorithms or ():
        load(DISPLAY_ALGORITHMS, name, "admittance algorithm")
    return list(dict.fromkeys(algorithms or DISPLAY_ALGORITHMS))


def compare_displays(
    scene: Scene,
    algorithms: Sequence[str] | None = None,
    *,
    duration: float | None = None,
    progress: Callable[[int], None] | None = None,
) -> dict[str, Any]:
    """Returns the account of every axis under each algorithm, as plain values.

    Args:
        scene: Whose axes are admittance displays, with drives simulated in this process.
        algorithms: Names of `DISPLAY_ALGORITHMS`; all of them by default.
        duration: [s]; by default the scene's.
        progress: Called with the number of cycles done so far, of all runs together.

    Raises:
        InputError: The drives are not simulated in this process.
        ParameterError: An unknown algorithm.
    """
    if not scene.simulated:
        raise InputError(f"{scene.source}: compare needs bus.interface: virtual and a `simulation`; add them")
    names, cycles = display_algorithms(algorithms), cycles_of(scene, duration)
    axes: dict[str, dict[str, Any]] = {axis.parameters.name: {} for axis in scene.axes}
    for number, name in enumerate(names):
        report = None if progress is None else _after(progress, number * cycles)
        for axis, found in _run(scene, name, cycles, report).items():
            axes[axis][name] = found
    return {
        "scene": scene.source,
        "config_hash": scene.config_hash(),
        "path": "can",
        "rate": 1.0 / scene.bus.sample_time,
        "delay": scene.bus.delay,
        "cycles": cycles,
        "axes": axes,
    }


def _after(progress: Callable[[int], None], before: int) -> Callable[[int], None]:
    return lambda cycles: progress(before + cycles)


def _under(axis: AxisScene, name: str) -> AxisScene:
    """Returns an axis under another algorithm, with its defaults where it is not the one of the scene."""
    if axis.passivity.name == name:
        return axis
    model = load(DISPLAY_ALGORITHMS, name, "admittance algorithm").parameters_type
    try:
        return replace(axis, passivity=ComponentSpec(name, model()))
    except ValueError as error:
        raise ParameterError(
            f"{name}: needs parameters that the scene does not give; compare a scene with it"
        ) from error


def _run(scene: Scene, name: str, cycles: int, progress: Callable[[int], None] | None) -> dict[str, dict[str, Any]]:
    names = [axis.parameters.name for axis in scene.axes]
    try:
        experiment = build(replace(scene, axes=tuple(_under(axis, name) for axis in scene.axes)), "free")
    except ParameterError as error:
        return {axis: {"status": "refused", "remark": str(error)} for axis in names}
    status = "completed"
    with experiment:
        try:
            run(experiment.cycle, cycles, progress=progress)
        except CanHapticError as error:
            status = f"stopped: {error}"
        account = experiment_account(experiment, status, 1.0)
    return {
        axis: {"status": status, "account": account["ports"][axis], "truth": account["truth"][axis]} for axis in names
    }


def display_comparison_report(result: Mapping[str, Any]) -> RenderableType:
    """Returns one table for each axis, one column for each algorithm."""
    parts: list[RenderableType] = [
        Text(f" {result['cycles']} cycles over CAN at {result['rate']:g} Hz, delay {result['delay']} hold(s)")
    ]
    for axis, found in result["axes"].items():
        table = FigureTable(pad_edge=True)
        table.add_column(axis, no_wrap=True)
        for name in found:
            table.add_column(name.replace("_", " "), justify="right")
        for label, cell in _ROWS:
            table.add_row(label, *(_cell(cell, of) for of in found.values()))
        parts.append(table)
    return Group(*parts)


def _cell(cell: Callable[[Mapping[str, Any]], str], of: Mapping[str, Any]) -> str:
    try:
        return cell(of)
    except KeyError:
        return str(of.get("remark", "-"))[:60]
