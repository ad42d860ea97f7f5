"""Writes docs/configuration.md from the parameter models: `python -m tools.make_configuration`.

Keys, units, ranges and defaults come from the models themselves, the words from their docstrings.
"""

import re
import sys
import types
import typing
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from textwrap import fill
from typing import Any, Final, Literal, NamedTuple

from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from canhaptic.control.environments import ENVIRONMENTS
from canhaptic.control.mechanisms import KINEMATICS
from canhaptic.control.multi_axis import GROUP_ALGORITHMS, NETWORKS
from canhaptic.control.passivity import ALGORITHMS
from canhaptic.control.passivity.controller import LoopProperties
from canhaptic.drive.axis_parameters import AxisParameters, BusParameters
from canhaptic.logs.log_parameters import LogParameters
from canhaptic.registry import load
from canhaptic.scene.axes import LOOP_KEYS, SCALING_KEYS
from canhaptic.scene.buses import BusTitle, FurtherBus
from canhaptic.scene.models import AutoAccuracy, RunParameters, SimulationParameters
from canhaptic.scene.profiles import PROFILE_KEY
from canhaptic.sim.bus.bus_effects import BusEffects
from canhaptic.sim.drive.drive_parameters import SimulatedDriveParameters
from canhaptic.sim.plant.effects import EFFECTS
from canhaptic.sim.plant.mechanism import MECHANISMS
from canhaptic.sim.plant.mechanism.task_hand import TaskHand
from canhaptic.sim.plant.plant import AccuracyParameters, PlantParameters
from canhaptic.sim.plant.user import UserParameters
from canhaptic.units import Parameters
from tools.field_words import first_sentence, words_of

PAGE: Final = Path(__file__).resolve().parent.parent / "docs" / "configuration.md"
_INTRODUCTION: Final = """\
# Configuration

Every key of a scene file. This page is made from the models by `python -m tools.make_configuration`.

Plain numbers are SI (or the unit given here). A text may carry a unit, which is checked for dimension: `1 kHz`,
`100 N/m`, `50 us`. Where two units stand, the first is of a linear axis (`unit: m`), the second of a rotary one
(`unit: rad`). A key without a default may be left out; where the words say None, they say what leaving it out (or
`null`) means. A key that is not listed is an error that names the nearest one. Any value can be laid over from the
command line: `--set environment.stiffness="500 N/m"`, `--set axes.0.node_id=5`.

`canhaptic schema` prints the same as JSON Schema, for editors.
"""
_HEAD: Final = "| key | unit | value | default | |\n|---|---|---|---|---|"
_REQUIRED: Final = "required"
_OWN_LOOP: Final = "Keys of the section `passivity` for this axis alone, laid over it."
_NAMES: Final = "list of names"
_SIGNS: Final = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}

Row = tuple[str, str, str, str, str]  # key, unit, value, default, words


class _Table(NamedTuple):
    """One table: the keys of a model, and those that a scene has beside it."""

    title: str  # "" directly below the heading of the section
    model: type[Parameters] | None = None
    only: frozenset[str] | None = None  # keys of the model; None: all
    beside: tuple[Row, ...] = ()
    words: str = ""
    taken: Mapping[str, str] = {}  # where a scene takes keys from that the model would need, or whose default it knows


class _Section(NamedTuple):
    title: str
    words: str
    tables: list[_Table]


def page() -> str:
    """Returns the text of the page."""
    parts = [_INTRODUCTION]
    for section in _sections():
        parts.append(f"\n## {section.title}\n\n{fill(section.words, 120)}\n")
        for table in section.tables:
            parts.extend(_written(table, section.title.strip("`")))
    return re.sub(r"\n{3,}", "\n\n", "\n".join(parts)).rstrip() + "\n"


def _sections() -> list[_Section]:
    return [*_of_the_rig(), *_of_groups(), *_of_the_simulation(), *_of_the_run()]


def _key(name: str, value: str, default: str, words: str) -> Row:
    return name, "", value, default, words


def _of_the_rig() -> list[_Section]:
    of_axis = (
        _key("bus", "name", "", "The bus that the drive is on; needed where there are several."),
        _key(PROFILE_KEY, "name or path", "", "Profile of a drive: keys of an axis, laid under these."),
        _key("environment", "keys", "", "Keys of the section `environment` for this axis alone, laid over it."),
        _key("passivity", "keys", "", _OWN_LOOP),
    )
    further = "A second bus and those behind it: rate, link policy and the rest are those of the first."
    loop = "What is known of the loop; of every algorithm."
    return [
        _Section(
            "Top level", "The sections of a scene, and what belongs to none.", [_Table("", RunParameters, beside=_TOP)]
        ),
        _Section(
            "`bus`",
            "One CAN bus, its rate of SYNC, and what happens when frames go missing on it. For several buses it is a "
            "list, and each has a `name`.",
            [
                _Table("", BusParameters),
                _Table("`bus[0].name`", BusTitle),
                _Table("`bus[1]` and on", FurtherBus, words=further),
            ],
        ),
        _Section(
            "`axes`",
            "A list of drives, each with the axis behind it. Torques are those of the axis: N*m where it turns, N where"
            " it slides.",
            [_Table("", AxisParameters, beside=of_axis)],
        ),
        _Section("`environment`", "Chosen by `type`; of all axes, or inside one axis.", _chosen("type", ENVIRONMENTS)),
        _Section(
            "`passivity`",
            "Chosen by `algorithm`; of all axes, or inside one axis.",
            [
                _Table("beside `algorithm`", LoopProperties, frozenset(LOOP_KEYS), words=loop, taken=_FROM_BUS),
                *_chosen("algorithm", ALGORITHMS),
            ],
        ),
    ]


