"""A person walks the tutorial of a first EtherCAT drive, command by command as the page has them."""

import re
import shlex
from pathlib import Path

import pytest

from tests.journeys.person import REPOSITORY, Person

PAGE = (REPOSITORY / "docs" / "tutorials" / "first_ethercat_drive.md").read_text(encoding="utf-8")


def commands(section: str) -> list[list[str]]:
    """The commands of `canhaptic` in a section of the page, with the files of this checkout."""
    text = PAGE.partition(f"## {section}\n")[2].partition("\n## ")[0]
    lines = [line for block in re.findall(r"```sh\n(.*?)```", text, re.DOTALL) for line in block.splitlines()]
    found = [shlex.split(line, comments=True)[1:] for line in lines if line.startswith("canhaptic ")]
    assert found
    return [[re.sub(r"^(configs|eds)/", rf"{REPOSITORY}/\1/", word) for word in words] for words in found]


@pytest.mark.slow
def test_the_tutorial_is_walked_without_hardware(person: Person, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(person.folder)
    said = {}
    for words in (*commands("The device description"), *commands("The twin")):
        said[words[0]] = person.types(*words)
    assert "usable with conditions" in said["check-eds"]
    assert "the wall is felt" in said["check"]
    assert "handle: passive: yes" in said["run"]
    shown = person.types("inspect", "twin.pcap")
    assert "asks for OP" in shown
    assert Path("measured.yaml").exists()


def test_the_pages_say_that_no_real_drive_was_run() -> None:
    drives = (REPOSITORY / "docs" / "drives.md").read_text(encoding="utf-8")
    assert "Never run on a real drive" in PAGE
    assert "**Never run on a real drive.**" in drives.partition("## EtherCAT")[2]


@pytest.mark.slow
def test_the_evidence_of_an_ethercat_drive_has_its_esi_and_every_frame(person: Person) -> None:
    out = person.folder / "evidence"
    scene = str(REPOSITORY / "configs" / "ethercat.yaml")
    person.types("evidence", scene, "--out", str(out), "--yes", "--anonymous", "--duration", "0.2")
    assert {"drive0.xml", "rig.yaml", "dry_run.pcap", "tenth.pcap", "sign.md"} <= {file.name for file in out.iterdir()}
    assert "esi: drive0.xml" in (out / "rig.yaml").read_text(encoding="utf-8")
    assert "<Name>canhaptic" not in (out / "drive0.xml").read_text(encoding="utf-8")
    assert "asks for OP" in person.types("inspect", str(out / "tenth.pcap"))
    for name in ("tenth", "dry_run"):
        log, frames, rig = (str(out / file) for file in (f"{name}.h5", f"{name}.pcap", "rig.yaml"))
        assert "equal bit for bit" in person.types("inspect", log, "--recompute", "--bus-log", frames)
        assert "identical" in person.types("replay", frames, "--config", rig, "--energy-log", log)


def test_a_homing_on_ethercat_is_refused_before_anything_is_sent(person: Person) -> None:
    scene = str(REPOSITORY / "configs" / "ethercat.yaml")
    words = ("--home", scene, "--method", "37", "--speed", "1", "1", "--torque", "0.1", "--yes")
    person.types("commission", *words, status=2)
    assert (
        "on a bus of type ethercat, where a homing is not offered: homing here writes the controlword by SDO"
        in person.errors
    )
    assert "home it with the vendor's tool" in person.errors
