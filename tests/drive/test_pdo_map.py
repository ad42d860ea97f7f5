"""The choice of PDOs from a dictionary and a configuration, and the codec of each."""

import re
from pathlib import Path
from typing import Any

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from canhaptic.drive.axis_parameters import CanBusParameters
from canhaptic.drive.can.link import Link
from canhaptic.drive.can.pdo_map import AxisMap, MappedObject, choose_map, codec, decode_entry
from canhaptic.drive.can.servo_drive import ServoDrive
from canhaptic.drive.clock import VirtualClock
from canhaptic.errors import DictionaryError
from tests.drive.drive_bench import OUR_EDS, axis, dictionary, private_channel


def chosen(path: Path, **values: Any) -> AxisMap:
    parameters = axis(eds=path, **values)
    return choose_map(dictionary(parameters), parameters)


def summary(chosen_map: AxisMap) -> list[tuple[str, int, list[int], bool]]:
    plans = (chosen_map.rpdo, *chosen_map.tpdos)
    return [(plan.name, plan.cob_id, [entry.entry for entry in plan.entries], plan.is_written) for plan in plans]


RPDO1 = ("RPDO1", 0x205, [0x60400010, 0x60710010], True)
STATUS, POSITION, DEMAND, ACTUAL = 0x60410010, 0x60640020, 0x60740010, 0x60770010


def test_our_dictionary_gets_the_preferred_map() -> None:
    assert summary(chosen(OUR_EDS)) == [RPDO1, ("TPDO1", 0x185, [STATUS, POSITION, DEMAND], True)]


@pytest.mark.parametrize(
    ("name", "tpdo"),
    [("elmo_gold.dcf", DEMAND), ("zeroerr_erob.eds", DEMAND), ("maxon_epos4.dcf", ACTUAL)],
)
def test_vendor_drives_read_back_what_they_can(vendor_eds: Path, name: str, tpdo: int) -> None:
    assert summary(chosen(vendor_eds / name)) == [RPDO1, ("TPDO1", 0x185, [STATUS, POSITION, tpdo], True)]


def test_kollmorgen_gets_its_fixed_rpdo_and_its_one_writable_tpdo(vendor_eds: Path) -> None:
    assert summary(chosen(vendor_eds / "kollmorgen_rgm.eds")) == [
        ("RPDO5", 0x205, [0x60400010, 0x60710010], False),
        ("TPDO26", 0x185, [STATUS, POSITION, ACTUAL], True),
    ]


@pytest.mark.parametrize(
    ("numbers", "entries"),
    [((3, 5), [[STATUS, POSITION], [STATUS, ACTUAL]]), ((3, 23), [[STATUS, POSITION], [ACTUAL]])],
)
def test_fixed_tpdos_are_combined(vendor_eds: Path, numbers: tuple[int, ...], entries: list[list[int]]) -> None:
    chosen_map = chosen(vendor_eds / "kollmorgen_rgm.eds", tpdo_numbers=numbers, pdo_cob_ids={0x1404: 0x305})
    assert [[e.entry for e in tpdo.entries] for tpdo in chosen_map.tpdos] == entries
    assert chosen_map.rpdo.cob_id == 0x305
    assert len({plan.cob_id for plan in (chosen_map.rpdo, *chosen_map.tpdos)}) == 3


def test_two_pdos_on_one_cob_id_are_refused(vendor_eds: Path) -> None:
    with pytest.raises(DictionaryError, match=r"share COB-ID 0x385; set pdo_cob_ids: {0x1804"):
        chosen(vendor_eds / "kollmorgen_rgm.eds", tpdo_numbers=(3, 5), pdo_cob_ids={0x1804: 0x385})


def test_a_read_back_that_the_drive_lacks_is_refused(vendor_eds: Path) -> None:
    with pytest.raises(DictionaryError, match="use read_back: auto"):
        chosen(vendor_eds / "maxon_epos4.dcf", read_back="demand")


def test_without_read_back_the_tpdo_has_six_bytes_and_the_map_says_so() -> None:
    chosen_map = chosen(OUR_EDS, read_back="none")
    assert (chosen_map.tpdos[0].length, chosen_map.read_back) == (6, "none")


def test_a_pdo_number_that_the_drive_lacks_is_refused() -> None:
    with pytest.raises(DictionaryError, match="no RPDO400"):
        chosen(OUR_EDS, rpdo_number=400)


@given(st.integers(0, 0xFFFFFFFF))
def test_every_mapping_entry_survives_decoding(entry: int) -> None:
    assert decode_entry(entry).entry == entry


