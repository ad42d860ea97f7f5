"""Replay of a recorded bus: the real master and controllers of a scene, against the recorded frames of the drives.

Every frame that the master sends is compared with the recording. Which recorded frames are the master's follows from
the scene, since a recording need not state the sender. The clock is that of the recording: it advances only when the
master waits, to the next recorded frame, however long the master computes today. So a SYNC that was late in the
recording is equally late now, and the same deadlines are skipped. A recording that lacks the start of the drives is
joined at the first SYNC that found every axis enabled.
"""

import struct
from collections import deque
from collections.abc import Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal, NamedTuple, TypedDict, TypeVar

import can

from canhaptic.canopen import objects as od
from canhaptic.canopen.objects import SYNC_FRAME_COB_ID
from canhaptic.cycle import Cycle, run
from canhaptic.drive.can.bus_cycle import can_buses
from canhaptic.drive.can.door import open_bus, private_channel
from canhaptic.drive.can.link import Link
from canhaptic.drive.can.pdo_map import choose_map, codec
from canhaptic.drive.can.servo_drive import ServoDrive
from canhaptic.drive.clock import Clock, FrameSource, WallClock
from canhaptic.drive.profile.fitness import agreed_rated_torque
from canhaptic.drive.profile.quirks import quirks_of
from canhaptic.drive.profile.scaling import axis_scaling
from canhaptic.drive.rig import Rig
from canhaptic.drive.safety.power_states import is_enabled
from canhaptic.errors import InputError, LogFormatError, RigError
from canhaptic.logs.bus_reader import Frame, Remarks, read_bus_log
from canhaptic.logs.decoder import BusDecoder
from canhaptic.logs.text_lines import SkippedKind
from canhaptic.result import RunResult, run_result
from canhaptic.scene import parts
from canhaptic.scene.build import build_loss_meters
from canhaptic.scene.buses import can_bus, kind_of
from canhaptic.scene.models import Scene
from canhaptic.scene.scene_logs import Channels, describe_nodes

if TYPE_CHECKING:
    from canhaptic.logs.frame_log import LoggedFrame

_Frame = TypeVar("_Frame")
_ENABLE_BITS: Final = int(od.Controlword.ENABLE_OPERATION)

Address = tuple[int, int]
"""Index of the bus in the scene, COB-ID."""


class Roles(NamedTuple):
    """COB-IDs of a scene, by their role in a replay."""

    master: frozenset[Address]  # sent by the master
    sdo_requests: frozenset[Address]
    heartbeat: int  # the master's
    rpdo: Address  # of the first axis
    controlword: struct.Struct  # in that RPDO
    statuswords: dict[Address, struct.Struct]  # TPDO with the statusword -> its place in the frame; one per axis
    commands: dict[Address, tuple[str, struct.Struct, bool]]  # RPDO -> axis, place of its target; is it a position

    def asks_to_leave(self, data: bytes) -> bool:
        """Return whether an RPDO of the first axis revokes OPERATION ENABLED.

        0x0F keeps the state and 0x00 revokes it; the majority of bits decides, so that one flipped bit changes nothing.
        """
        (controlword,) = self.controlword.unpack(data) if len(data) == self.controlword.size else (_ENABLE_BITS,)
        return (int(controlword) & _ENABLE_BITS).bit_count() < _ENABLE_BITS.bit_count() // 2

    def shows_enabled(self, address: Address, data: bytes) -> bool:
        """Return whether a TPDO with a statusword shows OPERATION ENABLED."""
        image = self.statuswords[address]
        return len(data) == image.size and is_enabled(int(image.unpack(data)[0]))


