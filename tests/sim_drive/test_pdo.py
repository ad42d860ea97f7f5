"""PDO mapping rules, transmission types, and frames as literal bytes."""

import can
import pytest

from tests.sim_drive.drive_on_bus import PERIOD, Rig

MS = 1_000_000
STATUSWORD, POSITION, DEMAND, TARGET = 0x60410010, 0x60640020, 0x60740010, 0x60710010


def disable(rig: Rig) -> None:
    assert rig.write(0x1800, 1, 0x8000_0185, 4) == "ok"
    assert rig.write(0x1A00, 0, 0, 1) == "ok"


def remap(rig: Rig, *entries: int, transmission_type: int = 1) -> None:
    """Gives TPDO1 a map and a transmission type, as CiA 301 prescribes."""
    disable(rig)
    assert rig.write(0x1800, 2, transmission_type, 1) == "ok"
    for i, entry in enumerate(entries, 1):
        assert rig.write(0x1A00, i, entry, 4) == "ok"
    assert rig.write(0x1A00, 0, len(entries), 1) == "ok"
    assert rig.write(0x1800, 1, 0x185, 4) == "ok"


def test_map_of_a_pdo_that_exists_cannot_be_changed(rig: Rig) -> None:
    assert rig.write(0x1A00, 0, 0, 1) == "08000022"
    assert rig.write(0x1A00, 1, POSITION, 4) == "08000022"
    assert rig.write(0x1800, 3, 10, 2) == "08000022"
    assert rig.write(0x1800, 1, 0x186, 4) == "08000022"


def test_entries_cannot_be_written_before_the_count_is_zero(rig: Rig) -> None:
    rig.write(0x1800, 1, 0x8000_0185, 4)
    assert rig.write(0x1A00, 1, POSITION, 4) == "06010000"


@pytest.mark.parametrize(
    ("entry", "abort"),
    [
        (0x20000010, "06020000"),  # does not exist
        (0x60640120, "06020000"),  # subindex does not exist
        (0x60070010, "06040041"),  # not mappable
        (0x60640010, "06040041"),  # 16 bits of a 32 bit object
        (0x10080020, "06040041"),  # a text
    ],
)
def test_objects_that_cannot_be_mapped_are_refused(rig: Rig, entry: int, abort: str) -> None:
    disable(rig)
    assert rig.write(0x1A00, 1, entry, 4) == abort


def test_read_only_object_is_refused_in_an_rpdo(rig: Rig) -> None:
    rig.write(0x1400, 1, 0x8000_0205, 4)
    rig.write(0x1600, 0, 0, 1)
    assert rig.write(0x1600, 1, STATUSWORD, 4) == "06040041"
    assert rig.write(0x1600, 1, TARGET, 4) == "ok"


def test_map_longer_than_a_frame_or_than_its_entries_is_refused(rig: Rig) -> None:
    disable(rig)
    for i, entry in enumerate((POSITION, POSITION, STATUSWORD), 1):
        assert rig.write(0x1A00, i, entry, 4) == "ok"
    assert rig.write(0x1A00, 0, 3, 1) == "06040042"
    assert rig.write(0x1A00, 0, 9, 1) == "06090031"
    assert rig.write(0x1A00, 0, 8, 1) == "06020000"  # entries 4..8 map nothing
    assert rig.write(0x1A00, 0, 2, 1) == "ok"


@pytest.mark.parametrize("cob_id", [0x000, 0x07F, 0x101, 0x180, 0x581, 0x605, 0x6E0, 0x705, 0x2000_0185])
def test_restricted_identifiers_are_refused(rig: Rig, cob_id: int) -> None:
    rig.write(0x1800, 1, 0x8000_0185, 4)
    assert rig.write(0x1800, 1, cob_id, 4) == "06090030"


@pytest.mark.parametrize(
    ("transmission_type", "result"),
    [
        (0, "ok"),
        (1, "ok"),
        (240, "ok"),
        (241, "06090030"),
        (252, "06090030"),
        (253, "06090030"),
        (254, "ok"),
        (255, "ok"),
    ],
)
def test_reserved_transmission_types_are_refused(rig: Rig, transmission_type: int, result: str) -> None:
    assert rig.write(0x1800, 2, transmission_type, 1) == result


def test_new_map_is_read_back_and_sent(rig: Rig) -> None:
    remap(rig, STATUSWORD, POSITION)
    assert rig.read(0x1A00, 2) == "20 00 64 60"
    rig.start()
    rig.motor.position = -2e-6
    assert rig.sync() == [(0x185, "50 02 fe ff ff ff")]


def test_tpdo_moves_to_its_new_identifier(rig: Rig) -> None:
    disable(rig)
    rig.write(0x1A00, 1, STATUSWORD, 4)
    rig.write(0x1A00, 0, 1, 1)
    rig.write(0x1800, 1, 0x1A0, 4)
    rig.start()
    assert rig.sync() == [(0x1A0, "50 02")]


