"""The JSON Schema of groups and of simulated mechanisms, composed from the models that own their parts."""

from typing import Final

from canhaptic.control.mechanisms import KINEMATICS
from canhaptic.control.multi_axis import GROUP_ALGORITHMS, NETWORKS
from canhaptic.scene.schema_parts import Schema, SchemaParts, or_null
from canhaptic.sim.plant.mechanism import MECHANISMS
from canhaptic.sim.plant.mechanism.task_hand import TaskHand

_NAMES: Final[Schema] = {"type": "array", "minItems": 1, "items": {"type": "string"}}


def group_schema(parts: SchemaParts) -> Schema:
    """Returns the schema of one entry of `groups`."""
    kinematics = parts.choices("type", KINEMATICS, "kinematics")
    for choice in kinematics:
        if choice["properties"]["type"] == {"const": "identity"}:  # a group knows how many axes it has
            choice["required"] = [key for key in choice["required"] if key != "axes"]
    return {
        "type": "object",
        "properties": {
            "name": {"type": "string", "minLength": 1, "maxLength": 40},
            "axes": _NAMES,
            "kinematics": {"oneOf": kinematics},
            "network": {"oneOf": parts.choices("type", NETWORKS, "network")},
            "passivity": {"oneOf": parts.algorithms(GROUP_ALGORITHMS, "group algorithm")},
        },
        "required": ["name", "axes", "network", "passivity"],
        "additionalProperties": False,
    }


def mechanism_schema(parts: SchemaParts) -> Schema:
    """Returns the schema of one entry of `simulation.mechanisms`."""
    own = {"axes": _NAMES, "hand": or_null(parts.of(TaskHand))}
    return {
        "oneOf": [
            {**choice, "properties": {**own, **choice["properties"]}, "required": ["axes", *choice["required"]]}
            for choice in parts.choices("type", MECHANISMS, "mechanism")
        ]
    }
