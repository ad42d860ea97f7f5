"""docs/drives.md lists every drive profile and every quirk."""

import re

from canhaptic.drive.profile.quirks import _QUIRKS
from canhaptic.scene.profiles import _profile_names
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
