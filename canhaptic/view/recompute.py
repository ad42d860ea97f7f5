"""Feeds the logged inputs to the same controller again: every logged output must come out bit for bit."""

import json
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from canhaptic.errors import InputError
from canhaptic.haptics.axis_group import AxisGroup, GroupedControllers
from canhaptic.haptics.balance import EnergyBalance
from canhaptic.haptics.passivity.protocol import Controller
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.signals import Sample

if TYPE_CHECKING:
    from canhaptic.scene.models import Scene

_LOGGED: Final = tuple("torque_command" if name == "torque" else name for name in EnergyBalance._fields)


_ALL: Final = struct.Struct(f"{len(_LOGGED)}d")
_ONE: Final = struct.Struct("d")


class Mismatch(NamedTuple):
    """The first output that differs."""

    port: str
    cycle: int
    quantity: str
    logged: float
    recomputed: float


def recompute(log: EnergyLog, port: str, controller: Controller) -> Mismatch | None:
    """Returns the first difference between the logged outputs of a port and those computed again; None when equal.

    Args:
        log: An open energy log that holds the run from its first cycle.
        port: Name of the axis.
        controller: Made from the configuration of the run; it is reset first.
    """
    controller.reset()
    logged = log.ports[port]
    outputs = zip(*(logged[name].tolist() for name in _LOGGED), strict=True)
    inputs = zip(logged["position"].tolist(), logged["torque_applied"].tolist(), logged["fresh"].tolist(), strict=True)
    for row, ((position, torque, fresh), expected) in enumerate(zip(inputs, outputs, strict=True)):
        balance = controller.step(position, torque) if fresh else controller.hold()
        if _ALL.pack(*balance) != _ALL.pack(*expected):
            number = next(n for n, values in enumerate(zip(balance, expected, strict=True)) if _differ(*values))
            cycle = int(log.timing["sync_index"][row])
            return Mismatch(port, cycle, _LOGGED[number], expected[number], balance[number])
    return None


def recompute_group(log: EnergyLog, axes: Sequence[str], group: AxisGroup) -> list[Mismatch]:
    """Returns the first difference of a group's account and of each of its axes; none where all are equal.

    Args:
        log: An open energy log that holds the run from its first cycle.
        axes: Their names, in the order of the group.
        group: Made from the configuration of the run; its axes are 0, 1, ...
    """
    group.controller.reset()
    controllers, found = GroupedControllers((), [group]), {}
    names = (*axes, group.name)
    outputs = [zip(*(log.ports[name][column].tolist() for column in _LOGGED), strict=True) for name in names]
    inputs = [
        zip(*(log.ports[name][column].tolist() for column in ("position", "torque_applied", "fresh")), strict=True)
        for name in axes
    ]
    for row, (seen, expected) in enumerate(zip(zip(*inputs, strict=True), zip(*outputs, strict=True), strict=True)):
        samples = [Sample(row, position, torque, 0, fresh=bool(fresh)) for position, torque, fresh in seen]
        balances = [*controllers.step(samples), group.balance.account]
        for name, balance, logged in zip(names, balances, expected, strict=True):
            if name not in found and _ALL.pack(*balance) != _ALL.pack(*logged):
                number = next(n for n, values in enumerate(zip(balance, logged, strict=True)) if _differ(*values))
                cycle = int(log.timing["sync_index"][row])
                found[name] = Mismatch(name, cycle, _LOGGED[number], logged[number], balance[number])
    return list(found.values())


def recompute_all(log: EnergyLog, config: Path | None = None) -> list[dict[str, Any]]:
    """Returns `{port, mismatch}` of every port, recomputed with the controllers of the run's own scene.

    Args:
        log: An open energy log that holds the run from its first cycle.
        config: The scene file; by default the one that the log names.

    Raises:
        InputError: The scene cannot be read, or is not the one of the run.
    """
    from canhaptic.scene.parts import build_axis_controller, build_group

    scene = scene_of(log, config)
    found: dict[str, Mismatch | None] = {}
    for axis in scene.axes:
        if not axis.group:
            name = axis.parameters.name
            found[name] = recompute(log, name, build_axis_controller(axis))
    for group in scene.groups:
        made = AxisGroup(group.name, range(len(group.axes)), build_group(scene, group))
        found.update(dict.fromkeys((group.name, *group.axes)))
        found.update((mismatch.port, mismatch) for mismatch in recompute_group(log, group.axes, made))
    return [{"port": name, "mismatch": m and m._asdict()} for name, m in found.items()]


def scene_of(log: EnergyLog, config: Path | None = None) -> "Scene":
    """Returns the scene of the run that a log holds, with the overrides of that run.

    Args:
        log: An open energy log.
        config: The scene file; by default the one that the log names.

    Raises:
        InputError: The scene cannot be read, or is not the one of the run.
    """
    from canhaptic.scene.load import load_scene

    overrides = json.loads(str(log.attributes.get("config_overrides", "[]")))
    path = config or Path(str(log.attributes.get("config_source", "")))
    if not path.is_file():
        raise InputError(f"{log.path}: its scene {str(path)!r} is not there; name it with --config")
    scene = load_scene(path, overrides)
    if scene.config_hash() != log.attributes.get("config_hash"):
        raise InputError(
            f"{path}: is not the scene of {log.path}, or was changed since; name the right one with --config"
        )
    return scene


def _differ(left: float, right: float) -> bool:
    return _ONE.pack(left) != _ONE.pack(right)
