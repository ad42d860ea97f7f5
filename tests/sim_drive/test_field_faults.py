"""EDS files with the faults seen in the field: each a small literal text, read, judged and brought up to an answer."""

from pathlib import Path

import pytest
from canopen.objectdictionary import ODVariable

from canhaptic.canopen.eds import read_dictionary
from canhaptic.drive.can.pdo_map import choose_map, pdo_capabilities
from canhaptic.drive.survey import Suitability, survey, unconfigured_axis
from tests.sim_drive.drive_on_bus import Rig

HEAD = "[FileInfo]\nFileName=x.eds\n"
OBJECTS = """\
[1000]
ParameterName=Device type
ObjectType=0x7
DataType=0x0007
AccessType=ro
DefaultValue=0x00020192
PDOMapping=0
[1016]
ParameterName=Consumer heartbeat time
ObjectType=0x8
SubNumber=2
[1016sub0]
ParameterName=Number
ObjectType=0x7
DataType=0x0005
AccessType=ro
DefaultValue=1
[1016sub1]
ParameterName=Consumer 1
ObjectType=0x7
DataType=0x0007
AccessType=rw
DefaultValue=0
[1017]
ParameterName=Producer heartbeat time
ObjectType=0x7
DataType=0x0006
AccessType=rw
DefaultValue=0
[6007]
ParameterName=Abort connection option code
ObjectType=0x7
DataType=0x0003
AccessType=rw
DefaultValue=1
[6040]
ParameterName=Controlword
ObjectType=0x7
DataType=0x0006
AccessType=rww
PDOMapping=1
[6041]
ParameterName=Statusword
ObjectType=0x7
DataType=0x0006
AccessType=ro
PDOMapping=1
[6060]
ParameterName=Modes of operation
ObjectType=0x7
DataType=0x0002
AccessType=rw
[6061]
ParameterName=Modes of operation display
ObjectType=0x7
DataType=0x0002
AccessType=ro
[6064]
ParameterName=Position actual value
ObjectType=0x7
DataType=0x0004
AccessType=ro
PDOMapping=1
[6071]
ParameterName=Target torque
ObjectType=0x7
DataType=0x0003
AccessType=rww
DefaultValue=0
PDOMapping=1
[6072]
ParameterName=Max torque
ObjectType=0x7
DataType=0x0006
AccessType=rw
DefaultValue=1000
[6074]
ParameterName=Torque demand
ObjectType=0x7
DataType=0x0003
AccessType=ro
PDOMapping=1
[6076]
ParameterName=Motor rated torque
ObjectType=0x7
DataType=0x0007
AccessType=rw
DefaultValue=1000
[6502]
ParameterName=Supported drive modes
ObjectType=0x7
DataType=0x0007
AccessType=ro
DefaultValue=0x00000200
"""


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


SOUND = HEAD + OBJECTS + pdo("RPDO") + pdo("TPDO")


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
        "ParameterName=Torque demand\nObjectType=0x7\nDataType=0x0003\nAccessType=ro\nPDOMapping=1",
        "ParameterName=Torque demand\nObjectType=0x7\nDataType=0x0003\nAccessType=ro\nPDOMapping=",
    )
    assert text != SOUND
    path = written(tmp_path, text)
    assert choose_map(read_dictionary(path, 5), unconfigured_axis(path)).read_back == "none"
    assert verdict(path) is Suitability.CONDITIONAL


def test_a_map_declared_array_is_written_entry_by_entry(tmp_path: Path) -> None:
    path = written(tmp_path, HEAD + OBJECTS + pdo("RPDO", mapping_type="0x8") + pdo("TPDO", mapping_type="8"))
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


@pytest.mark.parametrize("encoding", ["latin-1", "cp1252"])
def test_text_in_another_encoding_is_no_obstacle(tmp_path: Path, encoding: str) -> None:
    text = SOUND.replace("ParameterName=Target torque", "ParameterName=Solldrehmoment ±½µ §")
    path = written(tmp_path, text.encode(encoding))
    assert read_dictionary(path, 5)[0x6071].name == "Solldrehmoment ±½µ §"
    assert verdict(path) is Suitability.FIT


def test_the_signs_of_windows_1252_that_latin_1_lacks_are_read(tmp_path: Path) -> None:
    text = SOUND.replace("ParameterName=Statusword", "ParameterName=„Status“ €")
    path = written(tmp_path, text.encode("cp1252"))
    assert read_dictionary(path, 5)[0x6041].name == "„Status“ €"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("0x000003E8", 1000),
        ("1000", 1000),
        ("3E8", 1000),
        ("03e8", 1000),
        ("3E8h", 1000),
        ("ff", 255),
        ("10h", 16),
        ("10", 10),
        ("FFFFFFFF", 0xFFFFFFFF),
        ("-1", 0xFFFFFFFF),
        ("0xFFFFFFFFF", None),
        ("bad", None),
        ("0b11", 0x0B11),
        ("none", None),
    ],
)
def test_hexadecimal_is_read_with_and_without_prefix(tmp_path: Path, text: str, expected: int | None) -> None:
    path = written(tmp_path, SOUND.replace("AccessType=rw\nDefaultValue=1000\n[6502]", f"DefaultValue={text}\n[6502]"))
    assert read_dictionary(path, 5)[0x6076].default == expected


@pytest.mark.parametrize("cob_id", ["$NODEID+0x200", "0x200+$NODEID", "$nodeid + 0x200", "512+$NODEID"])
def test_identifiers_relative_to_the_node_are_read_in_either_order(tmp_path: Path, cob_id: str) -> None:
    path = written(tmp_path, HEAD + OBJECTS + pdo("RPDO", cob_id=cob_id) + pdo("TPDO"))
    assert read_dictionary(path, 5)[0x1400][1].default == 0x205
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
        ("DefaultValue=5000\nLowLimit=0\nHighLimit=1000\n", (0, None), 5000),
        ("DefaultValue=5\nLowLimit=10\nHighLimit=1000\n", (None, 1000), 5),
        ("DefaultValue=5\nLowLimit=10\nHighLimit=1\n", (None, None), 5),
        ("DefaultValue=70000\nHighLimit=1000\n", (None, 1000), None),
    ],
)
def test_a_value_out_of_its_own_range_stands_and_the_limit_falls(
    tmp_path: Path, entries: str, limits: tuple[int | None, int | None], held: int | None
) -> None:
    text = SOUND.replace("DefaultValue=1000\n[6074]", f"{entries}[6074]")
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
    path = written(tmp_path, HEAD + OBJECTS + pdo("RPDO") + communication + tpdo + record)
    assert list(pdo_capabilities(read_dictionary(path, 5), "TPDO")) == []
    assert verdict(path) is Suitability.UNFIT
