"""Parameters of an axis that is an admittance display: velocity commands, force sensor, limits.

`ForceChannel` turns the counts of the sensor into a force, and rejects a force beyond its range or a frozen sensor.
"""

import re
from collections.abc import Mapping
from math import inf
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Final, Literal

from pydantic import field_validator, model_validator

from canhaptic.canopen import objects as od
from canhaptic.drive.profile.causality import ADMITTANCE, RAMPS
from canhaptic.drive.profile.drive_objects import DRIVE_OBJECTS
from canhaptic.units import OnDemand, Parameters, quantity

if TYPE_CHECKING:
    from canhaptic.canopen.attached_devices import ForceNode
else:  # a sensor that is no node of its own loads nothing of it
    ForceNode = Any

_OBJECT: Final = re.compile(r"0x([0-9a-fA-F]{4})(?:\.([0-9a-fA-F]{1,2}))?")

Mode = Literal["velocity", "position"]
"""Cyclic synchronous velocity (mode 9, 0x60FF) or position (mode 8, 0x607A)."""


class ForceParameters(Parameters):
    """The force sensor of an admittance display: in the TPDO of its drive, or with its own node."""

    object: str | None = None
    """Object of the drive that shows the force, `0x3160.1` (index.subindex, hexadecimal); INTEGER16 or INTEGER32."""
    node: Annotated[ForceNode, OnDemand("canhaptic.canopen.attached_devices:ForceNode")] | None = None
    """Frame of a sensor that answers the SYNC by itself; in place of `object`."""
    per_count: Annotated[float, quantity("N", "N*m", ge=-1e6, le=1e6)]
    """Force of the hand towards +q per count (an impulse: N*s per count); negative for a sensor that counts down."""
    offset_counts: Annotated[float, quantity("count", ge=-2e9, le=2e9)] = 0.0
    """Counts that the sensor shows at zero force."""
    range: Annotated[float, quantity("N", "N*m", gt=0.0, le=1e6)]
    """Largest force that the sensor can show; beyond it the rig stops."""
    sampling: Literal["point", "mean", "impulse"] = "point"
    """Quantity of one value: the force at the SYNC, its mean since the last SYNC, or its running integral (wraps)."""
    latency: Annotated[int, quantity("count", ge=0, le=16)] = 0
    """Delay of a value in whole SYNCs."""
    filter: Annotated[float, quantity("Hz", ge=0.0, le=1e6)] = 0.0
    """Corner of a first-order filter before the sample; 0: none."""
    slew: Annotated[float, quantity("N/s", "N*m/s", gt=0.0, le=1e9)]
    """Largest slew of the force, an over-estimate."""
    corner: Annotated[float, quantity("Hz", ge=0.0, le=1e6)] = 0.0
    """Highest frequency in the force, by hand, handle and sensor, an over-estimate; 0: not known. Below it the slew
    itself changes by at most 2 pi corner slew per second, which leaves less in doubt between two point samples."""
    error: Annotated[float, quantity("N", "N*m", ge=0.0, le=1e6)]
    """Largest error of one value, an over-estimate: offset, drift, noise, quantisation."""
    frozen_after: Annotated[int, quantity("count", ge=2, le=100_000)] | None = None
    """SYNCs with the same count, beyond `error`, after which the sensor counts as frozen and the rig stops."""

    @field_validator("object")
    @classmethod
    def _names_an_object(cls, text: str | None) -> str | None:
        if text is not None and not _OBJECT.fullmatch(text):
            raise ValueError(f"got {text!r}, expected an object such as 0x3160.1 (index.subindex, hexadecimal)")
        return text

    @field_validator("per_count")
    @classmethod
    def _is_not_zero(cls, value: float) -> float:
        if value == 0.0:
            raise ValueError("got 0, expected the force of one count")
        return value

    @model_validator(mode="after")
    def _has_one_source(self) -> "ForceParameters":
        if (self.object is None) == (self.node is None):
            raise ValueError("expected either object (a sensor in the drive) or node (a sensor with its own node)")
        if self.node is not None and (self.node.tare or self.node.real) and self.sampling == "impulse":
            key, why = ("tare", "has no zero to take") if self.node.tare else ("real", "wraps, as integers do")
            raise ValueError(f"node.{key}: got true with sampling: impulse, expected a force: a sum {why}")
        return self

    @property
    def bits(self) -> int:
        """Number of bits of the sensor's value, modulo which it wraps."""
        return 32 if self.node is None else self.node.bits

    @property
    def place(self) -> tuple[int, int] | None:
        """(index, subindex) of the object; None for a sensor with its own node."""
        match = _OBJECT.fullmatch(self.object or "")
        return None if match is None else (int(match[1], 16), int(match[2] or "0", 16))


