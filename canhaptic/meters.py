"""Running figures of each port beyond its energy ledger, updated every SYNC, for the account and the energy log."""

from collections.abc import Sequence
from math import inf
from typing import TYPE_CHECKING, Any, Final, NamedTuple, Protocol

from canhaptic.control.axis_meter import Accuracy, AxisMeter
from canhaptic.control.balance import OUT_OF_CONTACT, Branch, EnergyBalance, along
from canhaptic.control.ledger import Ledger
from canhaptic.control.verdict import ACTIVE_AT_HANDLE, ACTIVE_AT_MOTOR, ROUNDING
from canhaptic.errors import LogFormatError
from canhaptic.signals import Measured, Sample

if TYPE_CHECKING:
    from canhaptic.control.motion_checks import MassFelt
    from canhaptic.control.ports import Port, Ports
    from canhaptic.logs.energy_reader import EnergyLog

_HELD: Final = Branch.HELD.value
_BRANCH: Final = EnergyBalance._fields.index("branch")  # a field by its number costs a fifth of one by its name
_measured: Final = tuple.__new__  # makes a record at half the cost of calling its class


class Promise(NamedTuple):
    """Lost cycles, energy allowance and hand force for which a controller's certificates hold."""

    max_consecutive_losses: int = 0  # sample times without a new torque that the certificates cover
    energy_allowance: float = 0.0  # the net energy into the handle stays above minus this [J]
    hand_force: float | None = None  # largest pull of the hand, as declared [N or N*m]


def promise_of(controller: object) -> Promise:
    """Return the conditions of a controller's certificates; by default no lost cycles and no energy allowance."""
    losses = int(getattr(controller, "max_consecutive_losses", 0))
    return Promise(losses, float(getattr(controller, "energy_allowance", 0.0)), getattr(controller, "hand_force", None))


class HeldTorques(Protocol):
    """Record of the torques held by one axis; `drive.profile.torque_axis` documents each value."""

    read_back_bound: float
    longest_hold: int
    longest_gap: int
    uncommanded: int
    open_time: int | None
    open_torque: float


class ActiveLimits(NamedTuple):
    """Bounds on the net energy of a port; below them it has certainly generated energy."""

    floor: float  # least sum of booked energy and its uncertainty [J]; -inf: the uncertainty is only an estimate
    power: float  # largest power that the device can dissipate [W]
    sample_time: float  # longest sample time [s]


def active_limits(accuracies: Sequence[Accuracy], allowance: float) -> ActiveLimits:
    """Return the bounds on the net energy below which a port has certainly generated energy.

    Args:
        accuracies: Accuracy of the measurements of each axis of the port.
        allowance: Net energy that the port may generate [J].
    """
    floor = -inf if any(accuracy.is_estimate for accuracy in accuracies) else -(allowance + ROUNDING)
    return ActiveLimits(floor, sum(each.most_dissipated for each in accuracies), accuracies[0].sample_time)


def limits_of(log: "EnergyLog", name: str) -> ActiveLimits | None:
    """Read the limits behind a port's column `active` from a log; None if the log lacks them.

    Raises:
        LogFormatError: The attribute is damaged.
    """
    from canhaptic.logs.columns import ACTIVE_LIMITS  # a run without a log loads nothing of it

    if f"{name}.{ACTIVE_LIMITS}" not in log.attributes:
        return None
    numbers = log.decoded(f"{name}.{ACTIVE_LIMITS}", dict[str, float]())
    if not all(key in ActiveLimits._fields and isinstance(value, float) for key, value in numbers.items()):
        raise LogFormatError(f"{log.path}: attribute {name}.{ACTIVE_LIMITS} cannot be used; the file is damaged")
    return ActiveLimits(numbers.get("floor", -inf), numbers.get("power", inf), numbers.get("sample_time", 0.0))


