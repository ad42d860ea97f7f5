"""Time from a request to the answer of a drive, through adapter, driver and bus."""

from statistics import median
from typing import Final, NamedTuple

from canhaptic.canopen import objects as od
from canhaptic.drive.can.bus_budget import round_rate
from canhaptic.drive.can.servo_drive import ServoDrive

_READS: Final = 100
_MARGIN: Final = 1.1


class RoundTrip(NamedTuple):
    """Times [s] of repeated reads of one object, and the window in which TPDOs must arrive at the rate of the scene."""

    axis: str
    least: float
    median: float
    largest: float
    window: float
    rate: float  # that this drive and adapter keep, with the same tpdo_timeout [Hz]

    @property
    def fits(self) -> bool:
        """Whether every answer came within the window."""
        return self.largest <= self.window

    def advice(self) -> str:
        """Return what the times mean for the scene."""
        if self.fits:
            return f"within the {1e3 * self.window:.3g} ms in which TPDOs must arrive (tpdo_timeout / rate)"
        return (
            f"TPDOs must arrive within {1e3 * self.window:.3g} ms (tpdo_timeout / rate), else they count as late; "
            f"lower bus.rate to {self.rate:g} Hz. Part of the time may be the drive's own, for SDO"
        )


def measure_round_trip(drive: ServoDrive) -> RoundTrip:
    """Read the device type of a drive many times by SDO; nothing is written.

    Raises:
        StartError: The drive does not answer.
    """
    clock, times = drive.link.clock, []
    for _ in range(_READS):
        begin = clock.now()
        drive.sdo.read(od.DEVICE_TYPE)
        times.append((clock.now() - begin) * 1e-9)
    largest, part = max(times), drive.bus.tpdo_timeout
    rate = round_rate(part / (_MARGIN * largest)) if largest else drive.bus.rate
    return RoundTrip(drive.axis.name, min(times), median(times), largest, part * drive.bus.sample_time, rate)
