"""The PDOs of one axis: chosen from its dictionary, packed by one codec each, written by SDO and read back.

A dictionary is first judged for cyclic torque: the profile, then heartbeat, watchdog and PDOs. Preferred: one TPDO of
statusword, position and torque (0x6074, else 0x6077), one RPDO of controlword and target torque. Writable mappings are
written; fixed ones (`ro`) are selected, several TPDOs if need be.

Each PDO has one struct codec for its bytes as one image: no value is ever torn, and no offset can shift.

A map is written in the order of CiA 301: COB-ID with bit 31 (off), transmission type, sub 0 = 0, entries, sub 0 = n,
COB-ID without bit 31 (on). Then it is read back and compared. canopen's own `save()` writes no entries where the
mapping is declared ARRAY, and yet switches the PDO on.
"""

import struct
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Final, Literal

from canopen import ObjectDictionary
from canopen.objectdictionary import ODVariable, datatypes

from canhaptic.canopen import objects as od
from canhaptic.canopen.eds import left_out
from canhaptic.canopen.objects import COB_ID_INVALID, SYNCHRONOUS_EVERY_SYNC, DataType, is_writable
from canhaptic.drive.axis_parameters import AxisParameters, CanBusParameters
from canhaptic.drive.can.sdo import SdoChannel
from canhaptic.drive.profile import fitness
from canhaptic.drive.profile.fitness import (
    Finding,
    ObjectUse,
    Verdict,
    force_object,
    judged,
    listed,
    mapping_objection,
    objection,
)
from canhaptic.drive.profile.quirks import quirks_of
from canhaptic.drive.profile.torque_axis_parameters import ReadBack
from canhaptic.errors import DictionaryError, SdoError

_UNSIGNED_FORMATS: Final = {8: "B", 16: "H", 32: "I", 64: "Q"}
_Kind = Literal["RPDO", "TPDO"]
Watchdog = Literal["heartbeat", "life_guarding", "rpdo_timer", "none"]
"""Means by which a drive notices a dead master."""


@dataclass(frozen=True, slots=True)
class MappedObject:
    """One entry of a PDO mapping (CiA 301, 7.5.2.36)."""

    index: int
    subindex: int
    bits: int
    signed: bool = False

    @property
    def entry(self) -> int:
        """The UNSIGNED32 of the mapping object: index, subindex, length in bits."""
        return self.index << 16 | self.subindex << 8 | self.bits

    @property
    def data_type(self) -> DataType:
        """The integer type of this length and sign."""
        return DataType[f"{'INTEGER' if self.signed else 'UNSIGNED'}{self.bits}"]

    def __str__(self) -> str:
        """Object and length in bits, as `0x6064:00/32`."""
        return f"{self.index:#06x}:{self.subindex:02x}/{self.bits}"


def decode_entry(entry: int) -> MappedObject:
    """Return the object of an UNSIGNED32 mapping entry, which does not tell whether it is signed."""
    return MappedObject(entry >> 16, entry >> 8 & 0xFF, entry & 0xFF)


def codec(entries: Sequence[MappedObject], wanted: Sequence[int]) -> struct.Struct:
    """Return the struct of a PDO that yields, in the order of the PDO, the values of the wanted indices.

    Args:
        entries: Mapped objects, in order.
        wanted: Indices to decode; the bytes of others are skipped.

    Raises:
        DictionaryError: A wanted object is not byte-aligned or of an odd length, or the PDO is longer than 8 bytes.
    """
    layout, offset, skipped = "<", 0, 0
    for entry in entries:
        if entry.index in wanted:
            if skipped % 8 or entry.bits not in _UNSIGNED_FORMATS:
                raise DictionaryError(
                    f"mapped object {entry} at bit {offset} must be an integer on a byte boundary; move it"
                )
            letter = _UNSIGNED_FORMATS[entry.bits]
            layout += f"{skipped // 8}x" + (letter.lower() if entry.signed else letter)
            skipped = 0
        else:
            skipped += entry.bits
        offset += entry.bits
    if offset > 64 or offset % 8:
        raise DictionaryError(f"a PDO of {offset} bits cannot be decoded, expected whole bytes up to 64 bits")
    return struct.Struct(f"{layout}{skipped // 8}x")


