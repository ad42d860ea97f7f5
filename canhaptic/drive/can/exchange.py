"""The cycle of a rig on its buses: wait for the deadline, send SYNC, take the TPDOs that answer it.

Deadlines are absolute. One that is missed is skipped and counted, never caught up: a burst of SYNCs would make drives
sample and hold at intervals other than the sample time.
"""

from collections.abc import Sequence

from canhaptic.canopen.objects import HEARTBEAT_BASE, SYNC_FRAME_COB_ID, NmtState
from canhaptic.drive.axis_parameters import BusParameters
from canhaptic.drive.can.link import Link
from canhaptic.drive.can.servo_drive import ServoDrive, SyncWindow
from canhaptic.errors import LinkError
from canhaptic.host.stop_signal import is_urgent

_MARGIN = 10  # part of a sample time by which an answer after a missing one may be slower than those before
_HEARTBEAT = bytes([NmtState.OPERATIONAL])


class Exchange:
    """The pace of a rig and the traffic on its buses in one cycle.

    Args:
        links: The buses; the first sets the clock.
        drives: All drives, each on one of the links.
        bus: Parameters of the bus: rate, windows, heartbeat.

    Attributes:
        sample_time_ns: Sample time of the cycle [ns].
        silence: Longest silence of the master that a drive tolerates [ns].
        beat_cycles: Sample times between heartbeats of the master.
        periods: Sample times between the last two SYNCs; more than 1 after a skip.
        uneven: Duration of the last hold minus its whole sample times [ns].
        skipped: Deadlines missed and skipped since `begin`.
        deadline: Deadline of the last SYNC [ns].
        woken: Time at which the wait for that SYNC ended [ns].
        heard: Time at which the last TPDO arrived, or the window closed [ns].
    """

    def __init__(self, links: Sequence[Link], drives: Sequence[ServoDrive], bus: BusParameters) -> None:
        self.links = tuple(links)
        self._others = self.links[1:]
        self.drives = tuple(drives)
        self.clock = self.links[0].clock
        self.now, self.wait_until = self.clock.now, self.clock.wait_until
        self.sample_time_ns, self.silence = bus.sample_time_ns, bus.master_silence_ns
        self._period = bus.sample_time_ns
        self._latest = self._period // 2  # a deadline missed by more is skipped
        self._window_ns = round(bus.tpdo_timeout * self._period)
        self._heartbeat_cob_id = HEARTBEAT_BASE + bus.master_id
        self.beat_cycles = bus.heartbeat_cycles
        self._guarded = tuple(drive for drive in self.drives if drive.map.watchdog == "life_guarding")
        self._beat_due = 0  # [ns], while no cycle runs
        self._buses = []
        for link in self.links:
            group = tuple(drive for drive in self.drives if drive.link is link)
            window = SyncWindow()
            for drive in group:
                drive.window = window
            self._buses.append((link, window, group, len(group)))
        self.begin()

    @property
    def is_urgent(self) -> bool:
        """Whether a second signal came: no confirmation is awaited any longer."""
        return is_urgent()

    def begin(self) -> None:
        """Restart the schedule: the next SYNC is due now, and later deadlines count from it."""
        self.periods = 1
        self.uneven = self.skipped = 0
        self._is_whole, self._slowest = True, -1
        for _, window, _, _ in self._buses:
            window.latest = self._window_ns
        self._since_heartbeat = self.beat_cycles
        self._next = self.deadline = self.woken = self.heard = self._synced = self._logged = self.clock.now()

    def leave_one_out(self) -> None:
        """Delay the next SYNC by one sample time, and handle arriving frames until the present window ends.

        Raises:
            LinkError: A bus failed.
        """
        self._next += self._period
        self._slowest = -1
        for link in self.links:
            link.pump(self._synced + self._window_ns)

    def sync(self) -> None:
        """Wait for the deadline, send SYNC on every bus and take the TPDOs until all have arrived or the window closes.

        Raises:
            LinkError: A bus failed; SYNC still went out on the others.
        """
        failure: LinkError | None = None
        synced = self.woken = self._wait()
        for link, window, group, count in self._buses:
            window.is_open, window.pending, window.synced = True, count, synced
            for drive in group:
                drive.expect_tpdos()
            try:
                synced = link.send(SYNC_FRAME_COB_ID, b"")  # a replay knows this time, and no other
            except LinkError as error:
                failure, window.pending = error, 0
                _refuse_tpdos(group)
        logged = synced - synced % 1000  # to the microsecond, as a bus log keeps it: a replay counts the same periods
        self.periods = periods = (logged - self._logged + self._latest) // self._period or 1
        self.uneven = abs(synced - self._synced - periods * self._period)
        self._synced, self._logged = synced, logged
        if synced - self.deadline > self._latest:  # held up after the wait: the next must not follow at once
            self._skip(synced - self.deadline)
        end, was_whole, self._is_whole = synced + self._window_ns, self._is_whole, True
        for link, window, group, _ in self._buses:
            while window.pending and link.poll(end):
                pass
            window.is_open = False
            if window.pending:
                self._is_whole = False
                _refuse_tpdos(group)
        self.heard = heard = self.now()
        if heard - synced > self._slowest and self._is_whole and was_whole:
            self._allow(heard - synced)
        if failure is not None:
            raise failure

    def _allow(self, slowest: int) -> None:
        """Set the latest time of a TPDO after a missing one, from the slowest answer known to be its SYNC's [ns]."""
        self._slowest = slowest
        for _, window, _, _ in self._buses:
            window.latest = slowest + self._period // _MARGIN

    def _wait(self) -> int:
        """Handle frames until the next deadline; one missed by half a period is skipped for the next.

        Returns:
            The time at its end [ns].
        """
        while True:
            self.links[0].pump(self._next)
            for link in self._others:
                link.drain()
            lateness = (woken := self.now()) - self._next
            if lateness <= self._latest:
                break
            self._skip(lateness)
        self.deadline = self._next
        self._next += self._period
        return woken

    def _skip(self, lateness: int) -> None:
        """Skip the deadlines that were missed, up to the nearest."""
        skipped = (lateness + self._latest) // self._period
        self.skipped += skipped
        self.deadline += lateness // self._period * self._period
        self._next += skipped * self._period

    def write_zero(self) -> None:
        """Send every drive its controlword with zero torque.

        Raises:
            LinkError: A frame could not be sent.
        """
        for drive in self.drives:
            drive.write(0)
        self.beat()

    def beat(self, *, at_once: bool = False) -> None:
        """Send the master's heartbeat when it is due, or at once.

        Skipped SYNCs count: a master that runs late must not seem dead to drives that time its heartbeat. Drives that
        time guard requests get one too.

        Raises:
            LinkError: It could not be sent.
        """
        self._since_heartbeat += self.periods
        if at_once or self._since_heartbeat >= self.beat_cycles:
            self._since_heartbeat = 0
            failure: LinkError | None = None
            for link in self.links:
                try:
                    link.send(self._heartbeat_cob_id, _HEARTBEAT)
                except LinkError as error:  # the drives of the other buses need theirs all the same
                    failure = error
            for drive in self._guarded:
                try:
                    drive.guard()
                except LinkError as error:
                    failure = error
            if failure is not None:
                raise failure

    def keep_alive_while_waiting(self, *, on: bool) -> None:
        """Send the drives what their watchdogs await also while the start waits for the answer of one of them."""
        self._beat_due = self.now() + self.beat_cycles * self._period
        for link in self.links:
            link.keep_alive = self._keep_alive if on else None

    def _keep_alive(self) -> int:
        """Send what is due while no cycle runs; return when the next is due [ns]; raise LinkError."""
        if self.now() >= self._beat_due:
            self._beat_due = self.now() + self.beat_cycles * self._period
            self.beat(at_once=True)
            for drive in self.drives:
                if drive.is_operational and drive.map.watchdog == "rpdo_timer":
                    drive.write(0)
        return self._beat_due


def _refuse_tpdos(drives: Sequence[ServoDrive]) -> None:
    for drive in drives:
        drive.refuse_tpdos()
