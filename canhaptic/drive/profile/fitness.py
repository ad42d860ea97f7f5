"""Whether an object dictionary is fit for cyclic torque, judged before any drive is asked.

A refusal rests only on what the dictionary states. An object listed without a default, and a rated torque of 0, are
`unknown`: the live value decides at the start.
"""

from enum import Enum
from typing import Final, NamedTuple

from canhaptic.canopen import objects as od
from canhaptic.canopen.dictionary import Dictionary
from canhaptic.drive.profile.quirks import quirks_of
from canhaptic.drive.profile.torque_axis_parameters import TorqueAxisParameters
from canhaptic.errors import DictionaryError

_RATED_TORQUE_TOLERANCE: Final = 1e-3  # configuration and drive may differ by rounding, not by more


class Verdict(Enum):
    """What a finding means for cyclic torque."""

    FIT = "fit"
    UNKNOWN = "unknown"
    REFUSED = "refused"


class Finding(NamedTuple):
    """One statement of a dictionary, judged."""

    item: str  # object or part, as `0x6502 supported drive modes`
    verdict: Verdict
    text: str  # value seen, value expected, what to do


def profile_findings(dictionary: Dictionary, axis: TorqueAxisParameters) -> list[Finding]:
    """Returns what the objects of CiA 402 in a dictionary say about its fitness for cyclic torque."""
    return [
        _device_type(dictionary),
        _target_torque(dictionary),
        _drive_modes(dictionary),
        _rated_torque(dictionary, axis),
        _max_torque(dictionary, axis),
    ]


def agreed_rated_torque(axis: TorqueAxisParameters, counts: int | None, resolution: float = 1e-3) -> float:
    """Returns the rated torque of the axis [N*m or N] on which drive and configuration agree.

    Args:
        axis: May state `rated_torque`.
        counts: 0x6076 of the motor; None or 0 when the drive does not know it.
        resolution: Newton metres (or newtons) per count of 0x6076.

    Raises:
        DictionaryError: Neither knows it, or they disagree.
    """
    if not counts:
        if axis.rated_torque is None:
            seen = "is 0" if counts == 0 else "is not stated"
            raise DictionaryError(
                f"{axis.name}: rated torque: 0x6076 {seen} by the drive and the configuration has none; "
                "set rated_torque (torque of the axis at 1000 per mille)"
            )
        return axis.rated_torque
    stated = counts * resolution * axis.transmission
    configured = axis.rated_torque
    if configured is not None and abs(configured - stated) > _RATED_TORQUE_TOLERANCE * stated:
        raise DictionaryError(
            f"{axis.name}: rated_torque: got {configured:g}, but the drive states 0x6076 = {counts}, which is "
            f"{stated:g} with transmission {axis.transmission:g}; correct one of them or leave rated_torque out"
        )
    return stated


def _stated(dictionary: Dictionary, index: int, subindex: int = 0) -> int | None:
    variable = dictionary.get_variable(index, subindex)
    default = None if variable is None else variable.default
    return default if isinstance(default, int) else None


def _device_type(dictionary: Dictionary) -> Finding:
    stated = _stated(dictionary, od.DEVICE_TYPE)
    item = "0x1000 device type"
    if stated is None:
        return Finding(item, Verdict.UNKNOWN, "not stated; read from the drive")
    if stated & 0xFFFF != od.CIA402_PROFILE:
        return Finding(item, Verdict.REFUSED, f"got {stated:#010x}, expected the low word 0x0192 of a CiA 402 drive")
    return Finding(item, Verdict.FIT, f"{stated:#010x}, a CiA 402 drive")


def _target_torque(dictionary: Dictionary) -> Finding:
    if od.TARGET_TORQUE not in dictionary:
        return Finding("0x6071 target torque", Verdict.REFUSED, "missing; this drive takes no cyclic torque")
    return Finding("0x6071 target torque", Verdict.FIT, "listed")


def _drive_modes(dictionary: Dictionary) -> Finding:
    stated = _stated(dictionary, od.SUPPORTED_DRIVE_MODES)
    item = "0x6502 supported drive modes"
    if stated is None:
        return Finding(item, Verdict.UNKNOWN, "not stated; read from the drive, and 0x6061 must confirm mode 10")
    if not stated & od.CYCLIC_SYNC_TORQUE_BIT:
        return Finding(item, Verdict.REFUSED, f"got {stated:#06x}, expected bit 9 (cyclic synchronous torque) set")
    return Finding(item, Verdict.FIT, f"{stated:#06x}, bit 9 is set")


def _rated_torque(dictionary: Dictionary, axis: TorqueAxisParameters) -> Finding:
    item = "0x6076 rated torque"
    stated = _stated(dictionary, od.RATED_TORQUE)
    is_read = quirks_of(axis.quirks).reads_rated_torque
    if axis.rated_torque is not None and not is_read:
        return Finding(item, Verdict.UNKNOWN, f"{axis.rated_torque:g} from the configuration alone (quirks)")
    if not is_read:
        return Finding(item, Verdict.REFUSED, "not read (quirks), and the configuration has no rated_torque; set it")
    if axis.rated_torque is not None:
        return Finding(item, Verdict.FIT, f"{axis.rated_torque:g} from the configuration, compared with the drive")
    if od.RATED_TORQUE not in dictionary:
        return Finding(item, Verdict.REFUSED, "missing, and the configuration has no rated_torque; set it")
    if not stated:
        return Finding(item, Verdict.UNKNOWN, "not stated; read from the drive, or set rated_torque")
    return Finding(item, Verdict.UNKNOWN, f"{stated} mN*m by default; the live value counts")


def _max_torque(dictionary: Dictionary, axis: TorqueAxisParameters) -> Finding:
    item = "0x6072 max torque"
    variable = dictionary.get_variable(od.MAX_TORQUE, 0)
    if variable is None:
        return Finding(
            item, Verdict.UNKNOWN, f"missing; the limit of {axis.torque_limit:g} is kept by the master alone"
        )
    if not quirks_of(axis.quirks).writes_max_torque:
        return Finding(item, Verdict.UNKNOWN, f"not written (quirks); the master alone keeps {axis.torque_limit:g}")
    if not variable.writable:
        return Finding(item, Verdict.UNKNOWN, f"read-only; the limit of {axis.torque_limit:g} is kept by the master")
    return Finding(item, Verdict.FIT, f"written from torque_limit {axis.torque_limit:g}")
