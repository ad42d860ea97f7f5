"""Shorter steps of numba for a kernel and the functions that it reaches; needs the extra `fast`.

**Linking.** numba optimises each function that a kernel reaches, and emits machine code for it, although Python calls
only the kernel; for a loop of 170 functions that was 18 of 26 s. Here a function that only kernels call is linked into
its caller, and machine code is emitted once, for the kernel.

**Zeros.** A field of settings that is 0 in all scenes (`canhaptic.kernels.OFTEN_ZERO`) is a constant of their loop. A
branch that needs another value is left out, with the functions that only it calls.

**Types.** numba looks for the meaning of `a * b` among all implementations, at every place. Within `linked` the answer
for an operation and types of operands is kept.

None of it changes an operation of the kernel or their order. It reaches into numba, so that only the versions that
`canhaptic.lab.batch` names compile. numba's own procedure takes twice (`unprotected`) to six
times as long (`guarded`) for the first sweep of a kind. A list of fewer passes saved a sixth more; it would have left
out, unseen, a pass that a later numba needs.
"""

import gc
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from functools import cache
from typing import Any, Final, cast

from llvmlite import binding
from numba.core import codegen, compiler, compiler_machinery, ir, types, untyped_passes
from numba.core.analysis import dead_branch_prune
from numba.core.compiler_machinery import register_pass
from numba.core.ir_utils import get_definition, guard
from numba.core.postproc import PostProcessor
from numba.core.registry import cpu_target

from canhaptic.kernels.records import of_zero

# numba states no types of its passes and its code generator
# mypy: allow-untyped-calls

_LEVEL: Final = 2
"""Optimisation level of LLVM; a loop is as fast with it as with the highest level."""
_under_way = False


Numba = Any
"""An object of numba, which has no type annotations: its code generator, or a compiled function."""


class _Library(codegen.JITCodeLibrary):
    """Code of a function that only kernels call: within `linked`, it is neither optimised nor emitted by itself.

    Attributes:
        is_linked: Whether the code is only linked into callers.
    """

    is_linked = False

    def finalize(self) -> None:
        """Complete the code of a function that Python calls, with all that it reaches; otherwise leave it as it is."""
        self._linking_libraries = self._reached()
        if not (_under_way and self._object_caching_enabled) or self._is_called_from_python():
            super().finalize()
            _set_environments(self._codegen)
            return
        self._finalize_dynamic_globals()
        for library in self._linking_libraries:
            self._reload_init.update(library._reload_init)  # noqa: SLF001 - as numba's own does
            self._dynamic_globals.extend(library._dynamic_globals)  # noqa: SLF001
        self.is_linked = self._finalized = True

    def _reached(self) -> list[Numba]:
        """Return the libraries of all functions that this one calls, directly or not: each once, before its callees.

        In another order LLVM would leave out a function, because nothing calls it yet.
        """
        found: dict[Numba, None] = {}
        for library in self._linking_libraries:
            if isinstance(library, _Library) and library.is_linked:
                found.update(dict.fromkeys(reversed(library._linking_libraries)))  # noqa: SLF001
            found[library] = None
        return [*reversed(found)]

    def _is_called_from_python(self) -> bool:
        return any(function.name.startswith("_ZN7cpython") for function in self._final_module.functions)

    def serialize_using_object_code(self) -> tuple[str, str, object]:
        """Content of the library for the disk."""
        if not self.is_linked:
            found: tuple[str, str, object] = super().serialize_using_object_code()
            return found
        whole = self._final_module.clone()
        for library in self._linking_libraries:
            whole.link_in(library._get_module_for_linking(), preserve=True)  # noqa: SLF001
        return self.name, "linked", whole.as_bitcode()

    @classmethod
    def _unserialize(cls, owner: Numba, state: tuple[str, str, object]) -> "_Library":
        name, kind, data = state
        if kind != "linked":
            return cast(_Library, super()._unserialize(owner, state))
        library: _Library = owner.create_library(name)
        library._final_module = binding.parse_bitcode(data)
        library.is_linked = library._finalized = True
        return library

    def _optimize_functions(self, module: Numba) -> None:
        """Remove what numba writes and never reads; the rest is optimised when all functions are linked together."""
        if not _under_way:
            super()._optimize_functions(module)
            return
        module.data_layout = self._codegen._data_layout  # noqa: SLF001
        manager = binding.create_new_function_pass_manager()
        manager.add_sroa_pass()
        manager.add_aggressive_dce_pass()
        builder = self._codegen._pass_builder()  # noqa: SLF001
        for function in module.functions:
            if not function.is_declaration:
                manager.run(function, builder)

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
    """Within the context, link a function that only kernels call into its caller, without machine code of its own.

    Python's cyclic garbage collection is off: it takes a tenth of the time.
    """
    global _under_way
    before, collects = _under_way, gc.isenabled()
    _install()
    _under_way = True
    gc.disable()
    try:
        with nullcontext() if before else _types_kept():
            yield
    finally:
        _under_way = before
        if collects:
            gc.enable()


