"""Restoring what the start wrote into a drive, last written first, once the drive reports that it is disabled.

Objects that command motion are not restored: they stay at rest.
"""

from collections.abc import Iterator

from canhaptic.canopen import objects as od
from canhaptic.drive.profile.torque_axis import TorqueAxis, Written
from canhaptic.drive.safety.power_states import PowerState
from canhaptic.errors import SdoError, cause_of


def restore(drive: TorqueAxis, problem: str = "") -> None:
    """Restore what the start wrote; objects that could not be restored are listed in `drive.unrestored`.

    Args:
        drive: Drive that is no longer in operation.
        problem: Reason why it is not known to be disabled; "" where it is disabled.
    """
    changes, drive.sdo.changes = drive.sdo.changes or [], None
    firsts: dict[tuple[int, int], Written] = {}
    for change in changes:
        firsts.setdefault(change.place, change)
    try:
        state = problem or drive.read_state().value
        if state != PowerState.SWITCH_ON_DISABLED.value:
            raise SdoError(f"not restored, because the drive shows {state}", od.STATUSWORD, 0)
        for change in reversed(changes):
            if change.before not in (None, change.after) and not _is_kept(drive, change):
                _put_back(drive, change)
        drive.unrestored = [text for first in firsts.values() if (text := "; ".join(_differences(drive, first)))]
    except Exception as error:  # a driver library, or a process without memory, raises anything
        why = cause_of(error).removeprefix(f"{drive.axis.name}: ")
        drive.unrestored = [f"{drive.sdo.describe(*place)}: {why}" for place in firsts]


def _is_kept(drive: TorqueAxis, change: Written) -> bool:
    is_limit = change.place[0] in (od.MAX_TORQUE, od.MAX_PROFILE_VELOCITY, od.MAX_MOTOR_SPEED)
    return is_limit and not drive.axis.restore_limits


def _put_back(drive: TorqueAxis, change: Written) -> None:
    """Write one value back; raise SdoError without an answer (an abort shows in `_differences`)."""
    try:
        drive.sdo.write(*change.place, change.before or 0, change.size)
    except SdoError as error:
        if error.code is None:
            raise


def _differences(drive: TorqueAxis, first: Written) -> Iterator[str]:
    """Yield the values of an object now and before the start, where they differ; raise SdoError."""
    name = drive.sdo.describe(*first.place)
    if first.before is None:
        yield f"{name} is {first.after}, unknown before"
    elif (now := drive.sdo.read(*first.place)) != first.before:
        kept = (
            "; the run leaves its limits in the drive, unless restore_limits is true" if _is_kept(drive, first) else ""
        )
        yield f"{name} is {now}, was {first.before} before the run{kept}"
