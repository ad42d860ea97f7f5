"""Text for every frame of a CANopen bus: NMT, SYNC, EMCY, SDO with object names, PDO fields, heartbeats.

The PDO maps are learnt from the SDO traffic of the bring-up in the log (CiA 301, 7.2.4), without any configuration.
A configuration adds the names in the drive's dictionary, and units of positions and torques. Power states follow the
table of IEC 61800-7-201, 6.3. Codecs and tables of the master are not used, so that a mistake in them is found.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, Final, NamedTuple

from canhaptic.axis_units import effort_unit
from canhaptic.canopen import objects as od
from canhaptic.canopen.code_texts import NMT_COMMAND_TEXTS, NMT_STATE_TEXTS, controlword_text, emcy_text, sdo_abort_text

ENABLED: Final = "OPERATION ENABLED"
_STATES: Final = {  # bits 7 to 0 of the statusword, as the standard prints them; the quick stop's bit 5 is inverted
    "x0xx0000": "NOT READY TO SWITCH ON",
    "x1xx0000": "SWITCH ON DISABLED",
    "x01x0001": "READY TO SWITCH ON",
    "x01x0011": "SWITCHED ON",
    "x01x0111": ENABLED,
    "x00x0111": "QUICK STOP ACTIVE",
    "x0xx1111": "FAULT REACTION ACTIVE",
    "x0xx1000": "FAULT",
}


@cache
def state_text(statusword: int) -> str:
    """Return the name of the state in the words of the standard; "UNKNOWN" where no state has these bits."""
    bits = f"{statusword & 0xFF:08b}"
    fits = (name for pattern, name in _STATES.items() if all(a in ("x", b) for a, b in zip(pattern, bits, strict=True)))
    return next(fits, "UNKNOWN")


_ABORT: Final = 0x80
_FRAME: Final = 8  # [bytes] of every SDO frame
_OTHER_SDO: Final = {  # by direction and command specifier; further ones below
    True: {
        0: "write segment of {name}: {segment}",
        2: "read {name}",
        3: "read next segment of {name}",
        5: "block upload: {raw}",
        6: "block download: {raw}",
    },
    False: {0: "segment of {name}: {segment}", 1: "segment of {name} taken"},
}
_FURTHER_SDO: Final = {True: "unknown command 0x{command:02X}", False: "block transfer: {raw}"}


class Access(NamedTuple):
    """Object and value of a confirmed SDO transfer."""

    object_index: int
    subindex: int
    value: bytes


class SdoDecoder:
    """Decoder of the SDO traffic of one node, one transfer at a time."""

    def __init__(self) -> None:
        self._object = (0, 0)
        self._written = b""

    def object_name(self, index: int, subindex: int) -> str:
        """Return the text for an object: its number, `0x1018.1`."""
        return f"0x{index:04X}" + (f".{subindex}" if subindex else "")

    def value_text(self, _index: int, _subindex: int, value: bytes) -> str:
        """Return the text for the value of an object."""
        return f"0x{int.from_bytes(value, 'little'):0{2 * len(value)}X}"

    def sdo(self, data: bytes, *, is_request: bool) -> tuple[str, Access | None]:
        """Return the text for a frame, and the object whose value it confirms, if any.

        Args:
            data: Content of the frame.
            is_request: Whether the client sent it (0x600 + node), not the server (0x580 + node).
        """
        if len(data) != _FRAME:
            return f"malformed: {len(data)} bytes instead of {_FRAME}", None
        command, specifier, before = data[0], data[0] >> 5, self._object
        if command == _ABORT or specifier in ((1, 2) if is_request else (2, 3)):
            self._object = int.from_bytes(data[1:3], "little"), data[3]
        name, number = self.object_name(*self._object), int.from_bytes(data[4:], "little")
        if command == _ABORT:
            self._written = b""
            side = "client" if is_request else "server"
            return f"abort by {side} of {name}: 0x{number:08X} {sdo_abort_text(number)}", None
        if specifier == (1 if is_request else 2):
            return self._with_value(data, name, is_request=is_request)
        if specifier == 3 and not is_request:
            value, self._written = self._written if self._object == before else b"", b""
            return f"written {name}", Access(*self._object, value) if value else None
        text = _OTHER_SDO[is_request].get(specifier, _FURTHER_SDO[is_request])
        segment = data[1 : 8 - (command >> 1 & 0x07)].hex(" ") + (", last" if command & 0x01 else "")
        return text.format(name=name, segment=segment, raw=data.hex(" "), command=command), None

    def _with_value(self, data: bytes, name: str, *, is_request: bool) -> tuple[str, Access | None]:
        """Return the text for the first frame of a transfer; with its value if expedited (4 bytes without a size)."""
        value = data[4 : 8 - (data[0] >> 2 & 0x03)] if data[0] & 0x02 else b""
        if is_request:
            self._written = value
        if not value:
            size = f", {int.from_bytes(data[4:], 'little')} bytes" if data[0] & 0x01 else ""
            return (f"write {name} in segments{size}" if is_request else f"{name} follows in segments{size}"), None
        text = f"{name} = {self.value_text(*self._object, value)}"
        return (f"write {text}", None) if is_request else (text, Access(*self._object, value))


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


_PDOS: Final = {
    first + number: f"{kind}{number + 1}"
    for kind, first in (("RPDO", od.RPDO_COMMUNICATION), ("TPDO", od.TPDO_COMMUNICATION))
    for number in range(od.PDO_COUNT)
}
"""Index of the communication parameters of a PDO -> its name."""
_TO_MAPPING: Final = od.TPDO_MAPPING - od.TPDO_COMMUNICATION


def _is_pdo(index: int) -> bool:
    return index in _PDOS or index - _TO_MAPPING in _PDOS


class PdoMaps:
    """PDO maps of one node, as far as they are known.

    Args:
        node_id: Node ID, 1..127.
        dictionary: Object dictionary, whose defaults apply until the log shows other values; None if unknown.
    """

    def __init__(self, node_id: int, dictionary: Mapping[int, Any] | None) -> None:
        bases = ((od.RPDO_BASE, od.RPDO_COMMUNICATION), (od.TPDO_BASE, od.TPDO_COMMUNICATION))
        self._predefined = {first + n: base + node_id for each, first in bases for n, base in enumerate(each)}
        self._cob_ids: dict[int, int] = {}  # communication index -> COB-ID with its flags
        self._entries: dict[int, dict[int, int]] = {}  # mapping index -> subindex -> entry
        known = dictionary or {}
        for index in filter(_is_pdo, known):
            for subindex, variable in getattr(known[index], "subindices", {}).items():
                value = variable.value if getattr(variable, "value", None) is not None else variable.default
                if isinstance(value, int):
                    self._set(index, subindex, value)

    def learn(self, access: Access) -> bool:
        """Update the maps from the object of a confirmed SDO transfer; return whether that object configures a PDO."""
        self._set(access.object_index, access.subindex, int.from_bytes(access.value, "little"))
        return _is_pdo(access.object_index)

    def _set(self, index: int, subindex: int, value: int) -> None:
        if index - _TO_MAPPING in _PDOS:
            self._entries.setdefault(index, {})[subindex] = value
        elif index in _PDOS and subindex == 1:
            self._cob_ids[index] = value

    def cob_ids(self) -> Iterator[tuple[int, str, int]]:
        """Yield (COB-ID, name such as `TPDO1`, mapping index) of every PDO that exists."""
        unnamed = {index: cob_id for index, cob_id in self._predefined.items() if index not in self._cob_ids}
        for index, cob_id in (self._cob_ids | unnamed).items():
            if not cob_id & od.COB_ID_INVALID:
                yield cob_id & 0x1FFFFFFF, _PDOS[index], index + _TO_MAPPING

    def tpdos(self) -> dict[int, int]:
        """Return COB-ID -> mapping index of every PDO that the node sends."""
        return {cob_id: mapping for cob_id, _, mapping in self.cob_ids() if mapping >= od.TPDO_MAPPING}

    def fields(self, mapping_index: int, data: bytes) -> list[PdoField] | str:
        """Return the fields of a frame, or a text that says why it cannot be decoded."""
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
    """Return the value of an object from its raw bits, read as two's complement if its type is signed."""
    return raw - (1 << bits) if index in _SIGNED and raw >> (bits - 1) else raw


