"""The cycle of a rig on its buses: wait for the deadline, send SYNC, take the process data that answer it."""

from collections.abc import Sequence

from canhaptic.drive.bus_cycle import BusCycle
from canhaptic.drive.cycle_parameters import CycleParameters
from canhaptic.drive.pace import Pace
from canhaptic.drive.profile.torque_axis import TorqueAxis
from canhaptic.errors import LinkError
from canhaptic.host.stop_signal import is_urgent

_MARGIN = 10  # part of a sample time by which an answer after a missing one may be slower than those before


class Exchange:
    """The pace of a rig and the traffic on its buses in one cycle.

    Args:
        buses: The buses; the first sets the clock.
        drives: All drives, each on one of the buses.
        bus: Parameters of the cycle: rate and heartbeat.

    Attributes:
        pace: Deadlines of SYNC.
        sample_time_ns: Sample time of the cycle [ns].
        silence: Longest silence of the master that a drive tolerates [ns].
        beat_cycles: Sample times between heartbeats of the master.
        woken: Time at which the wait for the last SYNC ended [ns].
        heard: Time at which the last answer arrived, or the window closed [ns].
    """

    def __init__(self, buses: Sequence[BusCycle], drives: Sequence[TorqueAxis], bus: CycleParameters) -> None:
        self.buses = tuple(buses)
        self._first, self._others = self.buses[0], self.buses[1:]
        self._asked = tuple(sorted(self.buses, key=lambda bus: bus.clock_leader))  # the leader awaits its answer
        self.drives = tuple(drives)
        self.clock = self._first.clock
        self.now, self.wait_until = self.clock.now, self.clock.wait_until
        self.sample_time_ns, self.silence = bus.sample_time_ns, bus.master_silence_ns
        self.pace = Pace(bus.sample_time_ns)
        self.pace.times_holds = not all(one.clock_leader for one in self.buses)
        for one in self.buses:
            one.lead(self.pace)
        self._window_ns = self._first.window_ns
        self.beat_cycles = bus.heartbeat_cycles
        self._beat_due = 0  # [ns], while no cycle runs
        self.begin()

    @property
    def is_urgent(self) -> bool:
        """Whether a second signal came: no confirmation is awaited any longer."""
        return is_urgent()

    def begin(self) -> None:
        """Restart the schedule: the next SYNC is due now, and later deadlines count from it."""
        self._is_whole, self._slowest = True, -1
        for bus in self.buses:
            bus.begin()
        self._since_heartbeat = self.beat_cycles
        self.woken = self.heard = now = self.now()
        self.pace.begin(now)

    def leave_one_out(self) -> None:
        """Delay the next SYNC by one sample time, and handle what arrives until the present window ends.

        Raises:
            LinkError: A bus failed.
        """
        self.pace.leave_one_out()
        self._slowest = -1
        for bus in self.buses:
            bus.pump(self.pace.synced + self._window_ns)

    def sync(self) -> None:
        """Wait for the deadline, send SYNC on every bus and take the answers until all have come or the window closes.

        Raises:
            LinkError: A bus failed; SYNC still went out on the others.
        """
        failure: LinkError | None = None
        synced = self.woken = self._wait()
        for bus in self._asked:
            try:
                synced = bus.ask(synced)
            except LinkError as error:
                failure = error
        self.pace.sent(synced)
        end, was_whole, is_whole = synced + self._window_ns, self._is_whole, True
        for bus in self.buses:
            if not bus.take(end):
                is_whole = False
        self._is_whole = is_whole
        self.heard = heard = self.now()
        if heard - synced > self._slowest and is_whole and was_whole:
            self._allow(heard - synced)
        if failure is not None:
            raise failure

    def _allow(self, slowest: int) -> None:
        """Set the latest time of an answer after a missing one, from the slowest known to be its SYNC's [ns]."""
        self._slowest = slowest
        for bus in self.buses:
            bus.allow(slowest + self.sample_time_ns // _MARGIN)

    def _wait(self) -> int:
        """Handle what arrives until the next deadline that is met; return the time at its end [ns]."""
        pace = self.pace
        while True:
            self._first.pump(pace.due)
            for bus in self._others:
                bus.drain()
            if pace.is_met(woken := self.now()):
                return woken

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

        Skipped SYNCs count: a master that runs late must not seem dead to drives that time its heartbeat.

        Raises:
            LinkError: It could not be sent.
        """
        self._since_heartbeat += self.pace.periods
        if at_once or self._since_heartbeat >= self.beat_cycles:
            self._since_heartbeat = 0
            failure: LinkError | None = None
            for bus in self.buses:
                try:
                    bus.beat()
                except LinkError as error:  # the drives of the other buses need theirs all the same
                    failure = error
            if failure is not None:
                raise failure

    def keep_alive_while_waiting(self, *, on: bool) -> None:
        """Send the drives what their watchdogs await also while the start waits for the answer of one of them."""
        self._beat_due = self.now() + self.beat_cycles * self.sample_time_ns
        for bus in self.buses:
            bus.keep_alive(self._keep_alive if on else None)

    def _keep_alive(self) -> int:
        """Send what is due while no cycle runs; return when the next is due [ns]; raise LinkError."""
        if self.now() >= self._beat_due:
            self._beat_due = self.now() + self.beat_cycles * self.sample_time_ns
            self.beat(at_once=True)
            for bus in self.buses:
                bus.feed()
        return self._beat_due
