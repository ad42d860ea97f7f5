"""Replacement of values in the text of a scene, which keeps comments, order and everything else."""

import re
from collections.abc import Iterable, Iterator, Sequence
from typing import Final, NamedTuple

import yaml

from canhaptic.errors import InputError
from canhaptic.scene.document import compose
from canhaptic.scene.load import scene_from_text
from canhaptic.scene.models import Scene
from canhaptic.scene.overrides import split_override

_COMMENT: Final = re.compile(r"[ \t]*(#.*)?$", re.MULTILINE)


class Change(NamedTuple):
    """New value or comment for one entry of a scene."""

    path: tuple[str, ...]  # keys, and indices or names of list entries
    value: str | None  # as YAML; None: an entry that is written keeps its value, and a missing one is not added
    comment: str | None = None  # replaces the comment of the line; None: kept


def edited_scene(scene: Scene, changes: Sequence[Change], place: str, *, allow_code: bool = False) -> str:
    """Return the text of a scene with its overrides and further changes written into it.

    Args:
        scene: Scene as loaded.
        changes: Changes, applied in order.
        place: File that the text is for; relative paths start from it.
        allow_code: As for `load_scene`.

    Raises:
        InputError: The edited text would not mean the changed scene.
        SceneError: The changed scene is wrong.
    """
    overrides = [Change(*split_override(text)) for text in scene.overrides]
    text = edited_text(scene.text, [*overrides, *changes, *_kept_apart(scene.text, changes)])
    typed = [f"{'.'.join(_quoted(change.path))}={change.value}" for change in changes if change.value is not None]
    expected = scene_from_text(scene.text, place, [*scene.overrides, *typed], allow_code=allow_code)
    if scene_from_text(text, place, allow_code=allow_code).resolved() != expected.resolved():
        raise InputError(f"{scene.source}: cannot be edited line by line: anchors, or values over several lines; "
                         "write each value of each axis where it belongs, on a line of its own")  # fmt: skip
    return text


def _kept_apart(text: str, changes: Sequence[Change]) -> Iterator[Change]:
    """Yield the old value of each key that an axis merges (`<<`) from an axis whose value changes."""
    axes = _child(compose(text), "axes")
    changed = [change.path[1:] for change in changes if change.path[:1] == ("axes",) and change.value is not None]
    given = [path for path in changed if _child(_child(axes, path[0]), "<<") is None]  # in a mapping that others merge
    for n, axis in enumerate(axes.value if isinstance(axes, yaml.SequenceNode) else ()):
        names = (str(n), getattr(_child(axis, "name"), "value", ""))
        own = {path[1:] for path in changed if path[0] in names}
        for name, *key in given if _child(axis, "<<") is not None else ():
            if len(key) == 1 and tuple(key) not in own and _child(axis, key[0]) is None:
                before = _child(_child(axes, name), key[0])
                value = "null" if before is None else text[before.start_mark.index : before.end_mark.index]
                yield Change(("axes", str(n), key[0]), value)


def edited_text(text: str, changes: Iterable[Change]) -> str:
    """Return YAML text with changes applied in order.

    Raises:
        InputError: A path leads to a whole section, or below a single value.
    """
    for change in changes:
        node: yaml.Node | None = compose(text)
        for depth, part in enumerate(change.path):
            child = _child(node, part)
            if child is None:
                text = text if change.value is None else _inserted(text, node, change.path[depth:], change)
                break
            node = child
        else:
            text = _replaced(text, node, change)
    return text


def is_written(text: str, path: Iterable[str]) -> bool:
    """Return whether YAML text has an entry at a path."""
    node: yaml.Node | None = compose(text)
    for part in path:
        node = _child(node, part)
    return node is not None


def _quoted(path: Iterable[str]) -> list[str]:
    return [f'"{part}"' if "." in part else part for part in path]


def _child(node: yaml.Node | None, part: str) -> yaml.Node | None:
    """Return the entry of a mapping by key, or of a list by index or `name`; None if there is none."""
    if isinstance(node, yaml.MappingNode):
        return next((value for key, value in node.value if key.value == part), None)
    if isinstance(node, yaml.SequenceNode):
        if part.isdigit():
            return node.value[int(part)] if int(part) < len(node.value) else None
        return next((item for item in node.value if getattr(_child(item, "name"), "value", None) == part), None)
    return None


def _replaced(text: str, node: yaml.Node | None, change: Change) -> str:
    """Return the text with another value, and another comment if the value ends its line."""
    if not isinstance(node, yaml.ScalarNode):
        raise InputError(f"{'.'.join(change.path)}: is a whole section; put it into the scene's file first")
    begin, end = node.start_mark.index, node.end_mark.index
    value = text[begin:end] if change.value is None else change.value
    behind = _COMMENT.match(text, end)
    if change.comment is None or behind is None:
        return text[:begin] + value + text[end:]
    after = _after_comment(text, behind.end(), node.start_mark.column)
    line = text[text.rfind("\n", 0, begin) + 1 : begin] + value
    width = behind.start(1) - text.rfind("\n", 0, end) - 1 if behind[1] else 0
    return (
        f"{text[: begin - len(line) + len(value)]}{line:<{max(width, len(line) + 2)}}# {change.comment}{text[after:]}"
    )


def _after_comment(text: str, end: int, column: int) -> int:
    """Return the end of a comment that continues on further lines: pure comments, right of a column."""
    while following := re.compile(rf"\n {{{column + 1},}}#.*").match(text, end):
        end = following.end()
    return end


def _inserted(text: str, node: yaml.Node | None, path: Sequence[str], change: Change) -> str:
    """Return the text with a new entry behind the last one of a mapping."""
    if not isinstance(node, yaml.MappingNode) or not node.value:
        raise InputError(f"{'.'.join(change.path)}: cannot be written there; give {path[0]} in the scene's file first")
    key, *below = path
    if node.flow_style:
        inside = "".join(f"{{{part}: " for part in below) + str(change.value) + "}" * len(below)
        begin = node.start_mark.index + 1
        return f"{text[:begin]}{key}: {inside}, {text[begin:]}"
    first, last = node.value[0][0], node.value[-1][0]
    behind = _COMMENT.search(text, max(last.end_mark.index, _end(node)))
    end = _after_comment(text, len(text) if behind is None else behind.end(), first.start_mark.column + 4)
    indents = [" " * (first.start_mark.column + 2 * depth) for depth in range(len(path))]
    lines = [f"{indent}{part}:" for indent, part in zip(indents, path, strict=True)]
    comment = f"  # {change.comment}" if change.comment else ""
    return "\n".join([text[:end].removesuffix("\n"), *lines[:-1], f"{lines[-1]} {change.value}{comment}"]) + (
        text[end:] or "\n"
    )


def _end(node: yaml.Node) -> int:
    """Return where the last value of a node ends; YAML's own end of a block includes the comments behind it."""
    if not isinstance(node, yaml.CollectionNode) or node.flow_style or not node.value:
        return int(node.end_mark.index)
    last = node.value[-1]
    return _end(last[1] if isinstance(node, yaml.MappingNode) else last)
