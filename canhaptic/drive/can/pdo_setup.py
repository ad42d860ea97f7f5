"""Writes the PDO map of one drive by SDO in the order that CiA 301 asks for, reads it back and compares.

COB-ID with bit 31 (off), transmission type, sub 0 = 0, entries, sub 0 = n, COB-ID without bit 31 (on). canopen's own
`save()` writes no entries where the mapping is declared ARRAY and then switches the PDO on all the same.
"""

from collections.abc import Callable
from typing import Final

from canopen import ObjectDictionary

from canhaptic.canopen.dictionary import is_writable
from canhaptic.canopen.objects import COB_ID_INVALID, RPDO_COMMUNICATION, SYNCHRONOUS_EVERY_SYNC, TPDO_COMMUNICATION
from canhaptic.drive.axis_parameters import AxisParameters, BusParameters
from canhaptic.drive.can.pdo_codec import decode_entry
from canhaptic.drive.can.pdo_map import AxisMap, PdoPlan, pdo_numbers
from canhaptic.drive.can.sdo import SdoChannel
from canhaptic.drive.profile.quirks import quirks_of

_COB_ID, _TRANSMISSION_TYPE, _EVENT_TIMER = 1, 2, 5  # subindices of the communication parameters
_NO_RTR: Final = 1 << 30  # bit 30 of a TPDO's COB-ID: some drives insist on it
_IDENTIFIER: Final = 0x7FF

_Expect = Callable[[str, int, int], None]
"""Called as expect(object, seen, expected); raises when they differ."""


def rpdo_transmission_type(bus: BusParameters, axis: AxisParameters) -> int:
    """Return the transmission type of the RPDO of an axis."""
    return SYNCHRONOUS_EVERY_SYNC if bus.rpdo == "synchronous" else quirks_of(axis.quirks).event_transmission_type


def write_map(
    sdo: SdoChannel, chosen: AxisMap, rpdo_type: int, expect: _Expect, rpdo_deadline: int | None = None
) -> None:
    """Configure the PDOs of one axis and switch all others off; every value is read back.

    Args:
        sdo: The drive, in NMT pre-operational.
        chosen: The PDOs to use.
        rpdo_type: Transmission type of the RPDO.
        expect: Judges each value read back.
        rpdo_deadline: Silence of the RPDO after which the drive itself shall act [ms], where its dictionary has that
            (CiA 301: the event timer of an RPDO); None: it is left as it is.

    Raises:
        SdoError: The drive refused a step.
    """
    _disable_others(sdo, chosen)
    for plan in (*chosen.tpdos, chosen.rpdo):
        transmission_type = rpdo_type if plan.kind == "RPDO" else SYNCHRONOUS_EVERY_SYNC
        deadline = rpdo_deadline if plan.kind == "RPDO" else None
        _write_pdo(sdo, plan, transmission_type, deadline, expect)
        _compare_pdo(sdo, plan, transmission_type, expect)


def _disable_others(sdo: SdoChannel, chosen: AxisMap) -> None:
    for index in others_to_disable(sdo.dictionary, chosen):
        cob_id = sdo.read(index, _COB_ID)
        if not cob_id & COB_ID_INVALID:
            sdo.write(index, _COB_ID, cob_id | COB_ID_INVALID)


def others_to_disable(dictionary: ObjectDictionary, chosen: AxisMap) -> list[int]:
    """Return the communication objects of the PDOs that are not chosen and can be switched off."""
    used = {plan.communication_index for plan in (chosen.rpdo, *chosen.tpdos)}
    indices = [RPDO_COMMUNICATION + n - 1 for n in pdo_numbers(dictionary, "RPDO")]
    indices += [TPDO_COMMUNICATION + n - 1 for n in pdo_numbers(dictionary, "TPDO")]
    return [n for n in indices if n not in used and is_writable(dictionary, n, _COB_ID) and _is_readable(dictionary, n)]


def _is_readable(dictionary: ObjectDictionary, index: int) -> bool:
    variable = dictionary.get_variable(index, _COB_ID)
    return variable is not None and variable.readable


def _write_pdo(sdo: SdoChannel, plan: PdoPlan, transmission_type: int, deadline: int | None, expect: _Expect) -> None:
    communication, mapping = plan.communication_index, plan.mapping_index
    present = sdo.read(communication, _COB_ID)
    cob_id = plan.cob_id | present & _NO_RTR
    if plan.cob_id_is_written:
        sdo.write(communication, _COB_ID, cob_id | COB_ID_INVALID)
    if is_writable(sdo.dictionary, communication, _TRANSMISSION_TYPE):
        sdo.write(communication, _TRANSMISSION_TYPE, transmission_type)
    if deadline is not None and is_writable(sdo.dictionary, communication, _EVENT_TIMER):
        sdo.write(communication, _EVENT_TIMER, deadline)
        seen = sdo.read(communication, _EVENT_TIMER)
        expect(f"{plan.name} {sdo.describe(communication, _EVENT_TIMER)}", seen, deadline)
    if plan.is_written:
        sdo.write(mapping, 0, 0)
        for subindex, entry in enumerate(plan.entries, start=1):
            sdo.write(mapping, subindex, entry.entry, size=4)
        sdo.write(mapping, 0, len(plan.entries))
    if plan.cob_id_is_written:
        sdo.write(communication, _COB_ID, cob_id)


def _compare_pdo(sdo: SdoChannel, plan: PdoPlan, transmission_type: int, expect: _Expect) -> None:
    communication, mapping = plan.communication_index, plan.mapping_index
    cob_id = sdo.read(communication, _COB_ID)
    expect(f"{plan.name} {sdo.describe(communication, _COB_ID)}", cob_id & (COB_ID_INVALID | _IDENTIFIER), plan.cob_id)
    seen_type = sdo.read(communication, _TRANSMISSION_TYPE)
    expect(f"{plan.name} {sdo.describe(communication, _TRANSMISSION_TYPE)}", seen_type, transmission_type)
    expect(f"{plan.name} {sdo.describe(mapping)}", sdo.read(mapping), len(plan.entries))
    for subindex, entry in enumerate(plan.entries, start=1):
        seen = sdo.read(mapping, subindex) & 0xFFFFFFFF
        expect(f"{plan.name} entry {mapping:#06x}:{subindex:02x} ({decode_entry(seen)})", seen, entry.entry)
