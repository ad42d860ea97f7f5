"""Cyclic torque: scaling, limits, what is reported for which hold, and when the motor moves."""

import math
from typing import Any

import pytest

from canhaptic.errors import ParameterError
from canhaptic.sim.drive import SimulatedDriveParameters, parse_place
from canhaptic.sim.drive.profile.state_machine import DriveState
from tests.sim_drive.drive_on_bus import PERIOD, Mass, Rig


def torque(per_mille: int) -> str:
    return (per_mille & 0xFFFF).to_bytes(2, "little").hex()


def test_target_is_per_mille_of_rated_torque() -> None:
    with Rig(rated_torque=2.5) as rig:
        rig.enable()
        assert rig.read(0x6076) == "c4 09 00 00"
        rig.send(0x205, "0f00" + torque(-400))
        assert rig.drive.torque == pytest.approx(-1.0, rel=1e-15)


def test_resolution_of_rated_torque_may_be_micro() -> None:
    with Rig(rated_torque=0.5, rated_torque_resolution=1e-6) as rig:
        assert rig.read(0x6076) == "20 a1 07 00"
        assert rig.drive.servo._stage.quantum == pytest.approx(0.5e-3, rel=1e-15)


def test_no_torque_before_operation_is_enabled_or_in_another_mode(rig: Rig) -> None:
    rig.start()
    for controlword in ("0600", "0700"):
        rig.send(0x205, controlword + torque(100))
        assert rig.drive.torque == 0.0
    rig.send(0x205, "0f00" + torque(100))
    assert rig.drive.torque == 0.1
    assert rig.write(0x6060, 0, 0, 1) == "ok"
    assert rig.drive.torque == 0.0


def test_torque_beyond_the_limit_is_cut_and_shown_in_bit_11(rig: Rig) -> None:
    rig.enable()
    rig.write(0x6072, 0, 300, 2)
    for target, demand, word in [(301, 300, "371a"), (300, 300, "3712"), (-301, -300, "371a"), (-32768, -300, "371a")]:
        rig.send(0x205, "0f00" + torque(target))
        frame = rig.sync()[-1][1].replace(" ", "")
        assert (frame[:4], frame[12:]) == (word, torque(demand))


def test_limit_of_the_parameters_acts_besides_the_object() -> None:
    with Rig(torque_limit=0.2) as rig:
        rig.enable()
        rig.send(0x205, "0f00" + torque(900))
        assert rig.drive.torque == 0.2


def test_of_two_limits_the_lower_acts() -> None:
    with Rig(torque_limit=0.7) as rig:
        rig.enable()
        rig.write(0x6072, 0, 500, 2)
        rig.send(0x205, "0f00" + torque(900))
        assert rig.drive.torque == 0.5


def test_torque_and_current_are_sampled_at_the_sync_when_mapped(rig: Rig) -> None:
    rig.write(0x1802, 1, 0x385, 4)  # TPDO3: torque actual, current actual
    rig.enable()
    rig.send(0x205, "0f00" + torque(100))
    assert (0x385, "64 00 64 00") in rig.sync()


def test_demand_and_actual_report_the_hold_that_just_ended(rig: Rig) -> None:
    rig.enable()
    rig.send(0x205, "0f00" + torque(100))
    assert rig.sync()[-1][1][-5:] == "64 00"
    rig.send(0x205, "0f00" + torque(200))
    assert rig.sync()[-1][1][-5:] == "c8 00"


def test_synchronous_torque_is_reported_one_sync_later_than_it_acts(rig: Rig) -> None:
    rig.write(0x1400, 2, 1, 1)
    rig.enable()
    rig.sync()
    rig.send(0x205, "0f00" + torque(100))
    assert rig.sync()[-1][1][-5:] == "00 00"  # sampled, sent, and only then in force
    assert rig.drive.torque == 0.1
    assert rig.sync()[-1][1][-5:] == "64 00"


