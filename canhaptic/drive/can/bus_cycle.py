"""One CAN bus in the cycle of a rig: SYNC, the TPDOs that answer it, and the master's heartbeat."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING

from canhaptic.canopen.objects import HEARTBEAT_BASE, SYNC_FRAME_COB_ID, NmtState
from canhaptic.drive.axis_parameters import CanBusParameters
from canhaptic.drive.can.bus_budget import budget_of, has_room_for_sdo, own_frames
from canhaptic.drive.can.link import Link
from canhaptic.drive.can.servo_drive import ServoDrive, SyncWindow
from canhaptic.drive.pace import Pace
from canhaptic.errors import LinkError

if TYPE_CHECKING:
    from canhaptic.drive.can.background_sdo import SdoLine

_HEARTBEAT = bytes([NmtState.OPERATIONAL])
_SHARED_PORT = (
    "; on udp_multicast all scenes with one port hear each other on every channel: "
    "give each its own bus.options: {port: ...}"
)


class CanBusCycle:
    """A CAN bus of a rig; see `drive.bus_cycle.BusCycle`.

    Args:
        link: The bus.
        drives: All drives on it.
        bus: Parameters of the bus: windows and heartbeat.

    Raises:
        InputError: A node ID is used twice.
        BusBudgetError: The frames of one cycle do not fit.
    """

    clock_leader = False

    def __init__(self, link: Link, drives: Sequence[ServoDrive], bus: CanBusParameters) -> None:
        self.link, self.drives, self._bus = link, tuple(drives), bus
        self.clock, self.seen = link.clock, link
        self.pump, self.drain, self._poll, self._send = link.pump, link.drain, link.poll, link.send
        self.budget = budget_of(self.drives, bus)
        self.window_ns = round(bus.tpdo_timeout * bus.sample_time_ns)
        self._heartbeat_cob_id = HEARTBEAT_BASE + bus.master_id
        self._guarded = tuple(drive for drive in self.drives if drive.map.watchdog == "life_guarding")
        self._timed = tuple(drive for drive in self.drives if drive.map.watchdog == "rpdo_timer")
        self._count = len(self.drives)
        self._window = SyncWindow()
        for drive in self.drives:
            drive.window = self._window

    def lead(self, pace: Pace) -> None:
        """Do nothing: SYNC follows the deadlines."""

    def begin(self) -> None:
        """Restart: nothing is known of how fast the drives answer."""
        self._window.latest = self.window_ns

    def ask(self, woken: int) -> int:
        """Send SYNC; return when it was sent [ns].

        Raises:
            LinkError: It was not sent.
        """
        window = self._window
        window.is_open, window.pending, window.synced = True, self._count, woken
        for drive in self.drives:
            drive.expect_tpdos()
        try:
            return self._send(SYNC_FRAME_COB_ID, b"")  # a replay knows this time, and no other
        except LinkError:
            window.pending = 0
            self._refuse_tpdos()
            raise

    def take(self, end: int) -> bool:
        """Take TPDOs until all have arrived; return False when some had not by `end` [ns].

        Raises:
            LinkError: The bus failed.
        """
        window, poll = self._window, self._poll
        while window.pending and poll(end):
            pass
        window.is_open = False
        if window.pending:
            self._refuse_tpdos()
            return False
        return True

    def _refuse_tpdos(self) -> None:
        for drive in self.drives:
            drive.refuse_tpdos()

    def allow(self, latest: int) -> None:
        """Set the latest time of a TPDO after a missing one [ns]."""
        self._window.latest = latest

    def beat(self) -> None:
        """Send the master's heartbeat, and a guard request to drives that time those.

        Raises:
            LinkError: One of them could not be sent; the others were.
        """
        failure: LinkError | None = None
        try:
            self._send(self._heartbeat_cob_id, _HEARTBEAT)
        except LinkError as error:
            failure = error
        for drive in self._guarded:
            try:
                drive.guard()
            except LinkError as error:
                failure = error
        if failure is not None:
            raise failure

    def feed(self) -> None:
        """Send the RPDOs that a drive times, with zero torque, while no cycle runs; raise LinkError."""
        for drive in self._timed:
            if drive.is_operational:
                drive.write(0)

    def keep_alive(self, send: Callable[[], int] | None) -> None:
        """Call `send` while an answer is awaited: it returns when it is to be called again [ns]. None: nothing."""
        self.link.keep_alive = send

    def reserve(self) -> None:
        """Note the COB-IDs that only this master may send, and forget who else did."""
        self.link.reserve(own_frames(self.link, self.drives, self._bus))

    def mark_start(self, *, is_starting: bool) -> None:
        """Let a signal end every wait on the bus, or none."""
        self.link.is_starting = is_starting

    def shared_hint(self) -> str:
        """Return how the bus may be shared with others without intent; empty without such a way."""
        return _SHARED_PORT if self._bus.interface == "udp_multicast" else ""

    def background(self) -> "SdoLine":
        """Return SDO access to the drives while the cycle runs."""
        from canhaptic.drive.can.background_sdo import SdoLine

        return SdoLine(self.link, has_room_for_sdo(self.budget, self._bus))

    def statistics(self) -> Mapping[str, float]:
        """Return the counts of the link by name."""
        return asdict(self.link.statistics)


def can_buses(
    links: Link | Sequence[Link], drives: Sequence[ServoDrive], bus: CanBusParameters
) -> "tuple[CanBusCycle, ...]":
    """Return the buses of a rig in the cycle.

    Args:
        links: The buses; the first sets the clock.
        drives: All drives, each on one of the links.
        bus: Parameters of the buses.

    Raises:
        InputError: A node ID is used twice on one bus.
        BusBudgetError: The frames of one cycle do not fit a bus.
    """
    each = (links,) if isinstance(links, Link) else links
    return tuple(CanBusCycle(link, [drive for drive in drives if drive.link is link], bus) for link in each)
