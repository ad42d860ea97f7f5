"""Comparisons of which one more or one less case changes nothing: `a if a > b else b` is `a if a >= b else b`.

Of `<` and `<=`, `>` and `>=` the mutator makes no mutant where both ways out of the comparison are the same program for
two equal numbers. Numbers are finite here, and the sign of zero does not count. `losses == 0` is `losses <= 0` as well.
"""

import ast
import copy
from typing import Final

EDGES: Final[dict[type[ast.cmpop], type[ast.cmpop]]] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt
}  # fmt: skip
"""Each order and the one that differs from it for equal numbers alone."""
_NEVER_NEGATIVE: Final = frozenset({
    "losses", "late", "damping", "friction", "hand_speed", "encoder_count", "missed", "counts", "hand", "squares",
    "net", "differs",
})  # fmt: skip
"""Names of counts and sizes, which no setting and no sum takes below zero."""


def same_at_the_edge(statement: ast.stmt, following: ast.stmt | None) -> list[ast.Compare]:
    """Returns the comparisons of a statement, without the block below it, whose edge changes nothing.

    Args:
        statement: Of a module.
        following: The one behind it in its block; None where it is the last.
    """
    found = []
    for node in ast.walk(statement) if not hasattr(statement, "body") else _heads(statement):
        if isinstance(node, ast.IfExp):
            found += [test for test in _orders(node.test) if _value(node.body, test) == _value(node.orelse, test)]
    if isinstance(statement, ast.If):
        found += [test for test in _orders(statement.test) if _changes_nothing(statement, following, test)]
    return found


def same_for_a_size(node: ast.Compare, other: type[ast.cmpop]) -> bool:
    """Whether an order that takes the place of a comparison with 0 says the same of a size, or of a sign, 1 or -1."""
    if len(node.ops) != 1 or not _is(node.comparators[0], 0):
        text = isinstance(node.comparators[0], ast.Constant) and isinstance(node.comparators[0].value, str)
        if text:  # of which none comes before another
            return other in EDGES
        return isinstance(node.ops[0], ast.Eq) and other is ast.GtE and ast.unparse(node.comparators[0]) == "inf"
    name = node.left.attr if isinstance(node.left, ast.Attribute) else ast.unparse(node.left)
    if name == "sign":
        return other is EDGES.get(type(node.ops[0]))
    is_size = name in _NEVER_NEGATIVE
    return is_size and (type(node.ops[0]), other) in ((ast.Eq, ast.LtE), (ast.NotEq, ast.Gt))


def _heads(statement: ast.stmt) -> list[ast.AST]:
    below = {"body", "orelse"}
    fields = [value for name, value in ast.iter_fields(statement) if name not in below]
    return [node for value in fields if isinstance(value, ast.AST) for node in ast.walk(value)]


def _orders(test: ast.expr) -> list[ast.Compare]:
    """The comparisons that decide a test, alone or together with others."""
    parts = test.values if isinstance(test, ast.BoolOp) else [test]
    return [
        part for part in parts if isinstance(part, ast.Compare) and len(part.ops) == 1 and type(part.ops[0]) in EDGES
    ]


def _changes_nothing(statement: ast.If, following: ast.stmt | None, test: ast.Compare) -> bool:
    """Whether both ways of a statement are the same where its test is one of equal numbers."""
    if len(statement.orelse) > 1:
        return False
    way = statement.body[0]
    if len(statement.body) > 1:
        return not statement.orelse and all(_effect(each, test) == "nothing" for each in statement.body)
    if isinstance(way, ast.Return):
        other = statement.orelse[0] if statement.orelse else following
        return isinstance(other, ast.Return) and _result(way, test) == _result(other, test)
    if not isinstance(way, ast.Assign | ast.AugAssign):
        return False
    if statement.orelse:
        other = statement.orelse[0]
        return type(other) is type(way) and _effect(way, test) == _effect(other, test) != ""
    return _effect(way, test) == "nothing"


def _result(statement: ast.Return, test: ast.Compare) -> str:
    return _value(statement.value, test) if statement.value else ""


def _effect(statement: ast.stmt, test: ast.Compare) -> str:
    """What an assignment does; "" where that is not known."""
    if isinstance(statement, ast.Assign) and len(statement.targets) == 1:
        target, value = _value(statement.targets[0], test), _value(statement.value, test)
        return "nothing" if target == value else f"{ast.unparse(statement.targets[0])} = {value}"
    if isinstance(statement, ast.AugAssign) and isinstance(statement.op, ast.Add | ast.Sub):
        return "nothing" if _value(statement.value, test) == "0" else ""
    return ""


def _value(node: ast.expr, test: ast.Compare) -> str:
    """The text of an expression for equal numbers, without what is added or multiplied by nothing."""
    one, other = test.left, test.comparators[0]
    if isinstance(one, ast.Constant):
        one, other = other, one
    return ast.unparse(_Equal(one, other).visit(copy.deepcopy(node)))


class _Equal(ast.NodeTransformer):
    """Puts one expression in the place of another, and takes out what that makes zero."""

    def __init__(self, old: ast.expr, new: ast.expr) -> None:
        self._old, self._new = ast.unparse(old), new

    def visit(self, node: ast.AST) -> ast.AST:
        if isinstance(node, ast.expr) and ast.unparse(node) == self._old:
            return self.visit_Constant(self._new) if isinstance(self._new, ast.Constant) else self._new
        found: ast.AST = super().visit(node)
        return found

    def visit_Constant(self, node: ast.Constant) -> ast.Constant:
        """Writes whole numbers of both types in one way."""
        is_whole = isinstance(node.value, float) and node.value.is_integer()
        return ast.Constant(int(node.value)) if is_whole and isinstance(node.value, float) else node

    def visit_UnaryOp(self, node: ast.UnaryOp) -> ast.AST:
        self.generic_visit(node)
        return node.operand if isinstance(node.op, ast.USub) and _is(node.operand, 0) else node

    def visit_Call(self, node: ast.Call) -> ast.AST:
        """Takes the one argument of `max` and `min` whose arguments are all the same."""
        self.generic_visit(node)
        is_same = len({ast.unparse(each) for each in node.args}) == 1
        return node.args[0] if is_same and ast.unparse(node.func) in ("max", "min") else node

    def visit_BinOp(self, node: ast.BinOp) -> ast.AST:
        self.generic_visit(node)
        left, right, operator = node.left, node.right, node.op
        is_product, is_sum = isinstance(operator, ast.Mult), isinstance(operator, ast.Add)
        is_difference, is_quotient = isinstance(operator, ast.Sub), isinstance(operator, ast.Div)
        if ((is_sum or is_difference) and _is(right, 0)) or ((is_product or is_quotient) and _is(right, 1)):
            return left
        if (is_sum and _is(left, 0)) or (is_product and _is(left, 1)):
            return right
        is_nothing = is_product and (_is(left, 0) or _is(right, 0))
        is_nothing |= is_difference and ast.unparse(left) == ast.unparse(right)
        return ast.Constant(0) if is_nothing or (is_quotient and _is(left, 0)) else node


def _is(node: ast.expr, number: int) -> bool:
    return isinstance(node, ast.Constant) and node.value == number and not isinstance(node.value, bool)
