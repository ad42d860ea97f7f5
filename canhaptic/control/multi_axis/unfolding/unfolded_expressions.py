"""Expressions of the source: computed where they are known, else written out."""

import ast
import builtins
import operator
from collections.abc import Callable, Iterator
from enum import Enum
from types import FunctionType, MethodType
from typing import Any, Final

from canhaptic.control.multi_axis.unfolding.memory import Memory, changing
from canhaptic.control.multi_axis.unfolding.source_writer import Frame, Writer
from canhaptic.control.multi_axis.unfolding.values import (
    SCALARS,
    Array,
    CannotUnfoldError,
    Cell,
    CellMethod,
    Maybe,
    Span,
    Var,
    is_plain,
    is_scalar,
    kind_of,
    known_other,
    text_of,
)

_OPERATORS: Final[dict[type, tuple[str, Callable[[Any, Any], Any]]]] = {
    ast.Add: ("+", operator.add), ast.Sub: ("-", operator.sub), ast.Mult: ("*", operator.mul),
    ast.Div: ("/", operator.truediv), ast.FloorDiv: ("//", operator.floordiv), ast.Mod: ("%", operator.mod),
    ast.Pow: ("**", operator.pow), ast.Lt: ("<", operator.lt), ast.LtE: ("<=", operator.le), ast.Gt: (">", operator.gt),
    ast.GtE: (">=", operator.ge), ast.Eq: ("==", operator.eq), ast.NotEq: ("!=", operator.ne),
    ast.Is: ("is", operator.is_), ast.IsNot: ("is not", operator.is_not),
    ast.In: ("in", lambda a, b: a in b), ast.NotIn: ("not in", lambda a, b: a not in b),
}  # fmt: skip
_COMPARING: Final = ("<", "<=", ">", ">=", "==", "!=")


