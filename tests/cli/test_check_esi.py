"""`check-eds` of an EtherCAT drive: ESI and EEPROM judged as an EDS is, by revision, with vendors' traps."""

import json
import os
import re
from pathlib import Path

import pytest

from canhaptic.canopen.esi import read_esi, without_names
from canhaptic.cli.main import main
from canhaptic.drive.ethercat.esi_survey import judge
from canhaptic.sim.drive.ethercat.eeprom import slave_information
from tests.scene.scene_text import REPOSITORY
from tools.make_esi import make_two_revisions

ESI = REPOSITORY / "eds" / "ethercat_servo.xml"


def verdict(capsys: pytest.CaptureFixture[str], path: Path, *words: str) -> tuple[int, str, str]:
    """Return exit status, verdict and reasons."""
    status = main(["check-eds", str(path), "--json", *words])
    said = json.loads(capsys.readouterr().out)
    return status, said.get("verdict", ""), "; ".join(said.get("reasons", [])) or said.get("error", "")


@pytest.fixture
def two(tmp_path: Path) -> Path:
    path = tmp_path / "two.xml"
    path.write_text(make_two_revisions())
    return path


@pytest.mark.slow_but("words3-*")
@pytest.mark.parametrize(
    ("words", "status", "seen", "reason"),
    [
        ((), 0, "usable with conditions", ""),
        (("--revision", "0x10420"), 0, "usable with conditions", ""),
        (("--revision", "0x20000"), 0, "usable with conditions", ""),
        (("--revision", "1"), 1, "not usable", "0x6071 target torque: missing"),
    ],
)
def test_the_revision_decides(two: Path, capsys, words: tuple[str, ...], status: int, seen: str, reason: str) -> None:
    found = verdict(capsys, two, *words)
    assert found[:2] == (status, seen)
    assert reason in found[2]


def test_a_revision_older_than_all_of_the_file_is_an_error(two: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check-eds", str(two), "--revision", "0"]) == 2
    assert "got revision 0x0, expected 0x1, 0x10420 or a later one" in capsys.readouterr().err


def entry(index: str, subindex: int, bits: int, kind: str) -> str:
    return (
        f"<Entry><Index>{index}</Index><SubIndex>{subindex}</SubIndex><BitLen>{bits}</BitLen><DataType>{kind}</DataType>"
        "</Entry>"
    )


WORD = entry("#x6040", 0, 16, "UINT")
REALS = WORD + entry("#x0x6071", 1, 32, "REAL") + entry("#x0x6071", 2, 32, "REAL")


@pytest.mark.parametrize(
    ("inner", "seen", "reason"),
    [
        ("", "not usable", "no RxPDO: not a drive"),
        (f"<RxPdo><Index>#x1600</Index>{REALS}</RxPdo>", "not usable", "0x6071 has 32 bits.*2 axes in one PDO"),
        (f"<RxPdo><Index>5632</Index>{WORD}{entry('24689', 0, 16, 'UINT16')}</RxPdo>", "only the drive can say", "SDO"),
    ],
)
def test_what_process_data_alone_say(tmp_path, capsys, inner: str, seen: str, reason: str) -> None:
    path = tmp_path / "drive.xml"
    path.write_text(
        "<EtherCATInfo><Vendor><Id>251</Id></Vendor><Descriptions><Devices><Device><Type ProductCode='7' "
        f"RevisionNo='1'>x</Type><Name>n</Name>{inner}</Device></Devices></Descriptions></EtherCATInfo>"
    )
    status, found, reasons = verdict(capsys, path)
    assert (status, found) == (1, seen)
    for part in reason.split(".*"):
        assert part in reasons


def test_modes_that_default_to_0_are_asked_of_the_drive(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "drive.xml"
    text = ESI.read_text(encoding="utf-8")
    at = text.index("#x6502")
    begin = text.index("<DefaultData>", at) + len("<DefaultData>")
    for value, seen in (("00000000", "only the drive can say"), ("A0000000", "not usable")):
        path.write_text(text[:begin] + value + text[begin + 8 :])
        status, found, reasons = verdict(capsys, path)
        assert (status, found) == (1, seen)
        assert "0x6502" in reasons


def test_the_mode_without_sync0_is_passed_over(tmp_path: Path) -> None:
    path = tmp_path / "drive.xml"
    first = "<Dc><OpMode><Name>free</Name><AssignActivate>#x0</AssignActivate></OpMode>"
    path.write_text(ESI.read_text(encoding="utf-8").replace("<Dc>", first))
    assert read_esi(path).assign_activate == 0x0300


def test_an_esi_without_names_describes_the_same_drive(tmp_path: Path) -> None:
    text, path = ESI.read_text(encoding="utf-8"), tmp_path / "drive.xml"
    secret = "<Name>Ada</Name><ImageData16x14>Ada</ImageData16x14>"
    path.write_text(text.replace("<Name>canhaptic</Name>", secret).replace(">ethercat_servo<", ">Ada<"))
    assert path.read_text().count("Ada") == 3
    path.write_text(without_names(path))
    assert not re.search("Ada|canhaptic|generic", path.read_text())
    found, known = read_esi(path), read_esi(ESI)
    assert (found.title, found.identity, found.assign_activate) == ("", known.identity, known.assign_activate)
    assert judge(path, found)[1:] == judge(ESI, known)[1:]


def test_an_eeprom_is_judged_by_what_it_lists(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "drive.bin"
    content = slave_information((1, 2, 3, 4), "servo", has_information=True)
    path.write_bytes(content)
    assert verdict(capsys, path)[:2] == (1, "only the drive can say")
    assert main(["new", str(path)]) == 2
    assert "only the drive can say: the file has no dictionary" in (said := capsys.readouterr().err)
    assert "get the drive's ESI with its objects" in said
    path.write_bytes(b"\0" + content[1:])
    assert main(["check-eds", str(path)]) == 2
    assert "check sum: got" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "status", "seen"),
    [
        ("esi/inovance_sv660n_v9.12.xml.gz", 0, "usable with conditions"),
        ("esi/ingenia_eve_xcr_e.xml.gz", 0, "usable with conditions"),
        ("esi/maxon_epos4_igh_scan.xml", 1, "only the drive can say"),
        ("esi/maxon_epos4_igh_scan_3axis.xml", 1, "only the drive can say"),
        ("esi/pollen_orbita2d.xml", 1, "not usable"),
        ("esi/pollen_orbita3d.xml", 1, "not usable"),
        ("sii/kollmorgen_akd.bin", 1, "only the drive can say"),
        ("sii/kollmorgen_akd_null_strings.bin", 1, "only the drive can say"),
        ("sii/pollen_orbita2d.bin", 1, "not usable"),
        ("sii/empty_eeprom_issue286.bin.gz", 2, ""),
    ],
)
def test_the_verdicts_on_vendors_files(capsys: pytest.CaptureFixture[str], name: str, status: int, seen: str) -> None:
    folder = os.environ.get("CANHAPTIC_CAPTURES")
    if folder is None or not Path(folder).is_dir():
        pytest.skip(f"no captures: CANHAPTIC_CAPTURES is {folder!r}, expected their folder")
    assert verdict(capsys, Path(folder) / name)[:2] == (status, seen)