_BY_HAND: Final = (
    ("speed_limit, admittance.acceleration_limit", "largest speed and acceleration that may be commanded"),
    ("admittance.position_low, position_high", "lowest and highest position to which a command may lead"),
    ("admittance.velocity_counts", "counts of 0x60FF for 1 m/s or 1 rad/s; left out: counts of 0x6064 per second"),
    ("admittance.handle_acceleration", "largest acceleration of the handle by drive and hand: an over-estimate"),
    ("admittance.force.per_count, range, error, slew", "scale and limits of the sensor; canhaptic commission measures"),
    ("admittance.force.frozen_after", "SYNCs with one count after which the sensor counts as frozen"),
)


class MotionParameters(Parameters):
    """Makes an axis an admittance display: force in, velocity out."""

    mode: Mode = "velocity"
    """velocity: mode 9, the velocity loop of the drive follows 0x60FF. position: mode 8, 0x607A, interpolated."""
    velocity_counts: Annotated[float, quantity("count*s/m", "count*s/rad", gt=0.0, le=1e15)] | None = None
    """Counts of 0x60FF for 1 m/s or 1 rad/s of the axis; None: `counts_per_unit`, as for counts per second."""
    acceleration_limit: Annotated[float, quantity("m/s^2", "rad/s^2", gt=0.0, le=1e6)] | None = None
    """Largest rise of the commanded speed per second; a fall to zero is never slowed."""
    handle_acceleration: Annotated[float, quantity("m/s^2", "rad/s^2", gt=0.0, le=1e6)]
    """Largest acceleration of the handle by the torque of the drive and the force of the hand; an over-estimate."""
    position_low: Annotated[float, quantity("m", "rad", ge=-1e6, le=1e6)] | None = None
    """Lowest position to which a command may lead."""
    position_high: Annotated[float, quantity("m", "rad", ge=-1e6, le=1e6)] | None = None
    """Highest position to which a command may lead."""
    limit_in_drive: bool = False
    """Whether `torque_limit` was set in the drive with the vendor's tool: needed where 0x6072 cannot be written."""
    stop_time: Annotated[float, quantity("s", gt=0.0, le=10.0)] = 0.5
    """Time that a quick stop may take."""
    force: ForceParameters
    """The force sensor."""

    @model_validator(mode="after")
    def _positions_are_in_order(self) -> "MotionParameters":
        low, high = self.position_low, self.position_high
        if low is not None and high is not None and low >= high:
            raise ValueError(f"position_low is {low}, expected less than position_high ({high})")
        return self

    kind: ClassVar[str] = ADMITTANCE
    target_type: ClassVar[od.DataType] = od.DataType.INTEGER32
    commands: ClassVar[Literal["torque", "motion"]] = "motion"
    by_hand: ClassVar[tuple[tuple[str, str], ...]] = _BY_HAND
    ramps: ClassVar[Mapping[int, int | None]] = dict.fromkeys(RAMPS)  # they would change a command that was certified
    quick_stop: ClassVar[Mapping[int, int | None]] = {
        od.QUICK_STOP_DECELERATION: None,
        od.QUICK_STOP_OPTION: 2,  # along its ramp, then disabled
    }
    offsets: ClassVar[tuple[int, ...]] = (od.POSITION_OFFSET, od.VELOCITY_OFFSET, od.TORQUE_OFFSET)
    owned: ClassVar[frozenset[int]] = frozenset(index for index, _ in DRIVE_OBJECTS)
    energy_from: ClassVar[Mapping[str, str]] = {}
    torques: ClassVar[tuple[tuple[int, str], ...]] = ()
    unseen: ClassVar[str] = ""
    extremes: ClassVar[tuple[int, ...]] = ()  # the limits of a velocity are in its own counts
    needs_limit: ClassVar[bool] = True
    holds: ClassVar[str] = "zero velocity with its full torque"
    reads: ClassVar[Literal["", "none"]] = "none"

    @property
    def followed_acceleration(self) -> float | None:
        """Acceleration that ramps inside the drive must follow; None: any."""
        return self.acceleration_limit if self.mode == "velocity" else None

    @property
    def ends(self) -> tuple[float, ...]:
        """Positions beyond which no command leads."""
        return tuple(end for end in (self.position_low, self.position_high) if end is not None)

    def command_quantum(self, counts_per_unit: float, sample_time: float) -> float:
        """Return the velocity of one count of the command [m/s or rad/s]."""
        if self.mode == "position":
            return 1.0 / (counts_per_unit * sample_time)
        return 1.0 / (self.velocity_counts or counts_per_unit)

    @property
    def mode_code(self) -> int:
        """Value of 0x6060 (mode of operation) for these velocity commands."""
        return od.CYCLIC_SYNC_VELOCITY if self.mode == "velocity" else od.CYCLIC_SYNC_POSITION

    @property
    def target(self) -> int:
        """Index of the object that carries the command."""
        return od.TARGET_VELOCITY if self.mode == "velocity" else od.TARGET_POSITION


