"""SDO during the running cycle, from any thread: a request is sent after the RPDOs, when the bus has room.

    value = rig.sdo("handle").read(0x6079).result(timeout=1.0)

A request is queued without a lock. The thread of the cycle sends at most one SDO frame per bus and cycle, after the
RPDOs, and reads answers only then; between SYNC and RPDO an answer is set aside by its COB-ID. Results are handed
over by another thread, so that no callback of a future runs in the cycle. Each bus has one transfer at a time.
"""

import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from queue import SimpleQueue
from typing import Any, Final

from canhaptic.canopen import objects as od
from canhaptic.canopen.objects import SDO_REQUEST_BASE, SDO_RESPONSE_BASE, SdoAbort
from canhaptic.drive.can import sdo
from canhaptic.drive.can.link import Link
from canhaptic.drive.can.sdo import ABORT, ATTEMPTS, FRAME_LENGTH, ProtocolError, Transfer
from canhaptic.drive.can.servo_drive import ServoDrive
from canhaptic.drive.profile.drive_objects import DRIVE_SETTINGS
from canhaptic.drive.profile.torque_axis import COMMANDS
from canhaptic.errors import LinkError, SdoError

_MOST_WAITING: Final = 1000  # requests per bus
_OWNED: Final = (
    # of the cycle and of the start that confirmed them: not to be written from outside while the rig runs
    COMMANDS
    | {od.SYNC_COB_ID, od.COMMUNICATION_CYCLE_PERIOD, od.STORE_PARAMETERS, od.RESTORE_PARAMETERS, od.EMCY_COB_ID}
    | {od.CONSUMER_HEARTBEAT_TIME, od.PRODUCER_HEARTBEAT_TIME, od.GUARD_TIME, od.LIFE_TIME_FACTOR, od.ERROR_BEHAVIOUR}
    | {od.MODES_OF_OPERATION, od.INTERPOLATION_PERIOD, od.ABORT_CONNECTION_OPTION, 0x1200}  # 0x1200: SDO server
    | {od.HOME_OFFSET, od.POSITION_OFFSET, od.VELOCITY_OFFSET, od.TORQUE_OFFSET}
    | {index for index, _ in DRIVE_SETTINGS}
    | {0x605B, 0x605C, 0x605D, 0x605E}  # reactions to shutdown, disable operation, halt and fault
    | set(range(od.RPDO_COMMUNICATION, od.TPDO_MAPPING + od.PDO_COUNT))
)


@dataclass(slots=True, eq=False)
class _Request:
    """One transfer, from the requesting thread to the thread that delivers the result."""

    drive: ServoDrive
    verb: str
    index: int
    subindex: int
    transfer: Transfer
    convert: Callable[[bytes], Any]
    future: "Future[Any]" = field(default_factory=Future)
    frame: bytes = b""
    attempts: int = 0

    def failure(self, text: str) -> SdoError:
        return self.drive.sdo.failure(self.verb, self.index, self.subindex, text)


