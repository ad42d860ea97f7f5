"""Judgement of a dictionary for an admittance display: source of its force, and its limits."""

from typing import Final

from canopen import ObjectDictionary

from canhaptic.canopen import objects as od
from canhaptic.canopen.dictionary import is_writable
from canhaptic.canopen.force_node import ForceNode
from canhaptic.canopen.objects import DataType
from canhaptic.drive.profile.display_parameters import DisplayParameters, ForceParameters, Mode
from canhaptic.drive.profile.fitness import Finding, Verdict
from canhaptic.drive.profile.object_use import listed, mapping_objection

_ANALOG_INPUTS: Final = ("0x3160.1", "0x2205.1", "0x2205.0", "0x207C.1")
"""Analog inputs of maxon EPOS4, Elmo Gold, ZeroErr and maxon EPOS2, as their dictionaries list them."""
_TYPES: Final = (DataType.INTEGER16, DataType.INTEGER32)
DISPLAY_KEYS: Final = (
    ("speed_limit, admittance.acceleration_limit", "largest speed and rise of it that may be commanded"),
    ("admittance.position_low, position_high", "lowest and highest position to which a command may lead"),
    ("admittance.velocity_counts", "counts of 0x60FF for 1 m/s or 1 rad/s; left out: those of 0x6064 per second"),
    ("admittance.handle_acceleration", "largest of the handle, by drive and hand: an over-estimate"),
    ("admittance.force.per_count, range, error, slew", "scale and limits of the sensor; canhaptic commission measures"),
    ("admittance.force.frozen_after", "SYNCs with one count after which the sensor counts as frozen"),
)
"""Keys of an axis that no dictionary supplies, with the reason."""
_SENSOR_NODE: Final = 9  # node ID of a sensor that is a node of its own, where the drive has no input


def _analog_input(dictionary: ObjectDictionary) -> str | None:
    """First known analog input that a TPDO of the drive can carry, as `0x3160.1`; None without one.

    The object of another make at one of these places may be another thing: it is a proposal.
    """
    for place in _ANALOG_INPUTS:
        index, _, subindex = place.partition(".")
        uses = (int(index, 16), int(subindex, 16))
        if any(mapping_objection(dictionary, "TPDO", uses[0], kind, uses[1]) is None for kind in _TYPES):
            return place
    return None


def display_of(dictionary: ObjectDictionary, mode: Mode, force_object: str | None = None) -> DisplayParameters:
    """Admittance display with a dictionary; its force has scale 1, and its figures are placeholders.

    Args:
        dictionary: Dictionary of the drive.
        mode: `velocity` or `position`.
        force_object: Object that shows the force; by default a known analog input of the drive, else a
            sensor with a node of its own.

    Raises:
        pydantic.ValidationError: `force_object` is no place of an object.
    """
    place = force_object or _analog_input(dictionary)
    node = ForceNode(node_id=_SENSOR_NODE) if place is None else None
    force = ForceParameters(object=place, node=node, per_count=1.0, range=1e6, slew=1.0, error=0.0)
    return DisplayParameters(mode=mode, handle_acceleration=1.0, force=force)


def force_finding(dictionary: ObjectDictionary, display: DisplayParameters) -> Finding:
    """Finding of the dictionary about the force of a display."""
    place = display.force.place
    if place is None:
        text = "no analog input is known of this drive; name one (--force-object), or give the sensor a node of its own"
        return Finding("force sensor", Verdict.UNKNOWN, text)
    item = f"{place[0]:#06x}:{place[1]:02x} force"
    variable = listed(dictionary, *place)
    kind = _TYPES[1] if variable is not None and variable.data_type == _TYPES[1] else _TYPES[0]
    if (refusal := mapping_objection(dictionary, "TPDO", place[0], kind, place[1])) is not None:
        return Finding(item, Verdict.REFUSED, f"{refusal}; name an INTEGER16 or INTEGER32 that a TPDO can carry")
    return Finding(
        item, Verdict.UNKNOWN, "in the TPDO with the position: one SYNC for both; confirm that it is an input"
    )


def limit_findings(dictionary: ObjectDictionary) -> list[Finding]:
    """Limits in the drive for a display whose sensor or master is wrong, and objects that may alter its command."""
    found = []
    ramps = [index for index in (od.PROFILE_ACCELERATION, od.MAX_ACCELERATION) if listed(dictionary, index) is not None]
    stuck = [index for index in ramps if not is_writable(dictionary, index, 0)]
    listing = ", ".join(f"{index:#06x}" for index in stuck or ramps)
    if stuck:
        text = (
            "read-only: a ramp inside the drive is a command that no certificate knows; set it with the vendor's tool"
        )
        found.append(Finding(f"{listing} ramps", Verdict.UNKNOWN, text))
    elif ramps:
        found.append(Finding(f"{listing} ramps", Verdict.FIT, "written as steep as they go"))
    if is_writable(dictionary, od.QUICK_STOP_OPTION, 0):
        found.append(Finding("0x605a quick stop option", Verdict.FIT, "written: brakes along its ramp, then disabled"))
    else:
        text = "not writable: set it with the vendor's tool so that a quick stop brakes (2)"
        found.append(Finding("0x605a quick stop option", Verdict.UNKNOWN, text))
    return found
