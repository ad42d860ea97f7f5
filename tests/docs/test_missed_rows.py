"""The figures page lists every recorded row that misses its target, with a reason, and no other row."""

import html
import json
import re
from pathlib import Path

import pytest

from tools import make_missed
from tools.fill_numbers import without_marks


def test_every_missed_row_has_a_reason_and_every_reason_a_row() -> None:
    assert [(each.question, each.row["row"]) for each in make_missed.missed() if not each.reason] == []
    assert make_missed.without_row() == []


def test_the_page_lists_each_missed_row_once_and_no_other() -> None:
    text = make_missed.PAGE.read_text(encoding="utf-8")
    assert text == make_missed.page(), "run: python -m tools.make_missed"
    [part] = re.findall(r"<!-- missed: begin -->\n(.*?)<!-- missed: end -->", text, re.DOTALL)
    lines = [line.split(" | ") for line in without_marks(part).splitlines()[2:]]
    recorded = [
        (path.stem, row["row"])
        for path in sorted(make_missed.RESULTS.glob("*.json"))
        for row in json.loads(path.read_text(encoding="utf-8")).get("rows", ())
        if row.get("met") is False
    ]
    assert [(question.strip("|` "), html.unescape(row).replace("\\*", "*")) for question, row, *_ in lines] == recorded
    assert {len(line) for line in lines} <= {5}


def _folder(place: Path, **met: bool) -> Path:
    rows = [{"row": name.replace("_", " "), "peer": "", "value": 1.0, "met": of} for name, of in met.items()]
    (place / "cycle.json").write_text(json.dumps({"rows": rows}), encoding="utf-8")
    return place


def test_a_missed_row_without_a_reason_and_a_reason_without_a_row_are_named(tmp_path, capsys) -> None:
    assert make_missed.main(["--check", str(_folder(tmp_path, new_row=False, other=True))]) == 1
    assert capsys.readouterr().out.splitlines() == [
        "missed, no reason: cycle: new row",
        "reason of no row: cycle: full stack / canopen",
    ]


@pytest.mark.parametrize("met", [False, True])
def test_a_reason_may_stay_while_its_row_is_met(met: bool, tmp_path: Path) -> None:
    folder = _folder(tmp_path, **{"full stack / canopen": met})
    assert make_missed.main(["--check", str(folder)]) == 0
    assert len(make_missed.missed(folder)) == (not met)
