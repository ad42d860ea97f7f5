"""Elementary operations on placeholders: what the source of a loop becomes when its numbers are not known yet.

A `Node` is one operation on others. Equal operations are one node; what is known is computed at once, and only such
identities are used as hold for every finite number bit for bit, but for the sign of zero (x + 0, x * 1, x * 0).
"""

import math
import operator
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final

from canhaptic.errors import CanHapticError

if TYPE_CHECKING:
    from canhaptic.study.batch.graph import Graph


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

_CHANGING: Final = ("state", "array", "var", "input")
_ROWS: Final = ("array", "store", "fill")


class Node:
    """One operation; made by a `Graph` only.

    Attributes:
        op: Name of `NUMBER` or `TRUTH`; "select", "const", "param", "state" or "input"; of lists and loops (`rings`)
            "fill", "array", "store", "load", "loop", "var" and "out".
        args: Nodes it works on.
        value: Of a constant; name of a parameter, state or input.
        is_truth: Whether its result is a truth value.
        changes: Whether it depends on a state, so that it is to be computed in every cycle.
        number: Position in the order of making; arguments come before what uses them.
    """

    __slots__ = ("args", "changes", "graph", "is_truth", "number", "op", "value")

    def __init__(self, graph: "Graph", op: str, args: tuple["Node", ...], value: Any, is_truth: bool) -> None:
        self.graph, self.op, self.args, self.value, self.is_truth = graph, op, args, value, is_truth
        self.changes: bool = op in _CHANGING or any(arg.changes for arg in args)
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

    def _with(self, op: str, other: Any, *, swapped: bool = False) -> Any:
        if not isinstance(other, Node | float | int):
            return NotImplemented
        return self.graph.op(op, other, self) if swapped else self.graph.op(op, self, other)

    def __add__(self, other: Any) -> Any:
        """Returns self + other."""
        return self._with("add", other)

    def __radd__(self, other: Any) -> Any:
        """Returns other + self."""
        return self._with("add", other, swapped=True)

    def __sub__(self, other: Any) -> Any:
        """Returns self - other."""
        return self._with("sub", other)

    def __rsub__(self, other: Any) -> Any:
        """Returns other - self."""
        return self._with("sub", other, swapped=True)

    def __mul__(self, other: Any) -> Any:
        """Returns self * other."""
        return self._with("mul", other)

    def __rmul__(self, other: Any) -> Any:
        """Returns other * self."""
        return self._with("mul", other, swapped=True)

    def __truediv__(self, other: Any) -> Any:
        """Returns self / other."""
        return self._with("div", other)

    def __rtruediv__(self, other: Any) -> Any:
        """Returns other / self."""
        return self._with("div", other, swapped=True)

    def __floordiv__(self, other: Any) -> Any:
        """Returns self // other."""
        return self._with("floordiv", other)

    def __mod__(self, other: Any) -> Any:
        """Returns self % other."""
        return self._with("mod", other)

    def __pow__(self, exponent: Any) -> Any:
        """Returns the square, or the square root for an exponent of 0.5."""
        if exponent == 2:
            return self * self
        if exponent == 0.5:
            return self.graph.op("sqrt", self)
        raise NotBatchableError(f"power {exponent!r} of a placeholder, expected 2 or 0.5")

    def __neg__(self) -> Any:
        """Returns -self."""
        return self.graph.op("neg", self)

    def __abs__(self) -> Any:
        """Returns |self|."""
        return self.graph.op("abs", self)

    def __lt__(self, other: Any) -> Any:
        """Returns self < other."""
        return self._with("lt", other)

    def __le__(self, other: Any) -> Any:
        """Returns self <= other."""
        return self._with("le", other)

    def __gt__(self, other: Any) -> Any:
        """Returns self > other."""
        return self._with("gt", other)

    def __ge__(self, other: Any) -> Any:
        """Returns self >= other."""
        return self._with("ge", other)

    def __eq__(self, other: Any) -> Any:
        """Returns self == other, as a node; identity is asked for with `is`."""
        return self._with("eq", other)

    def __ne__(self, other: Any) -> Any:
        """Returns self != other, as a node."""
        return self._with("ne", other)

    @property
    def is_rows(self) -> bool:
        """Whether it stands for the rows of a list and not for a number."""
        return self.op in _ROWS
