"""Writes the table of quantities into docs/words.md: `python -m tools.make_words`."""

from pathlib import Path
from typing import Final

from canhaptic.quantities import ACCOUNT, OLD_COLUMNS, OLD_KEYS, QuantityRow
from tools.page_part import with_part, write_page

PAGE: Final = Path(__file__).resolve().parent.parent / "docs" / "words.md"
_HEADINGS: Final = ("name", "unit", "title", "what it is", "better", "before 0.4")


def page() -> str:
    """Returns the page with its table made anew."""
    rows = [_HEADINGS, ["---"] * len(_HEADINGS), *(_cells(name, row) for name, row in ACCOUNT.items())]
    return with_part(PAGE, "quantities", "\n".join(f"| {' | '.join(cells)} |" for cells in rows) + "\n")


def _cells(name: str, row: QuantityRow) -> list[str]:
    units = dict.fromkeys((row.unit_on("m"), row.unit_on("rad")))
    unit = ", ".join(unit.replace("*", "\\*") for unit in units if unit not in ("1", ""))
    head, dot, last = name.rpartition(".")
    olds = [old for old in (OLD_COLUMNS.get(name), f"{head}{dot}{OLD_KEYS[last]}" if last in OLD_KEYS else None) if old]
    return [f"`{name}`", unit, row.title.strip(), row.sentence, row.better, ", ".join(f"`{old}`" for old in olds)]


if __name__ == "__main__":
    write_page(PAGE, page)
