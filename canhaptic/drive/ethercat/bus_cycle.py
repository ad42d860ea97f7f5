"""One EtherCAT line in the cycle of a rig: read frame, write frame, holds counted one by one, states and mail.

Hold k is [SYNC0_k, SYNC0_k+1) of the reference clock; the system time in each frame shows it. A frame read in another
hold than its own is not used: its sample is missing, and the torque before is held. Nothing of a frame with a low
counter is used either. Every answer carries the AL status of all drives, since a full counter proves no state.
"""

from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Final

from canhaptic.drive.clock import Clock
from canhaptic.drive.ethercat.held_torques import HeldTorques
from canhaptic.drive.ethercat.parameters import EthercatBusParameters
from canhaptic.drive.ethercat.phase_lock import PhaseLock
from canhaptic.drive.ethercat.segment import AlState, Cycle, FrameKind, Identity, Segment
from canhaptic.drive.pace import Pace
from canhaptic.drive.profile.torque_axis import ReceivedEmergency
from canhaptic.errors import InputError, LinkError

if TYPE_CHECKING:
    from canhaptic.drive.bus_cycle import BackgroundLine

_LAST: Final = 0.75  # part of the sample time after SYNC0 at which the write frame must be there
_OP: Final = int(AlState.OP)
_READ, _WRITE, _BOTH = FrameKind.READ, FrameKind.WRITE, FrameKind.BOTH


class _Seen:
    """What was seen on the line: a second master cannot share it."""

    intruder = ""


