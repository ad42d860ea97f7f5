"""Simulated EtherCAT drives of a scene on one cable."""

import random
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

from canhaptic.canopen.objects import Dictionary
from canhaptic.sim.drive import SimulatedDriveParameters
from canhaptic.sim.drive.ethercat.cable import Cable, CableEffects
from canhaptic.sim.drive.ethercat.drive_node import ClockParameters, EthercatDrive
from canhaptic.sim.drive.profile.servo import Motor

_LONGEST: Final = 1_000_000_000_000  # [ns] for which a drive may have been powered before


class DriveOnCable(NamedTuple):
    """One drive to be made."""

    position: int
    dictionary: Dictionary
    motor: Motor
    parameters: SimulatedDriveParameters


def drive_on(_: object, axis: Any, motor: Motor, drive: SimulatedDriveParameters, *_more: object) -> DriveOnCable:
    """Return what the simulated drive of an axis is made of, at its position and with its dictionary."""
    return DriveOnCable(axis.position, axis.dictionary(), motor, drive)


def cable_of(
    _: object, drives: Sequence[DriveOnCable], sample_time_ns: int, effects: CableEffects | None, seed: int
) -> tuple[Cable, list[EthercatDrive]]:
    """Return a cable, and its drives in the order in which they were given.

    Args:
        _: Not needed: a cable is a line of its own.
        drives: The drives, at positions 0 to n - 1 in any order.
        sample_time_ns: Sample time of the cycle [ns].
        effects: Faults of frames and clocks; None: none, and every clock is the host's.
        seed: Seed of clocks and faults.
    """
    dice = random.Random(seed)
    drift = 0.0 if effects is None else effects.drift
    clocks = []
    for n in range(len(drives)):
        own = drift if not n else dice.uniform(-abs(drift), abs(drift))
        clocks.append(ClockParameters(round(own * 1e9), dice.randrange(_LONGEST)))
    made = [EthercatDrive(of.dictionary, of.motor, of.parameters, sample_time_ns, clocks[of.position]) for of in drives]
    ordered = sorted(zip(drives, made, strict=True), key=lambda pair: pair[0].position)
    return Cable([drive for _, drive in ordered], sample_time_ns, effects, seed), made