def roles_of(scene: Scene) -> Roles:
    """Return the roles of the COB-IDs of a scene.

    Raises:
        DictionaryError: A dictionary cannot be read or has no fitting PDOs.
    """
    places = {bus.name: place for place, bus in enumerate(scene.buses)}
    axes = [axis.parameters for axis in scene.axes]
    on = [places[axis.bus] for axis in scene.axes]
    maps = [choose_map(axis.dictionary(), axis) for axis in axes]
    sensors = [axis.causality.force.node for axis in axes]
    nodes = zip(on * 2, [*axes, *sensors], strict=True)
    sdo_requests = frozenset((bus, od.SDO_REQUEST_BASE + of.node_id) for bus, of in nodes if of and of.node_id)
    rpdos = [(bus, plan.rpdo.cob_id) for bus, plan in zip(on, maps, strict=True)]
    heartbeat = od.HEARTBEAT_BASE + can_bus(scene.bus).master_id
    on_every_bus = {(bus, cob_id) for bus in on for cob_id in (od.NMT_COB_ID, od.SYNC_FRAME_COB_ID, heartbeat)}
    return Roles(
        sdo_requests | frozenset(rpdos) | on_every_bus,
        sdo_requests,
        heartbeat,
        rpdos[0],
        codec(maps[0].rpdo.entries, [od.CONTROLWORD]),
        {
            (bus, tpdo.cob_id): codec(tpdo.entries, [od.STATUSWORD])
            for bus, plan in zip(on, maps, strict=True)
            for tpdo in plan.tpdos
            if any(entry.index == od.STATUSWORD for entry in tpdo.entries)
        },
        {
            (bus, plan.rpdo.cob_id): (
                axis.name,
                codec(plan.rpdo.entries, _TARGETS),
                any(entry.index == od.TARGET_POSITION for entry in plan.rpdo.entries),
            )
            for bus, plan, axis in zip(on, maps, axes, strict=True)
        },
    )


_TARGETS: Final = (od.TARGET_TORQUE, od.TARGET_VELOCITY, od.TARGET_POSITION)
_UPLOAD: Final = 0x40  # first byte of an SDO request that reads
_NOTED: Final = (od.POLARITY, od.POSITIVE_TORQUE_LIMIT, od.NEGATIVE_TORQUE_LIMIT)
_STATUSWORD: Final = struct.pack("<H", od.STATUSWORD)
_SYNC: Final[Address] = (0, od.SYNC_FRAME_COB_ID)