class EthercatBusCycle:
    """An EtherCAT line of a rig; see `drive.bus_cycle.BusCycle`.

    Args:
        segment: The line.
        clock: Clock of every wait.
        bus: Parameters of the line.

    Attributes:
        identities: Drives found on the line, in its order; none before a scan.
        lock: Lock of the host on SYNC0.
        is_running: Whether SYNC0 runs and the image is mapped.
        held: Counts of held torques.
        slip: Sample times to add to those between the last two deadlines, which are 1 at least; 0 or less.
        low: Answers with a low counter.
    """

    clock_leader = True

    def __init__(self, segment: Segment, clock: Clock, bus: EthercatBusParameters) -> None:
        self.segment, self.clock, self.bus = segment, clock, bus
        self.drives: tuple[Any, ...] = ()  # each an `EthercatDrive`
        self.seen, self.identities = _Seen(), list[Identity]()
        self._period = bus.sample_time_ns
        self.lock = PhaseLock(self._period, round(bus.phase * self._period))
        self.held = HeldTorques(self.lock)
        self.window_ns = round((_LAST - bus.phase) * self._period)
        self.pump = clock.wait_until
        self._pace = Pace(self._period)
        self._first_kind = _READ if bus.frames == 2 else _BOTH
        self._keep_alive: Callable[[], int] | None = None
        self._keep_alive_due = self._looks = self._since_mail = 0
        self._mail_cycles = bus.mail_cycles
        self.is_running = False
        self.begin()

    def add(self, drive: Any) -> None:
        """Put a drive on the line."""
        self.drives = (*self.drives, drive)
        self._all = (1 << len(self.drives)) - 1

    def lead(self, pace: Pace) -> None:
        """Let the reference clock lead the deadlines of a rig."""
        self._pace = pace

    def begin(self) -> None:
        """Restart: no hold is known yet."""
        self._taken = -1  # hold of the last sample
        self._mark = 0  # its deadline, as if none had been moved
        self._counted = self._slipped = 0  # sample times since then, and by how many the last frame missed its hold
        self._written = 0  # one bit for each drive whose outputs wait for the frame
        self._answer: Cycle | None = None
        self.low = self.late = self.slip = 0

    def reserve(self) -> None:
        """Forget who was on the line."""
        self.identities, self.is_running = [], False
        self.begin()

    # --- the cycle --------------------------------------------------------------------------------------------------

    def ask(self, woken: int) -> int:
        """Send the frame that brings the inputs, and await it; return when it was sent [ns]."""
        for drive in self.drives:
            drive.is_complete = False
        if self._written:  # of some drives only, as in a stop
            self._send_outputs()
        self._answer = self.segment.exchange(self._first_kind, woken + self.window_ns)
        if self._first_kind is _BOTH:
            self.held.count(self._answer)
        return woken

    def take(self, end: int) -> bool:
        """Give each drive its inputs; return False where they did not come, or in another hold than theirs."""
        answer, pace, taken = self._answer, self._pace, self._taken
        self.slip = 0
        self._counted = counted = self._counted + pace.periods
        if answer is None or not answer.is_whole:
            self.low += answer is not None
            return self._miss("an answer of all drives")
        if answer.states != _OP:
            self._look_at_states()
        hold, now, left = self.lock.hold_of(answer.dc_time), self.clock.now(), pace.synced
        if hold - taken != counted and taken >= 0:
            slip, was_slow = hold - taken - counted, self.lock.was_slow(now - left)
            if hold <= taken or (slip > 0 and (was_slow or slip != self._slipped)):
                self._slipped = 0 if was_slow else slip
                self.late += 1
                return self._miss("a frame in its own hold")
            # the host itself has slipped: its deadlines belong to other holds than it counted
            counts = max(1, pace.periods + slip)
            self.slip = min(0, pace.periods + slip - counts)
            pace.periods = counts
        if taken >= 0:  # a frame that left late or early may round to another count than its deadline
            passed = (pace.deadline + pace.shifted - self._mark + self._period // 2) // self._period
            pace.shifted += (hold - taken - passed) * self._period
        self._mark = pace.deadline + pace.shifted
        self._slipped, self._taken, self._counted = 0, hold, 0
        if not pace.times_holds:
            pace.uneven = 0
        inputs = answer.inputs
        pace.shift(self.lock.follow(answer.dc_time, left - pace.deadline, now - left))
        for drive in self.drives:
            drive.take(inputs, now)
        return True

    def _miss(self, what: str) -> bool:
        for drive in self.drives:
            drive.culprit = what
        return False

    def _look_at_states(self) -> None:
        """Read the AL status of each drive: one of them is not in OP."""
        for drive in self.drives:
            drive.read_al_status()

    def written(self, bit: int) -> None:
        """Note that a drive has new outputs. Send the frame when every drive has new outputs."""
        self._written |= bit
        if self._written == self._all and self._first_kind is _READ:
            self._send_outputs()

    def _send_outputs(self) -> None:
        self._written = 0
        if self.is_running and self._first_kind is _READ:
            now = self.clock.now()
            self.held.count(self.segment.exchange(_WRITE, max(now, self._pace.synced + self.window_ns)))

    def flush(self) -> None:
        """Send the outputs now, whichever drives have written theirs."""
        self._send_outputs()

    def beat(self) -> None:
        """Look, now and then, into the mailbox of one drive after the other for an emergency, and at its clock."""
        self._since_mail += 1
        if self._since_mail < self._mail_cycles or not self.is_running or not self.drives:
            return
        self._since_mail = 0
        self._looks += 1
        drive = self.drives[self._looks // 2 % len(self.drives)]
        if self._looks % 2:
            with suppress(LinkError):  # its next turn comes
                drive.look_at_clock()
            return
        found = self.segment.mail(drive.axis.position)
        if found is not None and found.code and drive.emergency is None:
            drive.emergency = ReceivedEmergency(found.code, found.register, found.vendor)

    # --- the start --------------------------------------------------------------------------------------------------

    def idle(self, cycles: int = 1) -> None:
        """Run cycles with the outputs as they are, before the rig does."""
        pace, window = self._pace, self.window_ns
        for _ in range(cycles):
            while pace.due < self.clock.now():
                pace.due += self._period
            self.clock.wait_until(pace.due)
            pace.synced = pace.due
            pace.due += self._period
            if self._keep_alive is not None and self.clock.now() >= self._keep_alive_due:
                self._keep_alive_due = self._keep_alive()
            left = self.clock.now()
            answer = self.segment.exchange(self._first_kind, left + window)
            if answer is not None and answer.dc_time:
                pace.shift(self.lock.follow(answer.dc_time, left - pace.synced, self.clock.now() - left))
            if self._first_kind is _READ:
                answer = self.segment.exchange(_WRITE, max(self.clock.now(), pace.synced + window))
            self.held.count(answer)

    def keep_alive(self, send: Callable[[], int] | None) -> None:
        """Call `send` while an answer is awaited: it returns when it is to be called again [ns]. None: nothing."""
        self._keep_alive, self._keep_alive_due = send, 0

    def feed(self) -> None:
        """Send the outputs as they are: another bus is waited for, and the watchdogs of this one run."""
        if self.is_running:
            kind = _WRITE if self._first_kind is _READ else _BOTH
            self.held.count(self.segment.exchange(kind, self.clock.now() + self.window_ns))

    def mark_start(self, *, is_starting: bool) -> None:
        """Do nothing: no wait on the line lasts."""

    # --- the rest ---------------------------------------------------------------------------------------------------

    def drain(self) -> None:
        """Do nothing: every frame is awaited."""

    def allow(self, latest: int) -> None:
        """Do nothing: a frame tells its hold by itself."""

    def shared_hint(self) -> str:
        """Return an empty text: no other master can share the line."""
        return ""

    def background(self) -> "BackgroundLine":
        """Refuse; raise InputError."""
        raise InputError("objects of a drive on EtherCAT cannot be read while the rig runs; read them before the start")

    def statistics(self) -> Mapping[str, float]:
        """Return the counts of the line by name."""
        held = self.held
        return {
            "held": held.missed,
            "unanswered": held.unanswered,
            "low_counter": self.low,
            "late": self.late,
            "two_in_a_hold": held.twice,
        }
