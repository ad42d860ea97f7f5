"""The process data of one drive: one RxPDO and one TxPDO, chosen from its dictionary, written and read back.

Preferred are maps that can be written: controlword and target, and statusword, position and torque (0x6074, else
0x6077). A fixed map is taken as it is where it holds exactly these objects.
"""

import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final, Literal

from canhaptic.canopen import objects as od
from canhaptic.canopen.objects import DataType, Dictionary
from canhaptic.drive.profile.fitness import Finding, Verdict, force_object, mapping_objection
from canhaptic.drive.profile.quirks import quirks_of
from canhaptic.drive.profile.torque_axis import ObjectAccess
from canhaptic.drive.profile.torque_axis_parameters import ReadBack, TorqueAxisParameters
from canhaptic.errors import DictionaryError

_Kind = Literal["RPDO", "TPDO"]
_FIRST: Final = {"RPDO": od.RPDO_MAPPING, "TPDO": od.TPDO_MAPPING}
_ASSIGNMENT: Final = {"RPDO": 0x1C12, "TPDO": 0x1C13}
_NAMES: Final = {"RPDO": "RxPDO", "TPDO": "TxPDO"}
_CODES: Final = {DataType.UNSIGNED16: "H", DataType.INTEGER16: "h", DataType.INTEGER32: "i"}


@dataclass(frozen=True, slots=True)
class Entry:
    """One object in the process data."""

    index: int
    data_type: DataType
    subindex: int = 0

    @property
    def mapping(self) -> int:
        """The UNSIGNED32 of the map: index, subindex, length in bits."""
        return self.index << 16 | self.subindex << 8 | 8 * struct.calcsize(_CODES[self.data_type])

    def __str__(self) -> str:
        return f"{self.index:#06x}:{self.subindex:02x}"


_CONTROLWORD: Final = Entry(od.CONTROLWORD, DataType.UNSIGNED16)
_STATUSWORD: Final = Entry(od.STATUSWORD, DataType.UNSIGNED16)
_POSITION: Final = Entry(od.POSITION_ACTUAL, DataType.INTEGER32)
_TORQUES: Final[dict[ReadBack, Entry]] = {
    "demand": Entry(od.TORQUE_DEMAND, DataType.INTEGER16),
    "actual": Entry(od.TORQUE_ACTUAL, DataType.INTEGER16),
}


@dataclass(frozen=True, slots=True)
class ImagePdo:
    """One PDO and its contents."""

    kind: _Kind
    index: int
    entries: tuple[Entry, ...]
    is_written: bool  # False: the map is fixed in the drive, and only checked

    @property
    def codec(self) -> struct.Struct:
        """The struct of its bytes."""
        return struct.Struct("<" + "".join(_CODES[entry.data_type] for entry in self.entries))


@dataclass(frozen=True, slots=True)
class ImageMap:
    """The process data of one axis."""

    outputs: ImagePdo
    inputs: ImagePdo
    read_back: ReadBack


def choose_image(dictionary: Dictionary, axis: TorqueAxisParameters) -> ImageMap:
    """Return the PDOs to use for one axis.

    Raises:
        DictionaryError: No map carries the objects of cyclic torque; the text names the missing ones.
    """
    target = Entry(axis.causality.target, axis.causality.target_type)
    read_back, shown = _read_back(dictionary, axis)
    inputs = (_STATUSWORD, _POSITION, *([shown] if shown else ()))
    return ImageMap(
        _choose(dictionary, axis, "RPDO", (_CONTROLWORD, target)), _choose(dictionary, axis, "TPDO", inputs), read_back
    )


def image_findings(dictionary: Dictionary, axis: TorqueAxisParameters) -> list[Finding]:
    """Return the finding on the process data of a dictionary."""
    try:
        chosen = choose_image(dictionary, axis)
    except DictionaryError as error:
        return [Finding("process data", Verdict.REFUSED, str(error).removeprefix(f"{axis.name}: "))]
    text = f"RxPDO {chosen.outputs.index:#06x}, TxPDO {chosen.inputs.index:#06x}, torque read back: {chosen.read_back}"
    return [Finding("process data", Verdict.FIT, text)]


