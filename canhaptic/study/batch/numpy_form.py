"""A program written out as NumPy calls on a chunk of scenes: one an operation, memory taken by selections only."""

from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np

from canhaptic.study.batch.layout import NUMPY, Layout, known_values, widened
from canhaptic.study.batch.nodes import Node
from canhaptic.study.batch.program import Program
from canhaptic.study.batch.rings import Body, below
from canhaptic.study.loop import Array

BLOCK: Final = 64
"""Cycles for which inputs are laid out at a time."""
Feed = Callable[[int], Mapping[str, Array]]
"""From a number of cycles to the inputs of the next ones, by name, shape (cycles, n_scenes) each."""


class NumpyForm:
    """A program as a function on arrays.

    Attributes:
        source: Of the function, for whoever wants to read what runs.
    """

    def __init__(self, program: Program) -> None:
        self.program = program
        self.layout = Layout(program)
        self._writer = _Writer(self.layout)
        self.source = self._writer.source()
        names: dict[str, Any] = {name: getattr(np, name) for name in NUMPY.values()}
        names |= {"copyto": np.copyto, "flatnonzero": np.flatnonzero, "some": _some}
        exec(compile(self.source, "<batch>", "exec"), names)
        self._cycles = names["cycles"]

    def run(
        self,
        numbers: Mapping[str, Any],
        count: int,
        cycles: int,
        escaped: Callable[[Any, Mapping[str, Any], int], None],
        feed: Feed,
    ) -> dict[str, Any]:
        """Returns the states of a chunk after its cycles.

        Args:
            numbers: By parameter, one or of shape (count,).
            count: Scenes.
            cycles: After the first SYNC.
            escaped: Told (which scenes left every place in this cycle, all states, the cycle); may put the states back.
            feed: Gives the inputs of the next cycles.
        """
        layout, program = self.layout, self.program
        fixed = known_values([*layout.fixed, *program.first.values()], numbers, {})
        states = [
            widened(fixed[program.first[name]], count, program.then[name].is_truth)
            if layout.state_differs(name)
            else fixed[program.first[name]]
            for name in layout.states
        ]
        given = [fixed[node] for node in layout.fixed if node.op != "const"]
        buffers = [np.empty(count, bool if name.startswith("b") else float) for name in self._writer.buffers]

        done = 0

        def told(out: Any, now: tuple[Any, ...], cycle: int) -> None:
            escaped(out, dict(zip(layout.states, now, strict=True)), done + cycle)

        while done < cycles:
            some = min(BLOCK, cycles - done) if program.inputs else cycles
            inputs = self._inputs(feed, some)
            with np.errstate(all="ignore"):  # arrays change hands: what was a buffer may be a state afterwards
                states, buffers = self._cycles(some, told, states, given, buffers, inputs, *_rows(count))
            done += some
        return dict(zip(layout.states, states, strict=True))

    def _inputs(self, feed: Feed, cycles: int) -> list[Array]:
        nodes = self.program.inputs
        found = feed(cycles) if nodes else {}
        return [found[node.value] for node in nodes]


def _rows(count: int) -> tuple[Callable[..., Any], ...]:
    """Returns what copies a value, what reads and what changes entries of a list that every scene has of its own."""
    every = np.arange(count)

    def fresh(value: Any) -> Any:
        return np.array(np.broadcast_to(value, (count,)))

    def get(rows: Any, index: Any, lanes: Any = every) -> Any:
        if np.ndim(index) == 0:
            return rows[int(index), lanes]
        return rows[np.clip(index, 0, len(rows) - 1).astype(np.intp), lanes]  # clipped where no scene looks

    def put(rows: Any, index: Any, value: Any, path: Any) -> None:
        if np.ndim(index) == 0:
            np.copyto(rows[int(index)], value, where=path)
            return
        places = index.astype(np.intp)
        rows[places, every] = np.where(path, value, rows[places, every])

    return fresh, get, put


def _some(value: Any, rows: Any) -> Any:
    """Returns what some scenes have of a value that may be one for all."""
    return value[rows] if np.ndim(value) else value


