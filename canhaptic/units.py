"""Frozen parameter models with units, through which every number with a dimension enters the package.

A field is declared once, with its unit for linear axes, its unit for rotary axes where that differs, and its range:

    class SpringDamperWall(Parameters):
        stiffness: Annotated[float, quantity("N/m", "N*m/rad", ge=0.0, le=1e8)]

A plain number is SI. A string may carry a unit ("100 N/m", "1 kHz", "50 us"), which is checked for dimension.
"""

import math
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Self, TypeVar, cast, get_args

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, ValidationInfo
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, ErrorDetails, core_schema

from canhaptic.axis_units import Motion
from canhaptic.errors import ParameterError
from canhaptic.registry import load, unknown_key

if TYPE_CHECKING:
    from pydantic._internal._model_construction import ModelMetaclass as _ModelMetaclass
else:
    _ModelMetaclass = type(BaseModel)

# Dimension exponents of (kg, m, s, A, K, rad). The radian is kept as a dimension of its own, so that a linear
# stiffness on a rotary axis is an error and not a wall of the wrong strength.
_Dimension = tuple[int, ...]
_UNITS: Final[dict[_Dimension, dict[str, float]]] = {
    (1, 0, 0, 0, 0, 0): {"kg": 1.0, "g": 1e-3},
    (0, 1, 0, 0, 0, 0): {"m": 1.0},
    (0, 0, 1, 0, 0, 0): {"s": 1.0, "min": 60.0, "h": 3600.0},
    (0, 0, -1, 0, 0, 0): {"Hz": 1.0},
    (0, 0, 0, 1, 0, 0): {"A": 1.0},
    (0, 0, 0, 0, 1, 0): {"K": 1.0},
    (0, 0, 0, 0, 0, 1): {"rad": 1.0, "deg": math.pi / 180.0, "rev": 2.0 * math.pi},
    (1, 1, -2, 0, 0, 0): {"N": 1.0},
    (1, 2, -2, 0, 0, 0): {"J": 1.0},
    (1, 2, -3, 0, 0, 0): {"W": 1.0},
    (1, 2, -3, -1, 0, 0): {"V": 1.0},
    (1, 2, -3, -2, 0, 0): {"ohm": 1.0},
    (1, 2, -2, -2, 0, 0): {"H": 1.0},
    (0, 0, 0, 0, 0, 0): {"bit": 1.0, "count": 1.0, "1": 1.0, "%": 1e-2, "ppm": 1e-6},
}
_BASE_UNITS: Final = {name: (factor, dimension) for dimension, of in _UNITS.items() for name, factor in of.items()}
_PREFIXES: Final = {"": 1.0, "n": 1e-9, "u": 1e-6, "m": 1e-3, "c": 1e-2, "k": 1e3, "M": 1e6, "G": 1e9}
_NUMBER_AND_UNIT: Final = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(\S.*)?")
_AS_PRINTED: Final = str.maketrans({"µ": "u", "μ": "u", "·": "*", "²": "^2", "³": "^3"})
"""Letters as printed in data sheets -> letters as typed in units."""
_FACTOR: Final = re.compile(r"([*/]?)\s*([A-Za-z]+|1|%)(?:\^(-?\d))?\s*")


_NUMBER_FAULTS: Final = {
    *("greater_than", "greater_than_equal", "less_than", "less_than_equal", "finite_number", "float_type"),
    *("float_parsing", "int_type", "int_parsing", "int_parsing_size", "int_from_float"),
}
"""Types of pydantic's errors for which a message shows the range of the quantity instead of pydantic's text."""
_SHOULD: Final = re.compile(r"^\w+( is not| should (be|have))(?= )")
_MORE: Final = re.compile(r", unable to .*| for <class .*")
_SYMBOLS: Final = {"gt": "<", "ge": "<=", "lt": "<", "le": "<="}
_LEAST, _MOST = 1e-30, 1e30
"""Smallest and largest magnitude of a quantity in SI; beyond them products and quotients overflow."""


@dataclass(slots=True)
class UnitContext:
    """Context of a pydantic validation: whether the parameters are of a linear ("m") or a rotary ("rad") axis."""

    motion: Motion | None = None

    @contextmanager
    def moving(self, motion: Motion | None) -> Iterator[None]:
        """Within the block, read parameters for a linear or a rotary axis; None: keep the motion in effect."""
        before = self.motion
        self.motion = motion or before
        try:
            yield
        finally:
            self.motion = before