class BackgroundSdo:
    """SDO access to one drive while the rig runs; may be used from any thread."""

    def __init__(self, drive: ServoDrive, line: "SdoLine") -> None:
        self._drive, self._line = drive, line

    def __repr__(self) -> str:
        return f"<BackgroundSdo of {self._drive.axis.name}, node {self._drive.axis.node_id}>"

    def upload(self, index: int, subindex: int = 0) -> "Future[bytes]":
        """Read an object and return the future of its bytes.

        The future raises SdoError when the drive aborts, does not answer, or the rig stops before.

        Raises:
            SdoError: The rig does not run, the bus has no room, or too many requests wait.
        """
        return self._ask("read", index, subindex, sdo.upload(*_checked(index, subindex)), bytes)

    def download(self, index: int, subindex: int, data: bytes) -> "Future[None]":
        """Write the bytes of an object and return the future of its confirmation, which raises as for `upload`.

        Raises:
            SdoError: As `upload`, or the object belongs to the cycle.
        """
        axis = self._drive.axis
        if index in _OWNED | axis.causality.owned | {place[0] for place in axis.written_objects}:
            text = "it belongs to the cycle while the rig runs; stop the rig first"
            raise self._drive.sdo.failure("write", index, subindex, text)
        transfer = sdo.download(*_checked(index, subindex), bytes(data))
        return self._ask("write", index, subindex, transfer, lambda _: None)

    def read(self, index: int, subindex: int = 0) -> "Future[int]":
        """Read an integer object with the length and sign given by the dictionary; raise as `upload`."""
        transfer = sdo.upload(*_checked(index, subindex))
        return self._ask("read", index, subindex, transfer, partial(self._drive.sdo.decode, index, subindex))

    def write(self, index: int, subindex: int, value: int, size: int | None = None) -> "Future[None]":
        """Write an integer object of `size` bytes, by default as long as the dictionary says; raise as `download`."""
        return self.download(index, subindex, self._drive.sdo.encode(index, subindex, value, size))

    def _ask(
        self, verb: str, index: int, subindex: int, transfer: Transfer, convert: Callable[[bytes], Any]
    ) -> "Future[Any]":
        request = _Request(self._drive, verb, index, subindex, transfer, convert)
        self._line.submit(request)
        return request.future


def _checked(index: int, subindex: int) -> tuple[int, int]:
    if not (0 <= index <= 0xFFFF and 0 <= subindex <= 0xFF):
        raise SdoError(f"object {index:#x}:{subindex:#x} does not exist, expected 0..0xFFFF:0..0xFF", index, subindex)
    return index, subindex


