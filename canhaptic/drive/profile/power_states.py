"""The CiA 402 power state machine (IEC 61800-7-201, 6.3) as data: statusword -> state, and the way to a state.

Our own table instead of canopen's p402: that one sends 0x0F first for a quick stop from SWITCHED ON, re-enables after a
fault reset, and matches states as substrings.
"""

from enum import Enum
from typing import Final

from canhaptic.canopen.objects import Controlword


class DriveState(Enum):
    """States of the power state machine, named as the standard does."""

    NOT_READY_TO_SWITCH_ON = "NOT READY TO SWITCH ON"
    SWITCH_ON_DISABLED = "SWITCH ON DISABLED"
    READY_TO_SWITCH_ON = "READY TO SWITCH ON"
    SWITCHED_ON = "SWITCHED ON"
    OPERATION_ENABLED = "OPERATION ENABLED"
    QUICK_STOP_ACTIVE = "QUICK STOP ACTIVE"
    FAULT_REACTION_ACTIVE = "FAULT REACTION ACTIVE"
    FAULT = "FAULT"
    UNKNOWN = "UNKNOWN"


STATE_TABLE: Final = (
    # (mask, value, state): IEC 61800-7-201, table 30
    (0x4F, 0x00, DriveState.NOT_READY_TO_SWITCH_ON),
    (0x4F, 0x40, DriveState.SWITCH_ON_DISABLED),
    (0x6F, 0x21, DriveState.READY_TO_SWITCH_ON),
    (0x6F, 0x23, DriveState.SWITCHED_ON),
    (0x6F, 0x27, DriveState.OPERATION_ENABLED),
    (0x6F, 0x07, DriveState.QUICK_STOP_ACTIVE),
    (0x4F, 0x0F, DriveState.FAULT_REACTION_ACTIVE),
    (0x4F, 0x08, DriveState.FAULT),
)

ENABLE_TABLE: Final = {
    # state -> controlword of the next transition towards OPERATION ENABLED; a fault has no way there
    DriveState.SWITCH_ON_DISABLED: Controlword.SHUTDOWN,
    DriveState.READY_TO_SWITCH_ON: Controlword.SWITCH_ON,
    DriveState.SWITCHED_ON: Controlword.ENABLE_OPERATION,
    DriveState.OPERATION_ENABLED: Controlword.ENABLE_OPERATION,
    DriveState.QUICK_STOP_ACTIVE: Controlword.DISABLE_VOLTAGE,
}

TORQUE_FREE: Final = frozenset(
    {
        # states in which the power stage gives no torque
        DriveState.NOT_READY_TO_SWITCH_ON,
        DriveState.SWITCH_ON_DISABLED,
        DriveState.READY_TO_SWITCH_ON,
        DriveState.SWITCHED_ON,
        DriveState.FAULT,
    }
)

FAULTED: Final = frozenset({DriveState.FAULT, DriveState.FAULT_REACTION_ACTIVE})

ENABLED_MASK: Final = 0x6F
ENABLED_VALUE: Final = 0x27


def _state(statusword: int) -> DriveState:
    for mask, value, state in STATE_TABLE:
        if statusword & mask == value:
            return state
    return DriveState.UNKNOWN


_STATES: Final = tuple(_state(low_byte) for low_byte in range(256))


def drive_state(statusword: int) -> DriveState:
    """Returns the state that a statusword (0x6041) shows; only its low byte matters."""
    return _STATES[statusword & 0xFF]


def is_enabled(statusword: int) -> bool:
    """Whether the statusword shows OPERATION ENABLED."""
    return statusword & ENABLED_MASK == ENABLED_VALUE


def next_controlword(state: DriveState) -> Controlword | None:
    """Returns the controlword (0x6040) of the next step towards OPERATION ENABLED; None where only waiting helps."""
    return ENABLE_TABLE.get(state)
