"""Compiled code is kept for the next process, in a folder of the user's alone, and never taken for a changed kernel."""

import importlib
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("numba")

from canhaptic.kernels import compiler
from canhaptic.kernels.compiler import cache_folder, code_key, compiled, kept_code

ROOT = Path(__file__).resolve().parents[2]
INNER = "def inner(x):\n    return x * {factor}\n"
OUTER = """from inner_kernel import inner


def outer(values):
    for i in range(len(values)):
        values[i] = inner(values[i])
"""
CALL = """
import numpy as np
from outer_kernel import outer
from canhaptic.kernels.compiler import compiled

run = compiled(outer, keep=True)
values = np.array([1.0, 2.0])
run(values)
print(values.tolist(), sum(run.stats.cache_hits.values()))
"""


def output_of(script: str, folder: Path, cache: str) -> str:
    """Returns what a script of a folder prints in a process of its own; machine code is kept in the folder `cache`."""
    path = folder / "script.py"
    path.write_text(script)
    environment = {**os.environ, "PYTHONPATH": f"{ROOT}{os.pathsep}{folder}", "XDG_CACHE_HOME": str(folder / cache)}
    environment["PYTHONDONTWRITEBYTECODE"] = "1"  # Python itself sees no edit of the same second and size
    found = subprocess.run([sys.executable, str(path)], env=environment, capture_output=True, text=True, check=False)
    assert found.returncode == 0, found.stderr
    return found.stdout.strip()


def called(folder: Path, factor: float) -> str:
    """Returns what a process prints that compiles two kernels of two files, or loads them."""
    (folder / "inner_kernel.py").write_text(INNER.format(factor=factor))
    (folder / "outer_kernel.py").write_text(OUTER)
    return output_of(CALL, folder, "cache")


@pytest.mark.slow
def test_the_next_process_loads_the_code_and_an_edit_of_a_called_kernel_is_seen(tmp_path: Path) -> None:
    assert called(tmp_path, 3.0) == "[3.0, 6.0] 0"
    assert called(tmp_path, 3.0) == "[3.0, 6.0] 1"
    assert called(tmp_path, 5.0) == "[5.0, 10.0] 0"  # numba's own key knows the file of the outer one alone


def hits() -> int:
    """Returns how many kernels were loaded when this process, in which nothing of them is left, calls them anew."""
    for name in ("inner_kernel", "outer_kernel"):
        sys.modules.pop(name, None)
    values = np.array([1.0, 2.0])
    run = compiled(importlib.import_module("outer_kernel").outer, keep=True)
    run(values)
    assert values.tolist() == [3.0, 6.0]
    return sum(run.stats.cache_hits.values())


@pytest.fixture
def kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with two kernels whose code is kept below `cache`."""
    (tmp_path / "inner_kernel.py").write_text(INNER.format(factor=3.0))
    (tmp_path / "outer_kernel.py").write_text(OUTER)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.syspath_prepend(tmp_path)
    assert hits() == 0
    return tmp_path


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".nbi", ".nbc"], ids=["index", "code"])
@pytest.mark.parametrize("cut", [None, 0, 40], ids=["a bit", "to nothing", "in the middle"])
def test_damaged_code_is_compiled_anew_and_kept_again(kept: Path, suffix: str, cut: int | None) -> None:
    (file,) = (kept / "cache").rglob(f"*{suffix}")
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    file.write_bytes(content if cut is None else content[:cut])
    assert hits() == 0
    assert hits() == 1


def test_the_folder_is_the_users_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    folder = cache_folder()
    assert folder is not None
    assert folder.stat().st_mode & 0o777 == 0o700
    folder.chmod(0o755)  # others could put code there, or read what is run
    assert cache_folder() is None
    folder.rmdir()
    folder.symlink_to(tmp_path)
    assert cache_folder() is None


def test_without_a_place_nothing_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(blocked))
    assert cache_folder() is None


def test_every_source_counts_in_the_key() -> None:
    assert len({code_key(sources) for sources in (["a", "b"], ["b", "a"], ["ab"], ["a"], [])}) == 5


SYMBOLS = """
import re
import numpy as np
from canhaptic.kernels.compiler import compiled

def inner(record, factor):
    return factor * record.first

def outer(records, factor):
    return inner(records[0], factor)

