"""Buses and nodes of a scene to which recorded frames belong.

A frame names its bus by the second word of its line, or by the bus number in a binary log.
"""

from canhaptic.canopen.eds import read_dictionary
from canhaptic.drive.profile.quirks import quirks_of
from canhaptic.errors import LogFormatError
from canhaptic.logs.bus_reader import Frame
from canhaptic.logs.decoder import NodeDescription
from canhaptic.scene.models import Scene


class Channels:
    """Index of the buses of a scene by their names in a bus log.

    The log has the name, the channel (`can0`) or the number of the bus, counted from 0. If the scene has one bus, every
    frame belongs to it.
    """

    def __init__(self, scene: Scene) -> None:
        self._source = scene.source
        self._is_one = not scene.further_buses
        self._places: dict[str, int] = {}
        for place, (name, parameters) in enumerate(scene.buses):
            for word in (name, str(parameters.channel), str(place)):
                self._places.setdefault(word, place)

    def place_of(self, frame: Frame) -> int:
        """Return the index of the frame's bus in the scene.

        Raises:
            LogFormatError: The scene has no such bus.
        """
        if self._is_one:
            return 0
        place = self._places.get(frame.channel)
        if place is None:
            text = f"frame {frame.number} is on bus {frame.channel!r}, which is not a name"
            raise LogFormatError(f"{text}, channel or number of a bus of {self._source} ({', '.join(self._places)})")
        return place


def describe_nodes(scene: Scene) -> list[NodeDescription]:
    """Return the name, dictionary, units and bus of the node of every axis."""
    places = {bus.name: place for place, bus in enumerate(scene.buses)}
    nodes = []
    for axis, bus in ((axis.parameters, axis.bus) for axis in scene.axes):
        torque = axis.rated_torque and axis.rated_torque * quirks_of(axis.quirks).torque_scale
        scales = axis.counts_per_unit, axis.unit, torque, axis.direction
        dictionary = read_dictionary(axis.eds, axis.node_id)
        nodes.append(NodeDescription(axis.node_id, axis.name, dictionary, *scales, places[bus]))
    return nodes
