"""What happens when an axis goes unheard or unwell: the decision table as data, and the reason codes of a stop.

missed TPDOs in a row   0            normal: the controller's torque
                        1 .. hold    the last torque is held
                        .. stop      it ramps to zero, linearly
                        stop         the rig stops, reason TPDO_LOST
everything below        at once      zero torque, the rig stops
"""

from enum import Enum, IntEnum
from typing import Final

from canhaptic.errors import ControlError, DriveFaultError, LinkError, RigError


class StopReason(IntEnum):
    """Why a rig stopped; the number is in the log."""

    NONE = 0
    OPERATOR = 1
    TPDO_LOST = 10
    HEARTBEAT_LOST = 11
    SEND_FAILED = 12
    EMERGENCY = 20
    DRIVE_FAULT = 21
    STATE_LEFT = 22
    NMT_STATE_LEFT = 23
    POSITION_JUMP = 24
    CONTROLLER = 30
    EXCEPTION = 31


class Action(Enum):
    """What the rig does with the torque of an axis."""

    RUN = "the controller's torque"
    HOLD = "the last torque held"
    RAMP = "ramp to zero"
    STOP = "zero and disable"


STOP_TABLE: Final[dict[StopReason, tuple[str, type[RigError]]]] = {
    # reason -> (what it means, what is raised)
    StopReason.TPDO_LOST: ("no TPDO for too many SYNCs", LinkError),
    StopReason.HEARTBEAT_LOST: ("the drive's heartbeat stopped", LinkError),
    StopReason.SEND_FAILED: ("a frame could not be sent", LinkError),
    StopReason.EMERGENCY: ("the drive sent an EMCY", DriveFaultError),
    StopReason.DRIVE_FAULT: ("the drive is in FAULT", DriveFaultError),
    StopReason.STATE_LEFT: ("the drive left OPERATION ENABLED", DriveFaultError),
    StopReason.NMT_STATE_LEFT: ("the drive left NMT OPERATIONAL", DriveFaultError),
    StopReason.POSITION_JUMP: ("the position moved faster than the speed limit", DriveFaultError),
    StopReason.CONTROLLER: ("the controller's torque is not finite", ControlError),
}


class LinkPolicy:
    """Counts missed cycles of one axis and says what becomes of its torque.

    Args:
        hold_cycles: Missed cycles for which the last torque is held.
        stop_cycles: Missed cycles after which the rig stops.

    Attributes:
        missed: TPDOs missed in a row.
        missed_total: TPDOs missed since the start.
        cycles: SYNCs since the start.
    """

    __slots__ = ("_hold_cycles", "_stop_cycles", "cycles", "missed", "missed_total")

    def __init__(self, hold_cycles: int, stop_cycles: int) -> None:
        self._hold_cycles = hold_cycles
        self._stop_cycles = stop_cycles
        self.reset()

    def reset(self) -> None:
        """Starts counting again."""
        self.missed = 0
        self.missed_total = 0
        self.cycles = 0

    def count(self, *, heard: bool) -> None:
        """Takes the outcome of one SYNC."""
        self.cycles += 1
        if heard:
            self.missed = 0
        else:
            self.missed += 1
            self.missed_total += 1

    def action(self) -> Action:
        """Returns what to do in this cycle."""
        if self.missed == 0:
            return Action.RUN
        if self.missed <= self._hold_cycles:
            return Action.HOLD
        return Action.RAMP if self.missed < self._stop_cycles else Action.STOP

    def share(self) -> float:
        """Returns the part of the last heard torque that is left, 1 to 0."""
        if self.missed <= self._hold_cycles:
            return 1.0
        ramp_cycles = self._stop_cycles - self._hold_cycles
        return max(0.0, 1.0 - (self.missed - self._hold_cycles) / ramp_cycles)

    def success_rate(self) -> float:
        """Returns the part of all SYNCs that were answered; 1 before the first."""
        return 1.0 - self.missed_total / self.cycles if self.cycles else 1.0