def _base_unit(symbol: str) -> tuple[float, _Dimension]:
    if symbol in _BASE_UNITS:
        return _BASE_UNITS[symbol]
    for prefix, scale in _PREFIXES.items():
        rest = symbol.removeprefix(prefix)
        if prefix and rest != symbol and rest in _BASE_UNITS:
            factor, dimension = _BASE_UNITS[rest]
            return scale * factor, dimension
    raise ValueError(f"unknown unit {symbol!r} (products are written with '*', as in N*m)")


@lru_cache(maxsize=256)  # the same few units, at every number of every scene
def parse_unit(text: str) -> tuple[float, _Dimension]:
    """Return (factor to SI, dimension exponents) of a unit such as `N*s/m` or `kg*m^2`.

    Raises:
        ValueError: The text is not a product of known units.
    """
    factor, position = 1.0, 0
    dimension: _Dimension = (0, 0, 0, 0, 0, 0)
    text = text.strip().translate(_AS_PRINTED)
    while position < len(text):
        match = _FACTOR.match(text, position)
        if match is None or (position == 0) != (match[1] == ""):
            raise ValueError(f"cannot read unit {text!r}; write it like N*s/m or kg*m^2")
        scale, base = _base_unit(match[2])
        power = int(match[3] or 1) * (-1 if match[1] == "/" else 1)
        factor *= scale**power
        dimension = tuple(a + power * b for a, b in zip(dimension, base, strict=True))
        position = match.end()
    return factor, dimension


@dataclass(frozen=True, slots=True)
class Unit:
    """Unit of a field on a linear axis and on a rotary axis, which may be the same."""

    linear: str
    rotary: str

    def accepted(self, motion: Motion | None) -> tuple[str, ...]:
        """Units accepted on an axis; both where its kind of motion is unknown."""
        if motion is None:
            return (self.linear,) if self.linear == self.rotary else (self.linear, self.rotary)
        return (self.linear if motion == "m" else self.rotary,)

    def words(self, motion: Motion | None) -> str:
        """Return the unit as text: `[N/m]`, `[N/m or N*m/rad]`, or "" for a pure number."""
        accepted = self.accepted(motion)
        return "" if accepted in {("1",), ("count",)} else f"[{' or '.join(accepted)}]"

    def read(self, value: object, motion: Motion | None = None) -> object:
        """Return a number in SI from a number or a string with a unit; values of other types are unchanged.

        Raises:
            ValueError: The string is no number, or its unit has another dimension.
        """
        expected = f"expected {self.words(motion) or 'a number'}"
        if isinstance(value, bool):
            raise ValueError(f"a boolean is not a number; {expected}")
        if not isinstance(value, str):
            return value
        match = _NUMBER_AND_UNIT.fullmatch(value)
        if match is None:
            raise ValueError(f"not a number with an optional unit; {expected}")
        number = float(match[1])
        if match[2] is None:
            return number
        try:
            factor, dimension = parse_unit(match[2])
        except ValueError as error:
            raise ValueError(f"{error}; {expected}") from error
        for unit in self.accepted(motion):
            expected_factor, expected_dimension = parse_unit(unit)
            if dimension == expected_dimension:
                return number * (factor / expected_factor)
        raise ValueError(f"unit {match[2]!r} does not fit; {expected}")


class Quantity:
    """Annotation of a number: reads its unit, sets pydantic's limits, and extends the JSON schema."""

    def __init__(self, unit: Unit, limits: Mapping[str, float]) -> None:
        self.unit = unit
        self.limits = limits

    def expected(self, name: str, motion: Motion | None = None) -> str:
        """Return the accepted range as text, such as `0 < stiffness <= 1e8 [N/m]`."""
        low = next((f"{_short(self.limits[key])} {_SYMBOLS[key]} " for key in ("gt", "ge") if key in self.limits), "")
        high = next((f" {_SYMBOLS[key]} {_short(self.limits[key])}" for key in ("lt", "le") if key in self.limits), "")
        subject = f"{low}{name}{high}" if low or high else f"a finite number for {name}"
        return f"{subject} {self.unit.words(motion)}".rstrip()

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        schema = handler(source)
        if schema["type"] not in {"float", "int"}:
            raise TypeError(f"quantity() annotates float or int, not {source!r}; write Annotated[...] | None")
        schema.update(self.limits)
        if schema["type"] == "float":
            schema["allow_inf_nan"] = False
        return core_schema.with_info_before_validator_function(self._read, schema)

    def _read(self, value: object, info: ValidationInfo) -> object:
        number = self.unit.read(value, info.context.motion if isinstance(info.context, UnitContext) else None)
        if isinstance(number, int | float) and (0.0 < abs(number) < _LEAST or _MOST < abs(number) != math.inf):
            raise ValueError(f"expected 0 or a magnitude of {_LEAST:g} to {_MOST:g}")
        return number

    def __get_pydantic_json_schema__(self, core_schema: Any, handler: Any) -> Any:
        schema = handler(core_schema)
        unit = self.unit.linear if self.unit.linear == self.unit.rotary else f"{self.unit.linear} or {self.unit.rotary}"
        return {"anyOf": [schema, {"type": "string"}], "unit": unit}


