"""SDO in the caller's thread: transfers pumped through the Link, with retries and errors that name the object.

canopen's client waits on a queue that its Notifier thread fills. It never repeats a request, takes a late answer for
the next, aborts with index 0, and reads on for ever if an object has no end. Here the answer is pumped from the bus,
an unanswered first request is repeated, and an answer for another object is counted as late and ignored.

A transfer (CiA 301, 7.2.4.3) is a generator that knows no bus and no clock: it yields a request and receives its
answer, until it returns the uploaded bytes.
"""

from collections.abc import Generator, Iterator
from contextlib import contextmanager
from typing import Final

from canopen import ObjectDictionary
from canopen.objectdictionary import datatypes
from canopen.sdo.exceptions import SdoAbortedError

from canhaptic.canopen.objects import SDO_REQUEST_BASE, SDO_RESPONSE_BASE, SdoAbort
from canhaptic.drive.can.link import Link
from canhaptic.drive.profile.torque_axis import COMMANDS, Written, note_write
from canhaptic.errors import LinkError, SdoError

ABORT: Final = 0x80  # command specifier of an abort, either way
FRAME_LENGTH: Final = 8
_LARGEST: Final = 1 << 16  # [bytes] of one object; a server that goes on is broken
_SPECIFIER: Final = 0xE0
_TOGGLE: Final = 0x10
_EXPEDITED: Final = 0x02
_SIZE_INDICATED: Final = 0x01
_LAST: Final = 0x01
_UPLOAD, _DOWNLOAD = 0x40, 0x20  # requests to initiate; the answers have 0x40 and 0x60
_UPLOAD_ANSWER, _DOWNLOAD_ANSWER = 0x40, 0x60
_UPLOAD_SEGMENT, _DOWNLOAD_SEGMENT = 0x60, 0x00  # requests; the answers have 0x00 and 0x20

Transfer = Generator[bytes, bytes, bytes]


class ProtocolError(Exception):
    """An answer that does not match the request; its text quotes the answer."""


def address(index: int, subindex: int) -> bytes:
    """Return the address of an object in requests and answers."""
    return index.to_bytes(2, "little") + bytes([subindex])


def upload(index: int, subindex: int) -> Transfer:
    """Return the transfer that reads an object; its value is the bytes of the object."""
    answer = yield bytes([_UPLOAD]) + address(index, subindex) + bytes(4)
    _require(answer, _UPLOAD_ANSWER)
    if answer[0] & _EXPEDITED:
        unused = answer[0] >> 2 & 3 if answer[0] & _SIZE_INDICATED else 0
        return answer[4 : 8 - unused]
    size = int.from_bytes(answer[4:8], "little") if answer[0] & _SIZE_INDICATED else None
    data, toggle = b"", 0
    while True:
        answer = yield bytes([_UPLOAD_SEGMENT | toggle]) + bytes(7)
        _require(answer, 0x00, toggle)
        data += answer[1 : 8 - (answer[0] >> 1 & 7)]
        if answer[0] & _LAST:
            break
        if len(data) > _LARGEST:
            raise ProtocolError(f"more than {_LARGEST} bytes came, the most that is read of one object")
        toggle ^= _TOGGLE
    if size is not None and size != len(data):
        raise ProtocolError(f"{len(data)} of {size} announced bytes came")
    return data


def download(index: int, subindex: int, data: bytes) -> Transfer:
    """Return the transfer that writes an object; its value is empty."""
    head = address(index, subindex)
    if 1 <= len(data) <= 4:
        unused = 4 - len(data)
        answer = yield bytes([_DOWNLOAD | unused << 2 | _EXPEDITED | _SIZE_INDICATED]) + head + data.ljust(4, b"\0")
        _require(answer, _DOWNLOAD_ANSWER)
        return b""
    answer = yield bytes([_DOWNLOAD | _SIZE_INDICATED]) + head + len(data).to_bytes(4, "little")
    _require(answer, _DOWNLOAD_ANSWER)
    toggle = 0
    for start in range(0, max(1, len(data)), 7):
        piece = data[start : start + 7]
        is_last = start + 7 >= len(data)
        answer = yield bytes([_DOWNLOAD_SEGMENT | toggle | 7 - len(piece) << 1 | is_last]) + piece.ljust(7, b"\0")
        _require(answer, 0x20, toggle)
        toggle ^= _TOGGLE
    return b""


