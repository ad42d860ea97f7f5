"""A force sensor with its own CAN node: the frame with which it answers a SYNC, and the position of its value there.

A CiA 404 transducer sends its process value (0x6130, 0x7130 or 0x9130) in TPDO 1, at 0x180 + its node ID. Any other
sensor that answers the SYNC with one frame is described in the same way.
"""

import struct
from typing import Annotated, Final, Literal

from pydantic import model_validator

from canhaptic.canopen.objects import TPDO_BASE
from canhaptic.units import Parameters, quantity

_LONGEST: Final = 8  # bytes of a frame
_REAL: Final = 32  # bits of a REAL32
_ORDERS: Final = {"little": "<", "big": ">"}


class ForceNode(Parameters):
    """The frame of a force sensor with its own CAN node."""

    node_id: Annotated[int, quantity("1", ge=1, le=127)] | None = None
    """Node ID of a CANopen node, which the start sets operational; None: it sends by itself."""
    cob_id: Annotated[int, quantity("1", ge=1, le=0x7FF)] | None = None
    """Identifier of its frame; None: 0x180 + node_id."""
    first_byte: Annotated[int, quantity("1", ge=0, le=7)] = 0
    """First byte of the value in the frame, from 0."""
    bits: Literal[8, 16, 24, 32] = 32
    """Bits of the value."""
    real: bool = False
    """Whether the value is a REAL32, usual of CiA 404, and no integer; `per_count` is then the force of 1."""
    signed: bool = True
    """Whether its highest bit is the sign."""
    order: Literal["little", "big"] = "little"
    """Order of its bytes: little as in CANopen."""
    length: Annotated[int, quantity("1", ge=1, le=_LONGEST)] | None = None
    """Bytes of the frame; None: up to the end of the value."""

    device_type: Annotated[int, quantity("1", ge=1, le=0xFFFF)] | None = None
    """Low word of its 0x1000: 404 for a transducer, 401 for an analogue input; None: any but a drive's."""
    tare: bool | Literal["autozero"] = False
    """Whether the start writes "tara" to 0x6139:01 (CiA 404), or `autozero`: "zero" to 0x6125:01; no hand may touch the
    handle then; not of an impulse."""

    @model_validator(mode="after")
    def _has_a_place(self) -> "ForceNode":
        if self.node_id is None and self.cob_id is None:
            raise ValueError("got neither node_id nor cob_id, expected one of them")
        if self.end > (self.length or _LONGEST):
            raise ValueError(f"the value ends at byte {self.end}, expected at most {self.length or _LONGEST}")
        if self.real and (self.bits, self.signed) != (_REAL, True):
            raise ValueError(f"real: got true with {self.bits} bits, expected bits: {_REAL} and signed: true")
        if self.tare and self.node_id is None:
            raise ValueError("tare: got true without node_id, expected the node ID of a transducer that takes SDO")
        return self

    def value_in(self, data: bytes | bytearray) -> float:
        """Return the value in a frame of the right length."""
        part = data[self.first_byte : self.end]
        if self.real:
            return float(struct.unpack(_ORDERS[self.order] + "f", part)[0])
        return int.from_bytes(part, self.order, signed=self.signed)

    def frame_of(self, value: float) -> bytes:
        """Return the frame with a value; an integer is rounded, modulo its bits."""
        if self.real:
            part = struct.pack(_ORDERS[self.order] + "f", value)
        else:
            part = (round(value) % (1 << self.bits)).to_bytes(self.bits // 8, self.order)
        return bytes(self.first_byte) + part + bytes(self.frame_length - self.end)

    @property
    def end(self) -> int:
        """First byte after the value."""
        return self.first_byte + self.bits // 8

    @property
    def frame_id(self) -> int:
        """COB-ID of the sensor's frame."""
        return self.cob_id or TPDO_BASE[0] + (self.node_id or 0)

    @property
    def frame_length(self) -> int:
        """Length of the sensor's frame [bytes]."""
        return self.length or self.end
