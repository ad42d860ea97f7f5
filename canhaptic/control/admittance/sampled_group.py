"""`unprotected` and `passivity_observer` for several admittance displays with one account, and the base of such groups.

Energy created by sampling, drives and the uncertainty of the account is booked as `gen`, energy lost by them as `leak`,
as on one axis (`unprotected_admittance`). The observer sums F u T over all axes.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from math import isfinite, sqrt
from typing import Any, ClassVar, Generic, TypeVar

from canhaptic.control.admittance.admittance_environment import AdmittanceAxis, AdmittanceMass
from canhaptic.control.admittance.group_environment import GroupMass, TaskEnvironment
from canhaptic.control.admittance.port import AdmittanceProperties, BookedHold
from canhaptic.control.admittance.unprotected_admittance import NothingToChoose
from canhaptic.control.balance import AT_REST, Branch, Certificate, EnergyBalance
from canhaptic.control.multi_axis.group_controller import GroupBalance, group_at_rest
from canhaptic.errors import ControlError, ParameterError
from canhaptic.units import Parameters

_Vector = list[float]


_Axis = TypeVar("_Axis", bound=AdmittanceAxis)


class AdmittanceGroup(ABC, Generic[_Axis]):
    """Base class of a `GroupController` of displays; an algorithm implements `_answer`.

    Args:
        environment: Environment to render.
        parameters: Parameters of the algorithm.
        properties: Declared properties of each axis; sample time, delay and latency are the same for all.

    Attributes:
        axes: Number of axes.

    Raises:
        ParameterError: The axes differ in sample time, delay or latency, or do not fit the environment.
    """

    is_certified: ClassVar[bool] = False

    def __init__(
        self, environment: GroupMass | TaskEnvironment, parameters: Any, properties: Sequence[AdmittanceProperties]
    ) -> None:
        if len({(p.sample_time, p.delay, p.latency) for p in properties}) > 1:
            raise ParameterError(
                "got axes that differ in sample time, delay or force.latency, expected the same for all"
            )
        environment.require(len(properties))
        self.axes, self._time = len(properties), properties[0].sample_time
        self._environment, self._parameters, self._properties = environment, parameters, tuple(properties)
        self.reset()

    @abstractmethod
    def _begun(self, environment: AdmittanceMass, properties: AdmittanceProperties) -> _Axis:
        """Return an axis at rest."""

    def reset(self) -> None:
        """Return to the initial state; see `GroupController`."""
        self._each = [self._begun(self._environment.of_axis(axis), of) for axis, of in enumerate(self._properties)]
        self._h_s, self._started, self._last = 0.0, False, group_at_rest(self.axes)

    @property
    def energy_resolution(self) -> float:
        """Uncertainty of the sum of h_i of all axes [J]; its lower end is booked."""
        return 2.0 * sum(axis.port.doubt for axis in self._each)

    def sample_lost(self) -> GroupBalance:
        """Return the balance of a SYNC without the sample of an axis, with zero velocities; see `GroupController`."""
        speeds, last = (0.0,) * self.axes, self._last.account
        if self._started:
            self._miss()
            for axis in self._each:
                axis.commands.send(0.0)
        return GroupBalance(speeds, AT_REST._replace(h_s=last.h_s, h_dis=last.h_dis, branch=Branch.HELD.value), speeds)

    def _miss(self) -> None:
        """Account for a hold that ended without a sample."""
        for axis in self._each:
            axis.port.missed += 1

    def lasted(self, periods: float) -> None:
        """Count skipped SYNCs as lost samples, during which the commands kept acting."""
        if self._started:
            for axis in self._each:
                axis.port.missed += round(periods) - 1

    def step(self, positions: Sequence[float], torques_applied: Sequence[float]) -> GroupBalance:
        """Account for the hold that ended; see `GroupController`. `torques_applied` are minus the forces."""
        values = (*positions, *torques_applied)
        if not len(positions) == len(torques_applied) == self.axes or not isfinite(sum(values)):
            self.reset()
            raise ControlError(
                f"group controller: got positions {tuple(positions)} and applied forces {tuple(torques_applied)}, "
                f"expected {self.axes} finite numbers each; the velocities are zero and the controller was reset; "
                "check encoders and force sensors"
            )
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
    """A mass on several axes without protection."""

    parameters_type: ClassVar[type[Parameters]] = NothingToChoose

    def _begun(self, environment: AdmittanceMass, properties: AdmittanceProperties) -> AdmittanceAxis:
        return AdmittanceAxis(environment, properties, properties.delay + 1)

    def reset(self) -> None:
        """Return to the initial state; see `GroupController`."""
        super().reset()
        self._slips, self._energy = [0.0] * self.axes, self._begin()

    def _begin(self) -> float:
        """Return the initial energy of the observer or tank [J]."""
        return 0.0

    def _miss(self) -> None:
        super()._miss()
        self._slips = [0.0] * self.axes

    def _answer(self, positions: Sequence[float], forces: list[float]) -> GroupBalance:
        time = self._time
        holds = [
            axis.port.book(position, force) for axis, position, force in zip(self._each, positions, forces, strict=True)
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
        """Add the energy of the hold that ended, force times commanded velocity, to the observed energy [J]."""

    def _protected(self, request: _Vector, forces: _Vector) -> tuple[_Vector, _Vector]:
        """Return the speeds of the mass, and additional speeds that dissipate energy [m/s or rad/s]."""
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
    """An unprotected group with a slip along the force while the observed energy is below zero."""

    def _observe(self, energy: float) -> None:
        self._energy += energy

    def _protected(self, request: _Vector, forces: _Vector) -> tuple[_Vector, _Vector]:
        square = sum(force * force for force in forces)
        if self._energy >= 0.0 or square == 0.0:
            return request, [0.0] * self.axes
        part = -self._energy / (square * self._time)
        return request, [part * force for force in forces]
