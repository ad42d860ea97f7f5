"""The simulated EtherCAT drive answers literal bytes, refuses what a real one refuses, and acts at its SYNC0."""

import struct

import pytest

from canhaptic.drive.ethercat.datagrams import Command
from canhaptic.drive.ethercat.segment import AlError, AlState, al_status
from canhaptic.errors import SdoError
from canhaptic.sim.drive.ethercat.drive_node import ClockParameters
from canhaptic.sim.drive.profile.state_machine import DriveState
from tests.sim_drive.ethercat_line import PERIOD, Line, make_drive

HEAD, BACK = "ffffffffffff 101010101010 88a4", "ffffffffffff 121010101010 88a4"


def carried(line: Line, frame: str) -> str:
    answer = line.cable.carry(bytes.fromhex(HEAD + frame), line.clock.now())
    assert answer is not None
    assert answer[:14].hex() == BACK.replace(" ", "")
    return answer[14:].hex(" ")


def test_each_drive_counts_and_adds_to_the_address_of_a_broadcast() -> None:
    line = Line(make_drive(), make_drive())
    # BRD 0x0130, 2 bytes: INIT is 1, both drives count
    assert carried(line, "0e10 0705 0000 3001 0200 0000 0000 0000") == (
        "0e 10 07 05 02 00 30 01 02 00 00 00 01 00 02 00"
    )


def test_station_addresses_are_set_by_position_and_an_unknown_one_is_not_answered() -> None:
    line = Line(make_drive(), make_drive())
    # APWR to the second drive (address -1), 0x0010 = 0x1002; then FPRD of 0x1002 and of 0x1003
    assert carried(line, "0e10 0201 ffff 1000 0200 0000 0210 0000").endswith("02 10 01 00")
    assert carried(line, "0e10 0401 0210 1000 0200 0000 0000 0000").endswith("02 10 01 00")
    assert carried(line, "0e10 0401 0310 1000 0200 0000 0000 0000").endswith("00 00 00 00")


def test_the_identity_is_read_from_the_eeprom_word_by_word() -> None:
    line = Line()
    carried(line, "1210 0201 0000 0205 0600 0000 0001 08000000 0000")  # APWR 0x0502: read, word 8
    assert carried(line, "1410 0101 0000 0805 0800 0000 0000000000000000 0000").endswith(
        "bc 0a 00 00 34 12 00 00 01 00"
    )


def test_an_expedited_upload_is_one_mail_each_way() -> None:
    line = Line()
    line.master.scan()
    line.master.request(0, AlState.PRE_OP)
    request = bytes.fromhex("0a00 0000 00 13 0020 40 0010 00 00000000").ljust(128, b"\0")
    line.master._one(Command.WRITE, 0x1001, 0x1000, request, 1)
    answer = line.master._one(Command.READ, 0x1001, 0x1080, bytes(128), 1).data
    assert answer[:16].hex(" ") == "0a 00 00 00 00 13 00 30 43 00 10 00 92 01 02 00"
    line.master._one(Command.READ, 0x1001, 0x1080, bytes(128), 0)  # an empty mailbox does not count


