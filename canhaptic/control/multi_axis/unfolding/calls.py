"""Calls that are written out: Python's own functions on numbers, and the loops over states compiled as they are."""

import math
from collections.abc import Callable, Sequence
from typing import Any

from canhaptic.control.multi_axis.unfolding.source_writer import Frame
from canhaptic.control.multi_axis.unfolding.unfolded_expressions import Expressions
from canhaptic.control.multi_axis.unfolding.values import (
    Array,
    CannotUnfoldError,
    Cell,
    Maybe,
    Span,
    Var,
    is_plain,
    is_scalar,
    kind_of,
    text_of,
)
from canhaptic.control.port_hamiltonian.discrete_gradient import NetworkTables
from canhaptic.control.port_hamiltonian.equation import Workspace


class Calls(Expressions):
    """What is called by name."""

    def known_call(self, function: Any) -> Callable[..., Any] | None:
        """Returns how a function of Python is written; None for any other."""
        table: dict[Any, Callable[..., Any]] = {
            len: self._len, range: self._range, zip: self._zip, enumerate: self._enumerate, tuple: self._as_tuple,
            list: self._as_list, sum: self._sum, min: self._least, max: self._most, any: self._any, all: self._all,
            abs: self._abs, int: self._int, float: self._float, bool: self._bool, math.sqrt: self._of_math("sqrt"),
            math.sin: self._of_math("sin"), math.cos: self._of_math("cos"), math.exp: self._of_math("exp"),
            math.isfinite: self._finite, math.hypot: self._hypot, math.fsum: self._fsum,
        }  # fmt: skip
        return table.get(function)

    def opaque(self, name: str, args: Sequence[Any], kind: str) -> Any:
        """Writes a call of a function that is compiled as it is; returns its result, None where it has none."""
        text = f"{name}({', '.join(self._argument(arg) for arg in args)})"
        if kind == "None":
            self.writer.write(text)
            return None
        return self.writer.computed(text, kind)

    def _argument(self, value: Any) -> str:
        if isinstance(value, NetworkTables):
            return "tables"
        if isinstance(value, Workspace):
            return "room"
        if isinstance(value, Array):
            return value.name
        if value is None:
            return "None"
        if is_scalar(value):
            return text_of(value)
        if isinstance(value, (tuple, Cell)):
            entries = self.writer.state.lists[value] if isinstance(value, Cell) else value
            return f"({' '.join(f'{_number(entry)},' for entry in entries)})"
        raise CannotUnfoldError(f"compiled: {value!r} cannot be handed over")

    def _walked(self, value: Any, frame: Frame) -> list[Any]:
        return self.items(value, frame)

    def _len(self, frame: Frame, value: Any) -> Any:
        return value.shape[0] if isinstance(value, Array) else len(self.items(value, frame))

    def _range(self, frame: Frame, *ends: Any) -> Any:
        if not any(isinstance(end, Var) for end in ends):
            return range(*ends)
        if len(ends) > 2:
            raise CannotUnfoldError(f"compiled: {frame.where}: a range with a step has no form of plain numbers")
        return Span(*ends) if len(ends) == 2 else Span(0, ends[0])

    def _zip(self, frame: Frame, *values: Any, strict: bool = False) -> Any:
        return list(zip(*[self.items(value, frame) for value in values], strict=strict))

    def _enumerate(self, frame: Frame, value: Any) -> Any:
        return list(enumerate(self.items(value, frame)))

    def _as_tuple(self, frame: Frame, value: Any = ()) -> Any:
        return tuple(self.items(value, frame))

    def _as_list(self, frame: Frame, value: Any = ()) -> Any:
        return self.cell(self.items(value, frame))

    def _sum(self, frame: Frame, value: Any) -> Any:
        total: Any = 0
        for entry in self.items(value, frame):
            total = self.add(total, entry)
        return total

    def add(self, a: Any, b: Any) -> Any:
        """Returns a sum."""
        if not isinstance(a, Var) and not isinstance(b, Var):
            return a + b
        return self.writer.computed(f"{_number(a)} + {_number(b)}", "float")

    def _least(self, frame: Frame, *values: Any) -> Any:
        return self._outermost(frame, values, "<")

    def _most(self, frame: Frame, *values: Any) -> Any:
        return self._outermost(frame, values, ">")

    def _outermost(self, frame: Frame, values: Sequence[Any], sign: str) -> Any:
        entries = self.items(values[0], frame) if len(values) == 1 else list(values)
        if not entries or isinstance(entries[0], Maybe):
            raise CannotUnfoldError(f"compiled: {frame.where}: min or max may have nothing to choose from")
        found = entries[0]
        for entry in entries[1:]:
            condition = "" if not isinstance(entry, Maybe) else f"{entry.condition.name} and "
            value = entry.value if isinstance(entry, Maybe) else entry
            if not isinstance(found, Var) and not isinstance(value, Var) and not condition:
                found = (min if sign == "<" else max)(found, value)
                continue
            floating = "float" in (kind_of(found), kind_of(value))
            text = f"{text_of(value)} if {condition}{text_of(value)} {sign} {text_of(found)} else {text_of(found)}"
            found = self.writer.computed(text, "float" if floating else "int")
        return found

    def _any(self, frame: Frame, value: Any) -> Any:
        return self._quantified([self.truth(v) for v in self.items(value, frame)], True)

    def _all(self, frame: Frame, value: Any) -> Any:
        return self._quantified([self.truth(v) for v in self.items(value, frame)], False)

    def _quantified(self, truths: list[Any], decisive: bool) -> Any:
        unknown = [truth for truth in truths if isinstance(truth, Var)]
        if decisive in [truth for truth in truths if not isinstance(truth, Var)]:
            return decisive
        if not unknown:
            return not decisive
        return self.writer.computed((" or " if decisive else " and ").join(t.name for t in unknown), "bool")

    def _abs(self, _frame: Frame, value: Any) -> Any:
        return self.writer.computed(f"abs({value.name})", value.kind) if isinstance(value, Var) else abs(value)

    def _int(self, _frame: Frame, value: Any) -> Any:
        return self.writer.computed(f"int({value.name})", "int") if isinstance(value, Var) else int(value)

    def _float(self, _frame: Frame, value: Any) -> Any:
        return self.writer.computed(f"float({value.name})", "float") if isinstance(value, Var) else float(value)

    def _bool(self, _frame: Frame, value: Any) -> Any:
        return self.truth(value)

    def _finite(self, _frame: Frame, value: Any) -> Any:
        return (
            self.writer.computed(f"abs({value.name}) < inf", "bool") if isinstance(value, Var) else math.isfinite(value)
        )

    def _of_math(self, name: str) -> Callable[..., Any]:
        def written(_frame: Frame, value: Any) -> Any:
            if is_plain(value):
                return getattr(math, name)(value)
            return self.writer.computed(f"{name}({text_of(value)})", "float")

        return written

    def _hypot(self, _frame: Frame, *values: Any) -> Any:
        if is_plain(values):
            return math.hypot(*values)
        if len(values) == 1:
            return self._abs(_frame, values[0])
        if len(values) == 2:
            return self.writer.computed(f"hypot({_number(values[0])}, {_number(values[1])})", "float")
        return self.writer.computed(f"length_of({self._argument(values)})", "float")

    def _fsum(self, frame: Frame, value: Any) -> Any:
        entries = tuple(self.items(value, frame))
        return (
            math.fsum(entries)
            if is_plain(entries)
            else self.writer.computed(f"exact_sum({self._argument(entries)})", "float")
        )


def _number(value: Any) -> str:
    """Returns a number as a float is written."""
    text = text_of(value)
    if isinstance(value, Var):
        return text if value.kind == "float" else f"float({text})"
    return repr(float(value)) if isinstance(value, int) else text
