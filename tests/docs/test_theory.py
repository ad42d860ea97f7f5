"""Each statement of the proofs has a number of its own, and each number that is cited is that of a statement."""

import re
from collections import Counter

from tests.docs.documents import ROOT

PROOFS = sorted((ROOT / "docs" / "theory").glob("*.md"))
DEFINED = re.compile(r"^\s*(?:- )?\*\*([A-Z]\d+)\b", re.MULTILINE)
CITED = re.compile(r"\b([ADGLT]\d{1,2})\b")


def test_every_statement_has_a_number_of_its_own_and_every_citation_a_statement() -> None:
    texts = {path: path.read_text(encoding="utf-8") for path in PROOFS}
    numbers = Counter(number for text in texts.values() for number in DEFINED.findall(text))
    assert [
        number for number, times in numbers.items() if times > 1 and number[0] != "P"
    ] == []  # premises are a page's
    texts |= {path: path.read_text(encoding="utf-8") for path in (ROOT / "canhaptic" / "control").rglob("*.py")}
    cited = {(str(path.relative_to(ROOT)), number) for path, text in texts.items() for number in CITED.findall(text)}
    assert {place for place, number in cited if place.endswith(".py") and number in numbers}
    assert sorted((place, number) for place, number in cited if number not in numbers) == []
