"""One axis in cyclic synchronous torque mode: samples in, torques out, reasons to stop. Knows objects, no frames.

A fieldbus derives from `TorqueAxis`: it fills in the received values, and sends the arguments of `write`. The start
reads and writes single objects by `ObjectAccess`.
"""

import math
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from typing import Any, Final, NamedTuple, Protocol

from canhaptic.canopen import objects as od
from canhaptic.canopen.objects import Dictionary
from canhaptic.drive.profile.quirks import quirks_of
from canhaptic.drive.profile.scaling import axis_scaling
from canhaptic.drive.profile.torque_axis_parameters import ReadBack, TorqueAxisParameters
from canhaptic.drive.safety.limiter import DryRunLimiter, TorqueLimiter
from canhaptic.drive.safety.link_policy import LinkPolicy, StopReason
from canhaptic.drive.safety.power_states import ENABLED_MASK, ENABLED_VALUE, FAULTED, PowerState, drive_state
from canhaptic.drive.safety.torque_check import TorqueCheck
from canhaptic.errors import SdoError
from canhaptic.signals import Sample


class Written(NamedTuple):
    """One write to an object of a drive, with the value before."""

    place: tuple[int, int]  # index, subindex
    before: int | None  # None: the drive does not say
    after: int
    size: int  # [bytes]


def note_write(changes: list[Written], change: Written, read: Callable[[int, int], int]) -> None:
    """Record a write and the value before it, known from an earlier write or read from the drive.

    Raises:
        SdoError: The drive does not answer.
    """
    earlier = next((c.after for c in reversed(changes) if c.place == change.place), None)
    if earlier is None:
        try:
            earlier = read(*change.place)
        except SdoError as error:
            if error.code is None:
                raise
    changes.append(change._replace(before=earlier))


class ObjectAccess(Protocol):
    """Reads and writes integer objects of one drive: SDO over CAN, or over the mailbox of EtherCAT (CoE).

    Every method raises SdoError where the drive aborts or does not answer.
    """

    changes: list[Written] | None
    """Writes so far, except commands, with the values before; None: not recorded."""

    def read(self, index: int, subindex: int = 0) -> int:
        """Return the value of an object."""

    def probe(self, index: int, subindex: int = 0) -> int:
        """Return the value of an object; ask only once."""

    def write(self, index: int, subindex: int, value: int, size: int | None = None) -> None:
        """Write an object of `size` bytes; None: as many as the dictionary says."""

    def describe(self, index: int, subindex: int = 0) -> str:
        """Return an object as `0x6072:00 Max torque`."""


COMMANDS: Final = frozenset(
    (od.CONTROLWORD, od.TARGET_TORQUE, od.TARGET_POSITION, od.TARGET_VELOCITY, od.DIGITAL_OUTPUTS)
)
"""Objects that command a drive or its brake; they are no settings and are never restored."""
_tuple: Final = tuple.__new__  # makes a sample at half the cost of calling its class
_NO_REASON: Final = StopReason.NONE  # bound once: to look a member up in its enum takes as long as all of `fault`
_LIMITED: Final = int(od.StatusBit.INTERNAL_LIMIT)
_FOLLOWS: Final = int(od.StatusBit.FOLLOWS_COMMAND)
_REMOTE: Final = int(od.StatusBit.REMOTE)
_HALF: Final = 1 << 31  # 0x6064 wraps
_FILTER: Final = 0.01
"""Time in which a drive's filter of 0x6077, which no object describes, has settled [s]."""


class ReceivedEmergency(NamedTuple):
    """An EMCY as received (CiA 301, 7.2.7)."""

    code: int  # 0x0000 means that the error is gone
    register: int  # 0x1001
    vendor: bytes

    def __str__(self) -> str:
        numbers = f"error register {self.register:#04x}, vendor {self.vendor.hex(' ') or 'none'}"
        from canhaptic.canopen.code_texts import emcy_text

        return f"EMCY {self.code:#06x} {emcy_text(self.code)}, {numbers}"


