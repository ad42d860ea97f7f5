"""The CiA 402 power state machine of the simulated drive (IEC 61800-7-201, figure 2), its transitions as data."""

from enum import IntEnum
from typing import Final

from canhaptic.canopen.objects import StatusBit


class DriveState(IntEnum):
    """State of the power drive system."""

    NOT_READY_TO_SWITCH_ON = 0
    SWITCH_ON_DISABLED = 1
    READY_TO_SWITCH_ON = 2
    SWITCHED_ON = 3
    OPERATION_ENABLED = 4
    QUICK_STOP_ACTIVE = 5
    FAULT_REACTION_ACTIVE = 6
    FAULT = 7


class PowerCommand(IntEnum):
    """Command in bits 7, 3, 2, 1, 0 of the controlword (0x6040)."""

    DISABLE_VOLTAGE = 0  # xx0x
    QUICK_STOP = 1  # x01x
    SHUTDOWN = 2  # x110
    SWITCH_ON = 3  # 0111, and "disable operation" when operation is enabled
    ENABLE_OPERATION = 4  # 1111


_S, _C = DriveState, PowerCommand

_TRANSITIONS: Final = {
    (_S.SWITCH_ON_DISABLED, _C.SHUTDOWN): _S.READY_TO_SWITCH_ON,  # 2
    (_S.READY_TO_SWITCH_ON, _C.SWITCH_ON): _S.SWITCHED_ON,  # 3
    (_S.READY_TO_SWITCH_ON, _C.ENABLE_OPERATION): _S.OPERATION_ENABLED,  # 3, then 4 without another command
    (_S.READY_TO_SWITCH_ON, _C.QUICK_STOP): _S.SWITCH_ON_DISABLED,  # 7
    (_S.READY_TO_SWITCH_ON, _C.DISABLE_VOLTAGE): _S.SWITCH_ON_DISABLED,  # 7
    (_S.SWITCHED_ON, _C.ENABLE_OPERATION): _S.OPERATION_ENABLED,  # 4
    (_S.SWITCHED_ON, _C.SHUTDOWN): _S.READY_TO_SWITCH_ON,  # 6
    (_S.SWITCHED_ON, _C.QUICK_STOP): _S.SWITCH_ON_DISABLED,  # 10
    (_S.SWITCHED_ON, _C.DISABLE_VOLTAGE): _S.SWITCH_ON_DISABLED,  # 10
    (_S.OPERATION_ENABLED, _C.SWITCH_ON): _S.SWITCHED_ON,  # 5
    (_S.OPERATION_ENABLED, _C.SHUTDOWN): _S.READY_TO_SWITCH_ON,  # 8
    (_S.OPERATION_ENABLED, _C.DISABLE_VOLTAGE): _S.SWITCH_ON_DISABLED,  # 9
    (_S.OPERATION_ENABLED, _C.QUICK_STOP): _S.QUICK_STOP_ACTIVE,  # 11
    (_S.QUICK_STOP_ACTIVE, _C.DISABLE_VOLTAGE): _S.SWITCH_ON_DISABLED,  # 12
    (_S.QUICK_STOP_ACTIVE, _C.ENABLE_OPERATION): _S.OPERATION_ENABLED,  # 16, only with the option codes that stay
}

_SUPPLIED: Final = StatusBit.VOLTAGE_ENABLED | StatusBit.REMOTE
_NO_QUICK_STOP: Final = StatusBit.QUICK_STOP  # bit 5 is 1 while NO quick stop is commanded
_READY: Final = _SUPPLIED | _NO_QUICK_STOP | StatusBit.READY_TO_SWITCH_ON
_ENABLED: Final = StatusBit.READY_TO_SWITCH_ON | StatusBit.SWITCHED_ON | StatusBit.OPERATION_ENABLED

