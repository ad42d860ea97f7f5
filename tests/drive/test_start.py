"""The fail-closed start: every step confirmed on the wire, on our dictionary and on every cyclic-torque vendor file."""

from pathlib import Path

import pytest

from canhaptic.canopen.objects import NmtState
from canhaptic.drive.safety.power_states import is_enabled
from canhaptic.errors import StartError
from canhaptic.sim.drive.profile.state_machine import DriveState
from tests.drive.drive_bench import OUR_EDS, RATED_TORQUE, MakeBench, axis, started

VENDOR_FILES = ("elmo_gold.dcf", "zeroerr_erob.eds", "maxon_epos4.dcf", "kollmorgen_rgm.eds")


def test_the_start_ends_with_the_drive_enabled_and_every_torque_zero(bench: MakeBench) -> None:
    b = started(bench)
    assert b.drives[0].state is DriveState.OPERATION_ENABLED
    assert b.drives[0].nmt_state is NmtState.OPERATIONAL
    assert set(b.torques_sent()) == {0}


def test_the_start_sends_the_frames_that_cia_301_and_402_ask_for_in_order(bench: MakeBench) -> None:
    b = started(bench)
    wanted = [
        (0x605, "40 00 10 00 00 00 00 00"),  # device type, before anything is written
        (0x000, "80 05"),  # NMT enter pre-operational
        (0x605, "2b 17 10 00 14 00 00 00"),  # producer heartbeat 20 ms
        (0x605, "40 02 65 00 00 00 00 00"),  # supported drive modes
        (0x605, "40 41 60 00 00 00 00 00"),  # statusword
        (0x605, "2b 71 60 00 00 00 00 00"),  # target torque 0
        (0x605, "40 76 60 00 00 00 00 00"),  # rated torque
        (0x605, "2b 72 60 00 20 03 00 00"),  # max torque 800 per mille
        (0x605, "23 16 10 01 64 00 7e 00"),  # consumer heartbeat: node 126, 100 ms
        (0x605, "23 00 18 01 85 01 00 80"),  # TPDO1 off, bit 31
        (0x605, "2f 00 18 02 01 00 00 00"),  # type 1: every SYNC
        (0x605, "2f 00 1a 00 00 00 00 00"),  # no entries
        (0x605, "23 00 1a 01 10 00 41 60"),  # statusword
        (0x605, "23 00 1a 02 20 00 64 60"),  # position actual value
        (0x605, "23 00 1a 03 10 00 74 60"),  # torque demand
        (0x605, "2f 00 1a 00 03 00 00 00"),  # three entries
        (0x605, "23 00 18 01 85 01 00 00"),  # TPDO1 on
        (0x605, "40 00 1a 03 00 00 00 00"),  # read back
        (0x605, "23 00 16 01 10 00 40 60"),  # controlword
        (0x605, "23 00 16 02 10 00 71 60"),  # target torque
        (0x605, "40 00 16 02 00 00 00 00"),  # read back
        (0x605, "2f 60 60 00 0a 00 00 00"),  # mode of operation 10
        (0x605, "40 61 60 00 00 00 00 00"),  # mode display
        (0x000, "01 05"),  # NMT start
        (0x080, ""),  # SYNC
        (0x205, "00 00 00 00"),  # zero torque
        (0x605, "40 71 60 00 00 00 00 00"),  # target torque as it arrived
        (0x605, "40 64 60 00 00 00 00 00"),  # position by SDO
        (0x205, "06 00 00 00"),  # shutdown
        (0x205, "07 00 00 00"),  # switch on
        (0x205, "0f 00 00 00"),  # enable operation
    ]
    sent = iter([(can_id, data.hex(" ")) for _, can_id, data, is_rx in b.frames if not is_rx])
    for frame in wanted:
        assert frame in sent, f"{frame[0]:#x} {frame[1]} missing or out of order"


def test_the_first_samples_are_those_of_the_first_enabled_sync(bench: MakeBench) -> None:
    b = started(bench)
    syncs = len(b.sent(0x080))
    first = b.rig.sync()[0]
    assert len(b.sent(0x080)) == syncs
    assert first == (0, pytest.approx(0.01), 0.0, first.statusword, True)
    assert is_enabled(first.statusword)
    b.rig.write_torques([0.0])
    assert b.rig.sync()[0].sync_index == 1


@pytest.mark.parametrize("rpdo", ["synchronous", "event"])
@pytest.mark.parametrize("name", VENDOR_FILES)
def test_every_cyclic_torque_vendor_dictionary_is_brought_up_and_run(bench: MakeBench, vendor_eds, name, rpdo) -> None:
    b = started(bench, [axis(eds=vendor_eds / name)], bus={"rpdo": rpdo})
    samples = b.run(20, torque=2.0)
    assert all(sample.fresh for sample in samples)
    assert samples[-1].torque_applied == pytest.approx(2.0)
    assert samples[-1].position > samples[0].position
    b.rig.stop()
    assert b.drives[0].state is DriveState.SWITCH_ON_DISABLED


