"""A flat wall in any direction."""

from typing import Annotated

from canhaptic.control.port_hamiltonian.shapes import Rendered, Surface, linear_geometry, unit_vector
from canhaptic.units import Numbers, quantity


class Plane(Surface):
    """A wall: material where normal . p < offset."""

    normal: Numbers
    """Direction out of the material; its length does not matter."""
    offset: Annotated[float, quantity("m", "rad")] = 0.0
    """Distance of the surface from the origin along the normal [m or rad]."""

    def build(self, dimensions: int) -> Rendered:
        """Return the wall; see `NetworkEnvironment`."""
        normal = unit_vector("plane", "normal", self.normal, dimensions)
        return self.behind(linear_geometry([normal], [self.offset]))
