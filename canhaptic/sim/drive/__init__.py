"""The simulated drive: an independent CiA 402 node with SDO server, PDOs and watchdogs.

Here are the parameters that its object dictionary does not give; no missing value is ever assumed.
"""

import re
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal

from pydantic import Field, field_validator

from canhaptic.units import OnDemand, Parameters, quantity

if TYPE_CHECKING:
    from canhaptic.canopen.attached_devices import Brake, ForceNode
else:  # a sensor that is no node of its own, and an axis without a brake, load nothing of it
    Brake = Any
    ForceNode = Any

_PLACE: Final = re.compile(r"(?:0x)?([0-9a-f]{1,4})(?:(?:\.|sub)(?:0x)?([0-9a-f]{1,2}))?", re.IGNORECASE)


def parse_place(key: str | int) -> tuple[int, int]:
    """Return (index, subindex) of `0x6502`, `"0x1018.1"` or `"1018sub1"`; texts are hexadecimal.

    Raises:
        ValueError: The key names no object, or may name two: `4096` is 0x1000 as a number and 0x4096 as hexadecimal.
    """
    if isinstance(key, int):
        place = (key, 0)
    elif key.strip().isdecimal():
        number = int(key)
        also = f" or 0x{number:04x}" if number <= 0xFFFF else ""
        raise ValueError(f"{key!r} may be hexadecimal or decimal; write 0x{key.strip()}{also}")
    elif match := _PLACE.fullmatch(key.strip()):
        place = (int(match[1], 16), int(match[2] or "0", 16))
    else:
        raise ValueError(f"{key!r} names no object, expected a key like 0x6502 or 0x1018.1")
    if not 0 < place[0] <= 0xFFFF:
        raise ValueError(f"index {key!r} does not exist, expected 0x0001..0xFFFF")
    return place


class MotionScaling(Parameters):
    """Scales of a simulated drive that serves an admittance display."""

    force_object: str | None = None
    """Object that holds the force; None: a separate sensor node sends it."""
    force_node: Annotated[ForceNode, OnDemand("canhaptic.canopen.attached_devices:ForceNode")] | None = None
    """Sensor node that sends the force; None: an object of the drive holds it."""
    force_per_count: Annotated[float, quantity("N", "N*m")]
    """Force of the hand towards +q per count."""
    force_offset_counts: Annotated[float, quantity("count")] = 0.0
    """Counts at zero force."""
    velocity_counts: Annotated[float, quantity("count*s/m", "count*s/rad", gt=0.0)] | None = None
    """Counts of 0x60FF for 1 m/s or 1 rad/s; None: position counts per second."""
    ramp: Annotated[float, quantity("m/s^2", "rad/s^2", gt=0.0, le=1e6)] | None = None
    """Acceleration limit of the drive that no object shows, in addition to 0x6083 and 0x60C5; None: none."""


class TorqueFault(Parameters):
    """A fault of the power stage: from a time on, another torque acts than the one demanded."""

    at: Annotated[float, quantity("s", ge=0.0, le=1e6)]
    """Time from the first SYNC with the drive enabled."""
    kind: Literal["twice", "minus", "more", "stuck"]
    """Torque that acts: twice the demand, its negative, `torque` more, or that of the time `at` for good."""
    torque: Annotated[float, quantity("N", "N*m", ge=-1e6, le=1e6)] = 0.0
    """Torque that is added by `more`."""
    shown: Literal["actual", "both"] = "actual"
    """Objects that show it: 0x6077 alone, or 0x6074 too."""


