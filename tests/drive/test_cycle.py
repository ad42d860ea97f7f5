"""The cyclic exchange: what acts when, what is counted, what the link policy does with what is missing."""

import errno
import itertools

import can
import pytest

from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.control.passivity import LoopProperties, build_controller
from canhaptic.control.ports import axis_ports
from canhaptic.cycle import Cycle
from canhaptic.drive.safety.link_policy import StopReason
from canhaptic.errors import CommandLostError, DriveFaultError, InputError, LinkError
from canhaptic.sim.drive.profile.state_machine import DriveState
from tests.drive.drive_bench import MakeBench, axis, started


@pytest.mark.slow_but("actual-synchronous-2", "none-event-1", "demand-synchronous-2")
@pytest.mark.parametrize(("rpdo", "delay"), [("synchronous", 2), ("event", 1)])
@pytest.mark.parametrize("read_back", ["demand", "actual", "none"])
def test_a_torque_is_reported_for_exactly_the_holds_in_which_it_acted(bench: MakeBench, rpdo, delay, read_back) -> None:
    b = started(bench, [axis(read_back=read_back)], bus={"rpdo": rpdo})
    commands, samples = [0.5 * k for k in range(1, 9)], []
    for command in commands:
        samples.append(b.rig.sync()[0])
        b.rig.write_torques([command])
    applied = [sample.torque_applied for sample in samples]
    assert applied == pytest.approx([0.0] * delay + commands[:-delay])


@pytest.mark.slow_but("none-before_update", "actual-after_update", "demand-before_update")
@pytest.mark.parametrize("twin", ["before_update", "after_update"])
@pytest.mark.parametrize("read_back", ["demand", "actual", "none"])
def test_of_a_drive_that_acts_a_sync_late_every_hold_is_booked_with_its_own_torque(bench: MakeBench, read_back, twin):
    late = axis(read_back=read_back, quirks=("acts_a_sync_late",), demand_reported=twin.partition("_")[0])
    b = started(bench, [late], drive_values={"syncs_late": 1, "torque_read_back": twin})
    commands, samples, acted = [0.5 * k for k in range(1, 9)], [], []
    for command in commands:
        acted.append(b.drives[0].torque)  # in the hold that ends at the next SYNC
        samples.append(b.rig.sync()[0].torque_applied)
        b.rig.write_torques([command])
    assert samples[1:] == pytest.approx(acted[1:])
    assert samples == pytest.approx([0.0] * 3 + commands[:-3])
    assert b.rig.drives[0].uncommanded == 0


def test_work_by_reported_torque_and_position_is_the_energy_of_the_mass(bench: MakeBench) -> None:
    """Free mass of 1 kg: the sum of torque times displacement is its kinetic energy, at any delay."""
    b = started(bench, [axis(counts_per_unit=1e9)])
    work, last = 0.0, b.rig.sync()[0]
    for k in range(50):
        b.rig.write_torques([float(k % 7 - 2)])
        sample = b.rig.sync()[0]
        work += sample.torque_applied * (sample.position - last.position)
        last = sample
    assert work == pytest.approx(0.5 * b.drives[0].servo.motor.velocity ** 2, abs=1e-9)


def test_a_drive_that_reports_the_next_demand_is_shifted_back_by_one(bench: MakeBench) -> None:
    b = started(bench, [axis(demand_reported="after")], drive_values={"torque_read_back": "after_update"})
    samples = []
    for command in [1.0, 2.0, 3.0, 4.0]:
        samples.append(b.rig.sync()[0].torque_applied)
        b.rig.write_torques([command])
    assert samples == pytest.approx([0.0, 0.0, 1.0, 2.0])


def test_behind_a_lost_tpdo_that_showed_the_next_torque_the_command_of_that_hold_is_booked(bench: MakeBench) -> None:
    b = started(bench, [axis(demand_reported="after")], drive_values={"torque_read_back": "after_update"})
    samples = []
    for k, command in enumerate([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]):
        b.tampered.drop(*([0x185] if k == 3 else []))
        samples.append(b.rig.sync()[0])
        b.rig.write_torques([command])
    assert [sample.fresh for sample in samples] == [True, True, True, False, True, True]
    assert [sample.torque_applied for sample in samples if sample.fresh] == pytest.approx([0.0, 0.0, 1.0, 3.0, 3.0])


