"""`guarded` of admittance displays: every command is certified, by default by the drives' own velocity loops.

The promise: E, the energy that came in through all sensors, never falls below -energy_allowance, for every hand. It
relies on the declared properties of the drives (`velocity_loop`) and of the sensors (`port`), and on none of the hand.

At each SYNC

* the hold of a received force is booked with its uncertainty;
* W, the energy that the drives can still give out safely, is updated by the larger of its bounds by force and encoder;
* the environment advances under the last forces, and its speeds are reduced to the largest certified ones, by one
  factor on all axes, which keeps the direction;
* the account is reduced to the energy that the environment, or the drives with the queued commands, can give back.

A SYNC without a sample changes no command as long as it stays certified for every motion in the hold: the hold costs W
what any motion can cost, and the last command is a request like any other. With an integral the command is 0 at once.

A drive with an integral is certified as long as its torque is certain to stay below its limit. From the first hold in
which it may reach the limit, no command is certified any more, and the account uses the force alone.

If a largest force of the hand is declared (`largest_hand_force`), or the hand as a spring with damper and mass
(`hand_stiffness`), a command may be certified by that instead: see `declared_hand` and `margins`.

If the requested mass is lighter than the drives can render safely, the hand feels a heavier mass; nothing else changes.
"""

from collections.abc import Sequence
from math import inf
from typing import ClassVar, Final

from canhaptic.control.admittance.admittance_controller import AdmittanceController, Rendered, Vector
from canhaptic.control.admittance.admittance_environment import AdmittanceEnvironment
from canhaptic.control.admittance.guarded_axis import GuardedAxis
from canhaptic.control.admittance.margins import ByDeclaredHand, ByForce, ByLoop
from canhaptic.control.admittance.port import AdmittanceProperties, BookedHold
from canhaptic.control.admittance.velocity_loop import GuardedAdmittanceParameters
from canhaptic.control.balance import Certificate, GroupBalance
from canhaptic.control.passivity.stepped import settle
from canhaptic.errors import ForceContradictedError
from canhaptic.units import Parameters

_UNBOUNDED, _NONE = Certificate.EXACT.value, Certificate.NONE.value
_CHORDS: Final = 6  # each leaves only a part of the gap to the largest factor
_CLOSE: Final = 0.999  # of the budget used: near enough


