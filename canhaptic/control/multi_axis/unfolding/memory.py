"""Where the state of a controller is: in its objects, or in the array of the compiled step, and the way between."""

import ast
import inspect
import textwrap
from collections import deque
from functools import cache
from math import inf
from typing import Any, NamedTuple

import numpy as np

from canhaptic.control.multi_axis.unfolding.values import Array, CannotUnfoldError, Cell, Var, is_plain

_PACKAGE = "canhaptic."


class Slot(NamedTuple):
    """An attribute that changes: its numbers are consecutive entries."""

    owner: Any
    name: str
    first: int
    kinds: tuple[str, ...]
    example: Any  # of the shape in which it is kept


class Block(NamedTuple):
    """A list of numbers that is read and written in place."""

    owner: Any
    name: str
    first: int
    shape: tuple[int, ...]
    array: Array


class Memory:
    """The layout of the array, filled while the source is unfolded."""

    def __init__(self) -> None:
        self.size = 0
        self.slots: dict[tuple[int, str], Slot] = {}
        self.blocks: dict[int, Block] = {}
        self.parameters: dict[int, float] = {}
        self._lifted: dict[tuple[int, str], tuple[Any, Any]] = {}

    def take(self, count: int) -> int:
        """Returns the first of some free entries."""
        first, self.size = self.size, self.size + count
        return first

    def add_block(self, owner: Any, name: str, shape: tuple[int, ...]) -> None:
        """Keeps a list of the controller in the array."""
        value, count = getattr(owner, name), int(np.prod(shape))
        label = f"{type(owner).__name__.lower()}_{name.strip('_')}_{len(self.blocks)}"
        self.blocks[id(value)] = Block(owner, name, self.take(count), shape, Array(label, shape))

    def add_slot(self, owner: Any, name: str, example: Any) -> Slot:
        """Keeps an attribute in the array, in the shape of an example."""
        kinds = tuple(_kind(leaf) for leaf in leaves(example))
        slot = self.slots[id(owner), name] = Slot(owner, name, self.take(len(kinds)), kinds, example)
        return slot

    def lifted(self, owner: Any, name: str, value: Any) -> Any:
        """Returns a value with its parameters as entries of the array, so that other values need no other source.

        Zeros, ones and infinities stay: they say what is there at all.
        """
        if type(value) not in (float, tuple, list) or not is_plain(value):
            return value
        key = (id(owner), name)
        if key not in self._lifted:
            self._lifted[key] = (owner, self._of_parameters(value))  # the owner stays, and its identity with it
        return self._lifted[key][1]

    def _of_parameters(self, value: Any) -> Any:
        if type(value) in (tuple, list):
            return type(value)(self._of_parameters(entry) for entry in value)
        if type(value) is not float or value in _TELLING:
            return value
        first = self.take(1)
        self.parameters[first] = value
        return Var(f"s{first}", "float", True)

    def store(self, numbers: Any) -> bool:
        """Takes the state from the objects; returns False where an attribute has another shape than it is kept in."""
        for slot in self.slots.values():
            value = getattr(slot.owner, slot.name, _ABSENT)
            if value is _ABSENT or not same_shape(slot.example, value):
                return False
            if slot.kinds:
                numbers[slot.first : slot.first + len(slot.kinds)] = list(leaves(value))
        for block in self.blocks.values():
            value = np.array(getattr(block.owner, block.name), dtype=float).ravel()
            numbers[block.first : block.first + value.size] = value
        return True

    def restore(self, numbers: Any) -> None:
        """Gives the state back to the objects."""
        for slot in self.slots.values():
            found = numbers[slot.first : slot.first + len(slot.kinds)].tolist()
            values = iter([_TYPES[kind](v) for kind, v in zip(slot.kinds, found, strict=True)])
            setattr(slot.owner, slot.name, _rebuilt(slot.example, values))
        for block in self.blocks.values():
            _fill(getattr(block.owner, block.name), numbers[block.first : block.first + int(np.prod(block.shape))])


