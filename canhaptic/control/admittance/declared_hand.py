"""Largest certified commands of an admittance display for a hand of declared force or impedance.

A certificate is a proof that a command gives out no more energy than the display may: D1 for `DeclaredHand`, D2 for
`LargestForce`, D4 for several axes (`margins`). `damping_border` (D3) is the stability limit without certificates. All
certificates here are for a drive without an integral, whose torque must not reach its limit
(`VelocityLoop.may_limit`). Proofs:
`docs/theory/commands_of_a_display.md`.
"""

from collections.abc import Sequence
from copy import copy
from math import cos, exp, inf, log1p, sin, sqrt
from typing import Final, NamedTuple

from canhaptic.control.admittance.admittance_environment import Commands
from canhaptic.control.admittance.port import AdmittanceProperties
from canhaptic.control.admittance.velocity_loop import GuardedAdmittanceParameters, VelocityLoop, largest_square
from canhaptic.control.environments import plain


class LargestForce(NamedTuple):
    """Largest certified speed for a hand of bounded force, at a drive without an integral."""

    force: float  # f [N or N*m]
    loop: VelocityLoop

    def reserve(self, speed: float) -> float:
        """Return G, the most energy that the hand can take by braking the handle from `speed` to rest [J]."""
        gain = self.loop.gain_least
        rest = speed - self.force / gain * log1p(gain * speed / self.force)
        return self.force * self.loop.mass / gain * rest

    def lost(self, commands: Commands) -> float:
        """Return a bound on the fall of E - G, the energy received less `reserve`, in the hold that ended [J]."""
        square = largest_square(commands, self.loop.delay, self.loop.delay + self.loop.losses)
        return self.force * self.loop.sample_time * sqrt(square)

    def fastest(self, commands: Commands, budget: float) -> float:
        """Return the largest speed that an energy budget [J] permits as the next command [m/s or rad/s].

        If RPDOs may be lost, each hold is charged with the largest command that may act in it. A new command larger
        than all others is charged in all its holds. A smaller one is charged in its last hold only, in which it is at
        most as large as the command before.
        """
        left = budget / (self.force * self.loop.sample_time)
        for age in range(self.loop.delay):
            left -= sqrt(largest_square(commands, age, age + self.loop.losses))
        if left <= 0.0:
            return 0.0
        everywhere = left / (1 + self.loop.losses)
        if self.loop.losses == 0 or everywhere >= sqrt(largest_square(commands, 0, self.loop.losses - 1)):
            return everywhere
        for hold in range(self.loop.losses):
            left -= sqrt(largest_square(commands, 0, self.loop.losses - 1 - hold))
        last = abs(commands[commands.newest])
        return max(0.0, min(left, last))

    def used(self, commands: Commands) -> float:
        """Return a bound on how far all commands that can still act, the newest included, reduce E - G [J]."""
        total = 0.0
        for age in range(1, self.loop.delay + 1):
            total += sqrt(largest_square(commands, age, age + self.loop.losses))
        for hold in range(self.loop.losses + 1):
            total += sqrt(largest_square(commands, 0, self.loop.losses - hold))
        return self.force * self.loop.sample_time * total


_STEPS: Final = 5  # of the search for the largest speed; each halves the remaining gap at least
_OF_COMMANDS, _OF_WAY = 0.3125, 2.5
"""Factors that bound squares of sums: (x + y)^2 / 4 <= 0.3125 x^2 + 1.25 y^2, and (y + z)^2 <= 2 y^2 + 2 z^2."""


class HeardForce(NamedTuple):
    """A force reading, and the hold at whose end it was measured."""

    moved: float  # in that hold [m or rad]
    command: float  # that acted in it [m/s or rad/s]
    force: float  # [N or N*m]
    change: float  # since the force before [N or N*m]
    at_limit: bool  # whether the torque may have been at its limit in that hold