@cache
def _install() -> None:
    """Let numba create `_Library` objects for compiled functions."""
    owner = cpu_target.target_context.codegen()
    owner._library_class, owner.set_env = _Library, _set_environment(owner)  # noqa: SLF001


_waiting: Final[dict[str, object]] = {}
"""Name -> environment, in numba's sense, of a function that has no machine code yet."""


def _set_environment(owner: Numba) -> Callable[[str, object], None]:
    """Return a `set_env` for numba that defers a function without machine code until a caller has some."""
    of_numba = owner.set_env

    def set_env(name: str, environment: object) -> None:
        if owner._engine.is_symbol_defined(name):  # noqa: SLF001
            of_numba(name, environment)
        else:
            _waiting[name] = environment

    return set_env


def _set_environments(owner: Numba) -> None:
    """Set the deferred environments of all functions whose machine code exists by now."""
    for name in [name for name in _waiting if owner._engine.is_symbol_defined(name)]:  # noqa: SLF001
        owner.set_env(name, _waiting.pop(name))


_Function: Final[Numba] = types.Function


@register_pass(mutates_CFG=True, analysis_only=False)
class KnownZeros(compiler_machinery.FunctionPass):
    """Writes zero for a field that is zero in all scenes, and leaves out the branches that are not taken then."""

    _name = "known_zeros"

    def __init__(self) -> None:
        super().__init__()

    def run_pass(self, state: Numba) -> bool:
        """Return whether the function reads such a field."""
        whole_ir, is_changed = state.func_ir, False
        for block in whole_ir.blocks.values():
            for one in block.find_insts(ir.Assign):
                value = one.value
                if not (isinstance(value, ir.Expr) and value.op == "getattr"):
                    continue
                zero = _zero_of(_type_of(whole_ir, value.value, state.args), value.attr)
                if zero is not None:
                    definitions = whole_ir._definitions[one.target.name]  # noqa: SLF001
                    one.value = ir.Const(zero, value.loc)
                    definitions[definitions.index(value)] = one.value
                    is_changed = True
        if is_changed:
            dead_branch_prune(whole_ir, state.args)
            PostProcessor(whole_ir).run()
        return is_changed


def _type_of(whole_ir: Numba, variable: Numba, args: tuple[Numba, ...]) -> Numba:
    """Return the type of a variable that is an argument or a part of one; a list of types for a tuple of variables."""
    found = guard(get_definition, whole_ir, variable)
    if isinstance(found, ir.Arg):
        return args[found.index]
    match getattr(found, "op", ""):
        case "build_tuple":
            return [_type_of(whole_ir, item, args) for item in found.items]
        case "exhaust_iter":
            return _type_of(whole_ir, found.value, args)
        case "getattr":
            return _part_of(_type_of(whole_ir, found.value, args), found.attr)
        case "static_getitem" | "getitem":
            return _item_of(_type_of(whole_ir, found.value, args), found.index)
    return None


def _item_of(kind: Numba, index: Numba) -> Numba:
    """Return the type of an item of an array or tuple; None if it is not known."""
    if isinstance(kind, types.Array):
        return kind.dtype if kind.ndim == 1 else None
    is_tuple = isinstance(kind, list | types.BaseTuple) and isinstance(index, int)
    return cast(Numba, kind)[index] if is_tuple else None


def _part_of(kind: Numba, name: str) -> Numba:
    """Return the type of a field of a record or NamedTuple; None if there is none."""
    if isinstance(kind, types.Record):
        return kind.typeof(name) if name in kind.fields else None
    return dict(zip(getattr(kind, "fields", ()), getattr(kind, "types", ()), strict=True)).get(name)


def _zero_of(kind: Numba, name: str) -> float | None:
    """Return the zero that every record has in a field; None where the records differ."""
    if not isinstance(kind, types.Record):
        return None
    return next((zero for zero in (0, 0.0, False) if of_zero(name, type(zero)) in kind.fields), None)


class Steps(compiler.Compiler):
    """numba's passes of a function, with `KnownZeros` as soon as its code can be read."""

    def define_pipelines(self) -> list[Numba]:
        """Return the passes of the function that is compiled."""
        of_numba = cast("list[Numba]", super().define_pipelines())
        for one in of_numba:
            one.add_pass_after(KnownZeros, untyped_passes.IRProcessing)
            one.finalize()
        return of_numba


@contextmanager
def _types_kept() -> Iterator[None]:
    """Within the context, keep the types that numba found for a call of one of its own functions."""
    of_numba, found = _Function.get_call_type, dict[object, object]()

    def get_call_type(function: Numba, context: Numba, args: tuple[Numba, ...], named: Mapping[str, Numba]) -> object:
        key = (function, tuple(args), tuple(dict(named).items()))
        if key not in found:
            found[key] = of_numba(function, context, args, named)
        return found[key]

    _Function.get_call_type = get_call_type
    try:
        yield
    finally:
        _Function.get_call_type = of_numba
