"""What a list whose length data choose, and a loop that data end, become: rows of an array and a loop over them."""

from typing import Any, NamedTuple

from canhaptic.study.batch.graph import Graph
from canhaptic.study.batch.nodes import Node, NotBatchableError


class Ring:
    """A list made by `[value] * length`: as many rows as the longest needs, in every scene its own length.

    Attributes:
        token: The rows as the last store left them.
        length: Of the list.
    """

    def __init__(self, token: Node, length: Any) -> None:
        self.token, self.length = token, length

    def place(self, index: Any) -> Any:
        """Returns the row of an index; one below 0 counts from the end, as in a list."""
        graph = self.token.graph
        return graph.select(graph.op("lt", index, 0.0), graph.op("add", index, self.length), index)

    def load(self, index: Any) -> Node:
        """Returns the entry at an index."""
        graph = self.token.graph
        return graph.made("load", (self.token, graph.node(self.place(index))))

    def store(self, index: Any, value: Any, path: Any) -> None:
        """Changes the entry at an index where a condition holds."""
        graph = self.token.graph
        args = (self.token, graph.node(self.place(index)), graph.node(value), graph.node(path))
        self.token = graph.made("store", args)


class Rings:
    """A list of tuples made by `[(value, ...)] * length`: one ring for each place of the tuples."""

    def __init__(self, rings: tuple[Ring, ...]) -> None:
        self._rings = rings

    def load(self, index: Any) -> tuple[Node, ...]:
        """Returns the entry at an index."""
        return tuple(ring.load(index) for ring in self._rings)

    def store(self, index: Any, value: tuple[Any, ...], path: Any) -> None:
        """Changes the entry at an index where a condition holds."""
        for ring, part in zip(self._rings, value, strict=True):
            ring.store(index, part, path)


class DataRange(NamedTuple):
    """A range whose ends data choose."""

    start: Any
    stop: Any


class Body(NamedTuple):
    """What one pass through a loop does."""

    variables: tuple[Node, ...]  # what a pass leaves to the next; the first is whether there is another pass
    then: tuple[Node, ...]  # their values after a pass

    def inside(self) -> list[Node]:
        """Returns the nodes that are computed in every pass, in order."""
        own, found = {*self.variables}, []
        for node in below(self.then):
            if node in own or any(arg in own for arg in node.args):
                own.add(node)
                if node.op != "var":
                    found.append(node)
        return found


def loop_of(graph: Graph, body: Body, begin: list[Node]) -> list[Node]:
    """Returns the variables of a loop after its last pass.

    Args:
        graph: Where the loop goes.
        body: Of the loop.
        begin: Values of the variables before the first pass.
    """
    inside = {*body.inside(), *body.variables}
    used = [arg for node in inside for arg in node.args] + list(body.then)
    captured = {node for node in used if node not in inside}
    if any(node.op == "store" for node in inside):
        raise NotBatchableError("a loop that data end changes a list")
    loop = graph.made("loop", (*begin, *sorted(captured, key=lambda node: node.number)), body)
    return [graph.made("out", (loop,), i, is_truth=variable.is_truth) for i, variable in enumerate(body.variables)]


def latest(a: Node, b: Node) -> Node:
    """Returns the later of two versions of the rows of one ring; what a branch stores is stored under its condition.

    Raises:
        NotBatchableError: Both branches stored.
    """
    for late, early in ((a, b), (b, a)):
        version = late
        while version.op == "store" and version is not early:
            version = version.args[0]
        if version is early:
            return late
    raise NotBatchableError("a list that both ways of a branch change")


def below(nodes: Any) -> list[Node]:
    """Returns the nodes and all that they are made of, arguments before what uses them."""
    seen: set[Node] = set()
    waiting = list(nodes)
    while waiting:
        node = waiting.pop()
        if node not in seen:
            seen.add(node)
            waiting += node.args
    return sorted(seen, key=lambda node: node.number)
