"""`guarded` of an admittance display: a virtual mass whose every command is certified by the drive's own velocity loop.

The promise: E, the energy that came in through the sensor, never falls below -energy_allowance, for every hand. It
relies on the declared properties of the drive (`velocity_loop`) and of the sensor (`port`), and on none of the hand.

At each SYNC

* the hold of a received force is booked with its uncertainty;
* W, the energy that the drive can still give out safely, is updated by the larger of its bounds by force and encoder;
* the virtual mass advances under the last force, and its speed is reduced to the largest certified one;
* the account is reduced to the energy that the mass, or the drive with the queued commands, can give back.

A drive with an integral is certified as long as its torque is certain to stay below its limit. From the first hold in
which it may reach the limit, no command is certified any more, and the account uses the force alone.

If a largest force of the hand is declared (`largest_hand_force`), or the hand as a spring with damper and mass
(`hand_stiffness`), a command may be certified by that instead: see `declared_hand`.

If the requested mass is lighter than the drive can render safely, the hand feels a heavier mass; nothing else changes.
"""

from math import inf
from typing import ClassVar

from canhaptic.control.admittance.admittance_environment import AdmittanceController, AdmittanceEnvironment
from canhaptic.control.admittance.declared_hand import DeclaredHand, HeardForce, LargestForce
from canhaptic.control.admittance.guarded_axis import GuardedAxis, LateMargin
from canhaptic.control.admittance.port import AdmittanceProperties, BookedHold
from canhaptic.control.admittance.velocity_loop import GuardedAdmittanceParameters
from canhaptic.control.balance import AT_REST, Branch, Certificate, EnergyBalance
from canhaptic.control.passivity.stepped import settle
from canhaptic.errors import ForceContradictedError
from canhaptic.kernels import new
from canhaptic.units import Parameters

_EXACT, _DEPLETED, _FREE = Branch.EXACT.value, Branch.DEPLETED.value, Branch.FREE.value
_UNBOUNDED, _NONE = Certificate.EXACT.value, Certificate.NONE.value
_BY_LOOP, _BY_HAND = Certificate.VELOCITY_LOOP.value, Certificate.LARGEST_HAND_FORCE.value
_BY_DECLARED = Certificate.DECLARED_HAND.value


