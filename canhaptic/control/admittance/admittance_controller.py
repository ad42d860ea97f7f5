"""Controllers of admittance displays, on one axis or several with a common energy account.

A controller keeps the interface of a group (`canhaptic.control.multi_axis.group_controller`): `torques_applied` are
the forces of the display on the hand, minus the readings of the sensors, and the `torques` of its balance are the
commanded velocities [m/s or rad/s]. `OneDisplay` gives it the interface of an axis. Energy that entered at one axis may
leave at another.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from math import inf, isfinite, sqrt
from typing import Any, Final, Generic, Protocol, TypeVar

from canhaptic.control.admittance.admittance_environment import AdmittanceAxis, AdmittanceEnvironment
from canhaptic.control.admittance.port import AdmittanceProperties
from canhaptic.control.balance import Branch, EnergyBalance, GroupBalance, group_at_rest, held
from canhaptic.control.environments import plain
from canhaptic.errors import ControlError, ParameterError
from canhaptic.kernels import Buffer, list_of_zeros, new

Vector = list[float]
_Inner = list[Buffer]
_Axis = TypeVar("_Axis", bound=AdmittanceAxis)
_DEPLETED, _FREE, _EXACT = Branch.DEPLETED.value, Branch.FREE.value, Branch.EXACT.value


class Rendered(Protocol):
    """What a controller renders: `GroupEnvironment`, `TaskEnvironment`, or `OnOneAxis`."""

    damping: float
    states: int

    def require(self, axes: int) -> None:
        """Check the environment against the number of axes; see `GroupEnvironment`."""

    def of_axis(self, axis: int) -> AdmittanceEnvironment:
        """Return the walls and the damper of one axis."""

    def speeds_after(self, inner: _Inner, speeds: Vector, forces: Vector, positions: Vector, time: float) -> Vector:
        """Return the speeds after another hold; see `GroupEnvironment`."""

    def go_along(self, inner: _Inner, before: Vector, speeds: Vector, time: float) -> None:
        """Advance the states by a hold; see `GroupEnvironment`."""

    def stored(self, inner: _Inner, speeds: Vector, positions: Vector) -> float:
        """Return the stored energy [J]."""

    def lost(self, speeds: Vector, time: float) -> float:
        """Return the energy that the damper dissipates in a time [J]."""

    def stretch(self, positions: Vector) -> float:
        """Return the displacement of the spring of a single axis, for logs [m or rad]."""


class OnOneAxis:
    """An environment of one axis, in the form of one of several."""

    def __init__(self, environment: AdmittanceEnvironment) -> None:
        self._alone: AdmittanceEnvironment = plain(environment)
        self.damping, self.states = self._alone.damping, self._alone.states

    def require(self, axes: int) -> None:
        """Accept its one axis."""

    def of_axis(self, axis: int) -> AdmittanceEnvironment:
        """Return the environment."""
        return self._alone

    def speeds_after(self, inner: _Inner, speeds: Vector, forces: Vector, positions: Vector, time: float) -> Vector:
        """Return the speed after another hold [m/s or rad/s]."""
        return [self._alone.speed_after(inner[0], speeds[0], forces[0], positions[0], time)]

    def go_along(self, inner: _Inner, before: Vector, speeds: Vector, time: float) -> None:
        """Advance the states by a hold."""
        self._alone.go_along(inner[0], before[0], speeds[0], time)

    def stored(self, inner: _Inner, speeds: Vector, positions: Vector) -> float:
        """Return the stored energy [J]."""
        return self._alone.stored(inner[0], speeds[0], positions[0])

    def lost(self, speeds: Vector, time: float) -> float:
        """Return the energy that the damper dissipates in a time [J]."""
        return self.damping * speeds[0] * speeds[0] * time

    def stretch(self, positions: Vector) -> float:
        """Return the displacement of the spring [m or rad]."""
        return self._alone.stretch(positions[0])


class AdmittanceController(ABC, Generic[_Axis]):
    """Base class of the controllers (`GroupController`) of displays; a subclass implements `_answer` and `_miss`.

    Args:
        environment: Environment to render.
        parameters: Parameters of the algorithm.
        properties: Declared properties of each axis; sample time, delay and latency are the same for all.

    Attributes:
        axes: Number of axes.

    Raises:
        ParameterError: The axes differ in sample time, delay or latency, or do not fit the environment.
    """

    def __init__(self, environment: Rendered, parameters: Any, properties: Sequence[AdmittanceProperties]) -> None:
        if len({(p.sample_time, p.delay, p.latency) for p in properties}) > 1:
            raise ParameterError(
                "axes: got different sample times, delays or force.latency, expected the same for all; give every axis "
                "the same values"
            )
        environment.require(len(properties))
        self.axes, self._time = len(properties), properties[0].sample_time
        self._environment, self._given, self._properties = environment, plain(parameters), tuple(properties)
        self.reset()

    @staticmethod
    def rendered(environment: Any) -> Any:
        """Return an environment of a scene in the form that the algorithm renders."""
        return environment

    @abstractmethod
    def _begun(self, environment: AdmittanceEnvironment, properties: AdmittanceProperties) -> _Axis:
        """Return the account and commands of one axis, at rest."""

    def reset(self) -> None:
        """Return to the initial state; see `GroupController`."""
        self._each = [self._begun(self._environment.of_axis(axis), of) for axis, of in enumerate(self._properties)]
        self._inner = [list_of_zeros(self._environment.states) for _ in self._each]
        self._h_s, self._started, self._last = 0.0, False, group_at_rest(self.axes)

    def fade(self, share: float) -> None:
        """Limit the speed of every axis to a share of its largest one, from the next step on: a stop ends so."""
        for axis in self._each:
            axis.most = share * axis.properties.speed_limit

    @property
    def energy_resolution(self) -> float:
        """Width of the range that contains the energy received on all axes [J]; the account books its lower end."""
        return 2.0 * sum(axis.port.uncertainty for axis in self._each)

    def sample_lost(self) -> GroupBalance:
        """Return the balance of a SYNC without the sample of an axis; see `GroupController`."""
        if self._started:
            self._miss()
        commands = tuple([axis.commands.speed for axis in self._each])
        return GroupBalance(commands, held(self._last.account, _size(commands)), (0.0,) * self.axes)

    def _own(self) -> Vector:
        """Return the last commands without speeds that the algorithm added to dissipate energy [m/s or rad/s]."""
        return [axis.commands.speed for axis in self._each]

    @abstractmethod
    def _miss(self) -> None:
        """Update the state for a hold that ended without a sample, and send the next commands."""

    def note_skipped_syncs(self, periods: float) -> None:
        """Treat skipped SYNCs as lost samples, during which the last commands continued to act."""
        skipped, own = (round(periods) - 1) * self._started, self._own()
        for axis in self._each:
            axis.port.missed += skipped
        for _ in range(skipped):
            self._environment.go_along(self._inner, own, own, self._time)

    def step(self, positions: Sequence[float], torques_applied: Sequence[float]) -> GroupBalance:
        """Book the hold that ended and send the next commands; see `GroupController`.

        `torques_applied` are minus the forces of the sensors.
        """
        if not len(positions) == len(torques_applied) == self.axes or not isfinite(
            sum(positions) + sum(torques_applied)
        ):
            self.reset()
            raise ControlError(
                f"controller: got positions {tuple(positions)} and applied forces {tuple(torques_applied)}, expected "
                f"finite numbers, one each for {self.axes} axes; the velocity is zero and the controller was reset; "
                "check encoders, force sensors and their scaling"
            )
        forces = [-torque for torque in torques_applied]
        if not self._started:
            self._started = True
            for axis, position, force in zip(self._each, positions, forces, strict=True):
                axis.begin(position, force)
            return self._last
        self._last = balance = self._answer(list(positions), forces)
        if not isfinite(balance.account.torque):
            self.reset()
            raise ControlError(
                f"controller: computed velocities {balance.torques}, expected finite numbers; the velocity is zero and "
                "the controller was reset; check mass and damping against the forces"
            )
        return balance

    @abstractmethod
    def _answer(self, positions: Vector, forces: Vector) -> GroupBalance:
        """Book the hold that ended, send the next commands and return both with the energy balance."""

    def _closed(
        self, energies: tuple[float, ...], interactions: tuple[float, ...], before: Vector, positions: Vector,
        certificate: int,
    ) -> GroupBalance:  # fmt: skip
        """Return the commands with the balance of the hold that ended.

        Args:
            energies: The terms of `EnergyBalance` from h_i to paid [J].
            interactions: Energy received on each axis [J].
            before: Commands before the newest [m/s or rad/s].
            positions: Position of each axis [m or rad].
            certificate: Number of the `Certificate` of the commands.
        """
        environment, commands = self._environment, tuple([axis.commands.speed for axis in self._each])
        branch = _DEPLETED if energies[_DEFICIT] > 0.0 else _EXACT if any(commands) or any(before) else _FREE
        account = new(EnergyBalance, (
            _size(commands), *energies, branch, environment.damping, certificate, environment.stretch(positions), 0.0,
        ))  # fmt: skip
        return new(GroupBalance, (commands, account, interactions, 0.0, 0))


_DEFICIT: Final = EnergyBalance._fields.index("deficit") - 1


def _size(commands: Sequence[float]) -> float:
    """Return one command with its sign, of several their Euclidean norm [m/s or rad/s]."""
    return commands[0] if len(commands) == 1 else sqrt(sum(speed * speed for speed in commands))


class OneDisplay:
    """A controller of one axis with the interface of an axis (`canhaptic.control.passivity.Controller`)."""

    def __init__(self, controller: Any) -> None:
        self.of = controller
        self.reset, self.note_skipped_syncs, self.fade = (
            controller.reset,
            controller.note_skipped_syncs,
            controller.fade,
        )
        for name in ("max_consecutive_losses", "energy_allowance"):
            if hasattr(controller, name):
                setattr(self, name, getattr(controller, name))

    def step(self, position: float, torque_applied: float) -> EnergyBalance:
        """Book the hold that ended and send the next command; see `Controller.step`.

        `torque_applied` is minus the force of the sensor.
        """
        account: EnergyBalance = self.of.step((position,), (torque_applied,)).account
        return account

    def sample_lost(self) -> EnergyBalance:
        """Return the balance of a SYNC without a sample; see `Controller.sample_lost`."""
        account: EnergyBalance = self.of.sample_lost().account
        return account

    @property
    def energy_resolution(self) -> float:
        """Width of the range that contains the energy received so far [J]; the account books its lower end."""
        return float(self.of.energy_resolution)

    @property
    def releasable(self) -> float:
        """Most energy that may still come out [J]; infinite without a certificate."""
        return float(getattr(self.of, "left", inf))