def _short(value: float) -> str:
    return f"{value:g}".replace("e+0", "e").replace("e+", "e").replace("e-0", "e-")


def quantity(linear: str, rotary: str | None = None, **limits: float) -> Any:
    """Return the pydantic annotation of a finite number with a unit and limits.

    Args:
        linear: Unit on a linear axis, SI or the unit that the field keeps (`N/m`); "1" for a pure number.
        rotary: Unit on a rotary axis when it differs (`N*m/rad`).
        limits: Bounds in that unit: gt, ge, lt, le.
    """
    return Quantity(Unit(linear, rotary or linear), limits)


Coordinates = tuple[Annotated[float, quantity("m", "rad")], ...]
"""A point of task space, or a position of each axis [m or rad]."""
Numbers = tuple[Annotated[float, quantity("1")], ...]
"""Numbers of one row: a direction, or a row of a matrix in SI."""


class _ParametersMeta(_ModelMetaclass):
    """Metaclass that turns pydantic's error into `ParameterError` when a model is built directly."""

    def __call__(self, *args: Any, **values: Any) -> Any:
        try:
            return super().__call__(*args, **values)
        except ValidationError as error:
            raise ParameterError(_describe(cast("type[BaseModel]", self), error)) from error


def _describe(model: type[BaseModel], error: ValidationError) -> str:
    """Return one line per fault of a pydantic error: field, value seen, value expected."""
    return "\n".join(
        f"{model.__name__}.{'.'.join(map(str, fault['loc'])) or 'value'}: {_described(model, fault)}"
        for fault in error.errors()
    )


def _described(model: type[BaseModel], fault: ErrorDetails) -> str:
    name, *below = fault["loc"] or ("",)
    if fault["type"] == "extra_forbidden" and not below:
        return unknown_key(str(name), model.model_fields)
    field, expected = model.model_fields.get(str(name)), ""
    if field is not None and all(isinstance(part, int) for part in below):
        found = (part for part in parts_of((field.annotation, *field.metadata)) if isinstance(part, Quantity))
        expected = next((part.expected(str(name)) for part in found), "")
    return fault_text(fault, fault.get("input"), expected)


def parts_of(annotation: object) -> Iterator[object]:
    """Yield the types and annotations inside an annotation or a tuple of annotations."""
    yield annotation
    parts = annotation if isinstance(annotation, tuple) else get_args(annotation)
    for part in (*parts, *getattr(annotation, "__metadata__", ())):
        yield from parts_of(part)


def fault_text(fault: ErrorDetails, seen: object, expected: str = "") -> str:
    """Return one fault of pydantic in words: the value seen and the value expected.

    Args:
        fault: Error of pydantic.
        seen: Value as written.
        expected: Expected value, as from `Quantity.expected`; empty where only pydantic describes it.
    """
    kind = fault["type"]
    if kind == "missing":
        return f"missing{', expected ' + expected if expected else '; add it'}"
    if kind == "value_error":
        text = str(fault["ctx"]["error"])
        return text if "got " in text else f"got {shown(seen)}, {text}"
    if expected and kind in _NUMBER_FAULTS:
        return f"got {shown(seen)}, expected {expected}"
    message = _MORE.sub("", _SHOULD.sub("expected", fault["msg"])).replace("a valid boolean", "true or false")
    return f"got {shown(seen)}, {message[:1].lower()}{message[1:]}"


_LONGEST_SHOWN: Final = 200  # bits


def shown(value: object) -> str:
    """Return a value as shown in messages: short, on one line."""
    if value is None:
        return "nothing"
    if isinstance(value, Mapping):
        return "a mapping"
    if isinstance(value, list | tuple):
        return "a list"
    if isinstance(value, int) and value.bit_length() > _LONGEST_SHOWN:  # Python refuses to write the longest
        return f"an integer of {value.bit_length()} bits"
    text = str(value).lower() if isinstance(value, bool) else repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


