"""Settings of a drive that give its positions and torques their scale, sign and limits: as commissioned, and now."""

from canhaptic.canopen import objects as od
from canhaptic.canopen.objects import is_writable
from canhaptic.drive.profile.drive_objects import DRIVE_SETTINGS, Settings
from canhaptic.drive.profile.fitness import agreed_rated_torque, written_max_torque
from canhaptic.drive.profile.scaling import axis_scaling, torque_limit_per_mille
from canhaptic.drive.profile.torque_axis import TorqueAxis
from canhaptic.errors import DictionaryError, SdoError


def recorded_settings(drive: TorqueAxis) -> Settings:
    """Return the settings that a drive has now, for commissioning; those that it lacks or cannot read are left out.

    A 0x6072 that equals the limit of the scene may have been left by a run, and says nothing of the drive's own.

    Raises:
        SdoError: The drive does not answer.
    """
    found = _settings_now(drive)
    if found.get((od.MAX_TORQUE, 0)) == _limit_of_start(drive, found):
        found.pop((od.MAX_TORQUE, 0), None)
    return found


def changed_settings(drive: TorqueAxis, wanted: Settings) -> tuple[list[str], Settings]:
    """Compare the settings of a drive with those of commissioning.

    Returns:
        Each difference in words, with both values; and the values now, of those that the drive has.

    Raises:
        SdoError: The drive does not answer.
    """
    now = _settings_now(drive)
    differing = [
        place
        for place in DRIVE_SETTINGS
        if wanted.get(place) != now.get(place) and not _is_of_a_start(drive, place, wanted, now)
    ]
    shown = [
        f"{drive.sdo.describe(*place)} = {now.get(place, 'absent')}, {wanted.get(place, 'absent')} at commissioning"
        f" ({DRIVE_SETTINGS[place]})"
        for place in differing
    ]
    return shown, {place: now[place] for place in differing if place in now}


def _settings_now(drive: TorqueAxis) -> Settings:
    found = {}
    for place in DRIVE_SETTINGS:
        try:
            found[place] = drive.sdo.read(*place)
        except SdoError as error:
            if error.code is None:
                raise
    return found


def _limit_of_start(drive: TorqueAxis, settings: Settings) -> int | None:
    """Value of 0x6072 that the start writes; None where it writes none, or finds no rated torque."""
    if not (drive.quirks.writes_max_torque and is_writable(drive.dictionary, od.MAX_TORQUE)):
        return None
    counts = settings.get((od.RATED_TORQUE, 0)) if drive.quirks.reads_rated_torque else None
    try:
        rated_torque = agreed_rated_torque(drive.axis, counts, drive.quirks.rated_torque_resolution)
    except DictionaryError:  # the start refuses it
        return None
    limit = torque_limit_per_mille(drive.axis.torque_limit, axis_scaling(drive.axis, rated_torque).rated_torque)
    return written_max_torque(drive.dictionary, drive.axis, limit)


def _is_of_a_start(drive: TorqueAxis, place: tuple[int, int], wanted: Settings, now: Settings) -> bool:
    """Whether our own starts explain a difference: a limit left by a run, or a rated torque written where it was 0."""
    then, value = wanted.get(place), now.get(place)
    if place[0] == od.RATED_TORQUE:
        return drive.quirks.writes_rated_torque and not (then and value)
    limit = _limit_of_start(drive, now) if place[0] == od.MAX_TORQUE else None
    return limit is not None and value is not None and (then is None or value <= max(then, limit))