class Recording:
    """The frames of one bus log, without the master's heartbeats.

    The heartbeats follow the wall clock of the host: after skipped SYNCs, microseconds decide when a heartbeat is due,
    and the times in a log are less exact.

    Attributes:
        path: The log.
        frames: All other data frames, in the order of the log.
        remarks: What was left out of the log, and what is odd about its times.
        addresses: Index of each frame's bus in the scene, and its COB-ID.
        heartbeat: COB-ID of the master's heartbeat.
        is_master: Whether the master sent each frame.
        has_boot: Whether the start of the drives is in the log.
        first_sync: Index of the frame that is SYNC 0, on the first bus; -1 when no SYNC found every axis enabled.

    Raises:
        LogFormatError: The log cannot be read, lacks times, or holds no frame of the master.
    """

    def __init__(self, path: str | Path, scene: Scene) -> None:
        self.path, roles, channels = Path(path), roles_of(scene), Channels(scene)
        self.heartbeat = roles.heartbeat
        self.remarks = Remarks()
        self.frames = [frame for frame in read_bus_log(path, self.remarks) if frame.can_id != roles.heartbeat]
        if self.remarks.untimed:
            text = f"{self.remarks.untimed} frames have no time, and a replay needs the time of each"
            raise LogFormatError(f"{path}: {text}; record with candump -L, or with -ta for the screen")
        self.addresses = [(channels.place_of(frame), frame.can_id) for frame in self.frames]
        self.is_master = [address in roles.master for address in self.addresses]
        if not any(self.is_master):
            raise LogFormatError(
                f"{path}: none of its {len(self.frames)} frames is one that the master of the scene sends; "
                "is it the log of another scene?"
            )
        self._roles = roles
        self.first_sync = _first_sync(self.addresses, self.frames, roles)
        before = self.addresses[: self.first_sync] if self.first_sync >= 0 else self.addresses
        self.has_boot = any(address in roles.sdo_requests for address in before)

    def sdo_frames(self, bus: int, node_id: int, index: int) -> list[tuple[int, bytes]]:
        """Return the SDO requests and answers of a node for subindex 0 of an object: COB-ID less node ID, and data."""
        named, bases = struct.pack("<HB", index, 0), (od.SDO_REQUEST_BASE, od.SDO_RESPONSE_BASE)
        pairs = zip(self.addresses, (frame.data for frame in self.frames), strict=True)
        found = [(can_id - node_id, data) for (place, can_id), data in pairs if place == bus and data[1:4] == named]
        return [(base, data) for base, data in found if base in bases]

    def first_request(self, bus: int, node_id: int) -> bytes:
        """Return the data of the first SDO request to a node; empty without one."""
        pairs = zip(self.addresses, (frame.data for frame in self.frames), strict=True)
        return next((data for address, data in pairs if address == (bus, od.SDO_REQUEST_BASE + node_id)), b"")

    @property
    def restoring(self) -> int:
        """Index of the frame with which the stop begins to restore values: the state request after the last SYNC."""
        asks = bytes([_UPLOAD]) + struct.pack("<HB", od.STATUSWORD, 0)
        last = max((n for n, address in enumerate(self.addresses) if address == _SYNC), default=0)
        after = range(last, len(self.frames))
        return next((n for n in after if self.is_master[n] and self.frames[n].data[:4] == asks), len(self.frames))

    def commands(self, stop: int) -> dict[str, int]:
        """Return, for each axis, how many RPDOs had a torque or velocity, or another position than its first.

        Args:
            stop: Index of the first frame that does not count.
        """
        rest, found = dict[str, tuple[int, ...]](), {name: 0 for name, *_ in self._roles.commands.values()}
        for address, frame in zip(self.addresses[:stop], self.frames, strict=False):
            if address in self._roles.commands:
                name, image, is_position = self._roles.commands[address]
                if len(frame.data) == image.size:
                    target = image.unpack(frame.data)
                    found[name] += target != rest.setdefault(name, target if is_position else (0,) * len(target))
        return found

    def operator_cycles(self) -> int | None:
        """Return the number of cycles of a run that the operator stopped, with those of the stop; None without one.

        After an operator's stop the last SYNC before the drives are disabled was answered by an RPDO and followed by
        one more; after a fault it was answered by zero torque alone.
        """
        syncs, commands = self._run()
        return None if commands is None or len(syncs) != len(commands) else max(0, len(syncs) - 1)

    def end_before_ramp(self, ramp_cycles: int) -> int | None:
        """Return the index of the frame with which the ramp of an older master begins; None without one.

        Until the holds of a stop were booked, every stop had this ramp: its last commands all differ.
        """
        syncs, commands = self._run()
        ramp = commands[-ramp_cycles - 1 : -1] if commands is not None and len(syncs) == len(commands) else []
        return syncs[-ramp_cycles - 1] if ramp_cycles > 2 and len(set(ramp)) == ramp_cycles else None

    def _run(self) -> tuple[list[int], list[bytes] | None]:
        """Return the index of each SYNC of the run, and the first axis's commands before it is asked to leave."""
        syncs, commands = list[int](), list[bytes]()
        first = len(self.frames) if self.first_sync < 0 else self.first_sync
        for index in range(first, len(self.frames)):
            if self.addresses[index] == _SYNC:
                syncs.append(index)
            elif self.addresses[index] == self._roles.rpdo:
                if self._roles.asks_to_leave(self.frames[index].data):
                    return syncs, commands
                commands.append(self.frames[index].data)
        return syncs, None


def _first_sync(addresses: Sequence[Address], frames: Sequence[Frame], roles: Roles) -> int:
    """Return the index of the first SYNC that every axis answered in OPERATION ENABLED; -1 when there is none."""
    sync, enabled = -1, set[Address]()
    for index, (address, frame) in enumerate(zip(addresses, frames, strict=True)):
        if address == _SYNC:
            sync, enabled = index, set()
        elif sync >= 0 and address in roles.statuswords:
            if roles.shows_enabled(address, frame.data):
                enabled.add(address)
            if len(enabled) == len(roles.statuswords):
                return sync
    return -1


NEVER: Final = 1 << 62  # [ns]
_MOST_WAITS: Final = 1000
"""Waits of a master that sends no frame, after which its time goes on: it waits for an answer that the log lacks."""


class ReplayOverError(BaseException):
    """End of a replay: the recording is at its end, or the master sent another frame.

    It is no `Exception`, so that no handler treats it as a fault of drive or link and continues sending.
    """


