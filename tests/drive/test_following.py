"""What the drive says of the torque it gives: bits 11 and 12 of the statusword, and a measured torque that stays."""

import can
import pytest

from canhaptic.canopen.objects import StatusBit
from canhaptic.drive.safety.link_policy import StopReason
from canhaptic.errors import (
    CommandLostError,
    EmergencyError,
    NotFollowingError,
    StateLeftError,
    TorqueContradictedError,
    TorqueLimitedError,
)
from canhaptic.sim.drive.profile.state_machine import DriveState
from tests.drive.drive_bench import Bench, MakeBench, axis, started

LIMITED, FOLLOWS = int(StatusBit.INTERNAL_LIMIT), int(StatusBit.FOLLOWS_COMMAND)
HOLD, STOP = 2, 20


class Tampered:
    """Turns bits of the statusword in TPDOs, and puts another torque into them."""

    def __init__(self, b: Bench) -> None:
        self.set = self.clear = 0
        self.torque: int | None = None
        b.tampered.on_receive = self.receive

    def receive(self, message: can.Message) -> can.Message:
        if message.arbitration_id == 0x185:
            word = (int.from_bytes(message.data[:2], "little") | self.set) & ~self.clear
            torque = message.data[6:]
            if self.torque is not None:
                torque = bytearray(self.torque.to_bytes(2, "little", signed=True))
            message.data = bytearray(word.to_bytes(2, "little")) + message.data[2:6] + torque
        return message


def is_without_torque(b: Bench) -> bool:
    return b.drives[0].torque == 0.0 and b.drives[0].state is not DriveState.OPERATION_ENABLED


@pytest.mark.parametrize("read_back", ["demand", "actual", "none"])
def test_a_drive_that_follows_no_more_stops_the_rig_when_the_patience_of_a_lost_frame_is_over(bench, read_back):
    b = bench([axis(read_back=read_back)])
    tampered = Tampered(b)
    b.rig.start()
    b.run(10, torque=1.0)
    tampered.clear = FOLLOWS
    b.run(HOLD, torque=1.0)
    with pytest.raises(NotFollowingError, match=r"axis5: the drive does not follow .* statusword 0x0.*NOT_FOLLOWING"):
        b.run(1, torque=1.0)
    assert b.rig.stop_reason is StopReason.NOT_FOLLOWING
    assert b.torques_sent()[-1] == 0
    assert is_without_torque(b)


def test_two_cycles_now_and_then_are_borne_with(bench: MakeBench) -> None:
    b = bench()
    tampered = Tampered(b)
    b.rig.start()
    for _ in range(20):
        tampered.clear = FOLLOWS
        b.run(HOLD, torque=1.0)
        tampered.clear = 0
        b.run(1, torque=1.0)
    assert b.rig.is_running


def test_a_drive_that_never_shows_bit_12_is_not_judged_by_it(bench: MakeBench) -> None:
    b = bench()
    tampered = Tampered(b)
    tampered.clear = FOLLOWS
    b.rig.start()
    b.run(10, torque=1.0)
    tampered.clear = 0
    b.run(10, torque=1.0)
    tampered.clear = FOLLOWS
    samples = b.run(40, torque=1.0)
    assert b.rig.is_running
    assert samples[-1].statusword & FOLLOWS == 0, "the log has what the drive says"


def test_an_old_patience_is_forgotten_at_the_next_start(bench: MakeBench) -> None:
    b = bench()
    tampered = Tampered(b)
    b.rig.start()
    tampered.clear = FOLLOWS
    with pytest.raises(NotFollowingError):
        b.run(10)
    b.rig.start()
    b.run(10)
    assert b.rig.is_running


@pytest.mark.parametrize("read_back", ["demand", "actual"])
def test_a_limit_that_is_read_back_is_recorded_and_stops_nothing(bench: MakeBench, read_back: str) -> None:
    b = bench([axis(read_back=read_back)])
    tampered = Tampered(b)
    b.rig.start()
    tampered.set, tampered.torque = LIMITED, 50
    samples = b.run(60, torque=2.0)
    assert b.rig.is_running
    assert samples[-1].statusword & LIMITED
    assert samples[-1].torque_applied == pytest.approx(0.5)


