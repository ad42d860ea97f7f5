"""What a run knows of its ports in addition to their ledgers, hold by hold: for the account and the rows of the log."""

from collections.abc import Sequence
from typing import Any, Final, NamedTuple

from canhaptic.control.axis_meter import AxisMeter
from canhaptic.control.balance import OUT_OF_CONTACT, Branch, EnergyBalance, Ledger
from canhaptic.control.multi_axis.axis_group import AxisGroup
from canhaptic.drive.profile.torque_axis import TorqueAxis
from canhaptic.signals import Measured, Sample

_HELD = Branch.HELD.value
_measured: Final = tuple.__new__  # makes a record at half the cost of calling its class


class Promise(NamedTuple):
    """What the certificates of a controller rest on in addition to the declarations of hand and device."""

    max_consecutive_losses: int = 0  # sample times without a new torque that they survive
    energy_allowance: float = 0.0  # they promise a sum of interaction of minus this at least [J]


def promise_of(controller: object) -> Promise:
    """Returns what a controller declares; the least where it declares nothing."""
    losses = int(getattr(controller, "max_consecutive_losses", 0))
    return Promise(losses, float(getattr(controller, "energy_allowance", 0.0)))


class _Port(NamedTuple):
    """Where what is known of a port comes from."""

    meters: tuple[AxisMeter, ...]
    drives: tuple[TorqueAxis, ...]
    controller: Any  # that states an energy resolution of its own; None: it states none
    group: AxisGroup | None


def _port(
    meters: Sequence[AxisMeter], drives: Sequence[TorqueAxis], controller: object, group: AxisGroup | None = None
) -> _Port:
    states = hasattr(controller, "energy_resolution")
    return _Port(tuple(meters), tuple(drives), controller if states else None, group)


class RunMeters:
    """The meters of all axes, and their sums for axes and groups.

    Args:
        axes: One for each axis.
        drives: Of the axes.
        controllers: Of each axis that is in no group, in their order.
        groups: Axes that render together.

    Attributes:
        axes: As given.
        deadline: Sample times since the first SYNC; ahead of its index where SYNCs were skipped.
        least_at_handle: Least sum of interaction and certain dissipation of the device after any hold, of each axis,
            then of each group [J]; None where no damping of the device is declared.
        contacts: Holds in contact of each axis and group.
        silent: Holds of those whose next torque is none.
        asked: Sums of the effort that the environment of each axis asked for, and of what was rendered there [N].
        damping: Sum of the damping that was rendered in the contacts of each axis and group [N*s/m].
    """

    def __init__(
        self,
        axes: Sequence[AxisMeter],
        drives: Sequence[TorqueAxis],
        controllers: Sequence[object],
        groups: Sequence[AxisGroup] = (),
    ) -> None:
        self.axes, self._drives, self.deadline = tuple(axes), tuple(drives), 0
        grouped = {axis for group in groups for axis in group.axes}
        alone = iter(controllers)
        own = [None if axis in grouped else next(alone) for axis in range(len(self.axes))]
        self._ports = [_port((m,), (d,), c) for m, d, c in zip(self.axes, drives, own, strict=True)]
        for group in groups:
            members, moved = [self.axes[axis] for axis in group.axes], [drives[axis] for axis in group.axes]
            self._ports.append(_port(members, moved, group.controller, group))
        count = len(self._ports)
        damped = [all(meter.is_damped for meter in port.meters) for port in self._ports]
        self.least_at_handle: list[float | None] = [0.0 if is_damped else None for is_damped in damped]
        self.contacts, self.silent = [0] * count, [0] * count
        self._count, self._places, self._lowest = len(self.axes), tuple(range(count)), [0.0] * count
        self.damping = [0.0] * count
        self.asked: list[tuple[float, float]] = [(0.0, 0.0)] * len(self.axes)

    def take(
        self,
        samples: Sequence[Sample],
        balances: Sequence[EnergyBalance],
        ledgers: Sequence[Ledger],
        deadline: int,
        late: float = 0.0,
    ) -> None:
        """Takes the SYNC whose balances the ledgers have just taken.

        Args:
            samples: Of each axis, then of each group.
            balances: The same.
            ledgers: The same.
            deadline: Sample times since the first SYNC.
            late: Time by which the SYNC was later than that [sample times].
        """
        self.deadline, sent = deadline, deadline + late
        axes = self._count
        for place in self._places:  # walked by number, see `Cycle`
            balance = balances[place]
            branch = balance.branch
            if place < axes:
                meter = self.axes[place]
                if branch != _HELD:
                    sample, drive = samples[place], self._drives[place]
                    before = meter.position
                    meter.take(sample.position, sample.torque_applied, sent, balance)
                    if drive.open_time:
                        exact = -sample.torque_applied * (sample.position - before)
                        meter.leave_open(drive.open_torque, drive.open_time, abs(exact - balance.h_i))
                    if meter.asked:
                        asked, rendered = self.asked[place]
                        self.asked[place] = asked + meter.asked, rendered - balance.torque
            if branch not in OUT_OF_CONTACT:
                self.contacts[place] += 1
                self.damping[place] += balance.damping_rendered
                if not balance.torque:
                    self.silent[place] += 1
            least = self.least_at_handle[place]
            if least is not None and ledgers[place].interaction < self._lowest[place]:
                self._lowest[place] = ledgers[place].interaction
                now = ledgers[place].interaction + sum([meter.dissipated for meter in self._ports[place].meters])
                if now < least:
                    self.least_at_handle[place] = now

    def drives_of(self, place: int) -> tuple[TorqueAxis, ...]:
        """Returns the drives of an axis or group."""
        return self._ports[place].drives

    def measured(self, place: int) -> Measured:
        """Returns what is known of an axis or, behind all axes, of a group."""
        meters, drives, controller, group = self._ports[place]
        left = 0.0 if controller is None else controller.energy_resolution
        if group is None:
            [meter], [drive] = meters, drives
            left += meter.resolution + drive.read_back_bound
            return _measured(Measured, (left, meter.dissipated, meter.asked, drive.longest_hold, drive.uncommanded))
        left += group.unsure + sum([meter.resolution for meter in meters])
        return Measured(
            left + sum([drive.read_back_bound for drive in drives]),
            sum([meter.dissipated for meter in meters]),
            0.0,
            max([drive.longest_hold for drive in drives]),
            sum([drive.uncommanded for drive in drives]),
        )

    def all_measured(self) -> list[Measured]:
        """Returns what is known of each axis, then of each group."""
        rows = []
        for place in self._places:
            rows.append(self.measured(place))  # a comprehension is a function made and called anew
        return rows
