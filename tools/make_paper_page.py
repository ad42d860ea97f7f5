"""Writes docs/paper.md from tools/paper_page.md and the committed results: `python -m tools.make_paper_page`.

Three kinds of marks are filled in, and each fails where it points at nothing:

    [[RESULT#PART#PART|UNIT]]   a number of docs/results/RESULT.json, with UNIT (`J`, `m`, ...), in `%` or plain
    [[code:FILE:NAME]]          a function, class or method of canhaptic/FILE
    [[test:FILE:NAME]]          a test of tests/FILE

A PART is a key, or the name of one of the `rows` of a benchmark.
"""

import ast
import re
from pathlib import Path
from textwrap import fill
from typing import Any, Final

from canhaptic.errors import InputError
from tools.fill_numbers import value_at, written
from tools.page_part import write_page

ROOT: Final = Path(__file__).resolve().parents[1]
SOURCE: Final = ROOT / "tools" / "paper_page.md"
PAGE: Final = ROOT / "docs" / "paper.md"
_MARK: Final = re.compile(r"\[\[(.+?)\]\]", re.DOTALL)  # a line may end inside
_WIDTH: Final = 120
_AS_WRITTEN: Final = ("|", "#", "!", "```")
"""How blocks begin that are not a paragraph."""


def number(place: str) -> float:
    """Returns a number of docs/results.

    Args:
        place: `RESULT#PART#PART`.

    Raises:
        InputError: There is none.
    """
    try:
        value = value_at(place)
    except InputError as error:
        raise InputError(f"{SOURCE.name}: {error}") from error
    if isinstance(value, str):
        raise InputError(f"{SOURCE.name}: {place}: got {value!r}, expected a number; mend the mark")
    return value


def _shown(mark: str) -> str:
    place, _, unit = mark.partition("|")
    number(place)  # a text would be written as it is
    return written(f"{place} @ {unit}" if unit else place)


def _named(kind: str, mark: str) -> str:
    """Returns a reference to something in the source.

    Raises:
        InputError: The file has no such function, class or method.
    """
    folder = "canhaptic" if kind == "code" else "tests"
    file, _, name = mark.partition(":")
    path = ROOT / folder / file
    scope: Any = ast.parse(path.read_text(encoding="utf-8")) if path.is_file() else None
    for part in name.split("."):
        inside = scope.body if scope is not None else []
        scope = next((entry for entry in inside if _name_of(entry) == part), None)
    if scope is None:
        raise InputError(f"{SOURCE.name}: {folder}/{file} has no {name!r}; mend the mark")
    return f"`{name}` in `{file}`" if kind == "code" else f"`{folder}/{file}`"


def _name_of(entry: ast.stmt) -> str | None:
    return entry.name if isinstance(entry, ast.FunctionDef | ast.ClassDef) else None


def _fill(mark: re.Match[str]) -> str:
    inside = " ".join(mark[1].split())
    kind, _, rest = inside.partition(":")
    return _named(kind, rest) if kind in ("code", "test") else _shown(inside)


def page() -> str:
    """Returns the text of the page."""
    blocks = _MARK.sub(_fill, SOURCE.read_text(encoding="utf-8")).strip().split("\n\n")
    return "\n\n".join(block if block.startswith(_AS_WRITTEN) else _refilled(block) for block in blocks) + "\n"


def _refilled(paragraph: str) -> str:
    return fill(paragraph, _WIDTH, break_long_words=False, break_on_hyphens=False)


if __name__ == "__main__":
    write_page(PAGE, page)
