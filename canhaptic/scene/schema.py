"""The JSON Schema of a scene file, composed from the models that own its parts.

Values that refer to each other (units of an axis, unique names) are beyond a schema; `load_scene` checks them.
"""

from collections.abc import Mapping
from typing import Any

from canhaptic.drive.parameters import AxisParameters, BusParameters
from canhaptic.haptics.environments import ENVIRONMENTS
from canhaptic.haptics.passivity import ALGORITHMS
from canhaptic.haptics.passivity.protocol import LoopProperties
from canhaptic.logs.parameters import LogParameters
from canhaptic.parameters import Parameters
from canhaptic.scene.axes import LOOP_KEYS, OWN_SECTIONS, SCALING_KEYS, SIMULATION_PARTS
from canhaptic.scene.buses import BUS_KEY, BusTitle, FurtherBus
from canhaptic.scene.group_schema import group_schema, mechanism_schema
from canhaptic.scene.models import AutoAccuracy, RunParameters, SimulationParameters
from canhaptic.scene.profiles import PROFILE_KEY
from canhaptic.sim.bus_effects import BusEffects
from canhaptic.sim.drive_parameters import SimulatedDriveParameters
from canhaptic.sim.effects import EFFECTS
from canhaptic.sim.plant import AccuracyParameters, PlantParameters
from canhaptic.sim.user import UserParameters
from canhaptic.tables import load

Schema = dict[str, Any]


def scene_schema() -> Schema:
    """Returns the schema (JSON Schema 2020-12) of a scene file."""
    definitions: Schema = {}
    sections = {
        "bus": _bus(definitions),
        "axes": {"type": "array", "minItems": 1, "items": _axis(definitions)},
        "groups": _or_null({"type": "array", "items": group_schema(_of, definitions)}),
        "environment": _environment(definitions),
        "passivity": _passivity(definitions),
        "simulation": _simulation(definitions),
        "accuracy": {"anyOf": [_of(AccuracyParameters, definitions), _of(AutoAccuracy, definitions), {"type": "null"}]},
        "log": _or_null(_of(LogParameters, definitions)),
        **_of(RunParameters, definitions)["properties"],
    }
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "canhaptic scene",
        "type": "object",
        "properties": sections,
        "required": ["bus", "axes"],
        "additionalProperties": False,
        "$defs": definitions,
    }


def _bus(definitions: Schema) -> Schema:
    """Returns the schema of one bus, or of a list whose first entry has what holds for all."""
    one, title = _of(BusParameters, definitions), _of(BusTitle, definitions)
    first = {
        **one,
        "properties": {**title["properties"], **one["properties"]},
        "required": [*title["required"], *one.get("required", [])],
    }
    several = {"type": "array", "minItems": 1, "prefixItems": [first], "items": _of(FurtherBus, definitions)}
    return {"anyOf": [one, several]}


def _of(model: type[Parameters], definitions: Schema) -> Schema:
    """Returns the schema of one model; what it refers to joins the common definitions."""
    schema = model.model_json_schema(ref_template="#/$defs/{model}")
    definitions.update(schema.pop("$defs", {}))
    return schema


def _or_null(schema: Schema) -> Schema:
    return {"anyOf": [schema, {"type": "null"}]}


def _chosen(selector: str, name: str, schema: Schema) -> Schema:
    """Returns the schema of a section that names its type."""
    properties = {selector: {"const": name}, **{k: v for k, v in schema["properties"].items() if k != selector}}
    required = [selector, *(key for key in schema.get("required", []) if key != selector)]
    return {**schema, "properties": properties, "required": required}


def _without_required(schema: Schema) -> Schema:
    """Returns a schema of which any part may be left to another section."""
    return {key: value for key, value in schema.items() if key != "required"}


def _table(selector: str, table: Mapping[str, str], kind: str, definitions: Schema) -> list[Schema]:
    return [_chosen(selector, name, _of(load(table, name, kind), definitions)) for name in table]


def _environment(definitions: Schema) -> Schema:
    return {"oneOf": _table("type", ENVIRONMENTS, "environment", definitions)}


def _passivity(definitions: Schema) -> Schema:
    loop = _of(LoopProperties, definitions)["properties"]
    of_loop = {key: loop[key] for key in LOOP_KEYS}
    choices = []
    for name in ALGORITHMS:
        schema = _of(load(ALGORITHMS, name, "passivity algorithm").parameters_type, definitions)
        schema = {**schema, "properties": {**of_loop, **schema.get("properties", {})}}
        choices.append(_chosen("algorithm", name, schema))
    return {"oneOf": choices}


def _axis(definitions: Schema) -> Schema:
    schema = _of(AxisParameters, definitions)
    own = {
        "environment": {"anyOf": [_without_required(s) for s in _environment(definitions)["oneOf"]]},
        "passivity": {"anyOf": [_without_required(s) for s in _passivity(definitions)["oneOf"]]},
    }
    sections = {name: own[name] for name in OWN_SECTIONS}
    profile = {PROFILE_KEY: {"type": "string", "description": "A drive profile: a name of configs/drives, or a path."}}
    return {**schema, "properties": {**schema["properties"], BUS_KEY: {"type": "string"}, **profile, **sections}}


def _simulation(definitions: Schema) -> Schema:
    drive = _of(SimulatedDriveParameters, definitions)
    drive["required"] = [key for key in drive.get("required", []) if key not in SCALING_KEYS]
    effects = {"type": "array", "items": {"oneOf": _table("type", EFFECTS, "effect", definitions)}}
    parts: Schema = {
        "drive": drive,
        "plant": _of(PlantParameters, definitions),
        "user": _or_null(_of(UserParameters, definitions)),
        "effects": effects,
    }
    of_axis = {name: _without_required(parts[name]) for name in SIMULATION_PARTS}
    own = {"type": "object", "properties": of_axis, "additionalProperties": False}
    seed = _of(SimulationParameters, definitions)["properties"]
    bus = _or_null(_of(BusEffects, definitions))
    return _or_null(
        {
            "type": "object",
            "properties": {
                **parts,
                **seed,
                "bus": bus,
                "mechanisms": _or_null({"type": "array", "items": mechanism_schema(_of, definitions)}),
                "axes": {"type": "object", "additionalProperties": own},
            },
            "additionalProperties": False,
        }
    )
