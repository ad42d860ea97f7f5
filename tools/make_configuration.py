"""Writes docs/configuration.md from the parameter models: `python -m tools.make_configuration`.

Keys, units, ranges and defaults come from the models themselves, the words from their docstrings.
"""

import ast
import inspect
import re
import sys
import types
import typing
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Literal, NamedTuple

from pydantic_core import PydanticUndefined

from canhaptic.drive.parameters import AxisParameters, BusParameters
from canhaptic.haptics.environments import ENVIRONMENTS
from canhaptic.haptics.kinematics import KINEMATICS
from canhaptic.haptics.network import NETWORKS
from canhaptic.haptics.passivity import ALGORITHMS
from canhaptic.haptics.passivity.protocol import LoopProperties
from canhaptic.logs.parameters import LogParameters
from canhaptic.parameters import Parameters
from canhaptic.scene.axes import LOOP_KEYS
from canhaptic.scene.models import AutoAccuracy, RunParameters, SimulationParameters
from canhaptic.sim.bus_effects import BusEffects
from canhaptic.sim.drive_parameters import SimulatedDriveParameters
from canhaptic.sim.effects import EFFECTS
from canhaptic.sim.mechanism import MECHANISMS
from canhaptic.sim.plant import AccuracyParameters, PlantParameters
from canhaptic.sim.user import UserParameters
from canhaptic.tables import load

PAGE = Path(__file__).resolve().parent.parent / "docs" / "configuration.md"
_INTRODUCTION = """\
# Configuration

Every key of a scene file. This page is made from the models by `python -m tools.make_configuration`.

Plain numbers are SI (or the unit given here). A text may carry a unit, which is checked for dimension: `1 kHz`,
`100 N/m`, `50 us`. Where two units stand, the first is of a linear axis (`unit: m`), the second of a rotary one
(`unit: rad`). A key that is not listed is an error that names the nearest one. Any value can be laid over from the
command line: `--set environment.stiffness="500 N/m"`, `--set axes.0.node_id=5`.

`canhaptic schema` prints the same as JSON Schema, for editors.
"""


class _Section(NamedTuple):
    title: str
    words: str
    models: list[tuple[str, type[Parameters], frozenset[str] | None]]  # heading, model, keys of it or all


def page() -> str:
    """Returns the text of the page."""
    parts = [_INTRODUCTION]
    for section in _sections():
        parts.append(f"\n## {section.title}\n\n{section.words}\n")
        seen: set[type[Parameters]] = set()
        for heading, model, keys in section.models:
            parts.extend(_model(heading, model, keys, seen))
    return "\n".join(parts).rstrip() + "\n"


def _sections() -> list[_Section]:
    return [
        _Section("Top level", "Beside the sections below.", [("", RunParameters, None)]),
        _Section(
            "`bus`",
            "One bus, or a list of them, each with a `name` that an axis's `bus` gives.",
            [("", BusParameters, None)],
        ),
        _Section(
            "`axes`",
            "A list. `drive: NAME` lays a profile of `configs/drives/` under an axis.",
            [("", AxisParameters, None)],
        ),
        _Section("`environment`", "Chosen by `type`; of all axes, or inside one axis.", _chosen("type", ENVIRONMENTS)),
        _Section(
            "`passivity`",
            "Chosen by `algorithm`; of all axes, or inside one axis.",
            [
                ("for every algorithm: what is known of the loop", LoopProperties, frozenset(LOOP_KEYS)),
                *_chosen("algorithm", ALGORITHMS),
            ],
        ),
        _Section(
            "`groups[].kinematics`",
            "Between the motor axes of a group and its task space.",
            _chosen("type", KINEMATICS),
        ),
        _Section("`groups[].network`", "What a group of axes renders with one account.", _chosen("type", NETWORKS)),
        _Section(
            "`simulation`",
            "Present only without hardware: what stands behind the drives.",
            [
                ("", SimulationParameters, None),
                ("`drive`", SimulatedDriveParameters, None),
                ("`plant`", PlantParameters, None),
                ("`user`", UserParameters, None),
                ("`bus`: what the simulated bus does to its frames", BusEffects, None),
            ],
        ),
        _Section(
            "`simulation.effects`", "A list; each chosen by `type`, and absent unless named.", _chosen("type", EFFECTS)
        ),
        _Section(
            "`simulation.mechanisms`",
            "Chosen by `type`: what several motors move together.",
            _chosen("type", MECHANISMS),
        ),
        _Section(
            "`accuracy`",
            "How the simulated plant is computed.",
            [("", AccuracyParameters, None), ("chosen by a tolerance", AutoAccuracy, None)],
        ),
        _Section("`log`", "What a run writes.", [("", LogParameters, None)]),
    ]


