"""A flat wall that oscillates; the energy of its mover enters the account through a separate port."""

import math
from typing import Annotated

from canhaptic.control.port_hamiltonian.shapes import Mover, Rendered, Surface, linear_geometry, unit_vector
from canhaptic.units import Numbers, quantity


class MovingWall(Surface):
    """Material where normal . p < offset + w(t), w(t) = amplitude (1 - cos(2 pi f t)) / 2: from 0 to the amplitude.

    The wall can push the hand with the energy of its mover, which is booked as `GroupBalance.supplied`. The promise of
    the account, sum(h_i) >= 0, includes that energy.
    """

    normal: Numbers
    """Direction out of the material; its length does not matter."""
    offset: Annotated[float, quantity("m", "rad")] = 0.0
    """Distance of the surface from the origin along the normal at rest [m or rad]."""
    amplitude: Annotated[float, quantity("m", "rad")]
    """Largest advance of the surface along the normal."""
    frequency: Annotated[float, quantity("Hz", gt=0.0, le=100.0)]
    """Frequency f of its motion."""

    def build(self, dimensions: int) -> Rendered:
        """Return the wall; see `NetworkEnvironment`."""
        normal = unit_vector("moving_wall", "normal", self.normal, dimensions)
        return self.behind(
            linear_geometry([normal], [self.offset]), Mover(0.5 * self.amplitude, 2.0 * math.pi * self.frequency)
        )
