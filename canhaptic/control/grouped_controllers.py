"""Controllers of a rig, of which some may render on several axes together; the stop of every rig steps them so."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from canhaptic.control.balance import Branch, EnergyBalance
from canhaptic.control.passivity import Controller
from canhaptic.signals import Sample

if TYPE_CHECKING:
    from canhaptic.control.multi_axis.group_controller import AxisGroup

_GROUP, _HELD = Branch.GROUP.value, Branch.HELD.value


class GroupedControllers:
    """Controllers of a rig that has groups of axes, or of any rig in a dry run.

    Args:
        controllers: Controllers of the axes outside groups, in the order of the rig.
        groups: Groups; each axis of the rig is in one of them or has a controller.
        dry_run: Whether no torque is sent; a lost sample then makes no energy uncertain.
    """

    def __init__(self, controllers: Sequence[Controller], groups: "Sequence[AxisGroup]", dry_run: bool = False) -> None:
        self.groups = tuple(groups)
        render = (*controllers, *(group.controller for group in groups))
        self._withhold = [each.withhold for each in render if dry_run and hasattr(each, "withhold")]
        grouped = {axis for group in groups for axis in group.axes}
        self.axes = len(controllers) + len(grouped)
        self._singles = list(zip((axis for axis in range(self.axes) if axis not in grouped), controllers, strict=True))
        self._balances: list[EnergyBalance] = [_axis_balance(0.0, 0.0, _GROUP, 0)] * self.axes

    @property
    def programs(self) -> list[tuple[int, Any]]:
        """Axes whose torques the user's program requests, and the controllers of these axes."""
        return [(axis, controller) for axis, controller in self._singles if hasattr(controller, "ask")]

    def lasted(self, periods: int) -> None:
        """Record that SYNCs were skipped: the hold that ends next lasted this number of sample times."""
        for controller in (*(single for _, single in self._singles), *(group.controller for group in self.groups)):
            if periods > 1 and hasattr(controller, "lasted"):
                controller.lasted(float(periods))

    def step(self, samples: Sequence[Sample]) -> list[EnergyBalance]:
        """Return one balance per axis; balances of groups are in `AxisGroup.balance`."""
        balances = self._balances.copy()
        for axis, controller in self._singles:
            sample = samples[axis]
            balances[axis] = (
                controller.step(sample.position, sample.torque_applied) if sample.fresh else controller.sample_lost()
            )
        for group in self.groups:
            balance = group.step(samples)
            branch, certificate = balance.account.branch, balance.account.certificate
            branch = _HELD if branch == _HELD else _GROUP
            for axis, torque, h_i in zip(group.axes, balance.torques, balance.interactions, strict=True):
                balances[axis] = _axis_balance(torque, h_i, branch, certificate)
        for withhold in self._withhold:
            withhold()
        return balances


def _axis_balance(torque: float, h_i: float, branch: int, certificate: int) -> EnergyBalance:
    """Return the balance of one axis of a group: torque and h_i, because all else is in the group's account."""
    return EnergyBalance(torque, h_i, 0.0, h_i, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, branch, 0.0, certificate, 0.0)
