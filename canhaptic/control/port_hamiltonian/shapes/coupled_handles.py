"""Two handles joined by a spring and a damper over the bus: telemanipulation, with motion scaled between them."""

from typing import Annotated

from canhaptic.control.port_hamiltonian.network import Damper, Network, Spring
from canhaptic.control.port_hamiltonian.shapes import Rendered, linear_geometry
from canhaptic.errors import ParameterError
from canhaptic.units import Coordinates, Parameters, quantity


class CoupledHandles(Parameters):
    """Two coupled handles, each half of the task coordinates p1, p2; the spring's extension is p1 - scale p2 - offset.

    Forces scale as motion does, F2 = scale F1: any other ratio would generate power.
    """

    stiffness: Annotated[float, quantity("N/m", "N*m/rad", gt=0.0, le=1e9)]
    """Stiffness of the spring between the handles."""
    hardening: Annotated[float, quantity("N/m^3", "N*m/rad^3", ge=0.0, le=1e15)] = 0.0
    """Cubic coefficient k3 of that spring."""
    damping: Annotated[float, quantity("N*s/m", "N*m*s/rad", ge=0.0, le=1e7)] = 0.0
    """Damping coefficient between the handles."""
    scale: Annotated[float, quantity("1", gt=0.0, le=1e3)] = 1.0
    """Ratio of the first handle's motion to the second's."""
    offset: Coordinates | None = None
    """p1 - scale p2 without force [m or rad]; None: zeros."""

    def build(self, dimensions: int) -> Rendered:
        """Return the coupling; see `NetworkEnvironment`."""
        half, odd = divmod(dimensions, 2)
        if odd or not half:
            raise ParameterError(f"coupled_handles: got {dimensions} dimensions, expected an even number: two handles")
        offset = self.offset or (0.0,) * half
        if len(offset) != half:
            raise ParameterError(f"coupled_handles.offset: got {len(offset)} entries, expected {half}")
        rows = [
            [1.0 if j == i else -self.scale if j == half + i else 0.0 for j in range(dimensions)] for i in range(half)
        ]
        gain = [[1.0 if i == j else 0.0 for j in range(half)] for i in range(half)]
        springs = [Spring(stiffness=self.stiffness, hardening=self.hardening) for _ in range(half)]
        dampers = [Damper(viscous=self.damping, beside=i) for i in range(half)] if self.damping else []
        return Rendered(Network(springs, dampers, gain=gain), linear_geometry(rows, offset))