def test_a_line_goes_from_init_to_op_and_acts_at_the_next_sync0() -> None:
    line = Line(make_drive(), make_drive(ClockParameters(epoch=5_000_000_000)))
    line.start()
    assert [drive.al_state for drive in line.drives] == [AlState.OP, AlState.OP]
    assert [drive.state for drive in line.drives] == [DriveState.OPERATION_ENABLED] * 2
    line.cycle(100, -50)
    assert [drive.torque for drive in line.drives] == [0.0, 0.0]
    line.clock.wait_until(line.due - PERIOD // 4)
    line.cable.process(line.clock.now())
    assert [drive.torque for drive in line.drives] == [10.0, -5.0]
    assert (line.missed, line.unanswered, line.missed_by(0), line.missed_by(1)) == (0, 0, 0, 0)


@pytest.mark.parametrize("pipeline", [0, 1, 2])
def test_the_pipeline_is_the_number_of_further_sync0s_until_a_torque_acts(pipeline: int) -> None:
    line = Line(make_drive(syncs_late=pipeline))
    line.start()
    drive, acts = line.drives[0], list[int]()
    line.cycle(100)
    sent = drive.holds
    for _ in range(5):
        line.cycle()
        if drive.torque:
            acts.append(drive.holds - sent)
    assert acts == [1 + pipeline]


def refused(line: Line, state: AlState) -> int:
    with pytest.raises(AlError) as error:
        line.master.request(0, state)
    return error.value.code


def test_states_are_refused_with_the_code_of_their_reason() -> None:
    line = Line()
    line.master.scan()
    assert refused(line, AlState.OP) == 0x11
    assert refused(line, AlState.BOOT) == 0x13
    line.master.register(0, 0x800, struct.pack("<H", 0x1010))  # mailbox elsewhere than the EEPROM says
    assert refused(line, AlState.PRE_OP) == 0x16
    line.configure()
    line.master.map([(6, 8)])
    assert refused(line, AlState.SAFE_OP) == 0x1D
    line.master.map([(4, 10)])
    assert refused(line, AlState.SAFE_OP) == 0x1E
    line.master.map([(4, 8)])
    line.master.register(0, 0x9A0, struct.pack("<I", 100_000))
    line.master.register(0, 0x980, b"\x00\x03")
    assert refused(line, AlState.SAFE_OP) == 0x35
    line.master.register(0, 0x9A0, struct.pack("<I", PERIOD))
    line.master.register(0, 0x990, bytes(8))  # in the past
    line.master.register(0, 0x980, b"\x00\x03")
    assert refused(line, AlState.SAFE_OP) == 0x30


def test_op_is_refused_without_sync0_and_without_outputs() -> None:
    line = Line()
    line.configure()
    line.master.request(0, AlState.SAFE_OP)
    assert refused(line, AlState.OP) == 0x2D
    line.clock.wait_until(line.due + PERIOD)
    assert refused(line, AlState.OP) == 0x19
    line.cycle()
    line.master.request(0, AlState.OP)


def test_a_sync0_left_over_from_before_init_is_refused() -> None:
    line = Line()
    line.configure()
    line.master.request(0, AlState.INIT)
    line.master.map([(4, 8)])
    for number in (0, 1):
        line.master._set_manager(0, number, line.master._drives[0].managers[number])
    line.master.request(0, AlState.PRE_OP)
    assert refused(line, AlState.SAFE_OP) == 0x2C


def test_maps_and_assignments_change_in_pre_op_and_while_their_count_is_zero() -> None:
    line = Line()
    line.start()
    master = line.master
    for index in (0x1C12, 0x1600):
        with pytest.raises(SdoError) as error:
            master.write(0, index, 0, b"\0")
        assert error.value.code == 0x08000022
    master.request(0, AlState.PRE_OP)
    with pytest.raises(SdoError) as error:
        master.write(0, 0x1C12, 1, b"\x01\x16")
    assert error.value.code == 0x06010000
    master.write(0, 0x1C12, 0, b"\0")
    with pytest.raises(SdoError) as error:
        master.write(0, 0x1C12, 1, b"\x00\x1a")
    assert error.value.code == 0x06040041
    master.write(0, 0x1600, 0, b"\0")
    with pytest.raises(SdoError) as error:
        master.write(0, 0x1600, 1, struct.pack("<I", 0x60640020))  # an input
    assert error.value.code == 0x06040041


def test_silence_ends_the_torque_within_the_watchdog_and_a_full_counter_proves_nothing() -> None:
    line = Line()
    line.configure()
    line.master.register(0, 0x420, struct.pack("<H", 50))  # 5 ms
    line.master.request(0, AlState.SAFE_OP)
    for _ in range(40):
        line.cycle()
    line.master.request(0, AlState.OP)
    for _ in range(20):
        line.cycle(100)
    drive = line.drives[0]
    assert drive.torque == 10.0
    last = line.clock.now()
    line.clock.wait_until(last + 4_999_999)
    line.cable.process(line.clock.now())
    assert drive.torque == 10.0
    line.clock.wait_until(last + 5_000_000)
    line.cable.process(line.clock.now())
    assert drive.torque == 0.0
    assert al_status(line.master, 0) == (0x14, 0x1B)
    emergency = line.master.mail(0)
    assert emergency is not None
    assert (emergency.code, emergency.register) == (0x8100, 0x11)
    line.due += 10 * PERIOD
    assert line.cycle(100) is not None  # the counter is full in SAFE-OP
    assert drive.torque == 0.0


def test_too_many_sync0s_without_outputs_end_op() -> None:
    line = Line()
    line.start(limit=2)
    line.cycle(100)
    line.clock.wait_until(line.due + 3 * PERIOD)
    line.cable.process(line.clock.now())
    assert line.drives[0].torque == 0.0
    assert al_status(line.master, 0) == (0x14, 0x1A)
    assert line.missed_by(0) == 3


def test_leaving_op_while_enabled_ends_the_torque() -> None:
    line = Line()
    line.start()
    line.cycle(100)
    line.cycle(100)
    assert line.drives[0].torque == 10.0
    line.master.request(0, AlState.SAFE_OP)
    assert line.drives[0].torque == 0.0
    assert line.drives[0].state is not DriveState.OPERATION_ENABLED
