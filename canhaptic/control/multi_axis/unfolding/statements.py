"""Statements of the source, walked once: known branches are taken, loops over known things are written out."""

import ast
import inspect
from collections.abc import Callable, Sequence
from functools import partial
from types import FunctionType, MethodType
from typing import Any, Final, NamedTuple

from canhaptic.control.multi_axis.unfolding.calls import Calls
from canhaptic.control.multi_axis.unfolding.memory import Memory, source_of
from canhaptic.control.multi_axis.unfolding.source_writer import Frame, Writer
from canhaptic.control.multi_axis.unfolding.values import (
    DEAD,
    THROUGH,
    CannotUnfoldError,
    CellMethod,
    Span,
    Var,
    as_kind,
    is_plain,
    is_scalar,
    kind_of,
    text_of,
)
from canhaptic.control.port_hamiltonian.njit_registry import MODULES

_AS_THEY_ARE: Final = tuple(module.__name__ for module in MODULES)
Follow = Callable[[], Any]


class Loop(NamedTuple):
    """What `continue` and `break` go on with."""

    again: Follow
    out: Follow


def _through() -> Any:
    return THROUGH


class Statements(Calls):
    """Unfolds functions into one."""

    def __init__(self, memory: Memory) -> None:
        self.memory, self.writer = memory, Writer()

    def call(self, function: Any, args: list[Any], keywords: dict[str, Any], frame: Frame) -> Any:
        """Returns what a call returns, its lines written where it stands."""
        if isinstance(function, CellMethod):
            return self._list_method(function, args, frame)
        known = self.known_call(function) if not isinstance(function, (MethodType, FunctionType)) else None
        if known is not None:
            return known(frame, *args, **keywords)
        if isinstance(function, FunctionType) and function.__module__ in _AS_THEY_ARE:
            kind = function.__annotations__["return"]
            return self.opaque(function.__name__, args, "None" if kind is None else kind.__name__)
        if isinstance(function, (FunctionType, MethodType)):
            bound = [function.__self__] if isinstance(function, MethodType) else []
            return self._inside(getattr(function, "__func__", function), [*bound, *args], keywords)
        if (isinstance(function, type) and issubclass(function, tuple)) or is_plain((*args, *keywords.values())):
            return function(*args, **keywords)
        raise CannotUnfoldError(f"compiled: {frame.where}: {function!r} has no form of plain numbers")

    def _list_method(self, method: CellMethod, args: list[Any], frame: Frame) -> Any:
        entries = self.writer.state.lists[method.cell]
        if method.name == "append":
            entries.append(args[0])
            return None
        if method.name == "popleft":
            return entries.pop(0)
        raise CannotUnfoldError(f"compiled: {frame.where}: lists have no {method.name} of plain numbers")

    def _inside(self, function: Any, args: list[Any], keywords: dict[str, Any]) -> Any:
        source = source_of(function)
        bound = inspect.signature(function).bind(*args, **keywords)
        bound.apply_defaults()
        frame = Frame(dict(bound.arguments), function.__globals__, f"{function.__module__}.{function.__qualname__}")
        found = self.run(source.body, frame, _through, None)
        return None if found is THROUGH else found

    def run(self, body: Sequence[ast.stmt], frame: Frame, follow: Follow, loop: Loop | None) -> Any:
        """Walks statements, then what follows; returns the value of the function, THROUGH or DEAD."""
        for index, statement in enumerate(body):
            rest = body[index + 1 :]
            if _raises(body[index:]):
                return self.writer.bail()
            if isinstance(statement, (ast.Return, ast.Break, ast.Continue)):
                return self._leave(statement, frame, loop)
            if isinstance(statement, ast.If):
                found = self._if(statement, rest, frame, follow, loop)
                if found is not THROUGH or _leaves(statement):
                    return found
            elif isinstance(statement, ast.For):
                return self._for(statement, frame, partial(self.run, rest, frame, follow, loop))
            elif isinstance(statement, ast.Try):
                return self.run([*statement.body, *rest], frame, follow, loop)
            else:
                self._simple(statement, frame)
        return follow()

    def _leave(self, statement: ast.Return | ast.Break | ast.Continue, frame: Frame, loop: Loop | None) -> Any:
        if isinstance(statement, ast.Return):
            return None if statement.value is None else self.value(statement.value, frame)
        if loop is None:
            raise self.refuse(statement, frame)
        return (loop.out if isinstance(statement, ast.Break) else loop.again)()

    def _if(self, statement: ast.If, rest: Sequence[ast.stmt], frame: Frame, follow: Follow, loop: Loop | None) -> Any:
        truth = self.truth(self.value(statement.test, frame))
        if not isinstance(truth, Var):
            chosen = statement.body if truth else statement.orelse
            if _leaves(statement):
                return self.run([*chosen, *rest], frame, follow, loop)
            return self.run(chosen, frame, _through, None)
        if _leaves(statement):
            return self.writer.branch(
                truth,
                lambda: self.run([*statement.body, *rest], frame, follow, loop),
                lambda: self.run([*statement.orelse, *rest], frame, follow, loop),
                frame,
            )
        return self.writer.branch(
            truth,
            lambda: self.run(statement.body, frame, _through, None),
            lambda: self.run(statement.orelse, frame, _through, None),
            frame,
        )

    def _simple(self, statement: ast.stmt, frame: Frame) -> None:
        if isinstance(statement, ast.Assign):
            value = self.value(statement.value, frame)
            for target in statement.targets:
                self.bind(target, value, frame)
        elif isinstance(statement, ast.AnnAssign):
            if statement.value is not None:
                self.bind(statement.target, self.value(statement.value, frame), frame)
        elif isinstance(statement, ast.AugAssign):
            read = ast.parse(ast.unparse(statement.target), mode="eval").body
            changed = ast.BinOp(read, statement.op, statement.value)
            self.bind(statement.target, self.value(changed, frame), frame)
        elif isinstance(statement, ast.Expr):
            self.value(statement.value, frame)
        elif not isinstance(statement, ast.Pass):
            raise self.refuse(statement, frame)

    def _for(self, statement: ast.For, frame: Frame, after: Follow) -> Any:
        span = self.value(statement.iter, frame)
        if isinstance(span, Span):
            self._looped(span, statement, frame)
            return after()
        items = self.items(span, frame)

        def turn(index: int) -> Any:
            if index == len(items):
                return after()
            self.bind(statement.target, items[index], frame)
            again = Loop(lambda: turn(index + 1), after)
            return self.run(statement.body, frame, again.again, again)

        return turn(0)

    def _looped(self, span: Span, statement: ast.For, frame: Frame) -> None:
        """Writes a loop whose end is not known; numbers that it changes keep one name each."""
        assert isinstance(statement.target, ast.Name)
        carried: dict[Any, Var] = {}
        before, names, lines = self.writer.state, frame.names, self.writer.lines
        while True:
            self.writer.state, frame.names, self.writer.lines = before.copy(), dict(names), []
            for key, var in carried.items():
                self.writer.write(f"{var.name} = {as_kind(self._of(key, frame), var.kind)}")
                self._set(key, var, frame)
            head, outer, found = (
                self.writer.lines,
                self.writer.state.copy(),
                self._turn(span, statement, frame, carried),
            )
            if not found:
                break
            carried |= found
        body = self.writer.lines
        self.writer.state, frame.names, self.writer.lines = outer, dict(names), lines
        for key, var in carried.items():
            self._set(key, var, frame)
        self.writer.lines += head
        assert isinstance(statement.target, ast.Name)
        counter = frame.names[statement.target.id] = Var(self._counter, "int")
        self.writer.nest(f"for {counter.name} in range({text_of(span.first)}, {text_of(span.end)}):", body)

    def _turn(self, span: Span, statement: ast.For, frame: Frame, carried: dict[Any, Var]) -> dict[Any, Var]:
        """Writes one turn of a loop; returns the numbers that it changes beside those known to change."""
        assert isinstance(statement.target, ast.Name)
        start, names, self.writer.lines = self.writer.state.copy(), dict(frame.names), []
        counter = self.writer.fresh("int")
        self._counter = counter.name
        frame.names[statement.target.id] = counter
        found: dict[Any, Var] = {}
        place = statement.target.id

        def leave(word: str) -> Any:
            moved: list[tuple[str, str]] = []
            for key, value in self._numbers(frame):
                at_start = start.attributes.get(key[1]) if key[0] == "attribute" else names.get(key[1])
                if key[1] == place or at_start is None or not is_scalar(at_start):
                    continue
                if key in carried:
                    if text_of(value) != carried[key].name:
                        moved.append((carried[key].name, text_of(value)))
                elif text_of(value) != text_of(at_start):
                    whole = "float" not in (kind_of(value), kind_of(at_start))
                    found[key] = self.writer.fresh("int" if whole else "float")
            if moved:
                self.writer.write(f"{', '.join(a for a, _ in moved)} = {', '.join(b for _, b in moved)}")
            if word:
                self.writer.write(word)
            return DEAD

        self.run(statement.body, frame, lambda: leave(""), Loop(lambda: leave("continue"), lambda: leave("break")))
        return found

    def _numbers(self, frame: Frame) -> list[tuple[Any, Any]]:
        found: list[tuple[Any, Any]] = [
            (("attribute", key), value) for key, value in self.writer.state.attributes.items()
        ]
        found += [(("name", key), value) for key, value in frame.names.items()]
        return [(key, value) for key, value in found if is_scalar(value)]

    def _of(self, key: Any, frame: Frame) -> Any:
        return self.writer.state.attributes[key[1]] if key[0] == "attribute" else frame.names[key[1]]

    def _set(self, key: Any, var: Var, frame: Frame) -> None:
        (self.writer.state.attributes if key[0] == "attribute" else frame.names)[key[1]] = var


def _leaves(statement: ast.stmt) -> bool:
    """Returns True where a statement may end its function or its loop."""
    return any(isinstance(node, (ast.Return, ast.Break, ast.Continue)) for node in ast.walk(statement))


def _raises(body: Sequence[ast.stmt]) -> bool:
    """Returns True where statements come to an error whatever the data."""
    for statement in body:
        if isinstance(statement, ast.Raise):
            return True
        if _leaves(statement):
            return False
    return False
