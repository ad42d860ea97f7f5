"""Gives a scene of release 0.1 or 0.2 the names and keys of this one: `python tools/convert_scene.py SCENE > NEW`.

Comments and order are kept. What changed goes to standard error, a line each. A scene of the first release is given
what that took for granted and what is declared now: no damping of the device, and a hand that pushes as it pulls.
"""

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import yaml

from canhaptic.audit.recompute import GONE_KEYS, OLD_ALGORITHMS, OLD_KEYS
from canhaptic.scene.document import compose


class Edit(NamedTuple):
    """A part of the text and what replaces it."""

    start: int
    end: int
    text: str
    said: str  # what it does, in words


def converted(text: str) -> tuple[str, list[str]]:
    """Returns a scene by the names of now, and what changed in words.

    Args:
        text: The scene as YAML.

    Raises:
        yaml.YAMLError: It is not valid YAML.
    """
    root = compose(text)
    edits = set(_edits(text, root)) if isinstance(root, yaml.MappingNode) else set()
    whole = len(text)
    for edit in sorted(edits, reverse=True):
        text = text[: edit.start] + edit.text + text[min(edit.end, whole) :]
        whole = edit.start
    return text, [edit.said for edit in sorted(edits)]


def _edits(text: str, root: yaml.MappingNode) -> Iterator[Edit]:
    for section, is_of_axis in _sections(root):
        yield from _edits_of(text, section, is_of_axis)
        keys = {key.value for key, _ in section.value}
        if keys & OLD_KEYS.keys():
            yield from _declared(text, section, keys, is_of_axis)
    for name, section in root.value:
        if name.value == "simulation" and isinstance(section, yaml.MappingNode):
            for index, (key, _) in enumerate(section.value):
                if key.value == "compiled":
                    yield _without(text, section, index)


def _edits_of(text: str, section: yaml.MappingNode, is_of_axis: bool) -> Iterator[Edit]:
    for index, (key, value) in enumerate(section.value):
        place, now = _place(key), OLD_KEYS.get(key.value, key.value)
        if now in GONE_KEYS:
            yield _without(text, section, index)
        elif now != key.value:
            yield Edit(key.start_mark.index, key.end_mark.index, now, f"{place}: {key.value} is now {now}")
        elif key.value == "algorithm" and is_of_axis and value.value in OLD_ALGORITHMS:
            new = OLD_ALGORITHMS[value.value]
            yield Edit(value.start_mark.index, value.end_mark.index, new, f"{_place(value)}: now {new}")


def _sections(root: yaml.MappingNode) -> Iterator[tuple[yaml.MappingNode, bool]]:
    """Yields every section `passivity`, and whether its algorithm is one of an axis."""
    owners: list[tuple[yaml.Node, bool]] = [(root, True)]
    for key, value in root.value:
        if key.value in ("axes", "groups") and isinstance(value, yaml.SequenceNode):
            owners += [(entry, key.value == "axes") for entry in value.value]
    for owner, is_of_axis in owners:
        for key, value in owner.value if isinstance(owner, yaml.MappingNode) else ():
            if key.value == "passivity" and isinstance(value, yaml.MappingNode):
                yield value, is_of_axis


def _without(text: str, section: yaml.MappingNode, index: int) -> Edit:
    """Returns the edit that takes an entry out of a section: its lines, or its part of a line."""
    key, value = section.value[index]
    start, end, said = key.start_mark.index, value.end_mark.index, f"{_place(key)}: {key.value} is gone, left out"
    if not section.flow_style:
        line_end = text.find("\n", end)
        return Edit(text.rfind("\n", 0, start) + 1, len(text) if line_end < 0 else line_end + 1, "", said)
    if index + 1 < len(section.value):
        return Edit(start, section.value[index + 1][0].start_mark.index, "", said)
    return Edit(section.value[index - 1][1].end_mark.index if index else start, end, "", said)


def _declared(text: str, section: yaml.MappingNode, keys: set[str], is_of_axis: bool) -> Iterator[Edit]:
    """Yields the edit that declares what the first release took for granted."""
    if ("algorithm", "guarded") not in {(key.value, value.value) for key, value in section.value}:
        return
    pull = next((text[v.start_mark.index : v.end_mark.index] for k, v in section.value if k.value == "hand_force"), "0")
    then = {"device_damping_bound": "0", **({"hand_push": pull} if is_of_axis else {})}
    first = section.value[0][0]
    for key, value in then.items():
        if key not in keys and value not in ("null", "~", ""):
            between = ", " if section.flow_style else "\n" + " " * first.start_mark.column
            at = first.start_mark.index
            yield Edit(at, at, f"{key}: {value}{between}", f"{_place(first)}: {key} is needed now, taken as {value}")


def _place(node: yaml.Node) -> str:
    return f"line {node.start_mark.line + 1}"


def main(words: list[str] | None = None) -> int:
    """Converts a scene and returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path)
    text, said = converted(parser.parse_args(words).scene.read_text(encoding="utf-8"))
    sys.stdout.write(text)
    for line in said:
        print(line, file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main())