class _Writer:
    """Writes the function: names for states, fixed values and buffers, and a line an operation."""

    def __init__(self, layout: Layout) -> None:
        self._layout = layout
        self.buffers: list[str] = []
        self._free: dict[bool, list[str]] = {False: [], True: []}
        self._name: dict[Node, str] = {}
        self._outs: dict[Node, list[int]] = {}  # variables of a loop that something uses
        for node in layout.steps:
            if node.op == "out":
                self._outs.setdefault(node.args[0], []).append(node.value)
        program = layout.program
        graph = program.out.graph
        self._state = [f"s{i}" for i in range(len(layout.states))]
        for name, own in zip(layout.states, self._state, strict=True):
            self._name[graph.slot(name, program.then[name])] = own
        given = [node for node in layout.fixed if node.op != "const"]
        self._given = [f"p{i}" for i in range(len(given))]
        self._name |= dict(zip(given, self._given, strict=True))
        self._name |= {node: _literal(node.value) for node in layout.fixed if node.op == "const"}
        self._name |= {node: f"i{i}" for i, node in enumerate(program.inputs)}

    def source(self) -> str:
        """Returns the text of the function."""
        layout = self._layout
        then = [layout.program.then[name] for name in layout.states]
        last = self._last_uses([*then, layout.program.out])
        lines = []
        for index, node in enumerate(layout.steps):
            args = [self._name[arg] for arg in node.args]
            for arg in dict.fromkeys(node.args):  # a result may take the place of an argument that is used up
                if last.get(arg) == index and self._name.get(arg) in self.buffers:
                    self._free[arg.is_truth].append(self._name[arg])
            lines += self._lines(node, args)
        out = layout.program.out
        turned = self._turned(then)
        check = f"if {self._name[out]}.any(): told({self._name[out]}, ({', '.join(self._state)},), cycle)"
        taken = [f"{self._name[node]} = inputs[{i}][cycle - 1]" for i, node in enumerate(layout.program.inputs)]
        body = [*taken, *lines, *turned, check if out in layout.lanes else "pass"]
        head = ["def cycles(count, told, states, given, buffers, inputs, fresh, get, put):"]
        for names, source in ((self._state, "states"), (self._given, "given"), (self.buffers, "buffers")):
            if names:
                head.append(f"    {', '.join(names)}, = {source}")
        loop = ["    for cycle in range(1, count + 1):", *(f"        {line}" for line in body)]
        both = (", ".join((*names, "")) for names in (self._state, self.buffers))
        return "\n".join([*head, *loop, f"    return ({'), ('.join(both)})"]) + "\n"

    def _last_uses(self, goals: list[Node]) -> dict[Node, int]:
        last = {arg: index for index, node in enumerate(self._layout.steps) for arg in node.args}
        return last | dict.fromkeys(goals, len(self._layout.steps))

    def _buffer(self, is_truth: bool) -> str:
        free = self._free[is_truth]
        if free:
            return free.pop()
        self.buffers.append(f"{'b' if is_truth else 'f'}{len(self.buffers)}")
        return self.buffers[-1]

    def _lines(self, node: Node, args: list[str]) -> list[str]:
        if node.op == "loop":
            return self._loop(node, args)
        if node.op == "out":
            self._name[node] = f"{args[0]}_{node.value}"
            return []
        if node.op == "store":
            rows, index, value, path = args
            self._name[node] = rows
            return [f"put({rows}, {index}, {value}, {path})"]
        return [self._line(node, args)]

    def _loop(self, node: Node, args: list[str]) -> list[str]:
        """Returns the lines of a loop: each pass for the scenes that have one, fewer and fewer of them."""
        body, own = node.value, f"q{node.number}"
        self._name[node] = own
        wanted = self._outs.get(node, [])
        kept = _carried(body, wanted)
        name = {i: f"{own}v{i}" for i in kept}
        lines = [f"{own}_{i} = fresh({args[i]})" for i in wanted]
        lines += [f"{own}r = flatnonzero({args[0]})"]
        lines += [f"{name[i]} = some({args[i]}, {own}r)" for i in kept]
        inside = {body.variables[i]: name[i] for i in kept}
        parts = [node for node in below([body.then[i] for i in kept]) if node in {*body.inside()}]
        captured = []
        for arg in sorted(
            {arg for part in parts for arg in part.args} & self._layout.lanes, key=lambda arg: arg.number
        ):
            if arg in self._name and arg not in inside and not arg.is_rows:
                inside[arg] = f"{own}c{arg.number}"
                captured.append(inside[arg])
                lines.append(f"{inside[arg]} = some({self._name[arg]}, {own}r)")
        lines += [f"{own}a = some({args[0]}, {own}r)", f"while {own}r.size:"]
        for part in parts:
            operands = [inside.get(arg) or self._text(arg) for arg in part.args]
            inside[part] = f"{own}t{part.number}"
            call = "get" if part.op == "load" else NUMPY[part.op]
            lanes = f", {own}r" if part.op == "load" else ""
            lines.append(f"    {inside[part]} = {call}({', '.join(operands)}{lanes})")
        then = [inside.get(body.then[i]) or self._text(body.then[i]) for i in kept]
        lines.append(f"    {', '.join(name.values())}, = {', '.join(then)},")
        lines += [f"    {line}" for line in _ended(own, [*name.values(), *captured], wanted)]
        return lines

    def _text(self, node: Node) -> str:
        return _literal(node.value) if node.op == "const" else self._name[node]

    def _line(self, node: Node, args: list[str]) -> str:
        if node not in self._layout.lanes:
            self._name[node] = f"u{node.number}"
            return f"{self._name[node]} = {_one_for_all(node, args)}"
        target = self._name[node] = self._buffer(node.is_truth)
        if node.op in ("select", "load"):
            return f"{target} = {'where' if node.op == 'select' else 'get'}({', '.join(args)})"
        return f"{NUMPY[node.op]}({', '.join(args)}, out={target})"

    def _turned(self, then: list[Node]) -> list[str]:
        """Returns the lines that make the new values the states; arrays change hands and are not copied."""
        lines, takes, gives, freed = [], [], [], []
        given: set[str] = set()
        layout = self._layout
        for name, own, node in zip(layout.states, self._state, then, strict=True):
            value = self._name[node]
            if value == own:
                given.add(own)
                continue
            differs = layout.state_differs(name)
            if differs and (value in given or node not in layout.lanes or not node.changes):
                copy = self._buffer(node.is_truth)
                lines.append(f"copyto({copy}, {value})")
                value = copy
            given.add(value)
            takes.append(own)
            gives.append(value)
            if differs:
                freed.append((node.is_truth, own))
        for kind, initial in ((False, "f"), (True, "b")):  # the arrays of the old values become buffers of their kind
            idle = [own for is_truth, own in freed if is_truth == kind and own not in gives]
            left = [value for value in gives if value in self.buffers and value.startswith(initial)]
            both = min(len(left), len(idle))
            takes += left[:both]
            gives += idle[:both]
        if takes:
            lines.append(f"{', '.join(takes)}, = {', '.join(gives)},")
        return lines


