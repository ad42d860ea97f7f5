"""What the drive of an axis is sent and what it shows, by the causality of the axis.

An impedance display, `Impedance`, takes torques and shows torques; an admittance display, `MotionParameters`, takes
velocities and shows forces. Both have the attributes below, so that nothing else asks which of them an axis is.
"""

from collections.abc import Mapping
from typing import Final, Literal

from canhaptic.canopen import objects as od

RAMPS: Final = (od.PROFILE_ACCELERATION, od.PROFILE_DECELERATION, od.MAX_ACCELERATION, od.MAX_DECELERATION)
"""Ramps inside the drive, which alter a commanded velocity, in its velocity counts per second."""
ADMITTANCE: Final = "an admittance display"
"""`kind` of an axis whose drive takes velocities and shows forces."""


class _NoForce:
    place = node = frozen_after = None


class Impedance:
    """Torque out, motion in.

    Attributes:
        kind: What a dictionary must fit, for messages.
        mode_code: Value of 0x6060 for the drive's mode.
        target: Index of the object that carries the command.
        target_type: Its type.
        commands: What the command sets.
        by_hand: Keys of the scene that no dictionary supplies for this mode, with their meaning.
        ramps: Objects of ramps inside the drive -> what the start writes; None: the largest value.
        quick_stop: Objects of the drive's own quick stop -> what the start writes; None: the largest value.
        followed_acceleration: Acceleration that ramps inside the drive must follow [m/s^2 or rad/s^2]; None: any.
        velocity_counts: Counts of a velocity for 1 m/s or 1 rad/s; None: those of the position per second.
        ends: Positions beyond which no command leads.
        offsets: Indices of offsets added to the drive's target, or to a setpoint derived from it: 0 while a rig runs.
        owned: Indices of further objects that only the start may write: reactions, limits and ramps.
        torques: Indices and names of the torques that may be read back.
        energy_from: Torque that is read back -> what the energy follows from, where it is not exact.
        unseen: What no frame shows where no torque is read back; "" where none is needed.
        extremes: Commands that type and limits of the target must take [largest torques].
        limit_in_drive: Whether the drive keeps the limit of the torque where the start cannot write it.
        needs_limit: Whether a real drive is refused where neither does.
        holds: What the drive holds against a hand without a command of the master; "": nothing.
        reads: Torque that is read back in any case; "": the one that the axis asks for.
        force: The force sensor: `place`, (index, subindex) of an object of the drive, or `node`, one of its own.
    """

    kind = "cyclic torque"
    mode_code, target, target_type = od.CYCLIC_SYNC_TORQUE, od.TARGET_TORQUE, od.DataType.INTEGER16
    commands: Literal["torque", "motion"] = "torque"
    by_hand: tuple[tuple[str, str], ...] = ()
    ramps: Mapping[int, int | None] = {}
    quick_stop: Mapping[int, int | None] = {}
    followed_acceleration = velocity_counts = None
    ends: tuple[float, ...] = ()
    offsets: tuple[int, ...] = (od.TORQUE_OFFSET,)
    owned = frozenset[int]()
    torques = ((od.TORQUE_DEMAND, "torque demand"), (od.TORQUE_ACTUAL, "torque actual"))
    energy_from: Mapping[str, str] = {"actual": "the measured torque 0x6077", "none": "the commands, not exact"}
    unseen = "none: a lost or old torque, and one of another size or sign, is neither stopped nor in the account"
    extremes: tuple[int, ...] = (0, 1, -1)
    limit_in_drive = needs_limit = False
    holds = ""
    reads: Literal["", "none"] = ""
    force = _NoForce


IMPEDANCE: Final = Impedance()
