"""The state machine against the statuswords that the standard prints, and against the table of canopen."""

from types import SimpleNamespace
from typing import Any

from canopen.profiles.p402 import State402

from canhaptic.canopen.objects import DataType
from canhaptic.drive.profile.fitness import _of_value
from canhaptic.drive.safety.link_policy import StopReason
from canhaptic.drive.safety.power_states import TORQUE_FREE, PowerState, drive_state, is_enabled, next_controlword


def test_every_statusword_has_the_state_that_canopens_masks_give() -> None:
    for statusword in range(0x10000):
        theirs = {name for name, (mask, value) in State402.SW_MASK.items() if statusword & mask == value}
        ours = drive_state(statusword)
        assert ours.value in theirs or (ours is PowerState.UNKNOWN and not theirs), f"{statusword:#x} {theirs}"
        assert is_enabled(statusword) == (ours is PowerState.OPERATION_ENABLED)


def test_the_way_to_enabled_is_three_steps_and_a_fault_has_none() -> None:
    path = [PowerState.SWITCH_ON_DISABLED, PowerState.READY_TO_SWITCH_ON, PowerState.SWITCHED_ON]
    assert [next_controlword(state) for state in path] == [0x06, 0x07, 0x0F]
    for state in (PowerState.FAULT, PowerState.FAULT_REACTION_ACTIVE, PowerState.NOT_READY_TO_SWITCH_ON):
        assert next_controlword(state) is None


def test_quick_stop_leads_to_disable_and_never_to_enable() -> None:
    assert next_controlword(PowerState.QUICK_STOP_ACTIVE) == 0x00


def test_states_with_torque_are_not_taken_for_disabled() -> None:
    for state in (PowerState.OPERATION_ENABLED, PowerState.QUICK_STOP_ACTIVE, PowerState.UNKNOWN):
        assert state not in TORQUE_FREE


def test_the_numbers_of_stop_reasons_in_old_logs_keep_their_meaning() -> None:
    numbers = [0, 1, *range(10, 19), *range(20, 36)]
    assert [reason.value for reason in StopReason] == numbers
    assert StopReason(22).name == "STATE_LEFT"
    assert StopReason(23).name == "NMT_STATE_LEFT"


def test_a_signed_object_takes_values_from_its_least_to_its_largest_and_none_beyond() -> None:
    for data_type, bits in ((DataType.INTEGER8, 8), (DataType.INTEGER16, 16), (DataType.INTEGER32, 32)):
        variable: Any = SimpleNamespace(index=0x6071, subindex=0, data_type=data_type, min=None, max=None)
        for value in (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1):
            assert _of_value(variable, value) is None
            assert "limited to" in str(_of_value(variable, value + (1 if value > 0 else -1)))
