"""Reaction to missing TPDOs and drive faults: the decision table as data, and the reason codes of a stop.

Axes of a group each count the SYNCs at which the TPDO of any of them is missing.

missed TPDOs in a row   0            normal: the controller's torque
                        1 .. hold    the last torque is held
                        .. stop      it ramps to zero, linearly
                        stop         the rig stops, reason TPDO_LOST
every other StopReason   at once      zero torque, the rig stops
"""

import tomllib
from enum import IntEnum
from pathlib import Path
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


class _StopRule(NamedTuple):
    """Meaning, exception and remedy of a stop reason."""

    meaning: str
    error: type[errors.RigError]  # the exception
    remedy: str


_TABLES: Final = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
STOP_TABLE: Final = {
    StopReason[name]: _StopRule(of["meaning"], getattr(errors, of["error"]), of["remedy"])
    for name, of in _TABLES["stop"].items()
}
_REASONS: Final[dict[type[Exception], StopReason]] = {rule.error: reason for reason, rule in STOP_TABLE.items()}


def reason_of(error: Exception) -> StopReason:
    """Stop reason of an error raised in the cycle."""
    return _REASONS.get(type(error), StopReason.EXCEPTION)


READ_BACK_TABLE: Final = {name: tuple(of.values()) for name, of in _TABLES["read_back"].items()}


class LinkPolicy:
    """Counts the missed cycles of one axis, and fades the torque that is held meanwhile.

    Args:
        hold_cycles: Missed cycles for which the last torque is held.
        stop_cycles: Missed cycles after which the rig stops.

    Attributes:
        missed: Consecutive SYNCs without a TPDO, of this axis or of one that renders together with it.
        missed_total: All such SYNCs since the start, consecutive or not.
        cycles: Number of SYNCs since the start.
    """

    __slots__ = ("_hold_cycles", "_stop_cycles", "cycles", "missed", "missed_total")

    def __init__(self, hold_cycles: int, stop_cycles: int) -> None:
        self._hold_cycles, self._stop_cycles = hold_cycles, stop_cycles
        self.reset()

    def reset(self) -> None:
        """Set all counts of missed cycles to zero."""
        self.missed = self.missed_total = self.cycles = 0

    def on_tpdo(self) -> None:
        """Count a SYNC that was answered."""
        self.cycles += 1
        self.missed = 0

    def on_missed(self) -> None:
        """Count a SYNC that was not answered."""
        self.cycles += 1
        self.missed += 1
        self.missed_total += 1

    def torque_fraction(self) -> float:
        """Return the fraction of the last torque that may still be held, 1 to 0."""
        if self.missed <= self._hold_cycles:
            return 1.0
        ramp_cycles = self._stop_cycles - self._hold_cycles
        return max(0.0, 1.0 - (self.missed - self._hold_cycles) / ramp_cycles)

    def success_rate(self) -> float:
        """Return the fraction of all SYNCs that were answered; 1 before the first."""
        return 1.0 - self.missed_total / self.cycles if self.cycles else 1.0