_CONTROLWORD: Final = MappedObject(od.CONTROLWORD, 0, 16)
_TARGET_TORQUE: Final = MappedObject(od.TARGET_TORQUE, 0, 16, signed=True)
_STATUSWORD: Final = MappedObject(od.STATUSWORD, 0, 16)
_POSITION: Final = MappedObject(od.POSITION_ACTUAL, 0, 32, signed=True)
TORQUE_DEMAND: Final = MappedObject(od.TORQUE_DEMAND, 0, 16, signed=True)
_TORQUE_ACTUAL: Final = MappedObject(od.TORQUE_ACTUAL, 0, 16, signed=True)
_USED: Final = (_CONTROLWORD, _TARGET_TORQUE, _STATUSWORD, _POSITION, TORQUE_DEMAND, _TORQUE_ACTUAL)
_TARGETS: Final = {
    od.TARGET_TORQUE: _TARGET_TORQUE,
    od.TARGET_VELOCITY: MappedObject(od.TARGET_VELOCITY, 0, 32, signed=True),
    od.TARGET_POSITION: MappedObject(od.TARGET_POSITION, 0, 32, signed=True),
}
_INDICES: Final = {"RPDO": (od.RPDO_COMMUNICATION, od.RPDO_MAPPING), "TPDO": (od.TPDO_COMMUNICATION, od.TPDO_MAPPING)}
"""Kind of PDO -> first index of its communication parameters and of its mapping parameters."""


@dataclass(frozen=True, slots=True)
class PdoPlan:
    """A planned PDO: its number, COB-ID and contents."""

    kind: _Kind
    number: int
    cob_id: int
    entries: tuple[MappedObject, ...]
    is_written: bool  # False: the mapping is fixed in the drive and only checked
    cob_id_is_written: bool

    @property
    def communication_index(self) -> int:
        """Index of the communication parameters (0x1400.., 0x1800..)."""
        return _INDICES[self.kind][0] + self.number - 1

    @property
    def mapping_index(self) -> int:
        """Index of the mapping parameters (0x1600.., 0x1A00..)."""
        return _INDICES[self.kind][1] + self.number - 1

    @property
    def length(self) -> int:
        """Length of the PDO's frame [bytes]."""
        return sum(entry.bits for entry in self.entries) // 8

    @property
    def name(self) -> str:
        """Name of the PDO: its kind and number, such as `TPDO3`."""
        return f"{self.kind}{self.number}"


@dataclass(frozen=True, slots=True)
class AxisMap:
    """The PDOs chosen for one axis."""

    rpdo: PdoPlan
    tpdos: tuple[PdoPlan, ...]
    read_back: ReadBack
    awaited: tuple[int, ...] = ()  # lengths of frames of other nodes that belong to its sample [bytes]
    watchdog: Watchdog = "heartbeat"


@dataclass(frozen=True, slots=True)
class PdoCapability:
    """A PDO that the dictionary lists, with its fixed mapping or its number of writable entries."""

    kind: _Kind
    number: int
    fixed: tuple[MappedObject, ...] | None  # None: the mapping can be written
    room: int  # entries


def choose_map(dictionary: ObjectDictionary, axis: AxisParameters) -> AxisMap:
    """Return the PDOs to use for one axis.

    Raises:
        DictionaryError: No map carries the objects of cyclic torque; the text names the missing objects.
    """
    target = _TARGETS[axis.causality.target]
    for needed in (_CONTROLWORD, target, _STATUSWORD, _POSITION):
        if dictionary.get_variable(needed.index, needed.subindex) is None:
            raise DictionaryError(f"{axis.name}: {axis.eds}: has no object {needed}; {axis.causality.kind} needs it")
        if (text := objection(dictionary, ObjectUse(needed.index, 0, needed.data_type))) is not None:
            raise DictionaryError(f"{axis.name}: {axis.eds}: {needed} is {text}; correct the dictionary")
    read_back, torque = _read_back(dictionary, axis)
    shown = torque or _force(dictionary, axis)
    wanted = [_STATUSWORD, _POSITION] + ([shown] if shown else [])
    rpdo = _choose_rpdo(dictionary, axis, (_CONTROLWORD, target))
    tpdos = _choose_tpdos(dictionary, axis, wanted)
    plans, taken = [], set(axis.pdo_cob_ids.values())
    for candidate, entries in [(rpdo, (_CONTROLWORD, target)), *tpdos]:
        plan = _plan(dictionary, axis, candidate, tuple(candidate.fixed or entries), taken)
        taken.add(plan.cob_id)
        plans.append(plan)
    for first, second in combinations(plans, 2):
        if first.cob_id == second.cob_id:
            place = f"{second.communication_index:#06x}"
            shared = f"{first.name} and {second.name} would share COB-ID {first.cob_id:#x}"
            raise DictionaryError(f"{axis.name}: {shared}; set pdo_cob_ids: {{{place}: ...}}")
    node = axis.causality.force.node
    watchdog = _choose_watchdog(dictionary, axis, plans[0])
    return AxisMap(plans[0], tuple(plans[1:]), read_back, (node.frame_length,) if node else (), watchdog)