def initiates(request: bytes) -> bool:
    """Whether a request begins a transfer, and so may be repeated when no answer comes."""
    return request[0] & _SPECIFIER in (_UPLOAD, _DOWNLOAD)


def first_answer(request: bytes) -> bytes:
    """Return the first bytes of a normal answer to a request: specifier and object."""
    specifier = _UPLOAD_ANSWER if request[0] & _SPECIFIER == _UPLOAD else _DOWNLOAD_ANSWER
    return bytes([specifier]) + request[1:4]


def may_answer(answer: bytes | bytearray, request: bytes, of_object: bytes) -> bool:
    """Whether a frame of a server may answer a request: the same kind, and the same object if the frame names one.

    A first answer and an abort name their object; an answer to a segment does not.
    """
    if answer[0] == ABORT:
        return bytes(answer[1:4]) == of_object
    if initiates(request):
        return _head(answer) == first_answer(request)
    return answer[0] & _SPECIFIER not in (_UPLOAD_ANSWER, _DOWNLOAD_ANSWER)


def _head(answer: bytes | bytearray) -> bytes:
    """Return specifier and object of an answer."""
    return bytes([answer[0] & _SPECIFIER, *answer[1:4]])


def abort(index: int, subindex: int, code: int) -> bytes:
    """Return the frame that ends a transfer."""
    return bytes([ABORT]) + address(index, subindex) + code.to_bytes(4, "little")


def _require(answer: bytes, specifier: int, toggle: int | None = None) -> None:
    if answer[0] & _SPECIFIER != specifier:
        raise ProtocolError(f"the answer {answer.hex(' ')} does not fit this request")
    if toggle is not None and answer[0] & _TOGGLE != toggle:
        raise ProtocolError(f"the toggle bit of the answer {answer.hex(' ')} is wrong")


ATTEMPTS: Final = 3
"""Number of times that an unanswered first request is sent."""
_SILENT: Final = "check power, node ID, bit rate and cable, and sdo_timeout of a slow drive"
_OTHER_LENGTH: Final = (
    "an SDO has eight bytes (CiA 301): update the drive's firmware, or find what else sends this frame"
)
_LATE_ANSWERS: Final = 3  # one may be late after a long write; a drive that always is needs a longer timeout


class _NoAnswerError(Exception):
    """No answer of the node arrived in time."""


