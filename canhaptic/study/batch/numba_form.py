"""A program written out as a loop over scenes that numba compiles; needs the extra `fast`.

All numbers of a chunk lie in one array, a row for each state or value, `WIDTH` scenes wide. The width is a constant of
the source: the compiler then sees that rows do not overlap, and turns the inner loop into vector instructions. Nothing
is contracted or reordered: the same operations on the same numbers as in NumPy.
"""

from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any, Final

import numba
import numpy as np

from canhaptic.study.batch.layout import Layout, known_values, widened
from canhaptic.study.batch.nodes import Node
from canhaptic.study.batch.numpy_form import BLOCK, Feed
from canhaptic.study.batch.program import Program
from canhaptic.study.loop import Array

WIDTH: Final = 128
"""Scenes in a chunk: a few ten rows of it fit the first-level cache, and loads do not wait for stores of other rows."""
_ARGUMENTS: Final = "count, done, blocks, values, begins, kept, when, ones, given, inputs"
_MAGIC: Final = 6755399441055744.0  # 1.5 * 2^52: adding it rounds to a whole number, halves to even
_INFIX: Final = {
    "add": "+", "sub": "-", "mul": "*", "div": "/", "mod": "%", "floordiv": "//", "lt": "<", "le": "<=", "gt": ">",
    "ge": ">=", "eq": "==", "ne": "!=", "and": "&", "or": "|",
}  # fmt: skip
_CALLED: Final = {
    "neg": "-{0}", "abs": "abs({0})", "sqrt": "sqrt({0})", "exp": "exp({0})", "sin": "sin({0})", "cos": "cos({0})",
    "tan": "tan({0})", "asin": "asin({0})", "floor": "floor({0})", "not": "not {0}",
    "trunc": "copied(floor(abs({0})), {0})", "copysign": "copied(abs({0}), {1})",
    "rint": f"(({{0}} + {_MAGIC}) - {_MAGIC} if abs({{0}}) < 2251799813685248.0 else {{0}})",
    "finite": "abs({0}) < inf", "select": "{1} if {0} else {2}",
    "max": "{1} if {1} > {0} else {0}", "min": "{1} if {1} < {0} else {0}",
}  # fmt: skip


