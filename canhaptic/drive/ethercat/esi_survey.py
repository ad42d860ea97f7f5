"""Whether the drive of an ESI, or of an EEPROM (SII), can be used for cyclic torque, before anyone asks the drive.

A refusal rests only on what the file states. A file without a dictionary names process data alone; of signs, modes and
further objects only the drive itself can tell.
"""

from enum import Enum
from pathlib import Path
from typing import Any, Final, NamedTuple

from canhaptic.canopen import objects as od
from canhaptic.canopen.esi import EsiDictionary, read_esi
from canhaptic.canopen.sii import is_sii, read_sii
from canhaptic.drive.ethercat.image_map import choose_image, image_findings
from canhaptic.drive.ethercat.parameters import ASSIGN_ACTIVATE, EthercatAxisParameters
from canhaptic.drive.profile.fitness import Verdict, profile_findings, stated_default
from canhaptic.drive.survey import Survey
from canhaptic.errors import DictionaryError

_OUTPUTS: Final = range(0x1600, 0x1800)
_BITS: Final = 16  # of 0x6071, an INTEGER16
_SYNC_LIMIT: Final = 0x10F1


class Judgement(Enum):
    """Verdict on one device of a file."""

    FIT = "usable"
    CONDITIONAL = "usable with conditions"
    ASK = "only the drive can say"
    UNFIT = "not usable"


class DeviceVerdict(NamedTuple):
    """All findings on one device."""

    device: EsiDictionary
    judgement: Judgement
    reasons: tuple[str, ...]  # why it is not usable, or what only the drive can say
    conditions: tuple[str, ...]  # what the scene must supply, or the start finds out
    process_data: str  # the PDOs that would be used; "" where none is chosen
    notes: tuple[str, ...]  # what the start does about this file


def judge(path: Path, device: EsiDictionary) -> DeviceVerdict:
    """Return the verdict on one device.

    Args:
        path: Its file.
        device: The device.
    """
    refused, notes = _of_process_data(device, may_be_silent=is_sii(path)), _notes(device)
    if refused:
        return DeviceVerdict(device, Judgement.UNFIT, tuple(refused), (), "", notes)
    if not device.is_whole:
        text = "the file has no dictionary, so that modes, limits and types are not known: ask the drive (SDO)"
        carries = _pdos_with_torque(device)
        listed = f"RxPDO {', '.join(f'{of:#06x}' for of in carries)} with 0x6071" if carries else ""
        return DeviceVerdict(device, Judgement.ASK, (text,), (), listed, notes)
    reasons, conditions = _of_dictionary(path, device)
    if reasons:
        return DeviceVerdict(device, Judgement.UNFIT, reasons, conditions, "", notes)
    chosen = choose_image(device, _axis(path, device))
    text = f"RxPDO {chosen.outputs.index:#06x}{'' if chosen.outputs.is_written else ' (fixed)'}"
    text += f", TxPDO {chosen.inputs.index:#06x}{'' if chosen.inputs.is_written else ' (fixed)'}"
    text += f", torque read back: {chosen.read_back}"
    if stated_default(device, od.SUPPORTED_DRIVE_MODES) == 0:
        asked = ("0x6502 is 0 in this file, although 0x6071 can be mapped: ask the drive",)
        return DeviceVerdict(device, Judgement.ASK, asked, conditions, text, notes)
    return DeviceVerdict(device, Judgement.CONDITIONAL if conditions else Judgement.FIT, (), conditions, text, notes)


def surveyed(path: Path) -> Survey:
    """Return what a first scene needs to know of the only drive of an ESI.

    Raises:
        DictionaryError: The file cannot be read, describes several products or, as an EEPROM, no objects, or its drive
            cannot be used.
    """
    device = read_sii(path) if is_sii(path) else read_esi(path)
    verdict = judge(path, device)
    if verdict.judgement is Judgement.UNFIT or not device.is_whole:
        remedy = (
            "see canhaptic check-eds" if device.is_whole else "get the drive's ESI with its objects, from its vendor"
        )
        raise DictionaryError(f"{path}: {verdict.judgement.value}: {'; '.join(verdict.reasons)}; {remedy}")
    axis: Any = _axis(path, device)
    vendor, product, _ = device.identity
    image: Any = choose_image(device, axis)
    return Survey(device, axis, "", device.title, vendor, product, (), (), (), image, 0, ())


