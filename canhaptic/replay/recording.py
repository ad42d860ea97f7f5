"""A recorded bus, prepared for a replay: who sent what, where the cycle begins, where the operator ended it."""

from collections.abc import Sequence
from pathlib import Path

from canhaptic.errors import LogFormatError
from canhaptic.logs.bus_reader import Frame, read_bus_log
from canhaptic.object_dictionary import SYNC_FRAME_COB_ID
from canhaptic.replay.roles import Roles


class Recording:
    """The frames of one bus log.

    Attributes:
        path: The log.
        frames: All data frames, in the order of the log.
        is_master: For each frame, whether the master sent it.
        has_boot: Whether the start of the drives is in the log.
        first_sync: Index of the frame that is SYNC 0, the first that found every axis enabled; -1 when none did.

    Raises:
        LogFormatError: The log cannot be read, or holds no frame of the master.
    """

    def __init__(self, path: str | Path, roles: Roles) -> None:
        self.path = Path(path)
        self.frames = list(read_bus_log(path))
        master = roles.master
        self.is_master = [frame.can_id in master for frame in self.frames]
        if not any(self.is_master):
            raise LogFormatError(
                f"{path}: none of its {len(self.frames)} frames is one that the master of the scene sends; "
                "is it the log of another scene?"
            )
        self._roles = roles
        self.first_sync = _first_sync(self.frames, roles)
        before = self.frames[: self.first_sync] if self.first_sync >= 0 else self.frames
        self.has_boot = any(frame.can_id in roles.sdo_requests for frame in before)

    def operator_cycles(self, ramp_cycles: int) -> int | None:
        """Returns how many cycles were completed when the operator stopped the run; None when he did not.

        An operator's stop shows in the frames: the last SYNC before the drives are disabled was answered by an RPDO
        and followed by one more. After a fault it was answered by zero torque alone.

        Args:
            ramp_cycles: Cycles in which the master takes the torque to zero.
        """
        roles, syncs, commands = self._roles, 0, 0
        left: tuple[int, int] | None = None  # syncs and commands before the drives were disabled for good
        for frame in self.frames[self.first_sync :] if self.first_sync >= 0 else ():
            if frame.can_id == SYNC_FRAME_COB_ID:
                syncs += 1
            elif frame.can_id == roles.rpdo:
                if not roles.asks_to_leave(frame.data):
                    left = None
                elif left is None:
                    left = syncs, commands
                commands += 1
        if left is None or left[0] != left[1]:
            return None
        return max(0, left[0] - ramp_cycles - 1)

    def heartbeat_cycle(self) -> int | None:
        """Returns in which cycle, counted from 1, the master first sent its heartbeat; None when it never did."""
        syncs = 0
        for frame in self.frames[self.first_sync :] if self.first_sync >= 0 else ():
            if frame.can_id == SYNC_FRAME_COB_ID:
                syncs += 1
            elif frame.can_id == self._roles.heartbeat:
                return syncs
        return None


def _first_sync(frames: Sequence[Frame], roles: Roles) -> int:
    """Returns the index of the first SYNC that every axis answered in OPERATION ENABLED; -1 when there is none."""
    sync, enabled = -1, set[int]()
    for index, frame in enumerate(frames):
        if frame.can_id == SYNC_FRAME_COB_ID:
            sync, enabled = index, set()
        elif sync >= 0 and frame.can_id in roles.statuswords:
            if roles.shows_enabled(frame.can_id, frame.data):
                enabled.add(frame.can_id)
            if len(enabled) == len(roles.statuswords):
                return sync
    return -1
