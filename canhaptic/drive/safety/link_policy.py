"""Reaction to missing TPDOs and drive faults: the decision table as data, and the reason codes of a stop.

Axes of a group each count the SYNCs at which the TPDO of any of them is missing.

missed TPDOs in a row   0            normal: the controller's torque
                        1 .. hold    the last torque is held
                        .. stop      zero; the declared weight on an axis that hangs from its brake
                        stop         the rig stops, reason TPDO_LOST
every other StopReason   at once      zero torque, the rig stops

A `LossBudget` counts what is lost now and then, and never so many times in a row. Let each SYNC lose its sample or
command with the probability p, below the limit r. The level is then a random walk with a negative drift, so that with
theta > 0 and 1 - p + p exp(theta) = exp(r theta) a loss ends the run with a probability of at most exp(-theta most)
(Wald 1944). By default, for 1 % of frames lost, so that SYNC, TPDO and RPDO make 3 % of the SYNCs: 4e-20 a loss, and
2e-10 at 40 Hz and slower, where `most` is 10; less than once in 1e6 hours at every rate. With half of the SYNCs lost it
ends after most / (0.5 - r) of them: 50, or 25.
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
    FRAMES_LOST = 16
    TPDO_CONTRADICTED = 17
    HOLDS_CONTRADICTED = 18
    EMERGENCY = 20
    DRIVE_FAULT = 21
    STATE_LEFT = 22
    NMT_STATE_LEFT = 23
    POSITION_JUMP = 24
    NOT_FOLLOWING = 25
    TORQUE_LIMITED = 26
    FORCE_RANGE = 27
    FORCE_FROZEN = 28
    TORQUE_CONTRADICTED = 29
    CONTROLLER = 30
    EXCEPTION = 31
    ENERGY_LOST = 32
    FORCE_CONTRADICTED = 33
    OWN_CODE_LATE = 34
    ENERGY_UNCERTAIN = 35


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


_FEWEST: Final = 10
"""Losses that a budget bears at least: fewer come together by chance."""


class LossBudget:
    """Level of what is lost: it rises by each loss, falls by the limit with each SYNC, and is never below 0.

    Args:
        limit: What may be lost with each SYNC for ever.
        most: Level beyond which a loss ends the run.

    Attributes:
        level: What was lost beyond the limit, after the last loss.
    """

    __slots__ = ("_at", "_limit", "_most", "level")

    def __init__(self, limit: float, most: float) -> None:
        self._limit, self._most = limit, most
        self.reset()

    def reset(self) -> None:
        """Forget all losses."""
        self._at, self.level = 0, 0.0

    def lose(self, at: int, losses: float = 1.0) -> bool:
        """Take losses out of the budget; return whether it is spent.

        Args:
            at: Number of the SYNC, not below that of the last call.
            losses: What was lost since the last call.
        """
        self.level = max(0.0, self.level - self._limit * (at - self._at)) + losses
        self._at = at
        return self.level > self._most


class LinkPolicy:
    """Counts the missed cycles of one axis, and says for how long its torque is held meanwhile.

    Args:
        hold_cycles: Missed cycles for which the last torque is held.
        stop_cycles: Missed cycles after which the rig stops.
        loss_limit: Share of the SYNCs whose sample or command may be lost for ever.
        rate: SYNCs per second.

    Attributes:
        missed: Consecutive SYNCs without a TPDO, of this axis or of one that renders together with it.
        missed_total: All such SYNCs since the start, consecutive or not.
        cycles: Number of SYNCs since the start.
    """

    __slots__ = ("_budget", "_hold_cycles", "_lost_at", "_stop_cycles", "cycles", "missed", "missed_total")

    def __init__(self, hold_cycles: int, stop_cycles: int, loss_limit: float, rate: float) -> None:
        self._hold_cycles, self._stop_cycles = hold_cycles, stop_cycles
        self._budget = LossBudget(loss_limit, max(_FEWEST, min(stop_cycles, rate / 4.0)))
        self.reset()

    def reset(self) -> None:
        """Set all counts of missed cycles to zero."""
        self.missed = self.missed_total = self.cycles = self._lost_at = 0
        self._budget.reset()

    def lose(self) -> bool:
        """Count the sample or the command of the last SYNC as lost; return whether too many were.

        Losses in a row are bounded by `stop_cycles`.
        """
        is_in_a_row = self.cycles - self._lost_at <= 1
        self._lost_at = self.cycles
        is_spent = self._budget.lose(self.cycles)
        return is_spent and (not is_in_a_row or self._budget.level > self._stop_cycles)

    def on_tpdo(self) -> None:
        """Count a SYNC that was answered."""
        self.cycles += 1
        self.missed = 0

    def on_missed(self) -> None:
        """Count a SYNC that was not answered."""
        self.cycles += 1
        self.missed += 1
        self.missed_total += 1

    @property
    def lost_since(self) -> int:
        """SYNCs since a sample or a command was lost, or since the start."""
        return self.cycles - self._lost_at

    @property
    def is_held(self) -> bool:
        """Whether the last torque may still be held; a torque without a sample falls in one hold, without a ramp."""
        return self.missed <= self._hold_cycles

    def success_rate(self) -> float:
        """Return the fraction of all SYNCs that were answered; 1 before the first."""
        return 1.0 - self.missed_total / self.cycles if self.cycles else 1.0
