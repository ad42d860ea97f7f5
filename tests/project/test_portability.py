"""The package without the calls of POSIX that Windows or macOS lack, which are taken away from an interpreter here."""

import os
import subprocess
import sys

import pytest

from canhaptic.errors import LogWriteError
from canhaptic.logs import ring, writer_process

_WITHOUT_POSIX = """
import importlib, os, pkgutil, sys

class Absent:
    def find_spec(self, name, path=None, target=None):
        if name in ("fcntl", "resource", "termios", "pwd", "grp"):
            raise ModuleNotFoundError(name)

sys.meta_path.insert(0, Absent())
for name in ("posix_fallocate", "O_NOFOLLOW", "O_NONBLOCK", "O_CLOEXEC", "sched_setscheduler", "sched_getaffinity",
             "sched_setaffinity", "SCHED_FIFO", "getuid", "geteuid", "nice", "fork"):
    delattr(os, name)

import canhaptic

for module in pkgutil.walk_packages(canhaptic.__path__, "canhaptic."):
    if module.name.endswith("__main__"):
        continue
    try:
        importlib.import_module(module.name)
    except ModuleNotFoundError as error:  # of an extra that is not installed here
        if error.name.split(".")[0] not in ("bokeh", "tornado", "matplotlib", "numba", "dask", "distributed", "scipy"):
            raise
from canhaptic.cli.check import host_settings

host_settings()
print(canhaptic.simulate("configs/demo.yaml", duration=0.3).account.passive)
"""


@pytest.mark.slow
def test_every_module_imports_and_a_scene_runs_without_posix() -> None:
    """What a virtual bus needs is there on every system."""
    done = subprocess.run([sys.executable, "-c", _WITHOUT_POSIX], capture_output=True, text=True, timeout=100)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "yes"


def test_a_log_is_refused_in_words_where_there_is_no_shared_memory(monkeypatch, tmp_path) -> None:
    """Before the rig is enabled, and before a file is made."""
    monkeypatch.setattr(os, "name", "nt")
    with pytest.raises(LogWriteError, match=r"demo\.h5.*needs Linux or macOS; run without logs"):
        writer_process.WriterProcess({"path": f"{tmp_path}/demo.h5"}, [])
    monkeypatch.undo()
    assert not list(tmp_path.iterdir())


def test_the_memory_of_a_log_is_there_without_posix_fallocate(monkeypatch: pytest.MonkeyPatch) -> None:
    """As on macOS; a page that is not written would be made in the cycle."""
    monkeypatch.delattr(os, "posix_fallocate")
    size = 3_000_001
    descriptor = ring.allocate(size)
    try:
        status = os.fstat(descriptor)
        assert status.st_size == size
        assert status.st_blocks * 512 >= size
    finally:
        os.close(descriptor)