class RecordedSide:
    """Plays the frames of other nodes (a `SimulatedPeer`), and compares the master's frames except heartbeats.

    Order and times follow the recording: a frame is played once the master has sent everything recorded
    before it. Recorded frames of the drives that precede a frame of the master have reached it when it sends
    that frame.

    Args:
        buses: Connections to the buses, in the order of the scene.
        recording: Recording to play.
        first: Index of the first frame to play.

    Attributes:
        end: Index of the frame with which the comparison ends.
        compared: Number of frames of the master found equal so far.
        played: Number of frames of the drives sent so far.
        reached: Recorded time of the master's last frame [ns], which includes its computation.
        departure: First difference: index of the recorded frame; bus, COB-ID and data of the frame sent instead. None
            if there is none yet.
    """

    def __init__(self, buses: Sequence[can.BusABC], recording: Recording, first: int) -> None:
        self._buses = tuple(buses)
        self._sent: list[deque[can.Message]] = [deque() for _ in buses]  # by the master, not compared yet
        self._addresses = recording.addresses
        self._frames = recording.frames
        self._is_master = recording.is_master
        self._left_out = recording.heartbeat
        self.end = recording.restoring if first else len(recording.frames)  # a joined rig restores nothing
        self._next = first
        self._is_over = False
        self.compared = self.played = self.reached = 0
        self.departure: tuple[int, int, int, bytes] | None = None

    def process(self, now: int) -> None:
        """Compare every frame that the master has sent, and send the frames due up to `now` [ns].

        Raises:
            ReplayOverError: The recording is at its end, or the master sent another frame.
        """
        if self._is_over:  # the rig tries to stop its drives on the way out
            raise ReplayOverError
        for bus, sent in zip(self._buses, self._sent, strict=True):
            while (message := bus.recv(0.0)) is not None:
                if message.arbitration_id != self._left_out and not message.is_remote_frame:
                    sent.append(message)
        while any(self._sent):
            self._compare()
        while self.next_due() <= now:
            self._play()

    def next_due(self, *, of_master: bool = False) -> int:
        """Return when the next frame of the drives or the master is due [ns]; `NEVER` if the other side sends next."""
        if self._next == self.end or self._is_master[self._next] != of_master:
            return NEVER
        return self._frames[self._next].timestamp_ns

    @property
    def place(self) -> int:
        """Index of the first recorded frame that was neither played nor compared."""
        return self._next

    @property
    def unsent(self) -> int:
        """Index of the first recorded frame that the master has not sent; -1 if it has sent all."""
        return next((index for index in range(self._next, self.end) if self._is_master[index]), -1)

    def _play(self) -> None:
        frame, bus = self._frames[self._next], self._buses[self._addresses[self._next][0]]
        self._next += 1
        self.played += 1
        bus.send(frame.message())

    def _compare(self) -> None:
        """Compare one frame of the master with its recording, if possible on the bus of the next recorded frame."""
        while self._next < self.end and not self._is_master[self._next]:
            self._play()
        if self._next == self.end:
            raise self._over()
        frame, (place, can_id) = self._frames[self._next], self._addresses[self._next]
        bus = place if self._sent[place] else next(n for n, sent in enumerate(self._sent) if sent)
        message = self._sent[bus].popleft()
        if bus != place or message.arbitration_id != can_id or message.data != frame.data:
            self.departure = self._next, bus, message.arbitration_id, bytes(message.data)
            raise self._over()
        self.reached = frame.timestamp_ns
        self._next += 1
        self.compared += 1

    def _over(self) -> ReplayOverError:
        self._is_over = True
        return ReplayOverError()


class RecordedClock:
    """A `Clock` that follows the times of a recording.

    Args:
        side: Drives' side of the recording.
        start: The time at the beginning [ns].
        pace: Clock to keep pace with; None to run as fast as possible.
    """

    def __init__(self, side: RecordedSide, start: int, pace: Clock | None = None) -> None:
        self._side = side
        self._now = start
        self._pace = pace
        self._lead: int | None = None  # of the pace over the recording, from the first wait on
        self._waits, self._waited_at = 0, -1  # how often for the master's next frame, and the place of that

    def now(self) -> int:
        """Return the time of the recording [ns]."""
        return self._now

    def wait_until(self, deadline: int) -> None:
        """Run the recorded side until `deadline` [ns]."""
        while self._now < deadline:
            self._side.process(self._now)
            self._move(min(deadline, max(self._now + 1, self._side.next_due())))

    def receive(self, bus: FrameSource[_Frame], deadline: int) -> _Frame | None:
        """Return the next frame of the drives; None when the master's frame is due first, or at `deadline` [ns]."""
        side = self._side
        while True:
            side.process(self._now)
            self._move(side.reached)
            if (message := bus.recv(0.0)) is not None:
                return message
            due, command = side.next_due(), side.next_due(of_master=True)
            if due == NEVER:
                self._waits, self._waited_at = self._waits * (side.place == self._waited_at) + 1, side.place
                self._move(command if command != NEVER and self._waits < _MOST_WAITS else deadline)
                return None
            self._move(due)  # recorded before the master's next frame, so it comes before it, however late it was

    def _move(self, now: int) -> None:
        if now > self._now:
            if self._pace is not None:
                if self._lead is None:
                    self._lead = self._pace.now() - self._now
                self._pace.wait_until(now + self._lead)
            self._now = now


