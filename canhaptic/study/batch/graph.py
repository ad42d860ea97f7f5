"""Nodes by what they are: equal operations are one, what is known is computed at once, and what can be simpler is."""

from typing import Any

from canhaptic.study.batch.nodes import NUMBER, TRUTH, Node, NotBatchableError
from canhaptic.study.batch.rules import extreme, plain, simplified


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
        simpler = simplified(self, op, args)
        if simpler is not None:
            return plain(simpler)
        return self._node(op, args, None, op in TRUTH)

    def select(self, condition: Any, yes: Any, no: Any) -> Any:
        """Returns `yes` where the condition holds, else `no`."""
        if not isinstance(condition, Node):
            return yes if condition else no
        a, b = self.node(yes), self.node(no)
        if a is b or (a.op == b.op == "const" and a.value == b.value and a.is_truth == b.is_truth):
            return plain(a)
        if condition.op == "not":
            return self.select(condition.args[0], no, yes)
        if a.is_truth and b.is_truth:
            return self._select_truth(condition, a, b)
        if a.op == "select" and a.args[0] is condition:
            a = a.args[1]
        if b.op == "select" and b.args[0] is condition:
            b = b.args[2]
        largest = extreme(condition, a, b)
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