def _axis(path: Path, device: EsiDictionary) -> EthercatAxisParameters:
    """Return an axis whose scale and limits are placeholders; a rated torque only where the file lists none."""
    rated = 1.0 if device.get_variable(od.RATED_TORQUE) is None else None
    return EthercatAxisParameters(
        name="drive", position=0, esi=path, counts_per_unit=1.0, torque_limit=1.0, rated_torque=rated
    )


def _mapped(device: EsiDictionary) -> dict[int, list[int]]:
    """Return the mappings of each RxPDO that the file states."""
    found = {}
    for index in sorted(set(device.indices) & set(_OUTPUTS)):
        members = getattr(device.indices[index], "subindices", {})
        count = members[0].default if 0 in members and isinstance(members[0].default, int) else 0
        values = (members[n].default for n in range(1, count + 1) if n in members)
        found[index] = [value for value in values if isinstance(value, int)]
    return found


def _pdos_with_torque(device: EsiDictionary) -> list[int]:
    return [index for index, of in _mapped(device).items() if any(value >> 16 == od.TARGET_TORQUE for value in of)]


def _of_process_data(device: EsiDictionary, *, may_be_silent: bool) -> list[str]:
    """Return what the process data alone refuse; an EEPROM need not list any."""
    pdos, reasons = _mapped(device), list[str]()
    if not pdos:
        return [] if may_be_silent else ["no RxPDO: not a drive with process data"]
    torques = [[value for value in of if value >> 16 == od.TARGET_TORQUE] for of in pdos.values()]
    wide = sorted({value & 0xFF for of in torques for value in of} - {_BITS})
    if wide:
        reasons.append(f"0x6071 has {wide[0]} bits: got no INTEGER16, as the profile has it")
    if (several := max(map(len, torques))) > 1:
        reasons.append(f"{several} axes in one PDO: got several 0x6071, expected one drive for each axis")
    return reasons


def _of_dictionary(path: Path, device: EsiDictionary) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return reasons and conditions of a device with a dictionary."""
    axis = _axis(path, device)
    reasons, conditions = list[str](), list[str]()
    modes = stated_default(device, od.SUPPORTED_DRIVE_MODES)
    if device.get_variable(od.RATED_TORQUE) is None:
        conditions.append("0x6076 rated torque: not listed; set rated_torque")
    for found in (*profile_findings(device, axis), *image_findings(device, axis)):
        index, text = found.item[:6], f"{found.item}: {found.text}"
        if found.verdict is Verdict.FIT or (index == "0x6076" and axis.rated_torque is not None):
            continue
        if found.verdict is Verdict.UNKNOWN:
            conditions.append(text)
        elif index == "0x1000" and stated_default(device, od.DEVICE_TYPE) is not None:
            conditions.append(f"{found.item}: {found.text}; a default proves little, the start asks the drive")
        elif not (index == "0x6502" and modes == 0):
            reasons.append(text)
    return tuple(reasons), tuple(conditions)


def _notes(device: EsiDictionary) -> tuple[str, ...]:
    notes = []
    activate = device.assign_activate
    if activate is None:
        notes.append(
            f"no AssignActivate for SYNC0: {ASSIGN_ACTIVATE:#06x} is tried, unless bus.assign_activate says otherwise"
        )
    else:
        notes.append(f"AssignActivate {activate:#06x}")
    for item in device.startup:
        if item.place[0] == od.MODES_OF_OPERATION:
            mode = int.from_bytes(item.data, "little", signed=True)
            notes.append(f"its start-up list sets 0x6060 = {mode}: 10 is written after it")
    if device.is_whole and device.get_variable(od.INTERPOLATION_PERIOD, 1) is None:
        notes.append("no 0x60C2: the drive takes the period from SYNC0")
    if device.is_whole and device.get_variable(_SYNC_LIMIT, 2) is None:
        notes.append("no 0x10F1:02: the drive's own limit on lost frames is not known")
    return tuple(notes)


def choose(verdicts: list[DeviceVerdict], path: Path, revision: int | None) -> DeviceVerdict:
    """Return the verdict on one revision: the named one, or the highest up to it; without a name the best of all.

    Raises:
        DictionaryError: No device has a revision up to the one that was named.
    """
    if revision is None:
        order = list(Judgement)
        return min(verdicts, key=lambda of: (order.index(of.judgement), -of.device.identity[2]))
    older = [of for of in verdicts if of.device.identity[2] <= revision]
    if not older:
        known = ", ".join(f"{of.device.identity[2]:#x}" for of in verdicts)
        raise DictionaryError(f"{path}: got revision {revision:#x}, expected {known} or a later one; get its ESI")
    return max(older, key=lambda of: of.device.identity[2])
