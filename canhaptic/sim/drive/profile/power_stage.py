"""The power stage of a simulated drive, by its mode of operation."""

from typing import Any

from canhaptic.sim.drive import SimulatedDriveParameters
from canhaptic.sim.drive.profile.object_store import ObjectStore
from canhaptic.sim.drive.profile.servo import Servo


def servo_of(store: ObjectStore, motor: Any, parameters: SimulatedDriveParameters) -> Servo:
    """Return the power stage of a drive: one that follows torques, or one that follows velocities."""
    if parameters.display is None:
        return Servo(store, motor, parameters)
    from canhaptic.sim.drive.profile.motion_servo import MotionServo

    return MotionServo(store, motor, parameters)
