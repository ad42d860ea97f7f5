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

**Margin** (`LateMargin`). Between two SYNCs the margin W decreases by no more than the commands can cause: its
`change`. A late force gives a bound on W at an earlier SYNC, and the changes since then bring it up to date. The larger
of the two bounds counts.

**Energy of the force.** By the force at most `by_force` came in; by encoder and commands, E - V is at least
`by_encoder` (see `velocity_loop`), and V is not negative. If the encoder proves more energy than the force, one of them
is wrong.

**Momentum of the force** (`MomentumCheck`), for the mass that the drive moves:

    F = M v' + c (v - r) - k lead + friction

Encoder and commands give the right side, up to the declared bounds of the drive; the sensor gives the left. Both are
averaged with a triangular weight, which rises for a time H and falls for H. The mean of v' is then
(q_2 - 2 q_1 + q_0) / H^2, without differentiating the encoder twice. With abs(F') <= L, abs(v') <= A and an encoder
count e, the means differ by at most

    error + L T^2 / 6H + friction + damping (mean of abs(v) + A T / 4)
    + c (A T^2 / 6H + e / H) + k (e + A T^2 / 8) + 2 M e / H^2      and half the range of M, c and k times their terms;

the terms in T^2 / 6H come from a weight that changes inside a hold. Point samples add the error of `port`. A SYNC
that comes early or late by up to j T shifts a weight, which costs j T / H (2 max + total change), of the force and c
times of the command. A constant offset o of the sensor gives out o times the distance moved until it is noticed,
and never more than o times the range between the position limits.
If the friction of the drive is unknown, an offset of the sensor looks like a push of the hand. So nothing is compared
without declared friction, nor if the torque of the drive may have been at its limit.
"""

from collections import deque
from dataclasses import dataclass, field
from math import inf
from typing import ClassVar, Final, NamedTuple

from canhaptic.control.admittance import velocity_loop
from canhaptic.control.admittance.admittance_environment import (
    AdmittanceAxis,
    AdmittanceController,
    AdmittanceEnvironment,
)
from canhaptic.control.admittance.declared_hand import DeclaredHand, HeardForce, LargestForce
from canhaptic.control.admittance.port import AdmittanceProperties, BookedHold
from canhaptic.control.admittance.velocity_loop import GuardedAdmittanceParameters, VelocityLoop
from canhaptic.control.balance import AT_REST, Branch, Certificate, EnergyBalance
from canhaptic.control.passivity.stepped import settle
from canhaptic.errors import ForceContradictedError
from canhaptic.kernels import new
from canhaptic.units import Parameters


class LateMargin:
    """Lower bound of the margin W, the energy that may still be given out; keeps its history for late forces.

    Args:
        latency: Delay of a force in samples.

    Attributes:
        known: Lower bound of W [J].
        place: Index of this SYNC in the ring buffers.
        changes: Change of W in the hold that ended at each SYNC [J].
        before: W at each SYNC, plus all energy withdrawn from the account before it [J].
    """

    def __init__(self, latency: int) -> None:
        self.known, self.place = 0.0, 0
        self.changes, self.before = [0.0] * (latency + 1), [0.0] * (latency + 1)

    def fall(self, change: float, taken: float) -> None:
        """Add the change of W in the hold that ended; `taken` is all energy withdrawn from the account so far [J]."""
        self.known += change
        if len(self.changes) > 1:  # otherwise no force comes late
            self.place = self.oldest()
            self.changes[self.place] = change
        self.before[self.place] = self.known + taken

    def oldest(self) -> int:
        """Return the index of the SYNC to which the received force belongs."""
        then = self.place + 1
        return then if then < len(self.changes) else 0

    def known_then(self, known: float) -> float:
        """Convert a bound at this SYNC to the earlier SYNC at which the received force was measured [J]."""
        then = self.oldest()
        for place, change in enumerate(self.changes):
            if place != then:
                known -= change
        return known

    def rise(self, then: int, value: float, taken: float) -> None:
        """Raise the bound on W if the force proves more: at least `value` at the SYNC of index `then` [J]."""
        if then != self.place:
            for place, change in enumerate(self.changes):
                if place != then:
                    value += change
        if value > self.known:
            self.known = value
        if then == self.place:
            self.before[then] = self.known + taken


ROUNDING: Final = 1e-9
"""Largest difference by rounding between two sums of the same energy [J]."""


_HALF: Final = 0.03  # H [s]
_FEWEST: Final = 8  # holds in it


class MovedHold(NamedTuple):
    """Measured motion and velocity command of one hold."""

    moved: float  # [m or rad]
    command: float  # that acted [m/s or rad/s]
    uncertainty: float  # largest difference of the command that acted, where RPDOs were lost [m/s or rad/s]
    lead: float  # at its end: commanded less actual displacement [m or rad]


class Disagreement(NamedTuple):
    """Mean of the measured force, outside the range that the motion allows [N or N*m]."""

    shown: float
    low: float
    high: float
    over: float  # time that the means are taken over [s]

    def text(self, of: str = "force sensor") -> str:
        """Return the message of the disagreement, with the remedy."""
        return (
            f"{of}: it shows {self.shown:.3g} on average over {self.over:g} s, but encoder and commands put the force "
            f"between {self.low:.3g} and {self.high:.3g} [N or N*m]: its offset, sign or scale is wrong, it is frozen, "
            "commands do not reach the drive, or drive_mass, loop_gain, drive_friction or drive_damping is wrong; the "
            "velocity is zero; check sensor, bus and drive [FORCE_CONTRADICTED]"
        )


@dataclass(slots=True)
class _Half:
    """Sums over the holds of one half of the triangular weight: unweighted, and with the rising weight."""

    begin: float  # position [m or rad]
    sums: list[float] = field(default_factory=lambda: [0.0] * 4)  # of force, v - r, lead and uncertainty of each hold
    rising: list[float] = field(default_factory=lambda: [0.0] * 4)
    is_limited: bool = False
    command_change: float = 0.0  # sum of abs(change of the command) [m/s or rad/s]
    force_change: float = 0.0
    largest_command: float = 0.0
    largest_force: float = 0.0


@dataclass(slots=True)
class _Memory:
    """State of a momentum check, kept from SYNC to SYNC."""

    position: float = 0.0  # at the end of the last hold that was taken [m or rad]
    force: float = 0.0  # shown there
    command: float = 0.0
    lead: float = 0.0
    holds: int = 0  # in the half that is being filled
    filling: _Half = field(default_factory=lambda: _Half(0.0))
    full: _Half | None = None
    waiting: deque[MovedHold] = field(default_factory=deque)  # holds whose force has not come


class MomentumCheck:
    """Compares the measured force with the momentum of one axis.

    Args:
        parameters: Declared properties of the drive.
        port: Declared properties of the force sensor.
        loop: Declared velocity loop of the drive.
    """

    def __init__(self, parameters: GuardedAdmittanceParameters, port: AdmittanceProperties, loop: VelocityLoop) -> None:
        self._port, self._loop, self._spread = port, loop, parameters.spread
        self._friction, self._damping = parameters.drive_friction or 0.0, parameters.drive_damping
        self._holds = max(_FEWEST, round(_HALF / port.sample_time))
        self._half = self._holds * port.sample_time
        self.begin(0.0, 0.0, 0.0)

    def begin(self, position: float, force: float, lead: float) -> None:
        """Restart the check at the first sample, or at the first one after lost samples."""
        self._memory = _Memory(position, force, 0.0, lead, filling=_Half(position))

    def take(self, hold: MovedHold, force: float) -> Disagreement | None:
        """Add the hold that ended and the received force; return a disagreement, or None.

        Args:
            hold: Motion and command of the hold that ended.
            force: Measured force [N or N*m]; it belongs to a hold `latency` samples ago.
        """
        memory = self._memory
        memory.waiting.append(hold)
        if len(memory.waiting) <= self._port.latency:
            memory.force = force
            return None
        self._add(memory.waiting.popleft(), force)
        if memory.holds < self._holds:
            return None
        first, second = memory.full, memory.filling
        memory.full, memory.filling, memory.holds = second, _Half(memory.position), 0
        if first is None or first.is_limited or second.is_limited:
            return None
        return self._compared(first, second)

    def _add(self, hold: MovedHold, force: float) -> None:
        """Add a hold to the half of the triangular weight that is being filled."""
        memory, port = self._memory, self._port
        time = port.sample_time
        half, velocity = memory.filling, hold.moved / time
        memory.holds += 1
        rise = (memory.holds - 0.5) / self._holds
        mean, doubt = self._mean_force(force, memory.force)
        loose = doubt + self._loop.gain * hold.uncertainty + self._damping * abs(velocity)
        slip, lead = velocity - hold.command, 0.5 * (memory.lead + hold.lead)
        for place, value in enumerate((mean, slip, lead, loose)):
            half.sums[place] += value
            half.rising[place] += rise * value
        torque = self._loop.gain * (abs(slip) + 0.5 * port.handle_acceleration * time + port.encoder_count / time)
        torque += self._loop.integral * (abs(lead) + port.encoder_count + abs(slip) * time)
        half.is_limited = half.is_limited or torque >= self._loop.torque_limit
        half.command_change += abs(hold.command - memory.command)
        half.force_change += abs(force - memory.force)
        half.largest_command = max(half.largest_command, abs(hold.command))
        half.largest_force = max(half.largest_force, abs(force))
        memory.position += hold.moved
        memory.force, memory.command, memory.lead = force, hold.command, hold.lead

    def _mean_force(self, force: float, before: float) -> tuple[float, float]:
        """Return the mean force of a hold, and its uncertainty without the error of a sample [N or N*m]."""
        port, change, doubt = self._port, force - before, 0.0
        if not port.is_mean:
            length = port.sample_time * (1.0 + port.jitter)
            doubt = max(0.0, port.force_slew * port.force_slew * length * length - change * change) / (
                4.0 * port.force_slew * length
            )
            force = 0.5 * (force + before)
        return force + change * port.lag / port.sample_time, doubt

    def _compared(self, first: _Half, second: _Half) -> Disagreement | None:
        """Compare measured and expected mean force over the triangular weight; return a disagreement, or None."""
        holds, loop = self._holds, self._loop
        halves = zip(first.rising, second.sums, second.rising, strict=True)
        force, slip, lead, loose = [(rising + whole - falling) / holds for rising, whole, falling in halves]
        bent = (self._memory.position - 2.0 * second.begin + first.begin) / (self._half * self._half)
        terms = (
            (loop.mass * (1.0 - self._spread), loop.mass, bent),
            (loop.gain_least, loop.gain, slip),
            (loop.integral_least, loop.integral, -lead),
        )
        low = sum(min(least * term, most * term) for least, most, term in terms)
        high = sum(max(least * term, most * term) for least, most, term in terms)
        margin = loose + self._margin(first, second)
        if low - margin <= force <= high + margin:
            return None
        return Disagreement(force, low - margin, high + margin, 2.0 * self._half)

    def _margin(self, first: _Half, second: _Half) -> float:
        """Return the largest permitted difference of the mean forces, without each hold's uncertainty [N or N*m]."""
        port, loop, half = self._port, self._loop, self._half
        time = port.sample_time
        turned = time * time / (6.0 * half)
        margin = port.force_error * (1.0 + 4.0 * port.lag / half) + port.force_slew * turned + self._friction
        margin += self._damping * 0.25 * port.handle_acceleration * time
        margin += loop.gain * (port.handle_acceleration * turned + port.encoder_count / half)
        margin += loop.integral * (port.encoder_count + port.handle_acceleration * time * time / 8.0)
        margin += 2.0 * loop.mass * port.encoder_count / (half * half)
        if port.jitter:
            shift = port.jitter * time / half
            command = 2.0 * max(first.largest_command, second.largest_command)
            force = 2.0 * max(first.largest_force, second.largest_force)
            margin += shift * loop.gain * (command + first.command_change + second.command_change)
            margin += shift * (force + first.force_change + second.force_change)
        return margin


