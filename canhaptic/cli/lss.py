"""`canhaptic commission CONFIG --node-id NODE`: set the node ID of one node on a bus (LSS), asking before each step."""

import argparse

from canhaptic.cli.commission import dialogue_of
from canhaptic.cli.options import scene_of
from canhaptic.drive.can.door import open_bus
from canhaptic.drive.can.link import Link
from canhaptic.drive.can.lss import give_node_id
from canhaptic.drive.clock import WallClock
from canhaptic.errors import InputError
from canhaptic.scene.buses import can_bus

_LARGEST_NODE_ID = 127


def execute(arguments: argparse.Namespace) -> int:
    """Set the node ID; return 0 if the node booted with it, 1 if it did not or the person declined."""
    scene = scene_of(arguments)
    nodes = [node for node in (arguments.node, arguments.node_id) if node is not None]
    if len(nodes) != 1:
        raise InputError("--node-id: got no number or two, expected the node ID to give, 1 to 127")
    [arguments.node] = nodes
    if not 1 <= arguments.node <= _LARGEST_NODE_ID:
        raise InputError(f"NODE: got {arguments.node}, expected 1 to {_LARGEST_NODE_ID}")
    buses = [bus.parameters for bus in scene.buses if arguments.bus in (None, bus.name)]
    if len(buses) != 1:
        raise InputError(f"--bus: got {arguments.bus}, expected one of: {', '.join(bus.name for bus in scene.buses)}")
    dialogue = dialogue_of(scene, yes=arguments.yes)
    found = can_bus(buses[0])
    with open_bus(found, found.channel) as bus:
        link = Link(bus, WallClock())
        given = give_node_id(link, arguments.node, arguments.identity, dialogue.confirm, dialogue.tell)
    return 0 if given else 1
