"""One axis from its frames: PDO fields -> position, torque and state, without code of the master.

Scaling and state decoding are implemented here a second time on purpose. A position is the unwrapped counter times
(direction / counts_per_unit), a torque is the field times (direction * torque of 1000 counts / 1000), each rounded
as by the master, so that the audit can require equal bits.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple

from canhaptic.canopen import objects as od
from canhaptic.canopen.attached_devices import ForceNode
from canhaptic.canopen.eds import read_dictionary
from canhaptic.errors import InputError
from canhaptic.logs.bus_reader import Frame
from canhaptic.logs.decoder import ENABLED, Access, PdoField, PdoMaps, SdoDecoder, state_text
from canhaptic.signals import Sample

_RATED_TORQUE_COUNTS: Final[Mapping[str, float]] = {"rated_torque_micro": 1e-6}
"""Quirk -> newton metres (or newtons) per count of 0x6076 instead of 1e-3."""
_TORQUE_COUNTS: Final[Mapping[str, float]] = {"torque_per_cent": 1e-2, "torque_per_ten_thousand": 1e-4}
"""Quirk -> fraction of the rated torque per count of 0x6074 and 0x6077 instead of 1e-3."""
_TORQUES: Final = (od.TORQUE_DEMAND, od.TORQUE_ACTUAL)
_DISAGREES: Final = 0.01
"""Largest accepted difference between the rated torques in frames and scene, as a fraction."""


OF_A_NODE: Final = -1
"""Object index of a force that a separate node sends."""


class DeclaredForce(NamedTuple):
    """Force sensor of an admittance display, as the scene declares it."""

    object_index: int
    per_count: float  # [N or N*m; of an impulse N*s or N*m*s]
    offset_counts: float
    node: ForceNode | None = None  # that sends it in a frame of its own
    impulse_time: float = 0.0  # sample time of a running impulse [s]; 0: the value is a force
    bits: int = 32


@dataclass(frozen=True, slots=True)
class DeclaredDrive:
    """The declarations of a drive that are needed to decode its frames."""

    name: str
    place: int  # node ID, or position on its EtherCAT line
    dictionary: str | Path  # EDS, DCF or ESI
    counts_per_unit: float
    direction: int  # 1 or -1
    transmission: float  # torque of the axis over torque of the motor
    rated_torque: float | None  # of the axis [N*m or N]; None: as the drive states it
    quirks: Sequence[str]
    demand_reported: str  # "before" or "after" the target torque of the same SYNC
    force: DeclaredForce | None = None  # of an admittance display, which has it instead of the torque


class HeardAxis:
    """One axis from the objects in its process data; which frames bring them is the affair of its bus."""

    def __init__(self, drive: DeclaredDrive) -> None:
        self._drive = drive
        self._rated_counts = 0
        self._per_torque_count = 0.0  # not known before the first sample
        self._counts = self._reported = 0
        self._fields: dict[int, Any] = {}  # integers, or the REAL32 of a force sensor
        self._impulse: int | None = None
        self._impulse_at = -1
        self._last = Sample(-1, 0.0, 0.0, 0, fresh=False)

    def hear(self, fields: list[PdoField] | str) -> None:
        """Store the values in process data; a text says why they cannot be decoded."""
        for field in [] if isinstance(fields, str) else fields:
            self._fields.setdefault(field.object_index, self._signed(field))

    def learn(self, access: Access) -> None:
        """Take the rated torque from an object that was read from the drive or written to it."""
        if access[:2] == (od.RATED_TORQUE, 0):
            self._rated_counts = int.from_bytes(access.value, "little")

    def _signed(self, field: PdoField) -> int:
        """Return the value of a field; the force is a signed integer in every object."""
        force = self._drive.force
        if force is not None and field.object_index == force.object_index and field.raw >> (field.bits - 1) == 1:
            return field.raw - (1 << field.bits)
        return field.raw

    @property
    def is_complete(self) -> bool:
        """Whether statusword, position and torque of the last SYNC have arrived."""
        force = self._drive.force
        efforts = _TORQUES if force is None else (force.object_index,)
        return {od.STATUSWORD, od.POSITION_ACTUAL} <= set(self._fields) and any(t in self._fields for t in efforts)

    @property
    def shows_demand(self) -> bool:
        """Whether the last torque is the drive's exact demand (0x6074); True for a force, whose error is declared."""
        return self._drive.force is not None or od.TORQUE_DEMAND in self._fields

    @property
    def is_enabled(self) -> bool:
        """Whether the last SYNC was answered in OPERATION ENABLED."""
        return self.is_complete and state_text(self._fields[od.STATUSWORD]) == ENABLED

    @property
    def has_left(self) -> bool:
        """Whether the last SYNC was answered in a state other than OPERATION ENABLED."""
        return self.is_complete and not self.is_enabled

    def forget(self) -> None:
        """Clear the received values; called at every SYNC."""
        self._fields.clear()

    def sample(self, sync_index: int, *, is_whole: bool = True) -> Sample:
        """Return the sample from the values received since the last SYNC.

        Args:
            sync_index: Index of that SYNC.
            is_whole: Whether every axis of the same group sent a sample.

        Raises:
            InputError: Frames and scene disagree on the rated torque, or neither states it.
        """
        reported = next((self._fields[torque] for torque in _TORQUES if torque in self._fields), 0)
        if self.is_complete and self._drive.demand_reported == "after":
            reported, self._reported = self._reported, reported
        if not (self.is_complete and is_whole):
            self._last = self._last._replace(sync_index=sync_index, fresh=False)
            return self._last
        counts, force = self._unwrapped(self._fields[od.POSITION_ACTUAL]), self._drive.force
        position = counts * (self._drive.direction / self._drive.counts_per_unit)
        if force is not None:
            torque = -self._force(force, self._fields[force.object_index], sync_index)
        else:
            self._per_torque_count = self._per_torque_count or self._torque_of_a_count()
            torque = reported * self._per_torque_count
        self._last = Sample(sync_index, position, torque, self._fields[od.STATUSWORD], fresh=True)
        return self._last

    def _force(self, force: DeclaredForce, counts: int, sync_index: int) -> float:
        """Return the force for a sensor value; for an impulse, the mean force since the last value [N or N*m]."""
        if not force.impulse_time:
            return (counts - force.offset_counts) * force.per_count
        before, self._impulse, half = self._impulse, counts, 1 << (force.bits - 1)
        change = 0 if before is None else (counts - before + half) % (2 * half) - half
        periods, self._impulse_at = sync_index - self._impulse_at, sync_index
        return change * force.per_count / (periods * force.impulse_time)

    def _unwrapped(self, counts: int) -> int:
        """Unwrapped position counter [counts]; the counter itself is an INTEGER32."""
        self._counts += (counts - self._counts + (1 << 31)) % (1 << 32) - (1 << 31)
        return self._counts

    def _torque_of_a_count(self) -> float:
        drive = self._drive
        rated = drive.rated_torque
        if self._rated_counts:
            stated = self._rated_counts * _of(_RATED_TORQUE_COUNTS, drive.quirks) * drive.transmission
            if rated is not None and abs(rated - stated) > _DISAGREES * stated:
                raise InputError(
                    f"{drive.name}: the frames state a rated torque (0x6076) of {stated:g} and the scene {rated:g}; "
                    "use the scene of these frames"
                )
            rated = stated
        if rated is None:
            raise InputError(
                f"{drive.name}: neither the frames nor the scene state the rated torque; record the bring-up too, or "
                "set rated_torque of the axis"
            )
        of_1000_counts = rated * round(1000.0 * _of(_TORQUE_COUNTS, drive.quirks), 9)
        return drive.direction * of_1000_counts / 1000.0


