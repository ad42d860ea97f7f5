"""Overrides from the command line: `axes.0.node_id=5` replaces a value of the scene before validation.

The path is keys and list indices joined by dots (a key that contains a dot is quoted); the value is YAML.
"""

import re
from collections.abc import Sequence
from typing import Any, Final

from canhaptic.registry import nearest
from canhaptic.scene.document import Diagnostics, MarkedList, MarkedMapping, SourceLocation, parse_yaml
from canhaptic.units import shown

_PATH: Final = re.compile(r'(?:"[^"]*"|[^".=]+)(?:\.(?:"[^"]*"|[^".=]+))*')
_SELECTORS: Final = ("type", "algorithm")
"""Keys that select the parameter model, and so the other keys, of their section."""
_LONGEST: Final = 120  # characters of an override that a message shows
_PART: Final = re.compile(r'"([^"]*)"|([^".=]+)')


def apply_overrides(scene: MarkedMapping, overrides: Sequence[str], faults: Diagnostics) -> None:
    """Apply each override to the scene in place, in order; faults name the override."""
    for text in overrides:
        source = f"--set {text if len(text) <= _LONGEST else text[: _LONGEST - 3] + '...'}"
        top = SourceLocation(source, 0, 0, ())
        address, equals, value_text = text.partition("=")
        if not equals or _PATH.fullmatch(address.strip()) is None:
            faults.add(top, "got no PATH=VALUE, expected something like axes.0.node_id=5")
            continue
        path = split_override(text)[0]
        before = len(faults)
        value = parse_yaml(value_text, source, faults, path, lined=False)
        if len(faults) == before:
            _put(scene, path, value, top._replace(path=path), faults)


def split_override(text: str) -> tuple[tuple[str, ...], str]:
    """Return the path of an override, as typed, and its value."""
    address, _, value = text.partition("=")
    return tuple(quoted or plain for quoted, plain in _PART.findall(address.strip())), value


def _put(container: Any, path: tuple[str, ...], value: Any, mark: SourceLocation, faults: Diagnostics) -> None:
    """Set the entry at a path; missing mappings on the path are made."""
    for depth, part in enumerate(path):
        here = mark._replace(path=path[: depth + 1])
        is_last = depth == len(path) - 1
        if isinstance(container, MarkedMapping):
            if is_last and part in _SELECTORS and container.was is None:
                container.was = str(container.get(part, ""))
            if is_last or container.get(part) is None:
                container.put(part, value if is_last else MarkedMapping(here), here, here)
            container = container[part]
        elif isinstance(container, MarkedList):
            index = _index(container, part, here, faults)
            if index is None:
                return
            if is_last:
                container[index], container.values_at[index] = value, here
            container = container[index]
        else:
            faults.add(here._replace(path=path[:depth]), f"got {container!r}, which has no entry {part!r}")
            return


def _index(entries: MarkedList, part: str, here: SourceLocation, faults: Diagnostics) -> int | None:
    """Return the index of a list entry, given as a number or by the entry's name."""
    names = [str(entry.get("name")) if isinstance(entry, MarkedMapping) else "" for entry in entries]
    if part.isascii() and part.isdigit() and len(part) < 6 and int(part) < len(entries):
        return int(part)
    if part in names:
        return names.index(part)
    known = [name for name in names if name]
    last = f" to {len(entries) - 1}" if len(entries) > 1 else ""
    named = f" or a name: {', '.join(known)}" if known else ""
    expected = f"0{last}{named}" if entries else "an index of a list that has entries"
    faults.add(here, f"got index {shown(part)}, expected {expected}{nearest(part, known)}")
    return None
