"""Named deviations of real drives from the standard, chosen by `drive:` in an axis. Each field says what it changes."""

from typing import Final

from canhaptic.errors import ParameterError
from canhaptic.parameters import Parameters


class Quirks(Parameters):
    """How a drive differs; the defaults are CiA 301/402 as printed."""

    event_transmission_type: int = 255
    """Type of an event-driven RPDO: 255 (device profile) or 254 (manufacturer)."""
    writes_interpolation_period: bool = True
    """Whether 0x60C2 is written where the dictionary allows it; some drives want it for cyclic modes."""
    rated_torque_resolution: float = 1e-3
    """Newton metres per count of 0x6076."""
    abort_connection_option: int = 1
    """Value of 0x6007 for a lost master: 1 fault, 2 disable voltage, 3 quick stop."""


QUIRKS: Final[dict[str, Quirks]] = {
    "generic": Quirks(),
    "epos4": Quirks(rated_torque_resolution=1e-6),  # EPOS4 firmware specification: motor rated torque in uNm
    "manufacturer_event": Quirks(event_transmission_type=254),
    "no_interpolation_period": Quirks(writes_interpolation_period=False),
}


def quirks_of(drive: str | None) -> Quirks:
    """Returns the deviations of a named drive; those of a plain CiA 402 drive for None.

    Raises:
        ParameterError: No drive of that name is known.
    """
    if drive is None:
        return QUIRKS["generic"]
    if drive not in QUIRKS:
        raise ParameterError(f"drive: got {drive!r}, expected one of: {', '.join(sorted(QUIRKS))}")
    return QUIRKS[drive]
