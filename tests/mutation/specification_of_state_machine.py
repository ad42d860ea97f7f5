"""What `canhaptic.sim.drive.profile.state_machine` must do, from IEC 61800-7-201, figure 2 and table of commands."""

from types import ModuleType
from typing import Any

from tests.mutation.specification_of_cia402 import fits, state_of

POWER_ON = "NOT_READY_TO_SWITCH_ON"
SOD, RTSO, SO, OE = "SWITCH_ON_DISABLED", "READY_TO_SWITCH_ON", "SWITCHED_ON", "OPERATION_ENABLED"
QSA, FRA, FAULT = "QUICK_STOP_ACTIVE", "FAULT_REACTION_ACTIVE", "FAULT"
STATES = (POWER_ON, SOD, RTSO, SO, OE, QSA, FRA, FAULT)  # in the order of their numbers

COMMAND_CODING = {  # low byte of the controlword; bit 7 makes it a fault reset and no other command
    "xxxxxx0x": "DISABLE_VOLTAGE",
    "xxxxx01x": "QUICK_STOP",
    "xxxxx110": "SHUTDOWN",
    "xxxx0111": "SWITCH_ON",
    "xxxx1111": "ENABLE_OPERATION",
}
COMMANDS = tuple(COMMAND_CODING.values())
#         DISABLE_VOLTAGE QUICK_STOP SHUTDOWN SWITCH_ON ENABLE_OPERATION
FIGURE = {
    POWER_ON: (POWER_ON, POWER_ON, POWER_ON, POWER_ON, POWER_ON),
    SOD: (SOD, SOD, RTSO, SOD, SOD),
    RTSO: (SOD, SOD, RTSO, SO, OE),
    SO: (SOD, SOD, RTSO, SO, OE),
    OE: (SOD, QSA, RTSO, SO, OE),
    QSA: (SOD, QSA, QSA, QSA, QSA),
    FRA: (FRA, FRA, FRA, FRA, FRA),
    FAULT: (FAULT, FAULT, FAULT, FAULT, FAULT),
}
ENDS_BY_ITSELF, STAYS = (-1, 1, 2, 3, 4, 9), (5, 6, 7, 8)  # option codes 0x605A; 0: no quick stop, disable at once
OPTIONS = (0, *ENDS_BY_ITSELF, *STAYS)
SETTLES = {POWER_ON: SOD, FRA: FAULT}
STATUSWORDS = {POWER_ON: 0x210, SOD: 0x250, RTSO: 0x231, SO: 0x233, OE: 0x237, QSA: 0x217, FRA: 0x21F, FAULT: 0x218}
BITS_ABOVE = (0x0000, 0x0100, 0xFF00)
WORDS = [
    (above | low, place, name)
    for low in range(0x100)
    for above in BITS_ABOVE
    for place, (pattern, name) in enumerate(COMMAND_CODING.items())
    if fits(low, pattern)
]
ONE_WORD_EACH = (0x00, 0x02, 0x06, 0x07, 0x0F)


def machine_in(module: ModuleType, state: str) -> Any:
    """A machine that is in a state and has seen no controlword."""
    machine = module.StateMachine()
    machine.state = module.DriveState[state]
    return machine


def after_command(state: str, place: int, option: int) -> str:
    """Name of the state after a command, by the figure and the option code."""
    then = FIGURE[state][place]
    if state == QSA and COMMANDS[place] == "ENABLE_OPERATION" and option in STAYS:
        return OE  # transition 16
    return SOD if then == QSA and option == 0 else then


def judge(module: ModuleType) -> None:
    """Raises when the module is not what the standard says."""
    _names_and_words(module)
    _commands(module)
    _fault_reset(module)
    _transitions_without_command(module)


def _names_and_words(module: ModuleType) -> None:
    assert [state.name for state in module.DriveState] == list(STATES)
    assert [int(state) for state in module.DriveState] == list(range(8))
    assert [command.name for command in module.PowerCommand] == list(COMMANDS)
    assert {state.name: word for state, word in module.STATUSWORD.items()} == STATUSWORDS
    assert all(state_of(word) == state for state, word in STATUSWORDS.items())
    for word, _, name in WORDS:
        assert module.command_of(word).name == name


def _commands(module: ModuleType) -> None:
    machine = module.StateMachine()
    assert machine.state.name == POWER_ON
    for state in STATES:
        before = module.DriveState[state]
        for word, place, _ in WORDS[::7]:  # 7 and the 3 bits above share no factor: every command with every bit
            if state == FAULT and word & 0x80:
                continue
            machine.reset()
            machine.state = before
            then = state if word & 0x80 else after_command(state, place, 2)
            assert machine.obey(word, 2) is (then != state)
            assert machine.state.name == then
        for option in STAYS + ENDS_BY_ITSELF if state == QSA else OPTIONS:  # with 0 there is no QUICK STOP ACTIVE
            for place, word in enumerate(ONE_WORD_EACH):
                machine.reset()
                machine.state = before
                then = after_command(state, place, option)
                assert machine.obey(word, option) is (then != state)
                assert machine.state.name == then


def _fault_reset(module: ModuleType) -> None:
    for command in ONE_WORD_EACH:  # with any other command, the reset enables nothing
        machine = machine_in(module, FAULT)
        assert machine.obey(command, 2) is False
        assert machine.obey(command | 0x80, 2) is True
        assert machine.state.name == SOD
    machine = machine_in(module, OE)
    machine.obey(0x8F, 2)
    assert machine.state.name == OE
    machine.fault()
    machine.settle(2)
    assert [machine.obey(word, 2) for word in (0x8F, 0x80, 0x00, 0x80)] == [False, False, False, True]
    machine = machine_in(module, FAULT)
    machine.obey(0x80, 2)
    machine.reset()
    assert machine.state.name == POWER_ON
    machine.state = module.DriveState.FAULT
    assert machine.obey(0x80, 2)  # after a reset the edge counts anew


def _transitions_without_command(module: ModuleType) -> None:
    for state in STATES:
        for option in OPTIONS:
            machine = machine_in(module, state)
            then = SOD if state == QSA and option not in STAYS else SETTLES.get(state, state)
            assert machine.settle(option) is (then != state)
            assert machine.state.name == then
            machine = machine_in(module, state)
            machine.quick_stop(option)
            assert machine.state.name == (state if state != OE else QSA if option else SOD)
        machine = machine_in(module, state)
        machine.disable_voltage()
        assert machine.state.name == FIGURE[state][0]
        machine = machine_in(module, state)
        machine.fault()
        assert machine.state.name == (FAULT if state == FAULT else FRA)
