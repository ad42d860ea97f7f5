"""Text for every frame of a CANopen bus: NMT, SYNC, EMCY, SDO with object names, PDO fields, heartbeats.

The PDO maps are learnt from the bring-up in the log itself, so no configuration is needed; with one, objects get the
names of the drive's dictionary and positions and torques their units. It shares no code with the master's codecs, so
that it can judge them.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

from canhaptic.axis_units import effort_unit
from canhaptic.canopen import objects as od
from canhaptic.canopen.code_texts import NMT_COMMAND_TEXTS, NMT_STATE_TEXTS, controlword_text, emcy_text
from canhaptic.logs.pdo_decoder import PdoField, PdoMaps, with_sign
from canhaptic.logs.sdo_decoder import SdoDecoder
from canhaptic.logs.statusword import state_text

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
    """Description of one node that the log does not contain."""

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
