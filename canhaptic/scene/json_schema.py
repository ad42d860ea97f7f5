"""The JSON Schema of a scene file: the schema of `Scene`, rearranged to the layout of the file.

Descriptions come from the source of the parameter models. A schema cannot express units that depend on the axis, or
unique names; `load_scene` checks these.
"""

import ast
import inspect
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue

from canhaptic.control.passivity import RANGES
from canhaptic.registry import load
from canhaptic.scene import buses
from canhaptic.scene.models import LOOP_KEYS, SCALING_KEYS, SIMULATION_PARTS, scene_adapter
from canhaptic.units import Parameters


def words_of(model: type[Parameters]) -> dict[str, str]:
    """Return the description of each field: the string below it, or its entry under `Attributes:`."""
    found: dict[str, str] = {}
    for owner in reversed(model.__mro__):
        if not issubclass(owner, Parameters) or owner is Parameters:
            continue
        tree = ast.parse(inspect.cleandoc("\n" + inspect.getsource(owner)))
        body = next(node for node in ast.walk(tree) if isinstance(node, ast.ClassDef))
        found.update(_attributes(inspect.cleandoc(ast.get_docstring(body) or "")))
        for field, text in zip(body.body, body.body[1:], strict=False):
            if isinstance(field, ast.AnnAssign) and isinstance(text, ast.Expr) and isinstance(text.value, ast.Constant):
                found[ast.unparse(field.target)] = " ".join(str(text.value.value).split())
    return found


def _attributes(docstring: str) -> dict[str, str]:
    _, _, listed = docstring.partition("Attributes:\n")
    entries = re.split(r"\n    (?=\w+: )", "\n" + listed.split("\n\n")[0])
    pairs = [entry.split(": ", 1) for entry in entries if ": " in entry]
    return {name.strip(): " ".join(text.split()) for name, text in pairs}


Schema = JsonSchemaValue
_OF_CAN: Final = {"enum": ["can"], "description": "Kind of bus."}
_NULL: Final = {"type": "null"}

_TEXTS: Final[dict[str, dict[str, str]]] = tomllib.loads(
    Path(__file__).with_name("words.toml").read_text(encoding="utf-8")
)
"""Section of a scene -> key -> its description."""


class _WithWords(GenerateJsonSchema):
    """JSON Schema generator that adds the descriptions of fields."""

    def model_schema(self, schema: Any) -> Schema:
        found = super().model_schema(schema)
        words = words_of(schema["cls"])
        for name, of_field in found.get("properties", {}).items():
            if name in words:
                of_field["description"] = words[name]
        return found


def scene_schema() -> Schema:
    """Return the schema (JSON Schema 2020-12) of a scene file."""
    whole = scene_adapter().json_schema(schema_generator=_WithWords)
    defined, scene = whole["$defs"], whole["properties"]
    axis, far_side = (defined[name]["properties"] for name in ("AxisScene", "AxisSimulation"))
    environment, passivity = axis["environment"], _with_loop(axis["passivity"], defined)
    parts = {key: far_side[key] for key in SIMULATION_PARTS}
    drive = _optional(defined["SimulatedDriveParameters"], *SCALING_KEYS)
    taken = {key: drive["properties"][key] | {"taken": "that of the axis"} for key in SCALING_KEYS}
    parts["drive"] = {**drive, "properties": drive["properties"] | taken}
    given = {**defined["AccuracyParameters"], "title": "given"}
    chosen = {**defined["AutoAccuracy"], "title": "chosen by the build"}
    sections = {
        "bus": _bus(scene, defined),
        "axes": {"type": "array", "minItems": 1, "items": _axis(defined, environment, passivity)},
        "groups": _or_null({"type": "array", "items": _group(defined)}),
        "far": _or_null(defined["FarParameters"]),
        "environment": environment,
        "passivity": passivity,
        "simulation": _or_null(_simulation(scene, parts, defined)),
        "accuracy": {"anyOf": [given, chosen, {"type": "null"}]},
        "log": _or_null(defined["LogParameters"]),
        **defined["RunParameters"]["properties"],
    }
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "canhaptic scene",
        **_mapping(_described(sections, _TEXTS["sections"]), "bus", "axes"),
        "$defs": {name: defined[name] for name in sorted(set(_references(sections, defined)))},
    }


def _references(schema: Any, defined: Schema) -> Iterator[str]:
    """Yield the name of every definition that a schema refers to, at any depth."""
    for part in schema.values() if isinstance(schema, dict) else schema if isinstance(schema, list) else ():
        yield from _references(part, defined)
    if isinstance(schema, dict) and isinstance(schema.get("$ref"), str):
        name = schema["$ref"].removeprefix("#/$defs/")
        yield name
        yield from _references(defined[name], defined)


def _mapping(properties: Schema, *required: str) -> Schema:
    return {"type": "object", "properties": properties, "required": list(required), "additionalProperties": False}


def _described(properties: Schema, words: dict[str, str]) -> Schema:
    return {key: {**of, "description": words[key]} if key in words else of for key, of in properties.items()}


def _or_null(schema: Schema) -> Schema:
    """Schema of a section that may be left empty."""
    return {"anyOf": [schema, {"type": "null"}]}


def _faults(defined: Schema) -> Schema:
    faults = _model(load({"": "canhaptic.sim.drive.ethercat.cable:CableEffects"}, "", "model"), defined)
    return {**faults, "title": "faults of an EtherCAT line"}


