"""Writes docs/safety_case.md from tools/safety_case.yaml: `python -m tools.make_safety_case`.

A row names the tests that fail when its control is taken away. One that names no test, one that is not in the test
tree, or one that is skipped or may fail is an error: what no test covers is no control.
"""

import ast
import re
import sys
from functools import cache
from pathlib import Path
from typing import Any, Final

import yaml

from canhaptic.errors import InputError
from tools import fill_numbers

ROOT: Final = Path(__file__).resolve().parent.parent
PAGE: Final = ROOT / "docs" / "safety_case.md"
SOURCE: Final = ROOT / "tools" / "safety_case.yaml"
_INTRODUCTION: Final = """\
# Safety case

Each hazard of a haptic rig that software can cause or prevent, what this package does about it, the tests that fail
when the control is taken away, and the last measured figure. [Safety](safety.md) says what the builder of a rig must
provide; this page is evidence for a risk assessment and does not replace it. Tests with (slow) run in `make test-all`,
all others in `make test`. The page is made from `tools/safety_case.yaml` by `python -m tools.make_safety_case`.
"""
_MARK: Final = re.compile(r"pytest\.mark\.(\w+)")
_MAY_NOT_PASS: Final = {"skip", "skipif", "xfail"}
_HEADINGS: Final = ("cause", "control", "tests", "last figure", "left to you")


def hazards() -> list[dict[str, Any]]:
    """Returns the hazards with their rows, as written."""
    found: list[dict[str, Any]] = yaml.safe_load(SOURCE.read_text(encoding="utf-8"))
    return found


def page() -> str:
    """Returns the text of the page.

    Raises:
        InputError: A row names no test, one that does not exist or need not pass, or a figure that was not measured.
    """
    lines = [_INTRODUCTION]
    for hazard in hazards():
        lines += [f"## {hazard['hazard']}", "", *_table(hazard["rows"]), ""]
    return fill_numbers.filled("\n".join(lines), PAGE.name)


def _table(rows: list[dict[str, Any]]) -> list[str]:
    cells = [(row["cause"], row["control"], _tests(row), row["figure"].strip(), row["left"]) for row in rows]
    return [f"| {' | '.join(each)} |" for each in (_HEADINGS, ("---",) * len(_HEADINGS), *cells)]


def _tests(row: dict[str, Any]) -> str:
    if not row["tests"]:
        raise InputError(f"{SOURCE.name}: {row['cause']!r} names no test; write one, or take the row out")
    return "<br>".join(_test(name) for name in row["tests"])


def _test(name: str) -> str:
    file, _, function = name.partition("::")
    functions = _functions(file)
    if function not in functions:
        raise InputError(f"{SOURCE.name}: no test {name!r} in tests/; name the one that holds this control")
    if found := functions[function] & _MAY_NOT_PASS:
        raise InputError(f"{SOURCE.name}: {name!r} is marked {', '.join(sorted(found))}; name one that must pass")
    slow = " (slow)" if "slow" in functions[function] else ""
    return f"{function.removeprefix('test_').replace('_', ' ')}{slow} (`tests/{file}`)"


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


def main() -> int:
    """Writes the page; returns 0."""
    PAGE.write_text(page(), encoding="utf-8")
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except InputError as problem:
        sys.exit(str(problem))
