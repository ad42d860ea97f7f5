"""Compile kernels with numba and keep their machine code on disk; needs the extra `fast`.

**Compilation.** A kernel is compiled with every kernel that it reaches. The source is that of the Python functions;
only their global names are bound to compiled functions. No floating-point operation is reordered or fused, and a
division by zero gives an infinity, so that both forms give the same bits. Arrays are not reference-counted, because no
kernel makes one; that makes the code ten times faster.

**Code on disk.** Machine code is kept in the user's own cache folder, so that the next process need not compile. The
key of numba's own cache is the file of one function: a change in a function that it calls, in another file, goes
unnoticed. Here the key of a folder covers the code of every kernel reached, the constants that they name, the versions
of Python, numba, llvmlite and NumPy, and the processor. Loaded code is executed, so the folder must belong to the user,
and only the user may read it; otherwise nothing is kept.
"""

import hashlib
import os
import pickle
import platform
import shutil
import stat
import sys
import tempfile
import warnings
from collections import namedtuple
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import cache
from multiprocessing import parent_process
from pathlib import Path
from secrets import token_hex
from types import CodeType, FunctionType
from typing import Any, Final, TypeVar, cast

import llvmlite
import numba
import numpy as np
from llvmlite import binding
from numba import types
from numba.core import caching
from numba.extending import overload_method
from numba.np.unsafe.ndarray import to_fixed_tuple

from canhaptic.errors import InputError
from canhaptic.kernels import fields_of, linking, new
from canhaptic.kernels.linking import Numba
from canhaptic.kernels.records import Binding

# numba states no types of its cache and its code generator
# mypy: allow-untyped-calls

_PRIVATE: Final = 0o700
_UNUSED: Final = 30 * 86_400.0  # [s] after which code is deleted
_DIGEST: Final = hashlib.sha256().digest_size


class _CheckedFiles(caching.IndexDataCacheFile):
    """numba's cache files of one function, each with a digest at its end; a damaged file counts as missing."""

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


_Found = TypeVar("_Found")


class NotKeptError(Exception):
    """Raised if machine code is not on disk while compiling is forbidden (`only_kept`)."""


_may_compile = True


@contextmanager
def only_kept() -> Iterator[None]:
    """Forbid compiling within the context: a kernel whose code is not on disk raises `NotKeptError`.

    If the cache folder cannot be written, kernels are compiled as usual.
    """
    global _may_compile
    _may_compile = False
    try:
        yield
    finally:
        _may_compile = True


def if_kept(run: Callable[..., _Found], *arguments: object) -> _Found | None:
    """Call a function without compiling; return its result, or None if machine code of a kernel is not on disk."""
    with suppress(NotKeptError), only_kept():
        return run(*arguments)
    return None


class CheckedCache(caching.FunctionCache):
    """Machine code of one function on disk; if it is damaged or missing, the function is compiled again."""

    def __init__(self, function: Callable[..., object]) -> None:
        super().__init__(function)
        place = self._impl.locator.get_cache_path()  # of these sources: older numba asks for a time too
        self._cache_file = _CheckedFiles(place, self._impl.filename_base, None)

    def load_overload(self, sig: object, target_context: object) -> object:
        """Return the code from the disk; None if there is none.

        Raises:
            NotKeptError: There is none, and compiling is not allowed now.
        """
        found: object = super().load_overload(sig, target_context)
        if found is None and not _may_compile:
            raise NotKeptError
        return found

    def save_overload(self, sig: object, data: object) -> None:
        """Store the code; a full disk does not prevent a run."""
        with suppress(OSError):
            super().save_overload(sig, data)


def _is_whole(content: bytes, version: str = "") -> bool:
    """Return whether the digest at the end matches the rest, without the version in front of an index."""
    start = len(pickle.dumps(version, protocol=-1)) if version else 0
    return content[-_DIGEST:] == hashlib.sha256(content[start:-_DIGEST]).digest()


@contextmanager
def kept_code(sources: Iterable[str]) -> Iterator[bool]:
    """Let numba store code within the context, in a folder for these sources; yields whether the folder can be written.

    Args:
        sources: Texts that determine the machine code.
    """
    place = _place_of(sources)
    if place is None:
        _say_that_nothing_is_kept()
        yield False
        return
    config: Numba = numba.config
    before, config.CACHE_DIR = config.CACHE_DIR, str(place)
    try:
        yield True
    finally:
        config.CACHE_DIR = before