class CycleRules(NamedTuple):
    """Properties of the cycle that an axis uses."""

    sample_time_ns: int
    sample_time: float  # the same [s]
    hold_cycles: int  # missed cycles for which the last torque is held
    stop_cycles: int  # missed cycles after which the rig stops
    is_synchronous: bool  # a torque acts at the SYNC after it was sent, and not at once
    silence: int  # of the drive that is tolerated [ns]
    loss_limit: float  # share of the SYNCs whose sample or command may be lost for ever
    lateness: float  # longest time from a hold's begin until its torque has settled [s]
    more_holds: int = 0  # additional holds before a torque acts


class TorqueAxis(ABC):
    """The master's image of one drive.

    Args:
        axis: Parameters of the axis.
        dictionary: Object dictionary of the drive.
        sdo: Access to the drive's objects.
        rules: Properties of the cycle.
        read_back: Torque in its process data.
        dry_run: Whether the torque sent is always 0.

    Attributes:
        dry_run: Whether the torque sent is always 0.
        statusword: Statusword of the last complete process data.
        is_complete: Whether all process data of the last SYNC arrived in their window.
        is_contested: Whether different process data answered the last SYNC, of which any may be true.
        is_operational: Whether the drive exchanges process data, by its last report.
        alive_at: Time of the drive's last sign of life [ns].
        is_ours: Whether this start knows every drive as that of the configuration, and has begun to write to this one.
        left_out: Objects that the start skips, as the older master of a replayed run did.
        restores: Whether the stop restores values that the start wrote; False for the older master of a replayed run.
        identifies: Whether nothing is written before the identity was read; False for such a master.
        hold: Result, in words, of the hands-off test in which hold its torques act; empty if no account needs it.
        remarks: What the last start saw in the drive and did not refuse, in words.
        unrestored: Objects that the stop did not restore, in words.
        outputs: Digital outputs of the drive (0x60FE:01) as the start read them, for a brake; None before.
        elsewhere: Writes to other nodes, whose objects are not restored.
        controlword: Controlword sent with the next torque.
        weight: Torque that a stop holds until the brake does [N*m or N]; 0: none.
        settling: Holds until a torque has settled that is as late as the scene declares.
        unasked: Number of process data since the last `reset` that arrived in no SYNC window.
        culprit: Process data that arrived outside a window, or are missing in the last one, in words.
        unheard: Number of SYNCs since the last `reset` whose process data did not arrive in their window.
        read_back_bound: Bound of the error of the energy [J], summed over the holds; 0 where the demand is read back,
            which is exact. With a measured torque (0x6077): its largest difference from the hold before and from the
            command, and half a per mille of rounding, times the displacement; the true torque lies between them unless
            the current loop overshoots. Without read-back: the command's largest difference from 0 and from every
            earlier command, because any of them may continue if lost RPDOs go unnoticed, times the displacement; where
            only the sum of several displacements is known, times the farthest that `speed_limit` allows. Where two
            different process data answered one SYNC, also the difference that it makes which one is true.
        contested: What of it is due to samples of which none knows whether they are true [J].
        unchanged: Consecutive SYNCs whose process data, with a torque, were identical to the bit: a handle held still,
            a stuck encoder, or process data that are no longer updated.
        uncommanded: Holds in which the torque read back exceeded its command, or had the other sign, and was no older
            command: no certificate bounded it.
        longest_hold: Most sample times for which one torque was held since the last `reset`: 1 without losses. Skipped
            SYNCs, missed TPDOs and lost RPDOs (as far as the demand read back shows) in a row add up.
        longest_gap: Most sample times between two SYNCs since the last `reset`: 1 where none was skipped.
        open_time, open_torque: Sample times before the last whole sample in which another torque than its own may have
            acted, and the largest difference between them [N*m or N]; `open_time` is None where no sample was lost.
        disagreement: How the drive's count of held torques contradicts the host's at the end, in words; "" where it
            does not, or the drive has none.
        emergency: The first EMCY with an error code since the last `reset`; None when there was none.
    """

    stop_word: od.Controlword = od.Controlword.DISABLE_VOLTAGE
    """Controlword of a stop."""
    stop_time: int = 0
    """Time that the drive may take to stop [ns]."""
    rest_text: str = "0"
    """Target of a drive at rest, in words."""
    checks_rest: bool = True
    """Whether the start refuses a drive by `rest_objection`."""

    def __init__(
        self, axis: TorqueAxisParameters, dictionary: Dictionary, sdo: ObjectAccess, rules: CycleRules,
        read_back: ReadBack, dry_run: bool = False,
    ) -> None:  # fmt: skip
        self.axis, self.dictionary, self.sdo, self.dry_run = axis, dictionary, sdo, dry_run
        self.quirks = quirks_of(axis.quirks)
        self.read_back: ReadBack = read_back
        self.scaling = axis_scaling(axis, axis.rated_torque or 1.0)
        limiter = DryRunLimiter if dry_run else TorqueLimiter
        self.limiter = limiter(axis.torque_limit, rules.sample_time, axis.torque_rate_limit, axis.power_limit)
        self.weight = 0.0 if axis.brake is None else axis.brake.holds_weight
        self.policy = LinkPolicy(rules.hold_cycles, rules.stop_cycles, rules.loss_limit, 1.0 / rules.sample_time)
        self.is_ours = False
        self.left_out: frozenset[int] = frozenset()
        self.restores = self.identifies = True
        self.unrestored: list[str] = []
        self.hold = ""
        self.elsewhere: list[str] = []
        self.sample_time_ns = rules.sample_time_ns
        self._is_synchronous, self._silence = rules.is_synchronous, rules.silence
        self._holds_late = self.quirks.syncs_late + rules.more_holds
        self._sample_time, self._stop_cycles = rules.sample_time, rules.stop_cycles
        self._hold_cycles = rules.hold_cycles
        self._reads_demand, self._reads_nothing = read_back == "demand", read_back == "none"
        self._measures = read_back == "actual"
        self._shows_next = axis.demand_reported == "after"
        self._tolerance = axis.torque_tolerance / self.quirks.torque_resolution  # counts of 0x6077
        self.settling = math.ceil(rules.lateness / rules.sample_time)
        settled = math.ceil((rules.lateness + _FILTER * self._measures) / rules.sample_time)
        self.check = TorqueCheck(1 + rules.is_synchronous + settled, self._tolerance)
        # A handle just below the limit may pass one line of the encoder more than its speed makes.
        self._largest_step = axis.largest_speed * rules.sample_time + 1.0 / axis.counts_per_unit

    def reset(self) -> None:
        """Clear everything received and commanded; a derived class calls it once constructed."""
        self.statusword, self.is_operational, self.is_complete, self.is_contested = 0, False, False, False
        self.alive_at = self.now()
        self.emergency: ReceivedEmergency | None = None
        self.outputs: int | None = None
        self.disagreement = ""
        self.remarks: list[str] = []
        self.controlword = int(od.Controlword.DISABLE_VOLTAGE)
        self._values: tuple[int, ...] | list[int] = (0, 0, 0)  # statusword, position counts, torque per mille
        self.unheard = self.unasked = self.uncommanded = self.unchanged = 0
        self.culprit, self.read_back_bound, self.contested = "", 0.0, 0.0
        self._contested_until = 0  # count of SYNCs up to which a doubtful sample is the cause of an uncertain account
        self._spread = 0.0  # per mille: how far the torque is from what may have acted instead, see `read_back_bound`
        self._lowest = self._highest = 0  # per mille: of all commands that acted, or should have
        self.scaling.reset()
        self.limiter.reset()
        self.policy.reset()
        self.check.reset()
        self._distrust = _NO_REASON  # why the link or the torque is no longer trusted
        self._commanded = 0  # per mille: sent last
        self._acting = 0  # per mille: assumed to act now, with a synchronous RPDO
        self._later = deque([0] * self._holds_late)  # per mille: sent, and not acting yet where that takes longer
        self._reported = 0  # per mille: of the process data before
        self._held_before = 0  # per mille: read back for the hold before
        self._followed = 0  # per mille: the last command that a measured torque has shown
        self._stale_holds = 0  # holds in a row with an old torque although another was sent
        self._stale_samples = 0  # sample times since the torque read back was a new one
        self._watched, self._expected = ENABLED_MASK, ENABLED_VALUE  # bits of the statusword while the rig runs
        self._deviations = self._deviated_at = 0  # SYNCs in a row with bit 11 or 12 not as expected; the last of them
        self._held = 0.0  # torque when the first TPDO went missing [N*m or N]
        self._step = 0.0  # mean displacement per sample time since the last process data [rad or m]
        self._periods = 0  # sample times since the last process data
        self.longest_hold = self.longest_gap = 1
        self.open_time: int | None = None
        self.open_torque = 0.0
        self._passed: list[int] = []  # per mille: commands that acted, or should have, since the last process data
        self._contest: tuple[float, float] | None = None  # distance of other data of the last sample: position, torque
        self._is_let_go = False  # the drive may disable itself
        self._is_late = False  # a SYNC was skipped before the last one
        self._last = Sample(-1, 0.0, 0.0, 0, fresh=False)

    # --- what a fieldbus supplies -----------------------------------------------------------------------------------

    @abstractmethod
    def bring_up(self) -> Any:
        """Return the steps that start the drive in its mode: a `BringUp`."""

    @abstractmethod
    def signature(self) -> str:
        """Return a text that identifies drive, process data and rate: a hold test is valid for it; raise SdoError."""

    @abstractmethod
    def now(self) -> int:
        """Return the time [ns]."""

    @abstractmethod
    def pump(self, deadline: int) -> None:
        """Handle arriving frames until `deadline` [ns]; raise LinkError."""

    @abstractmethod
    def write(self, torque_per_mille: int) -> None:
        """Send controlword and target torque as one image; raise LinkError."""

    @abstractmethod
    def disable_unconfirmed(self) -> None:
        """Send 0x6040 = disable voltage outside the process data and await no answer; raise LinkError."""

    @abstractmethod
    def leave_operational(self) -> None:
        """Ask the drive to stop exchanging process data; raise LinkError."""

    @abstractmethod
    def await_pre_operational(self) -> None:
        """Return when the drive has confirmed that it left, or the timeout is over; raise LinkError."""

    @abstractmethod
    def disarm(self) -> None:
        """Switch off the drive's watchdog, so that the end of the master is not a fault; raise SdoError."""

    @property
    @abstractmethod
    def state_text(self) -> str:
        """State of the communication, in words."""

    def emergency_remedy(self, skipped: int) -> str:
        """Return the remedy for the drive's EMCY, where this computer skipped some SYNCs; "" for its manual's."""
        return ""

    @abstractmethod
    def command_brake(self, *, is_open: bool) -> None:
        """Open or set a brake operated by the host, and await no answer; raise LinkError."""

    # --- in ---------------------------------------------------------------------------------------------------------

    @property
    def delay(self) -> int:
        """Whole holds from the computation of a torque to the hold in which it acts."""
        return int(self._is_synchronous) + self._holds_late

    @property
    def mode_code(self) -> int:
        """Value of 0x6060 for the drive's mode."""
        return self.axis.causality.mode_code

    @property
    def withheld(self) -> float:
        """Largest torque that a dry run did not send [N*m or N]."""
        return self.limiter.withheld if isinstance(self.limiter, DryRunLimiter) else 0.0

    @property
    def quantum(self) -> float:
        """Step of the torque in its process data [N*m or N]."""
        return self.scaling.torque_quantum

    @property
    def position_counts(self) -> int:
        """0x6064 of the last complete process data."""
        return self._values[1]

    @property
    def reported_per_mille(self) -> int:
        """Torque of the last complete process data; 0 when none is mapped."""
        return self._values[2]

    @property
    def state(self) -> PowerState:
        """Power state of the last statusword."""
        return drive_state(self.statusword)

    def sample(self, sync_index: int, periods: int = 1, *, is_whole: bool = True) -> Sample:
        """Return the sample of the SYNC just answered, else the last one, marked as old.

        Args:
            sync_index: Index of that SYNC.
            periods: Sample times since the previous SYNC; more than 1 when SYNCs were skipped.
            is_whole: False where another drive, whose position is needed together with this one, did not answer: no
                torque can be computed, and the link policy counts the SYNC as missed.
        """
        self._periods += periods
        self._is_late = periods > 1
        if periods > 1:
            self.longest_gap = max(self.longest_gap, periods)
        if not (self.is_complete and is_whole):
            return self._missed_sample(sync_index)
        self.policy.on_tpdo()
        statusword, counts, reported = self._values
        scaling = self.scaling
        position = scaling.position(counts)
        torque = scaling.torque(self._applied_per_mille(reported))
        before, last_position, last_torque, last_word, _ = self._last
        periods, self._periods = self._periods, 0
        if before >= 0:
            self._step = (position - last_position) / periods
            if periods > self.longest_hold:
                self.longest_hold = periods
            if self._spread:
                farthest = abs(position - last_position)
                if self._reads_nothing and self.open_time:
                    farthest += periods * self._largest_step
                self.read_back_bound += self._spread * scaling.torque_quantum * farthest
            if self._contest is not None:
                self._settle_contest(self._contest, abs(position - last_position), abs(torque) + self.open_torque)
        if position == last_position and torque == last_torque != 0.0 and statusword == last_word:
            self.unchanged += 1
        elif self.unchanged:
            self.unchanged = 0
        self._last = sample = _tuple(Sample, (sync_index, position, torque, statusword, True))
        return sample

    def _missed_sample(self, sync_index: int) -> Sample:
        """Count a SYNC without a whole sample; return the last one, marked as old."""
        if self.policy.missed == 0:
            self._held = self.limiter.last
        self.policy.on_missed()
        self.longest_hold = max(self.longest_hold, self._periods)
        accounted = self._acting if self._is_synchronous else self._commanded
        self._passed.append(accounted)
        self.check.commands.append(accounted)
        self._acting = self._next_acting() if self._later else self._commanded
        if self.policy.missed >= self._stop_cycles:
            self._distrust = StopReason.TPDO_CONTRADICTED if self.is_contested else StopReason.TPDO_LOST
        if self.weight and not self.policy.is_held:  # it acts along a displacement that is not known
            self.read_back_bound += abs(self.weight) * self._largest_step
        if not self.is_complete:
            self.unheard += 1
            self.count_loss()
            self._reported = self._acting  # its value where `_shows_next`
        elif self._shows_next:
            self._reported = self._values[2]
        self._last = self._last._replace(sync_index=sync_index, fresh=False)
        return self._last

    def contest(self, counts: float, per_mille: float) -> None:
        """Take other process data of the SYNC whose sample was given out: one of the two is true, and none knows which.

        Args:
            counts: Their position.
            per_mille: Their torque or force, in steps of it.
        """
        self.uncommanded += 1
        self.is_contested, self._contested_until = True, self.policy.cycles + self._stop_cycles
        self.count_loss()
        moved = abs((counts - self._values[1] + _HALF) % (2 * _HALF) - _HALF) / self.axis.counts_per_unit
        size = 0 if self._reads_nothing else abs(per_mille - self._values[2]) * self.quantum
        before = abs(self._step) * self.longest_hold  # motion that this sample ends, at most
        self._settle_contest((moved, size), before, abs(self._last.torque_applied))
        self._contest = moved, size

    def _settle_contest(self, contest: tuple[float, float], displacement: float, torque: float) -> None:
        """Add what a doubtful sample adds to the error of a hold that it begins or ends."""
        moved, size = contest
        doubt = size * (displacement + moved) + torque * moved
        self.read_back_bound += doubt
        self.contested += doubt
        self._contest = None

    def count_loss(self) -> None:
        """Take the last sample, or command, out of the budget of the link, unless the rig stops already."""
        if self.policy.lose() and not self._distrust:
            self._distrust = StopReason.TPDO_CONTRADICTED if self.is_contested else StopReason.FRAMES_LOST

    def _applied_per_mille(self, reported: int) -> int:
        """Torque of the hold that ended: read back, or assumed as commanded where nothing is read back."""
        accounted = self._acting if self._is_synchronous else self._commanded
        self.check.commands.append(accounted)
        self._acting = self._next_acting() if self._later else self._commanded
        if self._shows_next:
            reported, self._reported = self._reported, reported
        if self._reads_nothing:
            reported = accounted
            self._lowest = min(self._lowest, accounted, *self._passed)
            self._highest = max(self._highest, accounted, *self._passed)
            self._spread = max(self._highest - accounted, accounted - self._lowest)
        if self._measures:
            self._judge_measured(reported, accounted)
            self._spread = max(abs(reported - accounted), abs(reported - self._held_before))
            if self._spread or reported:
                self._spread += 0.5  # 0x6077 is rounded
        elif reported == accounted:
            self._stale_holds, self._stale_samples, self.check.contradicted = 0, self._periods, 0
            self._followed = accounted
        else:
            self._judge_demand(reported, accounted)
        self.open_time = self._leave_open(reported, accounted) if self._passed else None
        self._held_before = reported
        return reported

    def _judge_demand(self, reported: int, accounted: int) -> None:
        """Count holds in which a demand read back is an old one, or none that was commanded."""
        if reported != self._held_before:
            self._stale_holds, self._stale_samples = 0, self._periods
            self._judge_other(reported, accounted, 0.0)
        elif self._is_reduced(reported, accounted, 0.0):
            self._stale_samples = self._periods
        else:
            self._stale_holds += 1
            self._stale_samples += self._periods
            self.longest_hold = max(self.longest_hold, self._stale_samples)
            if reported == self._followed:
                self.count_loss()
                self._distrust_command()
                return
        self._check(reported)

    def _check(self, applied: int) -> None:
        """Count a torque that is none of the commands that may act."""
        self.check.judge(applied, (self._commanded, *self._passed))
        if self.check.contradicted >= self._stop_cycles:
            self._distrust = StopReason.TORQUE_CONTRADICTED
        else:
            self._distrust_command()

    def _distrust_command(self) -> None:
        if self._stale_holds >= self._stop_cycles and not self._is_let_go:
            self._distrust = StopReason.COMMAND_LOST

    def _next_acting(self) -> int:
        """Torque of the hold that begins [per mille], of a drive that acts later than at the next SYNC."""
        self._later.append(self._commanded)
        return self._later.popleft()

    def _leave_open(self, applied: int, accounted: int) -> int:
        """Record how far torques of lost holds may have been from `applied`; return for how many sample times.

        In these holds any command since may have acted or, where commands were lost, the one before. A limit that the
        drive shows now cuts them.
        """
        is_known = self._reads_demand and not self._shows_next  # in the hold that ended
        others = (self._held_before, applied if is_known else accounted, *self._passed)
        cut = abs(applied) if applied != accounted and self._is_reduced(applied, accounted, 0.0) else 1 << 15
        self.open_torque = max(abs(max(-cut, min(cut, o)) - applied) for o in others) * self.scaling.torque_quantum
        self._passed.clear()
        return self._periods - is_known

    def _judge_other(self, applied: int, commanded: int, tolerance: float) -> None:
        """Count a torque that is not its command; the account covers smaller torques and older commands."""
        is_smaller = min(commanded, 0) - tolerance <= applied <= max(commanded, 0) + tolerance
        if not is_smaller and applied not in self._passed and self._last.sync_index >= 0:
            self.uncommanded += 1

    def _judge_measured(self, measured: int, accounted: int) -> None:
        """Count holds in which a measured torque stayed near an old command although another, far from it, was sent.

        Where the two commands are close, the comparison is inconclusive and the count stays.
        """
        tolerance = self._tolerance
        low, high = min(accounted, self._held_before, *self._passed), max(accounted, self._held_before, *self._passed)
        if not low - tolerance <= measured <= high + tolerance:  # between the last torque and the command it settles
            self._judge_other(measured, accounted, tolerance)
        if abs(measured - accounted) <= tolerance:
            self._followed, self._stale_holds, self.check.contradicted = accounted, 0, 0
        elif abs(measured - self._followed) > tolerance:
            self._stale_holds = 0
            self._check(measured)
        elif abs(accounted - self._followed) > 2.0 * tolerance and not self._is_reduced(measured, accounted, tolerance):
            self._stale_holds += 1
            self._distrust_command()

    def _is_reduced(self, applied: int, commanded: int, tolerance: float) -> bool:
        """Whether a limit that the drive shows (bit 11) explains a torque: it is smaller and of the same sign.

        Whether the drive follows its command is then unknown.
        """
        if not self._values[0] & _LIMITED:
            return False
        return min(commanded, 0) - tolerance <= applied <= max(commanded, 0) + tolerance

    def read_state(self) -> PowerState:
        """Ask the drive for its power state, outside the process data; raise SdoError."""
        return drive_state(self.sdo.read(od.STATUSWORD))

    def watch_statusword(self) -> None:
        """Watch bits 9, 11 and 12 of the statusword too from now on; called once the rig is enabled.

        A drive that shows that it follows its target (bit 12), or that the bus commands it (bit 9), must continue to do
        so. One whose torque is not read back must not begin to limit it (bit 11).
        """
        follows = self.statusword & (_FOLLOWS | _REMOTE)
        limits = 0 if not self._reads_nothing or self.statusword & _LIMITED else _LIMITED
        self._watched, self._expected = ENABLED_MASK | follows | limits, ENABLED_VALUE | follows

    def let_go(self) -> None:
        """Expect that the drive disables itself, because its brake was commanded to hold: only a fault counts now."""
        self._is_let_go = True
        self._watched, self._expected = int(od.StatusBit.FAULT), 0

    def fault(self, now: int) -> StopReason:
        """Return why the rig must stop because of this drive; NONE without a reason."""
        if (
            self.emergency is not None or self.statusword & self._watched != self._expected or not self.is_operational
        ) and (reason := self._state_fault()):
            return reason
        if now - self.alive_at > self._silence:
            return StopReason.HEARTBEAT_LOST
        if not abs(self._step) <= self._largest_step:  # NaN too
            return StopReason.POSITION_JUMP
        return self._distrust

    @property
    def suspicion(self) -> StopReason:
        """What makes the account of this axis uncertain at present, before it alone ends the run; NONE if unknown."""
        if self.is_contested or 0 < self.policy.cycles <= self._contested_until:
            return StopReason.TPDO_CONTRADICTED
        return StopReason.TORQUE_CONTRADICTED if self.check.contradicted > self._hold_cycles else _NO_REASON

    def _state_fault(self) -> StopReason:
        if self.emergency is not None:
            return StopReason.EMERGENCY
        if self.state in FAULTED:
            return StopReason.DRIVE_FAULT
        if self.statusword & ENABLED_MASK != ENABLED_VALUE and not self._is_let_go:
            return StopReason.STATE_LEFT
        if not self.is_operational:
            return StopReason.NMT_STATE_LEFT
        if self._watched & _REMOTE and not self.statusword & _REMOTE:
            return StopReason.STATE_LEFT
        return self._deviation()

    def _deviation(self) -> StopReason:
        """Return the reason in bit 11 or 12; it is tolerated for as many cycles as a torque is held without TPDO."""
        cycle = self.policy.cycles
        self._deviations = self._deviations + 1 if self._deviated_at == cycle - 1 else 1
        self._deviated_at = cycle
        if self._deviations <= self._hold_cycles:
            return StopReason.NONE
        if (self.statusword ^ self._expected) & self._watched & _FOLLOWS:
            return StopReason.NOT_FOLLOWING
        return StopReason.TORQUE_LIMITED

    # --- out --------------------------------------------------------------------------------------------------------

    def rest_target(self) -> int:
        """Return the target of a drive at rest; raise SdoError."""
        return 0

    def rest_objection(self) -> tuple[str, str] | None:
        """Return what the drive shows at rest and must not, and what it should; None where it may be enabled."""
        return None

    def rests_at(self, target: int) -> bool:
        """Whether a target read from the drive is consistent with rest."""
        return target == 0

    def command_per_mille(self, torque: float) -> int:
        """Target torque (0x6071) for a requested torque [N*m or N], after policy and limiter.

        While TPDOs are missing, the torque held when the first went missing is an upper bound for `hold_cycles`; then
        it is zero, or the weight that a stop holds. After a skipped SYNC the last torque is the bound: a controller
        takes the motion of several sample times for the motion of one and would brake several times too hard.

        Raises:
            ControlError: The torque is not finite.
        """
        policy, limiter = self.policy, self.limiter
        if (policy.missed or self._is_late) and torque - torque == 0.0:  # one that is not finite must reach the limiter
            held = limiter.last if not policy.missed else self._held if policy.is_held else 0.0
            torque = max(min(held, 0.0), min(max(held, 0.0), torque))
            if self.weight and not policy.is_held:
                torque = self.weight
        torque = limiter.limit(torque, self._step / self._sample_time)
        return self.scaling.torque_per_mille(torque, limiter.low, limiter.high)
