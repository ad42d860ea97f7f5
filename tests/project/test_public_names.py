import re
import subprocess
import sys
from pathlib import Path

import pytest

import canhaptic
from canhaptic import extending, passivity


def test_every_public_name_can_be_imported_and_there_are_at_most_81() -> None:
    assert len({*canhaptic.__all__, *extending.__all__, *passivity.__all__}) <= 81
    for name in canhaptic.__all__:
        assert getattr(canhaptic, name).__name__ == name
    for module in (extending, passivity):
        for name in module.__all__:
            assert hasattr(module, name)
            assert name in dir(module)


def test_every_public_name_is_shown_on_a_page_or_in_an_example_and_not_only_listed() -> None:
    root = Path(__file__).resolve().parents[2]
    pages = [path for path in (root / "docs").rglob("*.md") if path.name != "api.md"]
    text = " ".join(path.read_text(encoding="utf-8") for path in (*pages, *(root / "examples").glob("*.py")))
    assert [name for name in canhaptic.__all__ if not re.search(rf"\b{name}\b", text)] == []


def test_dir_lists_the_public_names_and_the_three_modules_that_hold_more() -> None:
    assert dir(canhaptic) == sorted([*canhaptic.__all__, "errors", "extending", "passivity"])
    assert canhaptic.extending is extending
    assert set(canhaptic.__all__) & set(extending.__all__) == {"Environment"}  # where it was, for one release


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'rig'"):
        canhaptic.rig  # type: ignore[attr-defined]  # noqa: B018


def test_importing_the_package_imports_nothing_else() -> None:
    code = (
        "import sys, canhaptic; print([m for m in sys.modules if m.startswith('canhaptic.') or m in {'can', 'numpy'}])"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"


@pytest.mark.slow
def test_a_loop_of_its_own_loads_neither_numpy_nor_a_bus_nor_a_file_format() -> None:
    code = (
        "import sys, examples.own_loop; "
        "print(sorted({'can', 'canopen', 'h5py', 'numpy', 'rich', 'yaml'} & set(sys.modules)))"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"
