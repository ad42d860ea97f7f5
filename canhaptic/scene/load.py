"""A scene file to a `Scene`: read, laid over with overrides, validated section by section, cross-checked.

Every fault found on the way is noted with its line; all of them are raised together, before anything is built.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from canhaptic.errors import SceneConflictError, SceneError
from canhaptic.logs.log_parameters import LogParameters
from canhaptic.scene.axes import LOOP_KEYS, SIMULATION_PARTS, read_axis
from canhaptic.scene.buses import BusSections, bus_of_axis, check_every_bus_has_an_axis, read_buses
from canhaptic.scene.cross_checks import cross_check
from canhaptic.scene.diagnostics import Diagnostics, SourceLocation
from canhaptic.scene.document import MarkedList, MarkedMapping, mark_plain, parse_yaml
from canhaptic.scene.groups import GroupEntry, check_axis_names, group_of, read_group_entries, read_groups
from canhaptic.scene.mechanisms import (
    MECHANISMS_KEY,
    MechanismEntry,
    moves_mechanism,
    read_mechanism_entries,
    read_mechanisms,
)
from canhaptic.scene.models import AutoAccuracy, AxisScene, RunParameters, Scene, SimulationParameters
from canhaptic.scene.overrides import apply_overrides
from canhaptic.scene.section import read_list, read_mapping, read_section, refuse_unknown_keys
from canhaptic.sim.plant.plant import AccuracyParameters

if TYPE_CHECKING:
    from canhaptic.sim.bus.bus_effects import BusEffects

MAX_BYTES: Final = 1_000_000
SECTIONS: Final = ("bus", "axes", "groups", "environment", "passivity", "simulation", "accuracy", "log", "duration")


def load_scene(path: str | Path, overrides: Sequence[str] = ()) -> Scene:
    """Returns the validated scene of a YAML file.

    Args:
        path: The scene file.
        overrides: Values laid over it, each `path.to.key=VALUE` with a YAML value (`axes.0.node_id=5`).

    Raises:
        SceneError: The file cannot be read, or anything in it is wrong; lists every fault with its line.
    """
    return scene_from_text(_text(Path(path), str(path)), str(path), overrides)


def scene_from_text(text: str, source: str, overrides: Sequence[str] = ()) -> Scene:
    """Returns the validated scene of YAML text, such as the one that an energy log keeps.

    Args:
        text: The scene.
        source: The file it came from: named in faults, and the place that relative paths start from.
        overrides: As for `load_scene`.

    Raises:
        SceneError: Anything in it is wrong; lists every fault with its line.
    """
    faults = Diagnostics()
    document = parse_yaml(text, source, faults)
    if len(faults) and not isinstance(document, MarkedMapping):
        faults.raise_if_any()
    return _read(document, source, text, overrides, faults)


def scene_from_mapping(values: Mapping[str, Any], source: str = "scene", overrides: Sequence[str] = ()) -> Scene:
    """Returns the validated scene of plain Python values with the keys of a scene file.

    Raises:
        SceneError: Anything in it is wrong; lists every fault.
    """
    return _read(mark_plain(values, source), source, "", overrides, Diagnostics())


def _text(path: Path, source: str) -> str:
    try:
        with path.open("rb") as file:
            content = file.read(MAX_BYTES + 1)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise SceneError([f"{source}: cannot be read ({reason}); give the path of a scene file (YAML)"]) from error
    if len(content) > MAX_BYTES:
        raise SceneError([f"{source}: larger than {MAX_BYTES} bytes; a scene has a few thousand"])
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content[: error.start].count(b"\n") + 1
        raise SceneError(
            [f"{source}:{line}: not UTF-8 text (byte 0x{content[error.start]:02x}); save it as UTF-8"]
        ) from error


def _read(document: Any, source: str, text: str, overrides: Sequence[str], faults: Diagnostics) -> Scene:
    top = SourceLocation(source, 1, 1, ()) if text else SourceLocation(source, 0, 0, ())
    if document is None:
        faults.add(top, f"empty, expected a mapping with {', '.join(SECTIONS)}")
        raise faults.error()
    sections = read_mapping(document, top, faults, ", ".join(SECTIONS))
    if sections is None:
        raise faults.error()
    apply_overrides(sections, overrides, faults)
    refuse_unknown_keys(sections, SECTIONS, faults)
    scene = _sections(sections, source, text, tuple(overrides), faults)
    if scene is None or len(faults):
        raise faults.error()
    cross_check(scene, sections, faults)
    faults.raise_if_any(SceneConflictError)
    return scene


def _sections(
    sections: MarkedMapping, source: str, text: str, overrides: tuple[str, ...], faults: Diagnostics
) -> Scene | None:
    run = read_section(RunParameters, sections.only(RunParameters.model_fields), faults)
    log_section = _section(sections, "log", faults)
    log = read_section(LogParameters, log_section, faults) if log_section is not None else LogParameters()
    simulation = _simulation(sections, faults)
    bus_effects = _bus_effects(sections, faults)
    buses = read_buses(sections, faults)
    accuracy = _accuracy(sections, faults)
    entries, moved = read_group_entries(sections, faults), read_mechanism_entries(sections, faults)
    axes = _axes(sections, buses, simulation.seed if simulation else 0, faults, entries, moved)
    _check_members(entries, sections, faults)
    groups = read_groups(entries, axes, LOOP_KEYS, faults)
    check_axis_names([(entry.section, entry.axes) for entry in moved], _axis_names(sections), "mechanism", faults)
    mechanisms = read_mechanisms(moved, axes, faults)
    if run is None or log is None or buses is None or accuracy is None or not axes:
        return None
    tolerance = accuracy.auto if isinstance(accuracy, AutoAccuracy) else None
    solved = AccuracyParameters() if isinstance(accuracy, AutoAccuracy) else accuracy
    axes = tuple(_solved(axis, solved, simulation is not None and simulation.compiled) for axis in axes)
    return Scene(
        source, text, overrides, buses.first, axes, log, run, simulation, bus_effects, buses.name, buses.further,
        tolerance, groups=groups, mechanisms=tuple(replace(of, substeps=solved.substeps) for of in mechanisms),
    )  # fmt: skip


def _section(sections: MarkedMapping, name: str, faults: Diagnostics) -> MarkedMapping | None:
    """Returns a section; None when it is absent or no mapping (a fault)."""
    value = sections.get(name)
    if value is None:
        return None
    return read_mapping(value, sections.value_at(name), faults, "keys and values")


def _simulation(sections: MarkedMapping, faults: Diagnostics) -> SimulationParameters | None:
    section = _section(sections, "simulation", faults)
    if section is None:
        return None
    names = (*SIMULATION_PARTS, "axes", "bus", MECHANISMS_KEY)
    return read_section(SimulationParameters, section.without(*names), faults, also=names)


def _accuracy(sections: MarkedMapping, faults: Diagnostics) -> AccuracyParameters | AutoAccuracy | None:
    """Returns what simulated plants spend on accuracy; the defaults where the scene does not say."""
    if sections.get("accuracy") == "auto":
        faults.add(sections.value_at("accuracy"), "got 'auto' without a tolerance; write it as {auto: 1 um}")
        return None
    section = _section(sections, "accuracy", faults)
    if section is not None and "auto" in section:
        return read_section(AutoAccuracy, section, faults)
    if section is None:
        return AccuracyParameters() if sections.get("accuracy") is None else None
    return read_section(AccuracyParameters, section, faults, also=AutoAccuracy.model_fields)


def _solved(axis: AxisScene, accuracy: AccuracyParameters, compiled: bool) -> AxisScene:
    """Returns an axis whose plant, if it is simulated, is solved so."""
    if axis.simulation is None:
        return axis
    return replace(axis, simulation=replace(axis.simulation, accuracy=accuracy, compiled=compiled))


def _bus_effects(sections: MarkedMapping, faults: Diagnostics) -> "BusEffects | None":
    """Returns what the simulated bus does to its frames; None when it is ideal, and then nothing is imported."""
    simulation = sections.get("simulation")
    if not isinstance(simulation, MarkedMapping) or "bus" not in simulation:
        return None
    from canhaptic.sim.bus.bus_effects import BusEffects

    section = _section(simulation, "bus", faults)
    return None if section is None else read_section(BusEffects, section, faults)


def _axis_names(sections: MarkedMapping) -> list[str]:
    """Returns the names of all axes as written, right or wrong otherwise."""
    axes = sections.get("axes")
    entries = axes if isinstance(axes, MarkedList) else ()
    return [str(entry.get("name")) for entry in entries if isinstance(entry, MarkedMapping)]


def _check_members(entries: tuple[GroupEntry, ...], sections: MarkedMapping, faults: Diagnostics) -> None:
    """Notes axes of groups that are none, and shared sections that no axis reads because groups render on all."""
    names = _axis_names(sections)
    if not entries or not names:
        return
    check_axis_names([(entry.section, entry.axes) for entry in entries], names, "group", faults)
    if all(group_of(name, entries) for name in names):
        for key in ("environment", "passivity"):
            if sections.get(key) is not None:
                faults.add(sections.keys_at[key], "no axis renders by itself; give it in the group, or leave it out")


def _axes(
    sections: MarkedMapping,
    buses: BusSections | None,
    seed: int,
    faults: Diagnostics,
    groups: tuple[GroupEntry, ...],
    mechanisms: tuple[MechanismEntry, ...],
) -> tuple[AxisScene, ...]:
    at = sections.value_at("axes")
    entries = read_list(sections.get("axes"), at, faults, "axes, each with name, node_id, eds, ...")
    if entries is None:
        return ()
    if not entries:
        faults.add(at, "got an empty list, expected at least one axis")
    axes: list[AxisScene | None] = []
    used: list[str] = []
    for index, (entry, entry_at) in enumerate(entries.items_at()):
        section = read_mapping(entry, entry_at, faults, "name, node_id, eds, ...")
        if section is not None:
            used.append("" if buses is None else bus_of_axis(section, buses.names, faults))
            name = str(section.get("name"))
            group, moves = group_of(name, groups), moves_mechanism(name, mechanisms)
            axis = read_axis(section, sections, buses and buses.first, seed + index, faults, group, moves)
            axes.append(axis and replace(axis, bus=used[-1]))
    if buses is not None and entries:
        check_every_bus_has_an_axis(buses.names, used, sections, faults)
    _check_parts_of_axes(sections, faults)
    return tuple(axis for axis in axes if axis is not None)


def _check_parts_of_axes(sections: MarkedMapping, faults: Diagnostics) -> None:
    """Notes every key of `simulation.axes` that names no axis, and every unknown part below it."""
    simulation = sections.get("simulation")
    if not isinstance(simulation, MarkedMapping) or simulation.get("axes") is None:
        return
    own = read_mapping(simulation["axes"], simulation.value_at("axes"), faults, "an axis name to its parts")
    if own is not None:
        refuse_unknown_keys(own, _axis_names(sections), faults)
        for parts in own.values():
            if isinstance(parts, MarkedMapping):
                refuse_unknown_keys(parts, SIMULATION_PARTS, faults)