run = compiled(outer, keep=True)
records = np.zeros(1, np.dtype([("first", float), ("rest", float, (2,))]))
run(records, 10.0)
(code,) = run.inspect_llvm().values()
print(*re.findall(r'define [^@]*@"?(_ZN[^" (]*outer[^" (]*)', code))
"""


@pytest.mark.slow
def test_no_name_of_machine_code_is_that_of_another_process(tmp_path: Path) -> None:
    """numba names a record type by a number that counts from 0 in each process; code of both may be loaded together."""
    found = [set(output_of(SYMBOLS, tmp_path, name).split()) for name in ("one", "other")]
    assert found[0]
    assert found[0].isdisjoint(found[1])


@pytest.fixture
def first_time() -> Iterator[None]:
    """A process that has neither said that nothing is kept nor deleted what is old."""
    for once in (compiler._say_that_nothing_is_kept, compiler._delete_unused):
        once.cache_clear()
    yield
    compiler._say_that_nothing_is_kept.cache_clear()


def test_where_no_folder_can_be_made_the_code_is_not_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, first_time: None
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    folder = cache_folder()
    assert folder is not None
    (folder / code_key(["source"])).touch()  # a file where the folder would be
    with pytest.warns(RuntimeWarning, match="compiled code is not kept"), kept_code(["source"]) as is_kept:
        assert not is_kept
    with kept_code(["source"]) as is_kept:  # said once: a warning is an error here
        assert not is_kept
    with kept_code(["another"]) as is_kept:
        assert is_kept


def test_a_folder_that_cannot_be_written_is_no_error_and_numba_finds_no_other(first_time: None) -> None:
    """numba would take the folder of the source file, under a key that misses kernels of other files."""
    home = Path(tempfile.mkdtemp())
    home.chmod(0o755)
    child = os.fork()
    if not child:  # as a user who may not write: the administrator may write anywhere
        status = 1
        with suppress(BaseException):
            os.environ["XDG_CACHE_HOME"] = str(home / "cache")
            home.chmod(0o777)
            if os.getuid() == 0:
                os.setuid(65_534)
            with kept_code(["source"]) as is_kept:
                status = 0 if is_kept else 2
            folder = cache_folder()
            assert folder is not None
            (folder / code_key(["source"])).chmod(0o500)
            with pytest.warns(RuntimeWarning, match="chmod 700"), kept_code(["source"]) as is_kept:
                status += 4 if is_kept else 0
            (folder / code_key(["source"])).chmod(0o700)
            status += 8 * bool(importlib.import_module("numba").config.CACHE_DIR)
            os._exit(status)
        os._exit(16)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    shutil.rmtree(home)


def test_what_was_not_used_for_30_days_is_deleted_once_in_a_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, first_time: None
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    folder = cache_folder()
    assert folder is not None
    now = tmp_path.stat().st_mtime
    days = {"old": 31, "young": 29, "left.by.a.process.that.was.killed": 400, "source": 31}
    names = {name: code_key([name]) if name == "source" else name for name in days}
    for name, age in days.items():
        place = folder / names[name]
        place.mkdir()
        (place / "code.nbc").write_text(name)
        os.utime(place, (now - age * 86_400.0,) * 2)
    with kept_code(["source"]):
        left = {path.name for path in folder.iterdir()}
    assert left == {"young", names["source"]}
    assert (folder / names["source"] / "code.nbc").read_text() == "source"
    os.utime(folder / "young", (0.0, 0.0))
    with kept_code(["source"]):
        assert (folder / "young").exists()


UNITS = """
import numpy as np
from inner_kernel import inner
from canhaptic.kernels import compiler
from canhaptic.kernels.compiler import compiled

def other(values):
    for i in range(len(values)):
        values[i] = inner(values[i]) + 1.0

kept = []
before = compiler._Compiling.keep
compiler._Compiling.keep = lambda self, made, function: (before(self, made, function), kept.append(made))[0]
run = compiled(other, keep=True, units=(inner,))
values = np.array([1.0, 2.0])
run(values)
print(values.tolist(), [sum(made.stats.cache_hits.values()) for made in kept])
"""


@pytest.mark.slow
def test_another_kernel_loads_a_unit_that_is_kept_and_sees_that_it_changed(tmp_path: Path) -> None:
    def ran(factor: float, added: float) -> str:
        (tmp_path / "inner_kernel.py").write_text(INNER.format(factor=factor))
        return output_of(UNITS.replace("+ 1.0", f"+ {added}"), tmp_path, "cache")

    assert ran(3.0, 1.0) == "[4.0, 7.0] [0, 0]"
    assert ran(3.0, 1.0) == "[4.0, 7.0] [0, 1]"  # the whole is loaded, and its unit is not needed
    assert ran(3.0, 2.0) == "[5.0, 8.0] [1, 0]"  # the unit is linked into another
    assert ran(5.0, 2.0) == "[7.0, 12.0] [0, 0]"
