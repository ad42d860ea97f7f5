"""The CiA 402 state machine in the drive: statuswords, commands by SDO, reactions timed by SYNC.

Its transitions are judged by `tests/mutation/specification_of_state_machine.py`.
"""

import pytest

from canhaptic.sim.drive.profile.state_machine import DriveState
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


@pytest.mark.parametrize("state", list(DriveState))
def test_statuswords_have_the_bits_that_the_standard_tells_states_by(rig: Rig, state: DriveState) -> None:
    rig.drive.servo.machine.state = state
    rig.drive.servo.update()
    assert rig.drive.store.find(0x6041).number == STATUSWORDS[state]


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