class GuardedAdmittance(AdmittanceController[GuardedAxis]):
    """Controller of an environment whose every command is certified, by default by the drives' velocity loops."""

    parameters_type: ClassVar[type[Parameters]] = GuardedAdmittanceParameters
    _given: GuardedAdmittanceParameters

    def __init__(
        self, environment: Rendered, parameters: GuardedAdmittanceParameters, properties: Sequence[AdmittanceProperties]
    ) -> None:
        self.max_consecutive_losses = parameters.max_consecutive_losses
        self.energy_allowance = self._allowance = parameters.energy_allowance
        super().__init__(environment, parameters, properties)

    def _begun(self, environment: AdmittanceEnvironment, properties: AdmittanceProperties) -> GuardedAxis:
        return GuardedAxis(environment, self._given, properties)

    def reset(self) -> None:
        """Return to the initial state; see `GroupController`."""
        super().reset()
        given, latency, each = self._given, self._properties[0].latency, self._each
        self._loop = ByLoop(each, latency)
        self._force = ByForce(each, latency) if given.largest_hand_force > 0.0 else None
        self._declared = ByDeclaredHand(each) if given.hand_stiffness > 0.0 else None
        self._margins = [margin for margin in (self._loop, self._force, self._declared) if margin is not None]
        # a torque at its limit would void the proof
        self._may_be_limited = given.integral_gain > 0.0 or len(self._margins) > 1
        self._surplus = 0.0  # [J]
        self._taken = 0.0  # dissipated or leaked so far, and not paid [J]
        self._limited = 0  # SYNCs for which a force may belong to a hold in which a drive was at its torque limit
        # whether it may have been there where a certificate rests on that it is not; its integral is then unknown
        self._is_uncertain = given.integral_gain > 0.0 and any(of.jitter > 0.0 for of in self._properties)

    @property
    def left(self) -> float:
        """Most energy that may still come out [J]."""
        return self._h_s - self._surplus + self._allowance

    def sample_lost(self) -> GroupBalance:
        """Return the balance of a SYNC without the sample of an axis; see `GroupController`."""
        balance = super().sample_lost()
        return balance._replace(account=balance.account._replace(certificate=_NONE)) if self._is_uncertain else balance

    def _miss(self) -> None:
        self._let_pass([axis.unseen() for axis in self._each])
        before = self._own()
        self._send(before if self._given.integral_gain == 0.0 else [0.0] * self.axes)
        self._environment.go_along(self._inner, before, self._own(), self._time)
        self._watch_limit()

    def note_skipped_syncs(self, periods: float) -> None:
        """Update margins and states for skipped SYNCs: no command was sent, and the queued ones acted longer."""
        skipped = round(periods) - 1
        if not self._started:
            return
        self._is_uncertain = self._is_uncertain or (self._given.integral_gain > 0.0 and self._each[0].port.missed > 0)
        changes = [axis.change_of_skip(skipped) for axis in self._each]
        own = self._own()
        for number in range(skipped):
            self._let_pass([change[min(number, 1)] for change in changes])
            self._environment.go_along(self._inner, own, own, self._time)
        self._watch_limit()

    def _let_pass(self, changes: Sequence[float]) -> None:
        """Update the margins for a hold without a sample, with a lower bound on its change for each axis [J]."""
        for axis, change in zip(self._each, changes, strict=True):
            axis.let_pass()
            axis.fall(change)
        self._fall(sum(changes))

    def _answer(self, positions: Vector, forces: Vector) -> GroupBalance:
        """Book the hold that ended and send the next commands; see `AdmittanceController`.

        Raises:
            ForceContradictedError: A force sensor contradicts the encoder.
        """
        each, environment, is_first = self._each, self._environment, bool(self._each[0].port.missed)
        holds, energy, h_i = self._take(positions, forces)
        before = self._own()
        request = environment.speeds_after(self._inner, before, forces, positions, self._time)
        for place, axis in enumerate(each):
            request[place] = axis.limited(request[place], positions[place], axis.drive.velocity)
        certificate = self._send(request)
        if environment.states:
            environment.go_along(self._inner, before, self._own(), self._time)
        self._watch_limit()
        if self._is_uncertain:
            certificate = _NONE
        else:
            self._require_agreement(holds, forces, is_first=is_first)
        apart = (h_i - energy) / self.axes  # known by the encoders: of no axis alone
        interactions = tuple([hold.energy + apart for hold in holds])
        return self._closed(self._settled(h_i, before, positions), interactions, before, positions, certificate)

    def _take(self, positions: Vector, forces: Vector) -> tuple[list[BookedHold], float, float]:
        """Book the hold that ended on every axis and update the margins.

        Returns:
            The holds, the energy received by the forces, and the energy received [J].
        """
        each, loop, declared, at_limit = self._each, self._loop, self._declared, self._limited > 0
        booked_to = [] if declared is None else [(axis.port.origin, axis.port.force) for axis in each]
        holds, energy, fallen = list[BookedHold](), 0.0, 0.0
        for axis, position, force in zip(each, positions, forces, strict=True):
            hold, change = axis.take(position, force)
            axis.fall(change)
            holds.append(hold)
            energy += hold.energy
            fallen += change
        self._fall(fallen)
        if self._is_uncertain or not holds[0].is_booked:
            return holds, energy, energy
        free, then = self._h_s - self._surplus, loop.oldest()
        late = free + energy
        if declared is not None:
            heard = zip(each, booked_to, strict=True)
            declared.hear(late, [axis.heard(*since, at_limit=at_limit) for axis, since in heard])
        kept = 0.0
        for axis, hold in zip(each, holds, strict=True):
            kept += axis.loop.reserve(axis.leads[then], hold.speed)
        loop.rise(then, late - kept, self._taken)
        if self._force is not None:
            kept = sum([axis.force.reserve(hold.speed) for axis, hold in zip(each, holds, strict=True)])
            self._force.rise(then, late - kept, self._taken)
        proved = loop.before[then] - self._taken
        if proved <= late:
            return holds, energy, late - free
        for axis in each:
            axis.port.reopen()
        return holds, energy, proved - free

    def _require_agreement(self, holds: Sequence[BookedHold], forces: Sequence[float], *, is_first: bool) -> None:
        """Check that the measured force of every axis agrees with its motion.

        Raises:
            ForceContradictedError: A force contradicts the motion.
        """
        for number, (axis, hold, force) in enumerate(zip(self._each, holds, forces, strict=True), 1):
            of = "force sensor" if self.axes == 1 else f"force sensor of motor axis {number}"
            if text := axis.contradiction(of, hold, force, is_first=is_first):
                self.reset()
                raise ForceContradictedError(text)

    def _fall(self, change: float) -> None:
        """Update the margins for the hold that ended, with a lower bound on the change of W in it [J]."""
        self._loop.fall(change, self._taken)
        if self._force is not None:
            is_in_doubt = self._limited > self._properties[0].latency
            self._force.fall(-inf if is_in_doubt else -self._force.lost(), self._taken)
        self._limited = max(0, self._limited - 1)
        if self._declared is not None:
            for axis in self._each:
                axis.declared.go_on(axis.commands.sent(axis.loop.delay))

    def _send(self, request: Sequence[float]) -> int:
        """Send the largest certified part of the requested speeds; return the certificate that limits it.

        One axis has closed forms. Several are searched along the request: the loss is convex in the factor, so that the
        chord between a permitted factor and a larger one that is not permitted leads to a permitted factor between.
        """
        alone = self._each[0] if self.axes == 1 else None
        size, best, found = 1.0 if alone is None else abs(request[0]), -1.0, _UNBOUNDED
        if alone is None:
            for axis, speed in zip(self._each, request, strict=True):
                axis.commands.send(axis.whole(speed))
            request = self._own()
        for margin in self._margins:
            budget = margin.known + self._allowance
            most = self._share(margin, request, budget) if alone is None else margin.fastest(request[0], budget)
            if size <= most:
                best, found = size, _UNBOUNDED if margin is self._loop else margin.certificate
                break
            if most > best:
                best, found = most, margin.certificate
        if alone is None:
            self._put(request, best)
        else:
            alone.commands.send(alone.whole(best if request[0] >= 0.0 else -best))
        return found

    def _share(self, margin: ByLoop | ByForce | ByDeclaredHand, request: Sequence[float], budget: float) -> float:
        """Return the largest factor of the request found whose use of a margin is within a budget [J]."""
        self._put(request, 1.0)
        low, high, above = 0.0, 1.0, margin.used()
        if above <= budget:
            return 1.0
        self._put(request, 0.0)
        below = margin.used()
        for _ in range(_CHORDS if below <= budget else 0):
            part = low + (high - low) * (budget - below) / (above - below)
            self._put(request, part)
            used = margin.used()
            if used > budget:  # by rounding
                high, above = part, used
                continue
            low, below = part, used
            if used >= _CLOSE * budget:
                break
        return low

    def _put(self, request: Sequence[float], part: float) -> None:
        """Make `part` times the request the newest commands."""
        for axis, speed in zip(self._each, request, strict=True):
            axis.commands[axis.commands.newest] = axis.commands.speed = axis.whole(part * speed)

    def _watch_limit(self) -> None:
        """Withdraw certificates that are void at the torque limit, if a newest command may drive a torque there.

        Without an integral, the velocity loops alone may certify all queued commands; then none is withdrawn.
        """
        loop = self._each[0].loop
        if not self._may_be_limited or not any(
            axis.loop.may_limit(axis.drive, axis.commands.speed, axis.port.missed) for axis in self._each
        ):
            return
        self._limited = loop.delay + 1 + loop.losses + self._properties[0].latency
        if loop.integral > 0.0:
            self._is_uncertain = True
        elif not self._is_uncertain:
            self._is_uncertain = self._loop.used() > self._loop.known + self._allowance

    def _settled(self, h_i: float, before: Vector, positions: Vector) -> tuple[float, ...]:
        """Write off energy that neither environment nor drives can return to the hand, as dissipated or leaked.

        Args:
            h_i: Energy received in the hold [J].
            before: Commands before the newest [m/s or rad/s].
            positions: Position of each axis [m or rad].

        Returns:
            The terms of `EnergyBalance` from h_i to paid [J].
        """
        environment, h_s, lost = self._environment, self._h_s + h_i, 0.0
        under_way = self._loop.used()
        slack, ceiling = self._loop.known + self._allowance - under_way, 0.0
        for axis in self._each:  # at the largest speed that the handle may have now
            ceiling += axis.reserve(abs(axis.drive.velocity) + axis.properties.handle_acceleration * self._time)
        ceiling += under_way
        if h_s > ceiling:  # what came in late belongs to commands that may be under way still
            sent = max(zip(*[axis.commands for axis in self._each], strict=True), key=_square)
            ceiling = max(environment.stored(self._inner, list(sent), positions), ceiling)
            # the damper's loss pays for the uncertainty of the force first
            lost = min(environment.lost(before, self._time), max(0.0, h_s - ceiling))
        for margin in self._margins[1:]:
            slack = max(slack, margin.known + self._allowance - margin.used())
        h_s, surplus, h_r, deficit, leak, paid = settle(h_s, self._surplus, lost, ceiling, slack)
        taken = h_r + leak - paid
        for margin in self._margins:
            margin.known -= taken
        self._taken += taken
        self._h_s, self._surplus = h_s, surplus
        return h_i, 0.0, h_i, h_r, h_s, surplus, 0.0, deficit, leak, paid


def _square(speeds: Sequence[float]) -> float:
    return sum([speed * speed for speed in speeds])
