"""The tolerant EDS reader, against literal files and against `canopen.import_od` where that can read the file."""

import contextlib
import gzip
import re
from pathlib import Path

import canopen
import pytest
from canopen.objectdictionary import ODRecord, ODVariable, datatypes
from hypothesis import given, settings
from hypothesis import strategies as st

from canhaptic.canopen.eds import DriveDictionary, read_dictionary
from canhaptic.canopen.objects import without_flags
from canhaptic.drive.profile.fitness import ObjectUse, objection
from canhaptic.drive.survey import Suitability, survey, unconfigured_axis
from canhaptic.errors import DictionaryError
from tests.drawn import examples


def read(tmp_path: Path, text: str | bytes, node_id: int = 5, name: str = "drive.eds") -> DriveDictionary:
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_dictionary(path, node_id)


def variable(
    tmp_path: Path, entries: str, data_type: int = datatypes.UNSIGNED16, index: str = "2000", **options: int
) -> ODVariable:
    text = f"[{index}]\nParameterName=thing\nObjectType=7\nDataType={data_type}\nAccessType=rw\n{entries}\n"
    return read(tmp_path, text, **options)[int(index, 16)]  # type: ignore[arg-type, return-value]


def test_empty_pdo_mapping_means_not_mappable(tmp_path: Path) -> None:
    assert variable(tmp_path, "PDOMapping=").pdo_mappable is False


def test_empty_device_info_entries_count_as_not_given(tmp_path: Path) -> None:
    dictionary = read(
        tmp_path, "[DeviceInfo]\nNrOfRXPDO=\nBaudRate_500=\nBaudRate_1000=1\n[1000]\nDataType=7\nDefaultValue=0x192\n"
    )
    assert dictionary.device_information.nr_of_RXPDO is None
    assert dictionary.device_information.allowed_baudrates == {1_000_000}
    assert dictionary[0x1000].default == 0x192


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "cp1252", "utf-16"])
def test_names_survive_every_encoding(tmp_path: Path, encoding: str) -> None:
    text = "[1000]\r\nParameterName=Gerätetyp µ „€“\r\nObjectType=0x7\r\nDataType=0x0007\r\nAccessType=ro\r\n"
    assert read(tmp_path, text.encode(encoding))[0x1000].name == "Gerätetyp µ „€“"


def test_undefined_windows_bytes_do_not_stop_the_reader(tmp_path: Path) -> None:
    assert read(tmp_path, b"[1000]\nParameterName=\x81\xe4\nDataType=7\n")[0x1000].data_type == 7


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("0x10", 16),
        ("16", 16),
        ("020", 16),
        ("0", 0),
        ("00", 0),
        ("-1", 0xFFFF),
        ("0XfF", 255),
        ("3E8h", 1000),
        ("03e8", 1000),
        ("0b11", 0x0B11),
        ("0xFFFFFFFFF", None),
        ("", None),
        ("bad", None),
    ],
)
def test_numbers_are_read_as_cia_306_writes_them(tmp_path: Path, text: str, expected: int | None) -> None:
    assert variable(tmp_path, f"DefaultValue={text}").default == expected


@pytest.mark.parametrize("text", ["$NODEID+0x180", "0x180+$NODEID", "$NodeID + 0x180", "$nodeid+384", "384+$NODEID"])
def test_node_id_is_added_to_relative_values(tmp_path: Path, text: str) -> None:
    read_variable = variable(tmp_path, f"DefaultValue={text}", datatypes.UNSIGNED32, node_id=7)
    assert (read_variable.default, read_variable.relative) == (0x187, True)


@pytest.mark.parametrize(
    ("data_type", "text", "expected"),
    [
        (2, "0xFF", -1),
        (3, "0x8000", -32768),
        (3, "-5", -5),
        (3, "0x7FFF", 32767),
        (4, "0xFFFFFFFE", -2),
        (0x10, "0xFFFFFF", -1),
    ],
)
def test_hexadecimal_values_of_signed_objects_are_negative(
    tmp_path: Path, data_type: int, text: str, expected: int
) -> None:
    assert variable(tmp_path, f"DefaultValue={text}\nLowLimit={text}", data_type).default == expected
    assert variable(tmp_path, f"LowLimit={text}", data_type).min == expected


def test_limit_of_the_consumer_heartbeat_that_allows_no_node_is_dropped(tmp_path: Path) -> None:
    limits = "ObjectType=8\n[1016sub1]\nDataType=7\nLowLimit=0\nHighLimit=65535\n[1016sub2]\nDataType=7\n"
    array = read(tmp_path, f"[1016]\n{limits}HighLimit=0x7FFFFF\n")[0x1016]
    assert (array[1].min, array[1].max, array[2].max) == (0, None, 0x7FFFFF)


