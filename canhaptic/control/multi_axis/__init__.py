"""Groups of axes that render one port-Hamiltonian network: tables of what a scene can name, and a controller's builder.

Every scene imports these tables; the other modules of this package are imported only if a scene has a group.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

from canhaptic.registry import load_algorithm

if TYPE_CHECKING:
    from canhaptic.control.mechanisms.kinematics import Kinematics
    from canhaptic.control.multi_axis.group_controller import GroupController, NetworkEnvironment
    from canhaptic.control.passivity import LoopProperties
    from canhaptic.units import Parameters

_HERE: Final = "canhaptic.control.multi_axis"
_RIVALS: Final = "canhaptic.lab.rivals"
_SHAPES: Final = "canhaptic.control.port_hamiltonian.shapes"

NETWORKS: Final[dict[str, str]] = {
    "plane": f"{_SHAPES}.plane:Plane",
    "box": f"{_SHAPES}.box:Box",
    "sphere": f"{_SHAPES}.sphere:Sphere",
    "tube": f"{_SHAPES}.tube:Tube",
    "anisotropic_spring": f"{_SHAPES}.anisotropic_spring:AnisotropicSpring",
    "moving_wall": f"{_SHAPES}.moving_wall:MovingWall",
    "virtual_mass": f"{_SHAPES}.virtual_mass:VirtualMass",
    "mass_on_spring": f"{_SHAPES}.virtual_mass:MassOnSpring",
    "coupled_handles": f"{_SHAPES}.coupled_handles:CoupledHandles",
    "guided_path": f"{_SHAPES}.guided_path:GuidedPath",
    "general": f"{_SHAPES}.general:General",
}
"""Networks: name in a scene -> "module:Class"; the class models the section's parameters (`NetworkEnvironment`)."""

GROUP_ALGORITHMS: Final[dict[str, str]] = {
    "guarded": f"{_HERE}.guarded_group:GuardedGroup",
    "unprotected": f"{_HERE}.unprotected_group:UnprotectedGroup",
    "step_scaling": f"{_RIVALS}.scaled_group:ScaledGroup",
}
"""Algorithms: name in a scene -> "module:Class". Every class has `parameters_type`, as in `passivity.ALGORITHMS`."""


def build_group_controller(
    environment: "NetworkEnvironment",
    kinematics: "Kinematics",
    algorithm_name: str,
    parameters: "Parameters | None",
    loops: "Sequence[LoopProperties]",
) -> "GroupController":
    """Return a controller of a group of axes, at rest and without stored energy.

    Args:
        environment: Environment to render; a class of `NETWORKS`, or anything with `build`.
        kinematics: Map between the motor axes and task space.
        algorithm_name: A name of `GROUP_ALGORITHMS`.
        parameters: Parameters of the algorithm, of its `parameters_type`; None: its defaults.
        loops: Properties of the loop of each motor axis; sample time and delay are the same for all.

    Raises:
        ParameterError: The name is unknown, the parameters are of another algorithm, dimensions do not fit together,
            loops differ in sample time or delay, or a value that the algorithm needs is missing.
    """
    algorithm, chosen = load_algorithm(GROUP_ALGORITHMS, algorithm_name, "group algorithm", parameters)
    controller: GroupController = algorithm(environment, kinematics, chosen, tuple(loops))
    return controller