_CHANGING: dict[type, frozenset[str]] = {}
_ABSENT = object()
_TELLING = (0.0, 1.0, -1.0, inf, -inf)
_TYPES = {"float": float, "int": int, "bool": bool}


def _kind(leaf: Any) -> str:
    return "bool" if isinstance(leaf, bool) else "int" if isinstance(leaf, int) else "float"


def _fill(into: list[Any], numbers: Any) -> None:
    if into and isinstance(into[0], list):
        width = len(into[0])
        for i, row in enumerate(into):
            row[:] = numbers[i * width : (i + 1) * width].tolist()
    else:
        into[:] = numbers.tolist()


def leaves(value: Any) -> Any:
    """Yields the numbers in nested tuples, lists and queues; None has none."""
    if isinstance(value, (tuple, list, deque)):
        for entry in value:
            yield from leaves(entry)
    elif isinstance(value, (float, int)):
        yield value
    elif value is not None:
        raise CannotUnfoldError(f"compiled: state {value!r} is no number, tuple, list or queue of numbers")


def same_shape(one: Any, other: Any) -> bool:
    """Returns True where two values nest alike."""
    if isinstance(one, (tuple, list, deque)):
        return (
            type(one) is type(other)
            and len(one) == len(other)
            and all(same_shape(a, b) for a, b in zip(one, other, strict=True))
        )
    return (one is None) == (other is None) and not isinstance(other, (tuple, list, deque))


def _rebuilt(example: Any, numbers: Any) -> Any:
    if isinstance(example, tuple):
        values = [_rebuilt(entry, numbers) for entry in example]
        return type(example)(*values) if hasattr(example, "_fields") else tuple(values)
    if isinstance(example, (list, deque)):
        return type(example)(_rebuilt(entry, numbers) for entry in example)
    return None if example is None else next(numbers)


def loaded(slot: Slot, lists: dict[Cell, list[Any]]) -> Any:
    """Returns the value of an attribute at the start of a step; its lists are new ones."""
    numbers = iter([Var(f"s{slot.first + i}", kind) for i, kind in enumerate(slot.kinds)])

    def of(example: Any) -> Any:
        if isinstance(example, tuple):
            values = [of(entry) for entry in example]
            return type(example)(*values) if hasattr(example, "_fields") else tuple(values)
        if isinstance(example, (list, deque)):
            cell = Cell()
            lists[cell] = [of(entry) for entry in example]
            return cell
        return None if example is None else next(numbers)

    return of(slot.example)


@cache
def source_of(function: Any) -> ast.FunctionDef:
    """Returns the source of a function of this package.

    Raises:
        CannotUnfoldError: It belongs to somebody else, or has no source.
    """
    name = f"{function.__module__}.{function.__qualname__}"
    if not function.__module__.startswith(_PACKAGE):
        raise CannotUnfoldError(f"compiled: {name} is a function of one's own")
    try:
        parsed = ast.parse(textwrap.dedent(inspect.getsource(function))).body[0]
    except (OSError, SyntaxError) as error:
        raise CannotUnfoldError(f"compiled: {name} has no source ({error})") from error
    if not isinstance(parsed, ast.FunctionDef):
        raise CannotUnfoldError(f"compiled: {name} is no function with a name")
    return parsed


def changing(owner: type) -> frozenset[str]:
    """Returns the attributes that the methods of a class assign, but for those that make it."""
    if owner in _CHANGING:
        return _CHANGING[owner]
    names = set()
    for base in owner.__mro__:
        if not base.__module__.startswith(_PACKAGE):
            continue
        tree = ast.parse(textwrap.dedent(inspect.getsource(base))).body[0]
        assert isinstance(tree, ast.ClassDef)
        for method in tree.body:
            if isinstance(method, ast.FunctionDef) and method.name not in ("__init__", "model_post_init"):
                names |= {
                    node.attr for node in ast.walk(method)
                    if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store)
                    and isinstance(node.value, ast.Name) and node.value.id == "self"
                }  # fmt: skip
    _CHANGING[owner] = frozenset(names)
    return _CHANGING[owner]
