"""The questions of CONTRIBUTING are answered by files that exist and define what they are said to define."""

import ast
import re

import pytest

from tests.docs.documents import ROOT

_ROW = re.compile(r"^\| (.+\?) \| `(canhaptic/[\w/]+\.py)` \| (`\w+`(?:, `\w+`)*) \|$", re.MULTILINE)
ROWS = _ROW.findall((ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8"))


def test_there_are_twenty_questions() -> None:
    assert len({question for question, _, _ in ROWS}) == 20


@pytest.mark.parametrize(("file", "names"), [row[1:] for row in ROWS], ids=[row[1] for row in ROWS])
def test_the_file_of_an_answer_defines_what_it_is_said_to_define(file: str, names: str) -> None:
    tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
    defined = {node.name for node in tree.body if isinstance(node, (ast.ClassDef, ast.FunctionDef))}
    assert set(re.findall(r"`(\w+)`", names)) <= defined