class Activity:
    """First time at which a port has certainly generated energy (was active); see `control.verdict`.

    Args:
        limits: Bounds on the net energy.

    Attributes:
        limits: Bounds on the net energy.
        active: Value for the log's column `active`: one bit for the motor, one for the handle.
        since: First time, by the energy at the motor [sample times since the first SYNC]; None: never.
        at_handle_since: First time, by the energy at the handle [sample times since the first SYNC]; None: never.
    """

    __slots__ = ("active", "at_handle_since", "limits", "since")

    def __init__(self, limits: ActiveLimits) -> None:
        self.limits, self.active = limits, 0
        self.since: int | None = None
        self.at_handle_since: int | None = None

    def take(self, most: float, deadline: int) -> None:
        """Note the time at which a net energy first falls below its bound.

        Args:
            most: Booked net energy plus its uncertainty [J].
            deadline: Sample times since the first SYNC.
        """
        limits = self.limits
        if self.since is None and most < limits.floor:
            self.since, self.active = deadline, self.active | ACTIVE_AT_MOTOR
        if self.at_handle_since is None and most + limits.power * (deadline + 1) * limits.sample_time < limits.floor:
            self.at_handle_since, self.active = deadline, self.active | ACTIVE_AT_HANDLE


class PortFigures:
    """Running figures of a port beyond its ledger, updated once per hold or from the columns of a log.

    Net energy is the energy that the port received less the energy that it delivered.

    Args:
        limits: Bounds on the net energy below which the port has certainly generated energy.
        is_damped: Whether damping of the device is declared; in a group for every axis.
        books_least: Whether the ledger books a lower bound of the energy received, so that no uncertainty is
            subtracted from it.
        damping_asked: Damping of the environment [N*s/m or N*m*s/rad]; None for a group.

    Attributes:
        activity: First times at which the port was certainly active; for a group, by the sum over its axes.
        books_least: The argument `books_least`.
        damping_asked: The argument `damping_asked`.
        least_at_handle: Lowest net energy at the handle, including the certain dissipation of the device [J]; None
            if no damping of the device is declared.
        least_certain: Lowest net energy less its uncertainty [J].
        least_certain_at_handle: Lowest net energy at the handle less its uncertainty [J].
        beyond_limit: Number of holds whose requested effort exceeds the drive's limit.
        contacts: Number of holds in contact.
        silent: Number of holds in contact followed by zero torque.
        damping: Sum of the damping rendered in contact [N*s/m].
        felt: Estimator of the mass felt; None if no mass is requested.
        ledger: Account of the port.
        is_requested: Whether a program, or user code in its own process, requests the torques: its storage is unknown.
        asked: Sum of the magnitudes of the efforts requested by the environment of an axis [N].
        reach: Lowest and highest position of an axis before its first contact [m or rad].
        last_torque: End of the last hold with a requested effort and a torque [sample times since the first SYNC].
        rendered: Sum of the torques sent in the holds with a requested effort, each positive in the direction of that
            effort and limited to the drive's limit [N].
        sizes_asked: Sum of the magnitudes of the requested efforts, each limited to the drive's limit [N].
        sizes_sent: Sum of the magnitudes of the torques sent in the holds with a requested effort [N].
        unanswered: Part of `sizes_asked` after the last torque [N].
    """

    __slots__ = (
        "_lowest",
        "activity",
        "asked",
        "beyond_limit",
        "books_least",
        "contacts",
        "damping",
        "damping_asked",
        "felt",
        "is_requested",
        "last_torque",
        "least_at_handle",
        "least_certain",
        "least_certain_at_handle",
        "ledger",
        "reach",
        "rendered",
        "silent",
        "sizes_asked",
        "sizes_sent",
        "unanswered",
    )  # fmt: skip

    def __init__(
        self, limits: ActiveLimits, *, is_damped: bool, books_least: bool, damping_asked: float | None
    ) -> None:
        self.ledger = Ledger()
        self.activity, self.books_least, self.damping_asked = Activity(limits), books_least, damping_asked
        self.least_at_handle = 0.0 if is_damped else None
        self._lowest = self.least_certain = self.least_certain_at_handle = 0.0
        self.asked = self.rendered = self.damping = self.sizes_asked = self.sizes_sent = self.unanswered = 0.0
        self.last_torque: float | None = None
        self.contacts = self.silent = self.beyond_limit = 0
        self.reach = inf, -inf
        self.felt: MassFelt | None = None
        self.is_requested = False

    def measured(self) -> Measured:
        """Return the present values of the log's columns for this port."""
        raise NotImplementedError

    @property
    def longest_gap(self) -> int:
        """Largest number of sample times between two SYNCs."""
        raise NotImplementedError

    @property
    def friction_excess(self) -> float | None:
        """Force by which the motion exceeds declared friction and hand [N or N*m]; None if not checked."""
        return None

    def _take_sums(self, interaction: float, resolution: float, dissipated: float) -> None:
        """Update the lowest net energies.

        Args:
            interaction: Net energy at the motor [J].
            resolution: Uncertainty of that energy [J].
            dissipated: Energy certainly dissipated by the device [J].
        """
        certain = interaction - resolution
        if certain < self.least_certain:
            self.least_certain = certain
        if self.least_at_handle is not None:
            if certain + dissipated < self.least_certain_at_handle:
                self.least_certain_at_handle = certain + dissipated
            if interaction < self._lowest:
                self._lowest = interaction
                if interaction + dissipated < self.least_at_handle:
                    self.least_at_handle = interaction + dissipated


