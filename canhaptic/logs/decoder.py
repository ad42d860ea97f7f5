"""Text for every frame of a CANopen bus: NMT, SYNC, EMCY, SDO with object names, PDO fields, heartbeats.

The PDO maps are learnt from the bring-up in the log itself, so no configuration is needed. With one, objects get the
names of the drive's dictionary and positions and torques their units. It shares no code with the master's codecs, so
that it can check them.

The power state in a statusword (0x6041), decoded bit by bit in the words of IEC 61800-7-201, 6.3.

Independent of the table of the master (`canhaptic.drive.profile.power_states`): the reader of a log must not share a
mistake with the writer of its frames.

Text for SDO frames, and the objects that they carry; follows one transfer per node (CiA 301, 7.2.4).

The PDO maps of a node, learnt from the SDO traffic that writes or reads them, and the text of its PDOs.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

from canhaptic.axis_units import effort_unit
from canhaptic.canopen import objects as od
from canhaptic.canopen.code_texts import NMT_COMMAND_TEXTS, NMT_STATE_TEXTS, controlword_text, emcy_text, sdo_abort_text
from canhaptic.canopen.objects import StatusBit

ENABLED: Final = "OPERATION ENABLED"
_UNKNOWN: Final = "UNKNOWN"
_STEPS: Final = {
    StatusBit(0): "",
    StatusBit.READY_TO_SWITCH_ON: "READY TO SWITCH ON",
    StatusBit.READY_TO_SWITCH_ON | StatusBit.SWITCHED_ON: "SWITCHED ON",
    StatusBit.READY_TO_SWITCH_ON | StatusBit.SWITCHED_ON | StatusBit.OPERATION_ENABLED: ENABLED,
}
_LADDER: Final = StatusBit.READY_TO_SWITCH_ON | StatusBit.SWITCHED_ON | StatusBit.OPERATION_ENABLED


def state_text(statusword: int) -> str:
    """Return the name of the state in the words of the standard; "UNKNOWN" where no state has these bits."""
    bits = StatusBit(statusword & 0xFF)
    step = _STEPS.get(bits & _LADDER)
    if step is None:
        return _UNKNOWN
    if StatusBit.SWITCH_ON_DISABLED in bits:
        return "SWITCH ON DISABLED" if not step and StatusBit.FAULT not in bits else _UNKNOWN
    if StatusBit.FAULT in bits:
        return {"": "FAULT", ENABLED: "FAULT REACTION ACTIVE"}.get(step, _UNKNOWN)
    if not step:
        return "NOT READY TO SWITCH ON"
    if StatusBit.QUICK_STOP in bits:  # inverted in the standard: set where no quick stop is under way
        return step
    return "QUICK STOP ACTIVE" if step == ENABLED else _UNKNOWN


_ABORT: Final = 0x80
_FRAME: Final = 8  # [bytes] of every SDO frame


class Access(NamedTuple):
    """An object whose value a confirmed SDO has shown."""

    object_index: int
    subindex: int
    value: bytes


class SdoDecoder:
    """The SDO traffic of one node.

    Args:
        name_of: Function that returns the text for (index, subindex).
        value_of: Function that returns the text for the value of (index, subindex, bytes).
    """

    def __init__(
        self, name_of: Callable[[int, int], str], value_of: Callable[[int, int, bytes], str] | None = None
    ) -> None:
        self._name_of = name_of
        self._value_of = value_of or _plain_value
        self._object = (0, 0)
        self._written = b""

    def request(self, data: bytes) -> str:
        """Text for a frame from client to server (0x600 + node)."""
        if len(data) != _FRAME:
            return f"malformed: {len(data)} bytes instead of {_FRAME}"
        if data[0] == _ABORT:
            return self._abort("client", data)
        specifier = data[0] >> 5
        if specifier == 1:
            return self._write(data)
        if specifier == 2:
            self._object = _object(data)
        segment_texts = {
            0: f"write segment of {self._name()}: {_segment(data)}",
            2: f"read {self._name()}",
            3: f"read next segment of {self._name()}",
            5: f"block upload: {data.hex(' ')}",
            6: f"block download: {data.hex(' ')}",
        }
        return segment_texts.get(specifier, f"unknown command 0x{data[0]:02X}")

    def response(self, data: bytes) -> tuple[str, Access | None]:
        """Text for a frame from server to client (0x580 + node), and the object it confirms, if any."""
        if len(data) != _FRAME:
            return f"malformed: {len(data)} bytes instead of {_FRAME}", None
        if data[0] == _ABORT:
            return self._abort("server", data), None
        specifier = data[0] >> 5
        if specifier == 3:
            return self._confirm(data)
        if specifier == 2:
            return self._value(data)
        segment_texts = {
            0: f"segment of {self._name()}: {_segment(data)}",
            1: f"segment of {self._name()} taken",
        }
        return segment_texts.get(specifier, f"block transfer: {data.hex(' ')}"), None

    def _write(self, data: bytes) -> str:
        self._object = _object(data)
        if not data[0] & 0x02:
            self._written = b""
            size = f", {int.from_bytes(data[4:], 'little')} bytes" if data[0] & 0x01 else ""
            return f"write {self._name()} in segments{size}"
        self._written = _expedited(data)
        return f"write {self._name()} = {self._value_of(*self._object, self._written)}"

    def _confirm(self, data: bytes) -> tuple[str, Access | None]:
        matches = _object(data) == self._object
        self._object = _object(data)
        access = Access(*self._object, self._written) if matches and self._written else None
        self._written = b""
        return f"written {self._name()}", access

    def _value(self, data: bytes) -> tuple[str, Access | None]:
        self._object = _object(data)
        if not data[0] & 0x02:
            size = f", {int.from_bytes(data[4:], 'little')} bytes" if data[0] & 0x01 else ""
            return f"{self._name()} follows in segments{size}", None
        value = _expedited(data)
        return f"{self._name()} = {self._value_of(*self._object, value)}", Access(*self._object, value)

    def _abort(self, side: str, data: bytes) -> str:
        self._object = _object(data)
        self._written = b""
        code = int.from_bytes(data[4:8], "little")
        return f"abort by {side} of {self._name()}: 0x{code:08X} {sdo_abort_text(code)}"

    def _name(self) -> str:
        return self._name_of(*self._object)


def _object(data: bytes) -> tuple[int, int]:
    return int.from_bytes(data[1:3], "little"), data[3]


def _expedited(data: bytes) -> bytes:
    """The value of an expedited transfer; all four bytes when its size is not indicated (0x22, 0x42)."""
    return data[4 : 8 - (data[0] >> 2 & 0x03)]


def _segment(data: bytes) -> str:
    last = ", last" if data[0] & 0x01 else ""
    return f"{data[1 : 8 - (data[0] >> 1 & 0x07)].hex(' ')}{last}"


def _plain_value(index: int, subindex: int, value: bytes) -> str:
    del index, subindex
    return f"0x{int.from_bytes(value, 'little'):0{2 * len(value)}X}"


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
        node_id: Node ID, 1..127.
        dictionary: Object dictionary, whose defaults apply until the log shows other values; None if unknown.
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
    """Description of one node, which the log does not contain."""

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
        if base in (od.EMCY_BASE, od.HEARTBEAT_BASE):
            name = self._node(node_id).name
            return _Decoded("EMCY", name, _emcy(data)) if base == od.EMCY_BASE else _heartbeat(name, data)
        if base in (od.SDO_REQUEST_BASE, od.SDO_RESPONSE_BASE):
            return self._sdo(self._node(node_id), data, is_request=base == od.SDO_REQUEST_BASE)
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

    def _sdo(self, node: "_Node", data: bytes, is_request: bool) -> _Decoded:
        if is_request:
            return _Decoded("SDO", node.name, node.sdo.request(data))
        text, access = node.sdo.response(data)
        if access is not None and node.maps.learn(access):
            self._collect_pdos()
        return _Decoded("SDO", node.name, text)

    def _pdo(self, can_id: int, node_id: int, data: bytes) -> _Decoded:
        if can_id not in self._pdos:
            self._node(node_id)
        if can_id not in self._pdos:
            return _Decoded("unknown", "", data.hex(" "))
        node, name, mapping = self._pdos[can_id]
        fields = node.maps.fields(mapping, data)
        text = fields if isinstance(fields, str) else ", ".join(node.field(field) for field in fields)
        return _Decoded(name, node.name, text)


class _Node:
    """State of one node, learnt from the frames."""

    def __init__(self, description: NodeDescription) -> None:
        self._description = description
        self.name = description.name or f"node {description.node_id}"
        self.maps = PdoMaps(description.node_id, description.dictionary)
        self.sdo = SdoDecoder(self.object_name, self._value)

    def object_name(self, index: int, subindex: int) -> str:
        """Return `0x6040 Controlword`, with the words of the dictionary where there is one."""
        number = f"0x{index:04X}" + (f".{subindex}" if subindex else "")
        entry = (self._description.dictionary or {}).get(index)
        if entry is None:
            return f"{number} {_NAMES.get(index, '')}".rstrip()
        member = getattr(entry, "subindices", {}).get(subindex)
        return f"{number} {entry.name}" + (f" / {member.name}" if member is not None else "")

    def _value(self, index: int, subindex: int, value: bytes) -> str:
        raw, bits = int.from_bytes(value, "little"), 8 * len(value)
        words = self._meaning(PdoField(index, subindex, bits, with_sign(index, raw, bits)))
        plain = f"0x{raw:0{2 * len(value)}X}"
        return f"{plain} ({words})" if words else plain

    def field(self, field: PdoField) -> str:
        """One field of a PDO as text."""
        name = (
            _TORQUES.get(field.object_index)
            or _NAMES.get(field.object_index)
            or self.object_name(field.object_index, field.subindex)
        )
        if field.object_index in (od.STATUSWORD, od.CONTROLWORD):
            return f"{name} 0x{field.raw:04X} {self._meaning(field)}"
        words = self._meaning(field)
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


def _heartbeat(name: str, data: bytes) -> _Decoded:
    if len(data) != 1:
        return _Decoded("heartbeat", name, f"malformed: {len(data)} bytes instead of 1")
    return _Decoded("heartbeat", name, NMT_STATE_TEXTS.get(data[0] & 0x7F, f"unknown state 0x{data[0]:02X}"))
