"""The names for parts of your own: environments, algorithms, effects, hands, kinematics and networks.

A part is a class with the methods of its protocol. It is known to scenes once a table names it::

    from canhaptic.extending import ENVIRONMENTS

    ENVIRONMENTS["centering_spring"] = "centering_spring:CenteringSpring"

Examples: docs/extending.md.
"""

from canhaptic.control.balance import AT_REST
from canhaptic.control.environments import ENVIRONMENTS
from canhaptic.control.environments.environment import Environment
from canhaptic.control.environments.own_environment import OwnEnvironment
from canhaptic.control.mechanisms import KINEMATICS
from canhaptic.control.mechanisms.kinematics import Kinematics, Limit, Pose
from canhaptic.control.mechanisms.user_function import UserFunction
from canhaptic.control.multi_axis import NETWORKS
from canhaptic.control.multi_axis.group_controller import GroupBalance, GroupController, NetworkEnvironment
from canhaptic.control.passivity import ALGORITHMS
from canhaptic.control.passivity.controller import Controller
from canhaptic.control.passivity.stepped import SteppedController
from canhaptic.kernels import Kernel
from canhaptic.sim.plant.assembly import NonlinearForce, PlantModel
from canhaptic.sim.plant.effects import EFFECTS, Effect
from canhaptic.sim.plant.own_hand import OwnHand
from canhaptic.units import Parameters, quantity

__all__ = [
    "ALGORITHMS",
    "AT_REST",
    "EFFECTS",
    "ENVIRONMENTS",
    "KINEMATICS",
    "NETWORKS",
    "Controller",
    "Effect",
    "Environment",
    "GroupBalance",
    "GroupController",
    "Kernel",
    "Kinematics",
    "Limit",
    "NetworkEnvironment",
    "NonlinearForce",
    "OwnEnvironment",
    "OwnHand",
    "Parameters",
    "PlantModel",
    "Pose",
    "SteppedController",
    "UserFunction",
    "quantity",
]
