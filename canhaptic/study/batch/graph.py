"""Elementary operations on placeholders: what the source of a loop becomes when its numbers are not known yet.

A `Node` is one operation on others. Equal operations are one node; what is known is computed at once, and only such
identities are used as hold for every finite number bit for bit, but for the sign of zero (x + 0, x * 1, x * 0).
"""

import math
import operator
from collections.abc import Callable
from typing import Any, Final

from canhaptic.errors import CanHapticError


class NotBatchableError(CanHapticError):
    """A piece of source that has no form in arrays; the message says which."""


def _rounded(x: float) -> float:
    return float(round(x)) if math.isfinite(x) else x


NUMBER: Final[dict[str, Callable[..., float]]] = {
    "add": operator.add,
    "sub": operator.sub,
    "mul": operator.mul,
    "div": operator.truediv,
    "mod": operator.mod,
    "floordiv": operator.floordiv,
    "neg": operator.neg,
    "abs": abs,
    "sqrt": math.sqrt,
    "exp": math.exp,
    "sin": math.sin,
    "cos": math.cos,
    "tan": math.tan,
    "asin": math.asin,
    "floor": lambda x: float(math.floor(x)),
    "trunc": lambda x: float(int(x)),
    "rint": _rounded,
    "copysign": math.copysign,
    "max": lambda a, b: b if b > a else a,
    "min": lambda a, b: b if b < a else a,
}
"""Operations with a number as their result."""

TRUTH: Final[dict[str, Callable[..., bool]]] = {
    "lt": operator.lt,
    "le": operator.le,
    "gt": operator.gt,
    "ge": operator.ge,
    "eq": operator.eq,
    "ne": operator.ne,
    "and": lambda a, b: a and b,
    "or": lambda a, b: a or b,
    "not": operator.not_,
    "finite": math.isfinite,
}
"""Operations with a truth value as their result."""

_CHANGING: Final = ("state", "array", "var")
_ROWS: Final = ("array", "store", "fill")
_COMPARISONS: Final = frozenset(("lt", "le", "gt", "ge", "eq", "ne"))
_SAME: Final = {"lt": False, "le": True, "gt": False, "ge": True, "eq": True, "ne": False}


class Node:
    """One operation; made by a `Graph` only.

    Attributes:
        op: Name of `NUMBER` or `TRUTH`; "select", "const", "param" or "state"; of lists and loops (`rings`) "fill",
            "array", "store", "load", "loop", "var" and "out".
        args: Nodes it works on.
        value: Of a constant; name of a parameter or state.
        is_truth: Whether its result is a truth value.
        changes: Whether it depends on a state, so that it is to be computed in every cycle.
        number: Position in the order of making; arguments come before what uses them.
    """

    __slots__ = ("args", "changes", "graph", "is_truth", "number", "op", "value")

    def __init__(self, graph: "Graph", op: str, args: tuple["Node", ...], value: Any, is_truth: bool) -> None:
        self.graph, self.op, self.args, self.value, self.is_truth = graph, op, args, value, is_truth
        self.changes = op in _CHANGING or any(arg.changes for arg in args)
        self.number = graph.count()

    def __repr__(self) -> str:
        """Returns the operation and its value, for messages."""
        return f"{self.op}({self.value if self.value is not None else ', '.join(str(a.number) for a in self.args)})"

    def __bool__(self) -> bool:
        """Refuses: whether it is true is not known while the form is made."""
        raise NotBatchableError(f"a decision on {self!r} outside of the source that is interpreted")

    def __float__(self) -> float:
        """Refuses: its value is not known while the form is made."""
        raise NotBatchableError(f"the value of {self!r} is asked for outside of the source that is interpreted")

    __hash__ = object.__hash__

    @property
    def is_rows(self) -> bool:
        """Whether it stands for the rows of a list and not for a number."""
        return self.op in _ROWS


def _binary(op: str, swapped: bool = False) -> Callable[[Node, Any], Any]:
    def apply(self: Node, other: Any) -> Any:
        if not isinstance(other, Node | float | int):
            return NotImplemented
        return self.graph.op(op, other, self) if swapped else self.graph.op(op, self, other)

    return apply


for _name, _op in (("add", "add"), ("sub", "sub"), ("mul", "mul"), ("truediv", "div"), ("mod", "mod"),
                   ("floordiv", "floordiv")):  # fmt: skip
    setattr(Node, f"__{_name}__", _binary(_op))
    setattr(Node, f"__r{_name}__", _binary(_op, swapped=True))
for _name in _COMPARISONS:
    setattr(Node, f"__{_name}__", _binary(_name))
Node.__neg__ = lambda self: self.graph.op("neg", self)  # type: ignore[attr-defined]
Node.__pos__ = lambda self: self  # type: ignore[attr-defined]
Node.__abs__ = lambda self: self.graph.op("abs", self)  # type: ignore[attr-defined]


