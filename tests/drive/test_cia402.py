"""The state machine against the statuswords that the standard prints, and against the table of canopen."""

from canopen.profiles.p402 import State402

from canhaptic.drive.profile.power_states import TORQUE_FREE, DriveState, drive_state, is_enabled, next_controlword


def test_every_statusword_has_the_state_that_canopens_masks_give() -> None:
    for statusword in range(0x10000):
        theirs = {name for name, (mask, value) in State402.SW_MASK.items() if statusword & mask == value}
        ours = drive_state(statusword)
        assert ours.value in theirs or (ours is DriveState.UNKNOWN and not theirs), f"{statusword:#x} {theirs}"
        assert is_enabled(statusword) == (ours is DriveState.OPERATION_ENABLED)


def test_the_way_to_enabled_is_three_steps_and_a_fault_has_none() -> None:
    path = [DriveState.SWITCH_ON_DISABLED, DriveState.READY_TO_SWITCH_ON, DriveState.SWITCHED_ON]
    assert [next_controlword(state) for state in path] == [0x06, 0x07, 0x0F]
    for state in (DriveState.FAULT, DriveState.FAULT_REACTION_ACTIVE, DriveState.NOT_READY_TO_SWITCH_ON):
        assert next_controlword(state) is None


def test_quick_stop_leads_to_disable_and_never_to_enable() -> None:
    assert next_controlword(DriveState.QUICK_STOP_ACTIVE) == 0x00


def test_states_with_torque_are_not_taken_for_disabled() -> None:
    for state in (DriveState.OPERATION_ENABLED, DriveState.QUICK_STOP_ACTIVE, DriveState.UNKNOWN):
        assert state not in TORQUE_FREE
