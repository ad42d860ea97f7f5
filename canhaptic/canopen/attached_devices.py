"""Devices at an axis next to its drive: a holding brake, and a force sensor that is a CAN node of its own.

Of the brake: who operates it, and how long it takes. Of the sensor: the frame with which it answers a SYNC, and the
force in it. A CiA 404 transducer sends its process value (0x6130, 0x7130 or 0x9130) in TPDO 1, with COB-ID 0x180 + node
ID. Any other sensor that answers a SYNC with one frame can be described in the same way.
"""

import struct
from typing import Annotated, Final, Literal

from pydantic import model_validator

from canhaptic.canopen.objects import TPDO_BASE
from canhaptic.units import Parameters, quantity


class Brake(Parameters):
    """A holding brake, such as on a vertical axis."""

    by: Literal["drive", "host"] = "drive"
    """Who operates the brake: `drive`, which releases it when enabled and sets it when disabled, or `host`, through
    `output`."""
    output: Annotated[int, quantity("1", ge=0, le=31)] | None = None
    """Bit of the drive's digital outputs (0x60FE:01) that works the brake; only with `by: host`."""
    released: Literal[0, 1] | None = None
    """Value of that bit with the brake released; drives differ. None: 1. Bit 0, whose 1 sets the brake in CiA 402, is
    refused without it."""
    release_time: Annotated[float, quantity("s", ge=0.0, le=5.0)]
    """Longest time until the brake is released; the controller sends no torque before."""
    set_time: Annotated[float, quantity("s", ge=0.0, le=1.0)]
    """Longest time until the brake holds; a stop holds `holds_weight` for this long."""
    holds_weight: Annotated[float, quantity("N", "N*m")] = 0.0
    """Torque that keeps the axis where it hangs, with its sign; what a stop holds until the brake does. 0: a stop holds
    nothing, and an axis that hangs sinks for `set_time`."""

    @model_validator(mode="after")
    def _has_an_output(self) -> "Brake":
        if (self.by == "host") != (self.output is not None):
            raise ValueError(f"output: got {self.output} with by: {self.by}, expected a bit only for by: host")
        if self.released is None and self.output == 0:
            text = (
                "output: got bit 0 without `released`; in CiA 402 its 1 sets the brake (released: 0), but drives differ"
            )
            raise ValueError(f"{text}: say which value releases it")
        if self.released is not None and self.by == "drive":
            raise ValueError(f"released: got {self.released} with by: drive, expected it only for by: host")
        return self

    def outputs(self, before: int, *, is_open: bool) -> int:
        """Return 0x60FE:01 with which the brake opens, or is set; every other bit stays as it was before."""
        bit = 1 << (self.output or 0)
        return before | bit if is_open == (self.released != 0) else before & ~bit

    def holds_until_set(self, sample_time_ns: int) -> int:
        """Return the holds from its command until the brake holds, with two for the command itself."""
        return -(-round(self.set_time * 1e9) // sample_time_ns) + 2


_LONGEST: Final = 8  # bytes of a frame
_REAL: Final = 32  # bits of a REAL32
_ORDERS: Final = {"little": "<", "big": ">"}


class ForceNode(Parameters):
    """Frame of a force sensor that is a CAN node of its own."""

    node_id: Annotated[int, quantity("1", ge=1, le=127)] | None = None
    """Node ID of a CANopen sensor, which is set operational at the start; None: the sensor sends without it."""
    cob_id: Annotated[int, quantity("1", ge=1, le=0x7FF)] | None = None
    """Identifier of the sensor's frame; None: 0x180 + node_id."""
    first_byte: Annotated[int, quantity("1", ge=0, le=7)] = 0
    """First byte of the value in the frame, counted from 0."""
    bits: Literal[8, 16, 24, 32] = 32
    """Number of bits of the value."""
    real: bool = False
    """Whether the value is a REAL32, as usual in CiA 404, instead of an integer; `per_count` is then the force of a
    value of 1."""
    signed: bool = True
    """Whether an integer value is signed."""
    order: Literal["little", "big"] = "little"
    """Byte order of the value; CANopen has little."""
    length: Annotated[int, quantity("1", ge=1, le=_LONGEST)] | None = None
    """Length of the frame [bytes]; None: the value is the last in the frame."""

    device_type: Annotated[int, quantity("1", ge=1, le=0xFFFF)] | None = None
    """Expected low word of the sensor's device type (0x1000): 404 for a transducer, 401 for an analogue input; None:
    any but a drive's."""
    tare: bool | Literal["autozero"] = False
    """Whether the sensor is set to zero at the start, when no hand may touch the handle: true writes "tara" to
    0x6139:01 (CiA 404), `autozero` writes "zero" to 0x6125:01."""

    @model_validator(mode="after")
    def _has_a_place(self) -> "ForceNode":
        if self.node_id is None and self.cob_id is None:
            raise ValueError("got neither node_id nor cob_id, expected one of them")
        if self.end > (self.length or _LONGEST):
            raise ValueError(f"the value ends at byte {self.end}, expected at most {self.length or _LONGEST}")
        if self.real and (self.bits, self.signed) != (_REAL, True):
            raise ValueError(f"real: got true with {self.bits} bits, expected bits: {_REAL} and signed: true")
        if self.tare and self.node_id is None:
            raise ValueError("tare: got true without node_id, expected the node ID of a transducer that answers SDO")
        return self

    def value_in(self, data: bytes | bytearray) -> float:
        """Return the sensor's value from a frame of the right length."""
        part = data[self.first_byte : self.end]
        if self.real:
            return float(struct.unpack(_ORDERS[self.order] + "f", part)[0])
        return int.from_bytes(part, self.order, signed=self.signed)

    def frame_of(self, value: float) -> bytes:
        """Return the frame for a value; an integer is rounded and wraps at its number of bits."""
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