def pdo_numbers(dictionary: ObjectDictionary, kind: _Kind) -> list[int]:
    """Return the numbers of all PDOs whose communication parameters the dictionary lists."""
    first = _INDICES[kind][0]
    last = first + od.PDO_COUNT - 1
    indices = {index for index in dictionary if first <= index <= last} | left_out(dictionary, first, last).keys()
    return [index - first + 1 for index in sorted(indices)]


def _unreadable(dictionary: ObjectDictionary, kind: _Kind) -> dict[int, str]:
    """Return the numbers of the PDOs of which a section could not be read, and why: none of them can be chosen."""
    ranges = [(first, left_out(dictionary, first, first + od.PDO_COUNT - 1)) for first in _INDICES[kind]]
    return {index - first + 1: why for first, found in ranges for index, why in found.items()}


# --- the objects ------------------------------------------------------------------------------------------------


def _read_back(dictionary: ObjectDictionary, axis: AxisParameters) -> tuple[ReadBack, MappedObject | None]:
    asked, has_demand = axis.causality.reads or axis.read_back, quirks_of(axis.quirks).maps_demand
    if asked in ("auto", "demand") and has_demand and _is_mappable(dictionary, TORQUE_DEMAND):
        return "demand", TORQUE_DEMAND
    if asked in ("auto", "actual") and _is_mappable(dictionary, _TORQUE_ACTUAL):
        return "actual", _TORQUE_ACTUAL
    if asked in ("auto", "none"):
        return "none", None
    asks, wanted = f"{axis.name}: read_back is {asked!r}, but", TORQUE_DEMAND if asked == "demand" else _TORQUE_ACTUAL
    if asked == "demand" and not has_demand:
        raise DictionaryError(f"{asks} its quirks have demand_absent; use read_back: auto")
    raise DictionaryError(f"{asks} {axis.eds} does not let {wanted} be mapped; use read_back: auto")


def _force(dictionary: ObjectDictionary, axis: AxisParameters) -> MappedObject | None:
    """Return the object that shows a force in place of a torque; None without one."""
    if (found := force_object(dictionary, axis)) is None:
        return None
    index, subindex, kind = found
    return MappedObject(index, subindex, 16 if kind is DataType.INTEGER16 else 32, signed=True)


def _is_mappable(dictionary: ObjectDictionary, wanted: MappedObject) -> bool:
    """Whether an object may go into a TPDO: stated as mappable, or part of a fixed map."""
    if mapping_objection(dictionary, "TPDO", wanted.index, wanted.data_type) is None:
        return True
    if objection(dictionary, ObjectUse(wanted.index, 0, wanted.data_type)) is not None:
        return False
    return any(wanted.entry == e.entry for c in pdo_capabilities(dictionary, "TPDO") for e in c.fixed or ())


def _mapped(dictionary: ObjectDictionary, entry: int) -> MappedObject:
    found = decode_entry(entry)
    variable = dictionary.get_variable(found.index, found.subindex)
    is_known = any(found.index == used.index and used.signed for used in _USED)
    return replace(found, signed=is_known or getattr(variable, "data_type", None) in datatypes.SIGNED_TYPES)


# --- the PDOs that a dictionary has -------------------------------------------------------------------------------