def test_direction_turns_position_and_torque_together(bench: MakeBench) -> None:
    b = started(bench, [axis(direction=-1)])
    samples = b.run(10, torque=2.0)
    assert min(b.torques_sent()) == -200
    assert samples[-1].torque_applied == pytest.approx(2.0)
    assert samples[-1].position > samples[0].position


def test_the_rpdo_is_one_image_of_controlword_and_torque(bench: MakeBench) -> None:
    b = started(bench)
    b.run(3, torque=1.5)
    assert b.sent(0x205)[-1] == bytes.fromhex("0f 00 96 00")
    b.run(1, torque=-1.5)
    assert b.sent(0x205)[-1] == bytes.fromhex("0f 00 6a ff")


def test_missing_tpdos_hold_then_let_go_in_one_hold_then_stop(bench: MakeBench) -> None:
    b = started(bench, bus={"hold_cycles": 2, "stop_cycles": 6})
    b.run(5, torque=4.0)
    b.tampered.drop(0x185)
    sent_before = len(b.torques_sent())
    with pytest.raises(LinkError, match=r"TPDO.*6 SYNCs in a row.*TPDO_LOST") as caught:
        b.run(20, torque=7.0)
    torques = b.torques_sent()[sent_before:]
    assert torques[:2] == [400, 400]
    assert set(torques[2:]) == {0}
    assert len(caught.value.records) == 10
    assert b.rig.stop_reason is StopReason.TPDO_LOST
    assert b.drives[0].state is DriveState.SWITCH_ON_DISABLED


def test_the_controller_has_the_torque_again_with_the_first_tpdo_after_a_gap(bench: MakeBench) -> None:
    b = started(bench)
    b.run(5, torque=4.0)
    b.tampered.drop(0x185)
    samples = b.run(2, torque=7.0)
    assert [sample.fresh for sample in samples] == [False, False]
    assert {sample.position for sample in samples} == {samples[0].position}
    b.tampered.on_receive = lambda message: message
    sample = b.run(1, torque=7.0)[0]
    assert sample.fresh
    assert b.torques_sent()[-3:] == [400, 400, 700]
    assert b.rig.link_statistics()["missed_tpdos"] == 2
    assert b.rig.link_statistics()["success_rate"] == pytest.approx(1.0 - 2.0 / 8.0)


def test_a_second_tpdo_for_one_sync_is_counted_and_left_out(bench: MakeBench) -> None:
    b = started(bench, [axis(5), axis(6)])
    copies: list[can.Message] = []

    def double(message: can.Message) -> can.Message:
        if message.arbitration_id == 0x185 and not copies:
            copies.append(message)
            copy = bytearray(message.data)
            copy[2] ^= 0xFF
            b.buses[1].send(can.Message(arbitration_id=0x185, is_extended_id=False, data=copy))
        return message

    before = b.run(3)[-1]
    b.tampered.on_receive = double
    after = b.run(3)
    assert copies
    statistics = b.rig.link_statistics()
    assert statistics["duplicate"] + statistics["late"] == 1
    assert {sample.position for sample in after} == {before.position}


def test_a_tpdo_that_comes_after_its_window_is_late_and_never_taken_for_the_next(bench: MakeBench) -> None:
    b = started(bench)
    b.run(3)
    withheld: list[can.Message] = []

    def withhold(message: can.Message) -> can.Message | None:
        if message.arbitration_id == 0x185 and not withheld:
            withheld.append(message)
            return None
        return message

    b.tampered.on_receive = withhold
    b.run(1)
    wrong = bytearray(withheld[0].data)
    wrong[2:6] = (77777).to_bytes(4, "little")
    b.buses[1].send(can.Message(arbitration_id=0x185, is_extended_id=False, data=wrong))
    sample = b.run(1)[0]
    assert sample.fresh
    assert sample.position == pytest.approx(0.01)
    assert b.rig.link_statistics()["late"] == 1


