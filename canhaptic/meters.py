"""What a run knows of its ports in addition to their ledgers, hold by hold: for the account and the rows of the log."""

from collections.abc import Sequence
from typing import Final, NamedTuple, Protocol, runtime_checkable

from canhaptic.control.axis_meter import AxisMeter
from canhaptic.control.balance import OUT_OF_CONTACT, Branch, EnergyBalance
from canhaptic.control.ledger import Ledger
from canhaptic.control.multi_axis.axis_group import AxisGroup
from canhaptic.drive.profile.torque_axis import TorqueAxis
from canhaptic.signals import Measured, Sample

_HELD: Final = Branch.HELD.value
_BRANCH: Final = EnergyBalance._fields.index("branch")  # a field by its number costs a fifth of one by its name
_measured: Final = tuple.__new__  # makes a record at half the cost of calling its class


class Promise(NamedTuple):
    """What the certificates of a controller rest on in addition to the declarations of hand and device."""

    max_consecutive_losses: int = 0  # sample times without a new torque that they survive
    energy_allowance: float = 0.0  # they promise a sum of interaction of minus this at least [J]


def promise_of(controller: object) -> Promise:
    """Returns what a controller declares; the least where it declares nothing."""
    losses = int(getattr(controller, "max_consecutive_losses", 0))
    return Promise(losses, float(getattr(controller, "energy_allowance", 0.0)))


@runtime_checkable
class _StatesResolution(Protocol):
    """A controller that leaves something of its energy open itself."""

    @property
    def energy_resolution(self) -> float: ...


class AxisPort:
    """What is known of one axis.

    Args:
        meter: Of the axis.
        drive: Of the axis.
        controller: Renders it; None of an axis in a group.

    Attributes:
        drives: Of the port.
        least_at_handle: Least sum of interaction and certain dissipation of the device after any hold [J]; None where
            no damping of the device is declared.
        contacts: Holds in contact.
        silent: Those of them whose next torque is none.
        damping: Sum of the damping that was rendered in contact [N*s/m].
        asked: Sum of the effort that the environment of an axis asked for [N].
        rendered: What was rendered there [N].
    """

    __slots__ = (
        "_controller", "_drive", "_is_damped", "_lowest", "_meter", "asked", "contacts", "damping", "drives",
        "least_at_handle", "rendered", "silent",
    )  # fmt: skip

    def __init__(self, meter: AxisMeter, drive: TorqueAxis, controller: object) -> None:
        self._meter, self._drive, self.drives = meter, drive, (drive,)
        self._controller = controller if isinstance(controller, _StatesResolution) else None
        self._lowest = self.asked = self.rendered = self.damping = 0.0
        self.contacts = self.silent = 0
        self._is_damped = meter.is_damped
        self.least_at_handle = 0.0 if self._is_damped else None

    def take(self, sample: Sample, balance: EnergyBalance, ledger: Ledger, sent: float) -> Measured:
        """Takes a hold; returns what is known.

        Args:
            sample: At its end.
            balance: Of the hold; one that was not booked waits for the next position.
            ledger: That took it.
            sent: Sample times from the first SYNC to its end, which may be late.
        """
        meter, branch = self._meter, balance[_BRANCH]
        touches = branch not in OUT_OF_CONTACT
        if branch != _HELD:
            _, position, torque, _, _ = sample
            drive, before = self._drive, meter.position
            meter.take(position, torque, sent, touches)
            if drive.open_time:
                exact = -torque * (position - before)
                meter.leave_open(drive.open_torque, drive.open_time, abs(exact - balance.h_i))
            if meter.asked:
                self.asked += meter.asked
                self.rendered -= balance.torque
        if touches:
            self.contacts += 1
            self.damping += balance.damping_rendered
            if not balance.torque:
                self.silent += 1
        if self._is_damped and ledger.interaction < self._lowest:
            self._lowest = lowest = ledger.interaction
            self.least_at_handle = _least(self.least_at_handle, lowest + meter.dissipated)
        return self.measured()

    def measured(self) -> Measured:
        """Returns what is known."""
        meter, drive = self._meter, self._drive
        left = meter.resolution + drive.read_back_bound
        if self._controller is not None:
            left = self._controller.energy_resolution + left
        return _measured(Measured, (left, meter.dissipated, meter.asked, drive.longest_hold, drive.uncommanded))