_TORQUES: Final = {
    od.TARGET_TORQUE: "target torque",
    od.TORQUE_DEMAND: "torque demand",
    od.TORQUE_ACTUAL: "torque actual",
    od.MAX_TORQUE: "max torque",
}
_NAMES: Final = {  # for nodes without a dictionary
    value: name.lower().replace("_", " ")
    for name, value in vars(od).items()
    if isinstance(value, int) and name.isupper() and 0x1000 <= value <= 0x6FFF
}
_EMCY_SIZE: Final = 8
_TIME_COB_ID: Final = 0x100


@dataclass(frozen=True, slots=True)
class NodeDescription:
    """Facts about a node that a log does not contain."""

    node_id: int
    name: str = ""
    dictionary: Mapping[int, Any] | None = None  # canopen.ObjectDictionary
    counts_per_unit: float | None = None
    unit: str = "rad"
    full_torque: float | None = None  # of the axis at 1000 counts [N*m or N]
    direction: int = 1  # of the axis over that of the drive
    bus: int = 0  # its place among several


class _Decoded(NamedTuple):
    """One frame as text."""

    kind: str  # "NMT", "SYNC", "EMCY", "SDO", "RPDO1", "TPDO1", "heartbeat", "unknown"
    node: str  # name or number; empty for the whole bus
    text: str


