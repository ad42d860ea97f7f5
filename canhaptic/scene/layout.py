"""Conversion of a scene file to the fields of `Scene`: shared sections, sections of an axis, profiles, dictionaries.

    written                                   `Scene`
    bus: {...}, or a list                     bus, bus_name, further_buses
    environment, passivity, simulation.drive  environment, passivity, loop, simulation of each axis: its own keys over
      .plant .user .effects, and those of       the shared ones, and those over the profile of its drive
      axes.N, simulation.axes.NAME
    simulation: {seed, bus, mechanisms, ...}  simulation, bus_effects, mechanisms
    accuracy, log, duration, guard            accuracy or auto_accuracy, log, run

Every value keeps its location in the file. Faults of the layout are noted here; `Scene` validates the values.
"""

import os
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, get_args

from canhaptic.axis_units import Motion
from canhaptic.drive.axis_parameters import AxisParameters, CanBusParameters
from canhaptic.files import shipped
from canhaptic.registry import load, nearest, unknown_key
from canhaptic.scene.buses import BUSES, DICTIONARIES, ETHERCAT_EFFECTS
from canhaptic.scene.components import ComponentSpec
from canhaptic.scene.document import NOTED, Diagnostics, MarkedList, MarkedMapping
from canhaptic.scene.models import LOOP_KEYS, SIMULATION_PARTS, FurtherBus, GroupMembership, RunParameters
from canhaptic.units import shown

if TYPE_CHECKING:
    from canhaptic.scene.group_layout import Members

    _Joined = tuple[list[Members], list[Members]]  # of groups, and of simulated mechanisms

_SHIPPED: Final = shipped("eds")
_FILES: Final = {"can": "EDS or DCF", "ethercat": "ESI"}


def find_dictionary(section: MarkedMapping, faults: Diagnostics) -> MarkedMapping:
    """Return the section of an axis with the path of its EDS or DCF; note a fault if there is no such file.

    A relative path starts from the folder of the scene file (in an override: from the current folder), else from the
    folder `eds/` of the package.
    """
    key = DICTIONARIES[section.bus_kind]
    text = section.get(key)
    if not isinstance(text, str):
        return section  # missing or of another type: noted by the model
    at = section.value_at(key)
    folders = (at.folder, _SHIPPED)
    for folder in folders:
        if os.path.isfile(folder / text):
            found = section.copy()
            found.put(key, str(folder / text), section.keys_at[key], at)
            return found
    looked = "" if Path(text).is_absolute() else f" in {' or '.join(str(folder) for folder in folders)}"
    faults.add(at, f"got {shown(text)}, no such file{looked}; give the path of the drive's {_FILES[section.bus_kind]}")
    return section


SECTIONS: Final = (
    *("bus", "axes", "groups", "far", "environment", "passivity", "simulation", "accuracy", "log"),
    *RunParameters.model_fields,
)
PROGRAM: Final = {"program": "canhaptic.control.passivity.asked_torque:Program"}
"""The environment of an axis where a program or a far side requests the torques."""
OWN_SECTIONS: Final = ("environment", "passivity")
"""Shared sections that an axis can replace."""