_Text = TypeVar("_Text", str, Path)
_IN_NAMES: Final = " _-+.()"


def _check_name(name: str) -> str:
    if not name[:1].isalnum() or not all(letter.isalnum() or letter in _IN_NAMES for letter in name):
        raise ValueError(f"expected letters, digits, spaces and {' '.join(_IN_NAMES.strip())}, a letter or digit first")
    return name


def _check_printable(text: _Text) -> _Text:
    if not str(text).isprintable():
        raise ValueError("expected printable text, without control characters")
    return text


Name = Annotated[str, Field(min_length=1, max_length=40), AfterValidator(_check_name)]
"""A name that appears in messages, tables, pages and logs: no markup, no control characters, no separators."""
PrintableText = Annotated[str, AfterValidator(_check_printable)]
"""A text that may appear on a terminal."""
PrintablePath = Annotated[Path, AfterValidator(_check_printable)]
"""A path that may appear on a terminal."""


class Parameters(BaseModel, metaclass=_ParametersMeta):
    """Base of every parameter model: frozen, with finite numbers only, no unknown keys, and validated defaults."""

    model_config = ConfigDict(frozen=True, extra="forbid", validate_default=True, allow_inf_nan=False, defer_build=True)

    @classmethod
    def validated(cls, values: Mapping[str, Any], motion: Motion | None = None) -> Self:
        """Check parameters, in the unit of the axis (m or rad), and return them as a model.

        Raises:
            ParameterError: A value is missing or wrong; names each.
        """
        try:
            return cls.model_validate(values, context=UnitContext(motion))
        except ValidationError as error:
            raise ParameterError(_describe(cls, error)) from error

    @classmethod
    def of_section(cls, section: Mapping[str, Any], context: object) -> Self:
        """Return the parameters of a scene's section; its axis, or else the model, sets linear or rotary units."""
        motion = getattr(section, "motion", None) or getattr(cls, "motion", None)
        with context.moving(motion) if isinstance(context, UnitContext) else nullcontext():
            return cls.model_validate(section, context=context)


class OnDemand:
    """Annotation of a field whose model is imported only where the scene has a section for it.

    Args:
        path: Path "module:Class" of the model.
    """

    def __init__(self, path: str) -> None:
        self._path = path

    def model_of(self, _section: object = None) -> type[Parameters]:
        """Return the model, imported now if it was not before."""
        model: type[Parameters] = load({"": self._path}, "", "model")
        return model

    def __get_pydantic_core_schema__(self, source: object, handler: object) -> CoreSchema:
        return core_schema.with_info_plain_validator_function(self.read)

    def read(self, value: object, info: ValidationInfo[Any]) -> object:
        """Return the parameters of a section; its axis, or else the model, sets linear or rotary units."""
        model = self.model_of()
        if isinstance(value, model):
            return value
        if not isinstance(value, Mapping):
            raise ValueError("expected a mapping of keys and values")
        return model.of_section(value, info.context)

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: Callable[[CoreSchema], JsonSchemaValue]
    ) -> JsonSchemaValue:
        return handler(core_schema.chain_schema([self.model_of().__pydantic_core_schema__]))


class OwnModel(OnDemand):
    """Annotation of a field whose section is read by the user-defined subclass that its key `type` names.

    Args:
        path: "module:Class" of the model for a section without `type`.
        kind: Kind of model, for messages and plug-ins.
    """

    def __init__(self, path: str, kind: str) -> None:
        super().__init__(path)
        self._kind = kind

    def __get_pydantic_core_schema__(self, source: object, handler: object) -> CoreSchema:
        plain = core_schema.plain_serializer_function_ser_schema(_with_type)
        return core_schema.with_info_plain_validator_function(self.read, serialization=plain)

    def read(self, value: object, info: ValidationInfo[Any]) -> object:
        """Return the parameters of a section."""
        if not isinstance(value, Mapping) or "type" not in value or info.context is None:
            return super().read(value, info)
        return load(_OWN_MODEL, "own model", "reader")(value, info.context, self.model_of(), self._kind)


_OWN_MODEL: Final = {"own model": "canhaptic.scene.own_code:own_model"}


def _with_type(value: Parameters | None) -> dict[str, object] | None:
    """Return the values of a model, with `type` first if it is a user's own class."""
    if value is None:
        return None
    is_own = not type(value).__module__.startswith("canhaptic.")
    return {**({"type": type(value).__name__} if is_own else {}), **value.model_dump(mode="json")}
