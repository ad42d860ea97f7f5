"""Reaction to missing TPDOs and drive faults: the decision table as data, and the reason codes of a stop.

Axes of a group each count the SYNCs at which the TPDO of any of them is missing.

missed TPDOs in a row   0            normal: the controller's torque
                        1 .. hold    the last torque is held
                        .. stop      it ramps to zero, linearly
                        stop         the rig stops, reason TPDO_LOST
everything below        at once      zero torque, the rig stops
"""

from enum import Enum, IntEnum
from typing import Final, NamedTuple

from canhaptic import errors


class StopReason(IntEnum):
    """Reason why a rig stopped; the number is in the log."""

    NONE = 0
    OPERATOR = 1
    TPDO_LOST = 10
    HEARTBEAT_LOST = 11
    SEND_FAILED = 12
    COMMAND_LOST = 13
    SECOND_MASTER = 14
    SYNCS_SKIPPED = 15
    EMERGENCY = 20
    DRIVE_FAULT = 21
    STATE_LEFT = 22
    NMT_STATE_LEFT = 23
    POSITION_JUMP = 24
    NOT_FOLLOWING = 25
    TORQUE_LIMITED = 26
    FORCE_RANGE = 27
    FORCE_FROZEN = 28
    CONTROLLER = 30
    EXCEPTION = 31
    ENERGY_LOST = 32
    FORCE_CONTRADICTED = 33
    OWN_CODE_LATE = 34


class Action(Enum):
    """Action of the rig on the torque of an axis."""

    RUN = "the controller's torque"
    HOLD = "the last torque held"
    RAMP = "ramp to zero"
    STOP = "zero and disable"


class _StopRule(NamedTuple):
    """One reason of a stop."""

    meaning: str
    error: type[errors.RigError]  # the exception
    remedy: str


STOP_TABLE: Final[dict[StopReason, _StopRule]] = {
    StopReason.TPDO_LOST: _StopRule(
        "no TPDO for too many SYNCs",
        errors.TpdoLostError,
        "check the cable and what else loads the bus, or raise bus.tpdo_timeout or bus.stop_cycles",
    ),
    StopReason.HEARTBEAT_LOST: _StopRule(
        "the drive's heartbeat stopped",
        errors.HeartbeatLostError,
        "check power and cable of the drive, or raise bus.heartbeat_timeout",
    ),
    StopReason.SEND_FAILED: _StopRule(
        "a frame could not be sent, or none be read",
        errors.BusFailedError,
        "check the cable, the bit rate and the length of the interface's queue",
    ),
    StopReason.COMMAND_LOST: _StopRule(
        "the drive holds an old torque, its RPDOs are lost",
        errors.CommandLostError,
        "check the cable, the COB-ID of the RPDO and what else loads the bus",
    ),
    StopReason.SECOND_MASTER: _StopRule(
        "another master sends on the bus",
        errors.SecondMasterError,
        "end the other program, or remove the other device, that sends SYNC, NMT, RPDOs or SDO requests",
    ),
    StopReason.SYNCS_SKIPPED: _StopRule(
        "this computer was late for too many SYNCs",
        errors.SyncsSkippedError,
        "end other programs, see `canhaptic check`, host, ask for bus.realtime, or lower bus.rate",
    ),
    StopReason.EMERGENCY: _StopRule(
        "the drive sent an EMCY", errors.EmergencyError, "look the code up in the drive's manual and remove its cause"
    ),
    StopReason.DRIVE_FAULT: _StopRule(
        "the drive is in FAULT", errors.DriveStateFaultError, "look its error code (0x603F) up and remove the cause"
    ),
    StopReason.STATE_LEFT: _StopRule(
        "the drive left OPERATION ENABLED, or the bus commands it no more (bit 9 of the statusword)",
        errors.StateLeftError,
        "check enable input, supply and limits of the drive, and what else may command it",
    ),
    StopReason.NMT_STATE_LEFT: _StopRule(
        "the drive left NMT OPERATIONAL",
        errors.NmtStateLeftError,
        "look for a reset of the drive and for another NMT master",
    ),
    StopReason.POSITION_JUMP: _StopRule(
        "the position moved faster than the speed limit",
        errors.PositionJumpError,
        "check the encoder and counts_per_unit, or raise speed_limit of the axis",
    ),
    StopReason.NOT_FOLLOWING: _StopRule(
        "the drive does not follow its target torque (bit 12 of the statusword)",
        errors.NotFollowingError,
        "look for a limit, a halt or a safety input of the drive, and for another master that commands it",
    ),
    StopReason.TORQUE_LIMITED: _StopRule(
        "the drive limits its torque (bit 11 of the statusword), and none is read back",
        errors.TorqueLimitedError,
        "map 0x6074 or 0x6077 (read_back), or lower torque_limit below the limits of the drive",
    ),
    StopReason.FORCE_RANGE: _StopRule(
        "the force is beyond the range of its sensor",
        errors.ForceRangeError,
        "check cable, scale and offset of the sensor, or raise admittance.force.range",
    ),
    StopReason.FORCE_FROZEN: _StopRule(
        "the force sensor shows the same count for too long",
        errors.ForceFrozenError,
        "check the sensor, its amplifier and its cable, or raise admittance.force.frozen_after",
    ),
    StopReason.CONTROLLER: _StopRule(
        "the controller's torque is not finite",
        errors.TorqueNotFiniteError,
        "check the parameters of environment and algorithm against the motion",
    ),
    StopReason.EXCEPTION: _StopRule(
        "the cycle raised an exception", errors.CycleFailedError, "see the error that caused it"
    ),
    StopReason.ENERGY_LOST: _StopRule(
        "a port gave out more energy than was declared",
        errors.EnergyLostError,
        "look for SYNCs skipped, frames lost, and a wrong moving_mass or hand_force; raise energy_loss_limit "
        "of the axis only where a person may be given that energy",
    ),
    StopReason.OWN_CODE_LATE: _StopRule(
        "own code in its process did not answer",
        errors.OwnCodeLateError,
        "look for what it waits for, or raise late_holds; a torque that is not answered for is zero",
    ),
    StopReason.FORCE_CONTRADICTED: _StopRule(
        "encoder and commands contradict the force sensor",
        errors.ForceContradictedError,
        "check sign, scale and offset of the sensor, whether commands reach the drive, and drive_mass and loop_gain",
    ),
}
_REASONS: Final[dict[type[Exception], StopReason]] = {rule.error: reason for reason, rule in STOP_TABLE.items()}


