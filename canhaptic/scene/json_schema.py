"""The JSON Schema of a scene file, composed from the models that own its parts.

Values that refer to each other (units of an axis, unique names) are beyond a schema; `load_scene` checks them.
"""

from canhaptic.control.environments import ENVIRONMENTS
from canhaptic.control.passivity import ALGORITHMS
from canhaptic.drive.axis_parameters import AxisParameters, BusParameters
from canhaptic.logs.log_parameters import LogParameters
from canhaptic.scene.axes import SCALING_KEYS, SIMULATION_PARTS
from canhaptic.scene.buses import BUS_KEY, BusTitle, FurtherBus
from canhaptic.scene.group_schema import group_schema, mechanism_schema
from canhaptic.scene.models import AutoAccuracy, RunParameters, SimulationParameters
from canhaptic.scene.profiles import PROFILE_KEY
from canhaptic.scene.schema_parts import Schema, SchemaParts, or_null, partial
from canhaptic.sim.bus.bus_effects import BusEffects
from canhaptic.sim.drive.drive_parameters import SimulatedDriveParameters
from canhaptic.sim.plant.effects import EFFECTS
from canhaptic.sim.plant.plant import AccuracyParameters, PlantParameters
from canhaptic.sim.plant.user import UserParameters


def scene_schema() -> Schema:
    """Returns the schema (JSON Schema 2020-12) of a scene file."""
    parts = SchemaParts()
    environments = parts.choices("type", ENVIRONMENTS, "environment")
    algorithms = parts.algorithms(ALGORITHMS, "passivity algorithm")
    sections = {
        "bus": _bus(parts),
        "axes": {"type": "array", "minItems": 1, "items": _axis(parts, environments, algorithms)},
        "groups": or_null({"type": "array", "items": group_schema(parts)}),
        "environment": {"oneOf": environments},
        "passivity": {"oneOf": algorithms},
        "simulation": _simulation(parts),
        "accuracy": {"anyOf": [parts.of(AccuracyParameters), parts.of(AutoAccuracy), {"type": "null"}]},
        "log": or_null(parts.of(LogParameters)),
        **parts.of(RunParameters)["properties"],
    }
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "canhaptic scene",
        "type": "object",
        "properties": sections,
        "required": ["bus", "axes"],
        "additionalProperties": False,
        "$defs": parts.definitions,
    }


def _bus(parts: SchemaParts) -> Schema:
    """Returns the schema of one bus, or of a list whose first entry has what holds for all."""
    one, title = parts.of(BusParameters), parts.of(BusTitle)
    first = {
        **one,
        "properties": {**title["properties"], **one["properties"]},
        "required": [*title["required"], *one.get("required", [])],
    }
    several = {"type": "array", "minItems": 1, "prefixItems": [first], "items": parts.of(FurtherBus)}
    return {"anyOf": [one, several]}


def _axis(parts: SchemaParts, environments: list[Schema], algorithms: list[Schema]) -> Schema:
    schema = parts.of(AxisParameters)
    own = {
        BUS_KEY: {"type": "string"},
        PROFILE_KEY: {"type": "string", "description": "A drive profile: a name of configs/drives, or a path."},
        "environment": {"anyOf": [partial(choice) for choice in environments]},
        "passivity": {"anyOf": [partial(choice) for choice in algorithms]},
    }
    return {**schema, "properties": {**schema["properties"], **own}}


def _simulation(parts: SchemaParts) -> Schema:
    drive = parts.of(SimulatedDriveParameters)
    drive["required"] = [key for key in drive.get("required", []) if key not in SCALING_KEYS]
    shared: Schema = {
        "drive": drive,
        "plant": parts.of(PlantParameters),
        "user": or_null(parts.of(UserParameters)),
        "effects": {"type": "array", "items": {"oneOf": parts.choices("type", EFFECTS, "effect")}},
    }
    of_axis = {name: partial(shared[name]) for name in SIMULATION_PARTS}
    own = {"type": "object", "properties": of_axis, "additionalProperties": False}
    return or_null(
        {
            "type": "object",
            "properties": {
                **shared,
                **parts.of(SimulationParameters)["properties"],
                "bus": or_null(parts.of(BusEffects)),
                "mechanisms": or_null({"type": "array", "items": mechanism_schema(parts)}),
                "axes": {"type": "object", "additionalProperties": own},
            },
            "additionalProperties": False,
        }
    )
