"""The logs of a scene: those of a run, with the attributes that their readers need, and the buses of recorded frames.

A recorded frame names its bus by the second word of its line, or by the bus number in a binary log.
"""

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict
from importlib.metadata import version
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal

from canhaptic.control.axis_meter import AxisMeter
from canhaptic.drive.axis_parameters import CanBusParameters
from canhaptic.drive.profile.quirks import quirks_of
from canhaptic.errors import LogFormatError
from canhaptic.logs.columns import ACTIVE_LIMITS, DRY_RUN, FRICTION_DECLARED, GROUP_AXES, Attribute, PortDescription
from canhaptic.logs.writer_process import BusLogWriter, EnergyLogWriter
from canhaptic.meters import active_limits, promise_of
from canhaptic.own_results import GIVEN_MARK
from canhaptic.scene.buses import kind_of
from canhaptic.scene.models import AxisScene, Port, Scene, task_unit
from canhaptic.scene.parts import friction_declared

if TYPE_CHECKING:
    from canhaptic.logs.bus_reader import Frame
    from canhaptic.logs.decoder import NodeDescription

_PRIVATE_NAME: Final = "vcan0"  # of a private virtual channel: the same in every run, so that logs can be compared
_Pace = Literal["real", "free"]
_OnFailure = Callable[[str], None]


def open_energy_log(
    scene: Scene, meters: Sequence[AxisMeter], path: Path, pace: _Pace, on_failure: _OnFailure, *, dry_run: bool = False
) -> EnergyLogWriter:
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
    given = [axis.parameters for axis in scene.axes]
    ports = [PortDescription(axis.name, axis.unit, None, axis.admittance is not None) for axis in given]
    for group in scene.groups:
        motor = scene.axis(group.axes[0]).parameters
        state_unit = task_unit(group.kinematics.name, motor.unit)
        ports.append(PortDescription(group.name, motor.unit, state_unit, motor.admittance is not None))
    names = [axis.parameters.name for axis in scene.axes]
    attributes = _run_attributes(scene, pace) | _active_attributes(scene.ports, names, meters)
    attributes |= {DRY_RUN: 1} if dry_run else {}
    period, has_phase, with_far = scene.bus.sample_time_ns, kind_of(scene.bus) == "ethercat", scene.far is not None
    return EnergyLogWriter(
        path, ports, attributes, sample_time_ns=period, with_truth=scene.simulated, with_phase=has_phase,
        with_far=with_far, pace=pace,
        on_failure=on_failure,
    )  # fmt: skip


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
        **({"bitrate": scene.bus.bitrate} if isinstance(scene.bus, CanBusParameters) else {"frames": scene.bus.frames}),
        "rate": scene.bus.rate,
        "rpdo": scene.bus.rpdo,
    }
    if any(name.startswith(GIVEN_MARK) for name in scene.own_code):
        from canhaptic.scene.given import sources_of

        attributes["own_source"] = json.dumps(sources_of(scene.own_code))
    if scene.bus_name:
        attributes["buses"] = json.dumps([bus.name for bus in scene.buses])
    for axis in scene.axes:
        attributes |= _axis_attributes(axis)
    for port in (port for port in scene.ports if port.section):
        attributes |= {
            f"{port.name}.{GROUP_AXES}": json.dumps([axis.parameters.name for axis in port.axes]),
            f"{port.name}.environment": port.rendered.name,
            f"{port.name}.kinematics": port.kinematics.name,
            f"{port.name}.algorithm": port.passivity.name,
            **_promise_attributes(port.name, port.passivity.parameters),
            **({f"{port.name}.is_damped": 1} if all(axis.loop.brakes for axis in port.axes) else {}),
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
    for port in ports:
        allowance = promise_of(port.passivity.parameters).energy_allowance
        limits = active_limits([meters[place].accuracy for place in port.places], allowance)
        finite = {key: value for key, value in limits._asdict().items() if isfinite(value)}
        found[f"{port.name}.{ACTIVE_LIMITS}"] = json.dumps(finite)
    fits = zip(names, (meter.felt for meter in meters), strict=True)
    return found | {f"{name}.mass_asked": json.dumps(asdict(felt.asked)) for name, felt in fits if felt is not None}


def _axis_attributes(axis: AxisScene) -> dict[str, Attribute]:
    name = axis.parameters.name
    attributes: dict[str, Attribute] = {
        **({f"{name}.bus": axis.bus} if axis.bus else {}),
        f"{name}.eds": str(axis.parameters.dictionary_path),
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
    environment: Any = axis.environment.parameters
    damping = getattr(environment, "damping", None)
    if getattr(environment, "damps_by_place", False):  # a sum
        damping = 0.0
        ends = zip(("low", "high"), environment.rests(), strict=True) if environment.low < environment.high else ()
        attributes |= {f"{name}.wall_{key}": end for key, end in ends if isfinite(end)}
    if isinstance(damping, float):
        attributes[f"{name}.damping_asked"] = damping
    for key in ("position", "side", "pitch"):
        value = getattr(environment, key, None)
        if isinstance(value, str | float) and (value or key == "position"):
            attributes[f"{name}.wall_{key}"] = value
    for key, own in (("low", "lower"), ("high", "upper")):  # of a display, or of a wall on two sides
        value = getattr(environment, f"{own}_wall", getattr(environment, own, None))
        if isinstance(value, float) and abs(value) < _NO_WALL:
            attributes[f"{name}.wall_{key}"] = value
    return attributes


_NO_WALL: Final = 1e3
"""Position from which a wall counts as absent [m or rad]."""


def _promise_attributes(name: str, parameters: object) -> dict[str, Attribute]:
    """Return the assumptions of the certificates that do not concern the device."""
    return {f"{name}.{key}": value for key, value in promise_of(parameters)._asdict().items() if value is not None}


class Channels:
    """Index of the buses of a scene by their names in a bus log.

    The log has the name, the channel (`can0`) or the number of the bus, counted from 0. If the scene has one bus, every
    frame belongs to it.
    """

    def __init__(self, scene: Scene) -> None:
        self._source = scene.source
        self._is_one = not scene.further_buses
        self._places: dict[str, int] = {}
        for place, (name, parameters) in enumerate(scene.buses):
            for word in (name, str(parameters.channel), str(place)):
                self._places.setdefault(word, place)

    def place_of(self, frame: "Frame") -> int:
        """Return the index of the frame's bus in the scene.

        Raises:
            LogFormatError: The scene has no such bus.
        """
        if self._is_one:
            return 0
        place = self._places.get(frame.channel)
        if place is None:
            text = f"frame {frame.number} is on bus {frame.channel!r}, which is not a name"
            raise LogFormatError(f"{text}, channel or number of a bus of {self._source} ({', '.join(self._places)})")
        return place


def describe_nodes(scene: Scene) -> "list[NodeDescription]":
    """Return the name, dictionary, units and bus of the node of every axis."""
    from canhaptic.logs.decoder import NodeDescription  # of no use to a run that writes logs

    places = {bus.name: place for place, bus in enumerate(scene.buses)}
    nodes = []
    for axis, bus in ((axis.parameters, axis.bus) for axis in scene.axes):
        torque = axis.rated_torque and axis.rated_torque * quirks_of(axis.quirks).torque_scale
        scales = axis.counts_per_unit, axis.unit, torque, axis.direction
        dictionary = axis.dictionary()
        nodes.append(NodeDescription(axis.node_id, axis.name, dictionary, *scales, places[bus]))
    return nodes
