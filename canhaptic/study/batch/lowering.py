"""Interprets the source of a loop with placeholders in the place of numbers: calls, attributes and statements.

Objects are real ones, made by the interpreted `__init__`; only what their attributes hold may be a `Node`. A branch on
something known is taken or not. A branch on data is taken both ways, one after the other, and what differs afterwards
becomes a selection; early returns and breaks are handled by giving each way its own rest of the function. A way that
raises is taken by no scene: where its condition holds, the results of a batch mean nothing, and the axis has left every
place that counts as not diverged.
"""

import ast
import builtins
import dataclasses
import inspect
import textwrap
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from types import FunctionType, MethodType
from typing import Any, Final, NamedTuple

from canhaptic.study.batch.expressions import Expressions
from canhaptic.study.batch.graph import Graph
from canhaptic.study.batch.heap import Maybe, differs
from canhaptic.study.batch.nodes import Node, NotBatchableError
from canhaptic.study.batch.rings import Body, DataRange, loop_of

_HERE: Final = "canhaptic."


class Mark(NamedTuple):
    """A place in a continuation that is no statement."""

    kind: str  # "assign": give `target` the value; "next": end of a pass through a loop; "end": of the loop; "join"
    target: Any = None
    value: Any = None


class Ending(NamedTuple):
    """How a piece of source ended."""

    kind: str  # "return", "raise", "join"
    value: Any = None


Continuation = tuple[Any, Any] | None
"""(statement or mark, what follows)."""


class Frame:
    """Local and global names of one call."""

    def __init__(self, function: FunctionType, local: dict[str, Any]) -> None:
        self.local = local
        self._free = inspect.getclosurevars(function).nonlocals
        self._global = function.__globals__

    def find(self, name: str) -> Any:
        """Returns what a name stands for."""
        for names in (self.local, self._free, self._global, vars(builtins)):
            if name in names:
                return names[name]
        raise NotBatchableError(f"name {name!r} has no value on this way")


