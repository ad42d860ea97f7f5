"""Interface of the cycle for the start and the stop of a rig, on any fieldbus."""

from collections.abc import Sequence
from typing import Protocol

from canhaptic.drive.profile.torque_axis import TorqueAxis


class CyclicExchange(Protocol):
    """Runs the cycle of several drives."""

    @property
    def drives(self) -> Sequence[TorqueAxis]:
        """All drives."""

    @property
    def periods(self) -> int:
        """Sample times between the last two SYNCs."""

    @property
    def skipped(self) -> int:
        """SYNCs missed and left out since `begin`."""

    @property
    def sample_time_ns(self) -> int:
        """The sample time [ns]."""

    @property
    def beat_cycles(self) -> int:
        """Sample times from one sign of life of the master to the next."""

    @property
    def silence(self) -> int:
        """Silence of the master that a drive tolerates [ns]."""

    def now(self) -> int:
        """Return the time [ns]."""

    def wait_until(self, deadline: int) -> None:
        """Return when `deadline` [ns] has come."""

    def begin(self) -> None:
        """Let the next SYNC go out at once and count from there."""

    def leave_one_out(self) -> None:
        """Let the next SYNC go out one sample time later, and take what still answers the last; raise LinkError."""

    def sync(self) -> None:
        """Wait for the next deadline, send SYNC and take its answers; raise LinkError."""

    def write_zero(self) -> None:
        """Send every drive its controlword with zero torque; raise LinkError."""

    def beat(self, *, at_once: bool = False) -> None:
        """Send the master's sign of life, when due or at once; raise LinkError."""
