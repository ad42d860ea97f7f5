"""A spring to a point of task space, with a stiffness and a damping matrix."""

from typing import Annotated

from pydantic import model_validator

from canhaptic.control.port_hamiltonian.network import DampingMatrix, Network, QuadraticForm, symmetric_positive
from canhaptic.control.port_hamiltonian.shapes import Rendered, check_length, identity_rows, linear_geometry
from canhaptic.units import Coordinates, Parameters, quantity


class AnisotropicSpring(Parameters):
    """A spring and damper to a point: F = -K (p - centre) - D p'."""

    centre: Coordinates
    """Task coordinates [m or rad] where the spring is at rest."""
    stiffness: tuple[tuple[Annotated[float, quantity("N/m", "N*m/rad")], ...], ...]
    """K, symmetric and positive semidefinite [N/m or N*m/rad]."""
    damping: tuple[tuple[Annotated[float, quantity("N*s/m", "N*m*s/rad")], ...], ...] | None = None
    """D, symmetric and positive semidefinite [N*s/m or N*m*s/rad]."""

    @model_validator(mode="after")
    def _passive(self) -> "AnisotropicSpring":
        symmetric_positive(self.stiffness, "stiffness", "a negative energy could be extracted without limit")
        if self.damping is not None:
            symmetric_positive(self.damping, "damping", "a damper that gives energy is not rendered")
        return self

    def build(self, dimensions: int) -> Rendered:
        """Return the spring; see `NetworkEnvironment`."""
        check_length("anisotropic_spring", "centre", len(self.centre), dimensions)
        check_length("anisotropic_spring", "stiffness", len(self.stiffness), dimensions)
        dampers = []
        if self.damping is not None:
            check_length("anisotropic_spring", "damping", len(self.damping), dimensions)
            dampers = [DampingMatrix(matrix=self.damping, ports=tuple(range(dimensions)))]
        rows = identity_rows(dimensions)
        network = Network([QuadraticForm(matrix=self.stiffness)], dampers, gain=rows)
        return Rendered(network, linear_geometry(rows, self.centre))
