"""What a CAN adapter at USB can keep up with, before it was measured.

Full-speed USB moves data once per frame of 1 ms: a SYNC waits up to 1 ms, and so do the TPDOs that answer it. The times
are over-estimates for a quiet host; `canhaptic check --host --bus` measures the real ones.
"""

from typing import Final, NamedTuple


class Adapter(NamedTuple):
    """Over-estimates of the times that an adapter adds."""

    round_trip: float  # from the SYNC to its TPDOs in this process, bus and drive included [s]
    jitter: float  # of the SYNC [s]
    channel: str

    @property
    def fastest(self) -> float:
        """Highest rate [Hz] at which the TPDOs arrive within `WINDOW`."""
        return WINDOW / self.round_trip


WINDOW: Final = 0.7
"""Fraction of the sample time in which the TPDOs may arrive; the rest is for the controllers and the RPDOs."""

ADAPTERS: Final = {
    "gs_usb": Adapter(3e-3, 1e-3, "0"),
    "pcan": Adapter(3e-3, 1e-3, "PCAN_USBBUS1"),
    "kvaser": Adapter(3e-3, 1e-3, "0"),
    "ixxat": Adapter(3e-3, 1e-3, "0"),
    "vector": Adapter(3e-3, 1e-3, "0"),
    "slcan": Adapter(20e-3, 2e-3, "/dev/ttyACM0"),  # 27 letters a frame, and the timer of the serial chip
}
