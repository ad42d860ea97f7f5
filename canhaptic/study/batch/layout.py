"""What both written forms need to know of a program: what differs between scenes, what changes, and in which order."""

import math
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from canhaptic.study.batch.nodes import NUMBER, Node
from canhaptic.study.batch.program import Program
from canhaptic.study.batch.rings import below
from canhaptic.study.loop import Array

NUMPY: Final[dict[str, str]] = {
    "add": "add", "sub": "subtract", "mul": "multiply", "div": "divide", "mod": "mod", "floordiv": "floor_divide",
    "neg": "negative", "abs": "absolute", "sqrt": "sqrt", "exp": "exp", "sin": "sin", "cos": "cos", "tan": "tan",
    "asin": "arcsin", "floor": "floor", "trunc": "trunc", "rint": "rint", "copysign": "copysign", "max": "maximum",
    "min": "minimum", "lt": "less", "le": "less_equal", "gt": "greater", "ge": "greater_equal", "eq": "equal",
    "ne": "not_equal", "and": "logical_and", "or": "logical_or", "not": "logical_not", "finite": "isfinite",
    "select": "where",
}  # fmt: skip
"""Operation -> function of NumPy."""
_SERIES: Final = ("exp", "sin", "cos", "tan")
_ALWAYS: Final = ("array", "fill", "store", "load", "loop", "out", "input")
"""Operations that are done for each scene, whatever they work on."""


class Layout:
    """Which nodes are one for all scenes, which are fixed for a run, and what is done in every cycle.

    Attributes:
        lanes: Nodes that differ between scenes.
        steps: Nodes computed in every cycle, in order.
        fixed: Fixed nodes, parameters and constants among them, that a cycle or the result uses.
        states: Names of the states, in order.
    """

    def __init__(self, program: Program) -> None:
        self.program = program
        self.states = sorted(program.then)
        goals = [*(program.then[name] for name in self.states), program.out, *program.results.values()]
        everything = below(goals)
        self.steps = [node for node in everything if node.changes and node.op not in ("state", "array", "input")]
        used = {arg for node in self.steps for arg in node.args} | set(goals)
        self.fixed = sorted((node for node in used if not node.changes), key=lambda node: node.number)
        self._lane_states = self._differing_states()
        self.lanes = self._differing(below([*goals, *program.first.values()]), self._lane_states)

    def state_differs(self, name: str) -> bool:
        """Returns whether a state differs between scenes."""
        return name in self._lane_states

    def _differing_states(self) -> frozenset[str]:
        """Returns the states that differ; of those that the results are made of every one, as it may be kept early."""
        program = self.program
        found = frozenset(node.value for node in below(program.results.values()) if node.op in ("state", "array"))
        while True:
            lanes = self._differing(below([*program.then.values(), *program.first.values()]), found)
            more = found | {n for n in self.states if program.then[n] in lanes or program.first[n] in lanes}
            if more == found:
                return found
            found = more

    def _differing(self, nodes: list[Node], states: frozenset[str]) -> set[Node]:
        lanes: set[Node] = set()
        for node in nodes:
            if node.op == "param":
                differs = self.program.kinds[node.value].differs
            elif node.op == "state":
                differs = node.value in states
            elif node.op in _ALWAYS:
                differs = True
            else:
                differs = any(arg in lanes for arg in node.args)
            if differs:
                lanes.add(node)
        return lanes


def known_values(nodes: list[Node], numbers: Mapping[str, Any], states: Mapping[str, Any]) -> dict[Node, Any]:
    """Returns the value of nodes and of all that they are made of: a number, or one for each scene.

    Args:
        nodes: To be computed.
        numbers: By parameter.
        states: By name, as far as the nodes are made of states.
    """
    found: dict[Node, Any] = {}
    with np.errstate(all="ignore"):
        for node in below(nodes):
            if node.op == "const":
                found[node] = node.value
            elif node.op in ("param", "state", "array"):
                found[node] = (numbers if node.op == "param" else states)[node.value]
            else:
                found[node] = _evaluated(node, [found[arg] for arg in node.args])
    return found


def _evaluated(node: Node, args: list[Any]) -> Any:
    if node.op == "fill":
        rows, count = int(np.max(args[1])), max(np.size(args[0]), np.size(args[1]))
        return np.broadcast_to(args[0], (rows, count))
    if node.op in _SERIES and isinstance(args[0], np.ndarray):  # one by one: in bulk the last bit may differ
        function = getattr(math, node.op)
        return np.array([function(value) for value in args[0].tolist()])
    result = getattr(np, NUMPY[node.op])(*args)
    if isinstance(result, np.ndarray) and result.ndim:
        return result
    return float(result) if node.op in NUMBER or not node.is_truth else bool(result)


def widened(value: Any, count: int, is_truth: bool) -> Array:
    """Returns a value for each scene, as an array of its own; of a list all rows."""
    if np.ndim(value) == 2:
        return np.array(np.broadcast_to(value, (len(value), count)), dtype=float)
    return np.array(np.broadcast_to(value, (count,)), dtype=bool if is_truth else float)
