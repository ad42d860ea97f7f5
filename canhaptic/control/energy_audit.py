"""Comparison of a run's energy accounts with its simulated plant; loaded in simulated runs only."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from canhaptic.control.balance import Branch, EnergyBalance
from canhaptic.control.ledger import Ledger
from canhaptic.signals import Truth

if TYPE_CHECKING:
    from canhaptic.control.multi_axis.group_controller import AxisGroup

_HELD = Branch.HELD.value


class EnergyAudit:
    """Compares the accounted energy of each ledger with the true energy of the simulated plant.

    Args:
        axes: Number of axes of the rig.
        groups: Axes that render together.

    Attributes:
        least: Least true sum of h_i after any hold, of each axis, then of each group, with what was supplied by
            movers of its walls or a far side [J].
        least_at_handle: The same, including what friction and bearings have dissipated [J].
        interaction: True sum of h_i, per axis and group [J].
        dissipated: Energy dissipated by friction and bearings, per axis and group [J].
        believed_error: Largest |accounted - true| sum of h_i after any hold, per axis and group [J].
    """

    def __init__(self, axes: int, groups: "Sequence[AxisGroup]" = ()) -> None:
        self.least, self.least_at_handle, self.interaction, self.dissipated, self.believed_error = (
            [0.0] * (axes + len(groups)) for _ in range(5)
        )
        self._axes = tuple(range(axes))
        self._groups = [(axes + place, group) for place, group in enumerate(groups)]

    def compare(self, ledgers: Sequence[Ledger], truths: Sequence[Truth], balances: Sequence[EnergyBalance]) -> None:
        """Compare the true energies at a SYNC with the ledgers, to which the balances of that SYNC were already added.

        Args:
            ledgers: Ledger of each axis.
            truths: True energies of each axis.
            balances: Balance of each axis; an account without a new position is not compared at this SYNC.
        """
        for axis in self._axes:
            _, (motor, _, dissipated, _) = truths[axis]
            ledger = ledgers[axis]
            self._take(axis, ledger.supplied - motor, dissipated, ledger.interaction, balances[axis].branch != _HELD)
        for place, group in self._groups:
            true = -sum([truths[axis].energy.motor for axis in group.axes])
            dissipated = sum([truths[axis].energy.dissipated for axis in group.axes])
            accounted = sum([ledgers[axis].interaction for axis in group.axes])
            supplied, booked = (
                group.ledger.supplied + group.balance.account.supplied,
                balances[group.axes[0]].branch != _HELD,
            )
            self._take(place, true, dissipated, accounted, booked, supplied)

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