def _chosen(selector: str, table: Mapping[str, str]) -> list[tuple[str, type[Parameters], frozenset[str] | None]]:
    found: list[tuple[str, type[Parameters], frozenset[str] | None]] = []
    for name in table:
        entry = load(dict(table), name, selector)
        found.append((f"`{selector}: {name}`", getattr(entry, "parameters_type", entry), None))
    return found


def _model(
    heading: str, model: type[Parameters], keys: frozenset[str] | None, seen: set[type[Parameters]]
) -> Iterator[str]:
    """Yields a heading, what the model says of itself, its table, and the models that it contains."""
    if heading:
        yield f"\n### {heading}\n"
    about = _first_sentence(inspect.getdoc(model) or "") if model.__doc__ else ""
    if about:
        yield f"{about}\n"
    words = _words(model)
    fields = {name: field for name, field in model.model_fields.items() if keys is None or name in keys}
    if fields:
        yield "| key | unit | range | default | |\n|---|---|---|---|---|"
    inner: list[type[Parameters]] = []
    for name, field in fields.items():
        unit, limits, choices, contained = _traits(field.annotation, list(field.metadata))
        inner += [each for each in contained if each not in seen]
        default = "required" if field.is_required() else _default(field.default, field.default_factory)
        row = [f"`{name}`", unit, limits or choices, default, words.get(name, "")]
        yield "| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |"
    for each in dict.fromkeys(inner):
        seen.add(each)
        yield from _model(f"{each.__name__}, inside {heading or 'it'}", each, None, seen)


def _traits(annotation: Any, metadata: list[Any]) -> tuple[str, str, str, list[type[Parameters]]]:
    """Returns unit, range, choices and contained models of a field."""
    unit = limits = ""
    choices: list[str] = []
    contained: list[type[Parameters]] = []
    for part in (*metadata, *_leaves(annotation)):
        if hasattr(part, "limits") and hasattr(part, "unit"):
            unit = " or ".join(dict.fromkeys((part.unit.linear, part.unit.rotary)))
            limits = ", ".join(f"{_SIGNS[key]} {value:g}" for key, value in part.limits.items())
        elif typing.get_origin(part) is Literal:
            choices += [f"`{_plain(value)}`" for value in typing.get_args(part)]
        elif part is bool:
            choices += ["`true`", "`false`"]
        elif isinstance(part, type) and issubclass(part, Parameters):
            contained.append(part)
    return ("" if unit == "1" else unit), limits, ", ".join(choices), contained


_SIGNS = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}


def _leaves(annotation: Any) -> Iterator[Any]:
    """Yields what an annotation is made of."""
    origin = typing.get_origin(annotation)
    if origin is None or origin is Literal:
        yield annotation
        return
    if origin is typing.Annotated:
        inner, *notes = typing.get_args(annotation)
        yield from notes
        yield from _leaves(inner)
        return
    if origin in (types.UnionType, typing.Union) or origin in (tuple, list, dict):
        for part in typing.get_args(annotation):
            yield from _leaves(part)


def _default(default: Any, factory: Any) -> str:
    value = factory() if factory is not None and default is PydanticUndefined else default
    if value is None or isinstance(value, Parameters):
        return "" if value is None else "its defaults"
    return f"`{_plain(value)}`"


def _plain(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, tuple):
        return "[" + ", ".join(map(_plain, value)) + "]"
    return str(value)


def _words(model: type[Parameters]) -> dict[str, str]:
    """Returns what is said of each field: the string below it, or its entry under `Attributes:`."""
    found: dict[str, str] = {}
    for owner in reversed(model.__mro__):
        if not issubclass(owner, Parameters) or owner is Parameters:
            continue
        [body] = [node for node in ast.walk(ast.parse(_source(owner))) if isinstance(node, ast.ClassDef)][:1]
        found.update(_attributes(inspect.cleandoc(ast.get_docstring(body) or "")))
        for field, text in zip(body.body, body.body[1:], strict=False):
            if isinstance(field, ast.AnnAssign) and isinstance(text, ast.Expr) and isinstance(text.value, ast.Constant):
                found[ast.unparse(field.target)] = " ".join(str(text.value.value).split())
    return found


def _source(owner: type) -> str:
    return inspect.cleandoc("\n" + inspect.getsource(owner))


def _attributes(docstring: str) -> dict[str, str]:
    _, _, listed = docstring.partition("Attributes:\n")
    entries = re.split(r"\n    (?=\w+: )", "\n" + listed.split("\n\n")[0])
    pairs = [entry.split(": ", 1) for entry in entries if ": " in entry]
    return {name.strip(): " ".join(text.split()) for name, text in pairs}


def _first_sentence(docstring: str) -> str:
    return " ".join(docstring.split("\n\n")[0].split())


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
    sys.stdout.write(f"{PAGE}\n")