def pdo_capabilities(dictionary: ObjectDictionary, kind: _Kind) -> Iterator[PdoCapability]:
    """Yield every PDO whose mapping can be written or is completely given, in order."""
    unreadable = _unreadable(dictionary, kind)
    for number in pdo_numbers(dictionary, kind):
        if number in unreadable:
            continue
        members = getattr(dictionary.get(_INDICES[kind][1] + number - 1), "subindices", {})
        room = next(n for n in range(len(members) + 1) if not _is_slot(members.get(n + 1)))
        if room and _is_slot(members.get(0)):
            yield PdoCapability(kind, number, None, room)
            continue
        count = members[0].default if 0 in members else None
        values = [members[s].default for s in sorted(members) if 0 < s <= (count or 0)]
        is_given = values and len(values) == count and all(isinstance(v, int) and v for v in values)
        if is_given and (entries := _decodable(dictionary, values)):
            yield PdoCapability(kind, number, entries, room)


def _is_slot(variable: ODVariable | None) -> bool:
    """Whether a subindex can be written and read back."""
    return variable is not None and variable.readable and variable.writable


def _decodable(dictionary: ObjectDictionary, values: Sequence[int]) -> tuple[MappedObject, ...]:
    """Return a fixed map; empty if it cannot be decoded: a single BOOLEAN shifts every later object by a bit."""
    try:
        entries = tuple(_mapped(dictionary, value) for value in values)
        codec(entries, [entry.index for entry in entries if entry.entry in {used.entry for used in _USED}])
    except DictionaryError:
        return ()
    return entries


def _choose_rpdo(
    dictionary: ObjectDictionary, axis: AxisParameters, wanted: tuple[MappedObject, MappedObject]
) -> PdoCapability:
    candidates = [c for c in pdo_capabilities(dictionary, "RPDO") if axis.rpdo_number in (None, c.number)]
    unmappable, needed = _unmappable(dictionary, "RPDO", wanted), {entry.entry for entry in wanted}
    fits = [c for c in candidates if c.fixed is None and c.room >= len(wanted) and not unmappable]
    fits += [c for c in candidates if {entry.entry for entry in c.fixed or ()} == needed]
    if not fits:
        text = f"no RPDO{axis.rpdo_number or ''} can carry {wanted[0]} and {wanted[1]}"
        remedy = "the drive needs a writable mapping (0x1600..) or a fixed one with exactly these two"
        remedy += "".join(f"; {why}" for why in _unreadable(dictionary, "RPDO").values())
        raise DictionaryError(f"{axis.name}: {axis.eds}: {text}; {remedy}{unmappable}")
    return fits[0]


def _choose_tpdos(
    dictionary: ObjectDictionary, axis: AxisParameters, wanted: Sequence[MappedObject]
) -> list[tuple[PdoCapability, Sequence[MappedObject]]]:
    candidates = [c for c in pdo_capabilities(dictionary, "TPDO") if c.number in (axis.tpdo_numbers or (c.number,))]
    unmappable = _unmappable(dictionary, "TPDO", wanted)
    for candidate in candidates:
        if candidate.fixed is None and candidate.room >= len(wanted) and not unmappable:
            return [(candidate, wanted)]
    needed = {entry.entry for entry in wanted}
    fixed = [c for c in candidates if c.fixed]
    for count in (1, 2, 3):  # at most statusword, position and torque each in a TPDO of its own
        covers = [g for g in combinations(fixed, count) if needed <= {e.entry for c in g for e in c.fixed or ()}]
        if covers:
            best = min(covers, key=lambda group: sum(e.bits for c in group for e in c.fixed or ()))
            return [(candidate, ()) for candidate in best]
    text = f"no writable or fixed TPDO carries {', '.join(map(str, wanted))}"
    text += "".join(f"; {why}" for why in _unreadable(dictionary, "TPDO").values())
    raise DictionaryError(f"{axis.name}: {axis.eds}: {text}; set tpdo_numbers or read_back: none{unmappable}")


def _unmappable(dictionary: ObjectDictionary, kind: _Kind, wanted: Sequence[MappedObject]) -> str:
    """Objects that cannot be part of a written map, and why; empty where all can."""
    texts = [mapping_objection(dictionary, kind, entry.index, entry.data_type, entry.subindex) for entry in wanted]
    return "".join(f"; {entry} is {text}" for entry, text in zip(wanted, texts, strict=True) if text is not None)


# --- the COB-IDs --------------------------------------------------------------------------------------------------


