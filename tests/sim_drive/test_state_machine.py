"""The CiA 402 state machine against a truth table written from the standard's figure, not from the code's data."""

import pytest

from canhaptic.sim.drive.profile.state_machine import DriveState, StateMachine
from tests.sim_drive.drive_on_bus import PERIOD, Rig

SOD, RTSO, SO, OE = (
    DriveState.SWITCH_ON_DISABLED,
    DriveState.READY_TO_SWITCH_ON,
    DriveState.SWITCHED_ON,
    DriveState.OPERATION_ENABLED,
)
QSA, FRA, FAULT, NRTSO = (
    DriveState.QUICK_STOP_ACTIVE,
    DriveState.FAULT_REACTION_ACTIVE,
    DriveState.FAULT,
    DriveState.NOT_READY_TO_SWITCH_ON,
)

# controlword:   0x00   0x02   0x06   0x07  0x0F   0x80
TRUTH = {
    NRTSO: (NRTSO, NRTSO, NRTSO, NRTSO, NRTSO, NRTSO),
    SOD: (SOD, SOD, RTSO, SOD, SOD, SOD),
    RTSO: (SOD, SOD, RTSO, SO, OE, RTSO),
    SO: (SOD, SOD, RTSO, SO, OE, SO),
    OE: (SOD, QSA, RTSO, SO, OE, OE),
    QSA: (SOD, QSA, QSA, QSA, QSA, QSA),  # with 0x605A = 2
    FRA: (FRA, FRA, FRA, FRA, FRA, FRA),
    FAULT: (FAULT, FAULT, FAULT, FAULT, FAULT, SOD),
}
# a command has bit 7 = 0 (table 28): with it 1 there is the fault reset alone
CONTROLWORDS = (0x00, 0x02, 0x06, 0x07, 0x0F, 0x80)
CASES = [(state, word, then) for state, row in TRUTH.items() for word, then in zip(CONTROLWORDS, row, strict=True)]


@pytest.mark.parametrize(("state", "controlword", "expected"), CASES)
def test_every_command_in_every_state_leads_where_the_standard_says(
    state: DriveState, controlword: int, expected: DriveState
) -> None:
    machine = StateMachine()
    machine.state = state
    assert machine.obey(controlword, 2) == (state != expected)
    assert machine.state == expected


@pytest.mark.parametrize("ignored_bits", [0x0010, 0x0100, 0xFF70])
def test_bits_of_mode_and_manufacturer_change_no_command(ignored_bits: int) -> None:
    for state, controlword, expected in CASES:
        machine = StateMachine()
        machine.state = state
        machine.obey(controlword | ignored_bits, 2)
        assert machine.state == expected


@pytest.mark.parametrize(
    ("option", "after_stop", "after_settling", "after_enabling"),
    [
        (0, SOD, SOD, SOD),
        (1, QSA, SOD, SOD),
        (2, QSA, SOD, SOD),
        (3, QSA, SOD, SOD),
        (5, QSA, QSA, OE),
        (6, QSA, QSA, OE),
    ],
)
def test_quick_stop_option_decides_where_a_quick_stop_ends(
    option: int, after_stop: DriveState, after_settling: DriveState, after_enabling: DriveState
) -> None:
    machine = StateMachine()
    machine.state = OE
    machine.obey(0x02, option)
    assert machine.state == after_stop
    machine.settle(option)
    assert machine.state == after_settling
    machine.obey(0x0F, option)
    assert machine.state == after_enabling


def test_fault_is_reset_by_a_rising_edge_only_and_never_reenables() -> None:
    machine = StateMachine()
    machine.state = OE
    machine.obey(0x8F, 2)
    assert machine.state == OE  # bit 7 is no command here; the others still enable
    machine.fault()
    machine.settle(2)
    machine.obey(0x8F, 2)
    assert machine.state == FAULT  # the bit was set before the fault
    machine.obey(0x0F, 2)
    machine.obey(0x8F, 2)
    assert machine.state == SOD
    machine.obey(0x8F, 2)
    assert machine.state == SOD


# statusword of each state as it goes over the wire: bits 4 (voltage) and 9 (remote) set, bit 12 follows in mode 10
STATUSWORDS = {
    NRTSO: 0x0210,
    SOD: 0x0250,
    RTSO: 0x0231,
    SO: 0x0233,
    OE: 0x0237,
    QSA: 0x0217,
    FRA: 0x021F,
    FAULT: 0x0218,
}
MASKS = {
    SOD: (0x4F, 0x40),
    RTSO: (0x6F, 0x21),
    SO: (0x6F, 0x23),
    OE: (0x6F, 0x27),
    QSA: (0x6F, 0x07),
    FRA: (0x4F, 0x0F),
    FAULT: (0x4F, 0x08),
    NRTSO: (0x4F, 0x00),
}


@pytest.mark.parametrize("state", list(DriveState))
def test_statuswords_have_the_bits_that_the_standard_tells_states_by(rig: Rig, state: DriveState) -> None:
    rig.drive.servo.machine.state = state
    rig.drive.servo.update()
    word = rig.drive.store.find(0x6041).number
    assert word == STATUSWORDS[state]
    matching = [s for s, (mask, value) in MASKS.items() if word & mask == value]
    assert matching == [state]


def test_controlwords_by_sdo_walk_the_states_before_nmt_operational(rig: Rig) -> None:
    seen = []
    for controlword in (0x06, 0x07, 0x0F, 0x07, 0x06, 0x00):
        assert rig.write(0x6040, 0, controlword, 2) == "ok"
        seen.append(rig.read(0x6041)[:5])
    assert seen == ["31 02", "33 02", "37 02", "33 02", "31 02", "50 02"]


def test_fault_reaction_shows_for_one_sync_and_ends_in_fault(rig: Rig) -> None:
    rig.enable()
    rig.drive.inject_fault(0x2310)
    words = [frame[1][:5] for _ in range(3) for frame in rig.sync() if frame[0] == 0x185]
    assert words == ["1f 02", "18 02", "18 02"]
    rig.send(0x205, "80 00 00 00")
    assert rig.sync()[-1][1][:5] == "50 02"


@pytest.mark.parametrize("period", [PERIOD // 4, PERIOD, 20 * PERIOD])
def test_a_quick_stop_shows_for_one_sync_of_the_masters_own_period_though_one_was_lost(rig: Rig, period: int) -> None:
    """The drive is built for 1 ms; a master of another package may send its SYNC at any other rate."""

    def statusword() -> str:
        (word,) = [content[:5] for cob_id, content in rig.run(rig.now + period) + rig.send(0x080) if cob_id == 0x185]
        return word

    rig.start()
    for controlword in ("0600", "0700", "0f00"):
        rig.send(0x205, controlword + "0000")
        statusword()
    rig.run(rig.now + period)  # without SYNC
    statusword()
    rig.send(0x205, "02 00 00 00")
    assert [statusword() for _ in range(3)] == ["17 02", "50 02", "50 02"]