class NumbaForm:
    """A program as a compiled function.

    Attributes:
        source: Of the function.
    """

    def __init__(self, program: Program) -> None:
        self.program = program
        self.layout = Layout(program)
        layout = self.layout
        self._rings = [name for name in layout.states if program.then[name].is_rows]
        self._lane_states = [n for n in layout.states if layout.state_differs(n) and n not in self._rings]
        self._one_states = [name for name in layout.states if not layout.state_differs(name)]
        given = [node for node in layout.fixed if node.op != "const"]
        self._lane_values = [node for node in given if node in layout.lanes]
        self._one_values = [node for node in given if node not in layout.lanes]
        self.source = _source(
            layout, self._lane_states, self._one_states, self._lane_values, self._one_values, self._rings
        )
        self._kernel = compiled(self.source, len(self._rings))

    def run(self, numbers: Mapping[str, Any], count: int, cycles: int, feed: Feed) -> tuple[dict[str, Any], Any]:
        """Returns the states of some scenes after their cycles, or when they diverged, and the cycle of that.

        Args:
            numbers: By parameter, one or of shape (count,).
            count: Scenes.
            cycles: After the first SYNC.
            feed: Gives the inputs of the next cycles.

        Returns:
            State -> value; and for each scene the cycle in which it diverged, 0 where it did not.
        """
        program, layout = self.program, self.layout
        fixed = known_values([*layout.fixed, *program.first.values()], numbers, {})
        chunks = -(-count // WIDTH)
        block = _block([*(fixed[program.first[name]] for name in self._lane_states), 0.0], count)
        values = _block([fixed[node] for node in self._lane_values], count)
        begin = block[:, :-1].copy().reshape(chunks, -1)
        frozen, when = begin.copy(), np.zeros(chunks * WIDTH, dtype=np.int64)
        ones = np.array([float(fixed[program.first[name]]) for name in self._one_states])
        given = np.array([float(fixed[node]) for node in self._one_values])
        lists = [self._list(fixed[program.first[name]], chunks) for name in self._rings]
        flat = block.reshape(chunks, -1), values.reshape(chunks, -1)
        done = 0
        while done < cycles:
            some = min(BLOCK, cycles - done) if program.inputs else cycles
            inputs = self._inputs(feed, some, chunks)
            self._kernel(some, done, *flat, begin, frozen, when, ones, given, inputs, *lists)
            done += some
        return self._states(block, frozen, when, ones, count), when[:count]

    def _inputs(self, feed: Feed, cycles: int, chunks: int) -> Array:
        """Returns the inputs of some cycles, shape (chunks, inputs, cycles, WIDTH)."""
        nodes = self.program.inputs
        found = feed(cycles) if nodes else {}
        padded = np.zeros((len(nodes), cycles if nodes else 0, chunks * WIDTH))
        for i, node in enumerate(nodes):
            padded[i, :, : found[node.value].shape[1]] = found[node.value]
        return np.ascontiguousarray(padded.reshape(*padded.shape[:2], chunks, WIDTH).transpose(2, 0, 1, 3))

    def _list(self, rows: Any, chunks: int) -> Array:
        """Returns the rows of a list, shape (chunks, rows, WIDTH)."""
        padded = np.empty((len(rows), chunks * WIDTH))
        padded[:] = rows[:, -1:]
        padded[:, : rows.shape[1]] = rows
        return np.ascontiguousarray(padded.reshape(len(rows), chunks, WIDTH).swapaxes(0, 1))

    def _states(self, block: Array, frozen: Array, when: Any, ones: Array, count: int) -> dict[str, Any]:
        chunks = len(block)
        kept = frozen.reshape(chunks, -1, WIDTH)
        states: dict[str, Any] = {}
        for i, name in enumerate(self._lane_states):
            row = np.where(when > 0, kept[:, i].ravel(), block[:, i].ravel())[:count]
            states[name] = widened(row, count, self.program.then[name].is_truth)
        return states | dict(zip(self._one_states, ones.tolist(), strict=True))


def _block(rows: list[Any], count: int) -> Array:
    """Returns numbers or arrays of shape (count,) as chunks, shape (chunks, rows, WIDTH), the last scene repeated."""
    chunks = -(-count // WIDTH)
    block = np.empty((chunks, len(rows), WIDTH))
    for i, values in enumerate(rows):
        row = np.full(chunks * WIDTH, values if np.ndim(values) == 0 else values[-1], dtype=float)
        row[:count] = values
        block[:, i] = row.reshape(chunks, WIDTH)
    return block


@lru_cache(maxsize=64)
def compiled(source: str, lists: int) -> Callable[..., None]:
    """Returns the function of a source, compiled for its only types."""
    names: dict[str, Any] = {name: getattr(np, name) for name in ("floor",)}
    names |= {name: getattr(__import__("math"), name) for name in ("sqrt", "exp", "sin", "cos", "tan", "asin", "inf")}
    names |= {"copied": numba.njit(_copied, inline="always"), "place": numba.njit(_place, inline="always")}
    exec(compile(source, "<batch>", "exec"), names)
    types = ["int64", "int64", *["float64[:, ::1]"] * 4, "int64[::1]", *["float64[::1]"] * 2, "float64[:, :, :, ::1]"]
    types += ["float64[:, :, ::1]"] * lists
    function: Callable[..., None] = numba.njit(f"void({', '.join(types)})", error_model="numpy")(names["cycles"])
    return function


def _copied(size: float, sign: float) -> float:
    return size if sign >= 0.0 else -size


def _place(index: float, rows: int) -> int:
    """Returns the row of an index, inside of the list also for a scene whose numbers are none any more."""
    if index >= rows:
        return rows - 1
    return int(index) if index >= 0.0 else 0


def _source(
    layout: Layout,
    lane_states: list[str],
    one_states: list[str],
    lane_values: list[Node],
    one_values: list[Node],
    rings: list[str],
) -> str:
    """Returns the text of the function; see `NumbaForm.run` for its arguments."""
    program = layout.program
    states = {n: program.out.graph.slot(n, program.then[n]) for n in layout.states}
    name = {node: _literal(node.value) for node in layout.fixed if node.op == "const"}
    own = {"v": lane_values, "g": one_values}
    own |= {kind: [states[n] for n in names] for kind, names in (("r", rings), ("s", lane_states), ("o", one_states))}
    for kind, nodes in own.items():
        name |= {node: f"{kind}{i}" for i, node in enumerate(nodes)}
    name |= {node: f"x{i}" for i, node in enumerate(program.inputs)}
    once: list[str] = []
    each: list[str] = []
    for node in layout.steps:
        (each if node in layout.lanes else once).extend(_lines(node, name))
    load = [_loaded(f"s{i}", i, states[n].is_truth) for i, n in enumerate(lane_states)]
    load += [f"x{i} = inputs[chunk, {i}, cycle, i]" for i in range(len(program.inputs))]
    load += [_loaded(f"v{i}", i, node.is_truth, "fixed") for i, node in enumerate(lane_values)]
    keep = [
        f"rows[{i * WIDTH} + i] = {_stored(name[program.then[n]], program.then[n].is_truth)}"
        for i, n in enumerate(lane_states)
        if program.then[n] is not states[n]
    ]
    out = name[program.out]
    keep += [f"rows[{len(lane_states) * WIDTH} + i] = 1.0 if {out} else 0.0", f"bad += 1 if {out} else 0"]
    turn = [f"o{i} = {name[program.then[n]]}" for i, n in enumerate(one_states)]
    lines = [
        f"def cycles({', '.join((_ARGUMENTS, *(f'r{i}' for i in range(len(rings)))))}):",
        *(f"    g{i} = given[{i}]{' != 0.0' if node.is_truth else ''}" for i, node in enumerate(one_values)),
        "    for chunk in range(blocks.shape[0]):",
        "        rows, fixed = blocks[chunk], values[chunk]",
        *(f"        o{i} = ones[{i}]{' != 0.0' if states[n].is_truth else ''}" for i, n in enumerate(one_states)),
        "        for cycle in range(count):",
        *(f"            {line}" for line in once),
        "            bad = 0",
        f"            for i in range({WIDTH}):",
        *(f"                {line}" for line in (*load, *each, *keep)),
        *(f"            {line}" for line in (*_at_once(turn), *_escapes(len(lane_states)))),
        *(f"    ones[{i}] = {_stored(f'o{i}', states[n].is_truth)}" for i, n in enumerate(one_states)),
    ]
    return "\n".join(lines) + "\n"


def _escapes(states: int) -> list[str]:
    """Returns the lines that keep the states of scenes that just diverged, and put them back to their start."""
    return [
        "if bad:",
        f"    for i in range({WIDTH}):",
        f"        if rows[{states * WIDTH} + i] != 0.0:",
        f"            first = when[chunk * {WIDTH} + i] == 0",
        "            if first:",
        f"                when[chunk * {WIDTH} + i] = done + cycle + 1",
        f"            for row in range({states}):",
        "                if first:",
        f"                    kept[chunk, row * {WIDTH} + i] = rows[row * {WIDTH} + i]",
        f"                rows[row * {WIDTH} + i] = begins[chunk, row * {WIDTH} + i]",
    ]


def _at_once(turn: list[str]) -> list[str]:
    if not turn:
        return []
    left, right = zip(*(line.split(" = ") for line in turn), strict=True)
    return [f"{', '.join(left)}, = {', '.join(right)},"]


def _loaded(name: str, row: int, is_truth: bool, source: str = "rows") -> str:
    return f"{name} = {source}[{row * WIDTH} + i]{' != 0.0' if is_truth else ''}"


def _stored(value: str, is_truth: bool) -> str:
    return f"1.0 if {value} else 0.0" if is_truth else value


def _lines(node: Node, name: dict[Node, str]) -> list[str]:
    """Returns the lines of an operation, and names its result."""
    args = [name[arg] for arg in node.args]
    name[node] = f"t{node.number}"
    if node.op == "loop":
        return _loop(node, args, name)
    if node.op == "out":
        name[node] = f"{args[0]}_{node.value}"
        return []
    if node.op == "store":
        name[node] = args[0]
        store = f"{args[0]}[chunk, place({args[1]}, {args[0]}.shape[1]), i] = {args[2]}"
        return [store if args[3] == "True" else f"if {args[3]}: {store}"]
    return [f"{name[node]} = {_text(node, args)}"]


def _loop(node: Node, args: list[str], name: dict[Node, str]) -> list[str]:
    """Returns the lines of a loop of one scene."""
    body, own = node.value, name[node]
    names = [f"{own}_{i}" for i in range(len(body.variables))]
    inside = name | dict(zip(body.variables, names, strict=True))
    lines = [f"{target} = {value}" for target, value in zip(names, args, strict=False)]
    passes: list[str] = []
    for part in body.inside():
        for arg in (*part.args, *body.then):
            if arg.op == "const":
                inside.setdefault(arg, _literal(arg.value))
        passes += _lines(part, inside)
    then = [_literal(value.value) if value.op == "const" else inside[value] for value in body.then]
    passes.append(f"{', '.join(names)}, = {', '.join(then)},")
    return [*lines, f"while {names[0]}:", *(f"    {line}" for line in passes)]


def _text(node: Node, args: list[str]) -> str:
    if node.op == "load":
        return f"{args[0]}[chunk, place({args[1]}, {args[0]}.shape[1]), i]"
    if node.op in _INFIX:
        return f"{args[0]} {_INFIX[node.op]} {args[1]}"
    return _CALLED[node.op].format(*args)


def _literal(value: Any) -> str:
    text = repr(value)
    return {"inf": "inf", "-inf": "(-inf)", "nan": "(inf - inf)"}.get(text, f"({text})" if text[0] == "-" else text)