_FROM_BUS: Final = {"sample_time": "from `bus.rate`", "delay": "from `bus.rpdo`"}
_TOP: Final = (
    _key("bus", "keys or list", _REQUIRED, "The CAN bus, or several: [below](#bus)."),
    _key("axes", "list", _REQUIRED, "The drives and what they move: [below](#axes)."),
    _key("environment", "keys", "", "What is rendered on an axis: [below](#environment)."),
    _key("passivity", "keys", "", "The algorithm that keeps the account: [below](#passivity)."),
    _key("groups", "list", "", "Axes that render together: [below](#groups)."),
    _key("simulation", "keys", "", "What stands behind simulated drives: [below](#simulation)."),
    _key("accuracy", "keys", "", "How the simulated plant is computed: [below](#accuracy)."),
    _key("log", "keys", "", "What a run writes: [below](#log)."),
)


def _of_groups() -> list[_Section]:
    entry = (
        _key("name", "text", _REQUIRED, "Of the group, in messages, tables and logs."),
        _key("axes", _NAMES, _REQUIRED, "The motor axes, in the order of the kinematics."),
        _key("kinematics", "keys", "`{type: identity}`", "From motor axes to task space; below."),
        _key("network", "keys", _REQUIRED, "What is rendered in task space; below."),
        _key("passivity", "keys", _REQUIRED, "The algorithm of the group; below."),
    )
    loop = "What is known of the loops of all its axes; an axis may have its own in its `passivity`."
    return [
        _Section(
            "`groups`", "A list of groups of axes that render one network with one account.", [_Table("", beside=entry)]
        ),
        _Section(
            "`groups[].kinematics`",
            "Between the motor axes of a group and its task space; chosen by `type`.",
            _chosen("type", KINEMATICS, {"identity": {"axes": "those of the group"}}),
        ),
        _Section("`groups[].network`", "What a group renders; chosen by `type`.", _chosen("type", NETWORKS)),
        _Section(
            "`groups[].passivity`",
            "Chosen by `algorithm`.",
            [
                _Table(
                    "beside `algorithm` of a group",
                    LoopProperties,
                    frozenset(LOOP_KEYS),
                    words=loop,
                    taken=_FROM_BUS,
                ),
                *_chosen("algorithm", GROUP_ALGORITHMS),
            ],
        ),
    ]


def _of_the_simulation() -> list[_Section]:
    parts = (
        _key("drive", "keys", "", "The simulated drive; below."),
        _key("plant", "keys", _REQUIRED, "The moving mass; below. Not of an axis that moves a mechanism."),
        _key("user", "keys", "", "The hand; below."),
        _key("effects", "list", "`[]`", "What else plant, drive and hand do: [below](#simulationeffects)."),
        _key("axes", "keys by axis", "", "`drive`, `plant`, `user`, `effects` of one axis, laid over those of all."),
        _key("bus", "keys", "", "What the simulated bus does to its frames; below."),
        _key("mechanisms", "list", "", "What several drives move together: [below](#simulationmechanisms)."),
    )
    scaling = dict.fromkeys(SCALING_KEYS, "that of the axis")
    return [
        _Section(
            "`simulation`",
            "Present only without hardware: what stands behind the drives.",
            [
                _Table("", SimulationParameters, beside=parts),
                _Table("`simulation.drive`", SimulatedDriveParameters, taken=scaling),
                _Table("`simulation.plant`", PlantParameters),
                _Table("`simulation.user`", UserParameters),
                _Table("`simulation.bus`", BusEffects),
            ],
        ),
        _Section(
            "`simulation.effects`", "A list; each chosen by `type`, and absent unless named.", _chosen("type", EFFECTS)
        ),
        _of_mechanisms(),
    ]


def _of_mechanisms() -> _Section:
    entry = (
        _key("axes", _NAMES, _REQUIRED, "The axes of its motors, in the order of the mechanism."),
        _key("hand", "keys", "", "What holds the handle, in task space; below. Without it nobody does."),
    )
    return _Section(
        "`simulation.mechanisms`",
        "A list; each chosen by `type`: what several motors move together.",
        [
            _Table("beside `type`", beside=entry),
            _Table("`simulation.mechanisms[].hand`", TaskHand),
            *_chosen("type", MECHANISMS),
        ],
    )