def _power(self: Node, exponent: Any) -> Any:
    if exponent == 2:
        return self * self
    if exponent == 0.5:
        return self.graph.op("sqrt", self)
    raise NotBatchableError(f"power {exponent!r} of a placeholder, expected 2 or 0.5")


Node.__pow__ = _power  # type: ignore[attr-defined]


class Graph:
    """Nodes by what they are."""

    def __init__(self) -> None:
        self.nodes: list[Node] = []
        self._known: dict[Any, Node] = {}
        self._signs: dict[str, int] = {}
        self._count = 0

    def count(self) -> int:
        """Returns the next number of a node."""
        self._count += 1
        return self._count

    def constant(self, value: float | bool) -> Node:
        """Returns the node of a known value."""
        is_truth = isinstance(value, bool)
        held = value if is_truth else float(value)
        return self._node("const", (), held, is_truth, key=("const", is_truth, repr(held)))

    def param(self, name: str, sign: int = 0) -> Node:
        """Returns the node of a value that does not change in a run.

        Args:
            name: Of it.
            sign: 1 or -1 where it is above or below zero in every scene, 0 where that is not known.
        """
        self._signs[name] = sign
        return self._node("param", (), name, False)

    def sign(self, node: Node) -> int:
        """Returns 1 or -1 where a node is above or below zero in every scene, 0 where that is not known."""
        return self._signs.get(node.value, 0) if node.op == "param" else 0

    def state(self, name: str, is_truth: bool = False) -> Node:
        """Returns the node of a value that every cycle leaves to the next."""
        return self._node("state", (), name, is_truth)

    def slot(self, name: str, like: Node) -> Node:
        """Returns the state that is to hold what another node is."""
        return self._node("array", (), name, False) if like.is_rows else self.state(name, like.is_truth)

    def made(self, op: str, args: tuple[Node, ...], value: Any = None, is_truth: bool = False) -> Node:
        """Returns the node of an operation that is never known beforehand."""
        key = (op, id(value), *(arg.number for arg in args)) if op == "loop" else None
        return self._node(op, args, value, is_truth, key)

    def node(self, value: Any) -> Node:
        """Returns a value as a node."""
        return value if isinstance(value, Node) else self.constant(value)

    def op(self, op: str, *values: Any) -> Any:
        """Returns the result of an operation: a plain value where all arguments are known, else a node."""
        args = tuple(self.node(value) for value in values)
        if all(arg.op == "const" for arg in args):
            try:
                return (NUMBER.get(op) or TRUTH[op])(*(arg.value for arg in args))
            except (ArithmeticError, ValueError) as error:
                raise NotBatchableError(f"{op} of {values}: {error}") from error
        simpler = _simplified(self, op, args)
        if simpler is not None:
            return _plain(simpler)
        return self._node(op, args, None, op in TRUTH)

    def select(self, condition: Any, yes: Any, no: Any) -> Any:
        """Returns `yes` where the condition holds, else `no`."""
        if not isinstance(condition, Node):
            return yes if condition else no
        a, b = self.node(yes), self.node(no)
        if a is b or (a.op == b.op == "const" and a.value == b.value and a.is_truth == b.is_truth):
            return _plain(a)
        if condition.op == "not":
            return self.select(condition.args[0], no, yes)
        if a.is_truth and b.is_truth:
            return self._select_truth(condition, a, b)
        if a.op == "select" and a.args[0] is condition:
            a = a.args[1]
        if b.op == "select" and b.args[0] is condition:
            b = b.args[2]
        largest = _extreme(condition, a, b)
        if largest:
            return self.op(largest, b, a)
        if a.is_truth != b.is_truth:
            raise NotBatchableError("a number on one branch and a truth value on the other")
        return self._node("select", (condition, a, b), None, False)

    def _select_truth(self, condition: Node, a: Node, b: Node) -> Any:
        either = self.op("and", condition, a), self.op("and", self.op("not", condition), b)
        return self.op("or", *either)

    def truth(self, value: Any) -> Any:
        """Returns whether a value is true, as a plain bool where it is known."""
        if not isinstance(value, Node):
            return bool(value)
        return value if value.is_truth else self.op("ne", value, 0.0)

    def _node(self, op: str, args: tuple[Node, ...], value: Any, is_truth: bool, key: Any = None) -> Node:
        key = key or (op, value, is_truth, *(arg.number for arg in args))
        node = self._known.get(key)
        if node is None:
            node = self._known[key] = Node(self, op, args, value, is_truth)
            self.nodes.append(node)
        return node


def _plain(node: Any) -> Any:
    return node.value if isinstance(node, Node) and node.op == "const" else node


def _extreme(condition: Node, a: Node, b: Node) -> str:
    """Returns "max" or "min" where the selection is one of its two operands by their order, else ""."""
    if condition.op in ("gt", "lt") and {*condition.args} == {a, b} and not a.is_truth:
        return "max" if (condition.op == "gt") == (condition.args[0] is a) else "min"
    return ""


def _is(node: Node, value: float) -> bool:
    return node.op == "const" and not node.is_truth and node.value == value


