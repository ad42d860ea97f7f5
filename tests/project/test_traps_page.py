"""The page of traps names tests, and they exist."""

import ast
import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
ROWS = re.findall(r"^\| (\d+) \| .* \| (.*) \|$", (ROOT / "docs" / "how_it_works.md").read_text(), flags=re.MULTILINE)


@cache
def functions_of(path: str) -> set[str]:
    """Returns the names of the test functions of a file."""
    tree = ast.parse((ROOT / path).read_text())
    return {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)}


def test_every_trap_has_a_row() -> None:
    assert [int(number) for number, _ in ROWS] == list(range(1, 15))


@pytest.mark.parametrize(("number", "cell"), ROWS)
def test_the_functions_of_a_trap_exist(number: str, cell: str) -> None:
    names = re.findall(r"`([^`]+)::([^`]+)`", cell)
    assert names, f"trap {number} names no test"
    for path, name in names:
        assert name in functions_of(path), f"trap {number}: {path} has no {name}"