class AxisPort(PortFigures):
    """Figures of one axis.

    Args:
        meter: Meter of the axis.
        drive: Record of the torques held by the axis.
        controller: Controller of the axis; None for an axis in a group.
    """

    __slots__ = ("_asks", "_drive", "_floor", "_meter", "controller")

    def __init__(self, meter: AxisMeter, drive: HeldTorques, controller: object) -> None:
        limits = active_limits([meter.accuracy], promise_of(controller).energy_allowance)
        super().__init__(
            limits, is_damped=meter.is_damped, books_least=meter.books_least, damping_asked=meter.damping_asked
        )
        self._meter, self._drive, self.felt = meter, drive, meter.felt
        self.controller: Any = controller if hasattr(controller, "energy_resolution") else None
        self._asks: Any = controller if hasattr(controller, "asked") else None
        self.is_requested = self._asks is not None
        self._floor = -inf if controller is None else limits.floor  # of a group only the sum counts

    def take(self, sample: Sample, balance: EnergyBalance, sent: float) -> Measured:
        """Update the figures with a completed hold, booked in the ledger; return the values of the log's columns.

        Args:
            sample: Sample at the end of the hold.
            balance: Energy balance of the hold; if its sample was lost, the next sample completes it.
            sent: Time of the SYNC that ended the hold, lateness included [sample times since the first SYNC].
        """
        meter, branch = self._meter, balance[_BRANCH]
        touches = branch not in OUT_OF_CONTACT
        if branch != _HELD:
            _, position, torque, _, _ = sample
            drive, before = self._drive, meter.position
            if self._asks is not None:
                meter.asked = -self._asks.asked
            meter.take(position, torque, sent, touches)
            if not self.contacts:
                low, high = self.reach
                if not low <= position <= high:
                    self.reach = min(low, position), max(high, position)
            if drive.open_time is not None:
                exact = balance.supplied - torque * (position - before)
                meter.leave_open(drive.open_torque, drive.open_time, abs(exact - balance.h_i))
            if (asked := meter.asked) != 0.0:
                self._take_effort(asked, balance.torque, sent)
        if touches:
            self.contacts += 1
            self.damping += balance.damping_rendered
            if not balance.torque:
                self.silent += 1
        interaction, resolution = self.ledger.interaction, self._resolution()
        self._take_sums(interaction, resolution, meter.dissipated)
        if interaction + resolution < self._floor:
            self.activity.take(interaction + resolution, int(sent))
        return self._measured(resolution)

    def _take_effort(self, asked: float, torque: float, sent: float) -> None:
        """Add an effort that the environment requested and the torque that was sent for it [N or N*m]."""
        size, most = abs(asked), self._meter.accuracy.largest_torque
        self.asked += size
        if size > most:  # a hand that is stronger than the drive feels it
            self.beyond_limit += 1
            size = most
        torque = max(-most, min(most, torque))  # the limiter cuts the rest
        self.rendered += along(asked, torque)
        self.sizes_asked += size
        self.sizes_sent += abs(torque)
        self.last_torque = sent if torque else self.last_torque
        self.unanswered = 0.0 if torque else self.unanswered + size

    @property
    def longest_gap(self) -> int:
        """Largest number of sample times between two SYNCs."""
        return self._drive.longest_gap

    @property
    def friction_excess(self) -> float | None:
        """Force by which the motion exceeds declared friction and hand [N or N*m]; None if not checked."""
        return None if self._meter.watch is None else self._meter.watch.excess

    def measured(self) -> Measured:
        """Return the present values of the log's columns for this port."""
        return self._measured(self._resolution())

    def _resolution(self) -> float:
        left = self._meter.resolution + self._drive.read_back_bound
        return left if self.controller is None else self.controller.energy_resolution + left

    def _measured(self, resolution: float) -> Measured:
        meter, drive = self._meter, self._drive
        known = resolution, meter.dissipated, meter.asked, drive.longest_hold, drive.uncommanded, self.activity.active
        return _measured(Measured, known)


