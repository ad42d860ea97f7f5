"""Admittance displays: force in, velocity out. The tables of what is rendered and of the algorithms that render it."""

from typing import Any, Final

from canhaptic.control.admittance.properties import DisplayProperties
from canhaptic.control.passivity.controller import Controller
from canhaptic.registry import load
from canhaptic.units import Parameters

_HERE: Final = "canhaptic.control.admittance"

DISPLAY_ENVIRONMENTS: Final[dict[str, str]] = {
    "virtual_mass": f"{_HERE}.display_mass:DisplayMass",
    "cup_and_ball": f"{_HERE}.cup_and_ball:CupAndBall",
}
"""Name in a scene -> "module:Class"; the class is the parameter model and the environment in one."""

DISPLAY_ALGORITHMS: Final[dict[str, str]] = {
    "unprotected": f"{_HERE}.unprotected_display:UnprotectedDisplay",
    "internal_dissipation": f"{_HERE}.dissipating_display:DissipatingDisplay",
    "passivity_observer": f"{_HERE}.observed_display:ObservedDisplay",
    "energy_tank": f"{_HERE}.tank_display:TankDisplay",
    "ultimately_passive": f"{_HERE}.ultimately_passive_display:UltimatelyPassiveDisplay",
    "guarded": f"{_HERE}.guarded_display:GuardedDisplay",
}
"""Name in a scene -> "module:Class". Every class has `parameters_type` and takes (environment, parameters, loop)."""


def build_display_controller(
    environment: Any, algorithm_name: str, parameters: Parameters | None, properties: DisplayProperties
) -> Controller:
    """Returns the controller of one admittance display, at rest.

    Args:
        environment: What is rendered.
        algorithm_name: A name of `DISPLAY_ALGORITHMS`.
        parameters: The algorithm's own `parameters_type`; None for its defaults.
        properties: What is declared of loop, sensor and limits.

    Raises:
        ParameterError: Unknown name, or a value that the algorithm cannot do without.
    """
    algorithm = load(DISPLAY_ALGORITHMS, algorithm_name, "admittance algorithm")
    controller: Controller = algorithm(environment, parameters or algorithm.parameters_type(), properties)
    return controller
