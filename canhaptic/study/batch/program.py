"""One cycle of a loop as a list of operations: the plant's flow, then everything that happens at a SYNC.

The loop is interpreted once for the first SYNC, from rest, and then for any later one: attributes that differ after it
become states. States that always hold the same are one, and what nobody asks for is left out.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Final, NamedTuple

from canhaptic.control.environments.environment import Environment
from canhaptic.control.passivity import ALGORITHMS
from canhaptic.control.passivity.controller import LoopProperties
from canhaptic.registry import load
from canhaptic.study.batch.axis import SampledAxis
from canhaptic.study.batch.graph import Graph
from canhaptic.study.batch.heap import differs
from canhaptic.study.batch.lowering import Lowering
from canhaptic.study.batch.nodes import Node, NotBatchableError
from canhaptic.study.batch.rings import Body, below, loop_of
from canhaptic.study.loop import Array
from canhaptic.units import Parameters

INPUTS: Final = ("continuous_position", "continuous_torque")
"""What a cycle may be given for every scene: of the continuous run beside it."""
_HELD: Final = ("state", "array")
_MOST_ROUNDS: Final = 50


@dataclass(frozen=True, slots=True)
class BatchCase:
    """What many loops have in common, and the numbers in which they differ.

    `numbers` holds what may differ by name: of the models `environment`, `passivity` and `loop` field by field; of the
    drive `counts_per_unit`, `torque_quantum` and `torque_limit`; of the meter `last_from` and `damping_per_time`; of
    the plant `start.ROW`, `flow.ROW.COLUMN` and, where it is in arrays, `rate.ROW.COLUMN`. A name that is absent has
    the value of its model; None, whole numbers and truth values are structure and stay there.
    """

    environment: Environment
    algorithm: str
    parameters: Parameters
    loop: LoopProperties
    delay: int
    furthest: float
    size: int  # of the plant's state vector [states..., torque, one]
    numbers: Mapping[str, Array | float | None]  # each of shape (n_scenes,) or one number

    def kinds(self) -> dict[str, "Kind"]:
        """Returns what is known of each number."""
        return {name: kind_of(value) for name, value in self.numbers.items() if value is not None}

    def structure(self) -> str:
        """Returns everything that decides what the program is, but no number."""
        parts: tuple[Any, ...] = (self.environment, self.parameters, self.loop)
        models = [(type(part).__qualname__, _rest(part)) for part in parts]
        return repr((self.algorithm, self.delay, self.furthest, self.size, models, sorted(self.kinds().items())))


class Structure:
    """A case by what decides its program, for remembering what was made of it."""

    def __init__(self, case: BatchCase) -> None:
        self.case, self._key = case, case.structure()

    def __eq__(self, other: object) -> bool:
        """Returns whether both have the same program."""
        return isinstance(other, Structure) and self._key == other._key

    def __hash__(self) -> int:
        """Returns the hash of the structure."""
        return hash(self._key)


class Kind(NamedTuple):
    """What is known of a number before its value: 0 itself, or its sign in all scenes, and whether they differ."""

    is_zero: bool
    sign: int
    differs: bool


def kind_of(value: Array | float) -> Kind:
    """Returns what is known of a number or of one for each scene."""
    if isinstance(value, float):
        return Kind(value == 0.0, (value > 0.0) - (value < 0.0), False)
    least, most = float(value.min()), float(value.max())
    return Kind(least == most == 0.0, (least > 0.0) - (most < 0.0), True)


def _rest(model: Parameters) -> list[tuple[str, Any]]:
    fields = [(name, getattr(model, name)) for name in type(model).model_fields]
    return [(name, value) for name, value in fields if not isinstance(value, float)]


@dataclass(frozen=True, slots=True)
class Program:
    """A cycle, ready to be written out.

    Attributes:
        first: State -> its value after the first SYNC; depends on parameters only.
        then: State -> its value one cycle later.
        out: Whether the axis diverged in this cycle.
        results: Sum of the meter -> its value at the end, made of states.
        kinds: What is known of each parameter.
        inputs: Of `INPUTS`, those that a cycle uses.
    """

    first: dict[str, Node]
    then: dict[str, Node]
    out: Node
    results: dict[str, Node]
    kinds: dict[str, Kind]
    inputs: tuple[Node, ...]


class _Numbers:
    """Parameters in the place of numbers."""

    def __init__(self, graph: Graph, kinds: Mapping[str, Kind]) -> None:
        self._graph, self._kinds = graph, kinds

    def get(self, name: str) -> Any:
        """Returns the parameter of a number, 0 where it is that, None where there is none."""
        kind = self._kinds.get(name)
        if kind is None:
            return None
        return 0.0 if kind.is_zero else self._graph.param(name, kind.sign)

    def lifted(self, section: str, model: Any) -> Any:
        """Returns a parameter model with its numbers as parameters."""
        names = [name for name in type(model).model_fields if f"{section}.{name}" in self._kinds]
        return model.model_copy(update={name: self.get(f"{section}.{name}") for name in names})


def numbers_of(section: str, model: Parameters) -> dict[str, float]:
    """Returns the numbers of a parameter model by the names of `BatchCase.numbers`."""
    fields = {f"{section}.{name}": getattr(model, name) for name in type(model).model_fields}
    return {name: value for name, value in fields.items() if isinstance(value, float)}


def build_program(case: BatchCase, sums: Sequence[str]) -> Program:
    """Returns the cycle of a loop that keeps some sums of its meter.

    Args:
        case: The loop.
        sums: Attributes of `Meter`.

    Raises:
        NotBatchableError: Part of the source has no form in arrays.
    """
    graph = Graph()
    lowering, numbers = Lowering(graph), _Numbers(graph, case.kinds())
    axis = _axis(lowering, numbers, case)
    start = [numbers.get(f"start.{i}") for i in range(case.size - 2)]
    lowering.call(SampledAxis.sync, (axis, start[0], start[0], 0.0), {})
    first = dict(lowering.heap.leaves())
    after_first = lowering.heap.save()
    states: set[str] = set()
    for _ in range(_MOST_ROUNDS):
        lowering.heap.restore(after_first)
        lowering.heap.change(partial(_placed, graph, states))
        placed = dict(lowering.heap.leaves())
        moved = _moved(graph, numbers, case.size, axis.held)
        lowering.call(SampledAxis.sync, (axis, moved[0], *(graph.made("input", (), name) for name in INPUTS)), {})
        then = dict(lowering.heap.leaves())
        changed = {name for name in then if name not in states and differs(then[name], placed[name])}
        if not changed:
            break
        states |= changed
    firsts = {name: first[name] for name in states} | {f"plant.{i}": value for i, value in enumerate(start)}
    thens = {name: then[name] for name in states} | {f"plant.{i}": value for i, value in enumerate(moved)}
    ends: dict[str, Node] = {}
    for name in sums:
        path = _path_of(lowering, axis.meter, name)
        ends[name] = graph.state(path, graph.node(then[path]).is_truth) if path in states else graph.node(then[path])
    return _reduced(graph, firsts, thens, graph.node(axis.out), ends, case.kinds())


def _axis(lowering: Lowering, numbers: _Numbers, case: BatchCase) -> Any:
    environment = numbers.lifted("environment", case.environment)
    algorithm = load(ALGORITHMS, case.algorithm, "passivity algorithm")
    parameters, loop = numbers.lifted("passivity", case.parameters), numbers.lifted("loop", case.loop)
    controller = lowering.create(algorithm, environment, parameters, loop)
    return lowering.create(
        SampledAxis,
        controller,
        environment,
        delay=case.delay,
        counts_per_unit=numbers.get("counts_per_unit"),
        torque_quantum=numbers.get("torque_quantum"),
        torque_limit=numbers.get("torque_limit"),
        furthest=case.furthest,
        last_from=numbers.get("last_from"),
        damping_per_time=numbers.get("damping_per_time"),
    )


def _moved(graph: Graph, numbers: _Numbers, size: int, torque: Any) -> list[Any]:
    """Returns the states of the plant after a hold, each the sum of its terms in the order of the states."""
    before = [graph.state(f"plant.{i}") for i in range(size - 2)] + [torque, 1.0]
    moved = []
    for row in range(size - 2):
        total: Any = 0.0
        for column in range(size):
            coefficient = numbers.get(f"flow.{row}.{column}")
            if coefficient is not None:
                total = total + coefficient * before[column]
        moved.append(total)
    return moved


def _placed(graph: Graph, states: set[str], name: str, value: Any) -> Any:
    if name not in states:
        return value
    return graph.slot(name, graph.node(value))


def _path_of(lowering: Lowering, owner: object, name: str) -> str:
    return f"{next(i for i, x in enumerate(lowering.heap.instances) if x is owner)}.{type(owner).__name__}.{name}"


def _reduced(
    graph: Graph, first: dict[str, Any], then: dict[str, Any], out: Node, ends: dict[str, Node], kinds: dict[str, Kind]
) -> Program:
    """Returns the program without states that are others, are constant, or are not asked for."""
    firsts = {name: graph.node(value) for name, value in first.items()}
    thens = {name: graph.node(value) for name, value in then.items()}
    for _ in range(_MOST_ROUNDS):
        same = _same_states(graph, firsts, thens)
        two_valued = {} if same else _two_valued(graph, firsts, thens)
        if not (same or two_valued):
            break
        rewrite = Rewrite(graph, {**same, **two_valued})
        thens = {name: rewrite(node) for name, node in thens.items() if graph.slot(name, node) not in same}
        out, ends = rewrite(out), {name: rewrite(node) for name, node in ends.items()}
    live = _live(thens, [out, *ends.values()])
    firsts, thens = {name: firsts[name] for name in live}, {name: thens[name] for name in live}
    inputs = tuple(node for node in below([*thens.values(), out]) if node.op == "input")
    return Program(firsts, thens, out, ends, kinds, inputs)


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
    """Returns state -> the state or constant that it always equals: assumed until something contradicts it."""
    state = {name: graph.slot(name, node) for name, node in then.items()}
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
        for part in below([node]):
            if part in self._known:
                continue
            args = [self._known.get(arg, arg) for arg in part.args]
            if all(new is old for new, old in zip(args, part.args, strict=True)):
                self._known[part] = part
            elif part.op == "loop":
                body = Body(part.value.variables, tuple(self(node) for node in part.value.then))
                outs = loop_of(self._graph, body, args[: len(body.variables)])
                self._known[part] = outs[0].args[0]
            elif part.op in ("load", "store", "out", "fill"):
                self._known[part] = self._graph.made(part.op, tuple(args), part.value, part.is_truth)
            elif part.op == "select":
                self._known[part] = self._graph.node(self._graph.select(_value(args[0]), *args[1:]))
            else:
                self._known[part] = self._graph.node(self._graph.op(part.op, *args))
        return self._known[node]


def _value(node: Node) -> Any:
    return node.value if node.op == "const" else node


def _live(then: dict[str, Node], wanted: Iterable[Node]) -> list[str]:
    """Returns the names of the states on which the wanted nodes depend, now or later.

    Raises:
        NotBatchableError: One of them has no next value.
    """
    found: dict[str, None] = {}
    waiting = list(wanted)
    while waiting:
        fresh = {node.value: None for node in below(waiting) if node.op in _HELD and node.value not in found}
        missing = [name for name in fresh if name not in then]
        if missing:
            raise NotBatchableError(f"states without a next value: {', '.join(missing)}")
        found |= fresh
        waiting = [then[name] for name in fresh]
    return sorted(found)