class ListenedAxis(HeardAxis):
    """One axis on a CAN bus, from its frames.

    Raises:
        DictionaryError: The dictionary of the drive cannot be read.
    """

    def __init__(self, drive: DeclaredDrive) -> None:
        super().__init__(drive)
        self._sdo = SdoDecoder()
        self._maps = PdoMaps(drive.place, read_dictionary(drive.dictionary, drive.place))
        self._tpdos = self._maps.tpdos()
        self._node = drive.force.node if drive.force else None

    def take(self, frame: Frame) -> None:
        """Store the values in a frame of the bus; frames of other nodes are ignored."""
        if frame.can_id - self._drive.place in (od.SDO_REQUEST_BASE, od.SDO_RESPONSE_BASE):
            is_request = frame.can_id - self._drive.place == od.SDO_REQUEST_BASE
            _, access = self._sdo.sdo(frame.data, is_request=is_request)
            if access is not None:
                self.learn(access)
                if self._maps.learn(access):
                    self._tpdos = self._maps.tpdos()
        elif self._node is not None and frame.can_id == self._node.frame_id:
            if len(frame.data) == self._node.frame_length:
                self._fields.setdefault(OF_A_NODE, self._node.value_in(frame.data))
        elif frame.can_id in self._tpdos:
            self.hear(self._maps.fields(self._tpdos[frame.can_id], frame.data))


def _of(table: Mapping[str, float], quirks: Sequence[str]) -> float:
    return next((table[name] for name in quirks if name in table), 1e-3)
