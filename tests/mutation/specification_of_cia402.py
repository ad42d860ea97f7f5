"""What `canhaptic.drive.safety.power_states` must do, from the tables in IEC 61800-7-201 and CiA 402-2."""

from types import ModuleType

# Statusword, low byte: x is any. CiA 402-2, table "State coding".
STATE_CODING = {
    "x0xx0000": "NOT_READY_TO_SWITCH_ON",
    "x1xx0000": "SWITCH_ON_DISABLED",
    "x01x0001": "READY_TO_SWITCH_ON",
    "x01x0011": "SWITCHED_ON",
    "x01x0111": "OPERATION_ENABLED",
    "x00x0111": "QUICK_STOP_ACTIVE",
    "x0xx1111": "FAULT_REACTION_ACTIVE",
    "x0xx1000": "FAULT",
}
NEXT_CONTROLWORD = {
    "NOT_READY_TO_SWITCH_ON": None,  # the drive leaves it by itself
    "SWITCH_ON_DISABLED": 0x06,
    "READY_TO_SWITCH_ON": 0x07,
    "SWITCHED_ON": 0x0F,
    "OPERATION_ENABLED": 0x0F,
    "QUICK_STOP_ACTIVE": 0x00,  # never straight back to torque
    "FAULT_REACTION_ACTIVE": None,
    "FAULT": None,  # never by itself
    "UNKNOWN": None,
}
WITH_TORQUE = {"OPERATION_ENABLED", "QUICK_STOP_ACTIVE", "FAULT_REACTION_ACTIVE", "UNKNOWN"}
BITS_ABOVE = (0x0000, 0x0200, 0x1F00, 0xFF00)


def fits(word: int, pattern: str) -> bool:
    """Whether the low byte of a word has the bits of a pattern."""
    return all(bit in ("x", seen) for bit, seen in zip(pattern, f"{word & 0xFF:08b}", strict=True))


def state_of(word: int) -> str:
    """Name of the state by the printed table; UNKNOWN where no row fits."""
    return next((name for pattern, name in STATE_CODING.items() if fits(word, pattern)), "UNKNOWN")


EXPECTED = [(above | low, state_of(low)) for low in range(0x100) for above in BITS_ABOVE]


def judge(module: ModuleType) -> None:
    """Raises when the module is not what the standard says."""
    assert {state.name for state in module.PowerState} == set(NEXT_CONTROLWORD)
    for word, name in EXPECTED:
        assert module.drive_state(word).name == name
        assert module.is_enabled(word) is (name == "OPERATION_ENABLED")
        assert (word & module.ENABLED_MASK == module.ENABLED_VALUE) is (name == "OPERATION_ENABLED")
    for state in module.PowerState:
        assert module.next_controlword(state) == NEXT_CONTROLWORD[state.name]
        assert (state in module.TORQUE_FREE) is (state.name not in WITH_TORQUE)
        assert (state in module.FAULTED) is state.name.startswith("FAULT")
