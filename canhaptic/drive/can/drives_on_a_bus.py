"""Requirements of the drives of one bus: COB-IDs that no other master sends, distinct node IDs, time on the wire."""

from collections.abc import Sequence

from canhaptic.canopen import objects as od
from canhaptic.drive.axis_parameters import BusParameters
from canhaptic.drive.can.bus_budget import BusBudget, require_budget
from canhaptic.drive.can.link import Link
from canhaptic.drive.can.servo_drive import ServoDrive
from canhaptic.errors import InputError


def own_frames(link: Link, drives: Sequence[ServoDrive], bus: BusParameters) -> dict[int, str]:
    """Return the COB-IDs that this master alone sends on a bus, with their names.

    Args:
        link: The bus.
        drives: Drives of the rig; those on other buses are left out.
        bus: Bus with the node ID of the master.
    """
    names = {
        od.NMT_COB_ID: "NMT",
        od.SYNC_FRAME_COB_ID: "SYNC",
        od.HEARTBEAT_BASE + bus.master_id: "heartbeat of the master",
    }
    for drive in drives:
        if drive.link is link:
            names[drive.map.rpdo.cob_id] = f"RPDO of {drive.axis.name}"
            names[od.SDO_REQUEST_BASE + drive.axis.node_id] = f"SDO request to {drive.axis.name}"
            node = None if drive.axis.admittance is None else drive.axis.admittance.force.node
            if node is not None and node.node_id is not None:
                names[od.SDO_REQUEST_BASE + node.node_id] = f"SDO request to the force sensor of {drive.axis.name}"
    return names


def budget_of(drives: Sequence[ServoDrive], bus: BusParameters) -> BusBudget:
    """Return the budget of one bus, which has a bit rate of its own.

    Args:
        drives: Drives on this bus.
        bus: Bus with the node ID of the master; its rates count where the bus has no drive.

    Raises:
        InputError: Two nodes have one node ID.
        BusBudgetError: The frames of one cycle do not fit the bus.
    """
    names = {bus.master_id: "the master's heartbeat (bus.master_id)"}
    for drive in drives:
        node_id, name = drive.axis.node_id, drive.axis.name
        if node_id in names:
            raise InputError(f"{name}: node_id {node_id} is that of {names[node_id]} on the same bus; give it its own")
        names[node_id] = name
        sensor = drive.axis.admittance.force.node if drive.axis.admittance else None
        if sensor is not None and sensor.node_id is not None:
            if sensor.node_id in names:
                text = f"{name}: admittance.force.node.node_id {sensor.node_id} is that of {names[sensor.node_id]}"
                raise InputError(f"{text} on the same bus; give it its own")
            names[sensor.node_id] = f"the force sensor of {name}"
    return require_budget(drives[0].bus if drives else bus, [drive.map for drive in drives])
