"""Makes every small change of a module that a slip of the hand could make, one at a time, compiled in memory.

A mutation replaces one field of one node of the syntax tree. It is named by the function it is in and by its text
before and after, never by a line number, so that a list of known mutants survives edits elsewhere. What is the same
program in other words is not made (`same_program`).
"""

import ast
from collections.abc import Iterator, Mapping, Sequence
from enum import Enum
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any, NamedTuple

from tests.mutation.same_program import EDGES, same_at_the_edge, same_for_a_size

_OTHERS: dict[type, tuple[type, ...]] = {
    ast.Lt: (ast.LtE, ast.Gt),
    ast.LtE: (ast.Lt, ast.GtE),
    ast.Gt: (ast.GtE, ast.Lt),
    ast.GtE: (ast.Gt, ast.LtE),
    ast.Eq: (ast.NotEq, ast.LtE, ast.GtE),
    ast.NotEq: (ast.Eq, ast.Lt, ast.Gt),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
    ast.Add: (ast.Sub, ast.Mult),
    ast.Sub: (ast.Add,),
    ast.Mult: (ast.Div, ast.Add),
    ast.Div: (ast.Mult,),
    ast.FloorDiv: (ast.Mult,),
    ast.Mod: (ast.Mult,),
    ast.Pow: (ast.Mult,),
    ast.BitAnd: (ast.BitOr, ast.BitXor),
    ast.BitOr: (ast.BitAnd,),  # bits that do not overlap are the same under ^
    ast.BitXor: (ast.BitAnd, ast.BitOr),
    ast.LShift: (ast.RShift,),
    ast.RShift: (ast.LShift,),
    ast.And: (ast.Or,),
    ast.Or: (ast.And,),
    ast.USub: (ast.UAdd,),
    ast.Invert: (ast.UAdd,),
    ast.Not: (ast.UAdd,),  # +True is true as well
}
_LONGEST, _CONTEXT = 110, 25  # characters of a name
_BITS = 8  # of a mask that are flipped: states and commands are in the low byte
_Sites = Iterator[tuple[ast.AST, str, Any]]
"""A node, the name of one of its fields, and the value that the field gets."""


class Mutant(NamedTuple):
    """One changed module, not yet run."""

    name: str
    code: CodeType


class Change(NamedTuple):
    """One changed module as text, and where it was changed."""

    name: str
    tree: ast.Module
    first: int  # line of the statement
    last: int  # its last one, without the block below it


def mutants(
    path: Path, members: Mapping[str, type[Enum]], names: Mapping[str, Sequence[str]] | None = None
) -> Iterator[Mutant]:
    """Yields every mutant of a module, in the order of its text.

    Args:
        path: Of the module.
        members: Enumerations by the name they have in the module; each use of a member becomes each of its neighbours.
        names: Further names and what each is taken for.
    """
    for change in changes(path, members, names):
        yield Mutant(change.name, compile(change.tree, str(path), "exec"))


