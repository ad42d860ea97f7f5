"""A force sensor with a node of its own: the frame with which it answers a SYNC, and the place of its value.

A CiA 404 transducer sends its process value (0x6130, 0x7130 or 0x9130) in TPDO 1, at 0x180 + its node ID. Any other
sensor that answers the SYNC with one frame is described in the same way.
"""

from typing import Annotated, Final, Literal

from pydantic import model_validator

from canhaptic.canopen.objects import TPDO_BASE
from canhaptic.units import Parameters, quantity

_LONGEST: Final = 8  # bytes of a frame


class ForceNode(Parameters):
    """The frame of a force sensor with a node of its own."""

    node_id: Annotated[int, quantity("1", ge=1, le=127)] | None = None
    """Node ID of a CANopen node, which the start sets operational; None: it sends by itself."""
    cob_id: Annotated[int, quantity("1", ge=1, le=0x7FF)] | None = None
    """Identifier of its frame; None: 0x180 + node_id."""
    first_byte: Annotated[int, quantity("1", ge=0, le=7)] = 0
    """First byte of the value in the frame, from 0."""
    bits: Literal[8, 16, 24, 32] = 32
    """Bits of the value, an integer."""
    signed: bool = True
    """Whether its highest bit is the sign."""
    order: Literal["little", "big"] = "little"
    """Order of its bytes: little as in CANopen."""
    length: Annotated[int, quantity("1", ge=1, le=_LONGEST)] | None = None
    """Bytes of the frame; None: up to the end of the value."""

    tare: bool = False
    """Whether the start writes "tara" to 0x6139:01 (CiA 404): no hand may touch the handle then; not of an impulse."""

    @model_validator(mode="after")
    def _has_a_place(self) -> "ForceNode":
        if self.node_id is None and self.cob_id is None:
            raise ValueError("got neither node_id nor cob_id, expected one of them")
        if self.end > (self.length or _LONGEST):
            raise ValueError(f"the value ends at byte {self.end}, expected at most {self.length or _LONGEST}")
        if self.tare and self.node_id is None:
            raise ValueError("tare: got true without node_id, expected the node ID of a transducer that takes SDO")
        return self

    @property
    def end(self) -> int:
        """Byte behind the value."""
        return self.first_byte + self.bits // 8

    @property
    def frame_id(self) -> int:
        """COB-ID of its frame."""
        return self.cob_id or TPDO_BASE[0] + (self.node_id or 0)

    @property
    def frame_length(self) -> int:
        """Bytes of its frame."""
        return self.length or self.end
