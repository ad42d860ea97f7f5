"""Access of the start of a drive to its objects: read and written, one at a time."""

from typing import Protocol


class ObjectAccess(Protocol):
    """Reads and writes integer objects of one drive: SDO over CAN, or over the mailbox of EtherCAT (CoE).

    Every method raises SdoError where the drive aborts or does not answer.
    """

    def read(self, index: int, subindex: int = 0) -> int:
        """Return the value of an object."""

    def probe(self, index: int, subindex: int = 0) -> int:
        """Return the value of an object; ask once only."""

    def read_within(self, limit: int, index: int, subindex: int = 0) -> int:
        """Return the value of an object; all attempts together take at most `limit` [ns]."""

    def write(self, index: int, subindex: int, value: int) -> None:
        """Write an object."""

    def describe(self, index: int, subindex: int = 0) -> str:
        """Return an object as `0x6072:00 Max torque`."""
