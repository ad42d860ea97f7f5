"""The objects that the interpreted source changes: remembered, put back, and joined after a branch on data."""

from collections import deque
from collections.abc import Callable, Iterator
from typing import Any, Final, NamedTuple

from canhaptic.study.batch.graph import Graph
from canhaptic.study.batch.nodes import Node, NotBatchableError
from canhaptic.study.batch.rings import latest

_CONTAINERS: Final = (deque, list, dict)
_MISSING: Final = object()


class Maybe(NamedTuple):
    """A number that is None where a condition does not hold."""

    present: Node
    value: Any


def attributes(instance: object) -> dict[str, Any]:
    """Returns the attributes that an instance has, by name."""
    names = list(getattr(instance, "__dict__", ()))
    for kind in type(instance).__mro__:
        slots = kind.__dict__.get("__slots__", ())
        names += [slots] if isinstance(slots, str) else list(slots)
    found = {name: getattr(instance, name, _MISSING) for name in sorted(set(names))}
    return {name: value for name, value in found.items() if value is not _MISSING}


class Snapshot(NamedTuple):
    """Everything that a branch may change."""

    attributes: list[dict[str, Any]]
    contents: dict[int, tuple[Any, Any]]  # id -> (container, copy)


class Heap:
    """The instances that interpreted source made, in the order of making."""

    def __init__(self, graph: Graph) -> None:
        self._graph = graph
        self.instances: list[object] = []

    def save(self) -> Snapshot:
        """Returns what all attributes and containers hold now."""
        held = [attributes(instance) for instance in self.instances]
        contents = {}
        for values in held:
            for value in values.values():
                if isinstance(value, _CONTAINERS):
                    contents[id(value)] = (value, value.copy())
        return Snapshot(held, contents)

    def restore(self, saved: Snapshot) -> None:
        """Goes back to what was saved."""
        for instance, values in zip(self.instances, saved.attributes, strict=False):
            for name, value in values.items():
                object.__setattr__(instance, name, value)
        for container, copy in saved.contents.values():
            _fill(container, copy)

    def join(self, condition: Node, yes: Snapshot, no: Snapshot) -> None:
        """Leaves everything as in `yes` where the condition holds, and as in `no` elsewhere."""
        for instance, a, b in zip(self.instances, yes.attributes, no.attributes, strict=False):
            for name, value in a.items():
                object.__setattr__(instance, name, self.joined(condition, value, b.get(name, value), name))
        for key, (container, copy) in yes.contents.items():
            other = no.contents.get(key, (container, copy))[1]
            if isinstance(copy, dict):
                container.clear()  # a memo: what is computed anew is the same
            else:
                _fill(container, self._items(condition, list(copy), list(other), "a container"))

    def joined(self, condition: Node, a: Any, b: Any, name: str) -> Any:
        """Returns one value for two branches.

        Raises:
            NotBatchableError: They are of different kinds.
        """
        if isinstance(a, Node) and isinstance(b, Node) and a.is_rows and b.is_rows:
            return latest(a, b)
        if a is b or (type(a) is type(b) and isinstance(a, str | int | float) and a == b):
            return a
        if isinstance(a, Maybe) or isinstance(b, Maybe) or a is None or b is None:
            return self._optional(condition, a, b, name)
        if isinstance(a, tuple) and isinstance(b, tuple):
            items = self._items(condition, list(a), list(b), name)
            return tuple.__new__(type(a), items)
        if isinstance(a, Node | float | int) and isinstance(b, Node | float | int):
            return self._graph.select(condition, a, b)
        raise NotBatchableError(f"{name} is {type(a).__name__} or {type(b).__name__}, as the data want")

    def _optional(self, condition: Node, a: Any, b: Any, name: str) -> Maybe:
        present, values = [], []
        for side in (a, b):
            present.append(side.present if isinstance(side, Maybe) else side is not None)
            values.append(side.value if isinstance(side, Maybe) else side)
        known = [value for value in values if value is not None]
        if not all(isinstance(value, Node | float) for value in known):
            raise NotBatchableError(f"{name} is nothing or a {type(known[0]).__name__}, as the data want")
        first, second = (known[0] if value is None else value for value in values)
        return Maybe(self._graph.select(condition, *present), self._graph.select(condition, first, second))

    def _items(self, condition: Node, a: list[Any], b: list[Any], name: str) -> list[Any]:
        if len(a) != len(b):
            raise NotBatchableError(f"{name} has {len(a)} or {len(b)} entries, as the data want")
        return [self.joined(condition, x, y, name) for x, y in zip(a, b, strict=True)]

    def leaves(self) -> Iterator[tuple[str, Any]]:
        """Returns every plain value of the instances by a name of its own."""
        for index, instance in enumerate(self.instances):
            for name, value in attributes(instance).items():
                yield from _leaves(f"{index}.{type(instance).__name__}.{name}", value)

    def change(self, replace: Callable[[str, Any], Any]) -> None:
        """Replaces every plain value of the instances by what a function of its name and itself returns."""
        for index, instance in enumerate(self.instances):
            for name, value in attributes(instance).items():
                changed = _changed(f"{index}.{type(instance).__name__}.{name}", value, replace)
                if changed is not value:
                    object.__setattr__(instance, name, changed)


def differs(a: Any, b: Any) -> bool:
    """Returns whether two plain values are not the same for certain."""
    return a is not b if isinstance(a, Node) or isinstance(b, Node) else bool(a != b)


def _fill(container: Any, items: Any) -> None:
    container.clear()
    container.update(items) if isinstance(container, dict) else container.extend(items)


def _leaves(path: str, value: Any) -> Iterator[tuple[str, Any]]:
    if isinstance(value, tuple | list | deque):
        for i, item in enumerate(value):
            yield from _leaves(f"{path}[{i}]", item)
    elif isinstance(value, Node | float | int):
        yield path, value


def _changed(path: str, value: Any, replace: Callable[[str, Any], Any]) -> Any:
    if isinstance(value, tuple | list | deque):
        items = [_changed(f"{path}[{i}]", item, replace) for i, item in enumerate(value)]
        if all(new is old for new, old in zip(items, value, strict=True)):
            return value
        if isinstance(value, tuple):
            return tuple.__new__(type(value), items)
        _fill(value, items)
        return value
    return replace(path, value) if isinstance(value, Node | float | int) else value
