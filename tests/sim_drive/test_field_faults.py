"""EDS files with the faults seen in the field: each a small literal text, read, judged and brought up to an answer."""

from pathlib import Path

import pytest
from canopen.objectdictionary import ODVariable

from canhaptic.canopen.eds import read_dictionary
from canhaptic.drive.can.pdo_map import choose_map, pdo_capabilities
from canhaptic.drive.survey import Suitability, survey, unconfigured_axis
from tests.sim_drive.drive_on_bus import Rig

HEAD = "[FileInfo]\nFileName=x.eds\n"
OBJECTS = [  # index, name, data type, access, default, whether it can be mapped
    ("1000", "Device type", 7, "ro", "0x00020192", 0),
    ("1017", "Producer heartbeat time", 6, "rw", "0", 0),
    ("6007", "Abort connection option code", 3, "rw", "1", 0),
    ("6040", "Controlword", 6, "rww", "", 1),
    ("6041", "Statusword", 6, "ro", "", 1),
    ("6060", "Modes of operation", 2, "rw", "", 0),
    ("6061", "Modes of operation display", 2, "ro", "", 0),
    ("6064", "Position actual value", 4, "ro", "", 1),
    ("6071", "Target torque", 3, "rww", "0", 1),
    ("6072", "Max torque", 6, "rw", "1000", 0),
    ("6074", "Torque demand", 3, "ro", "", 1),
    ("6076", "Motor rated torque", 7, "rw", "1000", 0),
    ("6502", "Supported drive modes", 7, "ro", "0x00000200", 0),
]
HEARTBEAT = "[1016]\nParameterName=Consumer heartbeat time\nObjectType=0x8\nSubNumber=2\n"


def text_of(index: str, name: str, data_type: int, access: str, value: str, mapping: int | str) -> str:
    """Text of one object."""
    return (
        f"[{index}]\nParameterName={name}\nObjectType=0x7\nDataType=0x{data_type:04X}\nAccessType={access}\n"
        f"{f'DefaultValue={value}' if value else ''}\nPDOMapping={mapping}\n"
    )


def sub(index: str, subindex: int, data_type: int, access: str, value: str = "") -> str:
    """Text of one subindex."""
    default = f"DefaultValue={value}\n" if value else ""
    return (
        f"[{index}sub{subindex:X}]\nParameterName=member {subindex}\nObjectType=0x7\nDataType=0x{data_type:04X}\n"
        f"AccessType={access}\n{default}PDOMapping=0\n"
    )


def pdo(kind: str, *, mapping_type: str = "0x9", cob_id: str = "") -> str:
    """Text of RPDO1 or TPDO1 with a writable, empty map of four entries."""
    communication, mapping = ("1400", "1600") if kind == "RPDO" else ("1800", "1A00")
    base = cob_id or ("$NODEID+0x200" if kind == "RPDO" else "$NODEID+0x180")
    return (
        f"[{communication}]\nParameterName=communication\nObjectType=0x9\nSubNumber=3\n"
        + sub(communication, 0, 5, "ro", "2")
        + sub(communication, 1, 7, "rw", base)
        + sub(communication, 2, 5, "rw", "255")
        + f"[{mapping}]\nParameterName=mapping\nObjectType={mapping_type}\nSubNumber=5\n"
        + sub(mapping, 0, 5, "rw", "0")
        + "".join(sub(mapping, n, 7, "rw", "0") for n in range(1, 5))
    )


PLAIN = HEAD + HEARTBEAT + sub("1016", 0, 5, "ro", "1") + sub("1016", 1, 7, "rw", "0")
PLAIN += "".join(text_of(*each) for each in OBJECTS)
SOUND = PLAIN + pdo("RPDO") + pdo("TPDO")


def written(folder: Path, text: str | bytes) -> Path:
    path = folder / "field.eds"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def verdict(path: Path) -> Suitability:
    axis = unconfigured_axis(path)
    return survey(read_dictionary(path, 5), axis).suitability


def comes_up(path: Path) -> None:
    """The simulated drive of this dictionary takes a map and a torque."""
    with Rig(path) as rig:
        rig.write(0x1400, 1, 0x8000_0205, 4)
        assert rig.write(0x1600, 0, 0, 1) == "ok"
        assert rig.write(0x1600, 1, 0x60400010, 4) == "ok"
        assert rig.write(0x1600, 2, 0x60710010, 4) == "ok"
        assert rig.write(0x1600, 0, 2, 1) == "ok"
        assert rig.write(0x1400, 1, 0x205, 4) == "ok"
        rig.enable()
        rig.send(0x205, "0f00" + "6400")
        assert rig.drive.torque == pytest.approx(0.1)


def test_the_sound_dictionary_is_fit(tmp_path: Path) -> None:
    path = written(tmp_path, SOUND)
    assert verdict(path) is Suitability.FIT
    comes_up(path)


def test_empty_device_info_entries_leave_the_drive_fit(tmp_path: Path) -> None:
    info = "[DeviceInfo]\nVendorName=\nVendorNumber=\nProductNumber=\nNrOfRXPDO=\nNrOfTXPDO=\nBaudRate_1000=\n"
    path = written(tmp_path, info + SOUND)
    axis = unconfigured_axis(path)
    found = survey(read_dictionary(path, 5), axis)
    assert (found.vendor, found.vendor_id, found.bitrates, found.bitrate) == ("", None, (), 1_000_000)
    assert found.suitability is Suitability.FIT
    comes_up(path)