class ForceChannel:
    """Turns the counts of a force sensor into the force of the hand.

    Args:
        force: Parameters of the sensor.
        sample_time: Sample time [s].

    Attributes:
        force: Last force [N or N*m].
        same: Consecutive SYNCs with the same count and a force within the error of the sensor.
        is_wrong: Whether the force is beyond the range, or the sensor has shown one count for too long.
    """

    def __init__(self, force: ForceParameters, sample_time: float) -> None:
        self._time = sample_time if force.sampling == "impulse" else 0.0
        self._half = 1 << (force.bits - 1)
        self._per_count, self._offset = force.per_count, force.offset_counts
        self._range, self._error = force.range, force.error
        self._frozen_after = force.frozen_after or inf
        self.reset()

    def reset(self) -> None:
        """Forget the received counts; the force is 0 until the next."""
        self.force, self.same, self.is_wrong = 0.0, 0, False
        self._counts: int | None = None

    def of(self, counts: int) -> float:
        """Force for a number of counts [N or N*m]; not for a running impulse."""
        return (counts - self._offset) * self._per_count

    def take(self, counts: int, periods: int = 1) -> float:
        """Return the force of the hand towards +q [N or N*m]; for a running impulse, its mean over the holds between.

        Args:
            counts: Counts in the process data.
            periods: Sample times since the last value.
        """
        if self._time:
            return self._take_impulse(counts, periods)
        force = (counts - self._offset) * self._per_count
        self.force, limit, error = force, self._range, self._error
        self.same = self.same + 1 if counts == self._counts and not -error <= force <= error else 0
        self._counts = counts
        self.is_wrong = not -limit <= force <= limit or self.same >= self._frozen_after
        return force

    def _take_impulse(self, counts: int, periods: int) -> float:
        before, half = self._counts, self._half
        change = 0 if before is None else (counts - before + half) % (2 * half) - half
        self._counts = counts
        self.force = change * self._per_count / (periods * self._time)
        self.is_wrong = self.is_beyond_range
        return self.force

    @property
    def is_beyond_range(self) -> bool:
        """Whether the force exceeds the range of the sensor."""
        return not -self._range <= self.force <= self._range