@pytest.mark.slow_but("0.5-demand", "0.0-actual", "-2.0-demand")
@pytest.mark.parametrize("read_back", ["demand", "actual"])
@pytest.mark.parametrize("commanded", [0.5, 0.0, -2.0])
def test_a_limit_explains_no_torque_that_is_larger_or_turned(bench: MakeBench, read_back: str, commanded: float):
    """Bit 11 is on, and the drive holds an old torque: a limit can only make a torque smaller."""
    b = bench([axis(read_back=read_back)])
    tampered = Tampered(b)
    b.rig.start()
    b.run(10, torque=2.0)
    tampered.set, tampered.torque = LIMITED, 200
    b.run(3, torque=2.0)
    b.tampered.on_send = lambda message: None if message.arbitration_id == 0x205 else message
    with pytest.raises(CommandLostError, match=rf"{STOP} SYNCs in a row.*COMMAND_LOST"):
        b.run(STOP + 2, torque=commanded)
    assert is_without_torque(b)


def test_a_command_above_the_limit_now_and_then_excuses_no_frozen_torque(bench: MakeBench) -> None:
    b = bench()
    tampered = Tampered(b)
    b.rig.start()
    b.run(10, torque=2.0)
    tampered.set, tampered.torque = LIMITED, 200
    for cycle in range(2 * STOP):
        b.run(1, torque=4.0 if cycle % 2 else 1.0)
    with pytest.raises(CommandLostError):
        b.run(1, torque=1.0)
    assert is_without_torque(b)


def test_a_limit_that_nobody_reads_back_stops_the_rig(bench: MakeBench) -> None:
    b = bench([axis(read_back="none")])
    tampered = Tampered(b)
    b.rig.start()
    b.run(5, torque=1.0)
    tampered.set = LIMITED
    b.run(HOLD, torque=1.0)
    with pytest.raises(TorqueLimitedError, match=r"bit 11.*none is read back.*TORQUE_LIMITED"):
        b.run(1, torque=1.0)
    assert is_without_torque(b)


def test_a_limit_that_is_on_at_the_start_is_not_judged(bench: MakeBench) -> None:
    b = bench([axis(read_back="none")])
    Tampered(b).set = LIMITED
    b.rig.start()
    b.run(30, torque=1.0)
    assert b.rig.is_running


def test_leaving_the_state_counts_at_once_though_bit_12_goes_with_it(bench: MakeBench) -> None:
    b = started(bench)
    b.run(5, torque=1.0)
    b.buses[0].send(can.Message(arbitration_id=0x605, is_extended_id=False, data=bytes.fromhex("2b40600006000000")))
    with pytest.raises(StateLeftError, match="STATE_LEFT"):
        b.run(3, torque=1.0)


# --- a torque that is measured ------------------------------------------------------------------------------------


def test_a_measured_torque_that_stays_constant_while_commands_change_stops_the_rig(bench: MakeBench) -> None:
    b = started(bench, [axis(read_back="actual")])
    b.run(10, torque=3.0)
    b.tampered.on_send = lambda message: None if message.arbitration_id == 0x205 else message
    begin = b.clock.now()
    with pytest.raises(CommandLostError, match=rf"{STOP} SYNCs in a row.*COMMAND_LOST"):
        b.run(100, torque=1.0)
    assert b.clock.now() - begin < 60_000_000
    assert is_without_torque(b)


def test_noise_within_the_tolerance_is_no_lost_command(bench: MakeBench) -> None:
    b = bench([axis(read_back="actual")])
    tampered = Tampered(b)
    b.rig.start()
    for cycle in range(200):
        torque = 3.0 if cycle // 40 % 2 else -3.0
        tampered.torque = round(torque * 100) + (cycle * 37 % 99 - 49)
        b.run(1, torque=torque)
    assert b.rig.is_running