class JoinedRig(Rig):
    """A rig whose `start` sends only SYNC 0, for recorded drives that are enabled; it would not check real drives."""

    def start(self) -> None:
        """Send SYNC 0 and receive its TPDOs."""
        self._reset()
        for drive in self.drives:
            _suppose_enabled(drive)
        exchange = self._exchange
        exchange.begin()
        exchange.sync()
        self.sync_index = 0
        self.is_running = True
        self._first_samples = [drive.sample(0) for drive in self.drives]
        for drive in self.drives:
            drive.watch_statusword()


def _suppose_enabled(drive: ServoDrive) -> None:
    """Set the values that the start would have read from the drive."""
    drive.reset()
    drive.is_ours = True
    drive.nmt_state = int(od.NmtState.OPERATIONAL)
    drive.controlword = int(od.Controlword.ENABLE_OPERATION)
    variable = drive.dictionary.get_variable(od.RATED_TORQUE, 0)
    stated = None if drive.axis.rated_torque or variable is None else variable.default
    rated_torque = agreed_rated_torque(drive.axis, stated, quirks_of(drive.axis.quirks).rated_torque_resolution)
    drive.scaling = axis_scaling(drive.axis, rated_torque)


_SHOWN_BEFORE: Final = 6  # frames
_CYCLES_BACK: Final = 2
_LONGEST_SILENCE: Final = 1.5  # sample times within a recording without gaps


class FrameWords(TypedDict):
    """One frame of the bus, decoded into words."""

    channel: str
    id: int
    data: str
    kind: str
    node: str
    text: str


class FrameBefore(FrameWords):
    """One of the last frames before the first difference."""

    number: int  # of its line in a text, or of the frame in a binary log
    time: float  # since the beginning of the log [s]
    direction: str


class FirstDifference(TypedDict):
    """The first frame in which master and recording differ."""

    number: int
    time: float
    recorded: FrameWords
    sent: FrameWords | None  # None: the master sent no further frame
    gap: float | None  # longest silence shortly before it, if the recording seems to lack frames [s]
    before: list[FrameBefore]


def describe(recording: Recording, side: RecordedSide, scene: Scene) -> FirstDifference | None:
    """Return the first difference; None when the master sent all that was recorded."""
    index = side.unsent if side.departure is None else side.departure[0]
    if index < 0:
        return None
    frames, start = recording.frames, recording.frames[0].timestamp_ns
    nodes = describe_nodes(scene)
    decoders = [BusDecoder([node for node in nodes if node.bus == place]) for place in range(len(scene.buses))]
    before: list[FrameBefore] = []
    for number, (frame, (bus, _)) in enumerate(zip(frames[:index], recording.addresses, strict=False)):
        words = _words(frame, decoders[bus])  # of every frame: the maps are learnt from the start
        if number >= index - _SHOWN_BEFORE:
            direction, time = "T" if recording.is_master[number] else "R", (frame.timestamp_ns - start) * 1e-9
            before.append({"number": frame.number, "time": time, "direction": direction, **words})
    recorded, (bus, _) = frames[index], recording.addresses[index]
    sent = None
    if side.departure is not None:
        _, other, can_id, data = side.departure
        channel = recorded.channel if other == bus else scene.buses[other].name
        sent = _words(recorded._replace(can_id=can_id, data=data, channel=channel), decoders[other])
    return {
        "number": recorded.number,
        "time": (recorded.timestamp_ns - start) * 1e-9,
        "recorded": _words(recorded, decoders[bus]),
        "sent": sent,
        "gap": _gap(recording, index, scene.bus.sample_time),
        "before": before,
    }


def _gap(recording: Recording, index: int, sample_time: float) -> float | None:
    """Return the longest silence of the recording in the two cycles before a frame [s]; None for a usual one.

    After a longer one frames are missing from the recording: SYNCs that the master itself skipped are skipped again in
    the replay.
    """
    if recording.first_sync < 0:
        return None
    frames, syncs, silence = recording.frames, 0, 0.0
    for place in range(index, recording.first_sync, -1):
        silence = max(silence, (frames[place].timestamp_ns - frames[place - 1].timestamp_ns) * 1e-9)
        syncs += frames[place].can_id == SYNC_FRAME_COB_ID
        if syncs == _CYCLES_BACK:
            break
    return silence if silence > _LONGEST_SILENCE * sample_time else None