def momentum_check(
    parameters: GuardedAdmittanceParameters, port: AdmittanceProperties, loop: VelocityLoop
) -> MomentumCheck | None:
    """Return the momentum check; None if `drive_friction` is not declared or the drive's integral is unknown."""
    if parameters.drive_friction is None or (loop.integral > 0.0 and port.jitter > 0.0):
        return None
    return MomentumCheck(parameters, port, loop)


class GuardedAxis(AdmittanceAxis):
    """Energy account, commands and drive of one axis of a guarded display.

    Args:
        environment: Environment of the axis.
        parameters: Declared properties of the drive.
        properties: Declared properties of the axis.

    Attributes:
        loop: Declared velocity loop of the drive.
        drive: Motion of the drive.
        leads: Lead of the drive at each SYNC whose force has not arrived [m or rad].
        by_encoder: Lower bound, by encoder and commands alone, of E - V: energy received less what the drive can
            return [J].
        by_force: Upper bound of the energy E received, by the force [J].

    Raises:
        ParameterError: Losses or a hand are declared that the proof does not cover for this drive.
    """

    def __init__(
        self, environment: AdmittanceEnvironment, parameters: GuardedAdmittanceParameters,
        properties: AdmittanceProperties,
    ) -> None:  # fmt: skip
        self.loop, latency = velocity_loop.loop_settings(parameters, properties), properties.latency
        self.drive = velocity_loop.LoopState()
        kept = self.loop.delay + self.loop.losses + 2 + (latency if parameters.hand_stiffness > 0.0 else 0)
        super().__init__(environment, properties, kept, self.loop.mass / self.loop.gain_least)
        self.leads, self.by_encoder, self.by_force = [0.0] * (latency + 1), 0.0, 0.0
        self._margin, self._check = LateMargin(latency), momentum_check(parameters, self.properties, self.loop)

    def begin(self, position: float, force: float) -> None:
        """Start the account and the momentum check at the first sample."""
        super().begin(position, force)
        if self._check is not None:
            self._check.begin(position, force, 0.0)

    def take(self, position: float, force: float) -> tuple[BookedHold, float]:
        """Book the hold that ended; return it, and a lower bound on the change of the margin in it [J]."""
        missed, loop = self.port.missed, self.loop
        hold = self.port.book(position, force)
        if not missed:
            change = loop.gained(self.drive.lead, self.commands, hold.moved)
        else:  # with an integral all is deducted by now
            change = 0.0 if loop.integral > 0.0 else -loop.lost_unseen(self.commands)
        self.drive.lead += self.acted() - hold.moved
        self.drive.velocity, self.drive.holds = hold.moved / hold.elapsed, missed + 1
        if hold.is_booked:
            if self.by_force == 0.0:  # the handle may have moved already
                fastest = hold.speed + self.properties.handle_acceleration * hold.elapsed
                self.by_encoder -= loop.reserve(0.0, fastest)
            self.by_force += hold.most
        return hold, change

    def unseen(self) -> float:
        """Return a lower bound on the change of the margin in a hold without a sample [J]."""
        if self.loop.integral == 0.0:
            return -self.loop.lost_unseen(self.commands)
        return 0.0 if self.port.missed else -self.used()

    def change_of_skip(self, skipped: int) -> tuple[float, float]:
        """Return lower bounds on the margin's change in the first and in each further hold of skipped SYNCs [J]."""
        if self.loop.integral > 0.0:
            return -self.loop.loss_of_skip(self.drive.lead, self.commands, skipped), 0.0
        lost = -self.loop.lost_unseen(self.commands)
        return lost, lost

    def let_pass(self) -> None:
        """Advance the drive's lead by a hold without a sample, and count the lost sample."""
        self.drive.lead += self.acted()
        self.port.missed += 1

    def fall(self, change: float) -> None:
        """Add a lower bound on the change of E - V in the hold that ended [J], and record the drive's lead."""
        self.by_encoder += change
        self._margin.fall(change, 0.0)
        self.leads[self._margin.place] = self.drive.lead

    def contradiction(self, of: str, hold: BookedHold, force: float, *, is_first: bool) -> str:
        """Return why force and motion cannot both be right, or "". Call it at every SYNC, after `send`.

        Args:
            of: Name of the sensor.
            hold: Result of booking the hold that ended.
            force: Received force [N or N*m].
            is_first: Whether samples were lost before this one.
        """
        if self._margin.known_then(self.by_encoder) > self.by_force + ROUNDING:  # more may have come in since
            return (
                f"{of}: by its forces at most {self.by_force:.3g} J came in, by encoder and commands at least "
                f"{self.by_encoder:.3g} J: its sign, scale or offset is wrong, it is frozen, commands do not reach the "
                "drive, or drive_mass or loop_gain is wrong; the velocity is zero; check sensor, bus and drive "
                "[FORCE_CONTRADICTED]"
            )
        if self._check is None:
            return ""
        if is_first:
            self._check.begin(self.port.position, force, self.drive.lead)
            return ""
        age, commands = self.loop.delay + 1, self.commands
        acted, unsure = commands.sent(age), 0.0
        for older in range(age + 1, age + self.loop.losses + 1):
            unsure = max(unsure, abs(commands.sent(older) - acted))
        found = self._check.take(MovedHold(hold.moved, acted, unsure, self.drive.lead), force)
        return "" if found is None else found.text(of)

    def used(self) -> float:
        """Return the most margin that all queued commands together can use up [J]."""
        return self.loop.loss_under_way(self.drive.lead, self.commands)

    def acted(self) -> float:
        """Return the displacement commanded in the hold that ended [m or rad]."""
        return self.commands.sent(self.loop.delay) * self.properties.sample_time

    def reserve(self, speed: float) -> float:
        """Return V, the most energy that the hand can take from the drive at speeds up to `speed` [J]."""
        return self.loop.reserve(self.drive.lead, speed)


