"""A network given in full: storages, dissipators, structure and gain, at coordinates of task space."""

from pydantic import model_validator

from canhaptic.control.port_hamiltonian.network import Dissipator, Network, Storage, check_rows
from canhaptic.control.port_hamiltonian.shapes import Rendered, identity_rows, linear_geometry
from canhaptic.errors import ParameterError
from canhaptic.units import Coordinates, Numbers, Parameters

_Rows = tuple[Numbers, ...]


class General(Parameters):
    """A network xdot = (J - R) e + g u, y = g'e + S u; see `canhaptic.control.port_hamiltonian.network.Network`."""

    storages: tuple[Storage, ...]
    """Energy storages, in the order of the states x."""
    dissipators: tuple[Dissipator, ...] = ()
    """Dissipators: R and S of the equation."""
    structure: _Rows | None = None
    """J, skew; None: zero."""
    gain: _Rows
    """g, one row for each state, one column for each port."""
    origin: _Rows | None = None
    """Matrix that gives x(0) from the ports' first coordinates; None: walls at their positions, masses at rest."""
    ports: _Rows | None = None
    """Matrix from task coordinates to ports, a row for each port; None: one port for each task coordinate."""
    offset: Coordinates | None = None
    """Offset subtracted from the ports' coordinates; None: zeros."""

    @model_validator(mode="after")
    def _fits(self) -> "General":
        self._network()
        return self

    def _network(self) -> Network:
        return Network(
            self.storages, self.dissipators, gain=self.gain, structure=self.structure, origin=self.origin
        )  # fmt: skip

    def build(self, dimensions: int) -> Rendered:
        """Return the network; see `NetworkEnvironment`."""
        network = self._network()
        if self.ports is None and network.ports != dimensions:
            raise ParameterError(
                f"general.gain: got {network.ports} columns, one for each port, in a task space of {dimensions} "
                "dimensions, expected as many; or give ports, their rows over task space"
            )
        rows = identity_rows(dimensions) if self.ports is None else self.ports
        check_rows("ports", rows, network.ports, dimensions)
        offset = self.offset or (0.0,) * network.ports
        if len(offset) != network.ports:
            raise ParameterError(
                f"general.offset: got {len(offset)} entries, expected {network.ports}, one for each port"
            )
        return Rendered(network, linear_geometry(rows, offset))