class GroupPort:
    """What is known of a group.

    Args:
        meters: Of its axes.
        drives: Of its axes.
        group: Axes that render together.

    Attributes:
        drives: As given.
        least_at_handle: As of an axis, where damping is declared of every axis.
        contacts: As of an axis.
        silent: As of an axis.
    """

    __slots__ = ("_group", "_lowest", "_meters", "contacts", "drives", "least_at_handle", "silent")

    def __init__(self, meters: Sequence[AxisMeter], drives: Sequence[TorqueAxis], group: AxisGroup) -> None:
        self._meters, self.drives, self._group = tuple(meters), tuple(drives), group
        self._lowest, self.contacts, self.silent = 0.0, 0, 0
        self.least_at_handle = 0.0 if all(meter.is_damped for meter in self._meters) else None

    def take(self, _sample: Sample, balance: EnergyBalance, ledger: Ledger, _sent: float) -> Measured:
        """Takes a hold, behind the axes of the group; returns what is known. See `AxisPort.take`."""
        if balance.branch not in OUT_OF_CONTACT:
            self.contacts += 1
            if not balance.torque:
                self.silent += 1
        if self.least_at_handle is not None and ledger.interaction < self._lowest:
            self._lowest = lowest = ledger.interaction
            now = lowest + sum([meter.dissipated for meter in self._meters])
            self.least_at_handle = _least(self.least_at_handle, now)
        return self.measured()

    def measured(self) -> Measured:
        """Returns what is known."""
        meters, drives, group = self._meters, self.drives, self._group
        left = group.controller.energy_resolution if isinstance(group.controller, _StatesResolution) else 0.0
        left += group.unsure + sum([meter.resolution for meter in meters])
        return Measured(
            left + sum([drive.read_back_bound for drive in drives]),
            sum([meter.dissipated for meter in meters]),
            0.0,
            max([drive.longest_hold for drive in drives]),
            sum([drive.uncommanded for drive in drives]),
        )


class RunMeters:
    """The meters of all axes, and their sums for axes and groups.

    Args:
        axes: One for each axis.
        drives: Of the axes.
        controllers: Of each axis that is in no group, in their order.
        groups: Axes that render together.

    Attributes:
        axes: As given.
        of_axes: What is known of each axis.
        ports: The same, then of each group.
        deadline: Sample times since the first SYNC; ahead of its index where SYNCs were skipped.
    """

    def __init__(
        self,
        axes: Sequence[AxisMeter],
        drives: Sequence[TorqueAxis],
        controllers: Sequence[object],
        groups: Sequence[AxisGroup] = (),
    ) -> None:
        self.axes, self.deadline = tuple(axes), 0
        grouped = {axis for group in groups for axis in group.axes}
        alone = iter(controllers)
        own = [None if axis in grouped else next(alone) for axis in range(len(self.axes))]
        self.of_axes = tuple(map(AxisPort, self.axes, drives, own))
        self.ports: list[AxisPort | GroupPort] = [*self.of_axes]
        for group in groups:
            members, moved = [self.axes[axis] for axis in group.axes], [drives[axis] for axis in group.axes]
            self.ports.append(GroupPort(members, moved, group))
        self._places = tuple(range(len(self.ports)))

    def take(
        self,
        samples: Sequence[Sample],
        balances: Sequence[EnergyBalance],
        ledgers: Sequence[Ledger],
        deadline: int,
        late: float = 0.0,
    ) -> list[Measured]:
        """Takes the SYNC whose balances the ledgers have just taken; returns what is known of each port.

        Args:
            samples: Of each axis, then of each group.
            balances: The same.
            ledgers: The same.
            deadline: Sample times since the first SYNC.
            late: Time by which the SYNC was later than that [sample times].
        """
        self.deadline, sent, known = deadline, deadline + late, []
        for place in self._places:  # walked by number, see `Cycle`
            known.append(self.ports[place].take(samples[place], balances[place], ledgers[place], sent))
        return known


def _least(known: float | None, now: float) -> float | None:
    return now if known is not None and now < known else known
