"""Every group algorithm on one scene: the accounts of its groups, and what truly happened.

Over its simulated drives, or compiled without a bus. There is no continuous reference: what a group adds to its network
is judged by the plant's own energies alone.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final, TypedDict, cast

from rich.console import Group, RenderableType
from rich.text import Text

from canhaptic.axis_units import damping_unit
from canhaptic.control.multi_axis import GROUP_ALGORITHMS
from canhaptic.control.verdict import PASSIVE_TOLERANCE, PortResult, passive_verdict
from canhaptic.errors import ParameterError
from canhaptic.lab.batch.engine import WORTH_COMPILING_GROUPS, Engine, chosen_engine
from canhaptic.lab.batch.group_loop import GroupRecorder
from canhaptic.lab.batch.group_rows import render_group_by
from canhaptic.lab.loop.accounts_over_can import Heading, Progress, accounts_over_can, heading_of, known_algorithms
from canhaptic.lab.loop.algorithms import group_under
from canhaptic.lab.loop.scenes import cycles_of, parts_of
from canhaptic.scene.models import Scene
from canhaptic.view.si import si
from canhaptic.view.table import Cell, Styled, Table

_NOTHING: Final = "-"


class TrueEnergies(TypedDict):
    """True energies of a group [J]."""

    interaction: float
    least_interaction: float
    believed_error: float


class ComparedGroup(PortResult, total=False):
    """The account of a group under one algorithm; of one that was refused there are only the first three."""

    status: str
    remark: str
    engine: str | None
    truth: TrueEnergies | None


class GroupCompared(TypedDict):
    """A group under all algorithms."""

    axes: list[str]
    network: str
    unit: str
    algorithms: dict[str, ComparedGroup]


class GroupsCompared(Heading):
    """All groups of a scene."""

    groups: dict[str, GroupCompared]


def compare_groups(
    scene: Scene,
    algorithms: Sequence[str] | None = None,
    *,
    duration: float | None = None,
    engine: Engine = "python",
    progress: Callable[[int], None] | None = None,
) -> GroupsCompared:
    """Return the accounts of every group of a scene under each algorithm, as plain values.

    Args:
        scene: With groups, and all its drives simulated in this process. Axes that render by themselves keep their
            own algorithm.
        algorithms: Names of `GROUP_ALGORITHMS`; all of them by default.
        duration: [s]; by default the scene's.
        engine: "python" goes over the whole CAN path, "numba" compiles each group with its motors, without a bus;
            "auto" takes that where it pays.
        progress: Called with the number of cycles done so far, of all runs together.

    Raises:
        InputError: The drives are not simulated in this process.
        ParameterError: An unknown algorithm.
    """
    names, cycles = group_algorithms(algorithms), cycles_of(scene, duration)
    chosen = chosen_engine(engine, len(names) * len(scene.groups) * cycles >= WORTH_COMPILING_GROUPS)
    accounts = _over_can if chosen == "python" else _without_bus
    found = accounts(scene, names, cycles, progress)
    return {
        **heading_of(scene, cycles, "can" if chosen == "python" else "direct"),
        "groups": {
            group.name: {
                "axes": list(group.axes),
                "network": group.network.name,
                "unit": scene.axis(group.axes[0]).parameters.unit,
                "algorithms": found[group.name],
            }
            for group in scene.groups
        },
    }


def group_algorithms(algorithms: Sequence[str] | None) -> list[str]:
    """Return the names asked for; see `known_algorithms`."""
    return known_algorithms(GROUP_ALGORITHMS, "group algorithm", algorithms)


def _scene_under(scene: Scene, name: str) -> Scene:
    return replace(scene, groups=tuple(group_under(group, name) for group in scene.groups))


_Accounts = dict[str, dict[str, ComparedGroup]]
"""By group and algorithm."""


def _over_can(scene: Scene, names: Sequence[str], cycles: int, progress: Progress | None) -> _Accounts:
    runs = accounts_over_can(scene, names, cycles, _scene_under, progress)
    return {group.name: {name: _of_group(group.name, found) for name, found in runs.items()} for group in scene.groups}


def _of_group(name: str, found: Mapping[str, Any]) -> ComparedGroup:
    account: ComparedGroup = {"status": found["status"], "remark": found["remark"], "engine": "python"}
    if "ports" in found:
        account.update(found["ports"][name])
        account["truth"] = found["truth"].get(name)
    return account


def _without_bus(scene: Scene, names: Sequence[str], cycles: int, progress: Progress | None) -> _Accounts:
    parts, found, done = parts_of(scene), _Accounts(), 0
    for group in scene.groups:
        found[group.name] = {}
        for name in names:
            found[group.name][name] = _compiled(parts[group.name], name, cycles)
            done += cycles
            if progress is not None:
                progress(done // len(scene.groups))
    return found


def _compiled(scene: Scene, name: str, cycles: int) -> ComparedGroup:
    """Return the account of one group; whether it was passive is what the plant's own energies say."""
    try:
        run = render_group_by("numba", _scene_under(scene, name), cycles, GroupRecorder(len(scene.axes)))
    except ParameterError as error:
        return {"status": "refused", "remark": str(error), "engine": None}
    account = cast("ComparedGroup", run.summary.as_json(scene.bus.sample_time))  # it has the keys of both
    account["status"], account["engine"] = run.ended or "completed", run.engine
    account["remark"] = "; ".join(text for text in (run.reason, run.engine.partition(": ")[2]) if text)
    account["passive"] = passive_verdict(run.least_interaction)
    account["truth"] = {
        "interaction": float(run.interaction[-1]) if run.interaction.size else 0.0,
        "least_interaction": run.least_interaction,
        "believed_error": run.believed_error,
    }
    return account


