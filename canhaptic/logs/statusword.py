"""The power state in a statusword (0x6041), decoded bit by bit in the words of IEC 61800-7-201, 6.3.

Independent of the table of the master (`canhaptic.drive.profile.power_states`): the reader of a log must not share a
mistake with the writer of its frames.
"""

from typing import Final

from canhaptic.canopen.objects import StatusBit

ENABLED: Final = "OPERATION ENABLED"
_UNKNOWN: Final = "UNKNOWN"
_STEPS: Final = {
    StatusBit(0): "",
    StatusBit.READY_TO_SWITCH_ON: "READY TO SWITCH ON",
    StatusBit.READY_TO_SWITCH_ON | StatusBit.SWITCHED_ON: "SWITCHED ON",
    StatusBit.READY_TO_SWITCH_ON | StatusBit.SWITCHED_ON | StatusBit.OPERATION_ENABLED: ENABLED,
}
_LADDER: Final = StatusBit.READY_TO_SWITCH_ON | StatusBit.SWITCHED_ON | StatusBit.OPERATION_ENABLED


def state_text(statusword: int) -> str:
    """Return the name of the state in the words of the standard; "UNKNOWN" where no state has these bits."""
    bits = StatusBit(statusword & 0xFF)
    step = _STEPS.get(bits & _LADDER)
    if step is None:
        return _UNKNOWN
    if StatusBit.SWITCH_ON_DISABLED in bits:
        return "SWITCH ON DISABLED" if not step and StatusBit.FAULT not in bits else _UNKNOWN
    if StatusBit.FAULT in bits:
        return {"": "FAULT", ENABLED: "FAULT REACTION ACTIVE"}.get(step, _UNKNOWN)
    if not step:
        return "NOT READY TO SWITCH ON"
    if StatusBit.QUICK_STOP in bits:  # inverted in the standard: set where no quick stop is under way
        return step
    return "QUICK STOP ACTIVE" if step == ENABLED else _UNKNOWN
