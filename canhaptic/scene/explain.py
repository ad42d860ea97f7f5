"""What pydantic finds wrong with a scene, as faults with line, value seen, unit and range."""

import dataclasses
import typing
from collections.abc import Iterable
from typing import Final, NamedTuple

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from canhaptic.axis_units import Motion
from canhaptic.registry import unknown_key
from canhaptic.scene.components import READY, ComponentOf, OnDemand
from canhaptic.scene.diagnostics import Diagnostics, SourceLocation
from canhaptic.scene.document import MarkedList, MarkedMapping
from canhaptic.units import Quantity, fault_text, parts_of, shown

NOTED: Final = object()
"""Replaces a value whose fault is noted already."""

_SHAPES: Final = {
    "model_type": "a mapping of keys and values",
    "dataclass_type": "a mapping of keys and values",
    "dict_type": "a mapping",
    "tuple_type": "a list of {name}",
    "list_type": "a list of {name}",
}


def read_mapping(value: object, at: SourceLocation, faults: Diagnostics, what: str) -> MarkedMapping | None:
    """Returns a value that must be a mapping; None, with a fault, when it is something else."""
    if isinstance(value, MarkedMapping):
        return value
    faults.add(at, f"got {shown(value)}, expected a mapping of {what}")
    return None


def read_list(value: object, at: SourceLocation, faults: Diagnostics, what: str) -> MarkedList | None:
    """Returns a value that must be a list; None, with a fault, when it is something else."""
    if isinstance(value, MarkedList):
        return value
    faults.add(at, f"got {shown(value)}, expected a list of {what}")
    return None


def refuse_unknown_keys(section: MarkedMapping, known: Iterable[str], faults: Diagnostics) -> None:
    """Notes every key of a section that is none of the known ones, with the nearest name."""
    names = tuple(known)
    for key in section:
        if key not in names:
            faults.add(section.keys_at[key], unknown_key(key, names))


def note_errors(model: type, section: MarkedMapping, error: ValidationError, faults: Diagnostics) -> None:
    """Notes every error of a validation at the place of its value.

    Args:
        model: Class that was validated: a parameter model, or a dataclass of such.
        section: What it was validated from.
        error: What pydantic found.
        faults: Receives one line per error.
    """
    for fault in error.errors(include_url=False):
        if fault.get("input") is not NOTED:
            _note(_find(model, section, fault["loc"], fault.get("input")), fault, faults)


class _KeyLocation(NamedTuple):
    """What a location of pydantic means in the scene."""

    name: str  # of the key, as written
    value: object  # as written
    value_at: SourceLocation
    key_at: SourceLocation
    annotation: object  # of the field; None where no model has it
    names: tuple[str, ...]  # of all keys that its mapping may have
    motion: Motion | None


def _find(model: type, section: MarkedMapping, location: tuple[int | str, ...], seen: object) -> _KeyLocation:
    """Walks models and values to a location; what is missing takes its owner's place and `seen` for its value."""
    owner: type | None = model
    container: object = section
    chosen: tuple[str, ...] = ()
    annotation, motion = None, section.motion
    found = _KeyLocation("", section, section.mark, section.mark, None, (), motion)
    for part in location:
        if isinstance(container, MarkedMapping) and part == container.get("type") and part not in container:
            owner = _named(annotation, part) or owner  # pydantic names the branch of a union that `type` chose
            continue
        fields = _fields(owner)
        annotation = fields.get(str(part), annotation if isinstance(part, int) else None)
        names: tuple[str, ...] = ()
        name = found.name if isinstance(part, int) and found.name else str(part)
        if isinstance(container, MarkedMapping):
            name, names = _key_of(container, part), (*fields, *container.elsewhere, *chosen)
            at, key_at = container.value_at(name), container.keys_at.get(name, container.mark.below(name))
        elif isinstance(container, MarkedList) and isinstance(part, int) and part < len(container):
            at = key_at = container.values_at[part]
        else:
            at, key_at = found.value_at, found.key_at
        value = _entry(container, name, part)
        if value is _ABSENT and not isinstance(container, MarkedMapping):
            return found._replace(value=seen)  # a part of pydantic's own, such as a branch of a union
        container = seen if value is _ABSENT else value
        found = _KeyLocation(name, container, at, key_at, annotation, names, motion)
        if isinstance(container, MarkedMapping):
            owner, chosen = _model_in(annotation, container, owner)
            motion = container.motion or getattr(owner, "motion", None) or motion
    return found


_ABSENT: Final = object()


def _entry(container: object, name: str, part: int | str) -> object:
    if isinstance(container, dict):
        return container.get(name, _ABSENT)
    if isinstance(container, list | tuple) and isinstance(part, int) and part < len(container):
        return container[part]
    return _ABSENT


def _key_of(container: MarkedMapping, part: int | str) -> str:
    """Returns the key as it was written; pydantic names a numbered one by its number."""
    if str(part) in container:
        return str(part)
    return next((key for key in container if isinstance(part, int) and _is_number(key, part)), str(part))


def _is_number(key: str, number: int) -> bool:
    try:
        return int(key, 0) == number
    except ValueError:
        return False


def _fields(owner: type | None) -> dict[str, object]:
    """Returns the annotation of each field of a model or dataclass, with what it is annotated with."""
    if owner is None:
        return {}
    if issubclass(owner, BaseModel):
        fields = owner.model_fields.items()
        return {name: (field.annotation, *field.metadata) for name, field in fields}
    if dataclasses.is_dataclass(owner):
        return typing.get_type_hints(owner, include_extras=True)
    return {}


def _named(annotation: object, kind: int | str) -> type[BaseModel] | None:
    """Returns the model of a union whose `type` this is."""
    models = (part for part in parts_of(annotation) if isinstance(part, type) and issubclass(part, BaseModel))
    return next((m for m in models if "type" in m.model_fields and m.model_fields["type"].default == kind), None)


def _model_in(annotation: object, section: MarkedMapping, owner: type | None) -> tuple[type | None, tuple[str, ...]]:
    """Returns the model of a section in a field of this annotation, `owner` where it has none; and further keys."""
    for part in parts_of(annotation):
        if isinstance(part, ComponentOf):
            return part.model_of(section), (part.selector, *part.apart)
        if isinstance(part, OnDemand):
            return part.model_of(), ()
        if isinstance(part, type) and (issubclass(part, BaseModel) or dataclasses.is_dataclass(part)):
            return part, ()
    return owner, ()


def _note(found: _KeyLocation, fault: ErrorDetails, faults: Diagnostics) -> None:
    kind, value = fault["type"], found.value
    if kind in ("extra_forbidden", "unexpected_keyword_argument"):
        faults.add(found.key_at, unknown_key(found.name, found.names))
    elif kind == READY:
        faults.add(found.value_at, fault["msg"])
    elif kind == "value_error" and isinstance(value, MarkedMapping):
        faults.add(found.value_at, str(fault["ctx"]["error"]))  # which names the key
    elif kind in _SHAPES:
        faults.add(found.value_at, f"got {shown(value)}, expected {_SHAPES[kind].format(name=found.name)}")
    else:
        faults.add(found.value_at, fault_text(fault, value, _expected(found)))


def _expected(found: _KeyLocation) -> str:
    """Returns `0 < stiffness <= 1e8 [N/m]` for a number with a unit, what a component needs, else ``."""
    for item in parts_of(found.annotation):
        if isinstance(item, ComponentOf):
            return item.expected
        if isinstance(item, Quantity):
            return item.expected(found.name, found.motion)
    return ""
