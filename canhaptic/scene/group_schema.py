"""The JSON Schema of groups and of simulated mechanisms, composed from the models that own their parts."""

from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

from canhaptic.haptics.kinematics import KINEMATICS
from canhaptic.haptics.network import GROUP_ALGORITHMS, NETWORKS
from canhaptic.haptics.passivity.protocol import LoopProperties
from canhaptic.parameters import Parameters
from canhaptic.scene.axes import LOOP_KEYS
from canhaptic.sim.mechanism import MECHANISMS
from canhaptic.sim.mechanism.task_hand import TaskHand
from canhaptic.tables import load

Schema: TypeAlias = dict[str, Any]
SchemaOf: TypeAlias = Callable[[type[Parameters], Schema], Schema]
"""Returns the schema of a model; what it refers to joins the common definitions."""

_NAMES: Schema = {"type": "array", "minItems": 1, "items": {"type": "string"}}


def group_schema(schema_of: SchemaOf, definitions: Schema) -> Schema:
    """Returns the schema of one entry of `groups`."""
    loop = schema_of(LoopProperties, definitions)["properties"]
    of_loop = {key: loop[key] for key in LOOP_KEYS}
    kinematics = _choices("type", KINEMATICS, "kinematics", schema_of, definitions)
    for choice in kinematics:
        if choice["properties"]["type"] == {"const": "identity"}:  # a group knows how many axes it has
            choice["required"] = [key for key in choice["required"] if key != "axes"]
    algorithms = [
        {**choice, "properties": {**of_loop, **choice["properties"]}}
        for choice in _choices("algorithm", GROUP_ALGORITHMS, "group algorithm", schema_of, definitions)
    ]
    return {
        "type": "object",
        "properties": {
            "name": {"type": "string", "minLength": 1, "maxLength": 40},
            "axes": _NAMES,
            "kinematics": {"oneOf": kinematics},
            "network": {"oneOf": _choices("type", NETWORKS, "network", schema_of, definitions)},
            "passivity": {"oneOf": algorithms},
        },
        "required": ["name", "axes", "network", "passivity"],
        "additionalProperties": False,
    }


def mechanism_schema(schema_of: SchemaOf, definitions: Schema) -> Schema:
    """Returns the schema of one entry of `simulation.mechanisms`."""
    hand = {"anyOf": [schema_of(TaskHand, definitions), {"type": "null"}]}
    choices = _choices("type", MECHANISMS, "mechanism", schema_of, definitions)
    return {
        "oneOf": [
            {
                **choice,
                "properties": {"axes": _NAMES, "hand": hand, **choice["properties"]},
                "required": ["axes", *choice["required"]],
            }
            for choice in choices
        ]
    }


def _choices(
    selector: str, table: Mapping[str, str], kind: str, schema_of: SchemaOf, definitions: Schema
) -> list[Schema]:
    """Returns one schema per entry of a table; each names itself under `selector`."""
    schemas = []
    for name in table:
        thing = load(table, name, kind)
        schema = schema_of(getattr(thing, "parameters_type", thing), definitions)
        properties = {selector: {"const": name}, **schema.get("properties", {})}
        schemas.append({**schema, "properties": properties, "required": [selector, *schema.get("required", [])]})
    return schemas