_EXACT, _DEPLETED, _FREE = Branch.EXACT.value, Branch.DEPLETED.value, Branch.FREE.value
_UNBOUNDED, _NONE = Certificate.EXACT.value, Certificate.NONE.value
_BY_LOOP, _BY_HAND = Certificate.VELOCITY_LOOP.value, Certificate.LARGEST_HAND_FORCE.value
_BY_DECLARED = Certificate.DECLARED_HAND.value


class GuardedAdmittance(AdmittanceController):
    """Controller of a virtual mass whose every command is certified, by default by the drive's velocity loop."""

    parameters_type: ClassVar[type[Parameters]] = GuardedAdmittanceParameters
    _display: GuardedAxis
    _given: GuardedAdmittanceParameters

    def __init__(
        self, environment: AdmittanceEnvironment, parameters: GuardedAdmittanceParameters,
        properties: AdmittanceProperties,
    ) -> None:  # fmt: skip
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
        """Book the energy of the hold that ended and send the next command; see `Controller.step`.

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
            environment.damping, certificate, environment.stretch(position), 0.0,
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
        """Withdraw certificates that are void at the torque limit, if the newest command may drive the torque there.

        Without an integral, the velocity loop alone may certify all queued commands; then none is withdrawn.
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
        """Send the command of a SYNC without a sample, and return it [m/s or rad/s].

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

    @property
    def releasable(self) -> float:
        """Most energy that may still come out [J]."""
        return self._h_s - self._surplus + self._allowance

    def sample_lost(self) -> EnergyBalance:
        """Return the balance of a SYNC without a sample; see `Controller.sample_lost`."""
        balance = super().sample_lost()
        return balance._replace(certificate=_NONE) if self._is_unsure else balance

    def lasted(self, periods: float) -> None:
        """Update margins and states for skipped SYNCs: no command was sent, and the queued one acted longer."""
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
        """Update the margins for a hold without a sample, with a lower bound on their change [J]."""
        self._display.let_pass()
        self._fall(change)

    def _take(self, position: float, force: float) -> tuple[BookedHold, float]:
        """Book the hold that ended and update the margins; return the hold and the energy received [J]."""
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
        """Update the margins for the hold that ended, and record the state at this SYNC for a force that comes late."""
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
        """Write off energy that neither virtual mass nor drive can return to the hand, as dissipated or leaked.

        Args:
            h_i: Energy received in the hold [J].
            before: Command before the newest [m/s or rad/s].
            speed: Largest speed that the handle may have now [m/s or rad/s].

        Returns:
            (h_s, h_r, deficit, leak, paid) [J].
        """
        display, commands, environment = self._display, self._commands, self._environment
        under_way, allowance = display.used(), self._allowance
        ceiling, largest, lost = display.reserve(speed) + under_way, 0.0, 0.0
        if self._h_s + h_i > ceiling:
            for command in commands:
                if command * command > largest * largest:
                    largest = command
            kept = environment.stored(self._inner, largest, display.port.position)
            ceiling = kept if kept > ceiling else ceiling  # the damper's loss pays for the uncertainty first
            lost = min(environment.damping * before * before * self._time, max(0.0, self._h_s + h_i - ceiling))
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
