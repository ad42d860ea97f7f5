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