def test_keywords_and_sections_are_read_in_any_case_and_order(tmp_path: Path) -> None:
    text = "[1018SUB1]\nPARAMETERNAME=vendor\ndatatype=7\n[1018Sub0]\nDataType=5\n[1018]\nObjectType=9\n"
    record = read(tmp_path, text)[0x1018]
    assert sorted(record.subindices) == [0, 1]
    assert record[1].name == "vendor"


def test_comments_behind_a_value_are_not_part_of_it(tmp_path: Path) -> None:
    assert variable(tmp_path, "; DefaultValue=3\nDefaultValue=4 ; four\nstray line").default == 4


def test_arrays_have_the_entries_that_they_list_and_each_keeps_its_access(tmp_path: Path) -> None:
    text = (
        "[1600]\nObjectType=8\nSubNumber=2\n[1600sub0]\nDataType=5\nAccessType=ro\nDefaultValue=1\n"
        "[1600sub1]\nDataType=7\nAccessType=ro\nDefaultValue=0x60400010\n[1016]\nObjectType=8\n[1016sub1]\nDataType=7\n"
    )
    dictionary = read(tmp_path, text)
    assert isinstance(dictionary[0x1600], ODRecord)
    assert dictionary.get_variable(0x1016, 1) is not None
    assert dictionary.get_variable(0x1016, 2) is None  # canopen makes one up for an ODArray
    assert dictionary[0x1600][1].default == 0x60400010
    assert not dictionary[0x1600][1].writable


def test_compact_subobjects_are_expanded_with_their_names_and_values(tmp_path: Path) -> None:
    text = (
        "[1003]\nParameterName=errors\nObjectType=8\nDataType=7\nAccessType=ro\nCompactSubObj=3\nDefaultValue=9\n"
        "[1003Name]\nNrOfEntries=1\n2=second\n[1003Value]\nNrOfEntries=1\n3=7\n"
    )
    array = read(tmp_path, text)[0x1003]
    assert [array.subindices[i].default for i in range(4)] == [3, 9, 9, 7]
    assert array.subindices[2].name == "second"


def test_members_that_share_a_name_stay_separate(tmp_path: Path) -> None:
    text = "[1003]\nObjectType=9\n" + "".join(f"[1003sub{i}]\nParameterName=x\nDataType=7\n" for i in (1, 2))
    record = read(tmp_path, text)[0x1003]
    assert record["x"].subindex == 1
    assert record[2].name == "x (2)"


def test_values_of_a_configuration_saved_for_another_node_give_way_to_the_defaults(tmp_path: Path) -> None:
    text = (
        "[DeviceComissioning]\nNodeID=1\n[1014]\nDataType=7\nDefaultValue=$NODEID+0x80\nParameterValue=0x81\n"
        "[1017]\nDataType=6\nDefaultValue=0\nParameterValue=100\n"
    )
    saved_for_node = read(tmp_path, text, node_id=1)
    other = read(tmp_path, text, node_id=5)
    assert saved_for_node[0x1014].value == 0x81
    assert (other[0x1014].value, other[0x1014].default) == (None, 0x85)
    assert other[0x1017].value == 100


