from pathlib import Path

import pytest

from tools.count_structure import count, main

FILES = {
    "canhaptic/__init__.py": '"""Doc."""\n',
    "canhaptic/first.py": '''"""Two lines
of text."""

from typing import Any

from canhaptic.room import second  # a comment

LIMIT = 1
_hidden = 2


class Wall:
    """A class."""

    stiffness: Any = {"stiffness": Any}


def _helper() -> None:
    pass


def public() -> None:
    """A function."""

    def inner() -> None: ...

    text = """not a
    docstring"""
''',
    "canhaptic/room/__init__.py": "",
    "canhaptic/room/second.py": "import typing\n\nif typing.TYPE_CHECKING:\n    from canhaptic import first\n",
    "canhaptic/room/_third.py": "class Wall: ...\n\n\nA, B = 1, 2\nC: int = 3\n",
    "canhaptic/other/__init__.py": "",
    "canhaptic/other/_third.py": "def late():\n    import canhaptic.room.second\n    return {'stiffness': 1}\n",
    "configs/a.yaml": "wall: {stiffness: 1 N/m}\naxes:\n  - {stiffness: 2}\n",
}


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    for name, text in FILES.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return tmp_path


def test_lines_names_and_doubles_of_a_small_tree_are_counted_by_their_definitions(tree: Path) -> None:
    counts = count(tree)
    assert counts["files"] == 7
    assert counts["code"] == 12 + 3 + 3 + 3
    assert counts["names"] == 4
    assert counts["names_by_room"] == {"canhaptic": 2, "room": 1, "other": 1}
    assert counts["constants"] == 4
    assert counts["class_names_twice"] == ["Wall"]
    assert counts["file_names_twice"] == ["_third.py"]
    assert counts["any_per_1000"]["canhaptic"] == round(2000 / 12, 1)
    assert counts["key_places"] == {"stiffness": 2, "axes": 0, "wall": 0}


def test_files_and_functions_that_are_too_long_are_named(tree: Path) -> None:
    body = "    pass\n" * 39
    for name, lines in (("fits", 400), ("long", 401)):
        functions = f'def at_most():\n    """A\n    b."""\n{body}\n\ndef beyond():\n{body}    pass\n'
        rest = "# a comment\n" * (lines - functions.count("\n"))
        (tree / "canhaptic" / f"{name}.py").write_text(functions + rest, encoding="utf-8")
    counts = count(tree)
    assert counts["long_files"] == ["canhaptic.long"]
    assert counts["long_functions"] == ["canhaptic.fits.beyond", "canhaptic.long.beyond"]


def test_circles_are_found_between_modules_and_between_siblings(tree: Path) -> None:
    counts = count(tree)
    assert counts["module_circles"] == [["canhaptic.first", "canhaptic.room.second"]]
    assert counts["sibling_circles"] == [["canhaptic.first", "canhaptic.room"]]


def test_the_table_has_a_column_for_each_tree(tree: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(tree), str(tree)]) == 0
    assert "| files | 7 |" in capsys.readouterr().out
