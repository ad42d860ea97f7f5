"""docs/paper.md says what the results and the source say, and leaves no equation and no trap out."""

import json
import re

import pytest

from canhaptic.errors import InputError
from tools import make_paper_page
from tools.make_paper_page import PAGE, SOURCE, number, page

TEXT = PAGE.read_text(encoding="utf-8")


def test_the_page_of_the_paper_is_current() -> None:
    assert page() == TEXT, "run: python -m tools.make_paper_page"
    assert "[[" not in TEXT  # a mark over two lines was left as it is


def test_every_equation_and_every_trap_has_its_place() -> None:
    rows = re.findall(r"^\| \((\d+)\) \|", TEXT, re.MULTILINE)
    assert [int(row) for row in rows] == list(range(1, 20))
    assert [int(n) for n in re.findall(r"^\*\*(\d+)\. ", TEXT, re.MULTILINE)] == list(range(1, 15))
    pictures = re.findall(r"\]\((images/paper_fig\d\.png)\)", TEXT)
    assert pictures == [f"images/paper_fig{n}.png" for n in (4, 5, 7, 8, 9)]
    assert all((PAGE.parent / picture).is_file() for picture in pictures)


def test_a_number_of_the_page_is_that_of_the_result() -> None:
    result = json.loads((PAGE.parent / "results" / "paper_figures.json").read_text(encoding="utf-8"))
    margin = result["fig7"]["one_sample_late_mass_known"]["least_margin"]
    assert f"fails by {-1e3 * margin:.1f} mJ" in TEXT.replace("\n", " ")
    assert number("paper_figures#fig7#one_sample_late_mass_known#least_margin") == margin


def test_the_source_has_no_measured_number_of_its_own() -> None:
    """Energies, errors and ratios come from marks: in the source no number is followed by a unit of theirs."""
    plain = re.sub(r"\[\[.+?\]\]|`[^`]+`", "", SOURCE.read_text(encoding="utf-8"))
    assert not re.findall(r"\d (?:[munpk]?J|um|times)\b", plain)


@pytest.mark.parametrize(
    ("mark", "said"),
    [
        ("[[no_such#a]]", "no_such.json"),
        ("[[paper_figures#fig6#no_delay]]", "'fig6'"),
        ("[[paper_figures#fig7]]", "expected a number"),
        ("[[passivity#A99 nothing#value]]", "'A99 nothing'"),
        ("[[code:control/balance.py:no_such]]", "has no 'no_such'"),
        ("[[code:no_such.py:any]]", "no_such.py"),
        ("[[test:control/test_root.py:test_no_such]]", "has no 'test_no_such'"),
    ],
)
def test_a_mark_that_points_at_nothing_is_refused(mark: str, said: str, tmp_path, monkeypatch) -> None:
    source = tmp_path / "paper_page.md"
    source.write_text(f"It is {mark}.\n", encoding="utf-8")
    monkeypatch.setattr(make_paper_page, "SOURCE", source)
    with pytest.raises(InputError, match=re.escape(said)):
        page()
