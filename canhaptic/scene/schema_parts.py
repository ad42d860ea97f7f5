"""The JSON Schemas of parameter models and of tables of them, which share one set of definitions."""

from collections.abc import Mapping
from typing import Any

from canhaptic.control.passivity.controller import LoopProperties
from canhaptic.registry import load
from canhaptic.scene.axes import LOOP_KEYS
from canhaptic.units import Parameters

Schema = dict[str, Any]


class SchemaParts:
    """Makes the schemas of one scene.

    Attributes:
        definitions: What the schemas refer to as `#/$defs/NAME`.
    """

    def __init__(self) -> None:
        self.definitions: Schema = {}

    def of(self, model: type[Parameters]) -> Schema:
        """Returns the schema of one model."""
        schema = model.model_json_schema(ref_template="#/$defs/{model}")
        self.definitions.update(schema.pop("$defs", {}))
        return schema

    def choices(self, selector: str, table: Mapping[str, str], kind: str) -> list[Schema]:
        """Returns one schema per entry of a table; each names itself under `selector`."""
        schemas = []
        for name in table:
            thing = load(table, name, kind)
            schema = self.of(getattr(thing, "parameters_type", thing))
            own = {key: value for key, value in schema.get("properties", {}).items() if key != selector}
            properties = {selector: {"const": name}, **own}
            schemas.append({**schema, "properties": properties, "required": [selector, *schema.get("required", [])]})
        return schemas

    def algorithms(self, table: Mapping[str, str], kind: str) -> list[Schema]:
        """Returns one schema per algorithm of a table; each takes what describes the loop as well."""
        loop = self.of(LoopProperties)["properties"]
        of_loop = {key: loop[key] for key in LOOP_KEYS}
        choices = self.choices("algorithm", table, kind)
        return [{**choice, "properties": {**of_loop, **choice["properties"]}} for choice in choices]


def or_null(schema: Schema) -> Schema:
    """Returns the schema of what may be left empty."""
    return {"anyOf": [schema, {"type": "null"}]}


def partial(schema: Schema) -> Schema:
    """Returns a schema of which any part may be left to another section."""
    return {key: value for key, value in schema.items() if key != "required"}
