"""Kinds of bus that a scene may name, and what each brings: parameters of bus and axis, and the door of its drives.

Nothing of a kind is imported before a scene names it.
"""

from typing import TYPE_CHECKING, Any, Final, TypeAlias

from pydantic import ValidationInfo, ValidatorFunctionWrapHandler

from canhaptic.drive.axis_parameters import CanBusParameters
from canhaptic.errors import InputError
from canhaptic.registry import load
from canhaptic.scene.document import MarkedMapping
from canhaptic.units import Parameters, UnitContext

if TYPE_CHECKING:
    from canhaptic.drive.ethercat.parameters import EthercatBusParameters

    BusParameters: TypeAlias = CanBusParameters | EthercatBusParameters
else:
    BusParameters = CanBusParameters  # by which pydantic reads a bus; `read_bus` reads a line before it

BUSES: Final = {
    "can": {
        "bus": "canhaptic.drive.axis_parameters:CanBusParameters",
        "axis": "canhaptic.drive.axis_parameters:AxisParameters",
        "named": "canhaptic.drive.can.door:with_channel",
        "open": "canhaptic.drive.can.door:opened",
        "line": "canhaptic.drive.can.door:link_on",
        "drive": "canhaptic.drive.can.door:drive_on",
        "cycles": "canhaptic.drive.can.bus_cycle:can_buses",
        "simulated_drive": "canhaptic.sim.drive.can.door:drive_on",
        "simulated": "canhaptic.sim.drive.can.door:bus_of",
    },
    "ethercat": {
        "bus": "canhaptic.drive.ethercat.parameters:EthercatBusParameters",
        "axis": "canhaptic.drive.ethercat.parameters:EthercatAxisParameters",
        "findings": "canhaptic.drive.ethercat.image_map:image_findings",
        "line": "canhaptic.drive.ethercat.door:line_on",
        "drive": "canhaptic.drive.ethercat.door:drive_on",
        "cycles": "canhaptic.drive.ethercat.door:cycles_of",
        "simulated_drive": "canhaptic.sim.drive.ethercat.door:drive_on",
        "simulated": "canhaptic.sim.drive.ethercat.door:cable_of",
        "frame_log": "canhaptic.logs.frame_log:FrameLog",
        "tap": "canhaptic.logs.tap:Tap",
        "served": "canhaptic.sim.drive.ethercat.served_line:ServedLine",
    },
}
"""Kind of bus -> its part -> "module:name"; `named`, `open`, `frame_log`, `tap` and `served` not for every kind."""
DICTIONARIES: Final = {"can": "eds", "ethercat": "esi"}
"""Kind of bus -> key of an axis that names the file of its drive's objects."""
PLACES: Final = {"can": "node_id", "ethercat": "position"}
"""Kind of bus -> key of an axis that is unique on its bus."""
ETHERCAT_EFFECTS: Final = ("drift", "late", "lost", "answer_lost", "low_counter", "falls_to_safe_op", "broken_at")
"""Keys of `simulation.bus` for an EtherCAT line; the others are for CAN buses."""


def kind_of(bus: Parameters) -> str:
    """Return the kind of a bus from its parameters."""
    return str(getattr(bus, "type", "can"))


def can_bus(bus: BusParameters) -> CanBusParameters:
    """Return a bus where only a CAN bus will do.

    Raises:
        InputError: It is an EtherCAT line.
    """
    if not isinstance(bus, CanBusParameters):
        raise InputError(f"got an EtherCAT line ({bus.interface}), expected a CAN bus; this is for CAN alone")
    return bus


def part(kind: str, name: str) -> Any:
    """Return one part of a kind of bus, imported now if it was not before."""
    return load(BUSES[kind], name, f"part of a bus {kind}")


def part_if_any(kind: str, name: str) -> Any:
    """Return one part of a kind of bus; None where that kind has none of this name."""
    return part(kind, name) if name in BUSES[kind] else None


def model_on(section: MarkedMapping, model: type) -> type:
    """Return the model of the section of a bus or of an axis on its kind of bus, in place of that of CAN."""
    if section.bus_kind == "can":
        return model
    names = (name for name in ("bus", "axis") if part("can", name) is model)
    return next((part(section.bus_kind, name) for name in names), model)


def read_bus(value: object, read: ValidatorFunctionWrapHandler, info: ValidationInfo[UnitContext]) -> object:
    """Read the section of a bus with the model of its kind."""
    return _read("bus", value, read, info)


def read_axis(value: object, read: ValidatorFunctionWrapHandler, info: ValidationInfo[UnitContext]) -> object:
    """Read the section of an axis with the model of the kind of its bus."""
    return _read("axis", value, read, info)


def _read(name: str, value: object, read: ValidatorFunctionWrapHandler, info: ValidationInfo[UnitContext]) -> object:
    if not isinstance(value, MarkedMapping) or value.bus_kind == "can":
        return read(value)
    model: type[Parameters] = part(value.bus_kind, name)
    return model.of_section(value, info.context)
