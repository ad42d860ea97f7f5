"""Every way out of a run: zero torque in the very next RPDO, then disabled, as the recorded frames show."""

import math
from functools import partial

import can
import pytest

from canhaptic.canopen.objects import NmtState
from canhaptic.drive.safety.link_policy import StopReason
from canhaptic.errors import ControlError, DriveFaultError, LinkError, RigError
from canhaptic.sim.drive.profile.state_machine import DriveState
from tests.drive.drive_bench import Bench, MakeBench, axis, started


def running(make: MakeBench, **values: object) -> tuple[Bench, int]:
    """A rig in the middle of a run at 4 N; returns it with the number of RPDOs sent so far."""
    b = started(make, **values)
    b.run(10, torque=4.0)
    return b, len(b.sent(0x205))


def require_stopped_at_once(b: Bench, before: int) -> None:
    """The next RPDO is enabled with zero torque, the ones after it disabled with zero torque; the drive obeyed."""
    rpdos = [data.hex(" ") for data in b.sent(0x205)[before:]]
    assert rpdos[0] == "0f 00 00 00"
    assert rpdos[1:]
    assert set(rpdos[1:]) == {"00 00 00 00"}
    assert b.drives[0].torque == 0.0
    assert b.drives[0].state in (DriveState.SWITCH_ON_DISABLED, DriveState.FAULT)
    assert not b.rig.is_running


@pytest.mark.parametrize("rate", [1000.0, 100.0, 40.0])
def test_a_stop_without_an_account_is_zero_in_one_hold_then_disables_then_leaves_operational(bench: MakeBench, rate):
    b, before = running(bench, bus={"rate": rate})
    b.rig.stop()
    require_stopped_at_once(b, before)
    assert b.drives[0].nmt_state is NmtState.PRE_OPERATIONAL
    assert b.rig.stop_reason is StopReason.OPERATOR
    assert b.received(0x705)[-1] == b"\x7f"
    assert b.received(0x085) == []


@pytest.mark.parametrize("torque", [math.nan, math.inf, -math.inf])
def test_a_torque_that_is_not_finite_is_zero_in_the_very_next_rpdo(bench: MakeBench, torque: float) -> None:
    b, before = running(bench)
    b.rig.sync()
    with pytest.raises(ControlError, match="expected a finite number"):
        b.rig.write_torques([torque])
    require_stopped_at_once(b, before)
    assert b.rig.stop_reason is StopReason.CONTROLLER


def test_an_exception_in_the_controller_is_zero_in_the_very_next_rpdo(bench: MakeBench) -> None:
    b = bench()

    def fail() -> None:
        b.run(10, torque=4.0)
        b.rig.sync()
        before.append(len(b.sent(0x205)))
        raise ZeroDivisionError

    before: list[int] = []
    with pytest.raises(ZeroDivisionError), b.rig:
        fail()
    require_stopped_at_once(b, before[0])


def test_an_interrupt_by_the_operator_is_no_fault(bench: MakeBench) -> None:
    b = bench()

    def interrupt() -> None:
        b.run(10, torque=4.0)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), b.rig:
        interrupt()
    assert b.rig.stop_reason is StopReason.OPERATOR
    assert b.drives[0].state is DriveState.SWITCH_ON_DISABLED


@pytest.mark.parametrize("wrong", [[], [1.0, 2.0]])
def test_a_wrong_number_of_torques_stops_the_rig(bench: MakeBench, wrong: list[float]) -> None:
    b, before = running(bench)
    b.rig.sync()
    with pytest.raises(ValueError, match=r"torques for . axes"):
        b.rig.write_torques(wrong)
    require_stopped_at_once(b, before)