def changes(
    path: Path, members: Mapping[str, type[Enum]], names: Mapping[str, Sequence[str]] | None = None
) -> Iterator[Change]:
    """Yields every mutant as a syntax tree, which is changed again behind each. As `mutants`."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    seen: dict[str, int] = {}
    for scope, body, place in list(_statements(tree.body, "module")):
        statement = body[place]
        text = _head(statement)
        lines = statement.lineno, _last_line(statement)
        following = body[place + 1] if place + 1 < len(body) else None
        for node, field, value in _sites(statement, following, members, names or {}):
            old = getattr(node, field)
            setattr(node, field, value)
            ast.fix_missing_locations(statement)
            yield Change(_numbered(f"{scope}: {_change(text, _head(statement))}", seen), tree, *lines)
            setattr(node, field, old)
        if scope != "module" and _may_be_left_out(statement):
            body[place] = ast.copy_location(ast.Pass(), statement)
            yield Change(_numbered(f"{scope}: {text} => left out", seen), tree, *lines)
            body[place] = statement


def load(code: CodeType) -> ModuleType:
    """Runs a mutant and returns it as a module that nothing else can import."""
    module = ModuleType("mutant")
    module.__file__ = code.co_filename  # by which some read their tables
    exec(code, module.__dict__)
    return module


def _numbered(name: str, seen: dict[str, int]) -> str:
    seen[name] = number = seen.get(name, 0) + 1
    return name if number == 1 else f"{name} #{number}"


def _head(statement: ast.stmt) -> str:
    """The text of a statement without the block below it."""
    lines = ast.unparse(statement).splitlines()
    return lines[0] if hasattr(statement, "body") else " ".join(line.strip() for line in lines)


def _last_line(statement: ast.stmt) -> int:
    """The last line of what `_head` is the text of."""
    body = getattr(statement, "body", None)
    return max(statement.lineno, body[0].lineno - 1) if body else statement.end_lineno or statement.lineno


def _change(before: str, after: str) -> str:
    """Both texts of a statement; of a long one, such as a table, only what is near the change."""
    if len(before) <= _LONGEST:
        return f"{before} => {after}"
    start = before.rfind(" ", 0, max(0, _alike(before, after) - _CONTEXT)) + 1
    end = max(0, _alike(before[start:][::-1], after[start:][::-1]) - _CONTEXT)
    return f"..{before[start : len(before) - end]}.. => ..{after[start : len(after) - end]}.."


def _alike(one: str, other: str) -> int:
    """How many characters two texts begin alike with."""
    return next((n for n, (a, b) in enumerate(zip(one, other, strict=False)) if a != b), min(len(one), len(other)))


def _statements(body: list[ast.stmt], scope: str) -> Iterator[tuple[str, list[ast.stmt], int]]:
    """Every statement with the name of its function or class, as a place in a block."""
    for place, statement in enumerate(body):
        yield scope, body, place
        inner = scope
        if isinstance(statement, ast.FunctionDef | ast.ClassDef):
            inner = statement.name if scope == "module" else f"{scope}.{statement.name}"
        for block in ("body", "orelse"):
            yield from _statements(getattr(statement, block, []), inner)


def _may_be_left_out(statement: ast.stmt) -> bool:
    if isinstance(statement, ast.Assign):
        return ast.unparse(statement.targets[0]) != "__slots__"
    return isinstance(statement, ast.AugAssign | ast.Raise) or (
        isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Call)
    )


def _sites(
    statement: ast.stmt,
    following: ast.stmt | None,
    members: Mapping[str, type[Enum]],
    names: Mapping[str, Sequence[str]],
) -> _Sites:
    if isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant):
        return  # a docstring
    same = same_at_the_edge(statement, following)
    for node in _nodes(statement):
        yield from _operators(node, node in same)
        yield from _constants(node)
        yield from _masks(node)
        yield from _exchanges(node, members, names)
    if isinstance(statement, ast.If):
        yield statement, "test", ast.UnaryOp(ast.Not(), statement.test)
    elif isinstance(statement, ast.Return) and statement.value and ast.unparse(statement.value) != "None":
        yield statement, "value", ast.Constant(None)


def _nodes(node: ast.AST) -> Iterator[ast.AST]:
    """The node and all below it, without statements, annotations and the text of messages."""
    yield node
    for field, value in ast.iter_fields(node):
        if field in ("annotation", "returns", "decorator_list"):
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST) and not isinstance(child, ast.stmt | ast.JoinedStr):
                yield from _nodes(child)


def _operators(node: ast.AST, is_same_at_the_edge: bool) -> _Sites:
    if isinstance(node, ast.Compare):
        for place, operator in enumerate(node.ops):
            for other in _OTHERS.get(type(operator), ()):
                if (is_same_at_the_edge and other is EDGES[type(operator)]) or same_for_a_size(node, other):
                    continue
                yield node, "ops", [*node.ops[:place], other(), *node.ops[place + 1 :]]
    elif isinstance(node, ast.BinOp | ast.BoolOp | ast.AugAssign | ast.UnaryOp):
        for other in _OTHERS.get(type(node.op), ()):
            yield node, "op", other()


def _constants(node: ast.AST) -> _Sites:
    if not isinstance(node, ast.Constant):
        return
    value = node.value
    if isinstance(value, bool):
        yield node, "value", not value
    elif isinstance(value, int):
        yield node, "value", value + 1
        yield node, "value", value - 1
    elif isinstance(value, float):
        yield node, "value", value + 1.0
        yield node, "value", value - 1.0
        if value not in (0.0, 1.0):
            yield node, "value", value * 2.0
    elif value is None:
        yield node, "value", ...


def _masks(node: ast.AST) -> _Sites:
    """Flips each bit of an integer that is an operand of bits, an entry of a table or a constant with a name."""
    places: list[ast.expr | None] = []
    if isinstance(node, ast.Tuple | ast.List):
        places = [*node.elts]
    elif isinstance(node, ast.Dict):
        places = [*node.keys, *node.values]
    elif isinstance(node, ast.BinOp) and isinstance(node.op, ast.BitAnd | ast.BitOr | ast.BitXor):
        places = [node.left, node.right]
    elif isinstance(node, ast.AnnAssign):
        places = [node.value]
    for place in places:
        if isinstance(place, ast.Constant) and type(place.value) is int:
            for bit in range(_BITS):
                if (other := place.value ^ 1 << bit) not in (place.value + 1, place.value - 1):
                    yield place, "value", other


def _exchanges(node: ast.AST, members: Mapping[str, type[Enum]], names: Mapping[str, Sequence[str]]) -> _Sites:
    """Takes a member of an enumeration for the one before and the one after it, and a name for those like it."""
    if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in members:
        every = list(members[node.value.id].__members__)
        place = every.index(node.attr)
        for other in (every[place - 1], every[(place + 1) % len(every)]):
            yield node, "attr", other
    elif isinstance(node, ast.Name | ast.Attribute):
        field = "id" if isinstance(node, ast.Name) else "attr"
        for other in names.get(getattr(node, field), ()):
            yield node, field, other