def test_a_tpdo_is_decoded_as_one_image() -> None:
    entries = [MappedObject(0x6041, 0, 16), MappedObject(0x6064, 0, 32, signed=True), MappedObject(0x6074, 0, 16, True)]
    image = codec(entries, [0x6041, 0x6064, 0x6074])
    assert image.unpack(bytes.fromhex("37 12 e8 03 00 00 9c ff")) == (0x1237, 1000, -100)


def test_objects_that_nobody_wants_are_skipped_and_shift_nothing() -> None:
    """An object that the EDS lacks shifts every later offset in canopen: 1000 is read as 65 584 879 there."""
    entries = [
        MappedObject(0x6041, 0, 16),
        MappedObject(0x2000, 1, 8),
        MappedObject(0x2000, 2, 8),
        MappedObject(0x6064, 0, 32, signed=True),
    ]
    assert codec(entries, [0x6041, 0x6064]).unpack(bytes.fromhex("37 12 aa bb 18 fc ff ff")) == (0x1237, -1000)


@pytest.mark.parametrize(
    "entries",
    [
        [MappedObject(0x2000, 1, 4), MappedObject(0x6064, 0, 32)],
        [MappedObject(0x6064, 0, 24)],
        [MappedObject(0x6064, 0, 32), MappedObject(0x2000, 1, 64)],
        [MappedObject(0x6064, 0, 32), MappedObject(0x2000, 1, 4)],
    ],
)
def test_a_pdo_that_cannot_be_decoded_right_is_refused(entries: list[MappedObject]) -> None:
    with pytest.raises(DictionaryError):
        codec(entries, [0x6064])


@pytest.mark.parametrize(("bits", "data", "value"), [(8, "f0", -16), (16, "f0 ff", -16), (64, "f0" + 7 * "ff", -16)])
def test_every_length_of_an_integer_is_decoded(bits: int, data: str, value: int) -> None:
    signed, unsigned = (MappedObject(0x2100, 0, bits, sign) for sign in (True, False))
    assert codec([signed], [0x2100]).unpack(bytes.fromhex(data)) == (value,)
    assert codec([unsigned], [0x2100]).unpack(bytes.fromhex(data)) == (value + (1 << bits),)


def edited(folder: Path, changes: dict[str, dict[str, str]], without: tuple[str, ...] = ()) -> Path:
    """Our dictionary with other values of some keys, and without some sections."""
    sections = OUR_EDS.read_text(encoding="utf-8").split("\n[")
    made = []
    for section in sections:
        name, _, body = section.partition("]")
        for key, value in changes.get(name, {}).items():
            body = re.sub(f"\n{key}=[^\n]*", f"\n{key}={value}", body)
        if name not in without:
            made.append(f"{name}]{body}")
    path = folder / "edited.eds"
    path.write_text("\n[".join(made), encoding="utf-8")
    return path


FIXED = {"AccessType": "const"}
SPLIT = {  # TPDO 1 has the statusword and the position, TPDO 2 the torque, and neither can be changed
    **{f"1A0{n}sub{sub}": FIXED for n in range(4) for sub in range(9)},
    "1A00sub0": {**FIXED, "DefaultValue": "2"},
    "1A01sub0": {**FIXED, "DefaultValue": "1"},
    "1A01sub1": {**FIXED, "DefaultValue": "0x60740010"},
}


def test_the_tpdos_of_a_sample_are_named_by_the_bits_of_those_that_are_missing(tmp_path: Path) -> None:
    of = axis(eds=edited(tmp_path, SPLIT))
    with can.Bus(interface="virtual", channel=private_channel()) as bus:
        drive = ServoDrive(Link(bus, VirtualClock()), of, dictionary(of), CanBusParameters(rate=1000.0))
        names = [drive.part(bits) for bits in range(4)]
    assert names == ["", "TPDO 0x185", "TPDO 0x285", "TPDO 0x185, TPDO 0x285"]


def test_an_rpdo_with_room_for_two_objects_alone_is_written(tmp_path: Path) -> None:
    small = edited(tmp_path, {"1600sub0": {"HighLimit": "2"}}, tuple(f"1600sub{sub}" for sub in range(3, 9)))
    assert summary(chosen(small))[0] == RPDO1


def test_a_cob_id_that_cannot_be_written_is_the_one_that_the_dictionary_states(tmp_path: Path) -> None:
    stated = {"AccessType": "ro", "DefaultValue": "0x40000311"}
    assert summary(chosen(edited(tmp_path, {"1400sub1": stated})))[0][1] == 0x311
