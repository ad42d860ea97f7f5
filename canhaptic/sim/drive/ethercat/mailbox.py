"""The CoE mailbox of a simulated EtherCAT drive: SDO, SDO information and emergencies (ETG.1000.6, 5.6).

It maps a mail of the master to the mails that answer it. Complete access is refused, which the standard permits.
"""

import struct
from collections.abc import Callable
from typing import Final

from canhaptic.canopen.objects import DataType, Dictionary, SdoAbort
from canhaptic.sim.drive.profile.object_store import Entry, ObjectStore

_ERROR, _COE = 0, 3  # kinds of mail
_EMERGENCY, _REQUEST, _RESPONSE, _INFORMATION = 1, 2, 3, 8  # services of CoE
_HEADER: Final = struct.Struct("<HHBB")  # length, address, channel, kind and counter
_HEADER_BYTES: Final = 8  # with the two of CoE
_SDO: Final = struct.Struct("<BHB")
_BAD_PROTOCOL, _BAD_SERVICE, _TOO_SHORT, _BAD_LENGTH = 2, 4, 6, 8  # details of a mailbox error
_LARGEST_DOWNLOAD: Final = 1 << 16  # [bytes] a servo drive has no object this long
_COMPLETE: Final = 0x10  # bit of the command: all subindices at once
_TOGGLE: Final = 0x10  # bit of a segment
_NO_INFORMATION: Final = struct.Struct("<I")
_VARIABLE, _RECORD = 7, 9  # codes of objects
_IN_ANY_STATE: Final = 0x07  # bits of the access: may be read in PRE-OP, SAFE-OP, OP


