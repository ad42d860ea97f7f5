"""The ESI of the package and those of vendors give the object dictionaries of their drives."""

import os
from pathlib import Path

import pytest

from canhaptic.canopen.esi import Startup, read_esi, without_names
from canhaptic.drive.ethercat.segment import AlState, Identity
from canhaptic.errors import DictionaryError
from canhaptic.sim.drive import SimulatedDriveParameters
from canhaptic.sim.drive.ethercat.drive_node import EthercatDrive
from tests.sim_drive.drive_on_bus import ROOT, Mass
from tests.sim_drive.ethercat_line import PERIOD, Line
from tools import make_esi

ESI = ROOT / "eds" / "ethercat_servo.xml"


def default(dictionary, index: int, subindex: int = 0):
    return dictionary.get_variable(index, subindex).default


def test_the_esi_is_the_one_that_its_tool_writes() -> None:
    assert ESI.read_text(encoding="utf-8") == make_esi.make_esi()


def test_a_drive_made_from_the_esi_goes_to_op() -> None:
    esi = read_esi(ESI)
    assert (esi.identity, esi.assign_activate, esi.startup) == ((0xABC, 0x1234, 1), 0x300, ())
    assert (default(esi, 0x1600, 2), default(esi, 0x1A00), default(esi, 0x1C12, 1)) == (0x60710010, 3, 0x1600)
    parameters = SimulatedDriveParameters(counts_per_unit=1e4, rated_torque=100.0)
    line = Line(EthercatDrive(esi, Mass(), parameters, PERIOD))
    assert list(line.master.scan()) == [Identity(0xABC, 0x1234, 1, 0)]
    line.start()
    line.cycle(100)
    line.cycle()
    assert line.drives[0].torque == 10.0
    assert line.drives[0].al_state == AlState.OP


def written(tmp_path: Path, devices: str) -> Path:
    path = tmp_path / "drive.xml"
    path.write_text(
        f"<EtherCATInfo><Vendor><Id>#x0xF3F</Id></Vendor><Descriptions><Devices>{devices}</Devices></Descriptions>"
        "</EtherCATInfo>"
    )
    return path


def device(product: str, revision: str, inner: str = "") -> str:
    return f'<Device><Type ProductCode="{product}" RevisionNo="{revision}">x</Type><Name>n</Name>{inner}</Device>'


def test_numbers_are_read_as_vendors_write_them(tmp_path: Path) -> None:
    objects = "".join(
        f"<Object><Index>{index}</Index><Name>o</Name><Type>{kind}</Type><BitSize>{bits}</BitSize><Info>{info}</Info>"
        "<Flags><Access>rw</Access></Flags></Object>"
        for index, kind, bits, info in (
            ("#x6071", "INT", 16, "<DefaultData>FEFF</DefaultData>"),
            ("0x6072", "UINT", 16, "<DefaultValue>#x03E8</DefaultValue>"),
            ("24694", "UDINT", 32, "<DefaultData>E8030000</DefaultData>"),
            ("#x1008", "STRING(3)", 24, "<DefaultString>abc</DefaultString>"),
        )
    )
    esi = read_esi(written(tmp_path, device("16", "#x2", f"<Objects>{objects}</Objects>")))
    assert esi.identity == (0xF3F, 16, 2)
    assert [default(esi, index) for index in (0x6071, 0x6072, 0x6076, 0x1008)] == [-2, 1000, 1000, "abc"]


def test_the_same_content_is_read_once_and_a_copy_without_names_is_of_the_file_as_it_is(tmp_path: Path) -> None:
    path = written(tmp_path, device("1", "1"))
    assert read_esi(path) is read_esi(path)
    assert 'ProductCode="1"' in without_names(path)
    written(tmp_path, device("2", "1"))
    assert 'ProductCode="2"' in without_names(path)


def test_revisions_are_chosen_and_products_are_named(tmp_path: Path) -> None:
    path = written(tmp_path, device("1", "1") + device("1", "0x10420") + device("2", "5"))
    assert read_esi(path, product=1).identity[2] == 0x10420
    assert read_esi(path, product=1, revision=7).identity[2] == 1
    assert read_esi(path, product=2, revision=1).identity[2] == 5
    with pytest.raises(DictionaryError, match="describes products 0x1, 0x2; name one"):
        read_esi(path)
    with pytest.raises(DictionaryError, match="got product 0x3, expected one of 0x1, 0x2"):
        read_esi(path, product=3)


@pytest.mark.parametrize(
    ("text", "said"), [("<EtherCATInfo", "is no XML"), ("<a/>", "expected EtherCATInfo"),
                       ("<EtherCATInfo/>", "describes no device")]
)  # fmt: skip
def test_what_is_no_esi_is_refused(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "drive.xml"
    path.write_text(text)
    with pytest.raises(DictionaryError, match=said):
        read_esi(path)


def test_esis_of_vendors_are_read() -> None:
    folder = os.environ.get("CANHAPTIC_CAPTURES")
    if folder is None or not Path(folder).is_dir():
        pytest.skip(f"no captures: CANHAPTIC_CAPTURES is {folder!r}, expected their folder")
    inovance = read_esi(Path(folder) / "esi" / "inovance_sv660n_v9.12.xml.gz")
    assert inovance.startup == (Startup("PS", (0x6060, 0), b"\x08"),)
    assert (default(inovance, 0x1702, 3), inovance.assign_activate, 0x60C2 in inovance) == (0x60B80010, 0x300, False)
    ingenia = read_esi(Path(folder) / "esi" / "ingenia_eve_xcr_e.xml.gz")
    assert (ingenia.identity[1], default(ingenia, 0x6076)) == (0x2C31001, 1000)
    scan = read_esi(Path(folder) / "esi" / "maxon_epos4_igh_scan.xml")
    assert (scan.is_whole, default(scan, 0x1C12, 1), scan.get_variable(0x6071).pdo_mappable) == (False, 0x1600, True)
