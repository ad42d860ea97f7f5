"""Common part of touchable surfaces: one coordinate, the distance from the surface, negative inside the material."""

import math
from collections.abc import Sequence
from typing import Annotated

from canhaptic.control.port_hamiltonian.network import Damper, Network, Spring
from canhaptic.control.port_hamiltonian.shapes.geometry import STILL, Geometry, Mover, Rendered
from canhaptic.errors import ParameterError
from canhaptic.kernels import Buffer
from canhaptic.units import Parameters, quantity


class Surface(Parameters):
    """Material behind a surface: a spring and a damper side by side, felt where the distance is negative."""

    stiffness: Annotated[float, quantity("N/m", "N*m/rad", ge=0.0, le=1e9)]
    """Stiffness of the spring behind the surface."""
    hardening: Annotated[float, quantity("N/m^3", "N*m/rad^3", ge=0.0, le=1e15)] = 0.0
    """Cubic coefficient k3."""
    damping: Annotated[float, quantity("N*s/m", "N*m*s/rad", ge=0.0, le=1e7)] = 0.0
    """Coefficient of the damper in parallel with the spring; it acts in contact only."""

    def network(self) -> Network:
        """Return spring and damper at one port, engaged below 0."""
        return Network(
            [Spring(stiffness=self.stiffness, hardening=self.hardening, upper=None)],
            [Damper(viscous=self.damping, beside=0)] if self.damping else [],
            gain=[[1.0]],
        )

    def behind(self, geometry: Geometry, mover: Mover = STILL) -> Rendered:
        """Return the material behind a surface given by its distance."""
        return Rendered(self.network(), geometry, mover)


def unit_vector(owner: str, name: str, vector: Sequence[float], dimensions: int) -> tuple[float, ...]:
    """Return the direction of a vector.

    Raises:
        ParameterError: It has another number of entries than task space, or no direction.
    """
    length = math.hypot(*vector)
    if len(vector) != dimensions or not (length > 0.0 and math.isfinite(length)):
        raise ParameterError(
            f"{owner}.{name}: got {tuple(vector)}, expected {dimensions} finite numbers that are not all 0"
        )
    return tuple(v / length for v in vector)


def radial(row: Buffer, radius: float, sign: float) -> float:
    """Return the distance from a round surface [m or rad]; turns the offset from centre or axis into its gradient.

    Args:
        row: Offset from the centre, or from the nearest point of the axis [m or rad]; the gradient afterwards.
        radius: Radius of the surface [m or rad].
        sign: 1 where free space is outside, else -1.
    """
    square = 0.0
    for offset in row:
        square += offset * offset
    length = math.sqrt(square)
    if length > 0.0:
        for i in range(len(row)):
            row[i] = sign * row[i] / length
    else:  # at the very centre no way out is shorter than another
        for i in range(len(row)):
            row[i] = sign if i == 0 else 0.0
    return sign * (length - radius)