STATUSWORD: Final = {  # 0x6041 of each state, without the bits that depend on mode and limits
    _S.NOT_READY_TO_SWITCH_ON: int(_SUPPLIED),
    _S.SWITCH_ON_DISABLED: int(_SUPPLIED | StatusBit.SWITCH_ON_DISABLED),
    _S.READY_TO_SWITCH_ON: int(_READY),
    _S.SWITCHED_ON: int(_READY | StatusBit.SWITCHED_ON),
    _S.OPERATION_ENABLED: int(_SUPPLIED | _NO_QUICK_STOP | _ENABLED),
    _S.QUICK_STOP_ACTIVE: int(_SUPPLIED | _ENABLED),
    _S.FAULT_REACTION_ACTIVE: int(_SUPPLIED | _ENABLED | StatusBit.FAULT),
    _S.FAULT: int(_SUPPLIED | StatusBit.FAULT),
}

_FAULT_RESET: Final = 0x80
_QUICK_STOP_STAYS: Final = range(5, 9)  # option codes 0x605A that stay in QUICK STOP ACTIVE


def command_of(controlword: int) -> PowerCommand:
    """Command of a controlword, apart from the fault reset bit."""
    if not controlword & 0x02:
        return PowerCommand.DISABLE_VOLTAGE
    if not controlword & 0x04:
        return PowerCommand.QUICK_STOP
    if not controlword & 0x01:
        return PowerCommand.SHUTDOWN
    return PowerCommand.ENABLE_OPERATION if controlword & 0x08 else PowerCommand.SWITCH_ON


class StateMachine:
    """The power state of one simulated drive, and its transitions.

    In cyclic torque mode every stop sets the torque to 0 at once, so that the option codes 0x605B, 0x605C and 0x605E
    have no effect here; 0x605A decides where a quick stop ends.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Return to the state after power-on."""
        self.state = DriveState.NOT_READY_TO_SWITCH_ON
        self._controlword = 0

    def obey(self, controlword: int, quick_stop_option: int) -> bool:
        """Execute a controlword; return whether the state changed.

        Args:
            controlword: 0x6040 as received.
            quick_stop_option: 0x605A.
        """
        rising = controlword & ~self._controlword
        self._controlword = controlword
        state = self.state
        if state is DriveState.FAULT:
            if rising & _FAULT_RESET:
                self.state = DriveState.SWITCH_ON_DISABLED  # 15; the other bits need a command of their own
        elif not controlword & _FAULT_RESET:  # every other command has bit 7 = 0 (table 28)
            self.state = _TRANSITIONS.get((state, command_of(controlword)), state)
            if state is DriveState.QUICK_STOP_ACTIVE and self.state is DriveState.OPERATION_ENABLED:
                self.state = self.state if quick_stop_option in _QUICK_STOP_STAYS else state
            elif self.state is DriveState.QUICK_STOP_ACTIVE and quick_stop_option == 0:
                self.state = DriveState.SWITCH_ON_DISABLED
        return self.state is not state

    def quick_stop(self, quick_stop_option: int) -> None:
        """Make transition 11, as the abort connection option demands (0x6007 = 3)."""
        if self.state is DriveState.OPERATION_ENABLED:
            self.state = DriveState.QUICK_STOP_ACTIVE if quick_stop_option else DriveState.SWITCH_ON_DISABLED

    def disable_voltage(self) -> None:
        """Make transition 7, 9, 10 or 12, as the abort connection option demands (0x6007 = 2)."""
        self.state = _TRANSITIONS.get((self.state, PowerCommand.DISABLE_VOLTAGE), self.state)

    def fault(self) -> None:
        """Begin the fault reaction (transition 13) from any state that is not yet a fault."""
        if self.state is not DriveState.FAULT:
            self.state = DriveState.FAULT_REACTION_ACTIVE

    def settle(self, quick_stop_option: int) -> bool:
        """Make the transitions that need no command (1, 14, and 12 at standstill); return whether there was one."""
        before = self.state
        if before is DriveState.NOT_READY_TO_SWITCH_ON:
            self.state = DriveState.SWITCH_ON_DISABLED
        elif before is DriveState.FAULT_REACTION_ACTIVE:
            self.state = DriveState.FAULT
        elif before is DriveState.QUICK_STOP_ACTIVE and quick_stop_option not in _QUICK_STOP_STAYS:
            self.state = DriveState.SWITCH_ON_DISABLED
        return self.state is not before