def _plan(
    dictionary: ObjectDictionary,
    axis: AxisParameters,
    candidate: PdoCapability,
    entries: tuple[MappedObject, ...],
    taken: set[int],
) -> PdoPlan:
    index = _INDICES[candidate.kind][0] + candidate.number - 1
    can_write = is_writable(dictionary, index, 1)
    bases = od.RPDO_BASE if candidate.kind == "RPDO" else od.TPDO_BASE
    predefined = [base + axis.node_id for base in bases]
    if not can_write:
        stated = getattr(dictionary.get_variable(index, 1), "default", None)
        cob_id = stated & 0x7FF if isinstance(stated, int) else predefined[min(candidate.number, len(bases)) - 1]
    elif index in axis.pdo_cob_ids:
        cob_id = axis.pdo_cob_ids[index]
    elif candidate.number <= len(bases):
        cob_id = predefined[candidate.number - 1]
    else:  # all other PDOs of this node get disabled, so its predefined COB-IDs are free
        cob_id = next((c for c in predefined if c not in taken), predefined[0])
    return PdoPlan(candidate.kind, candidate.number, cob_id, entries, candidate.fixed is None, can_write)


_COB_ID, _TRANSMISSION_TYPE, _INHIBIT_TIME, _EVENT_TIMER, _SYNC_START = 1, 2, 3, 5, 6
"""Subindices of the communication parameters."""

_Expect = Callable[[str, int, int], None]
"""Called as expect(object, seen, expected); raises when they differ."""


def rpdo_transmission_type(bus: CanBusParameters, axis: AxisParameters) -> int:
    """Return the transmission type of the RPDO of an axis."""
    return SYNCHRONOUS_EVERY_SYNC if bus.rpdo == "synchronous" else quirks_of(axis.quirks).event_transmission_type


def write_map(
    sdo: SdoChannel, chosen: AxisMap, rpdo_type: int, expect: _Expect, rpdo_deadline: int | None = None,
    *, clears: bool = True,
) -> None:  # fmt: skip
    """Configure the PDOs of one axis and switch all others off; every value is read back.

    Args:
        sdo: The drive, in NMT pre-operational.
        chosen: The PDOs to use.
        rpdo_type: Transmission type of the RPDO.
        expect: Function that judges each value read back.
        rpdo_deadline: Silence of the RPDO after which the drive itself must react [ms], where its dictionary has that
            (CiA 301: the event timer of an RPDO); None: unchanged.
        clears: Whether inhibit times, event timers and SYNC start values of the TPDOs are set to 0.

    Raises:
        SdoError: The drive refused a step.
    """
    for index in others_to_disable(sdo.dictionary, chosen):
        cob_id = sdo.read(index, _COB_ID)
        if not cob_id & COB_ID_INVALID:
            sdo.write(index, _COB_ID, cob_id | COB_ID_INVALID)
    for plan in (*chosen.tpdos, chosen.rpdo):
        transmission_type = rpdo_type if plan.kind == "RPDO" else SYNCHRONOUS_EVERY_SYNC
        deadline = rpdo_deadline if plan.kind == "RPDO" else None
        _write_pdo(sdo, plan, transmission_type, deadline, expect, clears=clears)
        _compare_pdo(sdo, plan, transmission_type, expect)


def others_to_disable(dictionary: ObjectDictionary, chosen: AxisMap) -> list[int]:
    """Return the communication objects of the PDOs that are not chosen and can be switched off."""
    used = {plan.communication_index for plan in (chosen.rpdo, *chosen.tpdos)}
    kinds: tuple[_Kind, ...] = ("RPDO", "TPDO")
    indices = [_INDICES[kind][0] + n - 1 for kind in kinds for n in pdo_numbers(dictionary, kind)]
    return [n for n in indices if n not in used and _is_slot(dictionary.get_variable(n, _COB_ID))]


