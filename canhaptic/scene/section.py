"""One section of a scene against one parameter model: pydantic's errors become faults with line, unit and range."""

import typing
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Final, TypeVar

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from canhaptic.errors import ParameterError
from canhaptic.registry import load, nearest
from canhaptic.scene.diagnostics import Diagnostics, SourceLocation
from canhaptic.scene.document import MarkedList, MarkedMapping
from canhaptic.units import Motion, Parameters, Unit, axis_motion, shown

P = TypeVar("P", bound=Parameters)

_SYMBOLS: Final = {"gt": "<", "ge": "<=", "lt": "<", "le": "<="}
_NUMBER_FAULTS: Final = {
    "greater_than",
    "greater_than_equal",
    "less_than",
    "less_than_equal",
    "finite_number",
    "float_type",
    "float_parsing",
    "int_type",
    "int_parsing",
    "int_parsing_size",
    "int_from_float",
}


def read_section(
    model: type[P],
    section: MarkedMapping,
    faults: Diagnostics,
    motion: Motion | None = None,
    also: Iterable[str] = (),
) -> P | None:
    """Returns the validated parameters of a section; None when it has faults, which are all noted.

    Args:
        model: The parameter model that owns the section.
        section: The section as written.
        faults: Receives one line per fault.
        motion: Whether the axis moves in metres or radians, for the units; None where that does not matter.
        also: Further keys that are read elsewhere, offered as nearest names.
    """
    try:
        with axis_motion(motion):
            return model.model_validate(_numbered_keys(model, section))
    except ValidationError as error:
        for fault in error.errors(include_url=False):
            _note(model, section, fault, faults, motion, tuple(also))
    except RecursionError:
        faults.add(section.mark, "nested too deeply")
    return None


def read_mapping(value: Any, at: SourceLocation, faults: Diagnostics, what: str) -> MarkedMapping | None:
    """Returns a value that must be a mapping; None, with a fault, when it is something else."""
    if isinstance(value, MarkedMapping):
        return value
    faults.add(at, f"got {shown(value)}, expected a mapping of {what}")
    return None


def read_list(value: Any, at: SourceLocation, faults: Diagnostics, what: str) -> MarkedList | None:
    """Returns a value that must be a list; None, with a fault, when it is something else."""
    if isinstance(value, MarkedList):
        return value
    faults.add(at, f"got {shown(value)}, expected a list of {what}")
    return None


def read_type(
    section: MarkedMapping, selector: str, kind: str, table: Mapping[str, str], faults: Diagnostics
) -> tuple[str, type[Any]] | None:
    """Returns (name, class) of a section that chooses from a table; None, with a fault, when it does not."""
    name, at = section.get(selector), section.value_at(selector)
    if not isinstance(name, str):
        seen = "missing" if name is None else f"got {shown(name)}"
        faults.add(at, f"{seen}, expected one of: {', '.join(sorted(table))}")
        return None
    try:
        return name, load(table, name, kind)
    except ParameterError as error:
        faults.add(at, str(error))
    except ImportError as error:
        faults.add(at, f"got {name!r}, a {kind} that this installation lacks a module for ({error})")
    return None


def refuse_unknown_keys(section: MarkedMapping, known: Iterable[str], faults: Diagnostics) -> None:
    """Notes every key of a section that is none of the known ones, with the nearest name."""
    names = tuple(known)
    for key in section:
        if key not in names:
            faults.add(section.keys_at[key], _unknown_key(key, names))


def _unknown_key(key: str, names: Iterable[str]) -> str:
    known = sorted(set(names))
    return f"unknown key{nearest(key, known) or '; expected one of: ' + ', '.join(known)}"


def _note(
    model: type[BaseModel],
    section: MarkedMapping,
    fault: ErrorDetails,
    faults: Diagnostics,
    motion: Motion | None,
    also: tuple[str, ...],
) -> None:
    value, value_at, key_at = _places(section, fault["loc"], fault.get("input"))
    kind = fault["type"]
    if kind == "extra_forbidden":
        owner = _model_at(model, fault["loc"][:-1])
        names = (*owner.model_fields, *(also if owner is model else ())) if owner else also
        faults.add(key_at, _unknown_key(str(fault["loc"][-1]), names))
        return
    expected = _expected(model, fault, motion)
    if kind == "missing":
        faults.add(value_at, f"missing{', expected ' + expected if expected else '; add it'}")
    elif kind == "value_error":
        seen = "" if isinstance(value, MarkedMapping) else f"got {shown(value)}, "  # the error names the key
        faults.add(value_at, f"{seen}{fault['ctx']['error']}")
    elif kind in _NUMBER_FAULTS and expected:
        faults.add(value_at, f"got {shown(value)}, expected {expected}")
    else:
        message = fault["msg"].replace("Input should be", "expected").split(", unable to parse")[0]
        faults.add(value_at, f"got {shown(value)}, {message[:1].lower()}{message[1:]}")


