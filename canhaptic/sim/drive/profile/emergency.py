"""Emergencies (EMCY; CiA 301, 7.2.7) of a simulated drive, with its error register and history."""

from collections.abc import Callable
from typing import Final

from canhaptic.canopen import objects
from canhaptic.canopen.objects import DataType
from canhaptic.sim.drive.profile.object_store import Entry, ObjectStore, refuse_unless

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
    """Keeps the present errors; sends one EMCY when an error appears, and EMCY 0x0000 when errors disappear.

    Args:
        store: Object store (0x1001, 0x1003, 0x603F are used).
        send: Called with the content of an EMCY.
    """

    def __init__(self, store: ObjectStore, send: Callable[[bytes], None]) -> None:
        self._register = store.optional(objects.ERROR_REGISTER, DataType.UNSIGNED8)
        self._error_code = store.optional(objects.ERROR_CODE, DataType.UNSIGNED16)
        self._send = send
        self._count = store.find(_ERROR_HISTORY) or Entry(_ERROR_HISTORY, 0, DataType.UNSIGNED8)
        self._history: list[Entry] = []
        while (field := store.find(_ERROR_HISTORY, len(self._history) + 1)) is not None:
            self._history.append(field)
        self._count.check, self._count.changed = refuse_unless(lambda value: value == 0), self._clear_history
        self.reset()

    def reset(self) -> None:
        """Clear the present errors without an EMCY."""
        self._present: list[int] = []
        self.show()

    def show(self) -> None:
        """Write the present errors to the error objects and clear the history."""
        self._show_present()
        self._clear_history()

    def announce(self, code: int) -> None:
        """Record an error and send its EMCY, unless it is present already."""
        if code not in self._present:
            self._present.append(code)
            for field, value in zip(self._history, [code, *(field.value for field in self._history)], strict=False):
                field.value = value
            self._count.value = min(self._count.number + 1, len(self._history))
            self._transmit(code)

    def withdraw(self, *codes: int) -> None:
        """Remove errors (all when none is named) and send EMCY 0x0000 if one was present."""
        remaining = [code for code in self._present if codes and code not in codes]
        if len(remaining) < len(self._present):
            self._present = remaining
            self._transmit(0)

    def _show_present(self) -> None:
        self._error_code.value = self._present[-1] if self._present else 0
        register = 0
        for code in self._present:
            register |= 1 | _REGISTER_BITS.get(code >> 12, 0)
        self._register.value = register

    def _transmit(self, code: int) -> None:
        """Update the error objects and send an EMCY: the code of a new error, or 0 when errors disappeared."""
        self._show_present()
        self._send(bytes((code & 0xFF, code >> 8, self._register.number)) + bytes(5))

    def _clear_history(self) -> None:
        for field in self._history:
            field.value = None
        self._count.value = 0