def laid_out(written: MarkedMapping, source: str, text: str, overrides: Sequence[str], faults: Diagnostics) -> Any:
    """Return a scene file in the form of `Scene`, every value with its location, and note faults of the layout."""
    for key in written:
        if key not in SECTIONS:
            faults.add(written.keys_at[key], _of_a_section(key, written) or unknown_key(key, SECTIONS))
    scene = MarkedMapping(written.mark)
    scene.update(source=source, text=text, overrides=tuple(overrides), simulation=None)
    scene.set("run", written.only(RunParameters.model_fields))
    log = written.get("log")
    scene.put("log", MarkedMapping(written.mark) if log is None else log, written.mark, written.value_at("log"))
    _put_accuracy(scene, written, faults)
    _put_buses(scene, written, faults)
    simulation = faults.section(written, "simulation", "keys and values")
    if written.get("simulation") is not None:
        scene.set("simulation", NOTED)
    if simulation is not None:
        scene.set("simulation", simulation.without(*SIMULATION_PARTS, "axes", "bus", "mechanisms", "far_network"))
        if simulation.get("far_network") is not None:
            at = simulation.keys_at["far_network"], simulation.values_at["far_network"]
            scene.put("far_network", simulation["far_network"], *at)
        if simulation.get("bus") is not None:
            _put_effects(scene, simulation, set(_bus_kinds(written).values()))
    before = len(faults)
    groups, mechanisms = members = _members(written, simulation, faults)
    _check_far_axis(written, faults)
    axes = _axes(written, simulation, members, faults, is_known=len(faults) == before)
    scene.set("axes", axes)
    units: dict[str, Motion] = {str(a["parameters"].get("name")): a.motion for a in axes if a is not NOTED and a.motion}
    if (far := faults.section(written, "far", "name, axis, peer or world, coupling, ...")) is not None:
        far = far.copy()
        far.motion = units.get(str(far.get("axis")), "m")
        scene.put("far", far, written.keys_at["far"], written.values_at["far"])
    scene.set("groups", [group.as_group(units) for group in groups])
    scene.set("mechanisms", [mechanism.as_mechanism() for mechanism in mechanisms])
    return scene


def _of_a_section(key: str, written: MarkedMapping) -> str:
    """Return the message about a key that belongs into a section of the scene; empty if no section has it."""
    axes = written.get("axes")
    sections = dict(written) | ({"axes.0": axes[0]} if isinstance(axes, MarkedList) and axes else {})
    places = [name for name, section in sections.items() if isinstance(section, MarkedMapping) and key in section]
    return f"unknown key; did you mean {' or '.join(f'{place}.{key}' for place in places)}?" if places else ""


def _members(written: MarkedMapping, simulation: MarkedMapping | None, faults: Diagnostics) -> "_Joined":
    """Return groups and simulated mechanisms; their layout is imported only if the scene has one."""
    if written.get("groups") is None and (simulation is None or simulation.get("mechanisms") is None):
        return [], []
    from canhaptic.scene.group_layout import check_members, members_of

    groups = members_of(written, "groups", "groups, each with name, axes, network, ...", faults)
    mechanisms = members_of(simulation, "mechanisms", "mechanisms, each with type and axes", faults)
    check_members(groups, mechanisms, _axis_names(written), faults)
    return groups, mechanisms


def _axis_names(written: MarkedMapping) -> list[str]:
    """Return the names of all axes as written, valid or not."""
    return [str(entry.get("name")) for entry in _entries(written.get("axes"))]


def _check_far_axis(written: MarkedMapping, faults: Diagnostics) -> None:
    """Note a section `far` whose axis does not exist, before its axis is found to lack an environment."""
    far, names = written.get("far"), _axis_names(written)
    if isinstance(far, MarkedMapping) and "axis" in far and far["axis"] not in names:
        text = f"got {shown(far['axis'])}, expected the name of an axis: {', '.join(names)}"
        faults.add(far.value_at("axis"), text)


def _entries(value: object) -> list[MarkedMapping]:
    return [entry for entry in value if isinstance(entry, MarkedMapping)] if isinstance(value, MarkedList) else []


def _or_noted(section: MarkedMapping | None) -> Any:
    return NOTED if section is None else section


def _put_accuracy(scene: MarkedMapping, written: MarkedMapping, faults: Diagnostics) -> None:
    """Set the accuracy given, or the tolerance from which the build chooses it."""
    if (accuracy := written.get("accuracy")) is None:
        return
    at = written.values_at["accuracy"]
    if isinstance(accuracy, MarkedMapping) and "auto" in accuracy:
        scene.set("auto_accuracy", accuracy)
        return
    if accuracy == "auto":
        faults.add(at, "got 'auto' without a tolerance; write it as {auto: 1 um}")
    elsewhere = accuracy.without("auto") if isinstance(accuracy, MarkedMapping) else accuracy
    scene.put("accuracy", NOTED if accuracy == "auto" else elsewhere, written.keys_at["accuracy"], at)


