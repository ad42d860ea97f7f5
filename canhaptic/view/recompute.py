"""Feeds the logged inputs to the same controller again: every logged output must come out bit for bit."""

import json
import struct
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from canhaptic.errors import InputError
from canhaptic.haptics.balance import EnergyBalance
from canhaptic.haptics.passivity.protocol import Controller
from canhaptic.logs.energy_reader import EnergyLog

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


def recompute_all(log: EnergyLog, config: Path | None = None) -> list[dict[str, Any]]:
    """Returns `{port, mismatch}` of every port, recomputed with the controllers of the run's own scene.

    Args:
        log: An open energy log that holds the run from its first cycle.
        config: The scene file; by default the one that the log names.

    Raises:
        InputError: The scene cannot be read, or is not the one of the run.
    """
    from canhaptic.scene.parts import build_axis_controller

    scene = scene_of(log, config)
    found = []
    for axis in scene.axes:
        name = axis.parameters.name
        mismatch = recompute(log, name, build_axis_controller(axis))
        found.append({"port": name, "mismatch": None if mismatch is None else mismatch._asdict()})
    return found


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
