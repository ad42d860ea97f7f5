"""Mechanisms in the simulation of a scene: `simulation.mechanisms` is a list of what several drives move together.

simulation:
  mechanisms:
    - type: five_bar
      axes: [left, right]       # its motors, in the mechanism's order
      base: 0.1 m
      hand: {stiffness: 300 N/m, damping: 3 N*s/m, rest: [0 m, 0.25 m]}
"""

from collections.abc import Sequence
from typing import Any, Final, NamedTuple

from canhaptic.scene.diagnostics import Diagnostics
from canhaptic.scene.document import MarkedMapping
from canhaptic.scene.groups import read_axis_names
from canhaptic.scene.models import AxisScene, ComponentSpec, MechanismScene
from canhaptic.scene.section import read_list, read_mapping, read_section, read_type

MECHANISMS_KEY: Final = "mechanisms"
_OWN_KEYS: Final = ("type", "axes", "hand")


class MechanismEntry(NamedTuple):
    """A mechanism as written, with the names of its axes."""

    section: MarkedMapping
    axes: tuple[str, ...]


def read_mechanism_entries(sections: MarkedMapping, faults: Diagnostics) -> tuple[MechanismEntry, ...]:
    """Returns the mechanisms of a scene with the axes that move each; faults in these are noted."""
    simulation = sections.get("simulation")
    if not isinstance(simulation, MarkedMapping) or simulation.get(MECHANISMS_KEY) is None:
        return ()
    at = simulation.value_at(MECHANISMS_KEY)
    entries = read_list(simulation[MECHANISMS_KEY], at, faults, "mechanisms, each with type and axes")
    found = []
    for entry, entry_at in entries.items_at() if entries is not None else ():
        section = read_mapping(entry, entry_at, faults, "type, axes and parameters")
        if section is not None:
            found.append(MechanismEntry(section, read_axis_names(section, faults)))
    return tuple(found)


def moves_mechanism(name: str, entries: Sequence[MechanismEntry]) -> bool:
    """Returns whether an axis, by its name, is a motor of a mechanism."""
    return any(name in entry.axes for entry in entries)


def read_mechanisms(
    entries: Sequence[MechanismEntry], axes: Sequence[AxisScene], faults: Diagnostics
) -> tuple[MechanismScene, ...]:
    """Returns the mechanisms whose sections are right; the faults of the others are noted."""
    found = (_read_mechanism(entry, axes, faults) for entry in entries)
    return tuple(mechanism for mechanism in found if mechanism is not None)


def _read_mechanism(entry: MechanismEntry, axes: Sequence[AxisScene], faults: Diagnostics) -> MechanismScene | None:
    from canhaptic.sim.plant.mechanism import MECHANISMS
    from canhaptic.sim.plant.mechanism.task_hand import TaskHand

    section, before = entry.section, len(faults)
    found = read_type(section, "type", "mechanism", MECHANISMS, faults)
    hand = None
    if section.get("hand") is not None:
        written = read_mapping(section["hand"], section.value_at("hand"), faults, "stiffness, damping, rest, ...")
        hand = None if written is None else read_section(TaskHand, written, faults, "m")
    if found is None:
        return None
    name, model = found
    parameters: Any = read_section(model, section.without(*_OWN_KEYS), faults, model.motion, also=_OWN_KEYS)
    if len(entry.axes) != model.axes:
        faults.add(section.value_at("axes"), f"got {len(entry.axes)} axes, expected the {model.axes} of a {name}")
    members = [axis for axis in axes if axis.parameters.name in entry.axes]
    for axis in members:
        if axis.parameters.unit != model.motion:
            faults.add(
                section.value_at("axes"),
                f"got {axis.parameters.name!r} with unit {axis.parameters.unit}, expected unit: {model.motion}, in "
                f"which the motors of a {name} move",
            )
    if len({axis.bus for axis in members}) > 1:
        faults.add(section.value_at("axes"), "got axes of several buses, expected one bus for what is simulated as one")
    if len(faults) > before or parameters is None:
        return None
    return MechanismScene(entry.axes, ComponentSpec(name, parameters), hand)
