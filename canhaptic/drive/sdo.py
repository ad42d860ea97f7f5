"""SDO in the caller's thread: canopen's client, pumped through the Link, with retries and errors that name the object.

canopen's own client waits on a queue that its Notifier thread fills, never repeats a request, takes a late answer for
the next request and aborts with index 0. Here the answer is pumped from the bus, an unanswered first request is
repeated, and an answer for another object is counted as late and left out.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from canopen import ObjectDictionary
from canopen.objectdictionary import datatypes
from canopen.sdo.client import SdoClient
from canopen.sdo.exceptions import SdoAbortedError, SdoCommunicationError

from canhaptic.drive.link import Link
from canhaptic.errors import LinkError, SdoError
from canhaptic.object_dictionary import SDO_REQUEST_BASE, SDO_RESPONSE_BASE

_ABORT: Final = 0x80  # command specifier of an abort, either way
_INITIATE_REQUESTS: Final = (0x20, 0x40)  # initiate download, initiate upload
_INITIATE_RESPONSES: Final = (0x60, 0x40)
_SPECIFIER: Final = 0xE0
_FRAME_LENGTH: Final = 8
_TIMED_OUT: Final = 0x05040000
ATTEMPTS: Final = 3
"""How often an unanswered first request is sent."""


class _PumpedClient(SdoClient):
    """canopen's client with the transport replaced; it never sees a thread, a Network or a wall clock."""

    def __init__(self, link: Link, node_id: int, dictionary: ObjectDictionary, timeout: int, attempts: int) -> None:
        super().__init__(  # type: ignore[no-untyped-call]
            SDO_REQUEST_BASE + node_id, SDO_RESPONSE_BASE + node_id, dictionary
        )
        self._link = link
        self._timeout = timeout
        self._attempts = attempts
        self._object = b"\0\0\0"  # index and subindex of the transfer, as on the wire
        self._answer: bytes | None = None
        self._waits_for_initiate = False
        self._waits = False
        self.listen()

    def listen(self) -> None:
        """Takes the answers of the drive from now on, in place of whoever took them before."""
        self._link.subscribe(self.tx_cobid, self._take)

    @contextmanager
    def patience(self, timeout: int, attempts: int) -> Iterator[None]:
        """Within the block an answer may take `timeout` [ns], and a request is sent `attempts` times, at most."""
        before = self._timeout, self._attempts
        self._timeout, self._attempts = min(self._timeout, timeout), min(self._attempts, attempts)
        try:
            yield
        finally:
            self._timeout, self._attempts = before

    def _take(self, data: bytearray) -> None:
        if len(data) != _FRAME_LENGTH:
            self._link.statistics.short += 1
            return
        names_object = data[0] == _ABORT or data[0] & _SPECIFIER in _INITIATE_RESPONSES
        is_ours = data[1:4] == self._object if names_object else not self._waits_for_initiate
        if not self._waits or not is_ours:
            self._link.statistics.late += 1
            return
        self._answer = bytes(data)

    def send_request(self, request: bytes | bytearray) -> None:
        self._link.send(self.rx_cobid, bytes(request))

    def request_response(self, sdo_request: bytes | bytearray) -> bytes:
        initiates = sdo_request[0] & _SPECIFIER in _INITIATE_REQUESTS
        if initiates:
            self._object = bytes(sdo_request[1:4])
        self._waits_for_initiate = initiates
        for _ in range(self._attempts if initiates else 1):
            self._answer, self._waits = None, True
            self.send_request(sdo_request)
            answered = self._link.wait_for(self._is_answered, self._timeout)
            self._waits = False
            if answered:
                return self.read_response()
        self.abort(_TIMED_OUT)
        raise SdoCommunicationError("no answer")

    def _is_answered(self) -> bool:
        return self._answer is not None

    def read_response(self) -> bytes:
        answer = self._answer or b""
        if answer[0] == _ABORT:
            raise SdoAbortedError(int.from_bytes(answer[4:8], "little"))
        return answer

    def abort(self, abort_code: int = 0x08000000) -> None:
        self.send_request(bytes([_ABORT]) + self._object + abort_code.to_bytes(4, "little"))