@pytest.mark.parametrize("data", [b"", b"\x37", b"\x37\x12\xe8\x03\0\0\0", bytes(3)])
def test_a_short_tpdo_is_counted_and_left_out(bench: MakeBench, data: bytes) -> None:
    b = started(bench)
    b.run(2)
    b.tampered.on_receive = lambda message: _with_data(message, 0x185, data)
    sample = b.run(1)[0]
    assert not sample.fresh
    assert sample.position == pytest.approx(0.01)
    assert b.rig.link_statistics()["short"] == 1


def _with_data(message: can.Message, can_id: int, data: bytes) -> can.Message:
    if message.arbitration_id == can_id:
        message.data, message.dlc = bytearray(data), len(data)
    return message


def test_foreign_remote_extended_and_error_frames_change_nothing(bench: MakeBench) -> None:
    b = started(bench)
    b.run(2)
    strangers = [
        can.Message(arbitration_id=0x123, is_extended_id=False, data=b"\1\2"),
        can.Message(arbitration_id=0x185, is_extended_id=True, data=bytes(8)),
        can.Message(arbitration_id=0x185, is_extended_id=False, is_remote_frame=True, dlc=8),
        can.Message(arbitration_id=0x185, is_extended_id=False, is_error_frame=True),
    ]
    for stranger in strangers:
        b.buses[1].send(stranger)
    samples = b.run(2)
    assert all(sample.fresh and sample.position == pytest.approx(0.01) for sample in samples)
    statistics = b.rig.link_statistics()
    assert (statistics["foreign"], statistics["error_frames"]) == (3, 1)


def test_a_full_queue_is_tried_once_more_and_then_stops_the_rig(bench: MakeBench) -> None:
    b = started(bench)
    b.run(3, torque=2.0)
    failures = [1]

    def refuse(message: can.Message) -> can.Message:
        if message.arbitration_id == 0x205 and failures[0]:
            failures[0] -= 1
            raise OSError(errno.ENOBUFS, "No buffer space available")
        return message

    b.tampered.on_send = refuse
    b.run(1, torque=2.0)
    assert b.rig.link_statistics()["send_failures"] == 1
    failures[0] = 2
    with pytest.raises(LinkError, match="txqueuelen"):
        b.run(1, torque=2.0)
    assert b.rig.stop_reason is StopReason.SEND_FAILED
    assert b.drives[0].torque == 0.0
    assert b.drives[0].state is DriveState.SWITCH_ON_DISABLED


@pytest.mark.parametrize(("limit", "byte", "bit"), [(1.0, 4, 0x01), (None, 5, 0x80), (None, 4, 0x80), (None, 4, 0x10)])
def test_a_position_that_jumps_stops_the_rig(bench: MakeBench, limit: float | None, byte: int, bit: int) -> None:
    b = started(bench, [axis(speed_limit=limit)])
    b.run(3, torque=1.0)

    def jump(message: can.Message) -> can.Message:
        if message.arbitration_id == 0x185:
            message.data[byte] ^= bit  # of byte 4 the lowest is 65536 counts: 0.66 m in one millisecond
        return message

    b.tampered.on_receive = jump
    with pytest.raises(DriveFaultError, match="speed limit"):
        b.run(2, torque=1.0)
    assert b.rig.stop_reason is StopReason.POSITION_JUMP


