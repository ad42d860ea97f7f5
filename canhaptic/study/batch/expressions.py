"""Interprets expressions with placeholders in the place of numbers; the statements around them are in `lowering`."""

import ast
import math
import operator
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from math import copysign, isfinite, sqrt
from typing import TYPE_CHECKING, Any, Final, cast

from canhaptic.study.batch.graph import Graph
from canhaptic.study.batch.heap import Heap, Maybe
from canhaptic.study.batch.nodes import Node, NotBatchableError
from canhaptic.study.batch.rings import DataRange, Ring, Rings

if TYPE_CHECKING:
    from canhaptic.study.batch.lowering import Frame

_ARITHMETIC: Final[dict[type, Callable[[Any, Any], Any]]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Mod: operator.mod,
    ast.FloorDiv: operator.floordiv,
    ast.Pow: operator.pow,
}
_ORDER: Final[dict[type, Callable[[Any, Any], Any]]] = {
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
}
_BY_NAME: Final[dict[Any, str]] = {
    abs: "abs",
    math.fabs: "abs",
    sqrt: "sqrt",
    math.exp: "exp",
    math.sin: "sin",
    math.cos: "cos",
    math.tan: "tan",
    math.asin: "asin",
    math.floor: "floor",
    round: "rint",
    isfinite: "finite",
    copysign: "copysign",
}
_LONG: Final = 8
"""Entries from which a list is kept as the rows of an array."""


