"""The axes of an EtherCAT line from a capture: frames -> registers, objects and process data -> samples.

No code of a master is shared. Where the inputs of a drive lie, what they hold and when a hold begins follows from what
was written to its registers and objects: FMMUs and sync managers, SYNC0, 0x1C13 and the maps (ETG.1000.4, ETG.1020).
"""

import struct
from collections.abc import Iterator, Sequence
from itertools import chain, pairwise
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from canhaptic.audit.listened_axis import DeclaredDrive, HeardAxis
from canhaptic.errors import InputError
from canhaptic.logs.bus_reader import Remarks
from canhaptic.logs.decoder import Access, PdoMaps, SdoDecoder
from canhaptic.logs.ethercat_frames import CapturedFrame, FrameDatagram, datagrams_of, is_ethercat, read_capture

if TYPE_CHECKING:
    from canhaptic.scene.models import Scene

_SOURCE, _MARK, _NUMBER = 6, 0x02, 17  # place of the source address, the mark of a drive, number of a frame
_FIRST, _HEAD = 16, 10  # [bytes] to the first datagram, and of a head
_SLOW: Final = 0.05  # part of the sample time by which a slow frame is slower than half of them
_RECENT: Final = 32  # frames within which one may come back late
_FEW: Final = 0.05  # part of the frames up to which a number out of order is a gap
_APWR, _FPRD, _FPWR, _BRD, _BWR, _LRD, _LWR, _LRW, _FRMW = 2, 4, 5, 7, 8, 10, 11, 12, 14
_MOVING: Final = frozenset((1, 2, 3, 7, 8, 9, 13))  # commands whose address each drive counts up
_KEPT: Final = frozenset((_APWR, _FPWR, _BWR, _LWR))  # commands whose data come back as they were sent
_STATION, _AL_STATUS, _FMMUS, _MANAGERS, _TIME = 0x0010, 0x0130, 0x0600, 0x0800, 0x0910
_SYNC_START, _SYNC_CYCLE = 0x0990, 0x09A0
_MEMORY: Final = 0x1000
_FMMU: Final = struct.Struct("<IHBBHBBB3x")  # logical begin, length, bits, physical begin, bit, kind, is active
_INPUT, _OUTPUT = 1, 2  # kinds of an FMMU
_NOTHING: Final = ((0, 0), (0, 0))  # outputs and inputs of a drive that has none
_ASSIGNED: Final = 0x1C13
_COE, _SDO_REQUEST, _SDO_ANSWER = 3, 2, 3
_MAIL: Final = 16  # [bytes] of a mail with the first 8 of an SDO


class _Exchange(NamedTuple):
    """A frame of the master, and as it came back; None where it did not."""

    number: int
    time: int  # [ns]
    taken: int  # time until it came back [ns]
    sent: list[FrameDatagram]
    answer: list[FrameDatagram] | None


class _Drive:
    """What the capture tells of one drive."""

    def __init__(self) -> None:
        self.registers = bytearray(_MEMORY)
        self.sdo, self.maps = SdoDecoder(), PdoMaps(0, None)
        self.assigned = 0

    def part(self, kind: int) -> tuple[int, int]:
        """Return the logical begin and the length of its outputs or inputs; a length of 0 where there are none."""
        begin, size = struct.unpack_from("<HH", self.registers, _MANAGERS + 8 * (2 if kind == _OUTPUT else 3))
        for at in range(_FMMUS, _FMMUS + 256, _FMMU.size):
            logical, length, _, _, physical, _, of, is_active = _FMMU.unpack_from(self.registers, at)
            if is_active & 1 and of == kind and begin <= physical < begin + size:
                return logical, length
        return 0, 0

    def mail(self, data: bytes, axes: Sequence[HeardAxis], *, is_request: bool) -> None:
        """Learn from an SDO."""
        if len(data) < _MAIL or data[5] & 0x0F != _COE or data[7] >> 4 != (
            _SDO_REQUEST if is_request else _SDO_ANSWER
        ):  # fmt: skip
            return
        _, access = self.sdo.sdo(data[8:_MAIL], is_request=is_request)
        if access is not None:
            self.maps.learn(access)
            self._assign(access)
            for axis in axes:
                axis.learn(access)

    def _assign(self, access: Access) -> None:
        if access[:2] == (_ASSIGNED, 1):
            self.assigned = int.from_bytes(access.value, "little")