class Mailbox:
    """Answers the mails of one master.

    Args:
        store: Object store.
        dictionary: Dictionary that the store was made from, for names.
        size: Length of both mailboxes [bytes].
        has_information: Whether it answers SDO information.
        send: Called with each mail of the drive.
    """

    def __init__(
        self, store: ObjectStore, dictionary: Dictionary, size: int, *, has_information: bool,
        send: Callable[[bytes], None],
    ) -> None:  # fmt: skip
        self._store, self._dictionary, self._size, self._send = store, dictionary, size, send
        self._has_information = has_information
        self._services: dict[int, Callable[[bytes], None]] = {_REQUEST: self._serve_sdo, _INFORMATION: self._inform}
        self.reset()

    def reset(self) -> None:
        """Forget transfers and counters."""
        self._counter = 0  # of the drive's own mails, 1..7
        self._heard = 0  # of the last mail of the master: the same again is a repetition
        self._end_transfer()

    def _end_transfer(self) -> None:
        self._place = (0, 0)
        self._rest: bytes | None = None  # of an upload
        self._received: bytearray | None = None  # of a download
        self._announced = self._toggle = 0

    def take(self, mail: bytes) -> None:
        """Answer a mail of the master."""
        length, _address, _channel, kind = _HEADER.unpack_from(mail)
        counter, kind = kind >> 4 & 7, kind & 0x0F
        if counter and counter == self._heard:
            return
        self._heard = counter
        if kind != _COE:
            self._refuse(_BAD_PROTOCOL)
        elif not _HEADER_BYTES - 6 <= length <= len(mail) - 6:
            self._refuse(_BAD_LENGTH)
        else:
            body = mail[_HEADER_BYTES : 6 + length]
            service = mail[7] >> 4
            serve = self._services.get(service)
            if serve is None or (service == _INFORMATION and not self._has_information):
                self._refuse(_BAD_SERVICE)
            elif len(body) < 8 - 2 * (service == _INFORMATION):
                self._refuse(_TOO_SHORT)
            else:
                serve(body)

    def send_emergency(self, content: bytes) -> None:
        """Send an emergency of 8 bytes."""
        self._answer(_EMERGENCY, content)

    def _answer(self, service: int, body: bytes) -> None:
        self._mail(_COE, struct.pack("<H", service << 12) + body)

    def _refuse(self, detail: int) -> None:
        self._mail(_ERROR, struct.pack("<HH", 1, detail))

    def _mail(self, kind: int, body: bytes) -> None:
        self._counter = self._counter % 7 + 1
        self._send(_HEADER.pack(len(body), 0, 0, kind | self._counter << 4) + body)

    # --- SDO ------------------------------------------------------------------------------------------------------

    def _serve_sdo(self, body: bytes) -> None:
        command = body[0]
        specifier = command >> 5
        if specifier == 4:  # an abort
            self._end_transfer()
        elif specifier == 3:
            self._upload_segment(command)
        elif specifier == 0:
            self._download_segment(command, body[1:])
        else:
            self._end_transfer()
            _, index, subindex = _SDO.unpack_from(body)
            self._place = (index, subindex)
            if specifier not in (1, 2):
                self._abort(SdoAbort.COMMAND_SPECIFIER)
            elif command & _COMPLETE:
                self._abort(SdoAbort.UNSUPPORTED_ACCESS)
            elif specifier == 2:
                self._upload()
            else:
                self._download(command, body[4:])

    def _respond(self, command: int, content: bytes = bytes(4)) -> None:
        self._answer(_RESPONSE, _SDO.pack(command, *self._place) + content)

    def _abort(self, code: SdoAbort) -> None:
        self._answer(_REQUEST, _SDO.pack(0x80, *self._place) + struct.pack("<I", code))
        self._end_transfer()

    def _upload(self) -> None:
        content = self._store.read(*self._place)
        if isinstance(content, SdoAbort):
            self._abort(content)
        elif 1 <= len(content) <= 4:
            self._respond(0x43 | (4 - len(content)) << 2, content.ljust(4, b"\0"))
        else:
            room = self._size - _HEADER_BYTES - 8
            self._rest = content[room:] or None
            self._respond(0x41, struct.pack("<I", len(content)) + content[:room])

    def _upload_segment(self, command: int) -> None:
        if self._rest is None:
            self._abort(SdoAbort.COMMAND_SPECIFIER)
        elif command & _TOGGLE != self._toggle:
            self._abort(SdoAbort.TOGGLE_BIT)
        else:
            room = self._size - _HEADER_BYTES - 1
            part, self._rest = self._rest[:room], self._rest[room:] or None
            unused = max(0, 7 - len(part))
            head = self._toggle | unused << 1 | (self._rest is None)
            self._answer(_RESPONSE, bytes((head,)) + part.ljust(7, b"\0"))
            self._toggle ^= _TOGGLE

    def _download(self, command: int, content: bytes) -> None:
        if command & 2:  # expedited
            entry = self._store.find(*self._place)
            own = entry.size if entry is not None and 1 <= entry.size <= 4 else 4
            self._store_value(content[: 4 - (command >> 2 & 3) if command & 1 else own])
            return
        self._announced = int.from_bytes(content[:4], "little")
        if (abort := self._store.may_write(*self._place)) is not None:
            self._abort(abort)
        elif self._announced > _LARGEST_DOWNLOAD:
            self._abort(SdoAbort.OUT_OF_MEMORY)
        elif len(content) - 4 >= self._announced:
            self._store_value(content[4 : 4 + self._announced])
        else:
            self._received = bytearray(content[4:])
            self._respond(0x60)

    def _store_value(self, content: bytes) -> None:
        abort = self._store.write(*self._place, content)
        if abort is not None:
            self._abort(abort)
        else:
            self._respond(0x60)

    def _download_segment(self, command: int, content: bytes) -> None:
        received = self._received
        if received is None:
            self._abort(SdoAbort.COMMAND_SPECIFIER)
            return
        if command & _TOGGLE != self._toggle:
            self._abort(SdoAbort.TOGGLE_BIT)
            return
        received += content[: 7 - (command >> 1 & 7)] if len(content) <= 7 else content
        is_last = bool(command & 1)
        if len(received) > self._announced:
            self._abort(SdoAbort.LENGTH_TOO_HIGH)
        elif is_last and len(received) < self._announced:
            self._abort(SdoAbort.LENGTH_TOO_LOW)
        elif is_last and (abort := self._store.write(*self._place, bytes(received))) is not None:
            self._abort(abort)
        else:
            self._answer(_RESPONSE, bytes((0x20 | self._toggle,)) + bytes(7))
            self._toggle ^= _TOGGLE
            if is_last:
                self._end_transfer()

    # --- SDO information ------------------------------------------------------------------------------------------

    def _inform(self, body: bytes) -> None:
        opcode = body[0] & 0x7F
        if opcode == 1:
            self._send_lists(struct.unpack_from("<H", body, 4)[0])
        elif opcode == 3:
            self._describe_object(struct.unpack_from("<H", body, 4)[0])
        elif opcode == 5 and len(body) >= 8:
            self._describe_entry(*struct.unpack_from("<HBB", body, 4))
        else:
            self._deny(SdoAbort.COMMAND_SPECIFIER)

    def _send_information(self, opcode: int, body: bytes, *, left: int = 0) -> None:
        self._answer(_INFORMATION, struct.pack("<BBH", opcode | 0x80 * (left > 0), 0, left) + body)

    def _deny(self, code: SdoAbort) -> None:
        self._send_information(7, _NO_INFORMATION.pack(code))

    def _send_lists(self, kind: int) -> None:
        """Send the indices of all objects, or the number of them (list 0), in as many mails as they need."""
        indices = self._store.indices()
        words = [len(indices), 0, 0, 0, 0] if kind == 0 else indices if kind == 1 else []
        content = struct.pack(f"<H{len(words)}H", kind, *words)
        room = (self._size - _HEADER_BYTES - 4) // 2 * 2
        parts = [content[at : at + room] for at in range(0, len(content), room)]
        for number, part in enumerate(parts):
            self._send_information(2, part, left=len(parts) - 1 - number)

    def _describe_object(self, index: int) -> None:
        members = self._store.subindices(index)
        entry = self._store.find(index, members[0]) if members else None
        if entry is None:
            self._deny(SdoAbort.NO_OBJECT)
            return
        item = self._dictionary[index]
        code = _VARIABLE if getattr(item, "subindices", None) is None else _RECORD
        described = struct.pack("<HHBB", index, entry.data_type, members[-1], code)
        self._send_information(4, (described + _latin(item.name))[: self._size - 12])

    def _describe_entry(self, index: int, subindex: int, asked: int) -> None:
        entry = self._store.find(index, subindex)
        variable = self._dictionary.get_variable(index, subindex)
        if entry is None or variable is None:
            self._deny(SdoAbort.NO_SUBINDEX if self._store.subindices(index) else SdoAbort.NO_OBJECT)
            return
        bits = 8 * len(entry.value) if isinstance(entry.value, bytes) else 8 * entry.size
        if entry.data_type == DataType.BOOLEAN:
            bits = 1
        head = struct.pack("<HBBHHH", index, subindex, asked, entry.data_type, bits & 0xFFFF, _access(entry))
        self._send_information(6, (head + _latin(variable.name))[: self._size - 12])


def _access(entry: Entry) -> int:
    """Return the access bits of an object: read, write, mapped into outputs, into inputs."""
    bits = _IN_ANY_STATE * entry.readable | (_IN_ANY_STATE << 3) * entry.writable
    return bits | entry.receivable << 6 | entry.transmittable << 7


def _latin(text: str) -> bytes:
    return text.encode("latin-1", errors="replace")