class SdoChannel:
    """Reads and writes objects of one drive as integers.

    Args:
        link: The bus.
        node_id: Node ID of the drive.
        dictionary: Gives names, sizes and signs; an object that it lacks is read as unsigned.
        name: Name of the axis, for messages.
        timeout: Time limit of one answer [ns].

    Attributes:
        changes: Writes so far, with the values before; None: not recorded.
    """

    def __init__(self, link: Link, node_id: int, dictionary: ObjectDictionary, name: str, timeout: int) -> None:
        self.dictionary = dictionary
        self._link, self._node_id, self._name = link, node_id, name
        self._timeout, self._attempts = timeout, ATTEMPTS
        self.changes: list[Written] | None = None
        self._object = b"\0\0\0"  # index and subindex of the transfer, as on the wire
        self._request = b""  # awaited for an answer; empty while none is
        self._answer: bytes | None = None
        self._owed: dict[bytes, int] = {}  # answers still to come, by their first four bytes
        self._asked = self._surplus = 0  # first requests sent, and answers to them beyond one for each
        self._quickest = -1  # [ns] answer to a request that was sent once; -1: none yet
        self._begun = self._took = 0  # [ns] first request of the transfer; until its answer, where it was repeated
        self._late = 0  # answers that came after their request was repeated
        self.lateness = 0  # [ns] after which the slowest of them came
        self._is_short = False
        self._stray = ""  # the last frame that answered nothing, in words
        self.listen()

    def listen(self) -> None:
        """Receive the answers of the drive from now on, in place of any earlier handler."""
        self._link.subscribe(SDO_RESPONSE_BASE + self._node_id, self._take)

    # --- frames -----------------------------------------------------------------------------------------------------

    @contextmanager
    def _within(self, timeout: int, attempts: int) -> Iterator[None]:
        """Within the block an answer may take `timeout` [ns], and a request is sent `attempts` times, at most."""
        before = self._timeout, self._attempts
        self._timeout, self._attempts = min(self._timeout, timeout), attempts
        try:
            yield
        finally:
            self._timeout, self._attempts = before

    def _value_of(self, verb: str, index: int, subindex: int, transfer: Transfer) -> bytes:
        """Carry out a transfer and return its value; raise SdoError."""
        try:
            return self._run(index, subindex, transfer)
        except SdoAbortedError as error:
            raise self.aborted(verb, index, subindex, error.code) from error
        except (ProtocolError, _NoAnswerError, LinkError) as error:
            patience = f"{self._attempts} requests, {self._timeout / 1e9:g} s each"
            remedy = _OTHER_LENGTH if self._is_short else _SILENT
            if self._late:
                remedy = f"answers came after {self.lateness * 1e-9:.3g} s: raise sdo_timeout"
            text = f"node {self._node_id}: {error} ({patience}); {remedy}"
            raise self.failure(verb, index, subindex, text) from error

    def _run(self, index: int, subindex: int, transfer: Transfer) -> bytes:
        """Carry out a transfer and return its value.

        Raises:
            SdoAbortedError: The server aborted the transfer.
            ProtocolError: The answer does not belong to the request; the transfer was aborted.
            _NoAnswerError: The server did not answer in time; the transfer was aborted.
            LinkError: The bus failed.
        """
        self._object = address(index, subindex)
        request = next(transfer)
        try:
            while True:
                request = transfer.send(self._ask(request))
        except StopIteration as end:
            return bytes(end.value)
        except (ProtocolError, _NoAnswerError) as error:
            code = SdoAbort.TIMEOUT if isinstance(error, _NoAnswerError) else SdoAbort.COMMAND_SPECIFIER
            self._link.send(SDO_REQUEST_BASE + self._node_id, abort(index, subindex, code))
            raise

    def _ask(self, request: bytes) -> bytes:
        now, is_first = self._link.clock.now, initiates(request)
        if is_first:
            self._await_owed(request)
        self._stray, self._is_short, self._begun = "", False, now()
        for attempt in range(self._attempts if is_first else 1):
            self._answer, self._request = None, request
            if is_first:
                head = first_answer(request)
                self._owed[head] = max(0, self._owed.get(head, 0)) + 1
                self._asked += 1
            sent = self._link.send(SDO_REQUEST_BASE + self._node_id, request)
            self._link.wait_for(lambda: self._answer is not None, self._timeout)
            self._request = b""
            if self._answer is not None:
                if is_first:
                    self._note_time(head, attempt, now() - sent)
                if self._answer[0] == ABORT:
                    raise SdoAbortedError(int.from_bytes(self._answer[4:8], "little"))
                return self._answer
        self._took = 0
        raise _NoAnswerError(f"no answer{self._stray}")

    def _await_owed(self, request: bytes) -> None:
        """Let late answers about the same object pass: none of them may be taken for the answer to this request."""
        of_object = request[1:4]
        heads = [head for head, count in self._owed.items() if count > 0 and head[1:] == of_object]
        if heads:
            is_over = lambda: all(self._owed[head] <= 0 for head in heads)  # noqa: E731
            self._link.wait_for(is_over, self._attempts * self._timeout)
            self._link.wait_for(is_over, self.lateness)
            self._owed |= dict.fromkeys(heads, 0)

    def _note_time(self, head: bytes, attempt: int, time: int) -> None:
        """Judge from the time since the last request whether the answer was to an earlier one, and this one's follows.

        An answer as quick as others shows that the earlier requests were lost.
        """
        if attempt == 0:
            self._quickest = time if self._quickest < 0 else min(time, self._quickest)
        elif 0 <= time <= 2 * self._quickest:
            self._owed[head] = 0
        self._took = self._link.clock.now() - self._begun if attempt else 0

    def _take(self, data: bytearray) -> None:
        if len(data) != FRAME_LENGTH:
            self._link.statistics.short += 1
            self._stray, self._is_short = f" of {FRAME_LENGTH} bytes, but one of {len(data)}", True
            return
        head = _head(data)
        if data[0] == ABORT:  # it answers a read or a write of its object
            heads = [bytes([kind]) + head[1:] for kind in (_UPLOAD_ANSWER, _DOWNLOAD_ANSWER)]
            head = next((one for one in heads if self._owed.get(one, 0) > 0), head)
        if head in self._owed:
            self._owed[head] -= 1
            if self._owed[head] < 0:
                self._surplus += 1
                self._link.statistics.late += 1
                return
        if not self._request or not may_answer(data, self._request, self._object):
            self._link.statistics.late += 1
            self._stray = f", but {bytes(data).hex(' ')}, which answers another request"
            if self._owed.get(head, -1) >= 0:
                self._late += 1
                self._took = self._took or self._link.clock.now() - self._begun
                self.lateness = max(self.lateness, self._took)
            return
        self._answer = bytes(data)

    @property
    def is_doubled(self) -> bool:
        """Whether most requests were answered more than once, as happens when two nodes have one ID."""
        return self._surplus >= 3 and 2 * self._surplus > self._asked  # a bus may double a frame now and then

    @property
    def is_late(self) -> bool:
        """Whether answers came again and again after their request had been repeated."""
        return self._late >= _LATE_ANSWERS

    # --- objects ----------------------------------------------------------------------------------------------------

    def read(self, index: int, subindex: int = 0) -> int:
        """Return the value of an integer object.

        Raises:
            SdoError: Aborted by the drive or not answered.
        """
        return self.decode(index, subindex, self._value_of("read", index, subindex, upload(index, subindex)))

    def probe(self, index: int, subindex: int = 0) -> int:
        """Return the value of an object, like `read`, but send the request only once.

        Raises:
            SdoError: Aborted by the drive or not answered.
        """
        with self._within(self._timeout, 1):
            return self.read(index, subindex)

    def write(self, index: int, subindex: int, value: int, size: int | None = None) -> None:
        """Write an integer object.

        Args:
            index: Index of the object.
            subindex: Subindex of the object.
            value: Value, signed or unsigned according to its type.
            size: Length in bytes; None takes it from the dictionary.

        Raises:
            SdoError: Aborted by the drive, not answered, or the value does not fit the object.
        """
        data = self.encode(index, subindex, value, size)
        if self.changes is not None and index not in COMMANDS:
            note_write(self.changes, Written((index, subindex), None, value, len(data)), self.read)
        self._value_of("write", index, subindex, download(index, subindex, data))

    def clear(self, index: int, subindex: int = 0) -> int:
        """Write 0 to an object that is not 0; return what it is then. One that the drive lacks is 0.

        Raises:
            SdoError: Not answered.
        """
        left = 0
        try:
            data = self._value_of("read", index, subindex, upload(index, subindex))
            left = self.decode(index, subindex, data)
            if left:
                is_listed = self.dictionary.get_variable(index, subindex) is not None
                self.write(index, subindex, 0, None if is_listed else len(data))
                left = self.read(index, subindex)
        except SdoError as error:
            if error.code is None:
                raise
        return left

    def decode(self, index: int, subindex: int, data: bytes) -> int:
        """Return the integer in the bytes of an object, with the length and sign given by the dictionary."""
        variable = self.dictionary.get_variable(index, subindex)
        if variable is None or variable.data_type not in datatypes.INTEGER_TYPES:
            return int.from_bytes(data, "little")
        is_signed = variable.data_type in datatypes.SIGNED_TYPES
        return int.from_bytes(data[: len(variable) // 8], "little", signed=is_signed)  # more may come, without a length

    def encode(self, index: int, subindex: int, value: int, size: int | None = None) -> bytes:
        """Return the bytes of an integer object, by default as many as the dictionary says.

        Raises:
            SdoError: The value does not fit them.
        """
        variable = self.dictionary.get_variable(index, subindex)
        if size is None:
            size = len(variable) // 8 if variable is not None else 4
        try:
            return value.to_bytes(size, "little", signed=value < 0)
        except OverflowError as error:
            raise self.failure("write", index, subindex, f"{value} does not fit {size} bytes") from error

    def describe(self, index: int, subindex: int = 0) -> str:
        """Return the name of an object, as `0x6072:00 Max torque`."""
        variable = self.dictionary.get_variable(index, subindex)
        return f"{index:#06x}:{subindex:02x}" + (f" {variable.name}" if variable is not None else "")

    def aborted(self, verb: str, index: int, subindex: int, code: int) -> SdoError:
        """Return the error of a transfer that the drive has aborted."""
        text = SdoAbortedError.CODES.get(code, "unknown abort code")
        return self.failure(verb, index, subindex, f"aborted with {code:#010x}, {text}", code)

    def failure(self, verb: str, index: int, subindex: int, text: str, code: int | None = None) -> SdoError:
        """Return the error of a transfer, with axis and object named."""
        return SdoError(f"{self._name}: {verb} {self.describe(index, subindex)}: {text}", index, subindex, code)
