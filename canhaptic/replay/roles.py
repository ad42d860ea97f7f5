"""Sender of each frame of a bus, from a scene: a recording need not contain it, and a sniffer cannot know it."""

import struct
from typing import Final, NamedTuple

from canhaptic.canopen import objects as od
from canhaptic.canopen.eds import read_dictionary
from canhaptic.drive.can.pdo_codec import codec
from canhaptic.drive.can.pdo_map import choose_map
from canhaptic.drive.profile.power_states import is_enabled
from canhaptic.scene.models import Scene

_ENABLE_BITS: Final = int(od.Controlword.ENABLE_OPERATION)

Address = tuple[int, int]
"""Place of the bus among those of the scene, COB-ID."""


class Roles(NamedTuple):
    """COB-IDs of a scene by their role in a replay."""

    master: frozenset[Address]  # sent by the master
    sdo_requests: frozenset[Address]
    heartbeat: int  # the master's
    rpdo: Address  # of the first axis
    controlword: struct.Struct  # in that RPDO
    statuswords: dict[Address, struct.Struct]  # TPDO with the statusword -> where it is in it; one per axis

    def asks_to_leave(self, data: bytes) -> bool:
        """Whether an RPDO of the first axis revokes OPERATION ENABLED.

        0x0F keeps it and 0x00 revokes it; decided by the majority of bits, so that one flipped bit moves no end.
        """
        (controlword,) = self.controlword.unpack(data) if len(data) == self.controlword.size else (_ENABLE_BITS,)
        return (int(controlword) & _ENABLE_BITS).bit_count() < _ENABLE_BITS.bit_count() // 2

    def shows_enabled(self, address: Address, data: bytes) -> bool:
        """Return whether a TPDO with a statusword shows OPERATION ENABLED."""
        image = self.statuswords[address]
        return len(data) == image.size and is_enabled(int(image.unpack(data)[0]))


def roles_of(scene: Scene) -> Roles:
    """Return the roles of the COB-IDs of a scene.

    Raises:
        DictionaryError: A dictionary cannot be read or has no fitting PDOs.
    """
    places = {bus.name: place for place, bus in enumerate(scene.buses)}
    axes = [axis.parameters for axis in scene.axes]
    on = [places[axis.bus] for axis in scene.axes]
    maps = [choose_map(read_dictionary(axis.eds, axis.node_id), axis) for axis in axes]
    sdo_requests = frozenset((bus, od.SDO_REQUEST_BASE + axis.node_id) for bus, axis in zip(on, axes, strict=True))
    rpdos = [(bus, plan.rpdo.cob_id) for bus, plan in zip(on, maps, strict=True)]
    heartbeat = od.HEARTBEAT_BASE + scene.bus.master_id
    on_every_bus = {(bus, cob_id) for bus in on for cob_id in (od.NMT_COB_ID, od.SYNC_FRAME_COB_ID, heartbeat)}
    return Roles(
        sdo_requests | frozenset(rpdos) | on_every_bus,
        sdo_requests,
        heartbeat,
        rpdos[0],
        codec(maps[0].rpdo.entries, [od.CONTROLWORD]),
        {
            (bus, tpdo.cob_id): codec(tpdo.entries, [od.STATUSWORD])
            for bus, plan in zip(on, maps, strict=True)
            for tpdo in plan.tpdos
            if any(entry.index == od.STATUSWORD for entry in tpdo.entries)
        },
    )
