import re
from collections import Counter
from pathlib import Path
from typing import Final

import pytest

from tools.count_structure import count, crossing_names, files_by_folder, long_functions, modules_of

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


def test_lines_of_a_small_tree_are_counted_by_their_definition(tree: Path) -> None:
    counts = count(tree)
    assert counts["files"] == 7
    assert counts["code"] == 12 + 3 + 3 + 3


def test_the_laboratory_is_counted_apart_and_a_name_crosses_a_room_once(tree: Path) -> None:
    argument = "Args:\n        wall: Of the room.\n        other: That is not.\n        size: Offset of it.\n    "
    (tree / "canhaptic/lab").mkdir()
    (tree / "canhaptic/lab/__init__.py").write_text("")
    (tree / "canhaptic/lab/study.py").write_text(
        f'from canhaptic.first import LIMIT, Wall\n\n\ndef study(wall):\n    """Two.\n\n    {argument}"""\n    pass\n'
    )
    (tree / "canhaptic/room/fourth.py").write_text(
        "from canhaptic.first import Wall\nfrom canhaptic.room import _third\n"
    )
    (tree / "canhaptic/room/fifth.py").write_text("from canhaptic.room._third import Wall\n")  # stays in its room
    counts = count(tree)
    assert counts["code_lab"] == 3
    assert counts["crossing"] == ["canhaptic.first.Wall"]  # a constant and a module do not count
    assert counts["vague_arguments"] == 2


def test_functions_that_are_too_long_are_named_and_a_docstring_does_not_count(tree: Path) -> None:
    body = "    pass\n" * 39
    functions = f'def at_most():\n    """A\n    b."""\n{body}\n\ndef beyond():\n{body}    pass\n'
    (tree / "canhaptic/long.py").write_text(functions, encoding="utf-8")
    assert count(tree)["long_functions"] == ["canhaptic.long.beyond"]


def test_files_are_counted_by_folder_without_those_that_make_a_package(tree: Path) -> None:
    assert count(tree)["folders"] == {".": 1, "other": 1, "room": 2}


ROOT: Final = Path(__file__).resolve().parents[2]
_MOST_ANY: Final = 15.0  # per 1,000 lines of code
_MOST_CROSSING: Final = 690
"""What there were on 29 November 2026: 686. It was 600 before EtherCAT lines, couplings to programs, and causes of a
tremor came, each in rooms of its own (EtherCAT in four); no door exports a name again.
"""


def any_by_room(top: Path) -> dict[str, float]:
    """Returns the uses of `Any` in 1,000 lines of code of each room; the files are not parsed."""
    uses, sizes = Counter[str](), Counter[str]()
    for path in top.rglob("*.py"):
        place = path.relative_to(top).parts
        room, in_docstring = place[0] if len(place) > 1 else top.name, False
        for line in path.read_text(encoding="utf-8").splitlines():
            text = line.strip()
            if in_docstring or text.startswith('"""'):
                in_docstring = in_docstring != (text.count('"""') == 1)
            elif text and not text.startswith("#"):
                sizes[room] += 1
                if "Any" in text and not text.startswith("from typing"):
                    uses[room] += len(re.findall(r"\bAny\b", text.partition("  #")[0]))
    return {room: 1000.0 * uses[room] / size for room, size in sizes.items()}


def test_no_room_leaves_the_types_of_more_than_15_names_in_1000_lines_open() -> None:
    found = any_by_room(ROOT / "canhaptic")
    assert {"control", "drive", "sim", "lab"} < set(found)
    assert {room: share for room, share in found.items() if share > _MOST_ANY} == {}


@pytest.mark.slow
def test_no_more_than_690_names_cross_a_room() -> None:
    assert 400 < len(crossing_names(list(modules_of(ROOT)))) <= _MOST_CROSSING


def test_uses_of_any_are_counted_and_texts_comments_and_imports_are_not(tree: Path) -> None:
    (tree / "canhaptic/room/fourth.py").write_text('"""Any."""\nfrom typing import Any\n\nx: Any = 1  # Any\n')
    assert any_by_room(tree / "canhaptic")["room"] == pytest.approx(1000.0 / 8)


_KERNELS: Final = {f"canhaptic.control.passivity.guarded.{name}" for name in ("render", "step")}
"""Compiled kernels of 44 lines each, whose parts would be further calls in every cycle."""


@pytest.mark.slow
def test_no_function_has_more_than_40_lines_without_its_docstring() -> None:
    assert set(long_functions(modules_of(ROOT))) == _KERNELS


_MOST_FILES: Final = 15  # of a folder, without its `__init__.py`
_MORE: Final = {
    "cli": 23,  # a subcommand is a file
    "sim/plant/effects": 19,  # an effect is a file
    "logs": 17,
    "sim/plant": 17,
    ".": 19,  # the route, the doors, and what several rooms share
    "scene": 27,  # what a plain run does not need is apart
}


def test_a_folder_has_about_15_files() -> None:
    found = files_by_folder(ROOT / "canhaptic")
    assert {folder: number for folder, number in found.items() if number > _MORE.get(folder, _MOST_FILES)} == {}
