"""Overrides from the command line: `axes.0.node_id=5` replaces a value of the scene before validation.

The path is keys and list indices joined by dots (a key that contains a dot is quoted); the value is YAML.
"""

import re
import warnings
from collections.abc import Sequence
from multiprocessing import parent_process
from typing import Any, Final, get_origin

from pydantic.fields import FieldInfo

from canhaptic.axis_units import Motion
from canhaptic.errors import OverrideWarning
from canhaptic.registry import nearest
from canhaptic.scene.components import ComponentOf, SceneContext
from canhaptic.scene.document import Diagnostics, MarkedList, MarkedMapping, SourceLocation, parse_yaml
from canhaptic.units import Parameters, Quantity, parts_of, shown

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


def _put(container: Any, path: tuple[str, ...], value: object, mark: SourceLocation, faults: Diagnostics) -> None:
    """Set the entry at a path; missing mappings on the path are made."""
    for depth, part in enumerate(path):
        here = mark._replace(path=path[: depth + 1])
        is_last = depth == len(path) - 1
        if isinstance(container, MarkedMapping):
            section = container.get(part)
            selector = next((key for key in _SELECTORS if isinstance(section, MarkedMapping) and key in section), "")
            if is_last and selector and isinstance(value, str):  # `passivity=unprotected` names another algorithm
                container, part, here = section, selector, here.below(selector)
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
    """Return the index of a list entry, given as a number, by the entry's name or by its `type`."""
    of_entries = [entry if isinstance(entry, MarkedMapping) else {} for entry in entries]
    names = [str(entry.get("name", entry.get("type", ""))) for entry in of_entries]
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


def without_old_keys(
    table: ComponentOf, name: str, model: type[Parameters], section: MarkedMapping, reading: SceneContext
) -> MarkedMapping:
    """Section without the keys of a type that an override replaced; in a scene of real drives it is an error.

    Args:
        table: Table that has both types.
        name: Type named by the override.
        model: Its model.
        section: Section of the scene.
        reading: Context of the validation.

    Raises:
        ValidationError: The drives may be real and keys would be dropped, or keys that the new type needs are missing.
    """
    was, fields = str(section.was), model.model_fields
    of_file = [key for key, at in section.keys_at.items() if key in section and not at.source.startswith("--set ")]
    gone = [key for key in of_file if key in table.model_named(was).model_fields.keys() - fields.keys()]
    if gone and not reading.simulated:
        text = f"which has no {', '.join(gone)}; the drives may be real, so no key is dropped: take it"
        raise table.refused(f"got {name!r} in place of {was!r}, {text} out of the scene")
    path, motion = ".".join(section.mark.path), section.motion or reading.motion
    needed = {key: field for key, field in fields.items() if field.is_required() and key not in section}
    if needed:
        words = " ".join(f"--set {path}.{key}={_example(field, motion)}" for key, field in needed.items())
        raise table.refused(f"got {name!r} in place of {was!r}, which needs {', '.join(needed)}, as in {words}")
    if gone and parent_process() is None:
        are = "is" if len(gone) == 1 else "are"
        text = f"{', '.join(gone)} {are} ignored: {name!r} does not use {'it' if are == 'is' else 'them'}"
        warnings.warn(f"{section.value_at(table.selector).source}: {path}: {text}", OverrideWarning, stacklevel=2)
    return section.without(*gone)


def _example(field: FieldInfo, motion: Motion | None) -> str:
    """Return an example value of a field, quoted for a shell: `'1 N'`; `...` if it is not a number."""
    if get_origin(field.annotation) is tuple:
        return "[...]"
    for part in parts_of((field.annotation, *field.metadata)):
        if isinstance(part, Quantity):
            most = min(part.limits.get("le", 2.0), part.limits.get("lt", 2.0))
            value = f"{max(part.limits.get('ge', 0.0), 1.0 if most > 1.0 else 0.5 * most):g}"
            return f"'{value} {part.unit.accepted(motion)[0]}'" if part.unit.words(motion) else value
    return "..."
