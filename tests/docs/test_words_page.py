"""The glossary is in order, has a line for each word, and knows the columns that it names."""

import re

from canhaptic.control.balance import EnergyBalance
from canhaptic.quantities import NEW_COLUMNS
from canhaptic.view.energy_table import PORT_ROWS
from tests.docs.documents import ROOT, pages

PAGE = (ROOT / "docs" / "words.md").read_text(encoding="utf-8")
ROWS = re.findall(r"^\| ((?!word )[^|-][^|]*) \| ([^|]*) ?\| ([^|]+) \|$", PAGE, re.MULTILINE)
ANCHOR = re.compile(r'<a id="([\w-]+)"></a>')


def test_the_words_are_in_alphabetical_order_and_explained_once() -> None:
    """A reader looks one up by its first letter."""
    words = [ANCHOR.sub("", word).lower() for word, _, _ in ROWS]
    assert len(words) > 60
    assert words == sorted(set(words))


def test_every_word_has_the_anchor_of_its_name() -> None:
    """Tables link to it."""
    named = {word: re.sub(r"[^a-z0-9]+", "-", ANCHOR.sub("", word).lower()).strip("-") for word, _, _ in ROWS}
    assert {word: found[1] for word in named if (found := ANCHOR.match(word))} == named


def test_the_keys_of_a_scene_link_to_their_words() -> None:
    """In the table of every key."""
    page = (ROOT / "docs" / "configuration.md").read_text(encoding="utf-8")
    linked = dict(re.findall(r"^\| (?:\*\*)?\[`(\w+)`\]\(words\.md#([\w-]+)\)", page, re.MULTILINE))
    assert linked["hand_force"] == "hand-force"
    assert len(linked) > 15


def test_rows_of_the_account_that_a_page_names_exist() -> None:
    """A row that is renamed is renamed in every page."""
    labels = {label.strip() for label, _ in PORT_ROWS.values()}
    texts = (" ".join(page.read_text(encoding="utf-8").split()) for page in pages())
    named = [row for text in texts for row in re.findall(r"[Rr]ow \*([^*]+)\*", text)]
    assert len(named) > 8
    assert set(named) <= labels


def test_columns_of_the_log_that_are_named_exist() -> None:
    """A column that is renamed is renamed here."""
    named = {name for _, _, meaning in ROWS for name in re.findall(r"In the log: `(\w+)`", meaning)}
    assert named <= {NEW_COLUMNS.get(name, name) for name in EnergyBalance._fields}
    assert {"interaction", "dissipated", "stored", "surplus"} <= named