def _put_effects(scene: MarkedMapping, simulation: MarkedMapping, kinds: set[str]) -> None:
    """Set the faults of the buses: each key goes to the kind of bus that has it."""
    effects, at = simulation["bus"], (simulation.keys_at["bus"], simulation.values_at["bus"])
    if "ethercat" not in kinds or not isinstance(effects, MarkedMapping):
        scene.put("bus_effects", effects, *at)
        return
    others = [key for key in effects if key not in ETHERCAT_EFFECTS]
    is_mixed = "can" in kinds
    scene.put("cable_effects", effects.without(*others) if is_mixed else effects, *at)
    if is_mixed and others:
        scene.put("bus_effects", effects.only(others), *at)


# --- buses --------------------------------------------------------------------------------------------------------


def _bus_names(written: MarkedMapping) -> tuple[str, ...]:
    """Return the names of the buses: "" for a single bus, and no names if one of several has none."""
    value = written.get("bus")
    if not isinstance(value, MarkedList):
        return ("",)
    names = [name for bus in _entries(value) if isinstance(name := bus.get("name"), str)]
    return tuple(names) if len(names) == len(value) else ()


def _bus_kinds(written: MarkedMapping) -> dict[str, str]:
    """Return the kind of each bus by its name; "" names a single one."""
    value = written.get("bus")
    entries = _entries(value) if isinstance(value, MarkedList) else [value] if isinstance(value, MarkedMapping) else []
    is_list = isinstance(value, MarkedList)
    return {str(entry.get("name", "")) if is_list else "": str(entry.get("type", "can")) for entry in entries}


def _of_its_kind(section: MarkedMapping, faults: Diagnostics) -> MarkedMapping:
    """Return the section of a bus that knows its kind; note a fault where there is no such kind."""
    kind = section.get("type", "can")
    if kind not in BUSES:
        faults.add(section.value_at("type"), f"got {shown(kind)}, expected one of: {', '.join(BUSES)}")
        kind = "can"
    known = section.without("type") if kind == "can" else section.copy()
    known.bus_kind = str(kind)
    return known


def bus_section(written: MarkedMapping, index: int) -> MarkedMapping:
    """Return the section of one bus as written."""
    value = written["bus"]
    section: MarkedMapping = value[index] if isinstance(value, MarkedList) else value
    return section


def _put_buses(scene: MarkedMapping, written: MarkedMapping, faults: Diagnostics) -> None:
    value = written.get("bus")
    if not isinstance(value, MarkedList):
        expected = "interface, channel and rate, or a list of such for several buses"
        only = faults.mapping(value, written.value_at("bus"), expected)
        scene.set("bus", NOTED if only is None else _of_its_kind(only, faults))
        return
    if not value:
        faults.add(value.mark, "got an empty list, expected at least one bus")
    entries = [faults.mapping(entry, at, "name, interface, channel, ...") for entry, at in value.items_at()]
    head, *further = entries or [None]
    scene.set("bus", NOTED)
    if head is not None:
        scene.set("bus", _of_its_kind(head.without("name"), faults))
        if "name" not in head:
            faults.add(head.value_at("name"), "missing; add it")
        scene.put("bus_name", head.get("name"), head.keys_at.get("name", head.mark), head.value_at("name"))
    names = _bus_names(written)
    for index, entry in enumerate(entries):
        if entry is not None and names and names[index] in names[:index]:
            faults.add(entry.value_at("name"), f"got {names[index]!r}, which is the name of another bus already")
    scene.set("further_buses", [_or_noted(entry and _further_bus(entry, faults)) for entry in further])


