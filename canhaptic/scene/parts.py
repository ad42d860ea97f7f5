"""The parts of one axis made from its scene: plant, controller, simulated drive, servo drive."""

from typing import cast

import can

from canhaptic.dictionary import read_dictionary
from canhaptic.drive.link import Link
from canhaptic.drive.parameters import BusParameters
from canhaptic.drive.servo_drive import ServoDrive
from canhaptic.haptics.environments.protocol import Environment
from canhaptic.haptics.passivity import build_controller
from canhaptic.haptics.passivity.protocol import Controller
from canhaptic.scene.models import AxisScene, AxisSimulation
from canhaptic.sim.drive_node import SimulatedDrive
from canhaptic.sim.effects import Effect
from canhaptic.sim.plant import Plant


def build_plant(simulation: AxisSimulation, sample_time_ns: int) -> Plant:
    """Returns the motor and user of one axis, at rest until the first SYNC with the drive enabled."""
    effects = [cast(Effect, effect.parameters) for effect in simulation.effects]  # every class of EFFECTS is one
    return Plant(
        simulation.plant, simulation.user, effects, sample_time_ns, simulation.seed, simulation.accuracy,
        simulation.compiled,
    )  # fmt: skip


def build_axis_controller(axis: AxisScene) -> Controller:
    """Returns the passivity algorithm of one axis around its environment."""
    environment = cast(Environment, axis.environment.parameters)  # every class of ENVIRONMENTS is one
    return build_controller(environment, axis.passivity.name, axis.passivity.parameters, axis.loop)


def build_servo_drive(axis: AxisScene, link: Link, bus: BusParameters) -> ServoDrive:
    """Returns the master's picture of the drive of one axis."""
    dictionary = read_dictionary(axis.parameters.eds, axis.parameters.node_id)
    return ServoDrive(link, axis.parameters, dictionary, bus)


def build_simulated_drive(
    axis: AxisScene, simulation: AxisSimulation, bus: can.BusABC, sample_time_ns: int
) -> SimulatedDrive:
    """Returns the drive of one axis with motor and user behind it; it reads its dictionary itself."""
    plant = build_plant(simulation, sample_time_ns)
    node_id, eds = axis.parameters.node_id, axis.parameters.eds
    return SimulatedDrive(bus, node_id, eds, plant, simulation.drive, sample_time_ns)
