"""A recorded bus, prepared for a replay: sender of each frame, start of the cycle, the operator's stop."""

import struct
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import Final

from canhaptic.canopen import objects as od
from canhaptic.errors import LogFormatError
from canhaptic.logs.bus_reader import Frame, SkippedKind, read_bus_log
from canhaptic.replay.roles import Address, Roles
from canhaptic.scene.channels import Channels

_SYNC: Final[Address] = (0, od.SYNC_FRAME_COB_ID)


class Recording:
    """The frames of one bus log, without the master's heartbeats.

    Those follow the wall clock of the host. After skipped SYNCs, microseconds decide when the next one is due, and the
    times of a log differ from those of the master by some.

    Attributes:
        path: The log.
        frames: All other data frames, in the order of the log.
        skipped: Frames that were left out, by kind.
        buses: Place of each frame's bus among those of the scene.
        heartbeat: COB-ID of the master's heartbeat.
        is_master: Whether the master sent each frame.
        has_boot: Whether the start of the drives is in the log.
        first_sync: Index of the frame that is SYNC 0, on the first bus; -1 when no SYNC found every axis enabled.

    Raises:
        LogFormatError: The log cannot be read, or holds no frame of the master.
    """

    def __init__(self, path: str | Path, roles: Roles, channels: Channels) -> None:
        self.path = Path(path)
        self.heartbeat = roles.heartbeat
        self.skipped = Counter[SkippedKind]()
        self.frames = [frame for frame in read_bus_log(path, self.skipped) if frame.can_id != roles.heartbeat]
        self.buses = [channels.place_of(frame) for frame in self.frames]
        self._addresses = [(bus, frame.can_id) for bus, frame in zip(self.buses, self.frames, strict=True)]
        self.is_master = [address in roles.master for address in self._addresses]
        if not any(self.is_master):
            raise LogFormatError(
                f"{path}: none of its {len(self.frames)} frames is one that the master of the scene sends; "
                "is it the log of another scene?"
            )
        self._roles = roles
        self.first_sync = _first_sync(self._addresses, self.frames, roles)
        before = self._addresses[: self.first_sync] if self.first_sync >= 0 else self._addresses
        self.has_boot = any(address in roles.sdo_requests for address in before)

    def has_sdo(self, bus: int, node_id: int, index: int) -> bool:
        """Return whether a request or an answer of a node names subindex 0 of an object."""
        named = struct.pack("<HB", index, 0)
        addresses = {(bus, od.SDO_REQUEST_BASE + node_id), (bus, od.SDO_RESPONSE_BASE + node_id)}
        pairs = zip(self._addresses, self.frames, strict=True)
        return any(address in addresses and frame.data[1:4] == named for address, frame in pairs)

    def operator_cycles(self, ramp_cycles: int) -> int | None:
        """Number of cycles before the operator stopped the run; None without such a stop.

        An operator's stop shows in the frames: the last SYNC before the drives are disabled was answered by an RPDO
        and followed by one more. After a fault it was answered by zero torque alone.

        Args:
            ramp_cycles: Cycles in which the master takes the torque to zero.
        """
        syncs = commands = 0
        for address, frame in self._since_first_sync():
            if address == _SYNC:
                syncs += 1
            elif address == self._roles.rpdo:
                if self._roles.asks_to_leave(frame.data):
                    return max(0, syncs - ramp_cycles - 1) if syncs == commands else None
                commands += 1
        return None

    def _since_first_sync(self) -> Iterator[tuple[Address, Frame]]:
        if self.first_sync >= 0:
            yield from islice(zip(self._addresses, self.frames, strict=True), self.first_sync, None)


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
