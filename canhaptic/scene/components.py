"""Annotations for fields of a scene whose parameter model is chosen by a name in the file, or defined by the user."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

from pydantic import (
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    ValidationError,
    ValidationInfo,
    ValidatorFunctionWrapHandler,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, InitErrorDetails, PydanticCustomError, core_schema

from canhaptic.errors import ParameterError
from canhaptic.registry import load
from canhaptic.scene.buses import BusParameters
from canhaptic.scene.document import MarkedMapping
from canhaptic.units import Parameters, UnitContext, shown

READY: Final = "ready"
"""Type of a pydantic error whose text is final: the seen value is not put in front of it."""


CodeUse = Literal["refused", "run", "left"]
"""Treatment of user code that a scene names: refused with an error, run, or left unread."""
_ON_DEMAND: Final = {
    "own code": "canhaptic.scene.own_code:OwnCode",
    "override": "canhaptic.scene.overrides:without_old_keys",
    "environment": "canhaptic.control.environments.sum_of_parts:added",
    "network": "canhaptic.control.port_hamiltonian.sum_of_networks:added",
}
"""Reader of a section, or kind whose parts add -> "module:name"; a scene loads only those that it needs."""
OWN_MODULE: Final = "_canhaptic_own_"
"""Prefix of the name of the private module made from a file of user code."""


@dataclass(slots=True)
class SceneContext(UnitContext):
    """Context of the validation of a scene."""

    bus: BusParameters | None = None  # once it is validated
    simulated: bool = False  # as that of `Scene`, once the bus is validated
    folder: Path = Path()  # of the scene
    use: CodeUse = "refused"
    kinds: dict[str, str] = field(default_factory=dict)  # axis -> kind of its causality, as far as they are read
    kind: str = ""  # of the last of them
    _code: Any = None

    @property
    def has_code(self) -> bool:
        """Whether the scene refers to user code."""
        return self._code is not None

    @property
    def code(self) -> Any:
        """The `OwnCode` of the scene, made when the scene first refers to user code."""
        if self._code is None:
            self._code = load(_ON_DEMAND, "own code", "reader")(self.folder, self.use)
        return self._code


class ComponentSpec(NamedTuple):
    """Parameters of a component chosen by name from a table."""

    name: str
    parameters: Parameters
    own: type | None = None  # the user's own class; None for an entry of the table
    parts: tuple["ComponentSpec", ...] = ()  # of a sum, whose parameters are made from theirs

    @property
    def is_read(self) -> bool:
        """Whether its parameters are known: False if it is user code that was left unread."""
        return not isinstance(self.parameters, UnreadParameters)

    def as_plain(self, selector: str) -> object:
        """Return the section as plain values, defaults included."""
        if self.parts:
            return [part.as_plain(selector) for part in self.parts]
        given = self.parameters
        plain = given.written if isinstance(given, UnreadParameters) else given.model_dump(mode="json")
        return {selector: self.name, **plain}


class UnreadParameters(Parameters):
    """Placeholder for the parameters of user code that was not read."""

    written: dict[str, Any]
    """The section as written."""


class ComponentOf:
    """Annotation of a `ComponentSpec`: its section names an entry of a table, which is then imported.

    Args:
        table: Name -> "module:Class", of parameter models or of classes with a `parameters_type`.
        kind: Kind of entries in the table, for messages.
        selector: Key of the section that contains the name.
        apart: Keys of the section for another field of the scene; only a model with such a field gets them too.
        others: Table of another section, and what its entries are, for a name of it.
        of_kinds: Kind of an axis' causality -> its own table in place of this one.
    """

    def __init__(
        self,
        table: Mapping[str, str],
        kind: str,
        selector: str = "type",
        apart: tuple[str, ...] = (),
        others: tuple[Mapping[str, str], str] = ({}, ""),
        of_kinds: Mapping[str, "ComponentOf"] = {},
    ) -> None:
        self._others = others
        self.table, self.kind, self.selector, self.apart, self._of_kinds = table, kind, selector, apart, of_kinds

    @property
    def expected(self) -> str:
        """Expected contents of the section, for messages."""
        return f"{self.selector} (one of {', '.join(sorted(self.table))}) and more"

    def model_of(self, section: object) -> type[Parameters] | None:
        """Return the model that a section names; None if it names none of the table, such as user code."""
        name = section.get(self.selector) if isinstance(section, MarkedMapping) else None
        return self.model_named(name) if isinstance(name, str) and name in self.table else None

    def table_for(self, section: object) -> "ComponentOf":
        """Return the table whose model has more of the section's keys, for error messages."""
        keys = section.keys() if isinstance(section, MarkedMapping) else set()

        def known(table: ComponentOf) -> int:
            model = table.model_of(section)
            return -1 if model is None else len(keys & {*model.model_fields, *table.apart})

        return max((self, *self._of_kinds.values()), key=known)

    def of(self, *kinds: str) -> "ComponentOf":
        """Return the table for axes with these kinds of causality."""
        return self._of_kinds.get(kinds[0], self) if len({*kinds}) == 1 else self

    def model_named(self, name: str, offered: Iterable[str] = ()) -> type[Parameters]:
        """Return the model of an entry of the table.

        Args:
            name: Its name.
            offered: Further names for the error, those of plug-ins.

        Raises:
            ParameterError: The table has no such entry.
        """
        if name in self._others[0] and name not in self.table:
            known = ", ".join(sorted(self.table))
            raise ParameterError(f"got {name!r}, {self._others[1]}; expected one of: {known}")
        return _parameters_of(load(self.table, name, self.kind, offered))

    def __get_pydantic_core_schema__(self, source: type, handler: GetCoreSchemaHandler) -> CoreSchema:
        plain = core_schema.plain_serializer_function_ser_schema(lambda spec: spec.as_plain(self.selector))
        one = core_schema.with_info_plain_validator_function(self.read, serialization=plain)
        if not self.adds:
            return one
        several = core_schema.list_schema(one)
        return core_schema.with_info_wrap_validator_function(self._one_or_several, several, serialization=plain)

    @property
    def adds(self) -> bool:
        """Whether a list of sections is a sum."""
        return self.kind in _ON_DEMAND

    def _one_or_several(
        self, value: object, read_parts: ValidatorFunctionWrapHandler, info: ValidationInfo[SceneContext]
    ) -> ComponentSpec:
        """Return a component, or the sum of those in a list.

        Raises:
            PydanticCustomError: Two parts cannot be added, or an admittance display is to render a sum.
        """
        if not isinstance(value, list):
            return self.read(value, info)
        if self.of(*_kinds(info)) is not self:
            text = f"a list is the sum of several, which an admittance display does not render; give one {self.kind}"
            raise PydanticCustomError(READY, "{text}", {"text": text})
        if not value:
            raise PydanticCustomError(READY, "got an empty list, expected at least one {kind}", {"kind": self.kind})
        parts: list[ComponentSpec] = read_parts(value)
        return parts[0] if len(parts) == 1 else self._added(parts)

    def _added(self, parts: list[ComponentSpec]) -> ComponentSpec:
        names = tuple(part.name for part in parts)
        own = next((part.own for part in parts if part.own is not None), None)
        if not all(part.is_read for part in parts):
            return ComponentSpec(" + ".join(names), UnreadParameters(written={}), own, tuple(parts))
        named = [(f"{n} ({part.name})", part.parameters) for n, part in enumerate(parts)]
        try:
            whole: Parameters = load(_ON_DEMAND, self.kind, "sum")(named)
        except ParameterError as error:
            raise PydanticCustomError(READY, "{text}", {"text": str(error)}) from error
        return ComponentSpec(" + ".join(names), whole, own, tuple(parts))

    def read(self, value: object, info: ValidationInfo[SceneContext]) -> ComponentSpec:
        """Return the component that a section names, from the table for this kind of display."""
        return self.of(*_kinds(info)).named(value, info)

    def named(self, value: object, info: ValidationInfo[SceneContext]) -> ComponentSpec:
        """Return the component of this table, or of the user's own code, that a section names."""
        if isinstance(value, ComponentSpec):
            return value
        if value is None:
            raise PydanticCustomError(READY, "missing, expected {what}", {"what": self.expected})
        if not isinstance(value, MarkedMapping):
            raise ValueError(f"expected a mapping of {self.selector} and its parameters")
        name = value.get(self.selector)
        try:
            if not isinstance(name, str):
                seen = f"got {shown(name)}" if name is not None else f"missing (keys given: {', '.join(value)})"
                raise ParameterError(f"{seen}, expected one of: {', '.join(sorted(self.table))}")
            own = None
            if name not in self.table:
                code = info.context.code
                if code.is_left(name, self.kind):
                    written = dict(value.without(self.selector, *self.apart))
                    return ComponentSpec(name, UnreadParameters(written=written))
                own = code.find(name, self.kind)
            offered = code.offered(self.kind) if name not in self.table and own is None else ()
            model = self.model_named(name, offered) if own is None else _own_parameters(own, name)
        except ParameterError as error:
            raise self.refused(str(error)) from error
        except ImportError as error:
            text = f"got {name!r}, a {self.kind} that this installation lacks a module for ({error})"
            raise self.refused(text) from error
        section = value.without(self.selector, *(key for key in self.apart if key not in model.model_fields))
        if section.was not in (None, name) and section.was in self.table:
            section = load(_ON_DEMAND, "override", "reader")(self, name, model, section, info.context)
        return ComponentSpec(name, model.of_section(section, info.context), own)

    def refused(self, text: str) -> ValidationError:
        """Return the error of a section whose name cannot be used."""
        fault = InitErrorDetails(
            type=PydanticCustomError(READY, "{text}", {"text": text}), loc=(self.selector,), input=None
        )
        return ValidationError.from_exception_data(self.kind, [fault])

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        choices = [self._choice(name, handler) for name in self.table]
        if not self._of_kinds:
            return {"oneOf": choices}
        if self.adds:
            choices.append({"type": "array", "title": "a sum", "minItems": 1, "items": {"oneOf": list(choices)}})
        for table in self._of_kinds.values():
            choices += table.__get_pydantic_json_schema__(schema, handler)["oneOf"]
        return {"anyOf": choices}

    def _choice(self, name: str, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        """Schema of one entry of the table, including its name."""
        model = handler.resolve_ref_schema(handler(self.model_named(name).__pydantic_core_schema__))
        own = {key: value for key, value in model.get("properties", {}).items() if key != self.selector}
        required = [key for key in model.get("required", []) if key != self.selector]
        properties = {self.selector: {"const": name}, **own}
        return {**model, "properties": properties, "required": [self.selector, *required]}


def _kinds(info: ValidationInfo[SceneContext]) -> list[str]:
    """Return the kind of the axis that is read, or of each axis of the group that is read."""
    context, together = info.context, info.data.get("axes")
    return [context.kinds.get(name, "") for name in together] if together else [context.kind]


def _parameters_of(entry: Any) -> type[Parameters]:
    model: type[Parameters] = getattr(entry, "parameters_type", entry)
    return model


def _own_parameters(own: object, name: str) -> type[Parameters]:
    """Return the parameter model of a user's class.

    Raises:
        ParameterError: It has none.
    """
    model = _parameters_of(own)
    if not (isinstance(model, type) and issubclass(model, Parameters)):
        raise ParameterError(f"{name}: has no parameters; expected a subclass of Parameters, or `parameters_type`")
    return model