def _write_pdo(
    sdo: SdoChannel, plan: PdoPlan, transmission_type: int, deadline: int | None, expect: _Expect, *, clears: bool
) -> None:
    communication, mapping = plan.communication_index, plan.mapping_index
    cob_id = plan.cob_id | sdo.read(communication, _COB_ID) & 1 << 30  # no RTR: some drives insist on it
    if plan.cob_id_is_written:
        sdo.write(communication, _COB_ID, cob_id | COB_ID_INVALID)
    if is_writable(sdo.dictionary, communication, _TRANSMISSION_TYPE):
        sdo.write(communication, _TRANSMISSION_TYPE, transmission_type)
    if deadline is not None and is_writable(sdo.dictionary, communication, _EVENT_TIMER):
        sdo.write(communication, _EVENT_TIMER, deadline)
        seen = sdo.read(communication, _EVENT_TIMER)
        expect(f"{plan.name} {sdo.describe(communication, _EVENT_TIMER)}", seen, deadline)
    if clears and deadline is None and plan.cob_id_is_written:
        _clear_times(sdo, plan)
    if plan.is_written:
        sdo.write(mapping, 0, 0)
        for subindex, entry in enumerate(plan.entries, start=1):
            sdo.write(mapping, subindex, entry.entry, size=4)
        sdo.write(mapping, 0, len(plan.entries))
    if plan.cob_id_is_written:
        sdo.write(communication, _COB_ID, cob_id)


def _clear_times(sdo: SdoChannel, plan: PdoPlan) -> None:
    """Set to 0 what delays a TPDO, makes it come without a SYNC, or begin at a later one; and a deadline of an RPDO.

    It must be switched off meanwhile (CiA 301).
    """
    for subindex in (_INHIBIT_TIME, _EVENT_TIMER, _SYNC_START) if plan.kind == "TPDO" else (_EVENT_TIMER,):
        if not is_writable(sdo.dictionary, plan.communication_index, subindex):
            continue
        try:
            left = sdo.read(plan.communication_index, subindex)
        except SdoError as error:
            if error.code is None:
                raise
            continue  # listed, and not in the drive
        if left:
            sdo.write(plan.communication_index, subindex, 0)


def _compare_pdo(sdo: SdoChannel, plan: PdoPlan, transmission_type: int, expect: _Expect) -> None:
    communication, mapping = plan.communication_index, plan.mapping_index
    cob_id = sdo.read(communication, _COB_ID)
    expect(f"{plan.name} {sdo.describe(communication, _COB_ID)}", cob_id & (COB_ID_INVALID | 0x7FF), plan.cob_id)
    seen_type = sdo.read(communication, _TRANSMISSION_TYPE)
    expect(f"{plan.name} {sdo.describe(communication, _TRANSMISSION_TYPE)}", seen_type, transmission_type)
    expect(f"{plan.name} {sdo.describe(mapping)}", sdo.read(mapping), len(plan.entries))
    for subindex, entry in enumerate(plan.entries, start=1):
        seen = sdo.read(mapping, subindex) & 0xFFFFFFFF
        expect(f"{plan.name} entry {mapping:#06x}:{subindex:02x} ({decode_entry(seen)})", seen, entry.entry)


def check_dictionary(
    dictionary: ObjectDictionary, axis: AxisParameters, bus: CanBusParameters | None = None
) -> list[Finding]:
    """Return the findings on a dictionary's fitness for cyclic torque, refusals included.

    Args:
        dictionary: Dictionary of the drive.
        axis: Parameters of the axis.
        bus: Bus of the axis; None: unknown, so that values that depend on it are not judged.
    """
    return [
        *fitness.profile_findings(dictionary, axis, None if bus is None else bus.sample_time_ns),
        _heartbeat(dictionary, axis, bus),
        _watchdog(dictionary, axis, bus),
        *_sync_period(dictionary),
        _map(dictionary, axis, bus),
        *_unseen(dictionary, axis),
    ]


def require_fit(dictionary: ObjectDictionary, axis: AxisParameters, bus: CanBusParameters | None = None) -> None:
    """Refuse a dictionary that is not fit for cyclic torque.

    Raises:
        DictionaryError: It is not fit; the text lists every reason.
    """
    refused = [finding for finding in check_dictionary(dictionary, axis, bus) if finding.verdict is Verdict.REFUSED]
    if refused:
        lines = "; ".join(f"{finding.item}: {finding.text}" for finding in refused)
        raise DictionaryError(f"{axis.name}: {axis.eds} is not fit for {axis.causality.kind}: {lines}")


def _heartbeat(dictionary: ObjectDictionary, axis: AxisParameters, bus: CanBusParameters | None) -> Finding:
    item = "0x1017 producer heartbeat"
    if watchdog_of(dictionary, axis) == "life_guarding":
        return Finding(item, Verdict.FIT, "not used: the answers to guard requests show the NMT state")
    values = () if bus is None else (bus.heartbeat_ms,)
    use = ObjectUse(od.PRODUCER_HEARTBEAT_TIME, 0, DataType.UNSIGNED16, reads=True, writes=True, values=values)
    return judged(dictionary, item, use, "without a heartbeat no NMT state can be confirmed")