def test_an_empty_pdo_mapping_is_not_mappable(tmp_path: Path) -> None:
    text = SOUND.replace(
        text_of("6074", "Torque demand", 3, "ro", "", 1), text_of("6074", "Torque demand", 3, "ro", "", "")
    )
    assert text != SOUND
    path = written(tmp_path, text)
    assert choose_map(read_dictionary(path, 5), unconfigured_axis(path)).read_back == "none"
    assert verdict(path) is Suitability.CONDITIONAL


def test_a_map_declared_array_is_written_entry_by_entry(tmp_path: Path) -> None:
    path = written(tmp_path, PLAIN + pdo("RPDO", mapping_type="0x8") + pdo("TPDO", mapping_type="8"))
    assert verdict(path) is Suitability.FIT
    comes_up(path)


def test_a_missing_subindex_ends_the_room_of_a_map(tmp_path: Path) -> None:
    text = SOUND.replace(sub("1A00", 3, 7, "rw", "0"), "")
    path = written(tmp_path, text)
    dictionary = read_dictionary(path, 5)
    assert [(c.room, c.fixed) for c in pdo_capabilities(dictionary, "TPDO")] == [(2, None)]
    assert verdict(path) is Suitability.UNFIT  # statusword, position and torque need three entries


def test_a_map_without_subindex_zero_is_still_written(tmp_path: Path) -> None:
    text = SOUND.replace(sub("1600", 0, 5, "rw", "0"), "")
    assert text != SOUND
    path = written(tmp_path, text)
    assert read_dictionary(path, 5)[0x1600][0].writable
    assert verdict(path) is Suitability.FIT
    comes_up(path)


def test_compact_subobjects_make_a_whole_map(tmp_path: Path) -> None:
    mapping = "".join(sub("1600", n, 7, "rw", "0") for n in range(1, 5))
    compact = "ObjectType=0x8\nDataType=0x0007\nAccessType=rw\nDefaultValue=0\nCompactSubObj=4\n"
    text = SOUND.replace(mapping, "").replace("ObjectType=0x9\nSubNumber=5\n" + sub("1600", 0, 5, "rw", "0"), compact)
    assert "CompactSubObj" in text
    path = written(tmp_path, text)
    record = read_dictionary(path, 5)[0x1600]
    assert [record[n].writable for n in range(1, 5)] == [True] * 4
    # the count of a compact object is read-only by CiA 306: such a map cannot be emptied, and is not written
    assert verdict(path) is Suitability.UNFIT


@pytest.mark.parametrize(
    ("entries", "limits", "held"),
    [
        ("5000\nLowLimit=0\nHighLimit=1000\n", (0, None), 5000),
        ("5\nLowLimit=10\nHighLimit=1000\n", (None, 1000), 5),
        ("5\nLowLimit=10\nHighLimit=1\n", (None, None), 5),
        ("70000\nHighLimit=1000\n", (None, 1000), None),
    ],
)
def test_a_value_out_of_its_own_range_stands_and_the_limit_falls(
    tmp_path: Path, entries: str, limits: tuple[int | None, int | None], held: int | None
) -> None:
    text = SOUND.replace(
        text_of("6072", "Max torque", 6, "rw", "1000", 0), text_of("6072", "Max torque", 6, "rw", entries, 0)
    )
    path = written(tmp_path, text)
    variable = read_dictionary(path, 5)[0x6072]
    assert isinstance(variable, ODVariable)
    assert ((variable.min, variable.max), variable.default) == (limits, held)
    with Rig(path) as rig:
        answer = rig.read(0x6072)
        assert answer == ("08000024" if held is None else held.to_bytes(4, "little").hex(" "))


def test_a_boolean_in_a_record_is_read_and_written_as_one_byte(tmp_path: Path) -> None:
    record = "[2000]\nParameterName=flags\nObjectType=0x9\nSubNumber=3\n" + sub("2000", 0, 5, "ro", "2")
    record += sub("2000", 1, 1, "rw", "1") + sub("2000", 2, 1, "rw", "7")
    path = written(tmp_path, SOUND + record)
    flags = read_dictionary(path, 5)[0x2000]
    assert (flags[1].default, flags[2].default) == (1, None)
    assert verdict(path) is Suitability.FIT
    with Rig(path) as rig:
        assert rig.read(0x2000, 1) == "01 00 00 00"
        assert rig.write(0x2000, 1, 0, 1) == "ok"
        assert rig.write(0x2000, 1, 2, 1) == "06090031"


def test_a_fixed_map_that_begins_with_a_boolean_is_not_chosen(tmp_path: Path) -> None:
    """One bit in front would shift statusword and position by a bit; the drive has no other TPDO."""
    record = "[2000]\nParameterName=flags\nObjectType=0x9\n" + sub("2000", 0, 5, "ro", "1") + sub("2000", 1, 1, "ro")
    fixed = [(0, 5, "4"), (1, 7, "0x20000101"), (2, 7, "0x60410010"), (3, 7, "0x60640020"), (4, 7, "0x60740010")]
    tpdo = "[1A00]\nParameterName=mapping\nObjectType=0x9\n"
    tpdo += "".join(sub("1A00", n, kind, "ro", value) for n, kind, value in fixed)
    communication = pdo("TPDO").split("[1A00]")[0]
    path = written(tmp_path, PLAIN + pdo("RPDO") + communication + tpdo + record)
    assert list(pdo_capabilities(read_dictionary(path, 5), "TPDO")) == []
    assert verdict(path) is Suitability.UNFIT