class SdoLine:
    """The SDO traffic of one bus during the cycle.

    Args:
        link: The bus.
        has_room: Whether each cycle has room for an SDO frame.

    Attributes:
        busy: Whether `step` must be called in this cycle.
    """

    def __init__(self, link: Link, has_room: bool) -> None:
        self._link, self._has_room = link, has_room
        self.busy = self._is_open = False
        self._waiting: deque[_Request] = deque()
        self._answers: deque[bytes] = deque(maxlen=16)  # kept between two looks
        self._under_way: _Request | None = None
        self._deadline = 0
        self._done: SimpleQueue[tuple[_Request, Any] | None] = SimpleQueue()
        self._starting = threading.Lock()
        self._has_hander = False

    # --- any thread -------------------------------------------------------------------------------------------------

    def submit(self, request: _Request) -> None:
        """Queue a request, which `step` sends when its turn comes.

        Raises:
            SdoError: The bus has no time left, the rig does not run, or too many requests are waiting.
        """
        if not self._has_room:
            raise request.failure(
                "the bus has no time left for SDO during the cycle; lower bus.rate, or send the request before start"
            )
        if not self._is_open:
            raise request.failure("the rig is not running; SDO from another thread needs a running cycle")
        if len(self._waiting) >= _MOST_WAITING:
            raise request.failure(f"{_MOST_WAITING} requests are waiting already; await some of them first")
        with self._starting:  # between those who ask; the cycle never waits for it
            if not self._has_hander:  # the thread that hands results over, from the first request of a run on
                self._has_hander = True
                threading.Thread(target=_hand_over, args=(self._done,), name="SDO results", daemon=True).start()
        self._waiting.append(request)
        self.busy = True
        if not self._is_open:  # closed in between: the thread that takes it out of the queue answers it
            with suppress(ValueError):
                self._waiting.remove(request)
                raise request.failure("the rig has stopped")

    # --- the thread of the cycle --------------------------------------------------------------------------------------

    def access(self, drive: ServoDrive) -> BackgroundSdo:
        """Return the access to one drive of the bus."""
        return BackgroundSdo(drive, self)

    def open(self) -> None:
        """Accept requests; no effect if already open."""
        with self._starting:  # the first request for SDO may open it while the rig starts
            if self._is_open:
                return
            self.busy = False
            self._done, self._has_hander = SimpleQueue(), False
            self._is_open = self._has_room

    def close(self) -> None:
        """Accept no more requests and fail the waiting ones."""
        if not self._is_open:
            return
        self._is_open = False
        if self._under_way is not None:
            self._finish(self._under_way.failure("the rig has stopped before the drive answered"))
        with suppress(IndexError):  # another thread may take its own request out
            while request := self._waiting.popleft():
                self._done.put((request, request.failure("the rig has stopped before the request was sent")))
        self._done.put(None)

    def step(self) -> None:
        """Process an arrived answer, and send at most one frame; called after the RPDOs while `busy`."""
        request = self._under_way
        if request is not None:
            self._look(request)
        elif self._waiting:
            self._begin(self._waiting.popleft())
        self.busy = self._under_way is not None or bool(self._waiting)

    def _begin(self, request: _Request) -> None:
        if not request.future.set_running_or_notify_cancel():
            return
        self._under_way = request
        self._answers.clear()
        self._link.subscribe(SDO_RESPONSE_BASE + request.drive.axis.node_id, self._take)
        self._advance(request, None)

    def _take(self, data: bytearray) -> None:
        """Store an answer; `step` reads it after the RPDOs."""
        self._answers.append(bytes(data))

    def _look(self, request: _Request) -> None:
        """Continue with the answer if it has arrived, or ask again when it is overdue."""
        while self._answers:
            answer = self._answers.popleft()
            if len(answer) != FRAME_LENGTH:
                self._link.statistics.short += 1
            elif not sdo.may_answer(answer, request.frame, sdo.address(request.index, request.subindex)):
                self._link.statistics.late += 1
            elif answer[0] == ABORT:
                code = int.from_bytes(answer[4:8], "little")
                return self._finish(request.drive.sdo.aborted(request.verb, request.index, request.subindex, code))
            else:
                return self._advance(request, answer)
        if self._link.clock.now() >= self._deadline:
            self._ask_again(request)

    def _advance(self, request: _Request, answer: bytes | None) -> None:
        try:
            request.frame = next(request.transfer) if answer is None else request.transfer.send(answer)
        except StopIteration as end:
            return self._finish(end.value)
        except ProtocolError as error:
            self._send(sdo.abort(request.index, request.subindex, SdoAbort.COMMAND_SPECIFIER))
            return self._finish(request.failure(str(error)))
        request.attempts = 0
        self._ask(request)

    def _ask_again(self, request: _Request) -> None:
        """Repeat an unanswered first request; a segment is not repeated, because the drive may have taken it."""
        if request.attempts < ATTEMPTS and sdo.initiates(request.frame):
            return self._ask(request)
        self._send(sdo.abort(request.index, request.subindex, SdoAbort.TIMEOUT))
        timeout = f"{request.attempts} requests, {request.drive.axis.sdo_timeout:g} s each"
        self._finish(request.failure(f"node {request.drive.axis.node_id}: no answer ({timeout})"))

    def _ask(self, request: _Request) -> None:
        request.attempts += 1
        self._deadline = self._link.clock.now() + round(request.drive.axis.sdo_timeout * 1e9)
        self._send(request.frame)

    def _send(self, frame: bytes) -> None:
        request = self._under_way
        if request is None:
            return
        try:
            self._link.send(SDO_REQUEST_BASE + request.drive.axis.node_id, frame)
        except LinkError as error:  # the cycle finds out by itself whether the bus is gone
            self._finish(request.failure(str(error)))

    def _finish(self, result: Any) -> None:
        request, self._under_way = self._under_way, None
        if request is not None:
            request.drive.sdo.listen()
            self._done.put((request, result))


def _hand_over(done: "SimpleQueue[tuple[_Request, Any] | None]") -> None:
    """Set the results of the futures, in a thread of its own where their callbacks run."""
    while (entry := done.get()) is not None:
        request, result = entry
        if request.future.done() or not (request.future.running() or request.future.set_running_or_notify_cancel()):
            continue
        if isinstance(result, SdoError):
            request.future.set_exception(result)
        else:
            request.future.set_result(request.convert(result))
