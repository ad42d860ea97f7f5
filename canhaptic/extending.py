"""Tables for user-defined parts: environments, algorithms, effects, hands, kinematics and networks.

A part is a class with the methods of its protocol. Scenes can use it once a table names it::

    from canhaptic.extending import ENVIRONMENTS

    ENVIRONMENTS["centering_spring"] = "centering_spring:CenteringSpring"

Examples: docs/extending.md. A name is imported when it is first used, so that a part loads what it needs itself.
"""

import importlib
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
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

_PLACES: Final = {
    "canhaptic.control.balance": ("AT_REST",),
    "canhaptic.control.environments": ("ENVIRONMENTS",),
    "canhaptic.control.environments.environment": ("Environment",),
    "canhaptic.control.environments.own_environment": ("OwnEnvironment",),
    "canhaptic.control.mechanisms": ("KINEMATICS",),
    "canhaptic.control.mechanisms.kinematics": ("Kinematics", "Limit", "Pose"),
    "canhaptic.control.mechanisms.user_function": ("UserFunction",),
    "canhaptic.control.multi_axis": ("NETWORKS",),
    "canhaptic.control.multi_axis.group_controller": ("GroupBalance", "GroupController", "NetworkEnvironment"),
    "canhaptic.control.passivity": ("ALGORITHMS",),
    "canhaptic.control.passivity.controller": ("Controller",),
    "canhaptic.control.passivity.stepped": ("SteppedController",),
    "canhaptic.kernels": ("Kernel",),
    "canhaptic.sim.plant.assembly": ("NonlinearForce", "PlantModel"),
    "canhaptic.sim.plant.effects": ("EFFECTS", "Effect"),
    "canhaptic.sim.plant.own_hand": ("OwnHand",),
    "canhaptic.units": ("Parameters", "quantity"),
}
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


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(__all__)


def __getattr__(name: str) -> Any:
    """Import a public name on its first use (PEP 562)."""
    module = next((module for module, names in _PLACES.items() if name in names), None)
    if module is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(module), name)
