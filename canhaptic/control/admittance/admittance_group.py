"""Algorithms for admittance displays with a common energy account: `unprotected`, `passivity_observer` and `guarded`.

Energy that entered at one axis may leave at another. Without a certificate, energy created by sampling, drives and the
uncertainty of the account is booked as `gen`, energy lost by them as `leak`, as on one axis
(`unprotected_admittance`). The observer sums F u T over all axes.

`guarded`: each axis has its own drive, so that the margins of `velocity_loop` add up, W = E - sum V_i, and so do the
losses of all queued commands. A request whose loss exceeds the margin is reduced by one factor on all axes, which keeps
its direction. The loss is convex in the factor, so that the chord between a permitted factor and a larger one that is
not permitted leads to a permitted factor between them.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from math import isfinite, sqrt
from typing import Any, ClassVar, Final, Generic, TypeVar

from canhaptic.control.admittance.admittance_environment import AdmittanceAxis, AdmittanceEnvironment
from canhaptic.control.admittance.group_environment import GroupEnvironment, TaskEnvironment
from canhaptic.control.admittance.guarded_admittance import GuardedAxis, LateMargin
from canhaptic.control.admittance.port import AdmittanceProperties, BookedHold
from canhaptic.control.admittance.unprotected_admittance import NothingToChoose
from canhaptic.control.admittance.velocity_loop import GuardedAdmittanceParameters
from canhaptic.control.balance import AT_REST, Branch, Certificate, EnergyBalance
from canhaptic.control.multi_axis.group_controller import GroupBalance, group_at_rest
from canhaptic.control.passivity.stepped import settle
from canhaptic.errors import ControlError, ForceContradictedError, ParameterError
from canhaptic.kernels import list_of_zeros
from canhaptic.units import Parameters

_Vector = list[float]


_Axis = TypeVar("_Axis", bound=AdmittanceAxis)


class AdmittanceGroup(ABC, Generic[_Axis]):
    """Base class of the controllers (`GroupController`) of several displays; a subclass implements `_answer`.

    Args:
        environment: Environment to render.
        parameters: Parameters of the algorithm.
        properties: Declared properties of each axis; sample time, delay and latency are the same for all.

    Attributes:
        axes: Number of axes.

    Raises:
        ParameterError: The axes differ in sample time, delay or latency, or do not fit the environment.
    """

    def __init__(
        self,
        environment: GroupEnvironment | TaskEnvironment,
        parameters: Any,
        properties: Sequence[AdmittanceProperties],
    ) -> None:
        if len({(p.sample_time, p.delay, p.latency) for p in properties}) > 1:
            raise ParameterError(
                "axes: got different sample times, delays or force.latency, expected the same for all; give every axis "
                "the same values"
            )
        environment.require(len(properties))
        self.axes, self._time = len(properties), properties[0].sample_time
        self._environment, self._parameters, self._properties = environment, parameters, tuple(properties)
        self.reset()

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
        return 2.0 * sum(axis.port.doubt for axis in self._each)

    def sample_lost(self) -> GroupBalance:
        """Return the balance of a SYNC without the sample of an axis, with zero velocities; see `GroupController`."""
        speeds, last = (0.0,) * self.axes, self._last.account
        if self._started:
            before = self._own()
            self._miss()
            for axis in self._each:
                axis.commands.send(0.0)
            self._environment.go_along(self._inner, before, list(speeds), self._time)
        return GroupBalance(speeds, AT_REST._replace(h_s=last.h_s, h_dis=last.h_dis, branch=Branch.HELD.value), speeds)

    def _own(self) -> _Vector:
        """Return the last commands without speeds that the algorithm added to dissipate energy [m/s or rad/s]."""
        return [axis.commands.speed for axis in self._each]

    def _miss(self) -> None:
        """Update the state for a hold that ended without a sample."""
        for axis in self._each:
            axis.port.missed += 1

    def lasted(self, periods: float) -> None:
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
        """Book the hold that ended, send the next commands and return both with the energy balance."""


class UnprotectedAdmittanceGroup(AdmittanceGroup[AdmittanceAxis]):
    """Controller that renders an environment on several axes and does nothing to stay passive."""

    parameters_type: ClassVar[type[Parameters]] = NothingToChoose

    def _begun(self, environment: AdmittanceEnvironment, properties: AdmittanceProperties) -> AdmittanceAxis:
        return AdmittanceAxis(environment, properties, properties.delay + 1)

    def reset(self) -> None:
        """Return to the initial state; see `GroupController`."""
        super().reset()
        self._slips, self._energy = [0.0] * self.axes, self._begin()

    def _begin(self) -> float:
        """Return the initial energy of a subclass's observer or tank [J]."""
        return 0.0

    def _own(self) -> _Vector:
        return [axis.commands.speed - slip for axis, slip in zip(self._each, self._slips, strict=True)]

    def _miss(self) -> None:
        super()._miss()
        self._slips = [0.0] * self.axes

    def _answer(self, positions: Sequence[float], forces: list[float]) -> GroupBalance:
        time = self._time
        holds = [
            axis.port.book(position, force) for axis, position, force in zip(self._each, positions, forces, strict=True)
        ]
        before = self._own()
        h_pas = sum(force * slip for force, slip in zip(forces, self._slips, strict=True)) * holds[0].elapsed
        self._observe(sum(force * axis.commands.speed for force, axis in zip(forces, self._each, strict=True)) * time)
        request = self._environment.speeds_after(self._inner, before, forces, list(positions), time)
        request, slips = self._protected(request, forces)
        self._slips = []
        for place, (axis, hold) in enumerate(zip(self._each, holds, strict=True)):
            asked = request[place] + slips[place]
            axis.commands.send(axis.whole(axis.limited(asked, positions[place], hold.moved / hold.elapsed)))
            self._slips.append(slips[place] if abs(axis.commands.speed - asked) < abs(slips[place]) else 0.0)
        self._environment.go_along(self._inner, before, self._own(), time)
        return self._closed(holds, h_pas, before, list(positions))

    def _observe(self, energy: float) -> None:
        """Add the energy of the hold that ended, force times commanded velocity, to the observed energy [J]."""

    def _protected(self, request: _Vector, forces: _Vector) -> tuple[_Vector, _Vector]:
        """Return the requested speeds, limited by the algorithm, and added speeds that dissipate [m/s or rad/s]."""
        return request, [0.0] * self.axes

    def _closed(self, holds: list[BookedHold], h_pas: float, before: _Vector, positions: _Vector) -> GroupBalance:
        """Return the commands with the energy balance of the hold that ended."""
        environment, energy = self._environment, sum(hold.energy for hold in holds)
        commands = tuple(axis.commands.speed for axis in self._each)
        h_s, h_r = environment.stored(self._inner, self._own(), positions), environment.lost(before, holds[0].elapsed)
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
    """Passivity observer on several axes: adds velocity along the force (slip) while its energy is below zero."""

    def _observe(self, energy: float) -> None:
        self._energy += energy

    def _protected(self, request: _Vector, forces: _Vector) -> tuple[_Vector, _Vector]:
        square = sum(force * force for force in forces)
        if self._energy >= 0.0 or square == 0.0:
            return request, [0.0] * self.axes
        part = -self._energy / (square * self._time)
        return request, [part * force for force in forces]


