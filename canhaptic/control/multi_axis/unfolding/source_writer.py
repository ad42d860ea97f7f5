"""Lines of the function that is written, the state at the place where it has come to, and how two branches join."""

from collections.abc import Callable
from typing import Any

from canhaptic.control.multi_axis.unfolding.values import (
    DEAD,
    MIXED,
    CannotUnfoldError,
    Cell,
    Mixed,
    Var,
    as_kind,
    is_scalar,
    kind_of,
    text_of,
)

_BAIL = "return False"


class State:
    """Attributes and lists at one place of the function."""

    def __init__(self) -> None:
        self.attributes: dict[tuple[int, str], Any] = {}
        self.lists: dict[Cell, list[Any]] = {}

    def copy(self) -> "State":
        """Returns one that can change without this one."""
        twin = State()
        twin.attributes = dict(self.attributes)
        twin.lists = {cell: list(entries) for cell, entries in self.lists.items()}
        return twin


class Frame:
    """A function being unfolded."""

    def __init__(self, names: dict[str, Any], outer: dict[str, Any], where: str) -> None:
        self.names, self.outer, self.where = names, outer, where


class Writer:
    """The function as far as it is written."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.state = State()
        self._count = 0

    def fresh(self, kind: str) -> Var:
        """Returns a name that is not in use."""
        self._count += 1
        return Var(f"v{self._count}", kind)

    def write(self, line: str) -> None:
        """Adds a line."""
        self.lines.append(line)

    def computed(self, text: str, kind: str) -> Var:
        """Writes the computation of a number and returns it."""
        found = self.fresh(kind)
        self.write(f"{found.name} = {text}")
        return found

    def bail(self) -> Any:
        """Leaves this step to the interpreted controller."""
        self.write(_BAIL)
        return DEAD

    def branch(self, condition: Var, one: Callable[[], Any], other: Callable[[], Any], frame: Frame) -> Any:
        """Writes both sides of a branch and joins what they leave behind; returns the joined result."""
        lines, names, state = self.lines, dict(frame.names), self.state.copy()
        first: list[str] = []
        self.lines = first
        results = [one()]
        ends = [(frame.names, self.state)]
        frame.names, self.state, self.lines = names, state, []
        results.append(other())
        ends.append((frame.names, self.state))
        sides = [first, self.lines]
        self.lines = lines
        self._leave_shapeless(sides, results, ends)
        dead = [result is DEAD for result in results]
        if dead[0] or dead[1]:
            flip = dead[1] and not dead[0]
            live = 0 if flip else 1
            test = f"not {condition.name}" if flip else condition.name
            self._nest(f"if {test}:", sides[1 - live])
            self.lines += sides[live]
            frame.names, self.state = ends[live]
            return results[live]
        result = self._join(sides, results, ends, frame)
        if sides[0] or sides[1]:
            self._nest(f"if {condition.name}:", sides[0] or ["pass"])
        if sides[1]:
            self._nest("else:", sides[1])
        return result

    def _nest(self, head: str, body: list[str]) -> None:
        self.lines += [head, *(f" {line}" for line in body)]

    def nest(self, head: str, body: list[str]) -> None:
        """Adds a block."""
        self._nest(head, body or ["pass"])

    def _leave_shapeless(self, sides: list[list[str]], results: list[Any], ends: list[Any]) -> None:
        """Lets the interpreted controller make the steps of a side that leaves None where the other has numbers."""
        if DEAD in results:
            return
        one, other = ends[0][1].attributes, ends[1][1].attributes
        pairs = [(one[key], other[key]) for key in one.keys() & other.keys()] + [(results[0], results[1])]
        for a, b in pairs:
            if (a is None) != (b is None):
                side = 0 if a is None else 1
                sides[side][:], results[side] = [_BAIL], DEAD
                return

    def _join(self, sides: list[list[str]], results: list[Any], ends: list[Any], frame: Frame) -> Any:
        (names, state), (other_names, other) = ends
        lists = {cell: state.lists.get(cell, other.lists.get(cell)) for cell in {**state.lists, **other.lists}}
        self.state = joined = State()
        joined.lists = lists
        done: dict[tuple[Any, Any], Any] = {}

        def join(a: Any, b: Any) -> Any:
            return self._joined(a, b, sides, (state.lists, other.lists), done)

        for cell in list(state.lists.keys() & other.lists.keys()):
            if state.lists[cell] is not other.lists[cell]:
                lists[cell] = self._joined_entries(state.lists[cell], other.lists[cell], join)
        for key in {**state.attributes, **other.attributes}:
            joined.attributes[key] = value = join(state.attributes[key], other.attributes[key])
            if isinstance(value, Mixed):
                raise CannotUnfoldError(f"compiled: attribute {key[1]} has another shape by branch")
        frame.names = {
            name: join(names[name], other_names[name]) if name in names and name in other_names else MIXED
            for name in {**names, **other_names}
        }
        result = join(results[0], results[1])
        if isinstance(result, Mixed):
            raise CannotUnfoldError(f"compiled: {frame.where} returns values of different shapes")
        return result

    def _joined_entries(self, one: list[Any], other: list[Any], join: Callable[[Any, Any], Any]) -> list[Any]:
        if len(one) != len(other):
            raise CannotUnfoldError("compiled: a list has another length by branch")
        return [join(a, b) for a, b in zip(one, other, strict=True)]

    def _joined(self, a: Any, b: Any, sides: list[list[str]], lists: Any, done: dict[Any, Any]) -> Any:
        if a is b:
            return a
        if is_scalar(a) and is_scalar(b):
            return self._joined_scalars(a, b, sides, done)
        if isinstance(a, Cell) and isinstance(b, Cell):
            if len(lists[0][a]) != len(lists[1][b]):
                return MIXED
            entries = [self._joined(x, y, sides, lists, done) for x, y in zip(lists[0][a], lists[1][b], strict=True)]
            cell = Cell()
            self.state.lists[cell] = entries
            return cell
        if isinstance(a, tuple) and type(a) is type(b) and len(a) == len(b) and not isinstance(a, Var):
            values = [self._joined(x, y, sides, lists, done) for x, y in zip(a, b, strict=True)]
            return type(a)(*values) if hasattr(a, "_fields") else tuple(values)
        return a if type(a) is type(b) and isinstance(a, str) and a == b else MIXED

    def _joined_scalars(self, a: Any, b: Any, sides: list[list[str]], done: dict[Any, Any]) -> Any:
        texts = (text_of(a), text_of(b))
        if texts[0] == texts[1] and kind_of(a) == kind_of(b):
            return a
        if texts not in done:
            kinds = {kind_of(a), kind_of(b)}
            done[texts] = found = self.fresh("float" if "float" in kinds else "int" if "int" in kinds else "bool")
            for side, value in zip(sides, (a, b), strict=True):
                side.append(f"{found.name} = {as_kind(value, found.kind)}")
        return done[texts]
