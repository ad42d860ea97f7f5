"""One cycle of a loop as a list of operations: the plant's flow, then everything that happens at a SYNC.

The loop is interpreted once for the first SYNC, from rest, and then for any later one: attributes that differ after it
become states. States that always hold the same are one, and what nobody asks for is left out.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from canhaptic.haptics.environments.protocol import Environment
from canhaptic.haptics.passivity import ALGORITHMS
from canhaptic.haptics.passivity.protocol import LoopProperties
from canhaptic.parameters import Parameters
from canhaptic.study.batch.axis import SampledAxis
from canhaptic.study.batch.graph import Graph, Node, NotBatchableError
from canhaptic.study.batch.lowering import Lowering
from canhaptic.study.loop import Array
from canhaptic.tables import load

POSITION: Final = "plant.0"
"""State of the plant that is the true position."""
_MOST_ROUNDS: Final = 50


@dataclass(frozen=True, slots=True)
class BatchCase:
    """What many loops have in common, and the numbers in which they differ."""

    environment: Environment
    algorithm: str
    parameters: Parameters
    loop: LoopProperties
    delay: int
    counts_per_unit: float | None
    torque_quantum: float | None
    torque_limit: float | None
    furthest: float
    flows: Array  # shape (n_scenes or 1, n, n): of [states..., torque, one] over one sample time
    start: Array  # shape (n_scenes or 1, n)
    varied: Mapping[str, Array] = field(default_factory=dict)  # "environment.stiffness", ... -> (n_scenes,)


@dataclass(frozen=True, slots=True)
class Program:
    """A cycle, ready to be written out.

    Attributes:
        first: State -> its value after the first SYNC; depends on parameters only.
        then: State -> its value one cycle later.
        out: Whether the axis diverged in this cycle.
        results: Sum of the meter -> the state that holds it, or its value where it never changes.
        values: Parameter -> number, or one for each scene.
    """

    first: dict[str, Node]
    then: dict[str, Node]
    out: Node
    results: dict[str, Node]
    values: dict[str, Any]


class _Values:
    """Numbers by the name of their parameter."""

    def __init__(self, graph: Graph, varied: Mapping[str, Array]) -> None:
        self._graph, self._varied = graph, varied
        self.values: dict[str, Any] = {}

    def lift(self, name: str, value: Any) -> Any:
        """Returns a number as a parameter; 0, truth values, whole numbers and None stay what they are."""
        value = self._varied.get(name, value)
        if isinstance(value, np.ndarray):
            return self.take(name, value)
        return self.take(name, value) if isinstance(value, float) and value else value

    def take(self, name: str, value: Any) -> Any:
        """Returns the parameter of one number or of one for each scene; an array of equal ones is one."""
        if isinstance(value, np.ndarray) and (value == value[0]).all():
            value = float(value[0])
        if isinstance(value, float) and value == 0.0:
            return 0.0
        self.values[name] = value
        least, most = np.min(value), np.max(value)
        return self._graph.param(name, int(least > 0.0) - int(most < 0.0))

    def lifted(self, section: str, model: Any) -> Any:
        """Returns a parameter model with its numbers as parameters."""
        names = type(model).model_fields
        return model.model_copy(update={name: self.lift(f"{section}.{name}", getattr(model, name)) for name in names})


def build_program(case: BatchCase, sums: Sequence[str]) -> Program:
    """Returns the cycle of a loop that keeps some sums of its meter.

    Args:
        case: The loop.
        sums: Attributes of `Meter`.

    Raises:
        NotBatchableError: Part of the source has no form in arrays.
    """
    graph = Graph()
    lowering, values = Lowering(graph), _Values(graph, case.varied)
    axis = _axis(lowering, values, case)
    size = case.start.shape[-1]
    start = [values.take(f"start.{i}", _column(case.start[:, i])) for i in range(size - 2)]
    lowering.call(SampledAxis.sync, (axis, start[0]), {})
    first = dict(lowering.heap.leaves())
    after_first = lowering.heap.save()
    states: set[str] = set()
    for _ in range(_MOST_ROUNDS):
        lowering.heap.restore(after_first)
        lowering.heap.change(lambda name, value: _placed(graph, states, name, value))
        placed = dict(lowering.heap.leaves())
        moved = _moved(graph, values, case.flows, axis.held)
        lowering.call(SampledAxis.sync, (axis, moved[0]), {})
        then = dict(lowering.heap.leaves())
        changed = {name for name in then if name not in states and _differs(then[name], placed[name])}
        if not changed:
            break
        states |= changed
    firsts = {name: first[name] for name in states} | {f"plant.{i}": value for i, value in enumerate(start)}
    thens = {name: then[name] for name in states} | {f"plant.{i}": value for i, value in enumerate(moved)}
    results = {name: getattr(axis.meter, name) for name in sums}
    kept = {name: path for name in sums for path in [_path_of(lowering, axis.meter, name)]}
    return _reduced(graph, firsts, thens, graph.node(axis.out), results, kept, values.values)


def _axis(lowering: Lowering, values: _Values, case: BatchCase) -> Any:
    environment = values.lifted("environment", case.environment)
    algorithm = load(ALGORITHMS, case.algorithm, "passivity algorithm")
    parameters, loop = values.lifted("passivity", case.parameters), values.lifted("loop", case.loop)
    controller = lowering.create(algorithm, environment, parameters, loop)
    return lowering.create(
        SampledAxis,
        controller,
        environment,
        delay=case.delay,
        counts_per_unit=values.lift("counts_per_unit", case.counts_per_unit),
        torque_quantum=values.lift("torque_quantum", case.torque_quantum),
        torque_limit=values.lift("torque_limit", case.torque_limit),
        furthest=case.furthest,
    )


def _column(column: Array) -> Array | float:
    return float(column[0]) if len(column) == 1 else column


def _moved(graph: Graph, values: _Values, flows: Array, torque: Any) -> list[Any]:
    """Returns the states of the plant after a hold, each the sum of its terms in the order of the states."""
    size = flows.shape[-1]
    before = [graph.state(f"plant.{i}") for i in range(size - 2)] + [torque, 1.0]
    moved = []
    for row in range(size - 2):
        total: Any = 0.0
        for column in range(size):
            if np.any(flows[:, row, column]):
                total = total + values.take(f"flow.{row}.{column}", _column(flows[:, row, column])) * before[column]
        moved.append(total)
    return moved


def _placed(graph: Graph, states: set[str], name: str, value: Any) -> Any:
    if name not in states:
        return value
    return graph.state(name, isinstance(value, bool) or (isinstance(value, Node) and value.is_truth))


def _differs(then: Any, placed: Any) -> bool:
    if isinstance(then, Node) or isinstance(placed, Node):
        return then is not placed
    return bool(then != placed)


def _path_of(lowering: Lowering, owner: object, name: str) -> str:
    return f"{next(i for i, x in enumerate(lowering.heap.instances) if x is owner)}.{type(owner).__name__}.{name}"


def _reduced(
    graph: Graph,
    first: dict[str, Any],
    then: dict[str, Any],
    out: Node,
    results: dict[str, Any],
    kept: dict[str, str],
    values: dict[str, Any],
) -> Program:
    """Returns the program without states that are others, are constant, or are not asked for."""
    firsts = {name: graph.node(value) for name, value in first.items()}
    thens = {name: graph.node(value) for name, value in then.items()}
    ends = {name: graph.state(path) if path in thens else graph.node(results[name]) for name, path in kept.items()}
    for _ in range(_MOST_ROUNDS):
        same = _same_states(graph, firsts, thens)
        two_valued = {} if same else _two_valued(graph, firsts, thens)
        if not (same or two_valued):
            break
        rewrite = Rewrite(graph, {**same, **two_valued})
        thens = {name: rewrite(node) for name, node in thens.items() if graph.state(name, node.is_truth) not in same}
        out, ends = rewrite(out), {name: rewrite(node) for name, node in ends.items()}
    live = _live(graph, thens, [out, *ends.values()])
    return Program({name: firsts[name] for name in live}, {name: thens[name] for name in live}, out, ends, values)


def _two_valued(graph: Graph, first: dict[str, Node], then: dict[str, Node]) -> dict[Node, Node]:
    """Returns state -> selection between the two numbers that it can be, by a truth value that takes its place."""
    found = {}
    for name, node in list(then.items()):
        if node.op != "select" or node.is_truth or any(side.op != "const" for side in node.args[1:]):
            continue
        condition, yes, no = node.args
        was_yes, was_no = (graph.op("eq", first[name], side) for side in (yes, no))
        if graph.op("or", was_yes, was_no) is not True:
            continue
        found[graph.state(name)] = graph.node(graph.select(graph.state(name, is_truth=True), yes, no))
        first[name], then[name] = graph.node(was_yes), condition
    return found


def _same_states(graph: Graph, first: dict[str, Node], then: dict[str, Node]) -> dict[Node, Node]:
    """Returns state -> the state or constant that it always equals, found by assuming it and looking for a contradiction."""
    state = {name: graph.state(name, node.is_truth) for name, node in then.items()}
    groups: dict[str, int] = {name: first[name].number for name in then}
    while True:
        leader: dict[Any, str] = {}
        for name in sorted(then):
            leader.setdefault((groups[name], then[name].is_truth), name)
        same = {state[n]: state[leader[groups[n], then[n].is_truth]] for n in then}
        same = {a: b for a, b in same.items() if a is not b}
        rewrite = Rewrite(graph, same)
        signature = {name: (groups[name], rewrite(node).number) for name, node in then.items()}
        numbers: dict[Any, int] = {}
        finer = {name: numbers.setdefault(signature[name], len(numbers)) for name in sorted(then)}
        if len(set(finer.values())) == len({(g, then[n].is_truth) for n, g in groups.items()}):
            break
        groups = finer
    for name, node in then.items():
        begin = first[name]
        if begin.op == "const" and state[name] not in same and Rewrite(graph, {state[name]: begin})(node) is begin:
            same[state[name]] = begin
    return same


class Rewrite:
    """Puts other nodes in the place of some, and simplifies what follows."""

    def __init__(self, graph: Graph, replaced: Mapping[Node, Node]) -> None:
        self._graph, self._known = graph, dict(replaced)
        self._active = bool(replaced)

    def __call__(self, node: Node) -> Node:
        """Returns the node with everything below it replaced."""
        if not self._active or not node.changes:
            return node
        for part in ordered([node]):
            if part in self._known:
                continue
            args = [self._known.get(arg, arg) for arg in part.args]
            if all(new is old for new, old in zip(args, part.args, strict=True)):
                self._known[part] = part
            elif part.op == "select":
                self._known[part] = self._graph.node(self._graph.select(_value(args[0]), *args[1:]))
            else:
                self._known[part] = self._graph.node(self._graph.op(part.op, *args))
        return self._known[node]


def _value(node: Node) -> Any:
    return node.value if node.op == "const" else node


def _live(graph: Graph, then: dict[str, Node], wanted: Iterable[Node]) -> list[str]:
    """Returns the names of the states on which the wanted nodes depend, now or later."""
    found: dict[str, None] = {}
    waiting = list(wanted)
    while waiting:
        for node in ordered(waiting):
            if node.op == "state":
                found.setdefault(node.value)
        waiting = [then[name] for name in found if name in then]
        before = len(found)
        for node in ordered(waiting):
            if node.op == "state":
                found.setdefault(node.value)
        if len(found) == before:
            break
    missing = [name for name in found if name not in then]
    if missing:
        raise NotBatchableError(f"states without a next value: {', '.join(missing)}")
    return sorted(found)


def ordered(nodes: Iterable[Node]) -> list[Node]:
    """Returns the nodes and all that they are made of, arguments before what uses them."""
    seen: set[Node] = set()
    waiting = list(nodes)
    while waiting:
        node = waiting.pop()
        if node not in seen:
            seen.add(node)
            waiting += node.args
    return sorted(seen, key=lambda node: node.number)