def _further_bus(entry: MarkedMapping, faults: Diagnostics) -> MarkedMapping:
    entry = _of_its_kind(entry, faults)
    if entry.bus_kind != "can":
        text = (
            "expected a CAN bus: a line comes first, since its clock leads the cycle, and there is one line in a rig: "
        )
        text += "the clock of a second would drift against it; put its drives on the first line"
        faults.add(entry.value_at("type"), f"got {entry.bus_kind!r}, {text}")
        return entry.only(FurtherBus.model_fields)
    common = [key for key in entry if key in CanBusParameters.model_fields and key not in FurtherBus.model_fields]
    for key in common:
        faults.add(entry.keys_at[key], "applies to all buses of the rig; give it in the first")
    return entry.without(*common)


def _bus_of_axis(section: MarkedMapping, names: tuple[str, ...], faults: Diagnostics) -> str:
    """Return the name of the bus of an axis; note a fault and return "" if there is no such bus."""
    named = section.get("bus")
    if named is None and len(names) == 1:
        return names[0]
    if isinstance(named, str) and named in names:
        return named
    known, at = ", ".join(dict.fromkeys(filter(None, names))), section.value_at("bus")
    if named is None:
        faults.add(at, f"missing, expected the name of the axis's bus: one of {known}")
    elif not known:
        faults.add(at, f"got {shown(named)}, but the scene's bus has no name; leave it out")
    else:
        faults.add(at, f"got {shown(named)}, expected one of: {known}{nearest(str(named), names)}")
    return ""


# --- axes ---------------------------------------------------------------------------------------------------------


def _axes(
    written: MarkedMapping, simulation: MarkedMapping | None, members: "_Joined", faults: Diagnostics, *, is_known: bool
) -> list[Any]:
    """Return the axes; `is_known` tells whether groups and mechanisms are valid, so that their members are known."""
    (groups, mechanisms), at, buses = members, written.value_at("axes"), _bus_names(written)
    entries = faults.list(written.get("axes"), at, "axes, each with name, node_id, eds, ...")
    if entries is not None and not entries:
        faults.add(at, "got an empty list, expected at least one axis")
    axes, joined = list[Any](), {name: group for group in groups for name in group.axes}
    for entry, entry_at in () if entries is None else entries.items_at():
        section = faults.mapping(entry, entry_at, "name, node_id, eds, ...")
        if section is None:
            axes.append(NOTED)
            continue
        name = str(section.get("name"))
        section.bus_kind = _kind_of_axis(section, written)
        axis = _axis(section, written, joined.get(name), faults, is_known=is_known)
        if buses:
            axis["bus"] = _bus_of_axis(section, buses, faults)
        if simulation is not None:
            from canhaptic.scene.far_side import put_far_side

            put_far_side(axis, name, simulation, any(name in moved.axes for moved in mechanisms), faults)
        axes.append(axis)
    _check_names(written, simulation, joined, faults)
    return axes


def _kind_of_axis(section: MarkedMapping, written: MarkedMapping) -> str:
    """Return the kind of the bus of an axis; "can" where there is no such bus."""
    kinds = _bus_kinds(written)
    named = section.get("bus", next(iter(kinds), "") if len(kinds) == 1 else "")
    kind = kinds.get(str(named), "can")
    return kind if kind in BUSES else "can"


def _axis(
    section: MarkedMapping, written: MarkedMapping, group: "Members | None", faults: Diagnostics, *, is_known: bool
) -> MarkedMapping:
    if section.get("drive") is None:
        section = section.without("drive")
    else:
        from canhaptic.scene.profiles import with_profile

        section = with_profile(section, faults)
    own = find_dictionary(section.without(*OWN_SECTIONS, "bus"), faults)
    unit = section.get("unit", AxisParameters.model_fields["unit"].default)
    axis = MarkedMapping(section.mark, unit if unit in get_args(Motion) else None)
    axis.set("parameters", own)
    if group is None:
        is_far = isinstance(far := written.get("far"), MarkedMapping) and far.get("axis") == section.get("name")
        environment = no_environment() if is_far else _environment(written, section, faults, is_needed=is_known)
        passivity = _own_over_shared(written, section, "passivity", "algorithm", faults, is_needed=is_known)
        axis.set("environment", environment)
        axis.set("passivity", _or_noted(passivity))
    else:
        passivity, name = _loop_in_group(section, group, faults), str(group.section.get("name"))
        membership = ComponentSpec("group", GroupMembership(group=name))
        axis.update(environment=membership, passivity=membership, group=name)
    axis.set("loop", MarkedMapping(section.mark) if passivity is None else passivity.only(LOOP_KEYS))
    axis.update(simulation=None)
    return axis


