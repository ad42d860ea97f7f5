"""Every relative link, anchor, image and named file of README and documentation exists; no page is an orphan."""

import re
import unicodedata
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import yaml

from tests.docs.documents import ROOT, pages

DOCS = ROOT / "docs"
_CODE_BLOCK = re.compile(r"^(```|~~~).*?^\1|^(?:    [^\n]*\n)+", re.MULTILINE | re.DOTALL)
_SPAN = re.compile(r"`([^`\n]+)`")
_LINK = re.compile(r"\]\(\s*<?([^)\s>]+)>?(?:\s+\"[^\"]*\")?\s*\)")
_IMAGE_IN_HTML = re.compile(r"<(?:img|a|source)\b[^>]*?\b(?:src|href)=\"([^\"]+)\"")
_ANCHOR = re.compile(r'<a id="([\w-]+)"></a>')
_HEADING = re.compile(r"^#{1,6} +(.+?) *#*$", re.MULTILINE)
_FOLDERS = ("canhaptic", "configs", "docs", "eds", "tests", "tools")
_PARTS = tuple(sorted(path.name for path in (ROOT / "canhaptic").iterdir() if path.is_dir()))
_NAMED = re.compile(rf"(?:{'|'.join((*_FOLDERS, *_PARTS))})/[\w./*-]*[\w*/]")


class Link(NamedTuple):
    """One link as written."""

    target: str
    line: int


def without_code(text: str) -> str:
    """The text with code blocks and spans blanked, every line where it was."""
    blank = _CODE_BLOCK.sub(lambda found: "\n" * found[0].count("\n"), text)
    return _SPAN.sub("", blank)


def links(text: str) -> Iterator[Link]:
    """The targets of links and images outside code."""
    plain = without_code(text)
    for pattern in (_LINK, _IMAGE_IN_HTML):
        for found in pattern.finditer(plain):
            yield Link(found[1], plain.count("\n", 0, found.start()) + 1)


def anchors(text: str) -> set[str]:
    """The anchors that both GitHub and the built site give to the headings of a page; the first of equal ones."""
    found = set(_ANCHOR.findall(text))
    for heading in _HEADING.findall(_CODE_BLOCK.sub("", text)):
        plain = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).replace("`", "")
        plain = re.sub(r"<!--.*?-->", "", plain)
        ascii_only = unicodedata.normalize("NFKD", plain).encode("ascii", "ignore").decode()
        of_site = re.sub(r"[-\s]+", "-", re.sub(r"[^\w\s-]", "", ascii_only).strip().lower())
        of_github = re.sub(r"\s", "-", re.sub(r"[^\w\s-]", "", plain).strip().lower())
        if of_site == of_github:
            found.add(of_site)
    return found


def faults(page: Path, text: str) -> list[str]:
    """What is wrong with the links of a page, one line each."""
    found = []
    for target, line in links(text):
        where = f"{page.relative_to(ROOT).as_posix()}:{line}: {target}"
        if re.match(r"https?://", target):
            continue
        path, _, anchor = target.partition("#")
        file = (page.parent / path).resolve() if path else page
        if path and not file.exists():
            found.append(f"{where}: there is no such file")
        elif page.is_relative_to(DOCS) and not file.is_relative_to(DOCS):
            found.append(f"{where}: leaves docs/, where the built site has no page; name the file in a code span")
        elif anchor and anchor not in anchors(file.read_text(encoding="utf-8") if path else text):
            found.append(f"{where}: there is no such heading")
    return found


def test_every_link_leads_somewhere() -> None:
    assert [fault for page in pages() for fault in faults(page, page.read_text(encoding="utf-8"))] == []


def test_every_file_that_a_page_names_exists() -> None:
    missing = []
    for page in pages():
        text = _CODE_BLOCK.sub("", page.read_text(encoding="utf-8"))
        named = [name for span in _SPAN.findall(text) for name in [span.split("::")[0]] if _NAMED.fullmatch(name)]
        bases = (ROOT, ROOT / "canhaptic")
        missing += [(page.name, name) for name in named if not any(_found(base, name) for base in bases)]
    assert missing == []


def _found(base: Path, name: str) -> bool:
    return any(True for _ in base.glob(name.rstrip("/")))


def navigation(entry: Any) -> Iterator[str]:
    """The pages that the navigation names."""
    if isinstance(entry, str):
        yield entry
    else:
        for inner in entry.values() if isinstance(entry, dict) else entry:
            yield from navigation(inner)


def test_every_page_is_in_the_navigation_of_26_and_the_proofs_once_and_the_first_is_the_readme() -> None:
    named = sorted(navigation(yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))["nav"]))
    assert len([page for page in named if not page.startswith("theory/")]) <= 26
    assert named == sorted(["index.md", *(page.relative_to(DOCS).as_posix() for page in DOCS.rglob("*.md"))])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("see [it](nowhere.md)", "docs/page.md:1: nowhere.md: there is no such file"),
        ("\n![picture](images/nothing.png)", "docs/page.md:2: images/nothing.png: there is no such file"),
        ("[it](safety.md#nothing)", "safety.md#nothing: there is no such heading"),
        ("[it](#nothing)\n\n# Something", "#nothing: there is no such heading"),
        ("[the route](../canhaptic/cycle.py)", "leaves docs/"),
        ('<img alt="x" src="images/nothing.png">', "no such file"),
        ("[![badge](nothing.svg)](safety.md)", "nothing.svg"),
    ],
)
def test_a_link_that_leads_nowhere_is_named(text: str, said: str) -> None:
    [fault] = faults(DOCS / "page.md", text)
    assert said in fault


def test_links_in_code_are_none_and_good_ones_pass() -> None:
    text = (
        "`[a](b.md)`\n\n```sh\n[a](b.md)\n```\n\n    [a](b.md)\n\n[safety](safety.md#first-torque) [w](https://a.b/c)"
    )
    assert faults(DOCS / "page.md", text) == []
    assert anchors("## `bus`\n\n## Who stops what\n\n```\n# no heading\n```\n") == {"bus", "who-stops-what"}