def _optional(schema: Schema, *keys: str) -> Schema:
    """Return a schema in which some keys are not required, or none is if no key is given."""
    left = [key for key in schema.get("required", ()) if keys and key not in keys]
    return {**schema, "required": left}


def _laid_under(choices: Schema, properties: Schema, *required: str) -> Schema:
    """Return the schema of a component with further keys."""
    [(kind, each)] = [(key, choices[key]) for key in ("oneOf", "anyOf") if key in choices]
    return {
        kind: [
            {**of, "properties": {**properties, **of["properties"]}, "required": [*required, *of["required"]]}
            for of in each
        ]
    }


def _with_loop(choices: Schema, defined: Schema) -> Schema:
    loop, taken = defined["LoopProperties"]["properties"], _TEXTS["taken"]
    known = {key: loop[key] | ({"taken": taken[key]} if key in taken else {}) for key in LOOP_KEYS}
    for key in RANGES:
        ends = {"type": "array", "items": known[key]["anyOf"][0], "minItems": 2, "maxItems": 2}
        known[key] = {**known[key], "anyOf": [*known[key]["anyOf"], ends]}
    return _laid_under(choices, known)


def _bus(scene: Schema, defined: Schema) -> Schema:
    """Return the schema of one bus, or of a list of buses whose first entry has the common values."""
    can = defined["CanBusParameters"]
    one = {**can, "title": "the only one, or the first", "properties": {"type": _OF_CAN, **can["properties"]}}
    line = _model(buses.part("ethercat", "bus"), defined)
    further = {**defined["FurtherBus"], "title": "the second and those behind it"}
    name = further["properties"]["name"]
    further["properties"] = {"type": _OF_CAN, **further["properties"]}
    named = [{**of, "properties": {"name": name, **of["properties"]}, "required": ["name", *of["required"]]}
             for of in (one, line)]  # fmt: skip
    several = {"type": "array", "minItems": 1, "prefixItems": [{"anyOf": named}], "items": further}
    return {"anyOf": [one, line, several]}


def _model(model: type[Parameters], defined: Schema) -> Schema:
    """Return the schema of a model that no field of `Scene` names, and add what it refers to."""
    schema = model.model_json_schema(schema_generator=_WithWords)
    for name, of in schema.pop("$defs", {}).items():
        defined.setdefault(name, of)
    return schema


def _axis(defined: Schema, environment: Schema, passivity: Schema) -> Schema:
    schema = _on_either_bus(defined["AxisParameters"], _model(buses.part("ethercat", "axis"), defined))
    own = {
        "bus": {"type": "string"},
        "drive": {"type": "string"},
        "environment": {"anyOf": [_optional(choice) for choice in environment["anyOf"]]},
        "passivity": {"anyOf": [_optional(choice) for choice in passivity["anyOf"]]},
    }
    return {**schema, "properties": {**schema["properties"], **_described(own, _TEXTS["axis"])}}


def _on_either_bus(on_can: Schema, on_ethercat: Schema) -> Schema:
    """Return the schema of an axis with the keys of both kinds of bus, of which it has those of its own."""
    properties = {**on_can["properties"], **on_ethercat["properties"]}
    needed = {"CAN": ("node_id", "eds"), "EtherCAT": ("position", "esi")}
    for kind, keys in needed.items():
        for key in keys:
            properties[key] = {**properties[key], "taken": f"required on {kind}"}
    required = [key for key in on_can["required"] if key not in needed["CAN"]]
    pairs = {first: [second] for first, second in needed.values()}
    return {**on_can, "properties": properties, "required": required, "dependentRequired": pairs}


def _group(defined: Schema) -> Schema:
    schema = _optional(defined["GroupScene"], "kinematics")
    of = schema["properties"]
    kinematics = [
        _counted(choice) if choice["properties"]["type"] == {"const": "identity"} else choice
        for choice in of["kinematics"]["oneOf"]  # the identity has as many axes as the group
    ]
    passivity = _with_loop(of["passivity"], defined)
    own = {**of, "kinematics": {"oneOf": kinematics, "taken": "`{type: identity}`"}, "passivity": passivity}
    return {**schema, "properties": _described(own, _TEXTS["group"])}


def _counted(identity: Schema) -> Schema:
    axes = identity["properties"]["axes"] | {"taken": "those of the group"}
    return _optional({**identity, "properties": identity["properties"] | {"axes": axes}}, "axes")


def _simulation(scene: Schema, parts: Schema, defined: Schema) -> Schema:
    of = defined["MechanismScene"]["properties"]
    further = _described({key: of[key] for key in ("axes", "hand")}, _TEXTS["mechanism"])
    of_axis = {key: _optional(part) if "properties" in part else part for key, part in parts.items()}
    keys = {
        **parts,
        **defined["SimulationParameters"]["properties"],
        "bus": {"anyOf": [{**defined["BusEffects"], "title": "faults of CAN buses"}, _faults(defined), _NULL]},
        "mechanisms": _or_null({"type": "array", "items": _laid_under(of["mechanism"], further, "axes")}),
        "far_network": _or_null(defined["NetworkParameters"]),
        "axes": {"type": "object", "additionalProperties": _mapping(of_axis)},
    }
    return _mapping(_described(keys, _TEXTS["simulation"]))