# --- the table ----------------------------------------------------------------------------------------------------


def group_comparison_report(result: GroupsCompared) -> RenderableType:
    """Return one table per group: a column per algorithm, a row per figure."""
    heading = Text(" ")
    heading.append(str(result["scene"]), style="bold")
    path = "over the CAN path" if result["path"] == "can" else "without a bus, compiled"
    heading.append(f"   {si(result['rate'], 'Hz', 3)}, delay {result['delay']}, {result['duration']:.4g} s, {path}")
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


def _table(group: GroupCompared) -> Table:
    rows: list[list[Cell]] = []
    for label, read in _ROWS.items():
        cells = [_cell(read, account, group["unit"]) for account in group["algorithms"].values()]
        if any(cell.text != _NOTHING for cell in cells):
            rows.append([label, *cells])
    return Table("", ["", *(name.replace("_", "\n") for name in group["algorithms"])], rows, keys=1)


def _cell(read: Callable[[ComparedGroup, str], str | float], account: ComparedGroup, unit: str) -> Styled:
    try:
        value = read(account, unit)
    except (KeyError, TypeError):  # refused, or nothing to measure
        return Styled(_NOTHING)
    if isinstance(value, str):
        return Styled(value, {"yes": "green", "in doubt": "yellow", "no": "red"}.get(value, ""))
    return Styled(si(value, "J", 3), "red" if value < -PASSIVE_TOLERANCE else "")


def _truth(account: ComparedGroup) -> TrueEnergies:
    truth = account["truth"]
    if truth is None:
        raise KeyError("truth")
    return truth


def _damping(account: ComparedGroup, unit: str) -> str:
    rendered = account["damping_rendered"]
    return f"{rendered['least']:.3g}..{rendered['most']:.3g} {damping_unit(unit)}"


_ROWS: Final[dict[str, Callable[[ComparedGroup, str], str | float]]] = {
    "": lambda account, _: account["status"],
    "passive (eq. 3)": lambda account, _: account["passive"],
    "least true sum(h_i)": lambda account, _: _truth(account)["least_interaction"],
    "least margin of (4)": lambda account, _: account["margin"]["value"],
    "believed - true": lambda account, _: _truth(account)["believed_error"],
    "in": lambda account, _: account["in"],
    "out": lambda account, _: account["out"],
    "dissipated": lambda account, _: account["dissipated"],
    "surplus at most": lambda account, _: account["surplus"]["max"],
    "damping rendered": _damping,
    "weakest certificate": lambda account, _: account["certificate"].replace("_", " "),
}