def _of_the_run() -> list[_Section]:
    auto = "In place of the keys above: the build chooses them."
    return [
        _Section(
            "`accuracy`",
            "How the simulated plant is computed: what it spends on events and on effects that are not exact.",
            [_Table("", AccuracyParameters), _Table("`accuracy.auto`", AutoAccuracy, words=auto)],
        ),
        _Section(
            "`log`",
            "Where a run is written to; paths are relative to the current folder, and options of `run` win over them.",
            [_Table("", LogParameters)],
        ),
    ]


def _chosen(
    selector: str, table: Mapping[str, str], taken: Mapping[str, Mapping[str, str]] | None = None
) -> list[_Table]:
    """Returns one table for each entry of a table of the package."""
    found = []
    for name in table:
        entry = load(dict(table), name, selector)
        known = (taken or {}).get(name, {})
        found.append(_Table(f"`{selector}: {name}`", getattr(entry, "parameters_type", entry), taken=known))
    return found


def _written(table: _Table, path: str) -> Iterator[str]:
    """Yields a title, what the model says of itself, its keys, and the tables of the models that it contains."""
    about = table.words or (first_sentence(table.model) if table.model is not None and table.title else "")
    yield f"\n### {table.title}\n\n{about}\n" if table.title else ""
    rows, inner = list(table.beside), dict[type[Parameters], list[str]]()
    if table.model is not None:
        words = words_of(table.model)
        for name, field in table.model.model_fields.items():
            if (table.only is not None and name not in table.only) or name == "type":
                continue
            rows.append(_row(name, field, words.get(name, ""), table.taken.get(name, "")))
            for each in _contained(field.annotation):
                inner.setdefault(each, []).append(name)
    if rows:
        yield "\n".join([_HEAD, *(_line(row) for row in rows)]) + "\n"
    for model, names in inner.items():
        yield from _written(_Table(_title(table.title, path, model, names), model), path)


def _title(outer: str, path: str, model: type[Parameters], names: list[str]) -> str:
    """Returns the title of a model inside another: its path, and its `type` where it has one."""
    kind = model.model_fields.get("type")
    chosen = f" with `type: {kind.default}`" if kind is not None and kind.default is not PydanticUndefined else ""
    if outer.startswith("`type:"):
        return ", ".join(f"`{name}`" for name in names) + f"{chosen} of {outer}"
    before = outer.strip("`") or path
    return ", ".join(f"`{before}.{name}`" for name in names) + chosen


def _row(name: str, field: FieldInfo, words: str, taken: str) -> Row:
    unit, value = _value(field.annotation, field.metadata)
    default = _REQUIRED if field.is_required() else _default(field.default, field.default_factory)
    return name, unit, value, taken or default, words


def _line(row: Row) -> str:
    cells = (f"`{row[0]}`", *row[1:])
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def _value(annotation: Any, notes: Sequence[Any] = ()) -> tuple[str, str]:
    """Returns unit and accepted values of a field."""
    origin, parts = typing.get_origin(annotation), typing.get_args(annotation)
    for note in notes:
        if hasattr(note, "limits") and hasattr(note, "unit"):
            unit = " or ".join(dict.fromkeys((note.unit.linear, note.unit.rotary)))
            limits = ", ".join(f"{_SIGNS[key]} {value:g}" for key, value in note.limits.items())
            return "" if unit == "1" else unit, limits or "any"
    if origin is typing.Annotated:
        return _value(parts[0], parts[1:])
    if origin is Literal:
        return "", ", ".join(f"`{_plain(value)}`" for value in parts)
    if origin in (types.UnionType, typing.Union):
        found = [_value(part) for part in parts if part is not type(None)]
        return found[0][0], " or ".join(dict.fromkeys(value for _, value in found))
    if origin is tuple or origin is list:
        unit, each = _value(parts[0])
        count = "list" if parts[-1] is Ellipsis or origin is list else f"{len(parts)} values"
        return unit, f"{count} of {_MANY[each]}" if each in _MANY else f"{count}, each {each}"
    return "", _KINDS.get(origin or annotation, "keys")


_MANY: Final = {
    "number": "numbers",
    "integer": "integers",
    "text": "texts",
    "keys": "mappings",
    "list of numbers": "rows",
}
_KINDS: Final[dict[Any, str]] = {
    bool: "`true`, `false`",
    str: "text",
    Path: "path",
    int: "integer",
    float: "number",
    dict: "mapping",
    Mapping: "mapping",
}


def _contained(annotation: Any) -> Iterator[type[Parameters]]:
    """Yields the models that a field contains."""
    if isinstance(annotation, type) and issubclass(annotation, Parameters):
        yield annotation
    for part in typing.get_args(annotation) if typing.get_origin(annotation) is not Literal else ():
        yield from _contained(part)


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


def main() -> int:
    """Writes the page; returns 0."""
    PAGE.write_text(page(), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
