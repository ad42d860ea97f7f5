"""What a rig knows of each of its buses, on CAN or not."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

from canhaptic.drive.clock import Clock
from canhaptic.drive.pace import Pace
from canhaptic.drive.profile.torque_axis import TorqueAxis


class Seen(Protocol):
    """What was seen on a bus."""

    intruder: str
    """Name of the first frame from elsewhere that only this master may send; empty without one."""


class BackgroundLine(Protocol):
    """Access to the objects of the drives of one bus while the cycle runs; made by `BusCycle.background`."""

    busy: Any
    """Truthy while a transfer waits or is under way."""

    def open(self) -> None:
        """Take requests: the rig runs."""

    def close(self) -> None:
        """Refuse requests, and fail those that wait: the rig has stopped."""

    def step(self) -> None:
        """Do what the rest of this cycle has room for."""

    def access(self, drive: Any) -> Any:
        """Return the access to one drive of the bus."""


class BusCycle(Protocol):
    """One bus of a rig in each cycle, at its start and at its end. Each method may raise LinkError."""

    clock_leader: bool
    """Whether its clock leads the deadlines of the rig; of one bus at most. It is asked last."""

    @property
    def clock(self) -> Clock:
        """Clock of every wait."""

    @property
    def drives(self) -> Sequence[TorqueAxis]:
        """Drives on this bus."""

    @property
    def window_ns(self) -> int:
        """Time after SYNC within which the process data must have come [ns]."""

    @property
    def seen(self) -> Seen:
        """What was seen on the bus."""

    def lead(self, pace: Pace) -> None:
        """Lead the deadlines of the rig, where the bus has a clock of its own."""

    def begin(self) -> None:
        """Restart: nothing is known of how fast the drives answer."""

    def pump(self, deadline: int) -> None:
        """Handle what arrives until `deadline` [ns]."""

    def drain(self) -> None:
        """Handle what has arrived."""

    def ask(self, woken: int) -> int:
        """Ask every drive for its process data; return when that was sent [ns]."""

    def take(self, end: int) -> bool:
        """Take the process data until all have come; return False when some had not by `end` [ns]."""

    def allow(self, latest: int) -> None:
        """Set the latest time after SYNC of an answer that follows a missing one [ns]."""

    def beat(self) -> None:
        """Send what shows the drives that the master lives."""

    def feed(self) -> None:
        """Send, while no cycle runs, the process data that a drive's watchdog waits for."""

    def keep_alive(self, send: Callable[[], int] | None) -> None:
        """Call `send` while an answer is awaited: it returns when it is to be called again [ns]. None: nothing."""

    def reserve(self) -> None:
        """Note what only this master may send, and forget who else did."""

    def mark_start(self, *, is_starting: bool) -> None:
        """Let a signal end every wait on the bus, or none."""

    def shared_hint(self) -> str:
        """Return how the bus may be shared with others without intent; empty without such a way."""

    def background(self) -> BackgroundLine:
        """Return access to the objects of the drives while the cycle runs."""

    def statistics(self) -> Mapping[str, float]:
        """Return the counts of the bus by name."""