_CHORDS: Final = 6  # each leaves only a part of the gap to the largest factor
_CLOSE: Final = 0.999  # of the budget used: near enough


class GuardedAdmittanceGroup(AdmittanceGroup[GuardedAxis]):
    """Controller of an environment on several axes, whose commands the drives' velocity loops certify."""

    parameters_type: ClassVar[type[Parameters]] = GuardedAdmittanceParameters
    _parameters: GuardedAdmittanceParameters

    def __init__(
        self, environment: GroupEnvironment | TaskEnvironment, parameters: GuardedAdmittanceParameters,
        properties: Sequence[AdmittanceProperties],
    ) -> None:  # fmt: skip
        for key in ("largest_hand_force", "hand_stiffness"):
            if getattr(parameters, key):
                raise ParameterError(
                    f"guarded: {key}: got {getattr(parameters, key):g}, expected 0 for several axes: "
                    "the proof for such a hand covers one axis only; leave it out"
                )
        self._allowance = self.energy_allowance = parameters.energy_allowance
        self.max_consecutive_losses = parameters.max_consecutive_losses
        super().__init__(environment, parameters, properties)

    def _begun(self, environment: AdmittanceEnvironment, properties: AdmittanceProperties) -> GuardedAxis:
        return GuardedAxis(environment, self._parameters, properties)

    def reset(self) -> None:
        """Return to the initial state; see `GroupController`."""
        super().reset()
        self._margin, self._surplus, self._taken = LateMargin(self._properties[0].latency), 0.0, 0.0
        uneven = any(of.jitter > 0.0 for of in self._properties)  # the integral of the drive is then unknown
        self._is_unsure = uneven and self._parameters.integral_gain > 0.0

    def sample_lost(self) -> GroupBalance:
        """Return the balance of a SYNC without the sample of an axis, with zero velocities; see `GroupController`."""
        balance = super().sample_lost()
        if self._started:
            self._watch_limit()
        return balance

    def _miss(self) -> None:
        self._let_pass([axis.unseen() for axis in self._each])

    def lasted(self, periods: float) -> None:
        """Update margin and states for skipped SYNCs: no command was sent, and the queued ones acted longer."""
        skipped = round(periods) - 1
        if not self._started:
            return
        self._is_unsure = self._is_unsure or any(axis.port.missed and axis.loop.integral for axis in self._each)
        changes = [axis.change_of_skip(skipped) for axis in self._each]
        own = self._own()
        for number in range(skipped):
            self._let_pass([change[min(number, 1)] for change in changes])
            self._environment.go_along(self._inner, own, own, self._time)
        self._watch_limit()

    def _let_pass(self, changes: Sequence[float]) -> None:
        """Update the margin for a hold without a sample, with a lower bound on its change for each axis [J]."""
        for axis in self._each:
            axis.let_pass()
        self._fall(changes)

    def _answer(self, positions: Sequence[float], forces: list[float]) -> GroupBalance:
        is_first = bool(self._each[0].port.missed)
        holds, h_i = self._take(positions, forces)
        before = self._own()
        velocities = [hold.moved / hold.elapsed for hold in holds]
        request = self._environment.speeds_after(self._inner, before, forces, list(positions), self._time)
        limits = zip(self._each, request, positions, velocities, strict=True)
        certificate = self._send([axis.whole(axis.limited(*of)) for axis, *of in limits])
        self._environment.go_along(self._inner, before, self._own(), self._time)
        self._watch_limit()
        if self._is_unsure:
            certificate = Certificate.NONE.value
        else:
            self._require_agreement(holds, forces, is_first=is_first)
        account = self._settle(h_i, before, velocities, list(positions), certificate)
        commands = tuple(axis.commands.speed for axis in self._each)
        apart = (h_i - sum(hold.energy for hold in holds)) / self.axes  # known by the encoders: of no axis alone
        return GroupBalance(commands, account, tuple(hold.energy + apart for hold in holds))

    def _take(self, positions: Sequence[float], forces: Sequence[float]) -> tuple[list[BookedHold], float]:
        """Book the hold that ended on every axis and update the margin; return the holds and received energy [J]."""
        taken = [
            axis.take(position, force) for axis, position, force in zip(self._each, positions, forces, strict=True)
        ]
        holds = [hold for hold, _ in taken]
        self._fall([change for _, change in taken])
        energy = sum(hold.energy for hold in holds)
        if self._is_unsure or not holds[0].is_booked:
            return holds, energy
        then, free = self._margin.oldest(), self._h_s - self._surplus
        kept = [axis.loop.reserve(axis.leads[then], hold.speed) for axis, hold in zip(self._each, holds, strict=True)]
        self._margin.rise(then, free + energy - sum(kept), self._taken)
        proved = self._margin.before[then] - self._taken
        if proved <= free + energy:
            return holds, energy
        for axis in self._each:
            axis.port.reopen()
        return holds, proved - free

    def _require_agreement(self, holds: Sequence[BookedHold], forces: Sequence[float], *, is_first: bool) -> None:
        """Check that the measured force of every axis agrees with its motion.

        Raises:
            ForceContradictedError: A force contradicts the motion.
        """
        for number, (axis, hold, force) in enumerate(zip(self._each, holds, forces, strict=True), 1):
            text = axis.contradiction(f"force sensor of motor axis {number}", hold, force, is_first=is_first)
            if text:
                self.reset()
                raise ForceContradictedError(text)

    def _fall(self, changes: Sequence[float]) -> None:
        self._margin.fall(sum(changes), self._taken)
        for axis, change in zip(self._each, changes, strict=True):
            axis.fall(change)

    def _send(self, request: Sequence[float]) -> int:
        """Send the requested speeds, scaled by the largest certified factor; return the certificate that limits it."""
        for axis, speed in zip(self._each, request, strict=True):
            axis.commands.send(speed)
        budget, used = self._margin.known + self._allowance, sum(axis.used() for axis in self._each)
        if used <= budget:
            return Certificate.EXACT.value
        low, high, above = 0.0, 1.0, used
        below = self._used_at(request, 0.0)
        for _ in range(_CHORDS if below <= budget else 0):
            part = low + (high - low) * (budget - below) / (above - below)
            used = self._used_at(request, part)
            if used > budget:  # by rounding
                high, above = part, used
                continue
            low, below = part, used
            if used >= _CLOSE * budget:
                break
        self._used_at(request, low)
        return Certificate.VELOCITY_LOOP.value

    def _used_at(self, request: Sequence[float], part: float) -> float:
        """Make `part` times the request the newest commands; return the margin that all queued ones can use up [J]."""
        for axis, speed in zip(self._each, request, strict=True):
            axis.commands[axis.commands.newest] = axis.commands.speed = axis.whole(part * speed)
        return sum(axis.used() for axis in self._each)

    def _watch_limit(self) -> None:
        """Withdraw the certificate if a drive with an integral may reach its torque limit."""
        for axis in self._each:
            if axis.loop.integral > 0.0 and not self._is_unsure:
                self._is_unsure = axis.loop.may_limit(axis.drive, axis.commands.speed, axis.port.missed)

    def _settle(
        self, h_i: float, before: _Vector, velocities: Sequence[float], positions: _Vector, certificate: int
    ) -> EnergyBalance:
        """Write off energy that neither environment nor drives can return to the hand; return the energy balance."""
        environment, under_way = self._environment, sum(axis.used() for axis in self._each)
        speeds, inner, ceiling, lost = self._own(), self._inner, under_way, 0.0
        for axis, velocity in zip(self._each, velocities, strict=True):
            ceiling += axis.reserve(abs(velocity) + axis.properties.handle_acceleration * self._time)
        if self._h_s + h_i > ceiling:
            stored = environment.stored(inner, speeds, positions), environment.stored(inner, before, positions)
            ceiling = max(*stored, ceiling)  # the damper's loss pays for the uncertainty of the force first
            lost = min(environment.lost(before, self._time), max(0.0, self._h_s + h_i - ceiling))
        slack = self._margin.known + self._allowance - under_way
        h_s, surplus, h_r, deficit, leak, paid = settle(self._h_s + h_i, self._surplus, lost, ceiling, slack)
        taken = h_r + leak - paid
        self._margin.known -= taken
        self._taken += taken
        self._h_s, self._surplus = h_s, surplus
        is_still = not any(speeds) and not any(before)
        branch = Branch.DEPLETED if deficit > 0.0 else Branch.FREE if is_still else Branch.EXACT
        norm = sqrt(sum(speed * speed for speed in speeds))
        return EnergyBalance(
            norm, h_i, 0.0, h_i, h_r, h_s, surplus, 0.0, deficit, leak, paid, branch.value, environment.damping,
            certificate, 0.0,
        )  # fmt: skip
