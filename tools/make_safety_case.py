"""Writes the safety case into docs/safety.md from tools/safety_case.yaml: `python -m tools.make_safety_case`.

A row names the tests that fail when its control is taken away. One that names no test, one that is not in the test
tree, or one that is skipped or may fail is an error: what no test covers is no control.
"""

import ast
import re
from collections import Counter
from functools import cache
from pathlib import Path
from typing import Any, Final

import yaml

from canhaptic.errors import InputError
from tools import fill_numbers
from tools.page_part import with_part, write_page

ROOT: Final = Path(__file__).resolve().parent.parent
PAGE: Final = ROOT / "docs" / "safety.md"
SOURCE: Final = ROOT / "tools" / "safety_case.yaml"
_MARK: Final = re.compile(r"pytest\.mark\.(\w+)")
_MAY_NOT_PASS: Final = {"skip", "skipif", "xfail"}
_HEADINGS: Final = ("cause", "control", "tests", "last figure", "left to you")


def hazards() -> list[dict[str, Any]]:
    """Returns the hazards with their rows, as written."""
    found: list[dict[str, Any]] = yaml.safe_load(SOURCE.read_text(encoding="utf-8"))
    return found


def page() -> str:
    """Returns the text of the page with a fresh table of hazards in it.

    Raises:
        InputError: A row names no test, one that does not exist or need not pass, or a figure that was not measured.
    """
    lines = [line for each in hazards() for line in (f"### {each['hazard']}", "", *_table(each["rows"]), "")]
    filled = fill_numbers.filled("\n".join(lines), SOURCE.name)
    return with_part(PAGE, "safety case", fill_numbers.without_marks(filled) + "\n")


def _table(rows: list[dict[str, Any]]) -> list[str]:
    cells = [(row["cause"], row["control"], _tests(row), row["figure"].strip(), row["left"]) for row in rows]
    return [f"| {' | '.join(each)} |" for each in (_HEADINGS, ("---",) * len(_HEADINGS), *cells)]


def _tests(row: dict[str, Any]) -> str:
    if not row["tests"]:
        raise InputError(f"{SOURCE.name}: {row['cause']!r} names no test; write one, or take the row out")
    for name in row["tests"]:
        if found := marks_of(name) & _MAY_NOT_PASS:
            raise InputError(f"{SOURCE.name}: {name!r} is marked {', '.join(sorted(found))}; name one that must pass")
    files = Counter(name.partition("::")[0] for name in row["tests"])
    return ", ".join(f"{count} in `tests/{file}`" for file, count in files.items())


def marks_of(name: str) -> set[str]:
    """Returns the marks of a test, such as `slow`.

    Raises:
        InputError: There is no such test.
    """
    file, _, function = name.partition("::")
    functions = _functions(file)
    if function not in functions:
        raise InputError(f"{SOURCE.name}: no test {name!r} in tests/; name the one that holds this control")
    return functions[function]


@cache
def _functions(file: str) -> dict[str, set[str]]:
    """Returns the tests of a file, each with the names of its marks."""
    path = ROOT / "tests" / file
    if not path.is_file():
        raise InputError(f"{SOURCE.name}: there is no tests/{file}")
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return {
        node.name: {mark[1] for each in node.decorator_list if (mark := _MARK.match(ast.unparse(each)))}
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef)
    }


if __name__ == "__main__":
    write_page(PAGE, page)
