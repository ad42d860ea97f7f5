"""Conversion of the groups of axes and the simulated mechanisms of a scene file to the fields of `Scene`.

    groups:
      - name: stylus
        axes: [left, right]
        kinematics: {type: five_bar, ...}      # identity where it is left out
        network: {type: sphere, ...}
        passivity: {algorithm: guarded, moving_mass: 1e-3 kg*m^2, hand_force: 0}
    simulation:
      mechanisms:
        - {type: five_bar, axes: [left, right], base: 0.1 m, hand: {stiffness: 300 N/m, rest: [0 m, 0.25 m]}}

`passivity` of the group also has the loop keys of all its axes; an axis may replace them in its own `passivity`.
"""

from collections.abc import Sequence
from typing import NamedTuple

from canhaptic.axis_units import Motion
from canhaptic.control.mechanisms import KINEMATICS
from canhaptic.registry import nearest
from canhaptic.scene.document import NOTED, Diagnostics, MarkedList, MarkedMapping
from canhaptic.scene.models import task_unit
from canhaptic.units import shown


class Members(NamedTuple):
    """A group or a simulated mechanism as written, with the names of its axes."""

    section: MarkedMapping
    axes: tuple[str, ...]

    def as_group(self, units: dict[str, Motion]) -> MarkedMapping:
        """Return a group whose `passivity` is in the units of its axes, and whose network is in those of task space."""
        motions = {units[name] for name in self.axes if name in units}
        motor = next(iter(motions)) if len(motions) == 1 else None
        section = self.section.copy()
        section.put("axes", self.axes or NOTED, section.mark, section.value_at("axes"))
        kinematics = section.get("kinematics")
        if kinematics is None:
            kinematics = MarkedMapping(section.value_at("kinematics"))
            kinematics.set("type", "identity")
        name = kinematics.get("type") if isinstance(kinematics, MarkedMapping) else None
        task = task_unit(str(name), motor) if str(name) in KINEMATICS else None
        of_task = (("kinematics", kinematics, task), ("network", section.get("network"), task))
        for key, value, motion in (*of_task, ("passivity", section.get("passivity"), motor)):
            section.put(key, _moving(value, motion), section.keys_at.get(key, section.mark), section.value_at(key))
        if name == "identity" and "axes" not in kinematics:
            section["kinematics"].set("axes", max(1, len(self.axes)))
        return section

    def as_mechanism(self) -> MarkedMapping:
        """Return a simulated mechanism, whose hand moves in metres even if its motors are rotary."""
        section = MarkedMapping(self.section.mark)
        section.put("axes", self.axes or NOTED, section.mark, self.section.value_at("axes"))
        section.set("mechanism", self.section.without("axes", "hand"))
        if self.section.get("hand") is not None:
            section.put("hand", _moving(self.section["hand"], "m"), section.mark, self.section.value_at("hand"))
        return section


def members_of(owner: MarkedMapping | None, key: str, what: str, faults: Diagnostics) -> list[Members]:
    """Return the groups or mechanisms of a scene with their axes, and note their faults."""
    if owner is None or owner.get(key) is None:
        return []
    entries = faults.list(owner[key], owner.value_at(key), what)
    sections = [faults.mapping(e, at, "keys and values") for e, at in (entries.items_at() if entries else ())]
    return [Members(section, _names_of_axes(section, faults)) for section in sections if section is not None]


def _names_of_axes(section: MarkedMapping, faults: Diagnostics) -> tuple[str, ...]:
    names = faults.list(section.get("axes"), section.value_at("axes"), "names of axes")
    if names is not None and names and all(isinstance(name, str) for name in names):
        return tuple(names)
    if names is not None:
        faults.add(section.value_at("axes"), f"got {', '.join(map(shown, names)) or 'none'}, expected names of axes")
    return ()


def check_members(
    groups: Sequence[Members], mechanisms: Sequence[Members], names: Sequence[str], faults: Diagnostics
) -> None:
    """Note unknown axes, axes in two groups or two mechanisms, and duplicate names of groups.

    Args:
        groups: Groups from `members_of`.
        mechanisms: Mechanisms from `members_of`.
        names: Names of all axes.
        faults: Receives one line per fault.
    """
    for members, what in ((groups, "group"), (mechanisms, "mechanism")):
        used: set[str] = set()
        for section, axes in members if names else ():
            value = section.get("axes")
            for index, name in enumerate(axes):
                at = value.values_at[index] if isinstance(value, MarkedList) else section.value_at("axes")
                if name not in names:
                    known = f"{', '.join(names)}{nearest(name, names)}"
                    faults.add(at, f"got {name!r}, expected the name of an axis: {known}")
                elif name in used:
                    faults.add(at, f"got {name!r}, which is in a {what} already; an axis belongs to one")
                used.add(name)
    taken = set(names)
    for group in groups:
        own = group.section.get("name")
        if isinstance(own, str) and own in taken:
            text = f"got {own!r}, which is the name of an axis or of another group; both have an account by name"
            faults.add(group.section.value_at("name"), text)
        taken.add(str(own))


def _moving(value: object, motion: Motion | None) -> object:
    """Return a section with values in the units of a motion; what is no mapping is unchanged."""
    if not isinstance(value, MarkedMapping):
        return value
    section = value.copy()
    section.motion = motion
    return section