def test_types_that_the_file_defines_itself_are_followed(tmp_path: Path) -> None:
    text = "[A0]\nObjectType=5\n[A0sub1]\nDataType=7\nDefaultValue=0x6\n[2000]\nDataType=0xA0\n[2001]\nDataType=0xA1\n"
    dictionary = read(tmp_path, text)
    assert dictionary[0x2000].data_type == datatypes.UNSIGNED16
    assert dictionary[0x2001].data_type == datatypes.DOMAIN


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("", "lists no object"),
        ("hello\nworld", "lists no object"),
        ("<?xml version='1.0'?>", "is XML"),
        ("<?xml version='1.0'?><!-- made\nby hand --><EtherCATInfo Version='1.6'>", "EtherCAT drive, which a scene"),
        ("<x:ISO15745ProfileContainer xmlns:x='http://www.canopen.org/xml/1.0'/>", "is an XDD or XDC"),
        ("<EDS><Parameters><Group SymbolName='a'>", "is an EPF"),
        ("\n<!DOCTYPE html>\n<html>", "is a web page"),
        ('{"objects": {}}', "is JSON"),
        ('VERSION ""\nBO_ 385 X: 8 Y\n', "is a DBC"),
        ("version https://git-lfs.github.com/spec/v1\n", "Git LFS"),
        (b"PK\x03\x04rest", "is a ZIP archive; unpack it"),
        (b"\x1f\x8b\x08rest", "is compressed (gzip) and damaged"),
        (gzip.compress(b"<EtherCATInfo>", mtime=0), "is an ESI"),
    ],
)
def test_unreadable_files_are_refused_with_what_they_are(tmp_path: Path, text: str | bytes, part: str) -> None:
    with pytest.raises(DictionaryError) as raised:
        read(tmp_path, text)
    assert str(tmp_path / "drive.eds") in str(raised.value)
    assert part in str(raised.value)


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("[1018sub1]\nDataType=7\n", "[1018sub1]: belongs to no object"),
        ("[1018]\nObjectType=9\n[1018sub0]\nDataType=5\n[1018sub1]\n", "[1018sub1]: DataType: got no entry"),
        ("[1018]\nObjectType=7\nDataType=u32\n[1018sub1]\nDataType=7\n", "[1018]: DataType: got 'u32'"),
    ],
)
def test_an_unreadable_section_is_left_out_and_its_object_refused(tmp_path: Path, text: str, part: str) -> None:
    dictionary = read(tmp_path, f"{text}[1000]\nDataType=Unsigned32 // as 0x0007\nDefaultValue=x\n")
    assert dictionary[0x1000].data_type == datatypes.UNSIGNED32
    assert dictionary.unread == [
        f"{tmp_path / 'drive.eds'}: [1000]: DefaultValue: got 'x', expected a number of the type of the object; "
        "it counts as not given: correct the file"
    ]
    with pytest.raises(DictionaryError, match=re.escape(f"drive.eds: {part}")):
        dictionary.get_variable(0x1018, 1)


@pytest.mark.parametrize(("device", "held", "number"), [("001", "0", 1), ("7", "0x9A", 0x9A), ("", "0x9A", 0x9A)])
def test_everyone_who_asks_for_the_vendor_gets_the_same_answer(
    tmp_path: Path, device: str, held: str, number: int
) -> None:
    text = f"[DeviceInfo]\nVendorNumber={device}\n[1018]\nObjectType=9\n[1018sub1]\nDataType=7\nDefaultValue={held}\n"
    dictionary = read(tmp_path, text)
    assert (dictionary.device_information.vendor_number, dictionary[0x1018][1].default) == (number, number)


@pytest.mark.parametrize(("limit", "objects_to"), [("0x181", False), ("0x40000181", False), ("0x201", True)])
def test_limits_of_a_cob_id_are_those_of_its_identifier(tmp_path: Path, limit: str, objects_to: bool) -> None:
    entries = f"LowLimit={limit}\nHighLimit={limit}"
    text = f"[1800]\nObjectType=9\n[1800sub1]\nDataType=7\nAccessType=rw\n{entries}\n"
    use = ObjectUse(0x1800, 1, values=(0xC000_0181, 0x181))
    assert (objection(read(tmp_path, text), use) is not None) is objects_to


SERVO = Path(__file__).parents[2] / "eds" / "cia402_servo.eds"
SECTIONS = re.findall(r"(?m)^\[([0-9A-F]{4}(?:sub[0-9A-F]+)?)\]", SERVO.read_text())
UNDAMAGED = read_dictionary(SERVO, 1)
GOOD = survey(UNDAMAGED, unconfigured_axis(SERVO)).axis_map
KEYS = ["DataType", "ObjectType", "AccessType", "DefaultValue", "PDOMapping", "LowLimit", "ParameterName", "SubNumber"]
BAD = st.sampled_from(["", "?", "0xZZ", "99999999999999999999", "-1.5e", "[", "$NODEID$", "REAL128", "\0"])


@settings(max_examples=examples(20), deadline=None)
@given(st.sampled_from(SECTIONS), st.sampled_from([None, "line", *KEYS]), BAD)
def test_a_bad_section_is_a_warning_or_a_refusal_that_names_it(
    tmp_path_factory: pytest.TempPathFactory, section: str, key: str | None, bad: str
) -> None:
    def spoil(found: re.Match[str]) -> str:
        if key is None:  # the section is lost, its members remain
            return ""
        body = found[0].replace(f"[{section}]", f"[{section}]{bad}") if key == "line" else found[0]
        return re.sub(rf"(?m)^{key}=.*$", lambda _: f"{key}={bad}", body)

    path = tmp_path_factory.getbasetemp() / "spoilt.eds"
    path.write_text(re.sub(rf"(?ms)^\[{section}\]\n.*?(?=^\[|\Z)", spoil, SERVO.read_text()))
    index = section[:4].lower()
    try:
        found = survey(dictionary := read_dictionary(path, 1), unconfigured_axis(path))
    except DictionaryError as error:
        told = str(error).lower()
    else:
        told = " ".join([*dictionary.left_out.values(), *dictionary.unread]).lower()
        if found.suitability is Suitability.UNFIT:
            told += " ".join(f"{row.item} {row.text}" for row in found.reasons).lower()
        elif found.axis_map == GOOD:
            return
    assert index in told