class DeclaredHand:
    """Largest certified speed for a hand declared by its impedance; keeps the state at the SYNC of the last force.

    Args:
        given: Declared stiffness K_e, speed w, mass N and damping B of the hand, friction f_d and damping d_d of the
            drive.
        loop: Velocity loop of the drive.
        properties: Properties of drive and sensor.

    Attributes:
        holds: Number of holds from the SYNC of the last force to the one at which a new command acts.
    """

    def __init__(
        self, given: GuardedAdmittanceParameters, loop: VelocityLoop, properties: AdmittanceProperties
    ) -> None:
        self.given, self.loop, self.port = plain(given), loop, plain(properties)
        self.friction, self.holds = given.drive_friction or 0.0, loop.delay + properties.latency
        self.lag = loop.mass / loop.gain  # l [s]
        self.decay = exp(-loop.sample_time / self.lag)  # part of the difference to the command that a hold leaves
        self.moved = loop.mass * (1.0 - given.spread)  # least mass of the drive [kg or kg*m^2]
        self.uncertainty = loop.gain * given.spread  # largest of abs(c - M / l) [N*s/m or N*m*s/rad]
        self.speeds = [0.0] * (properties.latency + 1)  # g at the SYNCs whose forces have not come, a ring
        self.speed = self.before = 0.0  # g now and at that SYNC [m/s or rad/s]
        self.place = self.waiting = 0  # place of this SYNC in the ring; SYNCs since the last force
        self.slowest = self.fastest = 0.0  # range of v there [m/s or rad/s]
        self.up = self.down = -inf  # least F and -F where K is alone [N or N*m]
        self.up_with_mass = self.down_with_mass = -inf  # least F + N a, and -(F + N a)

    def go_on(self, command: float) -> None:
        """Advance g, the velocity due to commands alone, by the hold in which `command` acted [m/s or rad/s]."""
        self.speed = command + (self.speed - command) * self.decay
        self.place = self.place + 1 if self.place + 1 < len(self.speeds) else 0
        self.speeds[self.place] = self.speed
        self.waiting += 1

    def hear(self, heard: HeardForce) -> tuple[float, float]:
        """Update the bounds on the hand's force with a reading that belongs to an earlier SYNC.

        Returns:
            The most of M s^2 / 2 there, and the least change of the margin A since the reading before, -inf if unknown
            [J].
        """
        samples, begin, loop, port = self.waiting, self.before, self.loop, self.port
        self.waiting = 0
        self.before = self.speeds[self.place + 1 - len(self.speeds)]
        length = samples * loop.sample_time
        mean, off = heard.moved / length, 0.5 * port.handle_acceleration * length + port.encoder_count / length
        self.slowest, self.fastest = mean - off, mean + off
        slip = max(self.fastest - self.before, self.before - self.slowest)
        stored = 0.5 * loop.mass * slip * slip
        if samples > 1:  # the force in between is unknown
            self.up = self.down = self.up_with_mass = self.down_with_mass = -inf
            return stored, -inf
        error = port.force_error + port.lag * port.force_slew
        self.up, self.up_with_mass = self._forces(heard, 1.0, error)
        self.down, self.down_with_mass = self._forces(heard, -1.0, error)
        return stored, -inf if heard.at_limit else self._gained(heard, begin)

    def _gained(self, heard: HeardForce, begin: float) -> float:
        """Return the least change of the margin A in a hold, by D1 [J]; -inf with a filter. Half of c s^2 covers D."""
        loop, port, end = self.loop, self.port, self.before
        if port.lag > 0.0:
            return -inf
        time, lead = loop.sample_time, heard.command - begin
        way = heard.command * time - self.lag * (end - begin)
        bend, rise = abs(lead) / self.lag, abs(heard.change)
        if port.is_mean:
            mean, uncertainty = heard.force, port.force_slew * bend * time * time * time / 12.0
        else:
            mean, uncertainty = heard.force - 0.5 * heard.change, rise * bend * time * time / 12.0
            room = port.force_slew * port.force_slew * time * time - rise * rise
            if room > 0.0:
                off_line = min(room / (4.0 * port.force_slew), port.force_bend * time * time * time / 12.0)
                uncertainty += max(abs(begin), abs(end)) * off_line
        added = max(0.0, abs(heard.moved - way) - port.encoder_count)
        top = max(abs(begin), abs(end))
        friction = self.friction + 0.25 * self.given.drive_damping * top
        uncertainty += port.force_error * abs(way) + friction * top * time
        uncertainty += self.uncertainty * self.uncertainty / (2.0 * loop.gain_least) * self._square(lead)
        return mean * way + 0.5 * loop.gain_least * added * added / time - uncertainty

    def _forces(self, heard: HeardForce, sign: float, error: float) -> tuple[float, float]:
        """Return the least hand force in a direction: F without, and F + N a with the hand's mass [N or N*m].

        A mean force belongs to the whole hold: by its end the spring may have lost K_e times half the displacement, and
        the arm may have moved. The mean acceleration follows from the drive.
        """
        loop, port, time = self.loop, self.port, self.loop.sample_time
        along, late = sign * heard.force - error, 0.0
        uncertainty = port.encoder_count / time
        if port.is_mean:
            late = max(0.0, 0.5 * sign * heard.moved + port.handle_acceleration * time * time / 12.0)
            late = self.given.hand_stiffness * (late + 0.5 * self.given.hand_speed * time)
        else:
            uncertainty += 0.5 * port.handle_acceleration * time
        lead = sign * (heard.command - heard.moved / time) - uncertainty
        push = along + (loop.gain_least if lead > 0.0 else loop.gain) * lead - self.friction
        push -= self.given.drive_damping * (abs(heard.moved) / time + uncertainty)
        push /= loop.mass if push > 0.0 else self.moved
        alone = min(late, 0.5 * port.force_slew * time) if self.given.hand_mass == 0.0 else late
        return along - alone, along - late + self.given.hand_mass * push

    def _square(self, lead: float) -> float:
        """Return the integral of (r - g)^2 over a hold that begins with r - g = `lead` [m^2/s or rad^2/s]."""
        return 0.5 * self.lag * lead * lead * (1.0 - self.decay * self.decay)

    def loss(self, commands: Sequence[float], newest: int, speed: float) -> float:
        """Return a bound on how far the queued commands and a new one reduce the margin A at any time [J].

        Args:
            commands: Ring buffer of the commands sent.
            newest: Index of the last command before the new one.
            speed: New command [m/s or rad/s].
        """
        loop, lag, holds, g, given = self.loop, self.lag, self.holds, self.before, self.given
        time, damping, mass, arm = loop.sample_time, given.hand_damping, given.hand_mass, given.hand_speed
        forth, back, late = lag * max(0.0, g), lag * max(0.0, -g), lag * lag * abs(g)
        top, square, bent = abs(g), 0.0, g
        for hold in range(holds + 1):
            command = commands[newest - (holds - 1 - hold)] if hold < holds else speed
            size = abs(command)
            if command > 0.0:
                forth += time * command
            else:
                back -= time * command
            late += time * size * (lag + time * (hold + 0.5))
            lead = command - bent
            square += lead * lead
            bent = command - lead * self.decay
            top = max(top, abs(bent))
        square = self._square(1.0) * square + 0.5 * lag * bent * bent
        way, stiffness, share = forth + back, given.hand_stiffness, self.uncertainty
        uncertainty = stiffness * stiffness * way * late + damping * damping * top * way
        fixed = stiffness * arm * late + (2.0 * damping * arm + self.friction) * way
        fixed += 0.25 * given.drive_damping * top * way + _OF_WAY * uncertainty / loop.gain_least
        yielding = damping * (top - self.slowest), damping * (top + self.fastest)
        push = 0.5 * stiffness * forth - self.up + max(0.0, yielding[0])
        pull = 0.5 * stiffness * back - self.down + max(0.0, yielding[1])
        largest = max(0.0, push * forth) + max(0.0, pull * back)
        largest += _OF_COMMANDS * share * share / loop.gain_least * square
        if mass > 0.0:
            push += self.up - self.up_with_mass
            pull += self.down - self.down_with_mass
            share += mass / lag
            slip = self.slowest - g if g > 0.0 else g - self.fastest
            heavy = max(0.0, push * forth) + max(0.0, pull * back)
            heavy += _OF_COMMANDS * share * share / loop.gain_least * square
            heavy += 0.5 * mass * ((1.0 + mass / self.moved) * top * top - g * g)
            heavy -= mass * abs(g) * slip
            largest = heavy if heavy > largest else largest
        return fixed + largest

    def fastest_speed(self, commands: Commands, request: float, budget: float) -> float:
        """Return the largest speed in the direction of the request within a budget [J], unsigned [m/s or rad/s].

        The loss is convex, so that the chord between a certified speed and one that is not certified meets the budget
        at a certified speed.
        """
        newest = commands.newest
        if self.waiting > 0 or self.up == -inf:
            return 0.0
        fits, low = 0.0, self.loss(commands, newest, 0.0)
        if low > budget:
            return 0.0
        fails, high = request, self.loss(commands, newest, request)
        if high <= budget:
            return abs(request)
        for _ in range(_STEPS):
            fits += (fails - fits) * (budget - low) / (high - low)
            low = self.loss(commands, newest, fits)
            middle = 0.5 * (fits + fails)
            value = self.loss(commands, newest, middle)
            if value <= budget:
                fits, low = middle, value
            else:
                fails, high = middle, value
        return abs(fits)

    def used(self, commands: Commands) -> float:
        """Return a bound on how far all queued commands reduce the margin A [J]; infinite if none is known."""
        if self.waiting > 0 or self.up == -inf:
            return inf
        return self.loss(commands, commands.newest - 1, commands[commands.newest])

    def lightest(self, speed: float) -> float:
        """Return the smallest virtual mass whose kinetic energy covers the loss at a constant speed [kg or kg*m^2].

        The declared hand exerts no force at first.
        """
        steady = copy(self)
        steady.before = steady.slowest = steady.fastest = speed
        steady.up = steady.down = steady.up_with_mass = steady.down_with_mass = 0.0
        return 2.0 * steady.loss([speed] * (self.holds + 1), self.holds, speed) / (speed * speed)


_ROUNDS: Final = 60


def damping_border(moved: float, gain: float, mass: float, stiffness: float, lag: float) -> float:
    """Return the virtual damping at the stability border [N*s/m or N*m*s/rad]; 0 if no damping is needed.

    Args:
        moved: M, mass moved by the drive [kg or kg*m^2].
        gain: c of the velocity loop [N*s/m or N*m*s/rad].
        mass: m, virtual mass [kg or kg*m^2].
        stiffness: K of the spring to ground [N/m or N*m/rad], > 0.
        lag: tau from the force to the command that answers it [s].
    """
    square = stiffness / mass
    damping = 0.0
    for _ in range(_ROUNDS):
        rate = sqrt(square)
        damping = stiffness * sin(rate * lag) / rate + mass * (moved * square - stiffness) / gain
        found = stiffness * (cos(rate * lag) + damping / gain) / (mass + moved * damping / gain)
        square = 0.5 * (square + max(found, 0.01 * square))
    return max(0.0, damping)
