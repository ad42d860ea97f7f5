"""Passivity algorithms of one axis, each in its own file, and the table of their names."""

from typing import Final

from canhaptic.control.environments.environment import Environment, plain
from canhaptic.control.passivity.controller import Controller, LoopProperties
from canhaptic.registry import load_algorithm
from canhaptic.units import Parameters

_HERE: Final = "canhaptic.control.passivity"
_RIVALS: Final = "canhaptic.lab.rivals"

LITERATURE: Final[dict[str, str]] = {
    "adaptive_reference": f"{_RIVALS}.adaptive_reference:AdaptiveReference",
    "windowed_observer": f"{_RIVALS}.windowed_observer:WindowedObserver",
    "bounded_observer": f"{_RIVALS}.bounded_observer:BoundedObserver",
    "force_gradient": f"{_RIVALS}.force_gradient:ForceGradient",
    "force_augmentation": f"{_RIVALS}.force_augmentation:ForceAugmentation",
    "energy_tank": f"{_RIVALS}.energy_tank:EnergyTank",
    "ultimate_passivity": f"{_RIVALS}.ultimate_passivity:UltimatePassivity",
}
"""Algorithms of other authors, for comparison, listed as in `ALGORITHMS`; none has a proven bound on its torque."""

ALGORITHMS: Final[dict[str, str]] = {
    "unprotected": f"{_HERE}.unprotected:Unprotected",
    "a_priori_dissipation": f"{_RIVALS}.a_priori_dissipation:APrioriDissipation",
    "internal_dissipation": f"{_HERE}.internal_dissipation:InternalDissipation",
    "passivity_observer": f"{_HERE}.passivity_observer:PassivityObserver",
    "energy_bounding": f"{_RIVALS}.energy_bounding:EnergyBounding",
    "guarded": f"{_HERE}.guarded:Guarded",
    **LITERATURE,
}
"""Name in a scene -> "module:Class". Every class has `parameters_type` and takes (environment, parameters, loop)."""


def build_controller(
    environment: Environment, algorithm_name: str, parameters: Parameters | None, loop: LoopProperties,
    hold_dither: float | None = None,
) -> Controller:  # fmt: skip
    """Return a controller of one axis, at rest and without stored energy.

    Args:
        environment: Environment to render.
        algorithm_name: A name of `ALGORITHMS`.
        parameters: The algorithm's own `parameters_type`; None for its defaults.
        loop: Sample time, delay and other properties of the loop.
        hold_dither: Amplitude of the random torques that `guarded` adds to test in which hold its torques act
                [N or N*m]; None: no test.

    Raises:
        ParameterError: Unknown name, parameters of another algorithm, or a missing value that the algorithm needs.
    """
    algorithm, chosen = load_algorithm(ALGORITHMS, algorithm_name, "passivity algorithm", parameters)
    if hold_dither is not None and algorithm_name == "guarded":  # the scene refuses others
        from canhaptic.control.passivity.hold_dither import DitheredGuarded

        return DitheredGuarded(plain(environment), chosen, loop, hold_dither)
    controller: Controller = algorithm(plain(environment), chosen, loop)
    return controller