def _simplified(graph: Graph, op: str, args: tuple[Node, ...]) -> Any:
    """Returns a simpler result, or None where there is none."""
    if op in ("and", "or", "not"):
        return _simplified_truth(graph, op, args)
    if op in _COMPARISONS:
        return _simplified_comparison(graph, op, args[0], args[1])
    if len(args) == 1:
        inner = args[0]
        return inner.args[0] if op == "neg" == inner.op else _pushed(graph, op, args)
    a, b = args
    if (op in ("add", "sub") and _is(b, 0.0)) or (op in ("mul", "div") and _is(b, 1.0)):
        return a
    if (op == "add" and _is(a, 0.0)) or (op == "mul" and _is(a, 1.0)):
        return b
    if (op == "mul" and (_is(a, 0.0) or _is(b, 0.0))) or (op == "div" and _is(a, 0.0)):
        return graph.constant(0.0)
    if op == "sub" and _is(a, 0.0):
        return graph.node(graph.op("neg", b))
    if a is b and op in ("max", "min"):
        return a
    if op in ("mul", "div") and "neg" in (a.op, b.op):
        return _without_sign(graph, op, a, b)
    if a is b and op == "sub":
        return graph.constant(0.0)
    if b.op == "neg" and op in ("add", "sub"):
        return graph.node(graph.op("sub" if op == "add" else "add", a, b.args[0]))
    if a.op == "neg" and op == "add":
        return graph.node(graph.op("sub", b, a.args[0]))
    return _pushed(graph, op, args)


def _without_sign(graph: Graph, op: str, a: Node, b: Node) -> Node:
    """Returns the product or quotient with the signs taken out of it."""
    negative = (a.op == "neg") != (b.op == "neg")
    result = graph.op(op, *(arg.args[0] if arg.op == "neg" else arg for arg in (a, b)))
    return graph.node(graph.op("neg", result) if negative else result)


def _pushed(graph: Graph, op: str, args: tuple[Node, ...]) -> Any:
    """Returns a selection of results where all arguments are selections by one condition and one side is known."""
    choices = [arg for arg in args if arg.op == "select"]
    if not choices or any(arg.op not in ("select", "const") for arg in args):
        return None
    condition = choices[0].args[0]
    if any(choice.args[0] is not condition for choice in choices):
        return None
    for side in (2, 1):
        chosen = [arg.args[side] if arg.op == "select" else arg for arg in args]
        if all(arg.op == "const" for arg in chosen):
            other = [arg.args[3 - side] if arg.op == "select" else arg for arg in args]
            known, rest = graph.op(op, *chosen), graph.op(op, *other)
            pair = (rest, known) if side == 2 else (known, rest)
            return graph.node(graph.select(condition, *pair))
    return None


def _simplified_truth(graph: Graph, op: str, args: tuple[Node, ...]) -> Any:
    if op == "not":
        return args[0].args[0] if args[0].op == "not" else None
    a, b = args
    for first, second in ((a, b), (b, a)):
        if first.op == "const":
            return second if first.value == (op == "and") else first
        if second.op == "not" and second.args[0] is first:
            return graph.constant(op == "or")
        if second.op in ("and", "or") and any(arg is first for arg in second.args):
            return first if second.op != op else second
        if second.op in ("and", "or") and second.op != op:  # a or (not a and c) is a or c
            for i, arg in enumerate(second.args):
                if arg is graph.node(graph.op("not", first)):
                    return graph.node(graph.op(op, first, second.args[1 - i]))
    if a.op == b.op and a.op in ("and", "or") and a.op != op:
        return _distributed(graph, a, b)
    return a if a is b else None


def _distributed(graph: Graph, a: Node, b: Node) -> Node | None:
    """Returns x for (x or y) and (x or not y), and for the same with `and` and `or` exchanged; else None."""
    for i, j in ((0, 0), (0, 1), (1, 0), (1, 1)):
        if a.args[i] is b.args[j] and a.args[1 - i] is graph.node(graph.op("not", b.args[1 - j])):
            return a.args[i]
    return None


def _simplified_comparison(graph: Graph, op: str, a: Node, b: Node) -> Any:
    if a is b:
        return graph.constant(_SAME[op])
    if _is(b, 0.0) and graph.sign(a):
        return graph.constant(bool(TRUTH[op](graph.sign(a), 0)))
    for chosen, other in ((a, b), (b, a)):
        if chosen.op == "select" and other.op == "const" and _known_leaves(chosen):
            sides = [graph.op(op, *((s, other) if chosen is a else (other, s))) for s in chosen.args[1:]]
            return graph.node(graph.select(chosen.args[0], *sides))
    if a.is_truth and b.op == "const":
        same = (op == "eq") == (b.value == 1.0)
        return a if same else graph.node(graph.op("not", a))
    return None


def _known_leaves(node: Node) -> bool:
    return all(arg.op == "const" or (arg.op == "select" and _known_leaves(arg)) for arg in node.args[1:])
