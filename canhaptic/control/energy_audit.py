"""Comparison of a run's energy accounts with its simulated plant; loaded in simulated runs only."""

from collections.abc import Sequence

from canhaptic.control.balance import Branch, EnergyBalance
from canhaptic.control.ledger import Ledger
from canhaptic.control.ports import Ports
from canhaptic.signals import PlantEnergy, Truth

_HELD = Branch.HELD.value


class EnergyAudit:
    """Compares the accounted energy of each ledger with the true energy of the simulated plant.

    Args:
        ports: Ports of the rig.

    Attributes:
        least: Least true sum of h_i after any hold, of each row, with what was supplied by movers of its walls or a far
            side [J].
        least_at_handle: The same, including what friction and bearings have dissipated [J].
        interaction: True sum of h_i, per row [J].
        dissipated: Energy dissipated by friction and bearings, per row [J].
        believed_error: Largest |accounted - true| sum of h_i after any hold, per row [J].
    """

    def __init__(self, ports: Ports) -> None:
        self.least, self.least_at_handle, self.interaction, self.dissipated, self.believed_error = (
            [0.0] * ports.rows for _ in range(5)
        )
        self._axes, self._several = tuple(range(ports.axes)), ports.several

    def compare(
        self, ledgers: Sequence[Ledger], truths: Sequence[Truth], balances: Sequence[EnergyBalance]
    ) -> Sequence[Truth]:
        """Compare the true energies at a SYNC with the ledgers, to which the balances of that SYNC were already added.

        Args:
            ledgers: Ledger of each row.
            truths: True energies of each axis.
            balances: Balance of each row; an account without a new position is not compared at this SYNC.

        Returns:
            True energies of each row.
        """
        for axis in self._axes:
            _, (motor, _, dissipated, _) = truths[axis]
            ledger = ledgers[axis]
            self._take(axis, ledger.supplied - motor, dissipated, ledger.interaction, balances[axis].branch != _HELD)
        for port in self._several:
            energies = [truths[axis].energy for axis in port.axes]
            motor, user, dissipated, stored = map(sum, zip(*energies, strict=True))
            accounted = sum([ledgers[axis].interaction for axis in port.axes])
            booked, supplied = balances[port.row].branch != _HELD, ledgers[port.row].supplied
            self._take(port.row, -motor, dissipated, accounted, booked, supplied)
            of_port = PlantEnergy(motor - supplied, user, dissipated, stored)  # what a mover gave counts as of motors
            truths = [*truths, Truth(0.0, of_port)]
        return truths

    def _take(
        self, place: int, true: float, dissipated: float, accounted: float, booked: bool, supplied: float = 0.0
    ) -> None:
        came_in = true + supplied
        self.interaction[place], self.dissipated[place] = came_in, dissipated
        if came_in < self.least[place]:
            self.least[place] = came_in
            if came_in + dissipated < self.least_at_handle[place]:
                self.least_at_handle[place] = came_in + dissipated
        error, most = accounted - true, self.believed_error[place]
        if booked and (error > most or error < -most):
            self.believed_error[place] = abs(error)
