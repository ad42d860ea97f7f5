"""Names of the nodes on the bus of a scene, to label recorded frames."""

from canhaptic.canopen.eds import read_dictionary
from canhaptic.drive.profile.quirks import quirks_of
from canhaptic.logs.decoder import NodeDescription
from canhaptic.scene.models import Scene


def describe_nodes(scene: Scene) -> list[NodeDescription]:
    """Name, dictionary, units and bus of every axis."""
    places = {bus.name: place for place, bus in enumerate(scene.buses)}
    return [
        NodeDescription(
            axis.node_id,
            axis.name,
            read_dictionary(axis.eds, axis.node_id),
            axis.counts_per_unit,
            axis.unit,
            axis.rated_torque and axis.rated_torque * quirks_of(axis.quirks).torque_scale,
            axis.direction,
            places[name],
        )
        for axis, name in ((axis.parameters, axis.bus) for axis in scene.axes)
    ]
