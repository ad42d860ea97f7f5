"""The SDO server of the simulated drive (CiA 301, 7.2.4): expedited and segmented transfers, abort codes.

It maps request frames to answer frames, without bus or time. Block transfer is refused, which CiA 301 permits.
"""

from typing import Final

from canhaptic.canopen.objects import SdoAbort
from canhaptic.sim.drive.profile.object_store import ObjectStore

_SEGMENT_BYTES: Final = 7
_MAX_DOWNLOAD: Final = 1 << 16  # [bytes] a servo drive has no object this long; a longer transfer is out of memory

_DOWNLOAD_SEGMENT, _INITIATE_DOWNLOAD, _INITIATE_UPLOAD, _UPLOAD_SEGMENT, _ABORT = range(5)  # client specifiers


class SdoServer:
    """Answers the requests of one client.

    Args:
        store: Object store.
        indicates_size: False for drives that leave out the length of an expedited answer (0x42 instead of 0x43).
    """

    def __init__(self, store: ObjectStore, indicates_size: bool = True) -> None:
        self._store = store
        self._indicates_size = indicates_size
        self.reset()

    def reset(self) -> None:
        """Discard a transfer in progress."""
        self._place = (0, 0)
        self._rest: bytes | None = None  # of an upload
        self._received: bytearray | None = None  # of a download
        self._announced: int | None = None  # length of that download [bytes]
        self._toggle = 0

    def answer(self, request: bytes) -> bytes | None:
        """Answer to a request of 8 bytes; None when no answer is due (an abort, a short frame)."""
        specifier = request[0] >> 5 if len(request) == 8 else _ABORT
        if specifier == _ABORT:
            self.reset()
            return None
        if specifier == _UPLOAD_SEGMENT:
            return self._upload_segment(request[0])
        if specifier == _DOWNLOAD_SEGMENT:
            return self._download_segment(request)
        return self._initiate(specifier, request)

    def _initiate(self, specifier: int, request: bytes) -> bytes:
        self.reset()
        self._place = (request[1] | request[2] << 8, request[3])
        if specifier == _INITIATE_UPLOAD:
            return self._initiate_upload()
        if specifier == _INITIATE_DOWNLOAD:
            return self._initiate_download(request)
        return self._abort(SdoAbort.COMMAND_SPECIFIER)

    def _reply(self, command: int, content: bytes = bytes(4)) -> bytes:
        index, subindex = self._place
        return bytes((command, index & 0xFF, index >> 8, subindex)) + content

    def _abort(self, code: SdoAbort) -> bytes:
        reply = self._reply(0x80, code.to_bytes(4, "little"))
        self.reset()
        return reply

    # --- upload: the client reads -----------------------------------------------------------------------------------

    def _initiate_upload(self) -> bytes:
        content = self._store.read(*self._place)
        if isinstance(content, SdoAbort):
            return self._abort(content)
        if not 1 <= len(content) <= 4:
            self._rest = content
            return self._reply(0x41, len(content).to_bytes(4, "little"))
        command = 0x43 | (4 - len(content)) << 2 if self._indicates_size else 0x42
        return self._reply(command, content.ljust(4, b"\0"))

    def _upload_segment(self, command: int) -> bytes:
        if self._rest is None:
            return self._abort(SdoAbort.COMMAND_SPECIFIER)
        if command & 0x10 != self._toggle:
            return self._abort(SdoAbort.TOGGLE_BIT)
        segment, self._rest = self._rest[:_SEGMENT_BYTES], self._rest[_SEGMENT_BYTES:]
        is_last = not self._rest
        reply = bytes((self._toggle | (_SEGMENT_BYTES - len(segment)) << 1 | is_last,)) + segment.ljust(7, b"\0")
        self._toggle ^= 0x10
        if is_last:
            self.reset()
        return reply

    # --- download: the client writes --------------------------------------------------------------------------------

    def _initiate_download(self, request: bytes) -> bytes:
        is_expedited, has_size = request[0] & 0x02, request[0] & 0x01
        if not is_expedited:
            return self._begin_segmented(int.from_bytes(request[4:8], "little") if has_size else None)
        entry = self._store.find(*self._place)
        own = entry.size if entry is not None and 1 <= entry.size <= 4 else 4  # length where none is indicated
        length = 4 - (request[0] >> 2 & 0x03) if has_size else own
        abort = self._store.write(*self._place, request[4 : 4 + length])
        return self._reply(0x60) if abort is None else self._abort(abort)

    def _begin_segmented(self, announced: int | None) -> bytes:
        if (abort := self._store.may_write(*self._place)) is not None:
            return self._abort(abort)
        if announced is not None and announced > _MAX_DOWNLOAD:
            return self._abort(SdoAbort.OUT_OF_MEMORY)
        self._received, self._announced = bytearray(), announced
        return self._reply(0x60)

    def _download_segment(self, request: bytes) -> bytes:
        abort = self._receive(request)
        if abort is not None or self._received is None:
            return self._abort(abort or SdoAbort.COMMAND_SPECIFIER)
        reply = bytes((0x20 | self._toggle,)) + bytes(7)
        self._toggle ^= 0x10
        if request[0] & 0x01:  # the last segment
            is_short = self._announced is not None and len(self._received) < self._announced
            abort = SdoAbort.LENGTH_TOO_LOW if is_short else self._store.write(*self._place, bytes(self._received))
            if abort is not None:
                return self._abort(abort)
            self.reset()
        return reply

    def _receive(self, request: bytes) -> SdoAbort | None:
        """Add a segment to the download in progress; return the abort code, or None."""
        if self._received is None:
            return SdoAbort.COMMAND_SPECIFIER
        if request[0] & 0x10 != self._toggle:
            return SdoAbort.TOGGLE_BIT
        self._received += request[1 : 8 - (request[0] >> 1 & 0x07)]
        if self._announced is not None and len(self._received) > self._announced:
            return SdoAbort.LENGTH_TOO_HIGH
        return SdoAbort.OUT_OF_MEMORY if len(self._received) > _MAX_DOWNLOAD else None
