"""The parts of one axis made from its scene: plant, controller, simulated drive."""

from typing import cast

from canhaptic.haptics.environments.protocol import Environment
from canhaptic.haptics.passivity import build_controller
from canhaptic.haptics.passivity.protocol import Controller
from canhaptic.scene.models import AxisScene, AxisSimulation
from canhaptic.sim.plant import Plant


def build_plant(simulation: AxisSimulation, sample_time_ns: int) -> Plant:
    """Returns the motor and user of one axis, at rest until the first SYNC with the drive enabled."""
    effects = [effect.parameters for effect in simulation.effects]
    return Plant(simulation.plant, simulation.user, effects, sample_time_ns, simulation.seed)


def build_axis_controller(axis: AxisScene) -> Controller:
    """Returns the passivity algorithm of one axis around its environment."""
    environment = cast(Environment, axis.environment.parameters)  # every class of ENVIRONMENTS is one
    return build_controller(environment, axis.passivity.name, axis.passivity.parameters, axis.loop)
