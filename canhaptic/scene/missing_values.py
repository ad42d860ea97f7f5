"""Values that a simulated drive needs besides its dictionary: a real drive has them and the dictionary leaves them out.

Some dictionaries state the settings of another rig, such as a communication cycle of 1 us; on a real drive the vendor's
tool has set them. A simulated drive gets those of this scene.
"""

from collections.abc import Iterator
from typing import Final

from canopen import ObjectDictionary

from canhaptic.canopen import objects as od
from canhaptic.drive.profile.object_use import ObjectUse, objection, range_objection
from canhaptic.drive.survey import Survey, stated_value

_EVENT_TIMER: Final = 5  # subindex: of an RPDO its deadline [ms]
_DEVICE_TYPE: Final = 0x0002_0000 | od.CIA402_PROFILE  # servo drive

_Place = tuple[int, int]


def missing_values(found: Survey, sample_time: float) -> dict[str, str]:
    """Return `simulation.drive.objects` for a scene made from a dictionary: key and value as written in a scene.

    Args:
        found: The survey of the dictionary.
        sample_time: Time from SYNC to SYNC [s].
    """
    listed = found.dictionary
    values = {**_absent(found), **_misleading(listed, sample_time)}
    return {_key(place): f"{value:#x}" for place, value in values.items() if _holds(listed, place, value)}


def _holds(dictionary: ObjectDictionary, place: _Place, value: int) -> bool:
    """Whether the drive has an object of a type that can hold a value."""
    if objection(dictionary, ObjectUse(*place)) is not None:
        return False
    variable = dictionary.get_variable(*place)
    return variable is not None and range_objection(variable, value) is None


def _key(place: _Place) -> str:
    return f"{place[0]:#06x}" + (f".{place[1]}" if place[1] else "")


def _absent(found: Survey) -> dict[_Place, int]:
    """Return values for objects that have none."""
    needed: dict[_Place, int] = {(od.DEVICE_TYPE, 0): _DEVICE_TYPE}
    if found.vendor_id is not None:
        needed[od.IDENTITY, 1] = found.vendor_id
    needed |= _cob_ids(found.dictionary)
    missing = {place: value for place, value in needed.items() if stated_value(found.dictionary, *place) is None}
    mode_bit = 1 << found.axis.mode_code - 1
    if not (stated_value(found.dictionary, od.SUPPORTED_DRIVE_MODES) or 0) & mode_bit:
        missing[od.SUPPORTED_DRIVE_MODES, 0] = mode_bit
    return missing


def _cob_ids(dictionary: ObjectDictionary) -> dict[_Place, int]:
    """Return the COB-ID of every PDO as delivered: that of the predefined connection set, or disabled."""
    found: dict[_Place, int] = {}
    for first, bases in ((od.RPDO_COMMUNICATION, od.RPDO_BASE), (od.TPDO_COMMUNICATION, od.TPDO_BASE)):
        for index in _indices(dictionary, first):
            number = index - first
            found[index, 1] = bases[number] + 1 if number < len(bases) else od.COB_ID_INVALID
    return found


def _indices(dictionary: ObjectDictionary, first: int) -> Iterator[int]:
    return (index for index in dictionary if first <= index < first + od.PDO_COUNT)


def _misleading(dictionary: ObjectDictionary, sample_time: float) -> dict[_Place, int]:
    """Replacements for stated values that belong to another rig."""
    period = round(sample_time * 1e6)
    wanted: dict[_Place, int] = {(od.SYNC_COB_ID, 0): od.SYNC_FRAME_COB_ID, (od.COMMUNICATION_CYCLE_PERIOD, 0): period}
    wanted |= {(index, _EVENT_TIMER): 0 for index in _indices(dictionary, od.RPDO_COMMUNICATION)}
    return {place: value for place, value in wanted.items() if stated_value(dictionary, *place) not in (None, 0, value)}
