"""A virtual mass carried through a spring and a damper, free on a viscous floor or held by its own spring."""

from typing import Annotated

from pydantic import model_validator

from canhaptic.control.port_hamiltonian.network import Damper, Mass, Network, Spring, Storage
from canhaptic.control.port_hamiltonian.shapes import Rendered, check_length, identity_rows, linear_geometry
from canhaptic.units import Coordinates, Parameters, quantity


class VirtualMass(Parameters):
    """A mass on a viscous floor, coupled to the handle by a (hardening) spring and a damper in every coordinate.

    The states are the extensions of the coupling, then the momenta. The mass begins at rest at the handle.
    """

    mass: Annotated[float, quantity("kg", "kg*m^2", gt=0.0)]
    """Mass of the virtual body, the same in every direction."""
    stiffness: Annotated[float, quantity("N/m", "N*m/rad", gt=0.0, le=1e9)]
    """Stiffness of the coupling."""
    hardening: Annotated[float, quantity("N/m^3", "N*m/rad^3", ge=0.0, le=1e15)] = 0.0
    """Cubic coefficient k3 of the coupling."""
    damping: Annotated[float, quantity("N*s/m", "N*m*s/rad", ge=0.0, le=1e7)] = 0.0
    """Damping of the coupling."""
    floor: Annotated[float, quantity("N*s/m", "N*m*s/rad", ge=0.0, le=1e7)] = 0.0
    """Viscous friction of the mass."""

    def build(self, dimensions: int) -> Rendered:
        """Return the mass; see `NetworkEnvironment`."""
        return Rendered(self._network(dimensions, []), linear_geometry(identity_rows(dimensions), [0.0] * dimensions))

    def _network(self, dimensions: int, anchors: list[Storage]) -> Network:
        n, size = dimensions, 2 * dimensions + len(anchors)
        storages: list[Storage] = [Spring(stiffness=self.stiffness, hardening=self.hardening) for _ in range(n)]
        storages += [Mass(mass=self.mass) for _ in range(n)]
        storages += anchors
        structure = [[0.0] * size for _ in range(size)]
        gain = [[0.0] * n for _ in range(size)]
        origin = [[0.0] * n for _ in range(size)]
        for i in range(n):
            gain[i][i] = 1.0
            structure[i][n + i], structure[n + i][i] = -1.0, 1.0
            if anchors:
                structure[n + i][2 * n + i], structure[2 * n + i][n + i] = -1.0, 1.0
                origin[2 * n + i][i] = 1.0
        dampers = [Damper(viscous=self.damping, beside=i) for i in range(n)] if self.damping else []
        if self.floor:
            dampers += [Damper(viscous=self.floor, states={n + i: 1.0}) for i in range(n)]
        return Network(storages, dampers, gain=gain, structure=structure, origin=origin)


class MassOnSpring(VirtualMass):
    """A virtual mass held by a spring to a point of task space."""

    anchor: Coordinates
    """Task coordinates [m or rad] of the point."""
    anchor_stiffness: Annotated[float, quantity("N/m", "N*m/rad", gt=0.0, le=1e9)]
    """Stiffness of the spring between mass and point."""

    @model_validator(mode="after")
    def _somewhere(self) -> "MassOnSpring":
        if not self.anchor:
            raise ValueError("anchor: got no coordinates, expected one for each dimension of task space")
        return self

    def build(self, dimensions: int) -> Rendered:
        """Return the mass on its spring; see `NetworkEnvironment`."""
        check_length("mass_on_spring", "anchor", len(self.anchor), dimensions)
        anchors: list[Storage] = [Spring(stiffness=self.anchor_stiffness) for _ in range(dimensions)]
        geometry = linear_geometry(identity_rows(dimensions), self.anchor)
        return Rendered(self._network(dimensions, anchors), geometry)