class BusDecoder:
    """Decodes the frames of one bus in the order in which they were recorded.

    Args:
        nodes: Descriptions of the nodes.
    """

    def __init__(self, nodes: Iterable[NodeDescription] = ()) -> None:
        self._described = {node.node_id: node for node in nodes}
        self._nodes: dict[int, _Node] = {}
        self._pdos: dict[int, tuple[_Node, str, int]] = {}
        for node_id in self._described:
            self._node(node_id)

    def decode(self, can_id: int, data: bytes) -> _Decoded:
        """Decode one frame as text."""
        if can_id == od.NMT_COB_ID:
            return self._nmt(data)
        if can_id in (od.SYNC_FRAME_COB_ID, _TIME_COB_ID):
            return _Decoded("SYNC" if can_id == od.SYNC_FRAME_COB_ID else "TIME", "", data.hex(" "))
        base, node_id = can_id & 0x780, can_id & 0x7F
        if can_id > 0x7FF or not node_id:
            return _Decoded("unknown", "", data.hex(" "))
        if base in _OF_NODES:
            kind, text = _OF_NODES[base]
            return _Decoded(kind, self._node(node_id).name, text(data))
        if base in (od.SDO_REQUEST_BASE, od.SDO_RESPONSE_BASE):
            node = self._node(node_id)
            words, access = node.sdo(data, is_request=base == od.SDO_REQUEST_BASE)
            if access is not None and node.maps.learn(access):
                self._collect_pdos()
            return _Decoded("SDO", node.name, words)
        return self._pdo(can_id, node_id, data)

    def _node(self, node_id: int) -> "_Node":
        if node_id not in self._nodes:
            self._nodes[node_id] = _Node(self._described.get(node_id, NodeDescription(node_id)))
            self._collect_pdos()
        return self._nodes[node_id]

    def _collect_pdos(self) -> None:
        self._pdos = {
            cob_id: (node, name, mapping)
            for node in self._nodes.values()
            for cob_id, name, mapping in node.maps.cob_ids()
        }

    def _nmt(self, data: bytes) -> _Decoded:
        if len(data) != 2:
            return _Decoded("NMT", "", f"malformed: {len(data)} bytes instead of 2")
        command = NMT_COMMAND_TEXTS.get(data[0], f"unknown command 0x{data[0]:02X}")
        return _Decoded("NMT", self._node(data[1]).name if data[1] else "all", command)

    def _pdo(self, can_id: int, node_id: int, data: bytes) -> _Decoded:
        if can_id not in self._pdos:
            self._node(node_id)
        if can_id not in self._pdos:
            return _Decoded("unknown", "", data.hex(" "))
        node, name, mapping = self._pdos[can_id]
        fields = node.maps.fields(mapping, data)
        text = fields if isinstance(fields, str) else ", ".join(node.field(field) for field in fields)
        return _Decoded(name, node.name, text)