def test_of_our_own_dictionary_nothing_is_left_unread() -> None:
    assert (UNDAMAGED.left_out, UNDAMAGED.unread) == ({}, [])


def test_missing_file_and_impossible_node_id_are_refused(tmp_path: Path) -> None:
    with pytest.raises(DictionaryError, match="cannot be read"):
        read_dictionary(tmp_path / "none.eds", 5)
    with pytest.raises(DictionaryError, match=r"expected 1\.\.127"):
        read_dictionary(tmp_path / "none.eds", 128)


LINES = [
    *("[1000]", "[1600]", "[1600sub1]", "[1000sub0]", "[DummyUsage]", "[", "="),
    *("DataType=7", "ObjectType=8", "DefaultValue=$NODEID", "LowLimit=-", "CompactSubObj=3", "SubNumber=2", "\x00"),
]


@settings(max_examples=examples(200), deadline=None)
@given(st.lists(st.sampled_from(LINES), max_size=12), st.binary(max_size=20))
def test_any_text_is_read_or_refused_but_never_crashes(
    tmp_path_factory: pytest.TempPathFactory, lines: list[str], noise: bytes
) -> None:
    path = tmp_path_factory.getbasetemp() / "fuzz.eds"
    path.write_bytes("\n".join(lines).encode() + noise)
    with contextlib.suppress(DictionaryError):
        read_dictionary(path, 1)


@pytest.mark.parametrize(
    "name",
    [
        "elmo_gold.dcf",
        "elmo_simpliq.dcf",
        "kollmorgen_rgm.eds",
        "maxon_epos2.eds",
        "maxon_epos4.dcf",
        "schunk_prl.dcf",
        "zeroerr_erob.eds",
    ],
)
def test_vendor_files_read_as_canopen_reads_them_except_where_it_errs(vendor_eds: Path, name: str) -> None:
    ours, theirs = read_dictionary(vendor_eds / name, 1), canopen.import_od(str(vendor_eds / name), node_id=1)
    assert set(ours) == set(theirs)
    for index in theirs:
        a = {0: ours[index]} if isinstance(ours[index], ODVariable) else ours[index].subindices
        b = {0: theirs[index]} if isinstance(theirs[index], ODVariable) else theirs[index].subindices
        assert set(a) == set(b)
        for subindex, expected in b.items():
            for attribute in ("data_type", "access_type", "min", "max", "default", "value"):
                seen, wanted = getattr(a[subindex], attribute), getattr(expected, attribute)
                signed = expected.data_type in datatypes.SIGNED_TYPES and isinstance(wanted, int)  # type: ignore[operator]
                if signed and wanted >> len(expected) - 1 == 1:
                    wanted -= 1 << len(expected)  # canopen leaves a hexadecimal default of a signed object unsigned
                if (name, index) == ("elmo_simpliq.dcf", 0x100B):
                    continue  # "$NODEID" alone, which canopen does not read
                if (index, attribute, wanted) == (0x1016, "max", 0xFFFF):
                    continue  # allows no node
                if attribute in ("min", "max"):
                    wanted = wanted and without_flags(index, subindex, wanted)
                if (index, attribute, wanted) == (0x1018, "default", None):
                    continue  # stated in [DeviceInfo] alone
                assert seen == wanted, (hex(index), subindex, attribute)


def test_a_dictionary_is_read_once_and_a_changed_file_again(tmp_path):
    path = tmp_path / "a.eds"
    text = "[1000]\nParameterName=Device type\nDataType=0x0007\nAccessType=ro\nDefaultValue={}\n"
    path.write_text(text.format(1))
    first = read_dictionary(path, 1)
    assert read_dictionary(path, 1) is first
    path.write_text(text.format(2))  # as long as before, and perhaps at the same instant
    assert (first[0x1000].default, read_dictionary(path, 1)[0x1000].default) == (1, 2)
    assert (read_dictionary(path, 2).node_id, first.node_id) == (2, 1)