def _read_back(dictionary: Dictionary, axis: TorqueAxisParameters) -> tuple[ReadBack, Entry | None]:
    if axis.causality.reads:
        if (found := force_object(dictionary, axis)) is None:
            text = "admittance.force.node is a node of a CAN bus, expected force.object, an object of the drive"
            raise DictionaryError(f"{axis.name}: {text}; connect the sensor to the drive, or put the axis on a CAN bus")
        index, subindex, kind = found
        return "none", Entry(index, kind, subindex)
    for name, entry in _TORQUES.items():
        if axis.read_back not in ("auto", name) or (name == "demand" and not quirks_of(axis.quirks).maps_demand):
            continue
        if any(entry in (*fixed, *free) for _, fixed, free in _candidates(dictionary, "TPDO", (entry,))):
            return name, entry
    if axis.read_back in ("auto", "none"):
        return "none", None
    raise DictionaryError(f"{axis.name}: read_back is {axis.read_back!r}, but no TxPDO carries it; use read_back: auto")


def _candidates(
    dictionary: Dictionary, kind: _Kind, wanted: Sequence[Entry]
) -> Iterator[tuple[int, tuple[Entry, ...], tuple[Entry, ...]]]:
    """Yield each PDO: its index, what its fixed map holds of the wanted, and what can be written of them into it."""
    mappable = tuple(w for w in wanted if not mapping_objection(dictionary, kind, w.index, w.data_type, w.subindex))
    for index in sorted(i for i in dictionary if _FIRST[kind] <= i < _FIRST[kind] + od.PDO_COUNT):
        members = getattr(dictionary[index], "subindices", {})
        slots = [n for n in range(1, len(members)) if n in members and members[n].writable]
        if slots and members[0].writable:
            yield index, (), mappable if len(slots) >= len(wanted) else ()
        else:
            count = members[0].default if 0 in members else 0
            held = [members[n].default for n in range(1, (count or 0) + 1) if n in members]
            yield index, tuple(w for value in held for w in wanted if w.mapping == value), ()


def _choose(dictionary: Dictionary, axis: TorqueAxisParameters, kind: _Kind, wanted: tuple[Entry, ...]) -> ImagePdo:
    for index, _, free in _candidates(dictionary, kind, wanted):
        if free == wanted:
            return ImagePdo(kind, index, wanted, is_written=True)
    for index, fixed, _ in _candidates(dictionary, kind, wanted):
        count = dictionary[index].subindices[0].default
        if set(fixed) == set(wanted) and count == len(wanted):
            return ImagePdo(kind, index, fixed, is_written=False)
    texts = [(w, mapping_objection(dictionary, kind, w.index, w.data_type, w.subindex)) for w in wanted]
    why = "".join(f"; {entry} is {text}" for entry, text in texts if text)
    names = ", ".join(map(str, wanted))
    raise DictionaryError(
        f"{axis.name}: no {_NAMES[kind]} can carry {names}{why}; the drive needs one that can be written, or a fixed "
        "one with exactly these"
    )


def write_image(sdo: ObjectAccess, pdo: ImagePdo, expect: Callable[[str, int, int], None]) -> None:
    """Write the map of a PDO, assign it alone to its sync manager, and read both back.

    Args:
        sdo: The drive, in PRE-OP.
        pdo: The PDO.
        expect: Judges each value read back.

    Raises:
        SdoError: The drive refused a step.
    """
    assignment = _ASSIGNMENT[pdo.kind]
    values = [(assignment, 0, 0)]
    if pdo.is_written:
        mapped = [(pdo.index, n, entry.mapping) for n, entry in enumerate(pdo.entries, 1)]
        values += [(pdo.index, 0, 0), *mapped, (pdo.index, 0, len(mapped))]
    values += [(assignment, 1, pdo.index), (assignment, 0, 1)]
    for index, subindex, value in values:
        sdo.write(index, subindex, value, 1 if not subindex else 2 if index == assignment else 4)
    count = len(pdo.entries)
    entries = [(pdo.index, n, entry.mapping) for n, entry in enumerate(pdo.entries, 1)]
    for index, subindex, value in [(assignment, 0, 1), (assignment, 1, pdo.index), (pdo.index, 0, count), *entries]:
        expect(sdo.describe(index, subindex), sdo.read(index, subindex), value)
