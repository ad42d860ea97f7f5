"""Several admittance displays with one account and without a certificate: `unprotected` and observer.

What sampling, the drives and the uncertainty of the account create is booked as `gen`, what they lose as `leak`, as on
one axis (`sampled_mass`). The observer counts the sum of F u T over all axes.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from math import isfinite, sqrt
from typing import Any, ClassVar, Generic, Protocol, TypeVar

from canhaptic.control.admittance.admittance_environment import AdmittanceAxis
from canhaptic.control.admittance.group_environment import AdmittanceMass
from canhaptic.control.admittance.port import AdmittanceProperties, BookedHold
from canhaptic.control.admittance.unprotected_admittance import NothingToChoose
from canhaptic.control.balance import AT_REST, Branch, Certificate, EnergyBalance
from canhaptic.control.multi_axis.group_controller import GroupBalance, group_at_rest
from canhaptic.errors import ControlError, ParameterError
from canhaptic.units import Parameters

_Vector = list[float]


class GroupMotion(Protocol):
    """Environment of a group of displays, in motor axes; see `GroupMass`."""

    damping: float

    def require(self, axes: int) -> None:
        """Check that it fits a number of axes; raise ParameterError."""

    def of_axis(self, axis: int, /) -> AdmittanceMass:
        """Return the mass on one axis, with its walls."""

    def speeds_after(self, speeds: _Vector, forces: _Vector, positions: _Vector, time: float) -> _Vector:
        """Return the speeds after another hold under the forces of the hand [m/s or rad/s]."""

    def stored(self, speeds: _Vector) -> float:
        """Return the energy of the mass [J]."""

    def lost(self, speeds: _Vector, time: float) -> float:
        """Return the energy that the damper dissipates in a time [J]."""


def require_alike(properties: Sequence[AdmittanceProperties]) -> None:
    """Require that the axes of a group share their clock.

    Raises:
        ParameterError: They do not.
    """
    if len({(p.sample_time, p.delay, p.latency) for p in properties}) > 1:
        raise ParameterError("got axes that differ in sample time, delay or force.latency, expected the same for all")


def require_finite(positions: Sequence[float], torques: Sequence[float], axes: int) -> None:
    """Require a finite sample of every axis.

    Raises:
        ControlError: It did not, or is not finite.
    """
    if not len(positions) == len(torques) == axes or not isfinite(sum((*positions, *torques))):
        raise ControlError(
            f"group controller: got positions {tuple(positions)} and applied forces {tuple(torques)}, "
            f"expected {axes} finite numbers each; the velocities are zero and the controller was reset; "
            "check encoders and force sensors"
        )


_Axis = TypeVar("_Axis", bound=AdmittanceAxis)


class AdmittanceGroup(ABC, Generic[_Axis]):
    """Common part of every `GroupController` of displays; `_answer` is the algorithm's own.

    Attributes:
        axes: Number of axes.
    """

    axes: int
    _each: list[_Axis]
    _started: bool
    _last: GroupBalance

    @property
    def energy_resolution(self) -> float:
        """Uncertainty of the sum of h_i of all axes [J]; its lower end is booked."""
        return 2.0 * sum(axis.port.doubt for axis in self._each)

    @abstractmethod
    def reset(self) -> None:
        """Return to the initial state; see `GroupController`."""

    @abstractmethod
    def sample_lost(self) -> GroupBalance:
        """Answer a SYNC at which the sample of an axis was lost: no command; see `GroupController`."""

    def lasted(self, periods: float) -> None:
        """Count skipped SYNCs as lost samples, during which the commands kept acting."""
        if self._started:
            for axis in self._each:
                axis.port.missed += round(periods) - 1

    def step(self, positions: Sequence[float], torques_applied: Sequence[float]) -> GroupBalance:
        """Account for the hold that ended; see `GroupController`. `torques_applied` are minus the forces."""
        try:
            require_finite(positions, torques_applied, self.axes)
        except ControlError:
            self.reset()
            raise
        forces = [-torque for torque in torques_applied]
        if self._started:
            self._last = self._answer(positions, forces)
            return self._last
        self._started = True
        for axis, position, force in zip(self._each, positions, forces, strict=True):
            axis.begin(position, force)
        return self._last

    @abstractmethod
    def _answer(self, positions: Sequence[float], forces: list[float]) -> GroupBalance:
        """Book the hold that ended, send the next commands and return the account of both."""


class UnprotectedAdmittanceGroup(AdmittanceGroup[AdmittanceAxis]):
    """A mass on several axes without protection; a `GroupController`.

    Args:
        environment: Environment to render.
        parameters: Parameters of the algorithm.
        properties: Declared properties of each axis; sample time, delay and latency are the same for all.

    Attributes:
        axes: Number of axes.
        energy_resolution: Uncertainty of the energy of all axes; its lower end is booked [J].

    Raises:
        ParameterError: Parts do not fit together.
    """

    parameters_type: ClassVar[type[Parameters]] = NothingToChoose
    is_certified: ClassVar[bool] = False

    def __init__(self, environment: GroupMotion, parameters: Any, properties: Sequence[AdmittanceProperties]) -> None:
        require_alike(properties)
        environment.require(len(properties))
        self.axes = len(properties)
        self._environment, self._properties, self._time = environment, tuple(properties), properties[0].sample_time
        self._parameters = parameters
        self.reset()

    def reset(self) -> None:
        """Return to the initial state; see `GroupController`."""
        self._each = [
            AdmittanceAxis(self._environment.of_axis(place), of, of.delay + 1)
            for place, of in enumerate(self._properties)
        ]
        self._slips, self._h_s, self._energy, self._started = [0.0] * self.axes, 0.0, self._begin(), False
        self._last = group_at_rest(self.axes)

    def _begin(self) -> float:
        """Initial energy of the algorithm's own [J]."""
        return 0.0

    def sample_lost(self) -> GroupBalance:
        """Answer a SYNC at which the sample of an axis was lost: no command; see `GroupController`."""
        speeds = (0.0,) * self.axes
        if self._started:
            for axis in self._each:
                axis.port.missed += 1
                axis.commands.send(0.0)
            self._slips = [0.0] * self.axes
        last = self._last.account
        return GroupBalance(speeds, AT_REST._replace(h_s=last.h_s, branch=Branch.HELD.value), speeds)

    def _answer(self, positions: Sequence[float], forces: list[float]) -> GroupBalance:
        time = self._time
        holds = [
            axis.book(position, force) for axis, position, force in zip(self._each, positions, forces, strict=True)
        ]
        before = [axis.commands.speed - slip for axis, slip in zip(self._each, self._slips, strict=True)]
        h_pas = sum(force * slip for force, slip in zip(forces, self._slips, strict=True)) * holds[0].elapsed
        self._observe(sum(force * axis.commands.speed for force, axis in zip(forces, self._each, strict=True)) * time)
        request = self._environment.speeds_after(before, forces, list(positions), time)
        request, slips = self._protected(request, forces)
        self._slips = []
        for place, (axis, hold) in enumerate(zip(self._each, holds, strict=True)):
            asked = request[place] + slips[place]
            axis.commands.send(axis.whole(axis.limited(asked, positions[place], hold.moved / hold.elapsed)))
            self._slips.append(slips[place] if abs(axis.commands.speed - asked) < abs(slips[place]) else 0.0)
        return self._closed(holds, h_pas, before)

    def _observe(self, energy: float) -> None:
        """Add the energy that came in by force and command in the hold that ended [J]."""

    def _protected(self, request: _Vector, forces: _Vector) -> tuple[_Vector, _Vector]:
        """Speeds of the mass, and additional speeds that dissipate [m/s or rad/s]."""
        return request, [0.0] * self.axes

    def _closed(self, holds: list[BookedHold], h_pas: float, before: _Vector) -> GroupBalance:
        """Return the commands with the account of the hold."""
        environment, energy = self._environment, sum(hold.energy for hold in holds)
        commands = tuple(axis.commands.speed for axis in self._each)
        own = [speed - slip for speed, slip in zip(commands, self._slips, strict=True)]
        h_s, h_r = environment.stored(own), environment.lost(before, holds[0].elapsed)
        rest = self._h_s + energy - h_pas - h_r - h_s
        self._h_s = h_s
        branch = Branch.EXACT if any(commands) or any(before) else Branch.FREE
        norm = sqrt(sum(speed * speed for speed in commands))
        account = EnergyBalance(
            norm, energy, h_pas, energy - h_pas, h_r, h_s, 0.0, max(0.0, -rest), 0.0, max(0.0, rest), 0.0, branch.value,
            environment.damping, Certificate.NONE.value, 0.0,
        )  # fmt: skip
        return GroupBalance(commands, account, tuple(hold.energy for hold in holds))


class ObservedAdmittanceGroup(UnprotectedAdmittanceGroup):
    """An unprotected group with a slip along the force whenever the observed energy falls below zero."""

    def _observe(self, energy: float) -> None:
        self._energy += energy

    def _protected(self, request: _Vector, forces: _Vector) -> tuple[_Vector, _Vector]:
        square = sum(force * force for force in forces)
        if self._energy >= 0.0 or square == 0.0:
            return request, [0.0] * self.axes
        part = -self._energy / (square * self._time)
        return request, [part * force for force in forces]