def test_a_fault_of_the_drive_stops_at_once_with_its_emcy_and_the_last_records(bench: MakeBench) -> None:
    b, before = running(bench)
    b.drives[0].inject_fault(0x2310)
    with pytest.raises(DriveFaultError, match=r"EMCY 0x2310.*EMERGENCY") as caught:
        b.run(3, torque=4.0)
    require_stopped_at_once(b, before)
    assert b.drives[0].state is DriveState.FAULT
    assert caught.value.records[-1].torques_per_mille == [400]


def test_a_fault_is_never_reset_and_never_enabled_again_by_itself(bench: MakeBench) -> None:
    b, before = running(bench)
    b.drives[0].inject_fault(0x2310)
    with pytest.raises(DriveFaultError):
        b.run(3, torque=4.0)
    assert not [data for data in b.sent(0x205)[before:] if data[0] & 0x80]
    with pytest.raises(RigError, match="not running"):
        b.rig.sync()
    with pytest.raises(RigError, match="not running"):
        b.rig.write_torques([0.0])


def test_the_operators_fault_reset_leaves_the_drive_disabled_and_takes_less_than_50_ms(bench: MakeBench) -> None:
    b, _ = running(bench)
    b.drives[0].inject_fault(0x2310)
    with pytest.raises(DriveFaultError):
        b.run(3, torque=4.0)
    begin = b.clock.now()
    b.rig.reset_faults()
    assert b.clock.now() - begin < 50_000_000
    assert b.drives[0].state is DriveState.SWITCH_ON_DISABLED
    b.rig.start()
    assert b.drives[0].state is DriveState.OPERATION_ENABLED


def test_an_emcy_alone_stops_the_rig_even_when_it_is_short(bench: MakeBench) -> None:
    b, before = running(bench)
    b.buses[1].send(can.Message(arbitration_id=0x085, is_extended_id=False, data=b"\x10\x43"))
    with pytest.raises(DriveFaultError, match="EMCY 0x4310"):
        b.run(2, torque=4.0)
    require_stopped_at_once(b, before)


def test_an_emcy_that_says_the_error_is_gone_stops_nothing(bench: MakeBench) -> None:
    b, _ = running(bench)
    b.buses[1].send(can.Message(arbitration_id=0x085, is_extended_id=False, data=bytes(8)))
    b.run(3, torque=4.0)
    assert b.rig.is_running
    assert b.drives[0].state is DriveState.OPERATION_ENABLED
    assert b.drives[0].torque == 4.0


def test_a_lost_heartbeat_stops_the_rig_though_tpdos_still_come(bench: MakeBench) -> None:
    b, _ = running(bench)
    b.tampered.drop(0x705)
    with pytest.raises(LinkError, match=r"heartbeat.*100 ms"):
        b.run(200, torque=4.0)
    assert b.rig.sync_index < 140
    assert b.drives[0].state is DriveState.SWITCH_ON_DISABLED


def test_a_heartbeat_with_another_nmt_state_stops_the_rig(bench: MakeBench) -> None:
    def pre_operational(message: can.Message) -> can.Message:
        if message.arbitration_id == 0x705:
            message.data = bytearray(b"\x7f")
        return message

    b, _ = running(bench)
    b.tampered.on_receive = pre_operational
    with pytest.raises(DriveFaultError, match=r"left NMT OPERATIONAL.*NMT_STATE_LEFT"):
        b.run(50, torque=4.0)
    assert b.drives[0].torque == 0.0


@pytest.mark.parametrize("command", ["80 05", "02 05", "81 05", "82 00"])
def test_an_nmt_command_from_elsewhere_ends_in_no_torque(bench: MakeBench, command: str) -> None:
    b, _ = running(bench)
    stranger = can.Message(arbitration_id=0x000, is_extended_id=False, data=bytes.fromhex(command))
    b.buses[0].send(stranger)  # from the master's own connection, so that the simulated drive hears it
    with pytest.raises(RigError):
        b.run(100, torque=4.0)
    assert b.drives[0].torque == 0.0
    assert b.drives[0].state is not DriveState.OPERATION_ENABLED