WATCHDOGS: Final[dict[Watchdog, str]] = {
    "heartbeat": "by the master's heartbeat (0x1016)",
    "life_guarding": "by guard requests (0x100C, 0x100D)",
    "rpdo_timer": "by its RPDO (event timer)",
}
"""By what a drive notices a dead master, in words."""


def lacking(dictionary: ObjectDictionary, rpdo: int, bus: CanBusParameters | None = None) -> dict[Watchdog, str]:
    """Return why a drive cannot use each standard means of noticing a dead master; "" where it can.

    Args:
        dictionary: Dictionary of the drive.
        rpdo: Index of the communication parameters of its RPDO.
        bus: Bus of the drive; None: unknown, so that values are not judged.
    """
    values = () if bus is None else (bus.consumer_heartbeat,)
    silence = () if bus is None else (bus.master_silence_ns // 1_000_000,)
    guard_time, factor = ((), ()) if bus is None else ((bus.guard_time_ms,), (bus.life_time_factor,))
    uses: dict[Watchdog, list[ObjectUse]] = {
        "heartbeat": [ObjectUse(od.CONSUMER_HEARTBEAT_TIME, 1, reads=True, writes=True, values=values)],
        "life_guarding": [
            ObjectUse(od.GUARD_TIME, 0, DataType.UNSIGNED16, reads=True, writes=True, values=guard_time),
            ObjectUse(od.LIFE_TIME_FACTOR, 0, DataType.UNSIGNED8, reads=True, writes=True, values=factor),
        ],
        "rpdo_timer": [ObjectUse(rpdo, _EVENT_TIMER, DataType.UNSIGNED16, reads=True, writes=True, values=silence)],
    }
    found: dict[Watchdog, str] = {}
    for means, needed in uses.items():
        texts = [(use, objection(dictionary, use)) for use in needed]
        found[means] = ", ".join(f"{use.index:#06x}:{use.subindex:02x} is {text}" for use, text in texts if text)
    return found


def standard_watchdog(dictionary: ObjectDictionary, chosen: AxisMap | None) -> tuple[Watchdog, str]:
    """Return the first means that a dictionary has, and why it lacks those before it ("none": all of them)."""
    rpdo = od.RPDO_COMMUNICATION if chosen is None else chosen.rpdo.communication_index
    texts = lacking(dictionary, rpdo)
    means: Watchdog = next((one for one, text in texts.items() if not text), "none")
    return means, "; ".join(text for text in texts.values() if text)


def _choose_watchdog(dictionary: ObjectDictionary, axis: AxisParameters, rpdo: PdoPlan) -> Watchdog:
    """Return the means that the scene names, else the first that the dictionary has."""
    if axis.watchdog is False:
        return "none"
    if axis.watchdog is not True:
        return axis.watchdog
    texts = lacking(dictionary, rpdo.communication_index)
    return next((means for means, text in texts.items() if not text), "none")


def watchdog_of(dictionary: ObjectDictionary, axis: AxisParameters) -> Watchdog:
    """Return by what a drive will notice a dead master; "none" also where the dictionary is not fit."""
    try:
        return choose_map(dictionary, axis).watchdog
    except DictionaryError:
        return "none"


def _watchdog(dictionary: ObjectDictionary, axis: AxisParameters, bus: CanBusParameters | None) -> Finding:
    item = "0x1016 consumer heartbeat"
    if not axis.watchdog:
        return Finding(item, Verdict.UNKNOWN, "not armed (watchdog: false); a killed master leaves the torque on")
    try:
        chosen = choose_map(dictionary, axis)
        rpdo, means = chosen.rpdo.communication_index, chosen.watchdog
    except DictionaryError:  # a finding of its own
        rpdo, means = od.RPDO_COMMUNICATION, "heartbeat"
    texts = lacking(dictionary, rpdo, bus)
    asked = [means] if means != "none" else list(texts)
    if all(texts[one] for one in asked):
        seen = "; ".join(texts[one] for one in asked)
        hint = "the drive cannot notice a killed master; set watchdog: false to accept that"
        if means != "none" and (others := [one for one, text in texts.items() if not text]):
            hint = f"set watchdog: {others[0]}"
        return Finding(item, Verdict.REFUSED, f"{seen}; {hint}")
    return Finding(item, Verdict.FIT, f"armed at the start: the drive notices a dead master {WATCHDOGS[means]}")


def _sync_period(dictionary: ObjectDictionary) -> list[Finding]:
    """Return a refusal if 0x1006 is listed but cannot be compared with the sample time; the object is optional."""
    variable = listed(dictionary, od.COMMUNICATION_CYCLE_PERIOD)
    if variable is None or not variable.readable:
        return []
    use = ObjectUse(od.COMMUNICATION_CYCLE_PERIOD, 0, DataType.UNSIGNED32, reads=True)
    found = judged(dictionary, "0x1006 SYNC period", use, "correct the dictionary")
    return [found] if found.verdict is Verdict.REFUSED else []


def _unseen(dictionary: ObjectDictionary, axis: AxisParameters) -> list[Finding]:
    """Return what no frame shows where no torque is read back."""
    with suppress(DictionaryError):
        if (text := axis.causality.unseen) and choose_map(dictionary, axis).read_back == "none":
            return [Finding("torque read back", Verdict.UNKNOWN, text)]
    return []


def _map(dictionary: ObjectDictionary, axis: AxisParameters, bus: CanBusParameters | None) -> Finding:
    try:
        chosen = choose_map(dictionary, axis)
    except DictionaryError as error:
        return Finding("PDO map", Verdict.REFUSED, str(error))
    rpdo_type = None if bus is None else rpdo_transmission_type(bus, axis)
    types = [(chosen.rpdo, rpdo_type), *((tpdo, od.SYNCHRONOUS_EVERY_SYNC) for tpdo in chosen.tpdos)]
    refused = [text for plan, kind in types for text in _plan_objections(dictionary, plan, kind)]
    for index in others_to_disable(dictionary, chosen):
        if (text := objection(dictionary, ObjectUse(index, 1, DataType.UNSIGNED32, reads=True))) is not None:
            refused.append(f"{index:#06x}:01 of a PDO to be switched off is {text}")
    if refused:
        return Finding("PDO map", Verdict.REFUSED, "; ".join(refused))
    parts = [
        f"{pdo.name} {pdo.cob_id:#05x} {'written' if pdo.is_written else 'fixed'} "
        f"[{', '.join(str(entry) for entry in pdo.entries)}]"
        for pdo in (chosen.rpdo, *chosen.tpdos)
    ]
    if source := axis.causality.energy_from.get(chosen.read_back):
        parts.append(f"energy from {source}")
    return Finding("PDO map", Verdict.FIT, "; ".join(parts))


def _plan_objections(dictionary: ObjectDictionary, plan: PdoPlan, transmission_type: int | None) -> Iterator[str]:
    """Yield the reasons why a planned PDO cannot be configured and read back."""
    place, types = plan.communication_index, () if transmission_type is None else (transmission_type,)
    cob_ids = (plan.cob_id | od.COB_ID_INVALID, plan.cob_id) if plan.cob_id_is_written else ()
    stated = getattr(listed(dictionary, place, 2), "default", None)
    is_type_written = is_writable(dictionary, place, 2)
    if not is_type_written and types and isinstance(stated, int) and stated not in types:
        yield f"{plan.name}: {place:#06x}:02 is read-only and {stated}, but {types[0]} is needed"
    uses = [
        ObjectUse(place, 1, reads=True, values=cob_ids),
        ObjectUse(place, 2, reads=True, values=types if is_type_written else ()),
        ObjectUse(plan.mapping_index, 0, reads=True, values=(0, len(plan.entries)) if plan.is_written else ()),
    ]
    for subindex, entry in enumerate(plan.entries, start=1):
        values = (entry.entry,) if plan.is_written else ()
        uses.append(ObjectUse(plan.mapping_index, subindex, DataType.UNSIGNED32, reads=True, values=values))
    for use in uses:
        if (text := objection(dictionary, use)) is not None:
            yield f"{plan.name}: {use.index:#06x}:{use.subindex:02x} is {text}"
    stated = getattr(listed(dictionary, place, 1), "default", None)
    if not plan.cob_id_is_written and isinstance(stated, int) and stated & od.COB_ID_INVALID:
        yield f"{plan.name}: {place:#06x}:01 is read-only and switches the PDO off"
