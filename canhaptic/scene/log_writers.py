"""The logs of a scene, with the attributes of the run that readers of the log need."""

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict
from importlib.metadata import version
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal

from canhaptic.control.axis_meter import AxisMeter
from canhaptic.logs.columns import ACTIVE_LIMITS, DRY_RUN, FRICTION_DECLARED, GROUP_AXES, Attribute, PortDescription
from canhaptic.logs.writer_process import BusLogWriter
from canhaptic.meters import active_limits, promise_of
from canhaptic.scene.models import AxisScene, Port, Scene, task_unit
from canhaptic.scene.parts import friction_declared

if TYPE_CHECKING:
    from canhaptic.logs.writer_process import EnergyLogWriter

_PRIVATE_NAME: Final = "vcan0"  # of a private virtual channel: the same in every run, so that logs can be compared
_Pace = Literal["real", "free"]
_OnFailure = Callable[[str], None]


def open_energy_log(
    scene: Scene, meters: Sequence[AxisMeter], path: Path, pace: _Pace, on_failure: _OnFailure, *, dry_run: bool = False
) -> "EnergyLogWriter":
    """Return an energy log that is ready to be written.

    Args:
        scene: Scene of the run.
        meters: Meter of each axis.
        path: File to make.
        pace: Pace of the run.
        on_failure: Called, from another thread, with the reason if the log can no longer be written.
        dry_run: Whether the torque sent is always 0.

    Raises:
        LogWriteError: The file cannot be made.
    """
    from canhaptic.logs.writer_process import EnergyLogWriter

    given = [axis.parameters for axis in scene.axes]
    ports = [PortDescription(axis.name, axis.unit, None, axis.admittance is not None) for axis in given]
    for group in scene.groups:
        motor = scene.axis(group.axes[0]).parameters
        state_unit = task_unit(group.kinematics.name, motor.unit)
        ports.append(PortDescription(group.name, motor.unit, state_unit, motor.admittance is not None))
    names = [axis.parameters.name for axis in scene.axes]
    attributes = _run_attributes(scene, pace) | _active_attributes(scene.ports, names, meters)
    attributes |= {DRY_RUN: 1} if dry_run else {}
    period, with_truth = scene.bus.sample_time_ns, scene.simulated
    return EnergyLogWriter(
        path, ports, attributes, sample_time_ns=period, with_truth=with_truth, pace=pace, on_failure=on_failure
    )


def open_bus_log(scene: Scene, path: Path, pace: _Pace, on_failure: _OnFailure) -> BusLogWriter:
    """Return a bus log that is ready to be written; the arguments are as for `open_energy_log`.

    Raises:
        LogWriteError: The file cannot be made.
    """
    # the label of each bus is the channel of a single one, the names of several
    channel = _PRIVATE_NAME if scene.bus.channel is None else "".join(str(scene.bus.channel).split())
    channels = [bus.name for bus in scene.buses] if scene.further_buses else [channel]
    size = scene.log.model_dump(include={"file_size", "files", "last"})
    return BusLogWriter(path, channels, pace=pace, on_failure=on_failure, **size)


def _run_attributes(scene: Scene, pace: _Pace) -> dict[str, Attribute]:
    """Return the attributes of the whole run: configuration, versions, clock, and positions of the walls."""
    attributes: dict[str, Attribute] = {
        "canhaptic_version": version("canhaptic"),
        "config": scene.text,
        "config_source": scene.source,
        "config_overrides": json.dumps(scene.overrides),
        "config_resolved": json.dumps(scene.resolved()),
        "config_hash": scene.config_hash(),
        "clock_base": "virtual, from 0" if pace == "free" else "CLOCK_MONOTONIC",
        "pace": pace,
        "interface": scene.bus.interface,
        "bitrate": scene.bus.bitrate,
        "rate": scene.bus.rate,
        "rpdo": scene.bus.rpdo,
    }
    if scene.bus_name:
        attributes["buses"] = json.dumps([bus.name for bus in scene.buses])
    for axis in scene.axes:
        attributes |= _axis_attributes(axis)
    for group in scene.groups:
        attributes |= {
            f"{group.name}.{GROUP_AXES}": json.dumps(group.axes),
            f"{group.name}.environment": group.network.name,
            f"{group.name}.kinematics": group.kinematics.name,
            f"{group.name}.algorithm": group.passivity.name,
            **_promise_attributes(group.name, group.passivity.parameters),
            **({f"{group.name}.is_damped": 1} if all(scene.axis(axis).loop.brakes for axis in group.axes) else {}),
        }
    return attributes


def _active_attributes(
    ports: Sequence[Port], names: Sequence[str], meters: Sequence[AxisMeter]
) -> dict[str, Attribute]:
    """Return the limits from which a reader computes the column `active` of each port, and the masses requested.

    Args:
        ports: Ports with an account of their own.
        names: Name of each axis.
        meters: Meter of each axis.
    """
    found: dict[str, Attribute] = {}
    for name, passivity, places in ports:
        allowance = promise_of(passivity.parameters).energy_allowance
        limits = active_limits([meters[place].accuracy for place in places], allowance)
        finite = {key: value for key, value in limits._asdict().items() if isfinite(value)}
        found[f"{name}.{ACTIVE_LIMITS}"] = json.dumps(finite)
    fits = zip(names, (meter.felt for meter in meters), strict=True)
    return found | {f"{name}.mass_asked": json.dumps(asdict(felt.asked)) for name, felt in fits if felt is not None}


def _axis_attributes(axis: AxisScene) -> dict[str, Attribute]:
    name = axis.parameters.name
    attributes: dict[str, Attribute] = {
        **({f"{name}.bus": axis.bus} if axis.bus else {}),
        f"{name}.eds": str(axis.parameters.eds),
        f"{name}.eds_hash": axis.dictionary_hash(),
        f"{name}.environment": axis.environment.name,
        f"{name}.algorithm": axis.passivity.name,
        f"{name}.torque_limit": axis.parameters.torque_limit,
        **({f"{name}.guard": axis.guard} if axis.guard else {}),
        **_promise_attributes(name, axis.passivity.parameters),
        **({f"{name}.is_damped": 1} if axis.loop.brakes else {}),
    }
    friction = friction_declared(axis)
    if friction is not None:
        attributes[f"{name}.{FRICTION_DECLARED}"] = json.dumps(asdict(friction))
    environment = axis.environment.parameters
    damping = getattr(environment, "damping", None)
    if isinstance(damping, float):
        attributes[f"{name}.damping_asked"] = damping
    for key in ("position", "side", "pitch"):
        value = getattr(environment, key, None)
        if isinstance(value, str | float):
            attributes[f"{name}.wall_{key}"] = value
    return attributes


def _promise_attributes(name: str, parameters: object) -> dict[str, Attribute]:
    """Return the assumptions of the certificates that do not concern the device."""
    return {f"{name}.{key}": value for key, value in promise_of(parameters)._asdict().items() if value is not None}
