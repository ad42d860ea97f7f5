"""The documentation builds as a site, without a warning, and its pages ask nothing of a network."""

import os
import re
import subprocess
import sys
from pathlib import Path
from urllib.parse import unquote

import pytest

import canhaptic
from canhaptic import extending, passivity
from tests.docs.documents import ROOT
from tests.view.chromium import Page, chromium

_ASKED = re.compile(r"<(?:script|link|img|iframe|source|video)\b[^>]*?\b(?:src|href)=[\"']?(?:https?:)?//[^\"'> ]+")
_ASKED_BY_STYLE = re.compile(r"(?:url\(\s*[\"']?|@import\s+[\"'])(?:https?:)?//[^)\"']+")


def _build(folder: Path) -> str:
    """Builds the site into a folder and returns what the builder wrote on standard error."""
    for module in ("mkdocs", "material", "mkdocstrings_handlers.python"):
        pytest.importorskip(module, reason="needs the extra `docs`")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)]
    environment = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    built = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr
    return built.stderr


@pytest.mark.campaign
def test_the_search_works_from_a_folder_and_finds_a_key_and_a_tutorial_first(tmp_path: Path) -> None:
    """Without a server, where a browser starts no worker; and finds a key inside its path."""
    _build(tmp_path)
    with chromium() as page:
        found = _searched(page, tmp_path, "sync_jitter")
        assert "configuration.html" in " ".join(found)
        assert found[0].endswith(("words.html", "configuration.html"))
        assert "/tutorials/" in _searched(page, tmp_path, "own wall")[0]
        assert page.faults == []


def _searched(page: Page, folder: Path, words: str) -> list[str]:
    """Returns the addresses that the search of the site finds, best first."""
    page.open((folder / "tutorials" / "your_own_wall.html").as_uri())
    page.wait_for("document.readyState === 'complete' && document.querySelector('[data-md-toggle=search]')")
    page.value("document.querySelector('[data-md-toggle=search]').click()")
    page.value(
        f"{{const query = document.querySelector('[data-md-component=search-query]'); query.value = '{words}';"
        " query.dispatchEvent(new Event('keyup', {bubbles: true}))}"
    )
    page.wait_for("document.querySelector('.md-search-result__item a')")
    links = page.value("[...document.querySelectorAll('.md-search-result__item a')].map(each => each.href).join()")
    return str(links).split(",")


def _missing(file: Path, text: str) -> list[str]:
    """Returns the addresses of a page that lead to no file of the site, which a browser logs as errors."""
    found = re.findall(r"""<(?:script|link|img|iframe|source|a)\b[^>]*?\b(?:src|href)=["']?([^"'> ]+)""", text)
    places = [unquote(of.partition("#")[0].partition("?")[0]) for of in found if not re.match(r"[a-z]+:|//|#", of)]
    return [place for place in places if not (file.parent / place).exists()]


@pytest.mark.slow
def test_the_site_builds_strictly_and_asks_nothing_of_a_network(tmp_path: Path) -> None:
    assert "WARNING" not in _build(tmp_path)
    html = {file: file.read_text(encoding="utf-8") for file in tmp_path.rglob("*.html")}
    assert len(html) > 20
    assert {file.name: found for file, text in html.items() if (found := _ASKED.findall(text))} == {}
    assert not [file for file, text in html.items() if 'class="mermaid"' in text]  # drawn by a script from a network
    assert [found for file, text in html.items() if file.name != "404.html" for found in _missing(file, text)] == []
    assert not [file for file, text in html.items() if '"provider":"mike"' in text.replace(" ", "")]  # versions.json
    styles = [file.read_text(encoding="utf-8") for file in tmp_path.rglob("*.css")]
    assert styles
    assert [found for text in styles for found in _ASKED_BY_STYLE.findall(text)] == []
    api = html[tmp_path / "api.html"]
    for name in ("canhaptic.scene.load.load_scene", "canhaptic.cycle.Cycle.step", "canhaptic.errors.CanHapticError"):
        assert f'id="{name}"' in api


def test_every_page_says_for_whom_it_is_and_where_to_go_next() -> None:
    for page in sorted((ROOT / "docs").rglob("*.md")):
        if "results" not in page.parts:
            text = page.read_text(encoding="utf-8")
            assert re.search(r"^# .+\n\nFor [a-z]", text, re.MULTILINE), page
            assert "Where to go next: " in text, page


def test_a_line_of_text_has_at_most_ninety_letters() -> None:
    """On a wide screen too; a letter is at least 0.87 times as wide as a digit."""
    style = (ROOT / "docs" / "stylesheets" / "tables.css").read_text(encoding="utf-8")
    [digits] = re.findall(r"\.md-typeset :is\(p, li, [^)]*\) \{ max-width: (\d+)ch; \}", style)
    assert int(digits) / 0.87 <= 90.0


def test_the_api_lists_the_public_names_and_no_others() -> None:
    page = (ROOT / "docs" / "api.md").read_text(encoding="utf-8")
    listed = re.findall(r"^::: [\w.]+\.(\w+)$", page, re.MULTILINE) + re.findall(r"^\| `(\w+)` \|", page, re.MULTILINE)
    errors = {
        name for name in [*canhaptic.__all__, *passivity.__all__] if name.endswith("Error")
    }  # listed with all others, as their module
    assert sorted([*listed, *errors]) == sorted(
        ["errors", *{*canhaptic.__all__, *extending.__all__, *passivity.__all__}]
    )