def test_fixed_maps_are_selected_and_several_tpdos_make_one_sample(bench: MakeBench, vendor_eds: Path) -> None:
    b = started(bench, [axis(eds=vendor_eds / "kollmorgen_rgm.eds", tpdo_numbers=(3, 5), pdo_cob_ids={0x1804: 0x285})])
    samples = b.run(20, torque=2.0)
    assert samples[-1].torque_applied == pytest.approx(2.0)
    assert len(b.received(0x285)) == len(b.received(0x385)) > 20
    assert not [data for data in b.sent(0x605) if data[1:3] in (b"\x02\x1a", b"\x04\x1a") and data[0] in (0x23, 0x2F)]


def test_rated_torque_and_limit_come_from_the_configuration_where_the_drive_lacks_them(bench: MakeBench, vendor_eds):
    b = started(bench, [axis(eds=vendor_eds / "kollmorgen_rgm.eds", torque_limit=3.0)])
    b.run(5, torque=100.0)
    assert max(b.torques_sent()) == 300  # per mille of the 10 N of the configuration
    assert not [data for data in b.sent(0x605) if data[1:3] == b"\x72\x60"]


def test_a_drive_left_enabled_by_a_dead_master_is_disabled_before_anything_else(bench: MakeBench) -> None:
    b = started(bench)
    b.run(5, torque=1.0)
    begin = len(b.frames)
    b.rig.start()
    sent = [(can_id, data.hex(" ")) for _, can_id, data, is_rx in b.frames[begin:] if not is_rx]
    disabled = sent.index((0x605, "2b 40 60 00 00 00 00 00"))
    assert disabled < sent.index((0x000, "80 05"))  # of a drive with power this would be a fault
    assert b.received(0x085) == []
    assert b.drives[0].state is DriveState.OPERATION_ENABLED
    b.rig.stop()


def test_a_start_after_a_stop_works_as_the_first(bench: MakeBench) -> None:
    b = bench()
    for _ in range(3):
        b.rig.start()
        assert b.run(5, torque=1.0)[0].sync_index == 0
        b.rig.stop()


def test_three_axes_on_one_bus_start_together_and_share_the_sync_index(bench: MakeBench) -> None:
    b = started(bench, [axis(node_id) for node_id in (5, 6, 7)], bus={"rate": 500.0})
    for _ in range(10):
        samples = b.rig.sync()
        assert len({sample.sync_index for sample in samples}) == 1
        b.rig.write_torques([1.0, 2.0, 3.0])
    assert [sample.torque_applied for sample in samples] == pytest.approx([1.0, 2.0, 3.0])
    b.rig.stop()
    assert all(drive.state is DriveState.SWITCH_ON_DISABLED for drive in b.drives)


def test_start_and_stop_take_less_than_a_tenth_of_a_second_each(bench: MakeBench) -> None:
    b = started(bench)
    begun = b.clock.now()
    b.run(3)
    running = b.clock.now()
    b.rig.stop()
    assert begun < 100_000_000
    assert b.clock.now() - running < 100_000_000


def test_the_live_rated_torque_scales_the_commands_when_the_configuration_has_none(bench: MakeBench) -> None:
    b = started(bench, [axis(rated_torque=None)], drive_values={"rated_torque": 20.0})
    b.run(3, torque=1.0)
    assert max(b.torques_sent()) == 50  # 1 N of 20 N


def test_a_small_difference_of_rated_torque_is_taken_as_rounding(bench: MakeBench) -> None:
    b = started(bench, [axis(rated_torque=RATED_TORQUE * 1.0005)])
    assert b.rig.drives[0].scaling.rated_torque == pytest.approx(10.0)


@pytest.mark.parametrize("left", [1, 5000])
def test_a_cycle_period_left_by_another_master_is_replaced_by_ours(bench: MakeBench, left: int) -> None:
    b = bench(objects={0x1006: left})  # [us]; at 1 us the drive would miss its SYNCs and fault
    b.rig.start()
    b.run(50)
    assert b.drives[0].store.read(0x1006, 0) == (1000).to_bytes(4, "little")


@pytest.mark.parametrize("left", [0, 1000])
def test_a_cycle_period_that_is_off_or_right_is_left_as_it_is(bench: MakeBench, left: int) -> None:
    b = started(bench, objects={0x1006: left})
    assert b.drives[0].store.read(0x1006, 0) == left.to_bytes(4, "little")
    assert not [data for data in b.sent(0x605) if data[1:3] == b"\x06\x10" and data[0] != 0x40]


def test_a_cycle_period_that_is_wrong_and_read_only_is_refused_with_both_values(bench: MakeBench, tmp_path) -> None:
    eds = tmp_path / "read_only.eds"
    text = OUR_EDS.read_text(encoding="utf-8")
    head, tail = text.split("[1006]\n")
    eds.write_text(f"{head}[1006]\n{tail.replace('AccessType=rw', 'AccessType=ro', 1)}", encoding="utf-8")
    b = bench([axis(eds=eds)], objects={0x1006: 5000})
    wanted = r"SYNC period: got 0x1006:00 .* = 5000 us, expected 1000 us or 0 \(off\); .*0x1006.*vendor's tool"
    with pytest.raises(StartError, match=wanted):
        b.rig.start()