def test_one_axis_stopping_stops_all(bench: MakeBench) -> None:
    b = started(bench, [axis(5), axis(6)])
    b.run(10, torque=4.0)
    b.drives[1].inject_fault(0x2310)
    with pytest.raises(DriveFaultError, match="axis6"):
        b.run(3, torque=4.0)
    assert b.sent(0x205)[-1] == bytes(4)
    assert b.drives[0].state is DriveState.SWITCH_ON_DISABLED
    assert [drive.torque for drive in b.drives] == [0.0, 0.0]


def test_a_stop_that_no_drive_confirms_says_so(bench: MakeBench) -> None:
    b, before = running(bench)
    b.tampered.drop(0x185, 0x585, 0x705)
    with pytest.raises(RigError, match=r"not confirmed.*axis5.*cut the power"):
        b.rig.stop()
    assert b.sent(0x205)[-1] == bytes(4)
    assert len(b.sent(0x205)) > before


def test_a_dead_bus_ends_the_run_with_a_link_error(bench: MakeBench) -> None:
    b, _ = running(bench)

    def fail(message: can.Message) -> can.Message:
        raise can.CanOperationError("bus-off")

    b.tampered.on_send = fail
    with pytest.raises(LinkError, match=r"bus-off.*NOT confirmed"):
        b.run(2, torque=4.0)


def test_a_second_stop_does_nothing(bench: MakeBench) -> None:
    b, _ = running(bench)
    b.rig.stop()
    frames = len(b.frames)
    b.rig.stop()
    assert len(b.frames) == frames


DISABLE_BY_SDO = bytes.fromhex("2b40600000000000")
PRE_OPERATIONAL = bytes.fromhex("8005")


def lose_on_the_way_out(b: Bench, *can_ids: int) -> None:
    b.tampered.on_send = lambda message: None if message.arbitration_id in can_ids else message


def frames_of_the_stop(b: Bench, begin: int) -> list[str]:
    """What the master sends from the stop on, in words."""
    names = {0x205: "RPDO", 0x605: "SDO", 0x080: "SYNC", 0x000: "NMT", 0x77E: "heartbeat"}
    return [names[can_id] for _, can_id, _, is_rx in b.frames[begin:] if not is_rx]


def test_zero_by_rpdo_and_disable_by_sdo_go_out_before_the_next_sync_when_the_link_failed(bench: MakeBench) -> None:
    b = started(bench, bus={"stop_cycles": 3})
    b.run(10, torque=1.0)
    b.tampered.drop(0x185)
    begin = len(b.frames)
    with pytest.raises(LinkError, match="TPDO_LOST"):
        b.run(5, torque=1.0)
    sent = frames_of_the_stop(b, begin)
    first = sent.index("SDO")
    assert sent[first - 1] == "RPDO"
    assert b.torques_sent()[-1] == 0
    assert DISABLE_BY_SDO in b.sent(0x605)


def test_torque_is_zero_before_the_drive_is_disabled_when_the_link_is_well(bench: MakeBench) -> None:
    b = started(bench)
    b.run(10, torque=1.0)
    begin = len(b.frames)
    with pytest.raises(ControlError):
        b.rig.write_torques([math.nan])
    sent = frames_of_the_stop(b, begin)
    assert sent[:2] == ["RPDO", "SYNC"]
    assert DISABLE_BY_SDO not in b.sent(0x605)
    told = [
        (int.from_bytes(d[:2], "little") & 0x6F == 0x27, int.from_bytes(d[6:], "little")) for d in b.received(0x185)
    ]
    assert (True, 0) in told[-4:]
    assert told[-1] == (False, 0)


def test_what_does_not_reach_the_drive_is_said_again_by_sdo_and_nmt(bench: MakeBench) -> None:
    b = started(bench)
    b.run(10, torque=1.0)
    lose_on_the_way_out(b, 0x205)
    begin = b.clock.now()
    with pytest.raises(ControlError):
        b.rig.write_torques([math.nan])
    assert b.drives[0].torque == 0.0
    assert b.clock.now() - begin < 40_000_000


