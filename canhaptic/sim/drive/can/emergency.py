"""EMCY of the simulated drive (CiA 301, 7.2.7): error register, history, and the frames."""

from collections.abc import Callable
from typing import Final

from canhaptic.canopen.objects import (
    COB_ID_INVALID,
    EMCY_BASE,
    EMCY_COB_ID,
    ERROR_CODE,
    ERROR_REGISTER,
    DataType,
    SdoAbort,
)
from canhaptic.sim.drive.profile.object_store import Entry, ObjectStore

_ERROR_HISTORY: Final = 0x1003

HEARTBEAT_LOST: Final = 0x8130
PDO_TOO_SHORT: Final = 0x8210
SYNC_LENGTH: Final = 0x8240
RPDO_TIMEOUT: Final = 0x8250
COMMUNICATION: Final = 0x8100
SYNC_LOST: Final = 0x8700

# Bit of the error register (0x1001) by the leading digits of the error code; bit 0 (generic) is always set.
_REGISTER_BITS: Final = {0x2: 1 << 1, 0x3: 1 << 2, 0x4: 1 << 3, 0x8: 1 << 4, 0xF: 1 << 7}


class EmergencyProducer:
    """Present errors: one EMCY when an error comes, and EMCY 0x0000 when errors go.

    Args:
        store: Object store (0x1001, 0x1003, 0x1014, 0x603F are used).
        node_id: Node ID of the drive.
        send: Called with COB-ID and content of a frame.
    """

    def __init__(self, store: ObjectStore, node_id: int, send: Callable[[int, bytes], None]) -> None:
        self._register = store.optional(ERROR_REGISTER, DataType.UNSIGNED8)
        self._error_code = store.optional(ERROR_CODE, DataType.UNSIGNED16)
        self._cob_id = store.optional(EMCY_COB_ID, DataType.UNSIGNED32)
        self._default_cob_id = EMCY_BASE + node_id
        self._send = send
        self._count = store.find(_ERROR_HISTORY)
        self._history: list[Entry] = []
        while (field := store.find(_ERROR_HISTORY, len(self._history) + 1)) is not None:
            self._history.append(field)
        if self._count is not None:
            self._count.check = _only_zero
            self._count.changed = self._clear_history
        self.reset()

    def reset(self) -> None:
        """Clear the present errors, silently."""
        self._present: list[int] = []
        self.show()

    def show(self) -> None:
        """Show the present errors in the objects; the history starts empty."""
        self._error_code.value = self._present[-1] if self._present else 0
        self._update_register()
        self._clear_history()

    def announce(self, code: int) -> None:
        """Enter an error and send its EMCY, unless it is present already."""
        if code in self._present:
            return
        self._present.append(code)
        self._error_code.value = code
        self._update_register()
        self._remember(code)
        self._transmit(code)

    def withdraw(self, *codes: int) -> None:
        """Remove errors (all when none is named) and send EMCY 0x0000 if one was present."""
        remaining = [code for code in self._present if codes and code not in codes]
        if len(remaining) == len(self._present):
            return
        self._present = remaining
        self._error_code.value = remaining[-1] if remaining else 0
        self._update_register()
        self._transmit(0)

    def _update_register(self) -> None:
        register = 0
        for code in self._present:
            register |= 1 | _REGISTER_BITS.get(code >> 12, 0)
        self._register.value = register

    def _transmit(self, code: int) -> None:
        cob_id = self._cob_id.number or self._default_cob_id
        if not cob_id & COB_ID_INVALID:
            self._send(cob_id & 0x7FF, bytes((code & 0xFF, code >> 8, self._register.number)) + bytes(5))

    def _remember(self, code: int) -> None:
        for newer, older in zip(reversed(self._history[:-1]), reversed(self._history[1:]), strict=True):
            older.value = newer.value
        if self._history:
            self._history[0].value = code
        if self._count is not None:
            self._count.value = min(self._count.number + 1, len(self._history))

    def _clear_history(self) -> None:
        for field in self._history:
            field.value = None
        if self._count is not None:
            self._count.value = 0


def _only_zero(value: int) -> SdoAbort | None:
    return None if value == 0 else SdoAbort.VALUE_RANGE
