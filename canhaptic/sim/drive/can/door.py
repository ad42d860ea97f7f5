"""Simulated CAN drives of a scene on one connection to their bus."""

from collections.abc import Sequence
from typing import Any

import can

from canhaptic.sim.drive import SimulatedDriveParameters
from canhaptic.sim.drive.can.drive_node import DrivesOnBus, SimulatedDrive
from canhaptic.sim.drive.profile.servo import Motor


def drive_on(
    bus: can.BusABC, axis: Any, motor: Motor, drive: SimulatedDriveParameters, sample_time_ns: int
) -> SimulatedDrive:
    """Return the simulated drive of an axis, with its node ID and its dictionary."""
    return SimulatedDrive(bus, axis.node_id, axis.eds, motor, drive, sample_time_ns)


def bus_of(bus: can.BusABC, drives: Sequence[SimulatedDrive], *_: object) -> tuple[DrivesOnBus, Sequence[object]]:
    """Return the drives of a bus together, and each."""
    return DrivesOnBus(bus, drives), drives
