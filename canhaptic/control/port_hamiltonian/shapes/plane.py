"""A flat wall in any direction."""

from canhaptic.control.port_hamiltonian.shapes.geometry import Rendered, linear_geometry
from canhaptic.control.port_hamiltonian.shapes.surface import Surface, unit_vector


class Plane(Surface):
    """Material where normal . p < offset."""

    normal: tuple[float, ...]
    """Out of the material; its length does not matter."""
    offset: float = 0.0
    """Distance of the surface from the origin along the normal [m or rad]."""

    def build(self, dimensions: int) -> Rendered:
        """Returns the wall; see `NetworkEnvironment`."""
        normal = unit_vector("plane", "normal", self.normal, dimensions)
        return self.behind(linear_geometry([normal], [self.offset]))