def _carried(body: Body, wanted: list[int]) -> list[int]:
    """Returns the variables of a loop on which its passes or what is wanted of it depend."""
    kept = {0, *wanted}
    while True:
        used = {*below([body.then[i] for i in kept])}
        more = kept | {i for i, variable in enumerate(body.variables) if variable in used}
        if more == kept:
            return sorted(kept)
        kept = more


def _ended(own: str, names: list[str], wanted: list[int]) -> list[str]:
    """Returns the lines that keep what the scenes have that end with a pass, and leave them out now and then."""
    rows, alive = f"{own}r", f"{own}a"
    return [
        f"over = flatnonzero({alive} > {names[0]})",
        "if over.size:",
        *(f"    {own}_{i}[{rows}[over]] = some({own}v{i}, over)" for i in wanted),
        f"    {alive} = {alive} & {names[0]}",
        f"    left = flatnonzero({alive})",
        f"    if 4 * left.size < 3 * {rows}.size:",
        f"        {rows}, {alive} = {rows}[left], {alive}[left]",
        *(f"        {name} = some({name}, left)" for name in names),
    ]


def _literal(value: Any) -> str:
    text = repr(value)
    return {"inf": "float('inf')", "-inf": "float('-inf')", "nan": "float('nan')"}.get(text, text)


def _one_for_all(node: Node, args: list[str]) -> str:
    if node.op == "select":
        return f"{args[1]} if {args[0]} else {args[2]}"
    if node.op in ("and", "or", "not"):
        return f"not {args[0]}" if node.op == "not" else f"{args[0]} {node.op} {args[1]}"
    call = f"{NUMPY[node.op]}({', '.join(args)})"
    signs = {"add": "+", "sub": "-", "mul": "*", "lt": "<", "le": "<=", "gt": ">", "ge": ">=", "eq": "==", "ne": "!="}
    if node.op in signs:
        return f"{args[0]} {signs[node.op]} {args[1]}"
    return f"-{args[0]}" if node.op == "neg" else f"bool({call})" if node.is_truth else f"float({call})"