class _Node(SdoDecoder):
    """State of one node, learnt from the frames."""

    def __init__(self, description: NodeDescription) -> None:
        super().__init__()
        self._description = description
        self.name = description.name or f"node {description.node_id}"
        self.maps = PdoMaps(description.node_id, description.dictionary)

    def object_name(self, index: int, subindex: int) -> str:
        """Return the text for an object, such as `0x6040 Controlword`; the name comes from the dictionary, if any."""
        number = super().object_name(index, subindex)
        entry = (self._description.dictionary or {}).get(index)
        if entry is None:
            return f"{number} {_NAMES.get(index, '')}".rstrip()
        member = getattr(entry, "subindices", {}).get(subindex)
        return f"{number} {entry.name}" + (f" / {member.name}" if member is not None else "")

    def value_text(self, index: int, subindex: int, value: bytes) -> str:
        """Return the text for the value of an object, with its meaning if known."""
        plain, bits = super().value_text(index, subindex, value), 8 * len(value)
        raw = with_sign(index, int.from_bytes(value, "little"), bits)
        words = self._meaning(PdoField(index, subindex, bits, raw))
        return f"{plain} ({words})" if words else plain

    def field(self, field: PdoField) -> str:
        """Return the text for a field of a PDO."""
        index, words = field.object_index, self._meaning(field)
        name = _TORQUES.get(index) or _NAMES.get(index) or self.object_name(index, field.subindex)
        if index in (od.STATUSWORD, od.CONTROLWORD):
            return f"{name} 0x{field.raw:04X} {words}"
        return f"{name} {field.raw}" + (f" ({words})" if words else "")

    def _meaning(self, field: PdoField) -> str:
        known = self._description
        if field.object_index == od.STATUSWORD:
            return state_text(field.raw)
        if field.object_index == od.CONTROLWORD:
            return controlword_text(field.raw)
        if field.object_index == od.POSITION_ACTUAL and known.counts_per_unit:
            return f"{field.raw * known.direction / known.counts_per_unit:.9g} {known.unit}"
        if field.object_index in _TORQUES and known.full_torque:
            counts = field.raw * (1 if field.object_index == od.MAX_TORQUE else known.direction)
            return f"{counts * known.full_torque / 1000.0:.6g} {effort_unit(known.unit)}"
        return ""


def _emcy(data: bytes) -> str:
    if len(data) < 3:
        return f"malformed: {len(data)} bytes instead of {_EMCY_SIZE}"
    code = int.from_bytes(data[:2], "little")
    short = "" if len(data) == _EMCY_SIZE else f" (short: {len(data)} bytes)"
    return f"0x{code:04X} {emcy_text(code)}, error register 0x{data[2]:02X}, vendor {data[3:].hex(' ') or '-'}{short}"


def _heartbeat(data: bytes) -> str:
    if len(data) != 1:
        return f"malformed: {len(data)} bytes instead of 1"
    return NMT_STATE_TEXTS.get(data[0] & 0x7F, f"unknown state 0x{data[0]:02X}")


_OF_NODES: Final = {od.EMCY_BASE: ("EMCY", _emcy), od.HEARTBEAT_BASE: ("heartbeat", _heartbeat)}