class ListenedLine:
    """The axes of one line.

    Args:
        drives: Declared drives of the axes.
        scene: Scene of the run.
        remarks: Takes what is damaged or missing.

    Attributes:
        axes: The axes, in the order of the scene.

    Raises:
        InputError: The scene has several buses, and a capture is of one.
    """

    def __init__(self, drives: Sequence[DeclaredDrive], scene: "Scene", remarks: Remarks) -> None:
        if len(scene.buses) > 1:
            text = f"{scene.source}: got {len(scene.buses)} buses, expected one: a capture holds the frames of one line"
            raise InputError(f"{text}; compare the energy log by --recompute")
        self.axes = [HeardAxis(drive) for drive in drives]
        bus: Any = scene.bus
        self._places = [drive.place for drive in drives]
        self._period, self._frames, self._remarks = scene.bus.sample_time_ns, bus.frames, remarks
        self._drives: dict[int, _Drive] = {}  # by position
        self._stations: dict[int, int] = {}  # station address -> position
        self._parts: dict[int, tuple[tuple[int, int], tuple[int, int]]] = {}  # position -> outputs, inputs
        self._clock = -1  # position of the reference clock
        self._hold = self._counted = self._slip = -1
        self._slow = 0.0  # time on the way beyond which a frame says nothing of the host's phase [ns]
        self._sent = -1  # time of the last row [ns]

    # --- frames -----------------------------------------------------------------------------------------------------

    def rows(self, path: str | Path) -> Iterator[int]:
        """Yield, for each frame that brings inputs, the sample times since the one before; the axes have heard it.

        Raises:
            LogFormatError: The capture cannot be read.
        """
        frames, was_read, last = read_capture(path), False, None
        self._look_for_gaps(frames)
        ways = [two.time - one.time for one, two in pairwise(frames) if two.content[_SOURCE] & _MARK]
        self._slow = (median(ways) if ways else 0) + _SLOW * self._period
        for next_one in chain(self._exchanges(frames), (None,)):
            one, last = last, next_one
            if one is None:
                continue
            self._learn(one)
            command = max((of.command for of in one.sent if _LRD <= of.command <= _LRW), default=0)
            if not command:
                continue
            is_read = command == _LRD
            if command == _LRW:  # reads, and then writes, by the same command: after a read states are asked for
                asks = next_one is not None and (next_one.sent[0].command, next_one.sent[0].offset) == (
                    _BRD,
                    _AL_STATUS,
                )
                is_read = self._frames == 1 or asks or not was_read
            was_read = is_read
            if one.answer and self._hold >= 0 and self._whole(one.answer) is None:
                self._remarks.note("came back with a low counter", one.number)
            if is_read and self._clock >= 0:
                yield self._row(one)

    def _exchanges(self, frames: list[CapturedFrame]) -> Iterator[_Exchange]:
        """Yield the frames of the master, each with its answer."""
        waiting: tuple[int, int, bytes] | None = None
        lost: dict[int, int] = {}  # number of a frame without answer -> its place
        for number, (time, content) in enumerate(frames, 1):
            if not is_ethercat(content):
                continue
            if not content[_SOURCE] & _MARK:
                if waiting is not None:
                    lost[waiting[2][_NUMBER]] = waiting[0]
                    yield from self._exchange(*waiting)
                waiting = number, time, content
            elif waiting is None or waiting[2][_NUMBER] != content[_NUMBER]:
                if number - lost.pop(content[_NUMBER], -_RECENT) < _RECENT:
                    self._remarks.note("came back after the next one had left", number)
                else:
                    self._remarks.damaged("answers a frame that is not in the capture before it", number)
            else:
                yield from self._exchange(*waiting, content, time - waiting[1])
                waiting = None
        if waiting is not None:
            yield from self._exchange(*waiting)

    def _exchange(
        self, number: int, time: int, content: bytes, came: bytes | None = None, taken: int = 0
    ) -> Iterator[_Exchange]:
        sent, answer = datagrams_of(content), None if came is None else datagrams_of(came)
        if not sent or (came is not None and answer is None):
            self._remarks.damaged("is damaged: its datagrams do not end where it does", number)
            return
        if came is None:
            self._remarks.note("has no answer", number)
        elif self._altered(content, came, sent):
            self._remarks.damaged("and its answer differ in what no drive alters", number)
        yield _Exchange(number, time, taken, sent, answer)

    def _altered(self, sent: bytes, came: bytes, datagrams: list[FrameDatagram]) -> bool:
        """Return whether an answer differs in more than drives alter: counters, data that are read, and their marks."""
        back, at = bytearray(came), _FIRST
        back[_SOURCE] &= ~_MARK
        for of in datagrams:
            data, stop = at + _HEAD, at + _HEAD + len(of.data)
            alters = [(at + 8, data), (stop, stop + 2)]  # event requests, counter
            if of.command in _MOVING:
                alters.append((at + 2, at + 4))
            if of.command not in _KEPT:
                alters.append((data, stop))
            for begin, end in alters:
                back[begin:end] = sent[begin:end]
            if of.command == _LRW:
                for (begin, size), _ in self._parts.values():
                    place = data + begin - (of.address | of.offset << 16)
                    back[place : place + size] = came[place : place + size]
            if of.counter:
                return True
            at = stop + 2
        return back[:at] != sent[:at]  # an interface fills a short frame up

    def _look_for_gaps(self, frames: list[CapturedFrame]) -> None:
        """Name frames that are missing where the master numbers its frames one by one, and none was lost before."""
        line = [(place, of.content) for place, of in enumerate(frames, 1) if is_ethercat(of.content)]
        most = 1 + max((content[_NUMBER] for _, content in line), default=0)
        gaps, before, since = list[int](), -1, 2 * most
        for (place, content), (_, after) in pairwise((*line, (0, bytes(_NUMBER + 1)))):
            if content[_SOURCE] & _MARK:
                continue
            if before >= 0 and (before + 1) % most != content[_NUMBER] and since > most:
                gaps.append(place)
            before, is_answered = content[_NUMBER], after[_SOURCE] & _MARK
            since = since + 1 if is_answered else 0  # a lost frame keeps its number for some time
        if len(gaps) <= _FEW * len(line):
            for place in gaps:
                self._remarks.damaged("comes after a gap in the numbers of the frames: some are missing", place)

    def _learn(self, one: _Exchange) -> None:
        """Take what a frame tells of registers and objects."""
        for sent, of in zip(one.sent, one.answer or (), strict=False):
            if not of.counter:
                continue
            if sent.command == _APWR and sent.offset == _STATION:
                self._stations[int.from_bytes(sent.data[:2], "little")] = -sent.address & 0xFFFF
            elif sent.command in (_APWR, _FPWR, _BWR):
                self._write(sent)
            elif sent.command == _FRMW and sent.offset == _TIME:
                self._clock = self._stations.get(sent.address, -1)
            elif sent.command == _FPRD and sent.offset >= _MEMORY:
                self._mail(sent.address, of.data, is_request=False)

    def _write(self, sent: FrameDatagram) -> None:
        if sent.offset >= _MEMORY:
            self._mail(sent.address, sent.data, is_request=True)
            return
        place = -sent.address & 0xFFFF if sent.command == _APWR else self._stations.get(sent.address, -1)
        places = [*self._stations.values()] if sent.command == _BWR else [place]
        for each in places:
            self._drive(each).registers[sent.offset : sent.offset + len(sent.data)] = sent.data
        self._parts = {place: (of.part(_OUTPUT), of.part(_INPUT)) for place, of in self._drives.items()}

    def _drive(self, place: int) -> _Drive:
        return self._drives.setdefault(place, _Drive())

    def _mail(self, station: int, data: bytes, *, is_request: bool) -> None:
        place = self._stations.get(station, -1)
        heard = [axis for axis, of in zip(self.axes, self._places, strict=True) if of == place]
        self._drive(place).mail(data, heard, is_request=is_request)

    # --- samples ----------------------------------------------------------------------------------------------------

    def _row(self, one: _Exchange) -> int:
        """Let the axes hear the inputs of a frame, if it came back whole and in its own hold; return its periods."""
        period, before = self._period, self._sent
        self._sent = one.time
        periods = 1 if before < 0 else (one.time - before + period // 2) // period or 1
        self._counted += periods
        for axis in self.axes:
            axis.forget()
        if one.answer is None or (image := self._whole(one.answer)) is None:
            return periods
        slip = self._slip_of(one.answer, one.taken > self._slow)
        if slip is None:
            return periods
        for axis, place in zip(self.axes, self._places, strict=True):
            drive, (begin, size) = self._drive(place), self._parts.get(place, _NOTHING)[1]
            at = begin - (image.address | image.offset << 16)
            axis.hear(drive.maps.fields(drive.assigned, image.data[at : at + size]))
        return max(1, periods + slip)

    def _whole(self, answer: list[FrameDatagram]) -> FrameDatagram | None:
        """Return the datagram of the process image; None where a drive let one pass unread."""
        image = None
        for of in answer:
            if _LRD <= of.command <= _LRW:
                image = of
                writes = 0 if of.command == _LRD else 1 if of.command == _LWR else 2
                expected = sum(
                    writes * (outputs[1] > 0) + (of.command != _LWR) * (inputs[1] > 0)
                    for outputs, inputs in self._parts.values()
                )
                if of.counter != expected:
                    return None
            elif of.command == _BRD and of.counter != len(self._stations):
                return None
        return image

    def _slip_of(self, answer: list[FrameDatagram], was_slow: bool) -> int | None:
        """Return by how many holds more than counted a frame came after the last one; None in another than its own.

        One that was slow says nothing: the next, in its own hold, is the second in a row without it.
        """
        registers = self._drive(self._clock).registers
        first, cycle = (
            int.from_bytes(registers[at : at + n], "little") for at, n in ((_SYNC_START, 8), (_SYNC_CYCLE, 4))
        )
        time = next((of.data for of in answer if of.command == _FRMW), b"")
        if not cycle or len(time) < 8:
            return None
        hold, taken = (int.from_bytes(time[:8], "little") - first) // cycle, self._hold
        slip = hold - taken - self._counted
        if taken >= 0 and slip and (hold <= taken or (slip > 0 and (was_slow or slip != self._slip))):
            self._slip = 0 if was_slow else slip
            return None
        self._hold, self._counted, self._slip = hold, 0, 0
        return slip if taken >= 0 else 0