class Expressions(ABC):
    """The half of the interpreter that has values.

    Attributes:
        graph: Where the operations go.
        heap: The instances that were made.
        path: Condition under which the source runs at this moment.
    """

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        self.heap = Heap(graph)
        self.path: Any = True
        self._values: dict[type, Callable[[Any, Frame], Any]] = {
            ast.Constant: lambda e, f: e.value,
            ast.Name: lambda e, f: f.find(e.id),
            ast.Attribute: lambda e, f: self.attribute(self.value(e.value, f), e.attr),
            ast.Subscript: lambda e, f: self.load(self.value(e.value, f), self.value(e.slice, f)),
            ast.Tuple: lambda e, f: tuple(self._elements(e.elts, f)),
            ast.List: lambda e, f: self._elements(e.elts, f),
            ast.BinOp: self._binary,
            ast.UnaryOp: self._unary,
            ast.BoolOp: self._boolean,
            ast.Compare: self._compare,
            ast.IfExp: self._either,
            ast.Call: self._called,
            ast.GeneratorExp: self._each,
            ast.ListComp: self._each,
            ast.Dict: self._memo,
            ast.JoinedStr: lambda e, f: "",
        }
        functions: dict[Any, Callable[..., Any]] = {
            known: self._operation(known, name) for known, name in _BY_NAME.items()
        }
        functions |= {min: self._least, max: self._most, int: self._whole, bool: self.graph.truth, sum: self._sum,
                      range: self._range,
                      float: lambda x: x if isinstance(x, Node) else float(x), cast: lambda kind, x: x}  # fmt: skip
        self._functions = functions

    @abstractmethod
    def call(self, function: Any, args: tuple[Any, ...], named: Mapping[str, Any]) -> Any:
        """Returns the result of a call."""

    @abstractmethod
    def give(self, target: ast.expr, value: Any, frame: "Frame") -> None:
        """Assigns a value."""

    def known_function(self, function: Any) -> Callable[..., Any] | None:
        """Returns what stands for a built-in function, or None."""
        try:
            return self._functions.get(function)
        except TypeError:  # not hashable
            return None

    def value(self, expression: ast.expr, frame: "Frame") -> Any:
        """Returns the value of an expression."""
        evaluate = self._values.get(type(expression))
        if evaluate is None:
            raise NotBatchableError(f"the expression {ast.unparse(expression)}")
        return evaluate(expression, frame)

    def attribute(self, owner: Any, name: str) -> Any:
        """Returns an attribute; a property is interpreted."""
        found = getattr(type(owner), name, None)
        if isinstance(found, property) and found.fget is not None and type(owner).__module__.startswith("canhaptic."):
            return self.call(found.fget, (owner,), {})
        return getattr(owner, name)

    def load(self, container: Any, key: Any) -> Any:
        """Returns an entry."""
        if isinstance(container, Ring | Rings):
            return container.load(key)
        if isinstance(key, Node):
            raise NotBatchableError("an entry at a place that data choose")
        return container[key]

    def store(self, container: Any, key: Any, value: Any) -> None:
        """Changes an entry."""
        if isinstance(container, Ring | Rings):
            container.store(key, value, self.path)
            return
        if isinstance(key, Node) and not isinstance(container, dict):
            raise NotBatchableError("an entry at a place that data choose")
        container[key] = value

    def _elements(self, elements: list[ast.expr], frame: "Frame") -> list[Any]:
        found: list[Any] = []
        for element in elements:
            if isinstance(element, ast.Starred):
                found += list(self.value(element.value, frame))
            else:
                found.append(self.value(element, frame))
        return found

    def _binary(self, expression: ast.BinOp, frame: "Frame") -> Any:
        left, right = _bare(self.value(expression.left, frame)), _bare(self.value(expression.right, frame))
        if isinstance(left, list) and (isinstance(right, Node) or right >= _LONG):
            return self._ring(left, right)
        try:
            return _ARITHMETIC[type(expression.op)](left, right)
        except (TypeError, KeyError) as error:
            raise NotBatchableError(f"the expression {ast.unparse(expression)} ({error})") from error

    def _ring(self, entries: list[Any], length: Any) -> Ring | Rings:
        """Returns a list of equal entries, each a number or a tuple of numbers."""
        [value] = entries
        if isinstance(value, tuple):
            return Rings(tuple(cast(Ring, self._ring([part], length)) for part in value))
        ring = Ring(self.graph.made("fill", (self.graph.node(value), self.graph.node(length))), length)
        self.heap.instances.append(ring)
        return ring

    def _memo(self, expression: ast.Dict, frame: "Frame") -> dict[Any, Any]:
        if expression.keys:
            raise NotBatchableError(f"the expression {ast.unparse(expression)}")
        return {}

    def _unary(self, expression: ast.UnaryOp, frame: "Frame") -> Any:
        value = _bare(self.value(expression.operand, frame))
        if isinstance(expression.op, ast.Not):
            return self.graph.op("not", self.graph.truth(value))
        return -value if isinstance(expression.op, ast.USub) else value

    def _boolean(self, expression: ast.BoolOp, frame: "Frame") -> Any:
        """Returns the last operand that had to be looked at, as the language has it."""
        op = "and" if isinstance(expression.op, ast.And) else "or"
        result = self.value(expression.values[0], frame)
        for operand in expression.values[1:]:
            truth = self.graph.truth(result)
            if not isinstance(truth, Node):
                if truth != (op == "and"):
                    return result
                result = self.value(operand, frame)
                continue
            following = self.value(operand, frame)
            if _is_truth(following) or _is_truth(result):
                result = self.graph.op(op, truth, self.graph.truth(following))
            else:
                result = self.graph.select(truth, *((following, result) if op == "and" else (result, following)))
        return result

    def test(self, expression: ast.expr, frame: "Frame") -> Any:
        """Returns whether an expression is true: a plain bool where that is known."""
        if isinstance(expression, ast.BoolOp):
            op = "and" if isinstance(expression.op, ast.And) else "or"
            result = self.test(expression.values[0], frame)
            for operand in expression.values[1:]:
                if not isinstance(result, Node) and result != (op == "and"):
                    return result
                result = self.graph.op(op, result, self.test(operand, frame))
            return result
        if isinstance(expression, ast.UnaryOp) and isinstance(expression.op, ast.Not):
            return self.graph.op("not", self.test(expression.operand, frame))
        return self.graph.truth(_bare(self.value(expression, frame)))

    def _compare(self, expression: ast.Compare, frame: "Frame") -> Any:
        left, result = self.value(expression.left, frame), cast(Any, True)
        for op, part in zip(expression.ops, expression.comparators, strict=True):
            right = self.value(part, frame)
            result = self.graph.op("and", result, self._compared(op, left, right))
            left = right
        return result

    def _compared(self, op: ast.cmpop, left: Any, right: Any) -> Any:
        if isinstance(op, ast.Is | ast.IsNot):
            found = self._is(left, right)
            return found if isinstance(op, ast.Is) else self.graph.op("not", found)
        if isinstance(op, ast.In | ast.NotIn):
            found = False
            for item in right:
                found = self.graph.op("or", found, self._compared(ast.Eq(), left, item))
            return found if isinstance(op, ast.In) else self.graph.op("not", found)
        return _ORDER[type(op)](_bare(left), _bare(right))

    def _is(self, left: Any, right: Any) -> Any:
        if isinstance(left, Maybe) and right is None:
            return self.graph.op("not", left.present)
        return left is right

    def _either(self, expression: ast.IfExp, frame: "Frame") -> Any:
        test = self.test(expression.test, frame)
        if not isinstance(test, Node):
            return self.value(expression.body if test else expression.orelse, frame)
        before, path = self.heap.save(), self.path
        values, saved = [], []
        for condition, side in ((test, expression.body), (self.graph.op("not", test), expression.orelse)):
            self.heap.restore(before)
            self.path = self.graph.op("and", path, condition)
            values.append(self.value(side, frame))
            saved.append(self.heap.save())
        self.path = path
        self.heap.join(test, *saved)
        return self.heap.joined(test, values[0], values[1], "the value")

    def _called(self, expression: ast.Call, frame: "Frame") -> Any:
        function = self.value(expression.func, frame)
        args = tuple(self._elements(expression.args, frame))
        named = {word.arg: self.value(word.value, frame) for word in expression.keywords if word.arg is not None}
        return self.call(function, args, named)

    def _each(self, expression: ast.GeneratorExp, frame: "Frame") -> list[Any]:
        [loop], found = expression.generators, []
        if loop.ifs:
            raise NotBatchableError(f"the expression {ast.unparse(expression)}")
        outer = dict(frame.local)
        for item in self.value(loop.iter, frame):
            self.give(loop.target, item, frame)
            found.append(self.value(expression.elt, frame))
        frame.local = outer
        return found

    def _operation(self, native: Callable[..., Any], name: str) -> Callable[..., Any]:
        def apply(*values: Any) -> Any:
            bare = [_bare(value) for value in values]
            return self.graph.op(name, *bare) if any(isinstance(value, Node) for value in bare) else native(*bare)

        return apply

    def _least(self, *values: Any) -> Any:
        return self._folded("min", values)

    def _most(self, *values: Any) -> Any:
        return self._folded("max", values)

    def _folded(self, op: str, values: Any) -> Any:
        items = list(values[0]) if len(values) == 1 else list(values)
        result = items[0]
        for item in items[1:]:
            result = self.graph.op(op, result, item)
        return result

    def _sum(self, values: Any) -> Any:
        result: Any = 0.0
        for value in values:
            result = result + value
        return result

    def _range(self, *ends: Any) -> Any:
        if not any(isinstance(end, Node) for end in ends):
            return range(*(int(end) for end in ends))
        start, stop = ends if len(ends) == 2 else (0.0, *ends)
        return DataRange(start, stop)

    def _whole(self, value: Any) -> Any:
        if not isinstance(value, Node):
            return int(value)
        return self.graph.select(value, 1.0, 0.0) if value.is_truth else self.graph.op("trunc", value)


def _bare(value: Any) -> Any:
    """Returns a number that may be None as the number: where it is None its use is masked."""
    return value.value if isinstance(value, Maybe) else value


def _is_truth(value: Any) -> bool:
    return isinstance(value, bool) or (isinstance(value, Node) and value.is_truth)