def _words(frame: Frame, decoder: BusDecoder) -> FrameWords:
    kind, node, text = decoder.decode(frame.can_id, frame.data)
    data = frame.data.hex().upper()
    return {"channel": frame.channel, "id": frame.can_id, "data": data, "kind": kind, "node": node, "text": text}


_BUS: Final[dict[str, object]] = {"interface": "virtual", "channel": None, "options": {}}


class ReplayResult(TypedDict):
    """Result of a replay; times in [s]."""

    status: Literal["identical", "different"]
    recording: str
    start: Literal["boot", "sync"]
    skipped: dict[SkippedKind, int]  # frames left out
    remarks: list[str]  # the same in words, and what is odd about the times
    reads_left_out: list[str]  # `axis: object` that the start reads or writes today and the recorded master did not
    frames: dict[Literal["recorded", "played", "compared"], int]
    cycles: int
    duration: float
    elapsed: float
    speed: float
    ended: str
    stop: str  # "operator", the name of the error that ended the run, or "none": the recording ended before
    commands: dict[str, int]  # axis -> RPDOs with a torque other than zero; of a display with a velocity or a motion
    difference: FirstDifference | None
    account: RunResult


def replay_bus_log(
    bus_log: str | Path, scene: Scene, *, realtime: bool = False, from_sync: bool = False, dry_run: bool = False
) -> ReplayResult:
    """Replay a recording and report whether the master sends the same frames today.

    Boot, SDO answers, TPDOs, heartbeats and EMCYs come from the recording, on python-can's virtual bus; rig,
    controllers and accounts are the scene's. A recording without the start of the drives is replayed from the
    first SYNC that found every axis enabled, with the maps of the scene and controllers at rest.

    Args:
        bus_log: Any bus log with times: candump text, SavvyCAN's CSV, BLF, TRC, ASC; each also compressed by gzip.
        scene: Scene of the run; its bus is replaced by a virtual one and nothing is simulated.
        realtime: Whether to keep the pace of the recording instead of running as fast as the machine allows.
        from_sync: Whether to leave the start out even if it was recorded.
        dry_run: Whether the recorded run was a dry run.

    Raises:
        InputError: The recording cannot be read, does not fit the scene, has no SYNC to begin with, or no whole cycle.
    """
    with closing(OpenReplay(bus_log, scene, realtime=realtime, from_sync=from_sync, dry_run=dry_run)) as replay:
        found = replay.run()
    if found["status"] == "identical" or not replay.has_ramped:
        return found
    # Frames do not show where a stop began: without a ramp it was later
    with closing(OpenReplay(bus_log, scene, realtime=realtime, from_sync=from_sync, dry_run=dry_run)) as replay:
        again = replay.run(ramps=False)
    return again if again["status"] == "identical" else found


class LineReplay(NamedTuple):
    """Outcome of a replay of an EtherCAT line."""

    recorded: int  # frames of the master in the log
    compared: int  # of these found equal
    difference: str  # the first other frame, in words; empty where every frame is the recorded one


def replay_line(bus_log: str | Path, scene: Scene, *, dry_run: bool = False, cycles: int | None = None) -> LineReplay:
    """Replay the log of a simulated EtherCAT line: every frame of the master must be the recorded one, at its time.

    Args:
        bus_log: The log of a run in virtual time, of any length.
        scene: Scene of the run.
        dry_run: Whether it was a dry run.
        cycles: Cycles of the run, with those of its stop (`audit.recompute.cycles_on_line`); None: as the scene says.

    Raises:
        InputError: The log cannot be read, or the scene is not of one simulated EtherCAT line.
    """
    from canhaptic.logs.frame_log import read_frame_log

    frames = read_frame_log(bus_log)
    if len(scene.buses) > 1 or not scene.simulated or kind_of(scene.bus) != "ethercat":
        raise InputError(f"{bus_log}: is the log of a simulated EtherCAT line; give the scene of one such line")
    duration, found = scene.run.duration, list[LineReplay]()
    declared = None if duration is None else max(1, round(duration / scene.bus.sample_time))
    for most in dict.fromkeys((cycles or declared, declared, None)):  # None: it ended for its reason
        found.append(_played(frames, scene, most, dry_run=dry_run))
        if not found[-1].difference:
            return found[-1]
    return max(found, key=lambda one: one.compared)


