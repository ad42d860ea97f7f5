"""Conversion of pydantic's errors to faults of a scene, with line, value seen, unit and range."""

import dataclasses
import typing
from collections.abc import Iterable
from typing import Final, NamedTuple

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from canhaptic.axis_units import Motion
from canhaptic.registry import unknown_key
from canhaptic.scene.buses import model_on
from canhaptic.scene.components import READY, ComponentOf
from canhaptic.scene.document import NOTED, Diagnostics, MarkedList, MarkedMapping, SourceLocation
from canhaptic.units import OnDemand, Quantity, fault_text, parts_of, shown

_SHAPES: Final = {
    "model_type": "a mapping of keys and values",
    "dataclass_type": "a mapping of keys and values",
    "dict_type": "a mapping",
    "tuple_type": "a list of {name}",
    "list_type": "a list of {name}",
}


def note_errors(model: type, section: MarkedMapping, error: ValidationError, faults: Diagnostics) -> None:
    """Note every error of a validation at the location of its value, and one error for a value of several types.

    Args:
        model: Validated class: a parameter model, or a dataclass of parameter models.
        section: Section that was validated.
        error: Error of pydantic.
        faults: Receives one line per error.
    """
    noted: dict[tuple[SourceLocation, str], tuple[tuple[int | str, ...], list[str]]] = {}
    for fault in error.errors(include_url=False):
        if fault.get("input") is NOTED:
            continue
        found = _find(model, section, fault)
        at, text = _in_words(found, fault)
        place = fault["loc"][: found.depth]
        first, texts = noted.setdefault((at, found.name), (place, []))
        if place == first:  # elsewhere it is the same value again, as in a simulated drive that takes its axis's scale
            texts.append(text)
    for (at, _), (_, texts) in noted.items():
        faults.add(at, _either(texts))


def _either(texts: Iterable[str]) -> str:
    """Return the error text of a value, with what each of its types expects."""
    first, *others = dict.fromkeys(texts)
    return " or ".join([first, *(text.partition("expected ")[2] or text for text in others)])


class _KeyLocation(NamedTuple):
    """Key of a scene to which a location of pydantic refers."""

    name: str  # of the key, as written
    value: object  # as written
    value_at: SourceLocation
    key_at: SourceLocation
    annotation: object  # of the field; None where no model has it
    names: tuple[str, ...]  # of all keys that its mapping may have
    motion: Motion | None
    depth: int  # parts of pydantic's location that lead to the key; later ones are internal, such as a union's branch


def _find(model: type, section: MarkedMapping, fault: ErrorDetails) -> _KeyLocation:
    """Return the key of a fault, found along models and values; a missing value has its owner's location."""
    is_key = fault["type"] in {"missing", READY}
    owner: type | None = model
    container: object = section
    chosen: tuple[str, ...] = ()
    annotation, motion = None, section.motion
    found = _KeyLocation("", section, section.mark, section.mark, None, (), motion, 0)
    for depth, part in enumerate(fault["loc"]):
        if isinstance(container, MarkedMapping) and part not in container and _named(annotation, part):
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
        if value is _ABSENT and not (isinstance(container, MarkedMapping) and is_key):
            return found._replace(value=fault.get("input"))
        container = fault.get("input") if value is _ABSENT else value
        found = _KeyLocation(name, container, at, key_at, annotation, names, motion, depth + 1)
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
    """Return the key as written; pydantic names a numeric key by its number."""
    if str(part) in container:
        return str(part)
    return next((key for key in container if isinstance(part, int) and _is_number(key, part)), str(part))


def _is_number(key: str, number: int) -> bool:
    try:
        return int(key, 0) == number
    except ValueError:
        return False


def _fields(owner: type | None) -> dict[str, object]:
    """Return the annotation of each field of a model or dataclass, with its metadata."""
    if owner is None:
        return {}
    if issubclass(owner, BaseModel):
        fields = owner.model_fields.items()
        return {name: (field.annotation, *field.metadata) for name, field in fields}
    if dataclasses.is_dataclass(owner):
        return typing.get_type_hints(owner, include_extras=True)
    return {}


def _named(annotation: object, kind: int | str) -> type[BaseModel] | None:
    """Return the model of a union that has this `type`."""
    models = (part for part in parts_of(annotation) if isinstance(part, type) and issubclass(part, BaseModel))
    return next((m for m in models if "type" in m.model_fields and m.model_fields["type"].default == kind), None)


def _model_in(annotation: object, section: MarkedMapping, owner: type | None) -> tuple[type | None, tuple[str, ...]]:
    """Return the model of a section, `owner` if its annotation has none, and keys that belong to other models."""
    for part in parts_of(annotation):
        if isinstance(part, ComponentOf):
            table = part.table_for(section)
            return table.model_of(section), (table.selector, *table.apart)
        if isinstance(part, OnDemand):
            return part.model_of(), ()
        if isinstance(part, type) and (issubclass(part, BaseModel) or dataclasses.is_dataclass(part)):
            return model_on(section, part), ()
    return owner, ()


def _in_words(found: _KeyLocation, fault: ErrorDetails) -> tuple[SourceLocation, str]:
    kind, value = fault["type"], found.value
    if kind in ("extra_forbidden", "unexpected_keyword_argument"):
        return found.key_at, unknown_key(found.name, found.names)
    if kind == READY:
        return found.value_at, fault["msg"]
    if isinstance(value, MarkedMapping):
        if kind == "value_error":
            return found.value_at, str(fault["ctx"]["error"])  # which names the key
        if kind in ("union_tag_invalid", "union_tag_not_found"):
            return value.value_at("type"), _tag_fault(found.annotation, value.get("type"))
    if kind in _SHAPES:
        units = next(
            (part.unit.words(found.motion) for part in parts_of(found.annotation) if isinstance(part, Quantity)), None
        )
        name = found.name if units is None else f"numbers {units}".rstrip()
        return found.value_at, f"got {shown(value)}, expected {_SHAPES[kind].format(name=name)}"
    return found.value_at, fault_text(fault, value, _expected(found))


def _tag_fault(annotation: object, seen: object) -> str:
    """Return the error text for a `type` that no model of a union has."""
    fields = (_fields(part).get("type") for part in parts_of(annotation) if isinstance(part, type))
    known = [str(name) for field in fields for name in parts_of(field) if isinstance(name, str)]
    return f"{'missing' if seen is None else 'got ' + shown(seen)}, expected one of: {', '.join(known)}"


def _expected(found: _KeyLocation) -> str:
    """Return `0 < stiffness <= 1e8 [N/m]` for a number with a unit, the required keys for a component, else ""."""
    for item in parts_of(found.annotation):
        if isinstance(item, ComponentOf):
            return item.expected
        if isinstance(item, Quantity):
            return item.expected(found.name, found.motion)
    return ""