def test_disabled_pdo_is_silent(rig: Rig) -> None:
    rig.write(0x1800, 1, 0x8000_0185, 4)
    rig.start()
    assert rig.sync() == []


def test_transmission_type_counts_syncs(rig: Rig) -> None:
    remap(rig, STATUSWORD, transmission_type=3)
    rig.start()
    assert [len(rig.sync()) for _ in range(7)] == [0, 0, 1, 0, 0, 1, 0]


def test_acyclic_synchronous_tpdo_follows_an_event_at_the_next_sync(rig: Rig) -> None:
    remap(rig, STATUSWORD, transmission_type=0)
    rig.start()
    assert rig.sync() == [(0x185, "50 02")]
    assert rig.sync() == []
    assert rig.send(0x205, "06 00 00 00") == []
    assert rig.sync() == [(0x185, "31 02")]
    assert rig.sync() == []


def test_event_driven_tpdo_is_sent_at_start_and_when_the_statusword_changes(rig: Rig) -> None:
    remap(rig, STATUSWORD, transmission_type=255)
    rig.write(0x6060, 0, 10, 1)
    assert rig.send(0x000, "01 05") == [(0x185, "50 02")]
    assert rig.sync() == []
    assert rig.send(0x205, "06 00 00 00") == [(0x185, "31 02")]
    assert rig.send(0x205, "06 00 01 00") == []


def test_event_timer_repeats_and_inhibit_time_delays(rig: Rig) -> None:
    rig.write(0x1800, 1, 0x8000_0185, 4)
    rig.write(0x1800, 3, 20, 2)  # 2 ms
    rig.write(0x1800, 5, 5, 2)  # 5 ms
    remap(rig, STATUSWORD, transmission_type=254)
    rig.start()
    start = rig.now
    assert rig.send(0x205, "06 00 00 00") == []  # within the inhibit time of the frame sent at start
    assert rig.run(start + 2 * MS - 1) == []
    assert rig.run(start + 2 * MS) == [(0x185, "31 02")]
    assert rig.run(start + 12 * MS) == [(0x185, "31 02")] * 2


def test_synchronous_rpdo_acts_after_the_sample_of_the_next_sync(rig: Rig) -> None:
    rig.write(0x1400, 2, 1, 1)
    rig.start()
    rig.send(0x205, "06 00 00 00")
    assert rig.sync() == [(0x185, "50 02 00 00 00 00 00 00")]
    assert rig.sync() == [(0x185, "31 02 00 00 00 00 00 00")]


def test_of_two_synchronous_rpdos_in_one_period_the_last_counts(rig: Rig) -> None:
    rig.write(0x1400, 2, 1, 1)
    rig.start()
    rig.send(0x205, "06 00 00 00")
    rig.send(0x205, "00 00 00 00")
    rig.sync()
    assert rig.sync()[0][1][:5] == "50 02"


def test_values_out_of_range_in_an_rpdo_are_ignored_one_by_one(rig: Rig) -> None:
    rig.write(0x1401, 1, 0x305, 4)  # RPDO2: controlword, mode
    rig.start()
    rig.send(0x305, "06 00 0b")  # mode 11 is above the limit of 0x6060
    assert rig.read(0x6060)[:2] == "0a"
    assert rig.read(0x6041)[:5] == "31 02"
    rig.send(0x305, "06 00 08")  # within the limits, but not in 0x6502
    assert rig.read(0x6061)[:2] == "0a"


def test_dummy_entries_skip_bytes_of_an_rpdo(rig: Rig) -> None:
    rig.write(0x1400, 1, 0x8000_0205, 4)
    rig.write(0x1600, 0, 0, 1)
    assert rig.write(0x1600, 1, 0x0005_0008, 4) == "ok"  # UNSIGNED8
    assert rig.write(0x1600, 2, 0x6040_0010, 4) == "ok"
    assert rig.write(0x1600, 0, 2, 1) == "ok"
    rig.write(0x1400, 1, 0x205, 4)
    rig.start()
    rig.send(0x205, "ff 06 00")
    assert rig.read(0x6041)[:5] == "31 02"


def test_limit_written_by_rpdo_takes_effect(rig: Rig) -> None:
    rig.write(0x1402, 1, 0x405, 4)  # RPDO3: max torque
    rig.enable()
    rig.send(0x205, "0f 00 64 00")
    rig.send(0x405, "32 00")
    assert rig.drive.torque == 0.05


def test_frames_are_stamped_with_virtual_time(rig: Rig) -> None:
    rig.start()
    rig.now = 123 * PERIOD
    rig.bus.send(can.Message(arbitration_id=0x080, is_extended_id=False))
    rig.group.process(rig.now)
    message = rig.bus.recv(0)
    assert message is not None
    assert message.timestamp == pytest.approx(0.123, abs=1e-12)
