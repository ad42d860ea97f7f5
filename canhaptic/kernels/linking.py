"""Linking of a kernel by numba: machine code is emitted once, for the kernel with everything in it.

numba optimises each function that a kernel reaches, and emits machine code for it, although only the kernel is called;
for a loop of 170 functions that was 18 of 26 s. Here a function compiled for a caller is linked into that caller
only. Where numba's version differs from those below, its own procedure is unchanged.
"""

import gc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any, Final, cast

import numba
from llvmlite import binding
from numba.core import codegen
from numba.core.registry import cpu_target

# numba states no types of its code generator
# mypy: allow-untyped-calls

_KNOWN: Final = ((0, 60), (0, 69))
"""Versions of numba from the first up to, but not including, the second, whose `finalize` matches this one."""
_LEVEL: Final = 2
"""Optimisation by LLVM; a loop is as fast with it as with the highest."""
_under_way = False


Numba = Any
"""A part of numba, which states no types: its code generator, a compiled function."""


class _Library(codegen.JITCodeLibrary):
    """A function compiled for its callers only: within `linked`, neither optimised nor made machine code.

    Attributes:
        is_linked: Whether that is so.
    """

    is_linked = False

    def finalize(self) -> None:
        """Link its callees; as numba does where Python calls it, or outside of `linked`."""
        if not (_under_way and self._object_caching_enabled) or self._is_called_from_python():
            super().finalize()
            _set_environments(self._codegen)
            return
        for library in dict.fromkeys(self._linking_libraries):
            self._reload_init.update(library._reload_init)  # noqa: SLF001 - as numba's own does
            self._final_module.link_in(library._get_module_for_linking(), preserve=True)  # noqa: SLF001
        self._finalize_dynamic_globals()
        self.is_linked = self._finalized = True

    def _is_called_from_python(self) -> bool:
        return any(function.name.startswith("_ZN7cpython") for function in self._final_module.functions)

    def serialize_using_object_code(self) -> tuple[str, str, object]:
        """Its content for the disk."""
        if not self.is_linked:
            found: tuple[str, str, object] = super().serialize_using_object_code()
            return found
        return self.name, "linked", self._final_module.as_bitcode()

    @classmethod
    def _unserialize(cls, owner: Numba, state: tuple[str, str, object]) -> "_Library":
        name, kind, data = state
        if kind != "linked":
            return cast(_Library, super()._unserialize(owner, state))
        library: _Library = owner.create_library(name)
        library._final_module = binding.parse_bitcode(data)
        library.is_linked = library._finalized = True
        return library

    def _optimize_final_module(self) -> None:
        """Optimise once; numba's first of two runs prunes reference counts, which kernels do not have."""
        if not _under_way:
            super()._optimize_final_module()
            return
        manager, builder = self._codegen._module_pass_manager(  # noqa: SLF001
            opt=_LEVEL, loop_vectorize=False, slp_vectorize=False
        )
        manager.run(self._final_module, builder)


@contextmanager
def linked() -> Iterator[None]:
    """Within the context, functions compiled for another are only linked into it.

    Python's cyclic garbage collection is off: it takes a tenth of the time.
    """
    global _under_way
    before, collects = _under_way, gc.isenabled()
    _under_way = _installed()
    gc.disable()
    try:
        yield
    finally:
        _under_way = before
        if collects:
            gc.enable()


@cache
def _installed() -> bool:
    """Let numba make its libraries of this kind; return whether its version is known."""
    if not _KNOWN[0] <= tuple(map(int, numba.__version__.split(".")[:2])) < _KNOWN[1]:
        return False
    owner = cpu_target.target_context.codegen()
    owner._library_class, owner.set_env = _Library, _set_environment(owner)  # noqa: SLF001
    return True


_waiting: Final[dict[str, object]] = {}
"""By name: environments (what numba calls so) of functions that have no machine code yet."""


def _set_environment(owner: Numba) -> Callable[[str, object], None]:
    """Numba's `set_env`, where a function without machine code waits for that of a caller."""
    of_numba = owner.set_env

    def set_env(name: str, environment: object) -> None:
        if owner._engine.is_symbol_defined(name):  # noqa: SLF001
            of_numba(name, environment)
        else:
            _waiting[name] = environment

    return set_env


def _set_environments(owner: Numba) -> None:
    """Give machine code that was made the environments of the functions in it."""
    for name in [name for name in _waiting if owner._engine.is_symbol_defined(name)]:  # noqa: SLF001
        owner.set_env(name, _waiting.pop(name))
