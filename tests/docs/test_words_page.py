"""The glossary is in order, has a line for each word, and knows the columns that it names."""

import re

from canhaptic.control.balance import EnergyBalance
from tests.docs.documents import ROOT

PAGE = (ROOT / "docs" / "words.md").read_text(encoding="utf-8")
ROWS = re.findall(r"^\| ((?!word )[^|-][^|]*) \| ([^|]*) ?\| ([^|]+) \|$", PAGE, re.MULTILINE)


def test_the_words_are_in_alphabetical_order_and_explained_once() -> None:
    """A reader looks one up by its first letter."""
    words = [word.lower() for word, _, _ in ROWS]
    assert len(words) > 50
    assert words == sorted(set(words))


def test_columns_of_the_log_that_are_named_exist() -> None:
    """A column that is renamed is renamed here."""
    named = {name for _, _, meaning in ROWS for name in re.findall(r"In the log: `(\w+)`", meaning)}
    assert named <= set(EnergyBalance._fields)
    assert {"h_i", "h_r", "h_s", "h_dis"} <= named
