"""What the drive of an axis is sent and what it shows, by the causality of the axis.

An impedance display, `Impedance`, takes torques and shows torques; an admittance display, `AdmittanceParameters`, takes
velocities and shows forces. Both have the attributes below, so that nothing else asks which of them an axis is.
"""

from collections.abc import Mapping
from typing import Final, Literal

from canhaptic.canopen import objects as od

ADMITTANCE: Final = "an admittance display"
"""`kind` of an axis whose drive takes velocities and shows forces."""


class _NoForce:
    place = node = None


class Impedance:
    """Torque out, motion in.

    Attributes:
        kind: What a dictionary must fit, for messages.
        mode_code: Value of 0x6060 for the drive's mode.
        target: Index of the object that carries the command.
        target_type: Its type.
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