def _played(frames: "list[LoggedFrame]", scene: Scene, cycles: int | None, *, dry_run: bool) -> LineReplay:
    """Return the outcome of one replay, which is stopped so that it has so many cycles; None: it ends by itself."""
    from canhaptic.logs.frame_log import ReplayDepartureError
    from canhaptic.scene.build import Experiment

    difference = ""
    with Experiment(scene, "free", None, None, no_torque=dry_run, recorded=frames) as experiment:
        cycle = experiment.cycle

        try:
            run(cycle, None, lambda: cycles is not None and _is_due(cycle, cycles, scene.bus.rate))
        except ReplayDepartureError as error:
            difference = str(error)
        except RigError:
            pass  # the run ended for its reason, as in the recording, or the frames differ
        played = experiment.played
    compared, left = (0, 0) if played is None else (played.compared, played.left)
    if left and not difference:
        difference = f"frame {len(frames) - left + 1}: recorded, and not sent"
    return LineReplay(sum(not frame.is_answer for frame in frames), compared, difference)


def _is_due(cycle: Cycle, cycles: int, rate: float) -> bool:
    """Return whether a stop that begins now ends after so many cycles in all."""
    if cycle.cycles + _LONGEST_STOP * rate < cycles:
        return False
    stop = cycle.planned_stop()
    return cycle.cycles + (0 if stop is None else stop.left) >= cycles


_LONGEST_STOP: Final = 2.0  # [s]: a brake sets within 1 s