@pytest.mark.parametrize(
    ("lost", "cycles"),
    [((0x205,), 22), ((0x080,), 22), ((0x205, 0x080), 22), ((0x205, 0x605), 27), ((0x205, 0x605, 0x080), 27)],
)
def test_no_way_of_a_command_is_trusted_when_commands_are_lost(bench: MakeBench, lost: tuple[int, ...], cycles: int):
    """From the loss: 20 cycles until it is judged, one for the SYNC under way, and 5 to NMT where SDO is lost too."""
    b = started(bench)
    b.run(10, torque=3.0)
    lose_on_the_way_out(b, *lost)
    begin = b.clock.now()
    still = begin
    recorder = b.links[0]._recorder

    def watch(time: int, can_id: int, data: bytes | bytearray, is_rx: bool) -> None:
        nonlocal still
        if b.drives[0].torque:
            still = time
        if recorder is not None:
            recorder(time, can_id, data, is_rx)

    b.links[0]._recorder = watch
    with pytest.raises(LinkError):
        b.run(100, torque=-3.0)
    assert b.drives[0].torque == 0.0
    assert b.drives[0].state is not DriveState.OPERATION_ENABLED
    assert still - begin <= cycles * 1_000_000


def test_a_drive_that_demands_nothing_but_is_slow_to_leave_is_not_sent_out_of_operational(bench: MakeBench) -> None:
    """NMT pre-operational would be a fault to it; it has all the time that a step of the stop may take."""
    b = started(bench)
    b.run(10, torque=3.0)
    enabled = 0x1237

    def stay(message: can.Message) -> can.Message:
        if message.arbitration_id == 0x185:
            message.data = bytearray(enabled.to_bytes(2, "little") + message.data[2:6] + b"\0\0")
        return message

    b.tampered.on_receive = stay
    begin = len(b.frames)
    with pytest.raises(ControlError):
        b.rig.write_torques([math.nan])
    nmt_before_confirmation = frames_of_the_stop(b, begin).index("NMT")
    assert frames_of_the_stop(b, begin)[:nmt_before_confirmation].count("SYNC") > 90


def test_the_operators_stop_sends_no_sdo_and_one_nmt_command(bench: MakeBench) -> None:
    b = started(bench)
    b.run(10, torque=3.0)
    begin = len(b.frames)
    b.rig.stop()
    assert DISABLE_BY_SDO not in b.sent(0x605)
    assert frames_of_the_stop(b, begin).count("NMT") == 1


def test_axes_that_are_disabled_leave_operational_before_another_is_waited_for(bench: MakeBench) -> None:
    b = started(bench, [axis(5), axis(6, sdo_timeout=0.2)])
    b.run(5, torque=1.0)
    b.tampered.on_receive = lambda message: None if message.arbitration_id in (0x186, 0x586) else message
    with pytest.raises(LinkError, match="NOT confirmed to be disabled: axis6"):
        b.run(60, torque=1.0)
    assert [drive.torque for drive in b.drives] == [0.0, 0.0]
    assert b.drives[0].state is DriveState.SWITCH_ON_DISABLED, "its watchdog missed the heartbeat"


def test_a_second_signal_shortens_the_wait_for_a_confirmation_and_no_step(bench: MakeBench, monkeypatch) -> None:
    lasted = []
    for is_urgent in (False, True):
        monkeypatch.setattr("canhaptic.drive.exchange.is_urgent", partial(bool, is_urgent))
        b = started(bench)
        b.run(5, torque=1.0)
        b.tampered.drop(0x185)
        begin = b.clock.now()
        b.rig.stop(ramp=False)  # confirmed by SDO
        lasted.append(b.clock.now() - begin)
        assert b.torques_sent()[-1] == 0
        assert b.drives[0].servo.torque == 0.0
    assert lasted[1] < lasted[0]