class GuardedAdmittance(AdmittanceController):
    """A virtual mass with the certificate of the drive's velocity loop."""

    parameters_type: ClassVar[type[Parameters]] = GuardedAdmittanceParameters
    _display: GuardedAxis
    _given: GuardedAdmittanceParameters

    def __init__(
        self,
        environment: AdmittanceEnvironment,
        parameters: GuardedAdmittanceParameters,
        properties: AdmittanceProperties,
    ) -> None:
        self.max_consecutive_losses = parameters.max_consecutive_losses
        self.energy_allowance = self._allowance = parameters.energy_allowance
        self._hand_force, self._is_declared = parameters.largest_hand_force, parameters.hand_stiffness > 0.0
        # a torque at its limit would void the proof
        self._may_be_limited = parameters.integral_gain > 0.0 or self._hand_force > 0.0 or self._is_declared
        super().__init__(environment, parameters, properties)

    def _begun(self) -> GuardedAxis:
        return GuardedAxis(self._environment, self._given, self._properties)

    def reset(self) -> None:
        """Clear the state; see `Controller.reset`."""
        super().reset()
        latency = self._properties.latency
        self._margin, self._hand = LateMargin(latency), LateMargin(latency)  # E - V, E - G
        self._declared = DeclaredHand(self._given, self._display.loop, self._properties)
        self._force = LargestForce(self._hand_force, self._display.loop)
        self._h_s = self._surplus = 0.0  # [J]
        self._taken = 0.0  # dissipated or leaked so far, and not paid [J]
        self._limited = 0  # SYNCs for which a force may belong to a hold in which the drive was at its torque limit
        # whether it may have been there where a certificate rests on that it is not; its integral is then unknown
        self._is_unsure = self._display.loop.integral > 0.0 and self._properties.jitter > 0.0

    def _account(self, position: float, torque_applied: float) -> EnergyBalance:
        """Account for the hold that ended; see `Controller.step`.

        Raises:
            ForceContradictedError: The force sensor contradicts the encoder.
        """
        display, commands, force = self._display, self._commands, -torque_applied
        environment, inner, is_first = self._environment, self._inner, bool(display.port.missed)
        if not display.port.started:
            display.begin(position, force)
            return AT_REST
        hold, h_i = self._take(position, force)
        velocity, before = display.drive.velocity, commands.speed
        request = environment.speed_after(inner, before, force, position, self._time)
        request, certificate = self._certified(display.limited(request, position, velocity))
        commands.send(display.whole(request))
        environment.go_along(inner, before, commands.speed, self._time)
        self._watch_limit()
        if self._is_unsure:
            certificate = _NONE
        elif text := display.contradiction("force sensor", hold, force, is_first=is_first):
            self.reset()
            raise ForceContradictedError(text)
        speed = abs(velocity) + display.properties.handle_acceleration * self._time
        h_s, h_r, deficit, leak, paid = self._settle(h_i, before, speed)
        branch = _DEPLETED if deficit > 0.0 else _FREE if commands.speed == 0.0 and before == 0.0 else _EXACT
        return new(EnergyBalance, (
            commands.speed, h_i, 0.0, h_i, h_r, h_s, self._surplus, 0.0, deficit, leak, paid, branch,
            environment.damping, certificate, environment.stretch(position),
        ))  # fmt: skip

    def _certified(self, request: float) -> tuple[float, int]:
        """Return the nearest certified speed [m/s or rad/s], and the certificate that limited it."""
        loop, commands, budget = self._display.loop, self._commands, self._margin.known + self._allowance
        sign = 1.0 if request >= 0.0 else -1.0
        most = loop.fastest(self._display.drive.lead, commands, budget, sign)
        if abs(request) <= most:
            return request, _UNBOUNDED
        certificate = _BY_LOOP
        if self._hand_force > 0.0:
            by_hand = self._force.fastest(commands, self._hand.known + self._allowance)
            if abs(request) <= by_hand:
                return request, _BY_HAND
            if by_hand > most:
                most, certificate = by_hand, _BY_HAND
        if self._is_declared:
            by_declared = self._declared.fastest_speed(commands, request, self._allowance)
            if by_declared > most:
                most, certificate = by_declared, _BY_DECLARED
        return sign * most, certificate

    def _watch_limit(self) -> None:
        """End the certificates that a torque at its limit voids, if the newest command may bring it there.

        Without an integral, the velocity loop alone may certify all queued commands; then no certificate ends.
        """
        display = self._display
        loop, drive, speed = display.loop, display.drive, self._commands.speed
        if not self._may_be_limited or not loop.may_limit(drive, speed, display.port.missed):
            return
        self._limited = loop.delay + 1 + loop.losses + display.properties.latency
        if loop.integral > 0.0:
            self._is_unsure = True
        elif not self._is_unsure:
            under_way = loop.loss_under_way(0.0, self._commands)
            self._is_unsure = under_way > self._margin.known + self._allowance

    def _command_unseen(self) -> float:
        """Handle a SYNC without a sample; return the command [m/s or rad/s].

        Without an integral the last command continues as long as it is certified for any motion in the hold. With an
        integral the command is 0 at once, and the largest loss of all queued commands is deducted.
        """
        display, commands = self._display, self._commands
        self._let_pass(display.unseen())
        before, speed = commands.speed, 0.0
        if display.loop.integral == 0.0:
            speed, _ = self._certified(before)
        commands.send(display.whole(speed))
        self._environment.go_along(self._inner, before, commands.speed, self._time)
        self._watch_limit()
        return commands.speed

    def sample_lost(self) -> EnergyBalance:
        """Return the balance of a SYNC without a sample; see `Controller.sample_lost`."""
        balance = super().sample_lost()
        return balance._replace(certificate=_NONE) if self._is_unsure else balance

    def lasted(self, periods: float) -> None:
        """Account for skipped SYNCs: no command was sent, and the queued one acted longer."""
        display, speed = self._display, self._commands.speed
        if not display.port.started:
            return
        self._is_unsure = self._is_unsure or (display.loop.integral > 0.0 and display.port.missed > 0)
        skipped = round(periods) - 1
        changes = display.change_of_skip(skipped)
        for number in range(skipped):
            self._let_pass(changes[min(number, 1)])
            self._environment.go_along(self._inner, speed, speed, self._time)
        self._watch_limit()

    def _let_pass(self, change: float) -> None:
        """Account for a hold without a sample, by a lower bound on the change of the margin [J]."""
        self._display.let_pass()
        self._fall(change)

    def _take(self, position: float, force: float) -> tuple[BookedHold, float]:
        """Book the hold that ended and update the margins; return it and h_i [J]."""
        display, at_limit = self._display, self._limited > 0
        port, origin, heard = display.port, display.port.origin, display.port.force
        hold, change = display.take(position, force)
        self._fall(change)
        if not hold.is_booked:
            return hold, 0.0
        free = self._h_s - self._surplus
        late = free + hold.energy
        if self._is_unsure:
            return hold, hold.energy
        if self._is_declared:
            acted = self._commands.sent(self._declared.holds)
            said = new(HeardForce, (late, port.origin - origin, acted, port.force, port.force - heard, at_limit))
            self._declared.hear(said)
        margin, hand = self._margin, self._hand
        then = margin.oldest()
        margin.rise(then, late - display.loop.reserve(display.leads[then], hold.speed), self._taken)
        if self._hand_force > 0.0:
            hand.rise(hand.oldest(), late - self._force.reserve(hold.speed), self._taken)
        proved = margin.before[then] - self._taken
        if proved <= late:
            return hold, late - free
        port.reopen()
        return hold, proved - free

    def _fall(self, change: float) -> None:
        """Update the margins for the hold that ended, and record the state of this SYNC for its force."""
        display, commands = self._display, self._commands
        display.fall(change)
        self._margin.fall(change, self._taken)
        if self._hand_force > 0.0:
            is_in_doubt = self._limited > display.properties.latency
            lost = inf if is_in_doubt else self._force.lost(commands)
            self._hand.fall(-lost, self._taken)
        self._limited = max(0, self._limited - 1)
        if self._is_declared:
            self._declared.go_on(commands.sent(display.loop.delay))

    def _settle(self, h_i: float, before: float, speed: float) -> tuple[float, float, float, float, float]:
        """Dissipate and leak the energy that neither mass nor drive can give back.

        Args:
            h_i: Energy received in the hold [J].
            before: Command before the newest [m/s or rad/s].
            speed: Largest speed that the handle may have now [m/s or rad/s].

        Returns:
            (h_s, h_r, deficit, leak, paid) [J].
        """
        display, commands, environment = self._display, self._commands, self._environment
        under_way, allowance = display.used(), self._allowance
        ceiling, largest = display.reserve(speed) + under_way, 0.0
        if self._h_s + h_i > ceiling:
            for command in commands:
                if command * command > largest * largest:
                    largest = command
            kept = environment.stored(self._inner, largest, display.port.position)
            ceiling = kept if kept > ceiling else ceiling
        lost = environment.damping * before * before * self._time
        slack = self._margin.known + allowance - under_way
        if self._hand_force > 0.0:
            slack = max(slack, self._hand.known + allowance - self._force.used(commands))
        if self._is_declared:
            slack = max(slack, self._declared.known + allowance - self._declared.used(commands))
        h_s, surplus, h_r, deficit, leak, paid = settle(self._h_s + h_i, self._surplus, lost, ceiling, slack)
        taken = h_r + leak - paid
        for margin in (self._margin, self._hand, self._declared):
            margin.known -= taken
        self._taken += taken
        self._h_s, self._surplus = h_s, surplus
        return h_s, h_r, deficit, leak, paid