def _places(
    section: MarkedMapping, location: tuple[int | str, ...], seen: Any
) -> tuple[Any, SourceLocation, SourceLocation]:
    """Returns the value as written and the marks of value and key at a location.

    What is missing takes its owner's place; `seen` stands for a value that is not found.
    """
    container: Any = section
    value_at = key_at = section.mark
    for part in location:
        name = _key_of(container, part)
        if isinstance(container, MarkedMapping) and name in container:
            value_at, key_at = container.values_at[name], container.keys_at[name]
            container = container[name]
        elif isinstance(container, MarkedList) and isinstance(part, int) and part < len(container):
            value_at = key_at = container.values_at[part]
            container = container[part]
        elif isinstance(container, MarkedMapping):
            return seen, container.mark.below(name), container.mark.below(name)
        else:  # a part of pydantic's own, such as a branch of a union
            return seen, value_at, key_at
    return container, value_at, key_at


def _key_of(container: Any, part: int | str) -> str:
    """Returns the key as it was written; pydantic names a numbered one by its number."""
    if isinstance(container, MarkedMapping) and str(part) not in container:
        return next((key for key in container if str(_number_of(key)) == str(part)), str(part))
    return str(part)


def _numbered_keys(model: type[BaseModel], section: MarkedMapping) -> dict[str, Any]:
    """Returns the section with the keys of every field that maps numbers (`0x1404: 0x205`) turned into numbers."""
    values = dict(section)
    for name, field in model.model_fields.items():
        keys = typing.get_args(field.annotation)[:1] if typing.get_origin(field.annotation) is dict else ()
        if keys == (int,) and isinstance(values.get(name), dict):
            values[name] = {_number_of(key): value for key, value in values[name].items()}
    return values


def _number_of(key: str) -> int | str:
    try:
        return int(key, 0)
    except ValueError:
        return key  # pydantic says what is wrong with it


def _inner(annotation: Any) -> Iterator[Any]:
    """Yields an annotation and everything inside it."""
    yield annotation
    for argument in typing.get_args(annotation):
        yield from _inner(argument)


def _field_at(model: type[BaseModel], location: tuple[int | str, ...]) -> FieldInfo | None:
    owner = _model_at(model, location[:-1])
    return owner.model_fields.get(str(location[-1])) if owner and location else None


def _model_at(model: type[BaseModel], location: tuple[int | str, ...]) -> type[BaseModel] | None:
    """Returns the model that owns the entries at a location, walking through lists and optional models."""
    owner = model
    for part in location:
        field = owner.model_fields.get(str(part))
        if field is not None:
            models = (a for a in _inner(field.annotation) if isinstance(a, type) and issubclass(a, BaseModel))
            owner = next(models, owner)
    return owner


def _expected(model: type[BaseModel], fault: ErrorDetails, motion: Motion | None) -> str:
    """Returns `0 < stiffness <= 1e8 [N/m]` for a number with a unit, else ``."""
    field = _field_at(model, fault["loc"])
    if field is None:
        return ""
    candidates = [*field.metadata, *(inner for inner in _inner(field.annotation))]
    metadata = [m for c in candidates for m in (c, *getattr(c, "__metadata__", ()))]
    for item in metadata:
        unit, limits = getattr(item, "unit", None), getattr(item, "limits", None)
        if isinstance(unit, Unit) and isinstance(limits, dict):
            return _range(str(fault["loc"][-1]), limits, unit, motion)
    return ""


def _range(name: str, limits: dict[str, float], unit: Unit, motion: Motion | None) -> str:
    with axis_motion(motion):
        units = unit.accepted()
    low = next((f"{_number(limits[k])} {_SYMBOLS[k]} " for k in ("gt", "ge") if k in limits), "")
    high = next((f" {_SYMBOLS[k]} {_number(limits[k])}" for k in ("lt", "le") if k in limits), "")
    subject = f"{low}{name}{high}" if low or high else f"a number for {name}"
    shown_units = [] if units in {("1",), ("count",)} else [f"[{' or '.join(units)}]"]
    return " ".join([subject, *shown_units])


def _number(value: float) -> str:
    text = f"{value:g}"
    return text.replace("e+0", "e").replace("e+", "e").replace("e-0", "e-")