class SdoChannel:
    """Reads and writes objects of one drive as integers.

    Args:
        link: The bus.
        node_id: The drive's.
        dictionary: Gives names, sizes and signs; objects it lacks can be read all the same, as unsigned.
        name: Name of the axis, for messages.
        timeout: For one answer [ns].
        attempts: How often an unanswered request is sent.
    """

    def __init__(
        self, link: Link, node_id: int, dictionary: ObjectDictionary, name: str, timeout: int, attempts: int = ATTEMPTS
    ) -> None:
        self.dictionary = dictionary
        self._client = _PumpedClient(link, node_id, dictionary, timeout, attempts)
        self._node_id = node_id
        self._name = name
        self._timeout, self._attempts = timeout, attempts
        self._patience = f"{attempts} requests, {timeout / 1e9:g} s each"

    def read(self, index: int, subindex: int = 0) -> int:
        """Returns the value of an integer object.

        Raises:
            SdoError: Aborted by the drive or not answered.
        """
        try:
            data = self._client.upload(index, subindex)
        except SdoAbortedError as error:
            raise self.aborted("read", index, subindex, error.code) from error
        except (SdoCommunicationError, LinkError) as error:
            raise self._unanswered("read", index, subindex, error) from error
        variable = self.dictionary.get_variable(index, subindex)
        signed = variable is not None and variable.data_type in datatypes.SIGNED_TYPES
        return int.from_bytes(data, "little", signed=signed)

    def probe(self, index: int, subindex: int = 0) -> int:
        """Returns the value of an object like `read`, but asks only once.

        Raises:
            SdoError: Aborted by the drive or not answered.
        """
        with self._client.patience(self._timeout, 1):
            return self.read(index, subindex)

    def read_within(self, limit: int, index: int, subindex: int = 0) -> int:
        """Returns the value of an object like `read`; all attempts together take at most `limit` [ns].

        Raises:
            SdoError: Aborted by the drive or not answered.
        """
        with self._client.patience(limit // self._attempts, self._attempts):
            return self.read(index, subindex)

    def write(self, index: int, subindex: int, value: int, size: int | None = None) -> None:
        """Writes an integer object.

        Args:
            index: Of the object.
            subindex: Of the object.
            value: Signed or unsigned, as its type is.
            size: Bytes; None takes it from the dictionary.

        Raises:
            SdoError: Aborted by the drive, not answered, or the value does not fit the object.
        """
        variable = self.dictionary.get_variable(index, subindex)
        if size is None:
            size = len(variable) // 8 if variable is not None else 4
        try:
            self._client.download(index, subindex, value.to_bytes(size, "little", signed=value < 0))
        except OverflowError as error:
            raise SdoError(
                f"{self._name}: write {self.describe(index, subindex)}: {value} does not fit {size} bytes",
                index,
                subindex,
            ) from error
        except SdoAbortedError as error:
            raise self.aborted("write", index, subindex, error.code) from error
        except (SdoCommunicationError, LinkError) as error:
            raise self._unanswered("write", index, subindex, error) from error

    def describe(self, index: int, subindex: int = 0) -> str:
        """Returns an object as `0x6072:00 Max torque`."""
        variable = self.dictionary.get_variable(index, subindex)
        return f"{index:#06x}:{subindex:02x}" + (f" {variable.name}" if variable is not None else "")

    def listen(self) -> None:
        """Takes the answers of the drive from now on; somebody else may have done so beside a cycle."""
        self._client.listen()

    def aborted(self, verb: str, index: int, subindex: int, code: int) -> SdoError:
        """Returns the error of a transfer that the drive has aborted."""
        text = SdoAbortedError.CODES.get(code, "unknown abort code")
        message = f"{self._name}: {verb} {self.describe(index, subindex)}: aborted with {code:#010x}, {text}"
        return SdoError(message, index, subindex, code)

    def _unanswered(self, verb: str, index: int, subindex: int, error: Exception) -> SdoError:
        message = (
            f"{self._name}: {verb} {self.describe(index, subindex)}: node {self._node_id}: {error} ({self._patience}); "
            "check power, node ID, bit rate and cable"
        )
        return SdoError(message, index, subindex)