class OpenReplay:
    """A replay that is ready to run; arguments as for `replay_bus_log`.

    Attributes:
        cycle: Rig, controllers and accounts, ready to run.
        has_ramped: Whether the run ended with a ramp.
    """

    has_ramped = False

    def __init__(
        self, bus_log: str | Path, scene: Scene, *, realtime: bool = False, from_sync: bool = False,
        dry_run: bool = False,
    ) -> None:  # fmt: skip
        if any(kind_of(bus.parameters) == "ethercat" for bus in scene.buses):
            from canhaptic.logs.frame_log import read_frame_log

            read_frame_log(bus_log)
            raise InputError(f"{bus_log}: is the log of an EtherCAT line; replay it with `replay_line`")
        self._scene, self._recording = scene, Recording(bus_log, scene)
        self._joins = from_sync or not self._recording.has_boot
        if self._joins and self._recording.first_sync < 0:
            raise InputError(
                f"{bus_log}: the log has no bring-up and no SYNC that every axis of {scene.source} "
                "answered in OPERATION ENABLED; replay needs one of them"
            )
        with ExitStack() as stack:
            self._build(stack, realtime, dry_run)
            self._stack = stack.pop_all()

    def _build(self, stack: ExitStack, realtime: bool, dry_run: bool) -> None:
        scene, first = self._scene, self._recording.first_sync if self._joins else 0
        self._start = self._recording.frames[first].timestamp_ns
        far_buses: list[can.BusABC] = []
        near_buses: list[can.BusABC] = []
        for _ in scene.buses:
            channel = private_channel()
            for buses in (far_buses, near_buses):
                buses.append(stack.enter_context(open_bus(can_bus(scene.bus).model_copy(update=_BUS), channel)))
        self._left_out: list[str] = []
        self._stop = "none"
        self._wall = WallClock()
        self._side = RecordedSide(far_buses, self._recording, first)
        clock = RecordedClock(self._side, self._start, self._wall if realtime else None)
        rig = self._rig([Link(bus, clock) for bus in near_buses], dry_run)
        known, meters = parts.build_axis_meters(scene), build_loss_meters(scene)
        self.cycle = Cycle(rig, parts.build_ports(scene), axis_meters=known, loss_meters=meters)
        if scene.run.code_runs_in == "process":
            from canhaptic.scene.own_code import ask_in_cycle

            ask_in_cycle(scene, self.cycle)

    def _rig(self, links: list[Link], dry_run: bool) -> Rig:
        scene = self._scene
        by_name = {bus.name: (link, bus.parameters) for bus, link in zip(scene.buses, links, strict=True)}
        drives = [parts.build_servo_drive(axis, *by_name[axis.bus], dry_run=dry_run) for axis in scene.axes]
        self._follow_older_master(drives)
        return (JoinedRig if self._joins else Rig)(
            can_buses(links, drives, can_bus(scene.bus)), drives, scene.bus, [port.places for port in scene.ports]
        )

    def _follow_older_master(self, drives: list[ServoDrive]) -> None:
        """Skip what an older recorded master did not do: identify first, write 0x1006 or an offset, restore values."""
        if self._joins:
            return
        places = {bus.name: place for place, bus in enumerate(self._scene.buses)}
        for axis, drive in zip(self._scene.axes, drives, strict=True):
            where = places[axis.bus], drive.axis.node_id
            drive.identifies = self._recording.first_request(*where)[1:3] != _STATUSWORD
            listed = {od.COMMUNICATION_CYCLE_PERIOD, *_NOTED} & drive.dictionary.keys()
            drive.left_out = frozenset(
                index
                for index in (*listed, *drive.axis.causality.offsets)
                if not self._recording.sdo_frames(*where, index)
            )
            self._left_out += [f"{drive.axis.name}: 0x{index:04X}" for index in sorted(drive.left_out)]
            periods = self._recording.sdo_frames(*where, od.PRODUCER_HEARTBEAT_TIME)
            requests = (data[0] for base, data in periods if base == od.SDO_REQUEST_BASE)
            drive.restores = next(requests, _UPLOAD) == _UPLOAD  # a master that restores it reads it first
            self._left_out += [] if drive.restores else [f"{drive.axis.name}: values before the start"]

    def run(self, *, ramps: bool = True) -> ReplayResult:
        """Run to the end of the recording or to the first difference.

        Args:
            ramps: Whether a stop by the operator may have had a ramp.
        """
        begin, ended = self._wall.now(), "at the end of the recording"
        cycles, bus = self._recording.operator_cycles(), self._scene.bus
        if older := self._recording.end_before_ramp(max(1, round(bus.stop_ramp * 1e9) // bus.sample_time_ns)):
            self._side.end, cycles = older, None

        def is_stopped() -> bool:
            if cycles is None or self.cycle.cycles + _LONGEST_STOP * bus.rate < cycles:
                return False
            stop = self.cycle.planned_stop()
            left = 0 if stop is None or (stop.is_ramp and not ramps) else stop.left
            self.has_ramped = stop is not None and stop.is_ramp
            return self.cycle.cycles + left >= cycles

        try:
            run(self.cycle, None, is_stopped)
            ended, self._stop = "at the stop that was recorded", "operator"
        except ReplayOverError:
            pass
        except RigError as error:
            ended, self._stop = f"{type(error).__name__}: {error}", type(error).__name__
        return self.result((self._wall.now() - begin) * 1e-9, ended)

    def close(self, _status: str = "completed") -> None:
        """Close the buses; a second call does nothing."""
        self._stack.close()

    def result(self, elapsed: float, ended: str = "by the program") -> ReplayResult:
        """Return the result of the comparison, after a run of the cycle.

        Args:
            elapsed: Duration of the run [s].
            ended: How the run ended, in words, if there was no difference.

        Raises:
            InputError: No whole cycle was compared.
        """
        if self.cycle.cycles == 0 and self._side.departure is None and self._side.unsent < 0:
            raise InputError(
                f"{self._recording.path}: holds no whole cycle (SYNC, TPDOs, RPDOs), so no output of a controller "
                "was compared; record for longer, or from an earlier time"
            )
        recording, side, scene = self._recording, self._side, self._scene
        difference = describe(recording, side, scene)
        duration = (recording.frames[-1].timestamp_ns - self._start) * 1e-9
        return {
            "status": "identical" if difference is None else "different",
            "recording": str(recording.path),
            "start": "sync" if self._joins else "boot",
            "skipped": dict(recording.remarks.skipped),
            "remarks": recording.remarks.lines(),
            "reads_left_out": self._left_out,
            "frames": {"recorded": len(recording.frames), "played": side.played, "compared": side.compared},
            "cycles": self.cycle.cycles,
            "duration": duration,
            "elapsed": elapsed,
            "speed": duration / elapsed if elapsed else 0.0,
            "ended": "at the first difference" if side.departure is not None else ended,
            "stop": self._stop,
            "commands": recording.commands(side.place),
            "difference": difference,
            "account": run_result(self.cycle, status="replayed", config_hash=scene.config_hash(), method=""),
        }
