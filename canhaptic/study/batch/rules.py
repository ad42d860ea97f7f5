"""Simpler forms of an operation, of those that hold for every finite number bit for bit, but for the sign of zero."""

from typing import TYPE_CHECKING, Any, Final

from canhaptic.study.batch.nodes import TRUTH, Node

if TYPE_CHECKING:
    from canhaptic.study.batch.graph import Graph

_SAME: Final = {"lt": False, "le": True, "gt": False, "ge": True, "eq": True, "ne": False}
"""Comparison -> what it says of a number and itself."""


def plain(node: Any) -> Any:
    """Returns the value of a constant, else the node."""
    return node.value if isinstance(node, Node) and node.op == "const" else node


def extreme(condition: Node, a: Node, b: Node) -> str:
    """Returns "max" or "min" where the selection is one of its two operands by their order, else ""."""
    if condition.op in ("gt", "lt") and {*condition.args} == {a, b} and not a.is_truth:
        return "max" if (condition.op == "gt") == (condition.args[0] is a) else "min"
    return ""


def _is(node: Node, value: float) -> bool:
    return node.op == "const" and not node.is_truth and node.value == value


def simplified(graph: "Graph", op: str, args: tuple[Node, ...]) -> Any:
    """Returns a simpler result of an operation, or None where there is none."""
    if op in ("and", "or", "not"):
        return _not(args[0]) if op == "not" else _simplified_truth(graph, op, args[0], args[1])
    if op in _SAME:
        return _simplified_comparison(graph, op, args[0], args[1])
    if op == "neg" == args[0].op:
        return args[0].args[0]
    found = _with_known(graph, op, args[0], args[1]) if len(args) == 2 else None
    if found is None and len(args) == 2:
        found = _with_sign(graph, op, args[0], args[1])
    return _pushed(graph, op, args) if found is None else found


def _with_known(graph: "Graph", op: str, a: Node, b: Node) -> Any:
    """Returns x + 0, x * 1, x * 0, x - x and their like."""
    if (op in ("add", "sub") and _is(b, 0.0)) or (op in ("mul", "div") and _is(b, 1.0)):
        return a
    if (op == "add" and _is(a, 0.0)) or (op == "mul" and _is(a, 1.0)):
        return b
    if (op == "mul" and (_is(a, 0.0) or _is(b, 0.0))) or (op == "div" and _is(a, 0.0)) or (op == "sub" and a is b):
        return graph.constant(0.0)
    if op == "sub" and _is(a, 0.0):
        return graph.node(graph.op("neg", b))
    return a if a is b and op in ("max", "min") else None


def _with_sign(graph: "Graph", op: str, a: Node, b: Node) -> Any:
    """Returns sums and products with the signs taken out of them."""
    if op in ("mul", "div") and "neg" in (a.op, b.op):
        result = graph.op(op, *(arg.args[0] if arg.op == "neg" else arg for arg in (a, b)))
        return graph.node(graph.op("neg", result) if (a.op == "neg") != (b.op == "neg") else result)
    if op in ("add", "sub") and b.op == "neg":
        return graph.node(graph.op("sub" if op == "add" else "add", a, b.args[0]))
    return graph.node(graph.op("sub", b, a.args[0])) if op == "add" and a.op == "neg" else None


def _not(a: Node) -> Node | None:
    return a.args[0] if a.op == "not" else None


def _pushed(graph: "Graph", op: str, args: tuple[Node, ...]) -> Any:
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


def _simplified_truth(graph: "Graph", op: str, a: Node, b: Node) -> Any:
    for first, second in ((a, b), (b, a)):
        found = _absorbed(graph, op, first, second)
        if found is not None:
            return found
    if a.op == b.op and a.op in ("and", "or") and a.op != op:
        return _distributed(graph, a, b)
    return a if a is b else None


def _absorbed(graph: "Graph", op: str, first: Node, second: Node) -> Any:
    """Returns what one operand makes of the other: known, its contrary, or part of it."""
    if first.op == "const":
        return second if first.value == (op == "and") else first
    if second.op == "not" and second.args[0] is first:
        return graph.constant(op == "or")
    if second.op not in ("and", "or"):
        return None
    if any(arg is first for arg in second.args):
        return first if second.op != op else second
    contrary = graph.node(graph.op("not", first))
    for i, arg in enumerate(second.args):
        if arg is contrary and second.op != op:  # a or (not a and c) is a or c
            return graph.node(graph.op(op, first, second.args[1 - i]))
    return None


def _distributed(graph: "Graph", a: Node, b: Node) -> Node | None:
    """Returns x for (x or y) and (x or not y), and for the same with `and` and `or` exchanged; else None."""
    for i, j in ((0, 0), (0, 1), (1, 0), (1, 1)):
        if a.args[i] is b.args[j] and a.args[1 - i] is graph.node(graph.op("not", b.args[1 - j])):
            return a.args[i]
    return None


def _simplified_comparison(graph: "Graph", op: str, a: Node, b: Node) -> Any:
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
