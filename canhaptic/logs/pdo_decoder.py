"""The PDO maps of a node, learnt from the SDO traffic that writes or reads them, and the text of its PDOs."""

from collections.abc import Iterator, Mapping
from typing import Any, Final, NamedTuple

from canhaptic.canopen import objects as od
from canhaptic.logs.sdo_decoder import Access

_SIGNED: Final = frozenset(
    {
        od.POSITION_ACTUAL,
        od.VELOCITY_ACTUAL,
        od.TARGET_TORQUE,
        od.TARGET_VELOCITY,
        od.TARGET_POSITION,
        od.TORQUE_DEMAND,
        od.TORQUE_ACTUAL,
        od.CURRENT_ACTUAL,
        od.MODES_OF_OPERATION,
        od.MODES_OF_OPERATION_DISPLAY,
    }
)


class PdoField(NamedTuple):
    """One mapped object and its value in one frame."""

    object_index: int
    subindex: int
    bits: int
    raw: int


class PdoMaps:
    """Known PDOs of one node.

    Args:
        node_id: 1..127.
        dictionary: Its object dictionary, whose defaults hold until the log shows other values; None if unknown.
    """

    def __init__(self, node_id: int, dictionary: Mapping[int, Any] | None) -> None:
        self._node_id = node_id
        self._cob_ids: dict[int, int] = {}  # communication index -> COB-ID with its flags
        self._entries: dict[int, dict[int, int]] = {}  # mapping index -> subindex -> entry
        for index in dictionary or {}:
            if _is_communication(index) or _is_mapping(index):
                self._take_defaults(index, (dictionary or {})[index])

    def _take_defaults(self, index: int, record: Any) -> None:
        for subindex, variable in getattr(record, "subindices", {}).items():
            value = variable.value if getattr(variable, "value", None) is not None else variable.default
            if isinstance(value, int):
                self._set(index, subindex, value)

    def learn(self, access: Access) -> bool:
        """Take a confirmed SDO; return whether it configures a PDO."""
        if not (_is_communication(access.object_index) or _is_mapping(access.object_index)):
            return False
        self._set(access.object_index, access.subindex, int.from_bytes(access.value, "little"))
        return True

    def _set(self, index: int, subindex: int, value: int) -> None:
        if _is_mapping(index):
            self._entries.setdefault(index, {})[subindex] = value
        elif subindex == 1:
            self._cob_ids[index] = value

    def cob_ids(self) -> Iterator[tuple[int, str, int]]:
        """Yield (COB-ID, name such as `TPDO1`, mapping index) of every PDO that exists."""
        named = set()
        for index, cob_id in self._cob_ids.items():
            named.add(index)
            if not cob_id & od.COB_ID_INVALID:
                yield cob_id & 0x1FFFFFFF, _name(index), index + 0x200
        for bases, first in ((od.RPDO_BASE, od.RPDO_COMMUNICATION), (od.TPDO_BASE, od.TPDO_COMMUNICATION)):
            for number, base in enumerate(bases):
                if first + number not in named:
                    yield base + self._node_id, _name(first + number), first + number + 0x200

    def tpdos(self) -> dict[int, int]:
        """Return COB-ID -> mapping index of every PDO that the node sends."""
        return {cob_id: mapping for cob_id, _, mapping in self.cob_ids() if mapping >= od.TPDO_MAPPING}

    def fields(self, mapping_index: int, data: bytes) -> list[PdoField] | str:
        """Fields of a frame, or a text why it cannot be decoded."""
        entries = self._entries.get(mapping_index, {})
        count = entries.get(0, 0)
        mapped = [entries.get(number, 0) for number in range(1, min(count, len(entries)) + 1)]
        if not count or len(mapped) != count or not all(entry & 0xFF for entry in mapped):
            return f"{data.hex(' ')} (map not known)"
        needed = sum(entry & 0xFF for entry in mapped)
        if needed != 8 * len(data):
            return f"malformed: {len(data)} bytes, the map has {needed} bits"
        image, fields = int.from_bytes(data, "little"), []
        for entry in mapped:
            index, subindex, bits = entry >> 16, entry >> 8 & 0xFF, entry & 0xFF
            raw = image & ((1 << bits) - 1)
            fields.append(PdoField(index, subindex, bits, with_sign(index, raw, bits)))
            image >>= bits
        return fields


def with_sign(index: int, raw: int, bits: int) -> int:
    """Value of an object of `length` bits: negative where its type has a sign and it is set."""
    return raw - (1 << bits) if index in _SIGNED and raw >> (bits - 1) else raw


def _is_communication(index: int) -> bool:
    return any(0 <= index - first < od.PDO_COUNT for first in (od.RPDO_COMMUNICATION, od.TPDO_COMMUNICATION))


def _is_mapping(index: int) -> bool:
    return any(0 <= index - first < od.PDO_COUNT for first in (od.RPDO_MAPPING, od.TPDO_MAPPING))


def _name(communication_index: int) -> str:
    if communication_index >= od.TPDO_COMMUNICATION:
        return f"TPDO{communication_index - od.TPDO_COMMUNICATION + 1}"
    return f"RPDO{communication_index - od.RPDO_COMMUNICATION + 1}"
