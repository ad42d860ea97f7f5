"""The CiA 402 power state machine (IEC 61800-7-201, 6.3) as data: statusword -> state, and the path to a state.

canopen's p402 is not used: it sends 0x0F first for a quick stop from SWITCHED ON, re-enables a drive after a fault
reset, and matches states as substrings.
"""

from enum import Enum
from typing import Final

from canhaptic.canopen.objects import Controlword


class PowerState(Enum):
    """States of the power state machine, named as in the standard."""

    NOT_READY_TO_SWITCH_ON = "NOT READY TO SWITCH ON"
    SWITCH_ON_DISABLED = "SWITCH ON DISABLED"
    READY_TO_SWITCH_ON = "READY TO SWITCH ON"
    SWITCHED_ON = "SWITCHED ON"
    OPERATION_ENABLED = "OPERATION ENABLED"
    QUICK_STOP_ACTIVE = "QUICK STOP ACTIVE"
    FAULT_REACTION_ACTIVE = "FAULT REACTION ACTIVE"
    FAULT = "FAULT"
    UNKNOWN = "UNKNOWN"


_STATE_TABLE: Final = (
    # (mask, value, state): IEC 61800-7-201, table 30
    (0x4F, 0x00, PowerState.NOT_READY_TO_SWITCH_ON),
    (0x4F, 0x40, PowerState.SWITCH_ON_DISABLED),
    (0x6F, 0x21, PowerState.READY_TO_SWITCH_ON),
    (0x6F, 0x23, PowerState.SWITCHED_ON),
    (0x6F, 0x27, PowerState.OPERATION_ENABLED),
    (0x6F, 0x07, PowerState.QUICK_STOP_ACTIVE),
    (0x4F, 0x0F, PowerState.FAULT_REACTION_ACTIVE),
    (0x4F, 0x08, PowerState.FAULT),
)

_ENABLE_TABLE: Final = {
    # state -> controlword of the next transition towards OPERATION ENABLED; a fault has no way there
    PowerState.SWITCH_ON_DISABLED: Controlword.SHUTDOWN,
    PowerState.READY_TO_SWITCH_ON: Controlword.SWITCH_ON,
    PowerState.SWITCHED_ON: Controlword.ENABLE_OPERATION,
    PowerState.OPERATION_ENABLED: Controlword.ENABLE_OPERATION,
    PowerState.QUICK_STOP_ACTIVE: Controlword.DISABLE_VOLTAGE,
}

TORQUE_FREE: Final = frozenset(
    {
        # states in which the power stage gives no torque
        PowerState.NOT_READY_TO_SWITCH_ON,
        PowerState.SWITCH_ON_DISABLED,
        PowerState.READY_TO_SWITCH_ON,
        PowerState.SWITCHED_ON,
        PowerState.FAULT,
    }
)

FAULTED: Final = frozenset({PowerState.FAULT, PowerState.FAULT_REACTION_ACTIVE})

ENABLED_MASK: Final = 0x6F
ENABLED_VALUE: Final = 0x27


def _state(statusword: int) -> PowerState:
    for mask, value, state in _STATE_TABLE:
        if statusword & mask == value:
            return state
    return PowerState.UNKNOWN


_STATES: Final = tuple(_state(low_byte) for low_byte in range(256))


def drive_state(statusword: int) -> PowerState:
    """Return the state that a statusword (0x6041) shows; only its low byte matters."""
    return _STATES[statusword & 0xFF]


def is_enabled(statusword: int) -> bool:
    """Whether the statusword shows OPERATION ENABLED."""
    return statusword & ENABLED_MASK == ENABLED_VALUE


def next_controlword(state: PowerState) -> Controlword | None:
    """Return the controlword (0x6040) of the next step towards OPERATION ENABLED; None where only waiting helps."""
    return _ENABLE_TABLE.get(state)