class Expressions:
    """Values of expressions; `call` is made by the class that walks statements."""

    writer: Writer
    memory: Memory

    def call(self, function: Any, args: list[Any], keywords: dict[str, Any], frame: Frame) -> Any:
        """Returns what a call returns."""
        raise NotImplementedError

    def refuse(self, node: ast.AST, frame: Frame) -> CannotUnfoldError:
        """Returns the error for a construct that has no form of plain numbers."""
        return CannotUnfoldError(f"compiled: {frame.where}: {ast.unparse(node)} has no form of plain numbers")

    def value(self, node: ast.expr, frame: Frame) -> Any:
        """Returns the value of an expression."""
        visit = getattr(self, f"_{type(node).__name__.lower()}", None)
        if visit is None:
            raise self.refuse(node, frame)
        return visit(node, frame)

    def _constant(self, node: ast.Constant, _frame: Frame) -> Any:
        return node.value

    def _name(self, node: ast.Name, frame: Frame) -> Any:
        for names in (frame.names, frame.outer, vars(builtins)):
            if node.id in names:
                return names[node.id]
        raise self.refuse(node, frame)

    def _joinedstr(self, _node: ast.JoinedStr, _frame: Frame) -> Any:
        return ""

    def _attribute(self, node: ast.Attribute, frame: Frame) -> Any:
        return self.attribute(self.value(node.value, frame), node.attr, frame)

    def attribute(self, owner: Any, name: str, frame: Frame) -> Any:
        """Returns an attribute; one that changes has its value at this place."""
        if isinstance(owner, (Var, Enum)) and name == "value":
            return owner if isinstance(owner, Var) else owner.value
        if isinstance(owner, Cell):
            return CellMethod(owner, name)
        key = (id(owner), name)
        if key in self.writer.state.attributes:
            return self.writer.state.attributes[key]
        if not hasattr(owner, name):
            raise CannotUnfoldError(f"compiled: {frame.where}: {type(owner).__name__} has no {name}")
        described = getattr(type(owner), name, None)
        if isinstance(described, property) and isinstance(described.fget, FunctionType):
            return self.call(MethodType(described.fget, owner), [], {}, frame)
        found = getattr(owner, name)
        if id(found) in self.memory.blocks:
            return self.memory.blocks[id(found)].array
        if not isinstance(owner, (type, tuple)) and not callable(found) and name in changing(type(owner)):
            raise CannotUnfoldError(f"compiled: {frame.where}: {type(owner).__name__}.{name} changes by itself")
        return self.memory.lifted(owner, name, found)

    def _tuple(self, node: ast.Tuple, frame: Frame) -> Any:
        return tuple(self._entries(node.elts, frame))

    def _list(self, node: ast.List, frame: Frame) -> Any:
        return self.cell(self._entries(node.elts, frame))

    def _entries(self, nodes: list[ast.expr], frame: Frame) -> list[Any]:
        entries: list[Any] = []
        for each in nodes:
            if isinstance(each, ast.Starred):
                entries += self.items(self.value(each.value, frame), frame)
            else:
                entries.append(self.value(each, frame))
        return entries

    def cell(self, entries: list[Any]) -> Cell:
        """Returns a new list."""
        found = Cell()
        self.writer.state.lists[found] = entries
        return found

    def items(self, value: Any, frame: Frame) -> list[Any]:
        """Returns the entries of something that can be walked."""
        if isinstance(value, Cell):
            return list(self.writer.state.lists[value])
        if isinstance(value, Array):
            return [self.entry(value, i) for i in range(value.shape[0])]
        if isinstance(value, (tuple, list, range)) and not isinstance(value, (Var, Span)):
            return list(value)
        raise CannotUnfoldError(f"compiled: {frame.where}: nothing to walk in {value!r}")

    def entry(self, array: Array, index: Any) -> Any:
        """Returns one number of an array, or one row."""
        place = f"{array.name}[{text_of(index)}]"
        return Array(place, array.shape[1:]) if len(array.shape) > 1 else self.writer.computed(place, "float")

    def _subscript(self, node: ast.Subscript, frame: Frame) -> Any:
        owner = self.value(node.value, frame)
        if isinstance(node.slice, ast.Slice):
            ends = [None if end is None else self.value(end, frame) for end in (node.slice.lower, node.slice.upper)]
            part = self.items(owner, frame)[slice(*ends)]
            return tuple(part) if isinstance(owner, tuple) else self.cell(part)
        index = self.value(node.slice, frame)
        if isinstance(owner, Array):
            return self.entry(owner, index)
        if isinstance(index, Var):
            raise self.refuse(node, frame)
        return self.writer.state.lists[owner][index] if isinstance(owner, Cell) else owner[index]

    def _unaryop(self, node: ast.UnaryOp, frame: Frame) -> Any:
        if isinstance(node.op, ast.Not):
            truth = self.truth(self.value(node.operand, frame))
            return self.writer.computed(f"not {truth.name}", "bool") if isinstance(truth, Var) else not truth
        value = self.value(node.operand, frame)
        if not isinstance(node.op, ast.USub):
            raise self.refuse(node, frame)
        return self.writer.computed(f"-{value.name}", value.kind) if isinstance(value, Var) else -value

    def _binop(self, node: ast.BinOp, frame: Frame) -> Any:
        return self.binary(_OPERATORS[type(node.op)], self.value(node.left, frame), self.value(node.right, frame))

    def binary(self, operation: tuple[str, Callable[[Any, Any], Any]], a: Any, b: Any) -> Any:
        """Returns the value of an operation with two sides."""
        sign, function = operation
        if isinstance(a, Cell) or isinstance(b, Cell):
            return self._of_lists(sign, a, b)
        if not isinstance(a, Var) and not isinstance(b, Var):
            known = sign not in ("==", "!=") or not isinstance(a, tuple) or (is_plain(a) and is_plain(b))
            return function(a, b) if known else self._equal_tuples(sign, a, b)
        if not (is_scalar(a) and is_scalar(b)):
            if sign not in ("is", "is not"):
                raise CannotUnfoldError(f"compiled: {a!r} {sign} {b!r} has no form of plain numbers")
            return sign == "is not"
        if sign in ("==", "!=") and (known_other(a, b) or known_other(b, a)):
            return sign == "!="
        whole = kind_of(a) != "float" and kind_of(b) != "float"
        kind = "bool" if sign in _COMPARING else "int" if whole and sign != "/" else "float"
        square = sign == "**" and b == 2
        text = f"{text_of(a)} * {text_of(a)}" if square else f"{text_of(a)} {sign} {text_of(b)}"
        return self.writer.computed(text, kind)

    def _of_lists(self, sign: str, a: Any, b: Any) -> Any:
        lists = self.writer.state.lists
        if sign == "*" and isinstance(a, Cell) and isinstance(b, int):
            return self.cell(lists[a] * b)
        if sign == "+" and isinstance(a, Cell) and isinstance(b, Cell):
            return self.cell(lists[a] + lists[b])
        if sign in ("is", "is not"):
            return (a is b) == (sign == "is")
        raise CannotUnfoldError(f"compiled: lists have no {sign} of plain numbers")

    def _equal_tuples(self, sign: str, a: Any, b: Any) -> Any:
        if len(a) != len(b):
            return sign == "!="
        parts = [self.binary(_OPERATORS[ast.Eq], x, y) for x, y in zip(a, b, strict=True)]
        text = " and ".join(text_of(part) for part in parts)
        return self.writer.computed(text if sign == "==" else f"not ({text})", "bool")

    def _compare(self, node: ast.Compare, frame: Frame) -> Any:
        left, found = self.value(node.left, frame), []
        for op, comparator in zip(node.ops, node.comparators, strict=True):
            right = self.value(comparator, frame)
            found.append(self.binary(_OPERATORS[type(op)], left, right))
            left = right
        unknown = [part for part in found if isinstance(part, Var)]
        if any(part is False for part in found) or not unknown:
            return all(part is not False for part in found)
        text = " and ".join(part.name for part in unknown)
        return unknown[0] if len(unknown) == 1 else self.writer.computed(text, "bool")

    def truth(self, value: Any) -> Any:
        """Returns True, False or the name of a bool."""
        if isinstance(value, Var):
            if value.known:
                return True
            return value if value.kind == "bool" else self.writer.computed(f"{value.name} != 0", "bool")
        if isinstance(value, Cell):
            return len(self.writer.state.lists[value]) > 0
        return bool(value)

    def _boolop(self, node: ast.BoolOp, frame: Frame) -> Any:
        return self._joined_truths(isinstance(node.op, ast.And), node.values, frame)

    def _joined_truths(self, both: bool, nodes: list[ast.expr], frame: Frame) -> Any:
        """Returns `a and b` or `a or b`; b is looked at only where Python would."""
        first = self.value(nodes[0], frame)
        if len(nodes) == 1:
            return first
        truth = self.truth(first)
        if not isinstance(truth, Var):
            return self._joined_truths(both, nodes[1:], frame) if truth == both else first

        def rest() -> Any:
            return self._joined_truths(both, nodes[1:], frame)

        def short() -> Any:
            return first

        return self.writer.branch(truth, rest, short, frame) if both else self.writer.branch(truth, short, rest, frame)

    def _ifexp(self, node: ast.IfExp, frame: Frame) -> Any:
        truth = self.truth(self.value(node.test, frame))
        if not isinstance(truth, Var):
            return self.value(node.body if truth else node.orelse, frame)
        return self.writer.branch(
            truth, lambda: self.value(node.body, frame), lambda: self.value(node.orelse, frame), frame
        )

    def _listcomp(self, node: ast.ListComp, frame: Frame) -> Any:
        return self.cell(list(self._comprehended(node.elt, node.generators, frame)))

    def _generatorexp(self, node: ast.GeneratorExp, frame: Frame) -> Any:
        return self.cell(list(self._comprehended(node.elt, node.generators, frame)))

    def _comprehended(self, element: ast.expr, generators: list[ast.comprehension], frame: Frame) -> Iterator[Any]:
        inner = Frame(dict(frame.names), frame.outer, frame.where)
        for item in self.items(self.value(generators[0].iter, inner), inner):
            self.bind(generators[0].target, item, inner)
            conditions = [self.truth(self.value(test, inner)) for test in generators[0].ifs]
            if False in conditions:
                continue
            unknown = [condition for condition in conditions if isinstance(condition, Var)]
            if len(generators) > 1:
                if unknown:
                    raise self.refuse(generators[0].ifs[0], frame)
                yield from self._comprehended(element, generators[1:], inner)
            elif unknown:
                yield self._maybe(unknown, element, inner)
            else:
                yield self.value(element, inner)

    def _maybe(self, conditions: list[Var], element: ast.expr, frame: Frame) -> Maybe:
        condition = conditions[0]
        if len(conditions) > 1:
            condition = self.writer.computed(" and ".join(c.name for c in conditions), "bool")
        return Maybe(condition, self.writer.branch(condition, lambda: self.value(element, frame), lambda: 0.0, frame))

    def bind(self, target: ast.expr, value: Any, frame: Frame) -> None:
        """Assigns."""
        if isinstance(target, ast.Name):
            frame.names[target.id] = value
        elif isinstance(target, (ast.Tuple, ast.List)):
            entries = self.items(value, frame)
            for each, entry in zip(target.elts, entries, strict=True):
                self.bind(each, entry, frame)
        elif isinstance(target, ast.Attribute):
            key = (id(self.value(target.value, frame)), target.attr)
            if key not in self.writer.state.attributes:
                raise self.refuse(target, frame)
            self.writer.state.attributes[key] = value
        elif isinstance(target, ast.Subscript):
            self._bind_entry(target, value, frame)
        else:
            raise self.refuse(target, frame)

    def _bind_entry(self, target: ast.Subscript, value: Any, frame: Frame) -> None:
        owner = self.value(target.value, frame)
        if isinstance(target.slice, ast.Slice):
            if target.slice.lower or target.slice.upper or not isinstance(owner, Array):
                raise self.refuse(target, frame)
            entries = self.items(value, frame)
            for i, entry in enumerate(entries):
                self.writer.write(f"{owner.name}[{i}] = {text_of(entry)}")
            return
        index = self.value(target.slice, frame)
        if isinstance(owner, Array) and is_scalar(value):
            self.writer.write(f"{owner.name}[{text_of(index)}] = {text_of(value)}")
        elif isinstance(owner, Cell) and isinstance(index, SCALARS):
            self.writer.state.lists[owner][int(index)] = value
        elif isinstance(owner, Cell) and isinstance(index, Var) and is_scalar(value):
            entries = self.writer.state.lists[owner]
            for i, entry in enumerate(entries):
                floating = "float" in (kind_of(entry), kind_of(value))
                text = f"{text_of(value)} if {index.name} == {i} else {text_of(entry)}"
                entries[i] = self.writer.computed(text, "float" if floating else "int")
        else:
            raise self.refuse(target, frame)

    def _starred(self, node: ast.Starred, frame: Frame) -> Any:
        raise self.refuse(node, frame)

    def _call(self, node: ast.Call, frame: Frame) -> Any:
        function = self.value(node.func, frame)
        args = self._entries(node.args, frame)
        keywords = {each.arg: self.value(each.value, frame) for each in node.keywords if each.arg is not None}
        return self.call(function, args, keywords, frame)


__all__ = ["Expressions"]
