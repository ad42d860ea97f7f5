"""Admittance displays, with force in and velocity out: the tables of their environments and algorithms.

Every scene reads these tables; the other modules of this package are loaded only if a scene has an admittance display.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

from canhaptic.errors import ParameterError
from canhaptic.registry import load_algorithm

if TYPE_CHECKING:
    from canhaptic.control.admittance.port import AdmittanceProperties
    from canhaptic.control.admittance.velocity_loop import GuardedAdmittanceParameters
    from canhaptic.control.mechanisms.kinematics import Kinematics
    from canhaptic.control.multi_axis.group_controller import GroupController
    from canhaptic.control.passivity import Controller
    from canhaptic.units import Parameters

_HERE: Final = "canhaptic.control.admittance"
_RIVALS: Final = "canhaptic.lab.rivals"

DISPLAY_ENVIRONMENTS: Final[dict[str, str]] = {
    "virtual_mass": f"{_HERE}.admittance_environment:AdmittanceMass",
    "cup_and_ball": f"{_HERE}.cup_and_ball:CupAndBall",
}
"""Environments of one display: name in a scene -> "module:Class", which is parameter model and environment in one."""

DISPLAY_ALGORITHMS: Final[dict[str, str]] = {
    "unprotected": f"{_HERE}.unprotected_admittance:UnprotectedAdmittance",
    "internal_dissipation": f"{_HERE}.dissipating_admittance:DissipatingAdmittance",
    "passivity_observer": f"{_HERE}.observed_admittance:ObservedAdmittance",
    "energy_tank": f"{_RIVALS}.tank_admittance:TankAdmittance",
    "ultimately_passive": f"{_RIVALS}.ultimately_passive_admittance:UltimatelyPassiveAdmittance",
    "guarded": f"{_HERE}.guarded_admittance:GuardedAdmittance",
}
"""Algorithms of one display or several: name in a scene -> "module:Class".

Every class has `parameters_type`, gives the environment its form by `rendered`, and takes (environment, parameters,
properties of each display).
"""


DISPLAY_NETWORKS: Final[dict[str, str]] = {
    "virtual_mass": f"{_HERE}.group_environment:GroupMass",
    "guided_path": f"{_HERE}.group_environment:PathMass",
    "cup_and_ball": f"{_HERE}.group_environment:GroupCupAndBall",
}
"""Environments that several displays render together, in the form of `DISPLAY_ENVIRONMENTS`."""


def build_display_controller(
    environment: Any, algorithm_name: str, parameters: "Parameters | None", properties: "AdmittanceProperties"
) -> "Controller":
    """Return the controller of one admittance display, at rest.

    Args:
        environment: Environment to render.
        algorithm_name: A name of `DISPLAY_ALGORITHMS`.
        parameters: Instance of the algorithm's `parameters_type`; None for its defaults.
        properties: Declared properties of loop, sensor and limits.

    Raises:
        ParameterError: Unknown name, parameters of another algorithm, or a missing value that the algorithm needs.
    """
    from canhaptic.control.admittance.admittance_controller import OneDisplay, OnOneAxis

    algorithm, chosen = load_algorithm(DISPLAY_ALGORITHMS, algorithm_name, "admittance algorithm", parameters)
    return OneDisplay(algorithm(OnOneAxis(algorithm.rendered(environment)), chosen, [properties]))


def build_display_group(
    environment: Any, algorithm_name: str, parameters: "Parameters | None",
    properties: "Sequence[AdmittanceProperties]", kinematics: "Kinematics | None" = None,
) -> "GroupController":  # fmt: skip
    """Return the controller of several admittance displays with a common energy account, at rest.

    Args:
        environment: Environment to render, a class of `DISPLAY_NETWORKS`.
        algorithm_name: A name of `DISPLAY_ALGORITHMS`.
        parameters: Instance of the algorithm's `parameters_type`; None for its defaults.
        properties: Declared properties of each axis.
        kinematics: Map between the axes and task space; None if the axes are the task coordinates.

    Raises:
        ParameterError: Unknown name, or parts that do not fit together.
    """
    from canhaptic.control.admittance.group_environment import TaskEnvironment
    from canhaptic.control.admittance.velocity_loop import GuardedAdmittanceParameters
    from canhaptic.control.mechanisms.kinematics import Identity

    kind = "algorithm of several admittance displays"
    algorithm, chosen = load_algorithm(DISPLAY_ALGORITHMS, algorithm_name, kind, parameters)
    environment = algorithm.rendered(environment)
    if kinematics is not None and not isinstance(kinematics, Identity):
        lag = 0.0
        if isinstance(chosen, GuardedAdmittanceParameters):
            _refuse_impedance(chosen)
            lag = chosen.drive_mass / (chosen.loop_gain * (1.0 - chosen.spread))
        ahead = (properties[0].delay + properties[0].latency) * properties[0].sample_time + lag
        environment = TaskEnvironment(environment, kinematics, ahead)
    controller: GroupController = algorithm(environment, chosen, properties)
    return controller


def _refuse_impedance(parameters: "GuardedAdmittanceParameters") -> None:
    """Refuse a hand of declared impedance at a mechanism: on the motor axes it changes with the pose."""
    if parameters.hand_stiffness:
        raise ParameterError(
            f"guarded: hand_stiffness: got {parameters.hand_stiffness:g}, expected 0 with kinematics: on the motor "
            "axes the impedance of a hand changes with the pose, and the proof is for one that does not; leave it out"
        )
