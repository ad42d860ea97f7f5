"""Refreshes the measured numbers in README, CONTRIBUTING, docs and the effects: `python -m tools.fill_numbers`.

A number that was measured is never typed. In Markdown it is between two HTML comments, which no reader sees; the
first says where in docs/results it comes from and, behind ` @ `, how it is written:

    <!--n cycle#one axis, full stack, best of 7#value @ .0f-->16628<!--/n--> cycles a second
    <!--n cycle#full stack / canopen#ratio-->2.09<!--/n--> times `canopen`
    <!--n pace#cycle at 1 kHz, p99~canopen#peer_value @ .0f-->255<!--/n--> us
    <!--n hour#*html#value @ .1f-->3.9<!--/n--> s
    <!--n soak#over-believed energy, largest#value @ J-->2.02 uJ<!--/n-->

The place is RESULT#PART#PART: a file of docs/results without its `.json`, then keys, or the name of one of the `rows`
of a benchmark (`*` matches any text; `ROW~PEER` where several rows have the name and differ in their peer).

Behind ` @ `: a Python format (`.0f`, `,.0f`, `.2e`, `d`), `%` of a part, or a unit (`J`, `m`, `s`) that takes prefixes.
Without it, three significant digits. A text of the result is written as it is.

`python -m tools.fill_numbers --check` writes nothing and ends with status 1 where a page is not current; a place that
does not exist is an error. Marks in code blocks and code spans are left alone. A mark holds no `--` (use `*`), and
in a table no `|`.
"""

import json
import re
import sys
from collections.abc import Iterator
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path
from typing import Any, Final

from canhaptic.axis_units import si
from canhaptic.errors import InputError

ROOT: Final = Path(__file__).resolve().parents[1]
_MARK: Final = re.compile(
    r"^(?P<fence>```|~~~).*?^(?P=fence)|`[^`\n]+`|<!--n (?P<mark>[^\n]+?)-->(?P<shown>.*?)<!--/n-->",
    re.MULTILINE | re.DOTALL,
)
_OPENING: Final = "<!--n "
_FORMAT: Final = re.compile(r"[+#]?,?(?:\.\d+[efg]|d)")
_DIGITS: Final = 3
_ROUNDING: Final = 1e-15  # [J]


def pages() -> list[Path]:
    """Returns README, CONTRIBUTING, every page of the documentation, and the one next to the effects."""
    effects = ROOT / "canhaptic" / "sim" / "plant" / "effects" / "README.md"
    return [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md")), effects]


@cache
def _result(name: str) -> Any:
    path = ROOT / "docs" / "results" / f"{name}.json"
    if not path.is_file():
        raise InputError(f"no result {path.name}, expected one of docs/results; make it or mend the mark")
    return json.loads(path.read_text(encoding="utf-8"))


def value_at(place: str) -> float | str:
    """Returns a number or text of docs/results.

    Args:
        place: `RESULT#PART#PART`.

    Raises:
        InputError: There is none, or the rows of that name differ in it.
    """
    name, *parts = place.split("#")
    found = [_result(name)]
    for part in parts:
        found = [each for node in found for each in _inside(node, part)]
        if not found:
            raise InputError(f"{place}: nothing is called {part!r} there; mend the mark")
    value = found[0]
    if any(each != value for each in found):
        raise InputError(f"{place}: {len(found)} rows have this name and differ in it; name the peer too: ROW~PEER")
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise InputError(f"{place}: got {str(value)[:40]!r}, expected a number or a text; mend the mark")
    return value


def _inside(node: Any, part: str) -> Iterator[Any]:
    """Yields what a part of a place names: a key, rows of a benchmark, or faults of a list."""
    if isinstance(node, dict) and part in node:
        yield node[part]
        return
    for row in node.get("rows", ()) if isinstance(node, dict) else node if isinstance(node, list) else ():
        if row_is_named(row, part):
            yield row


def row_is_named(row: dict[str, Any], name: str) -> bool:
    """Returns whether a row of a result has a name: ROW, or ROW~PEER, with `*` for any text."""
    row_name, _, peer = name.partition("~")
    return _named(row.get("row", row.get("fault")), row_name) and (not peer or _named(row.get("peer"), peer))


def _named(name: Any, pattern: str) -> bool:
    return isinstance(name, str) and (name == pattern or fnmatchcase(name, pattern.replace("[", "[[]")))


def written(mark: str) -> str:
    """Returns what the page holds for a mark.

    Args:
        mark: `RESULT#PART#PART` or `RESULT#PART#PART @ FORMAT`.

    Raises:
        InputError: It points at nothing.
    """
    place, _, style = mark.strip().partition(" @ ")
    value = value_at(place)
    if isinstance(value, str):
        return value
    if _FORMAT.fullmatch(style):
        return format(int(value) if style.endswith("d") else value, style)
    if style == "%":
        return f"{100.0 * value:.{_DIGITS}g} %"
    if style == "J" and abs(value) < _ROUNDING:
        return "0 J"
    return si(value, style, _DIGITS) if style else _plain(value)


def _plain(value: float) -> str:
    """Returns three significant digits, without an exponent where it reads well without."""
    if isinstance(value, int):
        return str(value)
    rounded = float(f"{value:.{_DIGITS}g}")
    return f"{rounded:.0f}" if 10.0**_DIGITS <= abs(rounded) < 1e6 else f"{value:.{_DIGITS}g}"


def filled(text: str, name: str) -> str:
    """Returns the text of a page with the numbers of today between its marks.

    Args:
        text: The page.
        name: Of the page, for errors.

    Raises:
        InputError: A mark points at nothing, or is not closed.
    """
    result, end = [], 0
    for found in _MARK.finditer(text):
        _refuse_open(text[end : found.start()], f"{name}:{text.count(chr(10), 0, end) + 1}")
        result.append(text[end : found.start()])
        end = found.end()
        mark = found["mark"]
        if mark is None:
            result.append(found[0])
            continue
        where = f"{name}:{text.count(chr(10), 0, found.start()) + 1}"
        if "--" in mark or _OPENING in found["shown"]:
            raise InputError(f"{where}: a mark that is not closed by <!--/n-->, or has -- in it; write * for that")
        try:
            result.append(f"{_OPENING}{mark}-->{written(mark)}<!--/n-->")
        except InputError as error:
            raise InputError(f"{where}: {error}") from error
    _refuse_open(text[end:], name)
    return "".join([*result, text[end:]])


def without_marks(text: str) -> str:
    """Returns a filled text with the numbers alone, for a part of a page that is made as a whole."""
    return re.sub(r"<!--.*?-->", "", text)


def _refuse_open(between: str, where: str) -> None:
    if _OPENING in between or "<!--/n-->" in between:
        raise InputError(f"{where}: behind this line is half a mark; write <!--n PLACE-->number<!--/n-->")


def main(arguments: list[str]) -> int:
    """Writes the pages, or with `--check` names those that are not current; returns the exit status."""
    stale = []
    for page in pages():
        name, text = page.relative_to(ROOT).as_posix(), page.read_text(encoding="utf-8")
        current = filled(text, name)
        if current != text:
            stale.append(name)
            if "--check" not in arguments:
                page.write_text(current, encoding="utf-8")
    sys.stdout.write("".join(f"{name}\n" for name in stale))
    return 1 if stale and "--check" in arguments else 0


if __name__ == "__main__":
    try:
        sys.exit(main(sys.argv[1:]))
    except InputError as problem:
        sys.exit(str(problem))