def test_drive_that_reports_after_its_update_shows_the_next_torque() -> None:
    with Rig(torque_read_back="after_update") as rig:
        rig.write(0x1400, 2, 1, 1)
        rig.enable()
        rig.sync()
        rig.send(0x205, "0f00" + torque(100))
        assert rig.sync()[-1][1][-5:] == "64 00"


@pytest.mark.parametrize(
    ("values", "acts"),
    [({}, [0, 1, 1, 1]), ({"acts_at_once": True}, [1, 1, 1, 1]), ({"syncs_late": 1}, [0, 0, 1, 1]),
     ({"syncs_late": 2}, [0, 0, 0, 1])],
)  # fmt: skip
@pytest.mark.parametrize("read_back", ["before_update", "after_update"])
def test_a_synchronous_torque_acts_in_the_hold_that_the_drive_chooses(
    values: dict[str, Any], acts: list[int], read_back: str
) -> None:
    """Before the first SYNC after its RPDO, after that one, after the next, and after the one after it."""
    with Rig(torque_read_back=read_back, **values) as rig:
        rig.enable()
        rig.write(0x1400, 2, 1, 1)
        for _ in range(4):
            rig.send(0x205, "0f00" + torque(0))
            rig.sync()
        rig.send(0x205, "0f00" + torque(100))
        seen = [rig.drive.torque]
        for _ in range(3):
            rig.sync()
            seen.append(rig.drive.torque)
    assert seen == pytest.approx([0.1 * act for act in acts])


def test_motor_stands_still_until_the_first_sync_with_operation_enabled(rig: Rig) -> None:
    rig.start()
    for controlword in ("0600", "0700"):
        rig.send(0x205, controlword + torque(500))
        rig.sync()
    rig.send(0x205, "0f00" + torque(500))
    assert rig.motor.epoch is None
    rig.sync()
    assert rig.motor.epoch == rig.now
    assert rig.motor.position == 0.0
    rig.sync()
    assert rig.motor.position == pytest.approx(0.5 * 0.5 * 1e-6, rel=1e-12)


def test_motor_runs_on_without_torque_when_disabled(rig: Rig) -> None:
    rig.enable()
    rig.send(0x205, "0f00" + torque(1000))
    rig.sync()
    rig.send(0x205, "0000" + torque(1000))
    assert rig.drive.torque == 0.0
    before = rig.motor.position
    rig.sync()
    assert rig.motor.position - before == pytest.approx(1e-3 * 1e-3, rel=1e-12)