def reason_of(error: Exception) -> StopReason:
    """Stop reason of an error raised in the cycle."""
    return _REASONS.get(type(error), StopReason.EXCEPTION)


READ_BACK_TABLE: Final[dict[str, tuple[str, str, str]]] = {
    # read_back of the axis -> an old torque is held (COMMAND_LOST), bit 12 goes out (NOT_FOLLOWING), bit 11 comes on
    "demand": (
        "0x6074 stays as it was for `bus.stop_cycles` SYNCs although another torque was sent",
        "stop after more than `bus.hold_cycles` SYNCs in a row",
        "recorded: the applied torque is read back, and the account is exact; one that is larger than the "
        "command, or turned, is no limit and counts as an old torque",
    ),
    "actual": (
        "0x6077 stays within `torque_tolerance` of an old command for `bus.stop_cycles` SYNCs although commands more "
        "than twice as far from it were sent; nearer ones cannot be distinguished from noise",
        "stop after more than `bus.hold_cycles` SYNCs in a row",
        "recorded: the applied torque is read back; one that is larger than the command, or turned, is no limit",
    ),
    "none": (
        "cannot be detected by the master; the drive's own deadline of the RPDO (0x1400:05) ends it after "
        "`bus.heartbeat_timeout`, where its dictionary has that and `watchdog` is on",
        "stop after more than `bus.hold_cycles` SYNCs in a row",
        "TORQUE_LIMITED after more than `bus.hold_cycles` SYNCs in a row, if it was not on at the start",
    ),
}


class LinkPolicy:
    """Counts the missed cycles of one axis and selects the action on its torque.

    Args:
        hold_cycles: Missed cycles for which the last torque is held.
        stop_cycles: Missed cycles after which the rig stops.

    Attributes:
        missed: Consecutive SYNCs without a TPDO, of this axis or of one that renders together with it.
        missed_total: All such SYNCs since the start, consecutive or not.
        cycles: SYNCs since the start.
    """

    __slots__ = ("_hold_cycles", "_stop_cycles", "cycles", "missed", "missed_total")

    def __init__(self, hold_cycles: int, stop_cycles: int) -> None:
        self._hold_cycles = hold_cycles
        self._stop_cycles = stop_cycles
        self.reset()

    def reset(self) -> None:
        """Start counting again."""
        self.missed = 0
        self.missed_total = 0
        self.cycles = 0

    def on_tpdo(self) -> None:
        """Count a SYNC that was answered."""
        self.cycles += 1
        self.missed = 0

    def on_missed(self) -> None:
        """Count a SYNC that was not answered."""
        self.cycles += 1
        self.missed += 1
        self.missed_total += 1

    def action(self) -> Action:
        """Return the action in this cycle."""
        if self.missed == 0:
            return Action.RUN
        if self.missed <= self._hold_cycles:
            return Action.HOLD
        return Action.RAMP if self.missed < self._stop_cycles else Action.STOP

    def torque_fraction(self) -> float:
        """Return the fraction of the last torque that may still be held, 1 to 0."""
        if self.missed <= self._hold_cycles:
            return 1.0
        ramp_cycles = self._stop_cycles - self._hold_cycles
        return max(0.0, 1.0 - (self.missed - self._hold_cycles) / ramp_cycles)

    def success_rate(self) -> float:
        """Return the fraction of all SYNCs that were answered; 1 before the first."""
        return 1.0 - self.missed_total / self.cycles if self.cycles else 1.0
