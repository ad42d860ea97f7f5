"""Groups of axes in a scene: `groups` is a list, each entry the axes that render one network with one account.

    groups:
      - name: stylus
        axes: [left, right]
        kinematics: {type: five_bar, ...}      # identity where it is left out
        network: {type: sphere, ...}
        passivity: {algorithm: guarded, moving_mass: 1e-3 kg*m^2, hand_force: 0}

What a scene says of the loop of all axes stands in `passivity` of the group; an axis may have its own beside it.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple, TypeVar

from canhaptic.control.mechanisms import KINEMATICS
from canhaptic.control.multi_axis import GROUP_ALGORITHMS, NETWORKS
from canhaptic.registry import nearest
from canhaptic.scene.diagnostics import Diagnostics, SourceLocation
from canhaptic.scene.document import MarkedList, MarkedMapping
from canhaptic.scene.models import AxisScene, ComponentSpec, GroupMembership, GroupScene
from canhaptic.scene.section import read_list, read_mapping, read_section, read_type, refuse_unknown_keys
from canhaptic.units import Motion, Parameters, shown

UnitT = TypeVar("UnitT", Motion, Motion | None)

GROUPS_KEY: Final = "groups"
KEYS: Final = ("name", "axes", "kinematics", "network", "passivity")
_MOVES_IN_METRES: Final = ("planar_2r", "five_bar")
"""Kinematics whose task space is in metres whatever the motors move in."""


class GroupEntry(NamedTuple):
    """A group as written, with the names of its axes."""

    section: MarkedMapping
    name: str
    axes: tuple[str, ...]


def read_group_entries(sections: MarkedMapping, faults: Diagnostics) -> tuple[GroupEntry, ...]:
    """Returns the groups of a scene with the axes that belong to each; faults in these are noted."""
    if sections.get(GROUPS_KEY) is None:
        return ()
    at = sections.value_at(GROUPS_KEY)
    entries = read_list(sections[GROUPS_KEY], at, faults, "groups, each with name, axes, network, ...")
    found: list[GroupEntry] = []
    for entry, entry_at in entries.items_at() if entries is not None else ():
        section = read_mapping(entry, entry_at, faults, ", ".join(KEYS))
        if section is not None:
            refuse_unknown_keys(section, KEYS, faults)
            name = section.get("name")
            if not isinstance(name, str) or not 0 < len(name) <= 40:
                faults.add(section.value_at("name"), f"got {shown(name)}, expected a name of 1 to 40 characters")
            found.append(GroupEntry(section, str(name), read_axis_names(section, faults)))
    return tuple(found)


def read_axis_names(section: MarkedMapping, faults: Diagnostics) -> tuple[str, ...]:
    """Returns the names under `axes` of a group or mechanism; none, with a fault, when they are no list of names."""
    names = read_list(section.get("axes"), section.value_at("axes"), faults, "names of axes")
    if names is None:
        return ()
    if not names or not all(isinstance(name, str) for name in names):
        faults.add(section.value_at("axes"), f"got {', '.join(map(shown, names)) or 'none'}, expected names of axes")
        return ()
    return tuple(names)


def check_axis_names(
    members: Sequence[tuple[MarkedMapping, tuple[str, ...]]], known: Sequence[str], what: str, faults: Diagnostics
) -> None:
    """Notes every axis that does not exist or is in two groups (or mechanisms)."""
    taken: set[str] = set()
    for section, names in members:
        value = section.get("axes")
        for index, name in enumerate(names):
            at: SourceLocation = value.values_at[index] if isinstance(value, MarkedList) else section.value_at("axes")
            if name not in known:
                faults.add(at, f"got {name!r}, expected the name of an axis: {', '.join(known)}{nearest(name, known)}")
            elif name in taken:
                faults.add(at, f"got {name!r}, which is in a {what} already; an axis belongs to one")
            taken.add(name)


def group_of(name: str, entries: Sequence[GroupEntry]) -> GroupEntry | None:
    """Returns the group of an axis, by its name; None when it renders for itself."""
    return next((entry for entry in entries if name in entry.axes), None)


def membership(entry: GroupEntry) -> ComponentSpec:
    """Returns what stands for environment and algorithm of its axes."""
    return ComponentSpec("group", GroupMembership(group=entry.name))


def task_unit(kinematics: str, motor_unit: UnitT) -> UnitT | Motion:
    """Returns in what task space is measured, by the name of the kinematics and the unit of the motor axes."""
    return "m" if kinematics in _MOVES_IN_METRES else motor_unit


def read_groups(
    entries: Sequence[GroupEntry], axes: Sequence[AxisScene], loop_keys: Sequence[str], faults: Diagnostics
) -> tuple[GroupScene, ...]:
    """Returns the groups whose sections are right; the faults of the others are noted.

    Args:
        entries: From `read_group_entries`.
        axes: Those of the scene that are right.
        loop_keys: Keys of `passivity` that belong to the loops of the axes.
        faults: Receives one line per fault.
    """
    _check_names(entries, axes, faults)
    units: dict[str, Motion] = {axis.parameters.name: axis.parameters.unit for axis in axes}
    groups = []
    for entry in entries:
        motions = {units[name] for name in entry.axes if name in units}
        group = _read_group(entry, next(iter(motions)) if len(motions) == 1 else None, loop_keys, faults)
        if group is not None:
            groups.append(group)
    return tuple(groups)


def _check_names(entries: Sequence[GroupEntry], axes: Sequence[AxisScene], faults: Diagnostics) -> None:
    taken = {axis.parameters.name for axis in axes}
    for entry in entries:
        if entry.name in taken:
            faults.add(
                entry.section.value_at("name"),
                f"got {entry.name!r}, which is the name of an axis or of another group; both have an account by name",
            )
        taken.add(entry.name)


def _read_group(
    entry: GroupEntry, motion: Motion | None, loop_keys: Sequence[str], faults: Diagnostics
) -> GroupScene | None:
    kinematics = _read_kinematics(entry, motion, faults)
    written = entry.section.get("kinematics")
    name = str(written.get("type")) if isinstance(written, MarkedMapping) else "identity"
    task = task_unit(name, motion) if name in KINEMATICS else None  # also where its other keys are at fault
    network = _read_part(entry.section, "network", "type", NETWORKS, "network", task, faults)
    passivity = _read_part(
        entry.section, "passivity", "algorithm", GROUP_ALGORITHMS, "group algorithm", motion, faults, loop_keys
    )
    if kinematics is None or network is None or passivity is None or not entry.axes:
        return None
    return GroupScene(entry.name, entry.axes, kinematics, network, passivity)


def _read_kinematics(entry: GroupEntry, motion: Motion | None, faults: Diagnostics) -> ComponentSpec | None:
    section = entry.section
    if section.get("kinematics") is None:
        section = section.copy()
        identity = MarkedMapping(section.value_at("kinematics"))
        identity.put("type", "identity", identity.mark, identity.mark)
        section.put("kinematics", identity, identity.mark, identity.mark)
    written = section["kinematics"]
    if isinstance(written, MarkedMapping) and written.get("type") == "identity" and "axes" not in written:
        counted = written.copy()
        counted.put("axes", max(1, len(entry.axes)), written.mark, written.mark)
        section = section.copy()
        section.put("kinematics", counted, written.mark, written.mark)
    task = task_unit(str(written.get("type")), motion) if isinstance(written, MarkedMapping) else motion
    return _read_part(section, "kinematics", "type", KINEMATICS, "kinematics", task, faults)


def _read_part(
    section: MarkedMapping,
    name: str,
    selector: str,
    table: Mapping[str, str],
    kind: str,
    motion: Motion | None,
    faults: Diagnostics,
    loop_keys: Sequence[str] = (),
) -> ComponentSpec | None:
    """Returns the parameters of one part of a group; None when it has faults, which are all noted."""
    if section.get(name) is None:
        faults.add(section.value_at(name), f"missing, expected {selector} (one of {', '.join(sorted(table))}) and more")
        return None
    part = read_mapping(section[name], section.value_at(name), faults, f"{selector} and its parameters")
    found = None if part is None else read_type(part, selector, kind, table, faults)
    if part is None or found is None:
        return None
    chosen, thing = found
    model: type[Parameters] = getattr(thing, "parameters_type", thing)
    own = part.without(selector, *(key for key in loop_keys if key not in model.model_fields))
    parameters: Any = read_section(model, own, faults, motion, also=(selector, *loop_keys))
    return None if parameters is None else ComponentSpec(chosen, parameters)
