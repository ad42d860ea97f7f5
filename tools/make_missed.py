"""Makes the part of docs/figures.md that lists the targets not reached: `python -m tools.make_missed`.

The rows come from docs/results, their reasons from `tools/missed_rows.yaml`. A reason names a question and a row, with
`*` for any text and `ROW~PEER` where several rows have the name. It may stay while its row is met, since a time is
met in one recording and missed in the next; only a reason of a row that does not exist is refused.

`python -m tools.make_missed --check [FOLDER]` writes nothing: it prints the missed rows without a reason, and the
reasons without a row, of docs/results or another folder of results; the exit status is 1 where there are any.
"""

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final, NamedTuple

import yaml

from tools.fill_numbers import ROOT, filled, row_is_named
from tools.page_part import with_part, write_page

PAGE: Final = ROOT / "docs" / "figures.md"
RESULTS: Final = ROOT / "docs" / "results"
REASONS: Final = Path(__file__).with_name("missed_rows.yaml")


class Missed(NamedTuple):
    """A row whose target is not reached."""

    question: str
    row: dict[str, Any]
    reason: str  # empty: none is known


def rows_of(folder: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yields question and row of every result of a folder that has rows with targets."""
    for path in sorted(folder.glob("*.json")):
        found = json.loads(path.read_text(encoding="utf-8"))
        for row in found.get("rows", ()) if isinstance(found, dict) else ():
            yield path.stem, row


def reasons() -> list[dict[str, str]]:
    """Returns what is written about missed rows: `question`, `row` and `why`, the first that fits counts."""
    written: list[dict[str, str]] = yaml.safe_load(REASONS.read_text(encoding="utf-8"))
    return written


def missed(folder: Path = RESULTS) -> list[Missed]:
    """Returns every missed row of a folder of results, with its reason."""
    known = reasons()
    return [
        Missed(question, row, next((each["why"] for each in known if _fits(each, question, row)), ""))
        for question, row in rows_of(folder)
        if row.get("met") is False
    ]


def without_row(folder: Path = RESULTS) -> list[str]:
    """Returns the reasons whose row is in no result of a folder; a question without a result there is left out."""
    rows = list(rows_of(folder))
    recorded = {question for question, _ in rows}
    return [
        f"{each['question']}: {each['row']}"
        for each in reasons()
        if each["question"] in recorded and not any(_fits(each, question, row) for question, row in rows)
    ]


def _fits(reason: dict[str, str], question: str, row: dict[str, Any]) -> bool:
    return reason["question"] == question and row_is_named(row, reason["row"])


def part() -> str:
    """Returns the table, with the numbers of docs/results.

    Raises:
        InputError: A reason names a number that no result has.
    """
    lines = ["| `make bench Q=` | row | asked | reached | why, and what would reach it |", "|---|---|---|---|---|"]
    for question, row, reason in missed():
        lines.append(f"| `{question}` | {_cell(row['row'])} | {_asked(row)} | {_reached(row)} | {reason.strip()} |")
    return filled("\n".join(lines) + "\n", "missed_rows.yaml")


def _cell(text: str) -> str:
    return text.replace("|", "/").replace("*", "\\*").replace("<", "&lt;")


def _asked(row: dict[str, Any]) -> str:
    asked = row.get("target", f"at most {row['allowed']} cycles" if "allowed" in row else "")
    return _cell(asked).replace(">", "&gt;")


def _reached(row: dict[str, Any]) -> str:
    if "value" not in row:  # of `faults`
        return f"{row['cycles_to_zero']} cycles"
    value = f"{row['value']:.3g}" if abs(row["value"]) < 1e3 else f"{row['value']:,.0f}"
    unit = "" if row["unit"] in ("", "1") else f" {_cell(row['unit'])}"
    peer = f"; {_cell(row['peer'])}" if row.get("peer") else ""
    if row.get("peer_value") is not None:
        peer += f": {row['peer_value']:.3g}" if abs(row["peer_value"]) < 1e3 else f": {row['peer_value']:,.0f}"
    return f"{value}{unit}{peer}" + ("" if row.get("ratio") is None else f", ratio {row['ratio']:.3g}")


def page() -> str:
    """Returns docs/figures.md with the table of today."""
    return with_part(PAGE, "missed", part())


def main(words: list[str]) -> int:
    """Writes the page, or with `--check` only says what is missing; returns the exit status."""
    folder = Path(words[words.index("--check") + 1]) if words[-1:] not in ([], ["--check"]) else RESULTS
    if "--check" not in words:
        write_page(PAGE, page)
    unknown = [f"missed, no reason: {each.question}: {_name(each.row)}" for each in missed(folder) if not each.reason]
    unknown += [f"reason of no row: {name}" for name in without_row(folder)]
    sys.stdout.write("".join(f"{line}\n" for line in unknown))
    return 1 if unknown else 0


def _name(row: dict[str, Any]) -> str:
    return f"{row['row']}~{row['peer']}" if row.get("peer") else str(row["row"])


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
