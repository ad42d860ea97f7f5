"""eds/cia402_servo.eds: equal to its generator, right by CiA 306, readable by the canopen package."""

import configparser
import re
import runpy

import canopen
import pytest

from canhaptic.canopen import objects as od
from canhaptic.canopen.eds import read_dictionary
from tests.sim_drive.drive_on_bus import ROOT, SERVO_EDS

NEEDED = [
    *(0x1000, 0x1001, 0x1003, 0x1005, 0x1006, 0x1008, 0x1009, 0x100A, 0x1014, 0x1016, 0x1017, 0x1018, 0x1029, 0x1200),
    *(base + i for base in (0x1400, 0x1600, 0x1800, 0x1A00) for i in range(4)),
    *(0x6007, 0x603F, 0x6040, 0x6041, 0x605A, 0x605B, 0x605C, 0x605D, 0x605E, 0x6060, 0x6061, 0x6064, 0x606C, 0x6071),
    *(0x6072, 0x6074, 0x6075, 0x6076, 0x6077, 0x6078, 0x6079, 0x608F, 0x6091, 0x60C2, 0x6502),
]


@pytest.fixture(scope="module")
def sections() -> configparser.RawConfigParser:
    parser = configparser.RawConfigParser()
    parser.read(SERVO_EDS, encoding="utf-8")  # strict: a section or key listed twice raises
    return parser


def test_committed_file_equals_the_output_of_its_generator() -> None:
    make_eds = runpy.run_path(str(ROOT / "tools" / "make_eds.py"))["make_eds"]
    assert SERVO_EDS.read_text(encoding="utf-8") == make_eds()


def test_supported_objects_count_and_list_every_object_once(sections: configparser.RawConfigParser) -> None:
    listed: list[int] = []
    for name in ("MandatoryObjects", "OptionalObjects", "ManufacturerObjects"):
        count = int(sections[name]["SupportedObjects"])
        numbered = {int(key): int(value, 16) for key, value in sections[name].items() if key.isdigit()}
        assert sorted(numbered) == list(range(1, count + 1)), name
        listed += numbered.values()
    described = [int(s, 16) for s in sections.sections() if re.fullmatch("[0-9A-F]{4}", s)]
    assert sorted(listed) == sorted(described) == sorted(NEEDED)
    assert [v for k, v in sections["MandatoryObjects"].items() if k.isdigit()] == ["0x1000", "0x1001", "0x1018"]


def test_canopen_imports_it_with_node_ids_records_and_mappable_objects() -> None:
    theirs = canopen.import_od(str(SERVO_EDS), node_id=9)
    assert theirs[0x1400][1].default == 0x209
    assert theirs[0x1A00].subindices[3].default == od.TORQUE_DEMAND << 16 | 16
    assert isinstance(theirs[0x1600], canopen.objectdictionary.ODRecord)
    assert isinstance(theirs[0x1A00], canopen.objectdictionary.ODRecord)
    for index in (od.CONTROLWORD, od.TARGET_TORQUE, od.STATUSWORD, od.POSITION_ACTUAL, od.TORQUE_DEMAND):
        assert theirs[index].pdo_mappable
    assert theirs[od.SUPPORTED_DRIVE_MODES].default == od.CYCLIC_SYNC_TORQUE_BIT
    assert theirs[od.RATED_TORQUE].default is None


def test_default_maps_are_those_of_the_preferred_cycle() -> None:
    ours = read_dictionary(SERVO_EDS, 1)
    assert [ours[0x1A00][i].default for i in range(4)] == [3, 0x60410010, 0x60640020, 0x60740010]
    assert [ours[0x1600][i].default for i in range(3)] == [2, 0x60400010, 0x60710010]