def no_environment() -> ComponentSpec:
    """Return the environment of an axis whose torques are requested: none."""
    return ComponentSpec("program", load(PROGRAM, "program", "environment")())


def _environment(shared: MarkedMapping, own: MarkedMapping, faults: Diagnostics, *, is_needed: bool) -> Any:
    """Return the section `environment` of an axis, or its list, which is a sum and is shared or replaced as a whole."""
    sections = [owner["environment"] for owner in (own, shared) if owner.get("environment") is not None]
    if sections and isinstance(sections[0], MarkedList):
        return sections[0]
    if len(sections) > 1 and isinstance(sections[1], MarkedList):
        shared = shared.without("environment")
    return _or_noted(_own_over_shared(shared, own, "environment", "type", faults, is_needed=is_needed))


def _own_over_shared(
    shared: MarkedMapping, own: MarkedMapping, name: str, selector: str, faults: Diagnostics, *, is_needed: bool
) -> MarkedMapping | None:
    """Return a section of an axis: its own keys over the shared ones, or its own alone if it names another type.

    None if there is no such section, with a fault if it is needed.
    """
    before, result = len(faults), None
    for owner in (shared, own):
        if (section := faults.section(owner, name, f"{selector} and its parameters")) is None:
            continue
        is_other = result is None or section.get(selector, result.get(selector)) != result.get(selector)
        if result is None or (is_other and section.was != ""):
            result = section
            continue
        was = (result.was or result.get(selector)) if is_other else result.was  # an override turns it into another
        result = section.over(result)
        result.was = was
    if result is None and is_needed and len(faults) == before:
        faults.add(shared.value_at(name), f"missing; give it here or in the axis, with {selector}")
    return result


def _loop_in_group(section: MarkedMapping, group: "Members", faults: Diagnostics) -> MarkedMapping | None:
    """Return the loop keys of an axis in a group: its own `passivity` over the group's."""
    renders = f"group {group.section.get('name')!r} renders on this axis;"
    if section.get("environment") is not None:
        faults.add(section.keys_at["environment"], f"{renders} leave it out")
    shared = group.section.get("passivity")
    loop = shared if isinstance(shared, MarkedMapping) else None
    if (own := faults.section(section, "passivity", ", ".join(LOOP_KEYS))) is None:
        return loop
    for key in own.keys() - set(LOOP_KEYS):
        faults.add(own.keys_at[key], f"{renders} give it in the group, and here only {', '.join(LOOP_KEYS)}")
    return own if loop is None else own.over(loop)


def _check_names(
    written: MarkedMapping, simulation: MarkedMapping | None, joined: Collection[str], faults: Diagnostics
) -> None:
    """Note names of unknown axes, and shared sections that are unused because every axis is in a group."""
    names = _axis_names(written)
    if names and joined and all(name in joined for name in names):
        for key in OWN_SECTIONS:
            if written.get(key) is not None:
                faults.add(written.keys_at[key], "every axis is in a group; give it in the group, or leave it out")
    own = None if simulation is None else faults.section(simulation, "axes", "an axis name to its parts")
    if own is not None:
        faults.unknown_keys(own, names)
        for parts in own.values():
            if isinstance(parts, MarkedMapping):
                faults.unknown_keys(parts, SIMULATION_PARTS)
