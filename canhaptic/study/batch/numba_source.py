"""The text of the function that numba compiles: what is done for every scene of a chunk, in phases.

What the compiler turns into vector instructions and what it cannot (a loop that data end, an entry at a place that data
choose) are kept apart: each phase is a loop of its own over the scenes of a chunk, and what a later phase needs of an
earlier one lies in rows of `work`. The order of the operations of one scene stays what it was.
"""

from collections.abc import Iterable
from typing import Any, Final

from canhaptic.study.batch.layout import Layout
from canhaptic.study.batch.nodes import Node

WIDTH: Final = 128
"""Scenes in a chunk: a few ten rows of it fit the first-level cache, and loads do not wait for stores of other rows."""
_ARGUMENTS: Final = "count, done, blocks, values, begins, kept, when, ones, given, inputs, work"
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


class NumbaSource:
    """Writes the function.

    Attributes:
        text: Of it.
        work: Rows that the phases hand over.
    """

    def __init__(
        self, layout: Layout, lane_states: list[str], one_states: list[str], lane_values: list[Node],
        one_values: list[Node], rings: list[str],
    ) -> None:  # fmt: skip
        program = layout.program
        self._layout, self._lane_states, self._one_states, self._rings = layout, lane_states, one_states, rings
        self._slot = {n: program.out.graph.slot(n, program.then[n]) for n in layout.states}
        self._one_values = one_values
        self._name = {node: _literal(node.value) for node in layout.fixed if node.op == "const"}
        states = {kind: [self._slot[n] for n in names] for kind, names in (("s", lane_states), ("o", one_states))}
        lists = [self._slot[n] for n in rings]
        own = {"v": lane_values, "g": one_values, "r": lists, "x": list(program.inputs), **states}
        for kind, nodes in own.items():
            self._name |= {node: f"{kind}{i}" for i, node in enumerate(nodes)}
        self._loads = {n: _loaded(f"s{i}", i, n.is_truth) for i, n in enumerate(states["s"])}
        self._loads |= {n: f"x{i} = inputs[chunk, {i}, cycle, i]" for i, n in enumerate(program.inputs)}
        self._loads |= {n: _loaded(f"v{i}", i, n.is_truth, "fixed") for i, n in enumerate(lane_values)}
        self.work = 0
        self.text = self._text()

    def _text(self) -> str:
        layout, name = self._layout, self._name
        phases, once, lines = phases_of(layout), [], {}
        for node in layout.steps:
            if node in phases:
                lines[node] = _lines(node, name)
            else:
                once += _lines(node, name)
        loops = self._loops(phases, lines)
        turn = [f"o{i} = {name[layout.program.then[n]]}" for i, n in enumerate(self._one_states)]
        ones = [(i, self._slot[n].is_truth) for i, n in enumerate(self._one_states)]
        text = [
            f"def cycles({', '.join((_ARGUMENTS, *(f'r{i}' for i in range(len(self._rings)))))}):",
            *(f"    g{i} = given[{i}]{' != 0.0' if node.is_truth else ''}" for i, node in enumerate(self._one_values)),
            "    for chunk in range(blocks.shape[0]):",
            "        rows, fixed = blocks[chunk], values[chunk]",
            *(f"        o{i} = ones[{i}]{' != 0.0' if is_truth else ''}" for i, is_truth in ones),
            "        for cycle in range(count):",
            *(f"            {line}" for line in once),
            "            bad = 0",
            *(f"            {line}" for line in loops),
            *(f"            {line}" for line in (*_at_once(turn), *_escapes(len(self._lane_states)))),
            *(f"    ones[{i}] = {_stored(f'o{i}', is_truth)}" for i, is_truth in ones),
        ]
        return "\n".join(text) + "\n"

    def _loops(self, phases: dict[Node, int], lines: dict[Node, list[str]]) -> list[str]:
        """Returns one loop over the scenes for each phase; the last one leaves the states to the next cycle."""
        program, name = self._layout.program, self._name
        changed = [
            (i, program.then[n]) for i, n in enumerate(self._lane_states) if program.then[n] is not self._slot[n]
        ]
        last = max(phases.values(), default=0)
        last += last % 2
        keep = [f"rows[{i * WIDTH} + i] = {_stored(name[node], node.is_truth)}" for i, node in changed]
        out = name[program.out]
        keep += [f"rows[{len(self._lane_states) * WIDTH} + i] = 1.0 if {out} else 0.0", f"bad += 1 if {out} else 0"]
        members: list[list[Node]] = [[] for _ in range(last + 1)]
        for node, phase in phases.items():
            members[phase].append(node)
        needs = [_needs(nodes) for nodes in members]
        needs[last] |= {node for _, node in changed} | {program.out}
        places: dict[Node, int] = {}
        found = []
        for phase, nodes in enumerate(members):
            handed = {n for later in needs[phase + 1 :] for n in later}
            body = [self._loads[node] for node in _ordered(needs[phase]) if node in self._loads]
            body += [_loaded(name[n], places[n], n.is_truth, "work") for n in _ordered(needs[phase]) if n in places]
            for node in nodes:
                body += lines[node]
            for node in nodes:
                if node in handed and not (node.is_rows or node.op == "loop"):
                    places[node] = len(places)
                    body.append(f"work[{places[node] * WIDTH} + i] = {_stored(name[node], node.is_truth)}")
            body += keep if phase == last else []
            if body:
                found += [f"for i in range({WIDTH}):", *(f"    {line}" for line in body)]
        self.work = len(places)
        return found


def phases_of(layout: Layout) -> dict[Node, int]:
    """Returns the phase of each node that is done for every scene: even where it can be vector instructions."""
    phases: dict[Node, int] = {}
    used: dict[Any, int] = {}  # list -> last phase that reads or changes it
    for node in layout.steps:
        if node not in layout.lanes:
            continue
        phase = max((phases[arg] for arg in node.args if arg in phases), default=0)
        lists = [_list_of(arg) for arg in node.args if arg.is_rows]
        if node.op == "store":
            phase = max(phase, *(used.get(name, 0) for name in lists))
        slow = node.op == "loop" or (node.op in ("load", "store") and node.args[1] in layout.lanes)
        if node.op != "out" and phase % 2 != slow:
            phase += 1
        phases[node] = phase
        used |= {name: max(used.get(name, 0), phase) for name in lists}
    return phases


def _list_of(node: Node) -> Any:
    while node.op == "store":
        node = node.args[0]
    return node.value


def _needs(nodes: list[Node]) -> set[Node]:
    """Returns what is read and not made in a phase."""
    made = {*nodes}
    return {arg for node in nodes for arg in node.args if arg not in made}


def _ordered(nodes: Iterable[Node]) -> list[Node]:
    return sorted(nodes, key=lambda node: node.number)


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
        place = f"{args[0]}[chunk, place({args[1]}, {args[0]}.shape[1]), i]"
        return [f"{place} = {args[2]}" if args[3] == "True" else f"{place} = {args[2]} if {args[3]} else {place}"]
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
