"""Machine code of kernels on disk, so that the next process need not compile: in the user's own cache folder.

numba keeps code too, but its key is the file of one function: a change in a function that it calls, in another file,
goes unnoticed. Here the key of a folder covers the code of every kernel reached, the constants that they name, the
versions of Python, numba, llvmlite and NumPy, and the processor. What is loaded is executed, so the folder must belong
to the user, and only the user may read it; otherwise nothing is kept.
"""
# numba states no types of its cache
# mypy: allow-untyped-calls

import hashlib
import os
import pickle
import platform
import shutil
import stat
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from multiprocessing import parent_process
from pathlib import Path
from typing import Final, Protocol, cast

import llvmlite
import numba
import numpy as np
from llvmlite import binding
from numba.core import caching

_PRIVATE: Final = 0o700
_UNUSED: Final = 30 * 86_400.0  # [s] after which code is deleted
_DIGEST: Final = hashlib.sha256().digest_size


class _Config(Protocol):
    """Settings of numba."""

    CACHE_DIR: str


class _CheckedFiles(caching.IndexDataCacheFile):
    """numba's files of one function, each with a digest at its end: one that is damaged counts as missing."""

    def _dump(self, obj: object) -> bytes:
        data: bytes = super()._dump(obj)
        return data + hashlib.sha256(data).digest()

    def _load_index(self) -> object:
        path = Path(self._index_path)
        return super()._load_index() if path.is_file() and _is_whole(path.read_bytes(), self._version) else {}

    def _load_data(self, name: str) -> object:
        if not _is_whole(Path(self._data_path(name)).read_bytes()):
            raise OSError(f"{name}: damaged")  # the caller takes it for missing
        return super()._load_data(name)


class CheckedCache(caching.FunctionCache):
    """The code of one function on disk; where it is damaged or cannot be written, the function is compiled anew."""

    def __init__(self, function: Callable[..., object]) -> None:
        super().__init__(function)
        locator = self._impl.locator
        self._cache_file = _CheckedFiles(locator.get_cache_path(), self._impl.filename_base, locator.get_source_stamp())

    def save_overload(self, sig: object, data: object) -> None:
        """Store the code; a full disk does not prevent a run."""
        with suppress(OSError):
            super().save_overload(sig, data)


def _is_whole(content: bytes, version: str = "") -> bool:
    """Return whether the digest at the end is that of the rest, without the version in front of an index."""
    start = len(pickle.dumps(version, protocol=-1)) if version else 0
    return content[-_DIGEST:] == hashlib.sha256(content[start:-_DIGEST]).digest()


@contextmanager
def kept_code(sources: Iterable[str]) -> Iterator[bool]:
    """Within the context, numba stores code in a folder of these sources; yields whether it can.

    Args:
        sources: Everything that decides the machine code.
    """
    place = _place_of(sources)
    if place is None:
        _say_that_nothing_is_kept()
        yield False
        return
    config = cast(_Config, numba.config)
    before, config.CACHE_DIR = config.CACHE_DIR, str(place)
    try:
        yield True
    finally:
        config.CACHE_DIR = before


def _place_of(sources: Iterable[str]) -> Path | None:
    """Return the folder for the code of these sources, marked as used now; None where none can be written."""
    folder = cache_folder()
    if folder is None:
        return None
    place = folder / code_key(sources)
    try:
        place.mkdir(mode=_PRIVATE, exist_ok=True)
        with tempfile.TemporaryFile(dir=place):  # numba would keep the code elsewhere, by a key of its own
            os.utime(place)
    except OSError:
        return None
    _delete_unused(folder)
    return place


@cache
def _delete_unused(folder: Path) -> None:
    """Delete what no process has used for 30 days, once in a process.

    A folder is renamed first, so that no process finds half of it. Code that a process misses because of that is
    compiled again.
    """
    with os.scandir(folder) as entries:
        used = {entry.path: entry.stat().st_mtime for entry in entries if entry.is_dir(follow_symlinks=False)}
    for path, last in used.items():
        if last < max(used.values()) - _UNUSED:  # the newest is the one that this process uses now
            with suppress(OSError):  # another process was quicker
                away = Path(path).rename(f"{path}.{os.getpid()}")
                shutil.rmtree(away, ignore_errors=True)


@cache
def _say_that_nothing_is_kept() -> None:
    """Warn once, in the process that the user started."""
    if parent_process() is None:
        text = (
            "compiled code is not kept, and each run compiles for 1 to 10 s: the folder canhaptic/kernels in "
            "XDG_CACHE_HOME, or in ~/.cache, cannot be written, or others can read it; make it yours alone (chmod 700)"
        )
        warnings.warn(text, RuntimeWarning, stacklevel=2)


def cache_folder() -> Path | None:
    """Folder of compiled kernels, created if need be; None where it is not the user's alone."""
    root = os.environ.get("XDG_CACHE_HOME", "")
    try:
        base = Path(root) if Path(root).is_absolute() else Path.home() / ".cache"
        folder = base / "canhaptic" / "kernels"
        folder.mkdir(mode=_PRIVATE, parents=True, exist_ok=True)
        status = folder.lstat()
    except (OSError, RuntimeError):
        return None
    is_own = not hasattr(os, "getuid") or status.st_uid == os.getuid()
    is_private = os.name != "posix" or not stat.S_IMODE(status.st_mode) & 0o077
    return folder if stat.S_ISDIR(status.st_mode) and is_own and is_private else None


def code_key(sources: Iterable[str]) -> str:
    """Return the name of the folder for code made of these sources, here."""
    digest = hashlib.sha256()
    features = sorted(name for name, there in binding.get_host_cpu_features().items() if there)
    where = (sys.version, platform.machine(), binding.get_host_cpu_name(), features)
    versions = (numba.__version__, llvmlite.__version__, np.__version__)
    for part in (repr(where), repr(versions), *sources):
        digest.update(hashlib.sha256(part.encode()).digest())
    return digest.hexdigest()[:32]