class SumOfAxes(PortFigures):
    """Figures of several axes with one account.

    Args:
        meters: Energy meters of its axes.
        drives: Records of the torques held by its axes.
        port: The port.
    """

    __slots__ = ("_drives", "_meters", "_port")

    def __init__(self, meters: Sequence[AxisMeter], drives: Sequence[HeldTorques], port: "Port") -> None:
        allowance = promise_of(port.controller).energy_allowance
        super().__init__(
            active_limits([meter.accuracy for meter in meters], allowance),
            is_damped=all(meter.is_damped for meter in meters),
            books_least=all(meter.books_least for meter in meters),
            damping_asked=None,
        )
        self._meters, self._drives, self._port = tuple(meters), tuple(drives), port

    def take(self, _sample: Sample, balance: EnergyBalance, sent: float) -> Measured:
        """Update the figures with a hold, after those of its axes; arguments and result as for `AxisPort.take`."""
        if balance.branch not in OUT_OF_CONTACT:
            self.contacts += 1
            if not balance.torque:
                self.silent += 1
        measured = self.measured()
        interaction, resolution = self.ledger.interaction, measured.energy_resolution
        self._take_sums(interaction, resolution, measured.device_dissipated)
        if interaction + resolution < self.activity.limits.floor:
            self.activity.take(interaction + resolution, int(sent))
            return measured._replace(active=self.activity.active)
        return measured

    @property
    def longest_gap(self) -> int:
        """Largest number of sample times between two SYNCs."""
        return max(drive.longest_gap for drive in self._drives)

    def measured(self) -> Measured:
        """Return the present values of the log's columns for this port."""
        resolution: float = getattr(self._port.controller, "energy_resolution", 0.0)
        resolution += self._port.uncertainty + sum([meter.resolution for meter in self._meters])
        return Measured(
            resolution + sum([drive.read_back_bound for drive in self._drives]),
            sum([meter.dissipated for meter in self._meters]),
            0.0,
            max([drive.longest_hold for drive in self._drives]),
            sum([drive.uncommanded for drive in self._drives]),
            self.activity.active,
        )


class RunMeters:
    """Running figures of all rows of a run; see `canhaptic.control.ports`.

    Args:
        axes: Energy meters, one per axis.
        drives: Record of the torques held by each axis.
        ports: Ports of the rig.

    Attributes:
        axes: Energy meters of the axes.
        ports: Figures of each row.
        deadline: Sample times since the first SYNC; more than the SYNC's index if SYNCs were skipped.
    """

    def __init__(self, axes: Sequence[AxisMeter], drives: Sequence[HeldTorques], ports: "Ports") -> None:
        self.axes, self.deadline, alone = tuple(axes), 0, ports.alone
        own = [alone.get(axis) for axis in range(len(self.axes))]
        self.ports: list[AxisPort | SumOfAxes] = [*map(AxisPort, self.axes, drives, own)]
        for port in ports.several:
            members, moved = [self.axes[axis] for axis in port.axes], [drives[axis] for axis in port.axes]
            self.ports.append(SumOfAxes(members, moved, port))

    def take(
        self,
        samples: Sequence[Sample],
        balances: Sequence[EnergyBalance],
        index: int,
        deadline: int,
        late: float = 0.0,
    ) -> list[Measured]:
        """Book a SYNC in the ledger of every row and update its figures; return the values of the log's columns.

        Args:
            samples: Sample of each row.
            balances: Energy balances in the same order.
            index: Index of the SYNC.
            deadline: Sample times since the first SYNC.
            late: Lateness of the SYNC [sample times].
        """
        self.deadline, sent, known = deadline, deadline + late, []
        for port, sample, balance in zip(self.ports, samples, balances, strict=True):
            port.ledger.add(balance, index, deadline)
            known.append(port.take(sample, balance, sent))
        return known