def _place_of(sources: Iterable[str]) -> Path | None:
    """Return the folder for the code of these sources, marked as used now; None if it cannot be written."""
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
    """Delete the folders that no process has used for 30 days; at most once in a process.

    A folder is renamed first, so that no process finds half of it. A process that still needed the code compiles again.
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
            "compiled code is not kept, and each run compiles for 3 to 15 s: the folder canhaptic/kernels in "
            "XDG_CACHE_HOME, or in ~/.cache, cannot be written, or others can read it; make it private (chmod 700)"
        )
        warnings.warn(text, RuntimeWarning, stacklevel=2)


def cache_folder() -> Path | None:
    """Folder of compiled kernels, created if needed; None if it cannot be made or others can access it."""
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
    """Return the name of the folder for code made from these sources on this machine."""
    digest = hashlib.sha256()
    features = sorted(name for name, there in binding.get_host_cpu_features().items() if there)
    where = (sys.version, platform.machine(), binding.get_host_cpu_name(), features)
    versions = (numba.__version__, llvmlite.__version__, np.__version__)
    for part in (repr(where), repr(versions), *sources):
        digest.update(hashlib.sha256(part.encode()).digest())
    return digest.hexdigest()[:32]


_OPTIONS: Final[dict[str, object]] = {"error_model": "numpy", "_nrt": False}
_INNER: Final = {
    **_OPTIONS, "no_cpython_wrapper": True, "no_cfunc_wrapper": True, "pipeline_class": linking.Steps,
}  # fmt: skip
"""Options of functions that are never called from Python; they save a fifth of the compile time."""
METHODS: Final = (
    *("contact", "true_state", "admissible", "stored_energy", "effort", "state_of_energy", "one_way", "relaxed"),
    "damping_at",
    *("locate", "measure", "energy", "add_gradient", "add_discrete_gradient", "add_slopes", "add_change"),
    "fill_structure",
)
"""Methods that a kernel may call on an environment, a mechanism, a geometry and the functions of a network."""

_PROCESS: Final = token_hex(8)
"""A part of the name of every function that this process compiles. numba names a record type by a number that counts
from 0 in each process, and a function too, so that code from two processes may have one name for two types or two
methods, and the first that is loaded would be taken for both."""

_Function = TypeVar("_Function", bound=Callable[..., object])


def _name_for_process(function: Callable[..., object], name: str) -> None:
    """Give a function that is compiled a name that no other process gives."""
    function.__qualname__ = f"{name}_{_PROCESS}"


_njit: Final[Callable[..., Numba]] = numba.njit

fixed_tuple: Final = cast(Callable[[object, int], tuple[float, ...]], to_fixed_tuple)
"""(array, length) -> tuple of its numbers; the length must be a global constant of the calling function."""


def compiled(
    function: _Function,
    instead: Mapping[object, object] | None = None,
    *,
    keep: bool = False,
    parts: Collection[type] = (),
    calls: Collection[Callable[..., object]] | None = None,
    units: Collection[Callable[..., object]] = (),
) -> _Function:
    """Return a kernel as a function that is compiled at its first call.

    Args:
        function: The kernel.
        instead: Maps a function that the kernel calls, or the name of a global, to its replacement.
        keep: Whether the machine code is stored on disk for the next process.
        parts: Classes whose methods the kernel calls without naming the class.
        calls: Functions that are called, because they are long and used in several places; every other function is
            inlined, which halves the time of a loop, because a call passes the arrays of a NamedTuple as some fifty
            words. None: LLVM decides.
        units: Functions, as reached after the replacements, whose code is also stored by itself, so that another
            kernel that reaches one of them need not compile it again.

    Raises:
        InputError: A NamedTuple that the kernel names has a field with the name of a method.
    """
    compiling = _Compiling(instead or {}, calls, units, parts)
    rebound = compiling.rebound(function)
    made = _njit(rebound, **_OPTIONS, no_cfunc_wrapper=True, pipeline_class=linking.Steps)
    _link(made)
    if keep:
        compiling.keep(made, function)
    return cast(_Function, made)


def _link(made: Numba) -> None:
    """Change a compiled function so that its callees are linked into its machine code."""
    of_numba = made._compile_for_args  # noqa: SLF001

    def compile_for(*args: object, **named: object) -> object:
        with linking.linked():
            return of_numba(*args, **named)

    made._compile_for_args = compile_for  # noqa: SLF001


class _Compiling(Binding):
    """The functions that a kernel reaches, each compiled once.

    Attributes:
        sources: Texts that determine the machine code: the code of every function, and the constants that they name.
    """

    def __init__(
        self,
        instead: Mapping[object, object],
        calls: Collection[Callable[..., object]] | None = None,
        units: Collection[Callable[..., object]] = (),
        parts: Collection[type] = (),
    ) -> None:
        self._instead_of, self._calls, self._parts = instead, calls, parts
        self._codes, self._units = ({cast(FunctionType, one).__code__ for one in some} for some in (calls or (), units))
        super().__init__(instead, self._wrapped, {new: _made})
        self.sources: list[str] = [repr(_OPTIONS), *(Path(of).read_text() for of in (__file__, linking.__file__))]
        self.sources.append(repr(calls and sorted(cast(FunctionType, function).__name__ for function in calls)))
        for kind in parts:
            self.look_at(kind)

    def _wrapped(self, function: FunctionType) -> Numba:
        inlined = self._calls is not None and function.__code__ not in self._codes
        return _njit(function, **_INNER, forceinline=inlined)

    def keep(self, made: Numba, function: Callable[..., object]) -> None:
        """Keep the machine code of a function on disk, if the cache folder can be written."""
        with kept_code(self.sources) as can_keep:
            if can_keep:
                made._cache = CheckedCache(function)  # noqa: SLF001 - as `enable_caching` does

    def rebound(self, function: Callable[..., object]) -> FunctionType:
        """Copy of a function whose global names are bound to compiled functions."""
        function = cast(FunctionType, function)
        self.sources.append(_text_of(function.__code__) + repr(function.__defaults__))
        made = super().rebound(function)
        _name_for_process(made, function.__name__)
        return made

    def constant(self, name: str, value: object) -> object:
        """Add a global constant that a function uses to the sources, the key of cached code; return its value."""
        self.sources.append(f"{name}={value!r}")
        return value

    def of(self, name: str, value: object) -> object:
        """Return the compiled replacement of a function or class; the content of a class is added to the sources."""
        if value in self._known:
            return self._known[value]
        if isinstance(value, type):
            self.look_at(value)
        elif not isinstance(value, FunctionType):
            self.sources.append(f"{name}={getattr(value, '__name__', name)}")
        elif value.__code__ in self._units:
            self._take_unit(value)
        return super().of(name, value)

    def _take_unit(self, function: FunctionType) -> None:
        """Compile a function by itself, so that its code on disk depends on nothing else."""
        unit = _Compiling(self._instead_of, self._calls, parts=self._parts)
        made = self._wrapped(unit.rebound(function))
        unit.keep(made, function)
        self.sources += unit.sources
        self._known = {**unit._known, **self._known, function: made}

    def look_at(self, kind: type) -> None:
        """Add the fields of a class and the code of its methods to the sources.

        Raises:
            InputError: A field of a NamedTuple has the name of a method, and numba would take it for the method.
        """
        taken = sorted(set(fields_of(kind)).intersection(METHODS))
        if taken:
            raise InputError(
                f"{kind.__name__}: got a field {taken[0]!r}, expected a name that is not a method of an environment, "
                "mechanism or geometry: compiled code would take the field for the method; give it another name"
            )
        self.sources.append(f"{kind.__qualname__}{fields_of(kind)}")
        for method in METHODS:
            if isinstance(getattr(kind, method, None), FunctionType):
                self.rebound(getattr(kind, method))


def _text_of(code: CodeType) -> str:
    constants = [_text_of(part) if isinstance(part, CodeType) else repr(part) for part in code.co_consts]
    return repr((code.co_name, code.co_code, constants, code.co_names, code.co_varnames, code.co_freevars))


def _make(kind: Callable[..., object], values: Iterable[object]) -> object:
    return kind(*values)


_name_for_process(_make, "make")
_made: Final = _njit(_make, **_INNER, forceinline=True)


def _overload(name: str) -> None:
    def method(self: Numba, *args: object) -> Callable[..., object]:  # numba asks that both be annotated alike
        function = _njit(_Compiling({}, None).rebound(getattr(self.instance_class, name)), **_INNER)

        def call(self: Numba, *args: object) -> object:
            return function(self, *args)

        _name_for_process(call, name)
        return call

    overload: Numba = overload_method
    overload(types.BaseNamedTuple, name, jit_options=_INNER)(method)


for _name in METHODS:
    _overload(_name)


_TUPLE_TYPES: Final[dict[tuple[type, tuple[str, ...]], type]] = {}


def tuple_type(twin: object) -> Any:
    """Return a NamedTuple type with the numbers and methods of a plain object; None counts as a number."""
    kind = type(twin)
    values = {name: value for base in reversed(kind.__mro__) for name, value in vars(base).items()} | vars(twin)
    numbers = [name for name, value in values.items() if value is None or isinstance(value, int | float)]
    fields = tuple(name for name in numbers if not name.startswith("_"))
    if (kind, fields) not in _TUPLE_TYPES:
        methods = {name: value for name, value in vars(kind).items() if isinstance(value, FunctionType)}
        bases = (namedtuple(kind.__name__, fields),)
        _TUPLE_TYPES[kind, fields] = type(kind.__name__, bases, {**methods, "__slots__": ()})
    return _TUPLE_TYPES[kind, fields]
