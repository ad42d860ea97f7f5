"""docs/drives.md lists every drive profile and every quirk."""

import re

from canhaptic.drive.profile.quirks import _QUIRKS
from canhaptic.scene.profiles import _PROFILES, _profile_names
from tests.docs.documents import ROOT

PAGE = (ROOT / "docs" / "drives.md").read_text(encoding="utf-8")


def names_below(heading: str) -> set[str]:
    """The names in the first column of the table below a heading."""
    section = PAGE.split(f"## {heading}\n")[1].split("\n## ")[0]
    rows = re.findall(r"^\| (`[^|]+`) \|", section, re.MULTILINE)
    return {name for row in rows for name in re.findall(r"`(\w+)`", row)}


def test_every_profile_is_listed() -> None:
    assert names_below("Profiles") == set(_profile_names())


def test_every_quirk_is_listed() -> None:
    assert names_below("Quirks") == set(_QUIRKS)


SOURCES = r"\s# (manual|dictionary|capture|assumption): \S"


def test_each_value_of_a_profile_says_where_it_is_from() -> None:
    values = [
        line
        for path in _PROFILES.glob("*.yaml")
        for line in path.read_text(encoding="utf-8").splitlines()
        if line and not line.startswith("#")
    ]
    assert len(values) > 15
    assert [line for line in values if not re.search(SOURCES, line)] == []