def test_event_driven_torque_inside_a_hold_splits_it_exactly(rig: Rig) -> None:
    rig.enable()
    rig.send(0x205, "0f00" + torque(1000))
    rig.run(rig.now + PERIOD // 4)
    rig.send(0x205, "0f00" + torque(0))
    rig.run(rig.now + 3 * PERIOD // 4)
    rig.send(0x080)
    velocity = 0.25e-3
    assert rig.motor.position == pytest.approx(0.5 * 0.25e-3**2 + velocity * 0.75e-3, rel=1e-12)


@pytest.mark.parametrize(
    ("encoder", "position", "counts"),
    [
        ("round", 1.6e-6, 2),
        ("round", -1.4e-6, -1),
        ("floor", 1.6e-6, 1),
        ("floor", -1.4e-6, -2),
        ("round", 2147.483648, -(2**31)),
        ("round", 2147.483647, 2**31 - 1),
        ("round", -2147.483648, -(2**31)),
        ("round", -2147.483649, 2**31 - 1),
        ("round", 4294.967297, 1),
    ],
)
def test_position_is_counted_and_wraps_at_32_bits(encoder: str, position: float, counts: int) -> None:
    with Rig(encoder=encoder) as rig:
        rig.start()
        rig.motor.position = position
        frame = bytes.fromhex(rig.sync()[-1][1])
        assert int.from_bytes(frame[2:6], "little", signed=True) == counts
        assert math.isfinite(rig.drive.truth().position)


def test_position_and_velocity_can_be_read_by_sdo_before_nmt_start(rig: Rig) -> None:
    rig.motor.position, rig.motor.velocity = 12e-6, -3e-6
    assert rig.read(0x6064) == "0c 00 00 00"
    assert rig.read(0x606C) == "fd ff ff ff"
    rig.motor.velocity = math.nan
    assert rig.read(0x606C) == "fd ff ff ff"  # a fault, and no other number in its place


def test_velocity_is_sampled_when_a_tpdo_maps_it(rig: Rig) -> None:
    rig.write(0x1801, 1, 0x285, 4)  # TPDO2: position, velocity
    rig.enable()
    rig.send(0x205, "0f00" + torque(1000))
    assert (0x285, "00 00 00 00 e8 03 00 00") in rig.sync()  # 0.5 counts, and 1 mm/s


def test_new_rated_torque_by_sdo_rescales_the_torque_in_force(rig: Rig) -> None:
    rig.enable()
    rig.send(0x205, "0f00" + torque(100))
    assert rig.write(0x6076, 0, 3000, 4) == "ok"
    assert rig.drive.torque == pytest.approx(0.3, rel=1e-15)


def test_true_energy_of_the_motor_is_work_done_on_it(rig: Rig) -> None:
    rig.enable()
    rig.send(0x205, "0f00" + torque(1000))
    for _ in range(10):
        rig.sync()
    position, energy = rig.drive.truth()
    assert energy.motor == pytest.approx(1.0 * position, rel=1e-12)


def test_rated_torque_that_nobody_states_is_refused() -> None:
    with pytest.raises(ParameterError, match="rated_torque"):
        Rig(rated_torque=None)


def test_rated_torque_that_the_object_cannot_show_is_refused() -> None:
    with pytest.raises(ParameterError, match=r"whole number of 0\.001"):
        Rig(rated_torque=0.12345)


def test_objects_that_the_dictionary_lacks_or_of_a_wrong_type_are_refused() -> None:
    with pytest.raises(ParameterError, match="no such object"):
        Rig(objects={0x2000: 1})
    with pytest.raises(ParameterError, match="expected a value of type"):
        Rig(objects={0x1000: "servo"})
    with pytest.raises(ParameterError, match="expected a value of type"):
        Rig(objects={0x1017: 70000})


@pytest.mark.parametrize(
    ("key", "place"),
    [
        (0x6502, (0x6502, 0)),
        ("0x6502", (0x6502, 0)),
        ("60fe", (0x60FE, 0)),
        ("0x1018.1", (0x1018, 1)),
        ("1018sub1", (0x1018, 1)),
        ("1A00SUBa", (0x1A00, 10)),
    ],
)
def test_places_of_objects_are_read_in_every_spelling(key: str | int, place: tuple[int, int]) -> None:
    assert parse_place(key) == place


def test_a_text_that_may_be_hexadecimal_or_decimal_is_refused() -> None:
    with pytest.raises(ValueError, match="'6502' may be hexadecimal or decimal; write 0x6502 or 0x1966"):
        parse_place("6502")


def test_keys_that_name_no_object_are_refused() -> None:
    for key in ("torque", 0, 0x10000):
        with pytest.raises(ParameterError):
            SimulatedDriveParameters(counts_per_unit=1.0, objects={key: 1})


def test_mode_zero_is_no_mode_and_nothing_but_listed_modes_is_taken(rig: Rig) -> None:
    for mode in range(1, 10):
        assert rig.write(0x6060, 0, mode, 1) == "06090030"
    assert rig.write(0x6060, 0, 10, 1) == "ok"
    assert rig.read(0x6061)[:2] == "0a"
    rig.enable()
    assert rig.drive.state is DriveState.OPERATION_ENABLED


def test_motor_with_an_encoder_of_its_own_is_read_there() -> None:
    class WithEncoder(Mass):
        @property
        def encoder_position(self) -> float:
            return self.position + 7e-6

    with Rig(motor=WithEncoder()) as rig:
        rig.start()
        assert rig.sync() == [(0x185, "50 02 07 00 00 00 00 00")]