class SimulatedDriveParameters(Parameters):
    """Parameters of a simulated drive.

    Attributes:
        counts_per_unit: Encoder counts of 0x6064 per m or rad, at the axis.
        rated_torque: Torque of 1000 per mille [N or N*m]; from 0x6076 of the dictionary when not given.
        rated_torque_resolution: Torque of one count of 0x6076 [N or N*m]; 1e-3 by the standard, 1e-6 on some drives.
        torque_limit: Limit of the drive in addition to 0x6072 [N or N*m]; none when not given.
        objects: Object -> value, for objects listed without a value, or to replace a value. Keys are
            `0x6502` or `"0x1018.1"` (index.subindex, hexadecimal).
        encoder: Rounding of the position to counts: to the nearest, or down to the last line passed.
        torque_read_back: Whether 0x6074 and 0x6077 sent at a SYNC are those of the hold that ended, or of the next.
        acts_at_once: Whether a synchronous RPDO acts on arrival, although the drive confirms its transmission type.
        syncs_late: Number of SYNCs by which a synchronous RPDO acts later than at the SYNC that follows it.
        torque_resolution: Fraction of the rated torque per count of 0x6071, 0x6072, 0x6074 and 0x6077.
        torque_lag: Time constant of the drive's filter from the motor's torque to 0x6077; 0: no filter.
        torque_ripple: Variation of 0x6077 with position, as a fraction of the torque (error of a current sensor).
        torque_ripple_pitch: Period of that ripple [rad or m].
        direction: -1 for a drive mounted the other way round: position and torque both count against the axis.
        reversed: Wrong wiring: only the encoder, or only the motor, counts against the axis.
        rated_torque_stated: False for a drive whose 0x6076 is 0 until the master writes it.
        absent: Objects that the dictionary lists and the drive lacks; keys as in `objects`, or a whole index.
        refused: Object -> value that the drive rejects although the dictionary allows it.
        enable_delay: Time from the command to enable until OPERATION ENABLED (brake, commutation).
        follow_delay: Time in OPERATION ENABLED until the torque follows; bit 12 of the statusword is 0 until then.
        mode_when_enabled: Whether 0x6061 shows the mode in OPERATION ENABLED only, and 0 in other states.
        sdo_size_indicated: False for a drive that leaves out the length of expedited answers.
        sync_losses_to_fault: Communication cycle periods (0x1006) without SYNC until the drive faults.
        fault: Faults of the torque; from its time on each takes the place of the one before.
        brake: A brake that holds the motor; by default the axis's.
        display: Scales of an admittance display; by default the axis's.
    """

    counts_per_unit: Annotated[float, quantity("count/m", "count/rad", gt=0.0, le=1e12)]
    rated_torque: Annotated[float, quantity("N", "N*m", gt=0.0, le=1e6)] | None = None
    rated_torque_resolution: Annotated[float, quantity("N", "N*m", ge=1e-12, le=1e6)] = 1e-3
    torque_limit: Annotated[float, quantity("N", "N*m", gt=0.0, le=1e6)] | None = None
    objects: dict[str | int, int | float | str] = Field(default_factory=dict)
    encoder: Literal["round", "floor"] = "round"
    torque_read_back: Literal["before_update", "after_update"] = "before_update"
    acts_at_once: bool = False
    syncs_late: Annotated[int, quantity("count", ge=0, le=4)] = 0
    torque_resolution: Annotated[float, quantity("1", ge=1e-6, le=1.0)] = 1e-3
    torque_lag: Annotated[float, quantity("s", ge=0.0, le=1.0)] = 0.0
    torque_ripple: Annotated[float, quantity("1", ge=0.0, lt=1.0)] = 0.0
    torque_ripple_pitch: Annotated[float, quantity("m", "rad", gt=0.0, le=1e3)] = 1.0
    direction: Literal[1, -1] = 1
    reversed: Literal["none", "encoder", "torque"] = "none"
    rated_torque_stated: bool = True
    absent: tuple[str | int, ...] = ()
    refused: dict[str | int, int] = Field(default_factory=dict)
    enable_delay: Annotated[float, quantity("s", ge=0.0, le=60.0)] = 0.0
    follow_delay: Annotated[float, quantity("s", ge=0.0, le=60.0)] = 0.0
    mode_when_enabled: bool = False
    sdo_size_indicated: bool = True
    sync_losses_to_fault: Annotated[int, quantity("1", ge=1, le=1000)] = 3
    fault: tuple[TorqueFault, ...] = ()
    display: MotionScaling | None = None
    brake: Annotated[Brake, OnDemand("canhaptic.canopen.attached_devices:Brake")] | None = None

    @field_validator("objects", "absent", "refused")
    @classmethod
    def _check_places(cls, places: Any) -> Any:
        for key in places:
            parse_place(key)
        return places

    @property
    def position_sign(self) -> int:
        """Sign of a count (0x6064) along the axis."""
        return -self.direction if self.reversed == "encoder" else self.direction

    def absent_places(self) -> frozenset[tuple[int, int | None]]:
        """Return `absent` as (index, subindex); the subindex is None for a whole object."""
        return frozenset((index, subindex or None) for index, subindex in map(parse_place, self.absent))

    def refused_values(self) -> dict[tuple[int, int], int]:
        """Return the values of `refused` by (index, subindex)."""
        return {parse_place(key): value for key, value in self.refused.items()}

    def object_values(self) -> dict[tuple[int, int], int | float | str]:
        """Return the values of `objects` by (index, subindex)."""
        return {parse_place(key): value for key, value in self.objects.items()}
