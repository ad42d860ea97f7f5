"""Checks of groups and mechanisms: they are made once, and say what they cannot do."""

from canhaptic.errors import ParameterError
from canhaptic.scene.diagnostics import Diagnostics
from canhaptic.scene.document import MarkedMapping
from canhaptic.scene.groups import GROUPS_KEY
from canhaptic.scene.mechanisms import MECHANISMS_KEY
from canhaptic.scene.models import AxisScene, Scene
from canhaptic.scene.parts import build_group, build_mechanism


def check_groups(scene: Scene, sections: MarkedMapping, faults: Diagnostics) -> None:
    """Notes what network, kinematics and passivity of a group cannot do together, and axes apart in time."""
    for group, section in zip(scene.groups, sections.get(GROUPS_KEY) or (), strict=True):
        try:
            build_group(scene, group)
        except ParameterError as error:
            faults.add(section.mark, str(error))


def check_mechanisms(scene: Scene, sections: MarkedMapping, faults: Diagnostics) -> None:
    """Notes what a simulated mechanism refuses, such as a singular pose to begin with."""
    if not scene.mechanisms:
        return
    for of, section in zip(scene.mechanisms, sections["simulation"][MECHANISMS_KEY], strict=True):
        try:
            build_mechanism(of, scene.bus.sample_time_ns)
        except ParameterError as error:
            faults.add(section.mark, str(error))


def passivity_section(axis: AxisScene, entry: MarkedMapping, sections: MarkedMapping, scene: Scene) -> MarkedMapping:
    """Returns where a scene speaks of the loop of an axis: the axis's own section, the shared one, or the group's."""
    owners = [entry, sections]
    if axis.group:
        place = [group.name for group in scene.groups].index(axis.group)
        owners = [entry, sections[GROUPS_KEY][place]]
    owner = next(owner for owner in owners if isinstance(owner.get("passivity"), MarkedMapping))
    section: MarkedMapping = owner["passivity"]
    return section