def test_a_measured_torque_that_wanders_is_no_lost_command_but_contradicts_them(bench: MakeBench) -> None:
    """It is never near the old command for long: it is somewhere else."""
    b = bench([axis(read_back="actual")])
    tampered = Tampered(b)
    b.rig.start()
    tampered.torque = 400

    def wander() -> None:
        for cycle in range(2 * STOP):
            tampered.torque = 400 + cycle
            b.run(1, torque=-3.0 if cycle > 10 else 3.0)

    with pytest.raises(TorqueContradictedError, match=rf"{STOP} SYNCs in a row, read 4.2 N, -3 .. 3 N commanded"):
        wander()
    assert is_without_torque(b)


def test_commands_near_the_old_one_tell_nothing_and_forget_nothing(bench: MakeBench) -> None:
    b = started(bench, [axis(read_back="actual", torque_tolerance=0.02)])
    b.run(10, torque=3.0)
    b.tampered.on_send = lambda message: None if message.arbitration_id == 0x205 else message
    b.run(60, torque=3.3)  # 30 counts away: not more than twice 20
    assert b.rig.is_running
    with pytest.raises(CommandLostError):
        b.run(30, torque=1.0)


# --- a torque that is not read back ------------------------------------------------------------------------------


def test_a_lost_rpdo_that_nothing_tells_of_is_ended_by_the_drives_own_deadline(bench: MakeBench) -> None:
    b = started(bench, [axis(read_back="none")])
    writes = [data.hex() for data in b.sent(0x605) if data[1:4] == bytes.fromhex("001405")]
    assert writes == ["4000140500000000", "2b00140564000000", "4000140500000000"]  # 100 ms, read back
    b.run(10, torque=3.0)
    b.tampered.on_send = lambda message: None if message.arbitration_id == 0x205 else message
    begin = b.clock.now()
    with pytest.raises(EmergencyError, match="EMCY 0x8250"):
        b.run(200, torque=1.0)
    assert b.clock.now() - begin < 130_000_000
    assert is_without_torque(b)


@pytest.mark.parametrize("values", [{"read_back": "demand"}, {"read_back": "none", "watchdog": False}])
def test_a_drive_whose_torque_is_read_back_or_that_has_no_watchdog_keeps_its_deadline(bench: MakeBench, values) -> None:
    b = started(bench, [axis(**values)])
    assert not [data for data in b.sent(0x605) if data[0] != 0x40 and data[1:4] == bytes.fromhex("001405")]


def test_the_deadline_is_no_fault_of_a_run_that_goes_well(bench: MakeBench) -> None:
    b = started(bench, [axis(read_back="none")])
    b.run(300, torque=0.1)
    b.rig.stop()
    assert b.drives[0].state is DriveState.SWITCH_ON_DISABLED
    b.rig.start()
    b.run(5)


@pytest.mark.parametrize("shown", [0, 1, 99])
def test_a_drive_that_gives_less_than_it_was_asked_for_is_covered_to_the_last_count(bench: MakeBench, shown: int):
    b = bench()
    tampered = Tampered(b)
    b.rig.start()
    b.run(10, torque=1.0)  # 100 per mille
    tampered.torque = shown
    b.run(1, torque=1.0)
    assert b.rig.drives[0].uncommanded == 0
    tampered.torque = 101
    b.run(1, torque=1.0)
    assert b.rig.drives[0].uncommanded == 1


@pytest.mark.parametrize("read_back", ["demand", "actual"])
def test_an_old_torque_is_borne_with_for_as_many_holds_as_a_lost_frame_however_it_is_read_back(bench, read_back):
    b = bench([axis(read_back=read_back)])
    tampered = Tampered(b)
    b.rig.start()
    b.run(10)
    tampered.torque = 0
    b.run(STOP + 1, torque=4.0)  # the first is shown by the TPDO of the SYNC after it acted
    with pytest.raises(CommandLostError):
        b.run(1, torque=4.0)


def test_a_measured_torque_before_the_first_hold_is_none_that_nobody_asked_for(bench: MakeBench) -> None:
    b = bench([axis(read_back="actual")])
    tampered = Tampered(b)
    tampered.torque = 80  # per mille, of a current that is not zero yet
    b.rig.start()
    assert b.rig.drives[0].uncommanded == 0
    b.run(1)
    assert b.rig.drives[0].uncommanded == 0