class Lowering(Expressions):
    """An interpreter of the source of this package."""

    def __init__(self, graph: Graph) -> None:
        super().__init__(graph)
        self._run_statement: dict[type, Callable[[Any, Frame], None]] = {
            ast.Expr: lambda s, f: None if isinstance(s.value, ast.Constant) else self.value(s.value, f),
            ast.Assign: self._assign,
            ast.AnnAssign: lambda s, f: self.give(s.target, self.value(s.value, f), f) if s.value else None,
            ast.AugAssign: self._augment,
            ast.Assert: lambda s, f: None,
            ast.Pass: lambda s, f: None,
        }

    def create(self, kind: type, *args: Any, **named: Any) -> Any:
        """Returns an instance whose `__init__` was interpreted."""
        instance: Any = object.__new__(kind)
        self.heap.instances.append(instance)
        self.call(kind.__init__, (instance, *args), named)  # type: ignore[misc]
        return instance

    def call(self, function: Any, args: tuple[Any, ...], named: Mapping[str, Any]) -> Any:
        """Returns the result of a call; functions of this package are interpreted, others run."""
        if isinstance(function, MethodType):
            return self.call(function.__func__, (function.__self__, *args), named)
        known = self.known_function(function)
        if known is not None:
            return known(*args, **named)
        if isinstance(function, type):
            return self._construct(function, args, named)
        if isinstance(function, FunctionType) and function.__module__.startswith(_HERE):
            return self._interpret(function, args, named)
        return function(*args, **named)

    def _construct(self, kind: type, args: tuple[Any, ...], named: Mapping[str, Any]) -> Any:
        plain = dataclasses.is_dataclass(kind) or issubclass(kind, tuple) or not kind.__module__.startswith(_HERE)
        return kind(*args, **named) if plain else self.create(kind, *args, **named)

    def _interpret(self, function: FunctionType, args: tuple[Any, ...], named: Mapping[str, Any]) -> Any:
        bound = _signature(function).bind(*args, **named)
        bound.apply_defaults()
        ending = self._run(_pushed(_body(function), None), Frame(function, dict(bound.arguments)))
        if ending.kind == "raise":
            raise NotBatchableError(f"{function.__qualname__} raises whatever the data are: {ending.value}")
        return ending.value

    def _run(self, rest: Continuation, frame: Frame) -> Ending:
        while rest is not None:
            item, rest = rest
            ending = self._ending(item, frame)
            if ending is not None:
                return ending
            if isinstance(item, Mark):
                if item.kind == "assign":
                    self.give(item.target, item.value, frame)
            elif isinstance(item, ast.Break | ast.Continue):
                rest = _dropped(rest, "end" if isinstance(item, ast.Break) else "next")
            elif isinstance(item, ast.Try):
                rest = _pushed(item.body, _pushed(item.orelse, _pushed(item.finalbody, rest)))
            elif isinstance(item, ast.For):
                rest = self._loop(item, rest, frame)
            elif isinstance(item, ast.If):
                ending, rest = self._branch(item, rest, frame)
                if ending is not None:
                    return ending
            else:
                self._statement(item, frame)
        return Ending("return")

    def _ending(self, item: Any, frame: Frame) -> Ending | None:
        """Returns how a statement or mark ends the source, None where it does not."""
        if isinstance(item, Mark) and item.kind == "join":
            return Ending("join", item.value)
        if isinstance(item, ast.Return):
            return Ending("return", None if item.value is None else self.value(item.value, frame))
        return Ending("raise", ast.unparse(item)[:60]) if isinstance(item, ast.Raise) else None

    def _branch(self, item: ast.If, rest: Continuation, frame: Frame) -> tuple[Ending | None, Continuation]:
        test = self.test(item.test, frame)
        if isinstance(test, Node):
            return self._fork(test, item, rest, frame)
        return None, _pushed(item.body if test else item.orelse, rest)

    def _statement(self, item: ast.stmt, frame: Frame) -> None:
        run = self._run_statement.get(type(item))
        if run is None:
            raise NotBatchableError(f"a {type(item).__name__} in the source")
        run(item, frame)

    def _fork(self, test: Node, item: ast.If, rest: Continuation, frame: Frame) -> tuple[Ending | None, Continuation]:
        """Runs both ways of a branch; returns (how both ended, None), or (None, what follows)."""
        leaves = _leaves_early(item)
        after = rest if leaves else (Mark("join"), None)
        before, local, path = self.heap.save(), frame.local, self.path
        ends, saved, locals_of = [], [], []
        refuted = self.graph.op("not", test)
        for condition, body, holds in ((test, item.body, True), (refuted, item.orelse, False)):
            self.heap.restore(before)
            frame.local = dict(local)
            self.refine(item.test, holds, frame)
            self.path = self.graph.op("and", path, condition)
            ends.append(self._run(_pushed(body, after), frame))
            saved.append(self.heap.save())
            locals_of.append(frame.local)
        self.path = path
        for one, other in ((0, 1), (1, 0)):
            if ends[one].kind == "raise":
                self.heap.restore(saved[other])
                frame.local = locals_of[other]
                return (ends[other], None) if leaves else (None, rest)
        self.heap.join(test, *saved)
        frame.local = self._joined_names(test, *locals_of)
        if leaves:
            if ends[0].kind != ends[1].kind:
                raise NotBatchableError("a loop that data end from inside a branch")
            return Ending(ends[0].kind, self.heap.joined(test, ends[0].value, ends[1].value, "the result")), None
        return None, rest

    def _joined_names(self, test: Node, yes: dict[str, Any], no: dict[str, Any]) -> dict[str, Any]:
        names = {**no, **yes}
        for name in yes.keys() & no.keys():
            names[name] = self.heap.joined(test, yes[name], no[name], name)
        return names

    def _loop(self, item: ast.For, rest: Continuation, frame: Frame) -> Continuation:
        """Returns the loop written out, one pass after the other, before what follows."""
        values = self.value(item.iter, frame)
        if isinstance(values, DataRange):
            self._loop_of_data(item, values, frame)
            return rest
        if not isinstance(values, Iterable):
            raise NotBatchableError(f"a loop over {type(values).__name__}")
        rest = _pushed(item.orelse, (Mark("end"), rest))
        for value in reversed(list(values)):
            rest = (Mark("assign", item.target, value), _pushed(item.body, (Mark("next"), rest)))
        return rest

    def _loop_of_data(self, item: ast.For, values: DataRange, frame: Frame) -> None:
        """Makes a loop out of one pass, with variables in the place of all that passes leave to each other."""
        graph, before, local, path = self.graph, self.heap.save(), dict(frame.local), self.path
        running, index = (graph.made("var", (), f"{name}{graph.count()}", name == "run") for name in ("run", "index"))
        names = sorted(
            {part.id for part in ast.walk(item) if isinstance(part, ast.Name) and isinstance(part.ctx, ast.Store)}
        )
        carried = {name: graph.made("var", (), f"{name}{graph.count()}") for name in names}
        begin: dict[str, Any] = {}
        leaves: dict[str, Node] = {}
        while True:
            self.heap.restore(before)
            begin = dict(self.heap.leaves())
            self.heap.change(lambda name, value, known=leaves: known.get(name, value))  # type: ignore[misc]
            placed = dict(self.heap.leaves())
            frame.local = {**local, **carried}
            self.path = running
            self.give(item.target, index, frame)
            after = (Mark("next"), (Mark("join", value=False), (Mark("end"), (Mark("join", value=True), None))))
            broke = self._run(_pushed(item.body, after), frame).value
            then = dict(self.heap.leaves())
            fresh = [n for n in then if n not in leaves and differs(then[n], placed[n])]
            if not fresh:
                break
            leaves |= {name: graph.made("var", (), f"{name}{graph.count()}") for name in fresh}
        again = graph.op("and", graph.op("not", broke), graph.op("lt", index + 1.0, values.stop))
        first = graph.op("and", path, graph.op("lt", values.start, values.stop))
        body = Body(
            (running, index, *carried.values(), *leaves.values()),
            tuple(graph.node(v) for v in (again, index + 1.0, *map(frame.local.get, names), *map(then.get, leaves))),
        )
        start = [first, values.start, *(local.get(name, 0.0) for name in names), *map(begin.get, leaves)]
        outs = loop_of(graph, body, [graph.node(value) for value in start])
        self.heap.restore(before)
        ends = dict(zip(leaves, outs[2 + len(names) :], strict=True))
        self.heap.change(lambda name, value: ends.get(name, value))
        frame.local = local | dict(zip(names, outs[2 : 2 + len(names)], strict=True))
        self.path = path

    def _assign(self, item: ast.Assign, frame: Frame) -> None:
        value = self.value(item.value, frame)
        for target in item.targets:
            self.give(target, value, frame)

    def _augment(self, item: ast.AugAssign, frame: Frame) -> None:
        read = ast.copy_location(_as_read(item.target), item)
        self.give(item.target, self.value(ast.BinOp(read, item.op, item.value), frame), frame)

    def give(self, target: ast.expr, value: Any, frame: Frame) -> None:
        """Assigns a value to a name, an attribute, an entry, or to several of them."""
        if isinstance(target, ast.Name):
            frame.local[target.id] = value
        elif isinstance(target, ast.Attribute):
            object.__setattr__(self.value(target.value, frame), target.attr, value)
        elif isinstance(target, ast.Tuple | ast.List):
            items = list(value)
            for part, item in zip(target.elts, items, strict=True):
                self.give(part, item, frame)
        elif isinstance(target, ast.Subscript):
            container, key = self.value(target.value, frame), self.value(target.slice, frame)
            self.store(container, key, value)
        else:
            raise NotBatchableError(f"an assignment to {ast.unparse(target)}")

    def refine(self, test: ast.expr, holds: bool, frame: Frame) -> None:
        """Takes what a test says of a name that may be None into the names of one way."""
        if isinstance(test, ast.BoolOp) and holds == isinstance(test.op, ast.And):
            for part in test.values:
                self.refine(part, holds, frame)
        if not (isinstance(test, ast.Compare) and isinstance(test.left, ast.Name) and len(test.ops) == 1):
            return
        value = frame.local.get(test.left.id)
        if isinstance(value, Maybe) and isinstance(test.ops[0], ast.Is | ast.IsNot):
            is_none = holds == isinstance(test.ops[0], ast.Is)
            frame.local[test.left.id] = None if is_none else value.value


def _pushed(statements: Iterable[ast.stmt], rest: Continuation) -> Continuation:
    for statement in reversed(list(statements)):
        rest = (statement, rest)
    return rest


def _dropped(rest: Continuation, kind: str) -> Continuation:
    while rest is not None:
        item, rest = rest
        if isinstance(item, Mark) and item.kind == kind:
            return rest
    raise NotBatchableError("a break or continue outside of a loop")


def _leaves_early(item: ast.If) -> bool:
    return any(isinstance(part, ast.Return | ast.Break | ast.Continue) for part in ast.walk(item))


def _as_read(target: ast.expr) -> ast.expr:
    return ast.parse(ast.unparse(target), mode="eval").body


@cache
def _signature(function: FunctionType) -> inspect.Signature:
    return inspect.signature(function)


@cache
def _body(function: FunctionType) -> list[ast.stmt]:
    try:
        tree = ast.parse(textwrap.dedent(inspect.getsource(function))).body[0]
    except (OSError, SyntaxError) as error:
        raise NotBatchableError(f"no source of {function.__qualname__} ({error})") from error
    if not isinstance(tree, ast.FunctionDef):
        raise NotBatchableError(f"{function.__qualname__} is no plain function")
    return tree.body
