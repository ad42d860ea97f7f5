"""The present limits, ramps and reactions of a drive, compared with the scene."""

from collections.abc import Iterator

from canhaptic.canopen.objects import POSITION_LIMITS
from canhaptic.drive.profile.drive_objects import DRIVE_OBJECTS
from canhaptic.drive.profile.fitness import Finding, Verdict
from canhaptic.drive.profile.torque_axis import TorqueAxis
from canhaptic.errors import SdoError


def read_objects(drive: TorqueAxis) -> Iterator[Finding]:
    """Yield a finding for each listed object that a drive has; raise SdoError where it does not answer."""
    asked = drive.axis.written_objects
    for place, meaning in DRIVE_OBJECTS.items():
        try:
            value = drive.sdo.read(*place)
        except SdoError as error:
            if error.code is None:
                raise
            continue
        objection = _objection(drive, place, value)
        text = f"{value}" + (f", the start writes {asked[place]}" if place in asked else "")
        verdict = Verdict.UNKNOWN if objection else Verdict.FIT
        yield Finding(drive.sdo.describe(*place), verdict, f"{text}: {objection or meaning}")


def _objection(drive: TorqueAxis, place: tuple[int, int], value: int) -> str:
    """Return which limit of the scene a position limit of the drive cuts off; "" where it cuts none."""
    axis, display = drive.axis, drive.axis.admittance
    if place[0] != POSITION_LIMITS or display is None or place in axis.written_objects:
        return ""
    ends = [end for end in (display.position_low, display.position_high) if end is not None]
    counts = sorted(axis.direction * end * axis.counts_per_unit for end in ends)
    beyond = [end for end in counts if (end < value if place[1] == 1 else end > value)]
    if not beyond or not any(drive.sdo.read(place[0], sub) for sub in (1, 2)):  # both 0: no limits
        return ""
    return f"admittance.position_low or position_high is at {beyond[0]:.0f}; widen it (drive_objects) or the scene"