def test_one_count_of_a_coarse_encoder_is_no_jump(bench: MakeBench) -> None:
    """At 1 kHz a count of 0.1 m is a motion of 100 m/s from one SYNC to the next."""
    b = started(bench, [axis(counts_per_unit=10.0)])
    b.run(3, torque=1.0)
    moved = itertools.count()

    def move(message: can.Message) -> can.Message:
        if message.arbitration_id == 0x185:
            message.data[2:6] = (next(moved) // 40).to_bytes(4, "little")
        return message

    b.tampered.on_receive = move
    b.run(200, torque=1.0)
    assert b.rig.stop_reason is StopReason.NONE


def test_the_master_heartbeat_is_sent_by_the_count_of_syncs(bench: MakeBench) -> None:
    b = started(bench)
    before = len(b.sent(0x77E))
    b.run(200)
    assert len(b.sent(0x77E)) - before == 10
    assert set(b.sent(0x77E)) == {b"\x05"}
    assert b.drives[0].state is DriveState.OPERATION_ENABLED


def test_two_runs_give_the_same_frames_at_the_same_times(bench: MakeBench) -> None:
    runs = []
    for _ in range(2):
        b = started(bench)
        b.run(50, torque=1.0)
        b.rig.stop()
        runs.append(b.frames)
    assert runs[0] == runs[1]


def test_no_frame_ever_carries_more_than_the_torque_limit(bench: MakeBench) -> None:
    b = started(bench, [axis(torque_limit=3.006)])
    b.run(4, torque=3.0055)
    b.run(4, torque=-9.0)
    assert b.torques_sent()[-8:] == [300] * 4 + [-300] * 4


def test_a_reversal_on_the_wire_rises_by_the_rate_limit(bench: MakeBench) -> None:
    b = started(bench, [axis(torque_rate_limit=500.0)])
    b.run(4, torque=2.0)
    b.run(3, torque=-2.0)
    assert b.torques_sent()[-7:] == [50, 100, 150, 200, -50, -100, -150]


def test_a_rate_below_one_per_mille_a_cycle_still_arrives(bench: MakeBench) -> None:
    b = started(bench, [axis(torque_rate_limit=2.5)])
    b.run(12, torque=1.0)
    assert b.torques_sent()[-12:] == [0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3]


def test_a_lost_tpdo_never_raises_a_torque_above_what_is_asked_now(bench: MakeBench) -> None:
    b = started(bench)
    b.run(3, torque=2.0)
    b.tampered.drop(0x185)
    for torque in (2.0, 1.0, -1.0):
        b.rig.sync()
        b.rig.write_torques([torque])
    assert b.torques_sent()[-4:] == [200, 200, 100, 0]


def test_a_drive_that_never_hears_its_rpdo_stops_the_rig_before_its_old_torque_does_harm(bench: MakeBench) -> None:
    b = started(bench, bus={"stop_cycles": 8})
    b.run(5, torque=4.0)
    b.tampered.on_send = lambda message: None if message.arbitration_id == 0x205 and message.data[2] else message
    with pytest.raises(CommandLostError, match=r"old torque.*8 SYNCs in a row.*COMMAND_LOST"):
        b.run(12, torque=1.0)
    assert b.drives[0].torque == 0.0
    assert b.drives[0].state is DriveState.SWITCH_ON_DISABLED


def test_a_torque_that_the_drive_itself_limits_is_no_lost_command(bench: MakeBench) -> None:
    b = started(bench, bus={"stop_cycles": 8}, drive_values={"torque_limit": 3.0})
    samples = b.run(40, torque=6.0)
    assert samples[-1].torque_applied == pytest.approx(3.0)


def test_a_few_lost_rpdos_are_no_lost_command(bench: MakeBench) -> None:
    b = started(bench, bus={"stop_cycles": 8})
    b.run(5, torque=4.0)
    sent = itertools.count()
    b.tampered.on_send = lambda message: None if message.arbitration_id == 0x205 and not next(sent) % 12 else message
    for cycle in range(300):
        b.run(1, torque=4.0 + 0.01 * (cycle % 7))
    assert b.rig.is_running


@pytest.mark.parametrize("controllers", [0, 2])
def test_a_cycle_wants_one_controller_for_each_axis(bench: MakeBench, controllers: int) -> None:
    wall, loop = SpringDamperWall(stiffness=100.0), LoopProperties(sample_time=1e-3)
    several = [build_controller(wall, "unprotected", None, loop) for _ in range(controllers)]
    with pytest.raises(InputError, match=f"controllers for {controllers} axes and a rig of 1"):
        Cycle(bench().rig, axis_ports(several))
