"""Certificate by the drive's velocity loop: the largest speed that may be commanded, for every hand.

The drive is M v' = c (r - v) + f_I + F - friction with f_I' = k (r - v). With r = 0 the hand can take out
V = M v^2 / 2 + f_I^2 / 2k, and W = E - V falls by no more than the `loss` of the commands (D6 of
`docs/theory/commands_of_a_display.md`).
"""

from dataclasses import dataclass, replace
from math import inf, sqrt
from typing import Annotated

from canhaptic.control.admittance.admittance_environment import Commands
from canhaptic.control.admittance.port import AdmittanceProperties
from canhaptic.control.certificates.scalar_bounds import hand_force_bound
from canhaptic.errors import ParameterError
from canhaptic.units import Parameters, quantity


@dataclass(slots=True)
class LoopState:
    """Motion of the drive from encoder and commands."""

    lead: float = 0.0  # commanded less actual displacement: f_I = k lead [m or rad]
    velocity: float = 0.0  # mean of the hold of the last sample that came [m/s or rad/s]
    holds: int = 1  # that this mean is taken over


def _within(commands: Commands, speed: float, own: int, losses: int) -> float:
    """Reduce a new command to be the largest that may act in exactly `own` of its holds; 0 if that is impossible."""
    first = losses + 1 - own  # the first hold in which it is to be the largest
    if first < losses and speed * speed < largest_square(commands, 0, losses - 1 - first):
        return 0.0
    before = largest_square(commands, 0, losses - first) if first else inf
    return sqrt(before) if speed * speed > before else speed


def largest_square(commands: Commands, newest: int, oldest: int) -> float:
    """Return the largest square of the commands with ages from `newest` to `oldest` [m^2/s^2 or rad^2/s^2]."""
    largest = 0.0
    for age in range(newest, oldest + 1):
        command = commands.sent(age)
        largest = max(largest, command * command)
    return largest


@dataclass(frozen=True, slots=True)
class VelocityLoop:
    """Declared bounds of a drive's velocity loop, and the largest commands that are certified by them."""

    sample_time: float  # the longest hold [s]
    delay: int
    losses: int  # consecutive RPDOs that may be lost
    mass: float  # over-estimate [kg or kg*m^2]
    gain: float  # over-estimate of c [N*s/m or N*m*s/rad]
    gain_least: float  # under-estimate of it, > 0
    integral: float  # over-estimate of k; 0: none [N/m or N*m/rad]
    integral_least: float  # under-estimate of it
    count: float  # of the encoder [m or rad]
    torque_limit: float  # [N or N*m]
    acceleration: float = 0.0  # largest of the handle [m/s^2 or rad/s^2]
    evenness: float = 1.0  # the shortest hold, as a part of the longest

    def reserve(self, lead: float, speed: float) -> float:
        """Return V, the most energy that the hand can take from the drive at speeds up to `speed` [J]."""
        value = 0.5 * self.mass * speed * speed
        if self.integral > 0.0:
            stretch = abs(lead) + self.count
            value += 0.5 * self.integral * stretch * stretch
        return value

    def may_limit(self, loop: LoopState, command: float, missed: int) -> bool:
        """Return whether the torque may reach its limit while a command acts, which voids proofs by braking torque.

        Args:
            loop: Known velocity and lead; the lead does not include the displacement since the last sample.
            command: The new command [m/s or rad/s].
            missed: Number of samples lost since the velocity was measured.
        """
        time, speed = self.sample_time, abs(loop.velocity)
        span, unseen = (self.delay + 1 + self.losses) * time, missed * time
        change = self.acceleration * (span + unseen + 0.5 * time * loop.holds)
        change += speed * (1.0 / self.evenness - 1.0)  # the last hold may have taken less time
        ahead = (abs(command) + speed + change) * span + (speed + change) * unseen
        torque = self.gain * (abs(command - loop.velocity) + change)
        torque += self.integral * (abs(loop.lead) + self.count + ahead)
        return torque >= self.torque_limit

    def gained(self, lead: float, commands: Commands, moved: float) -> float:
        """Return a lower bound, from encoder and commands, on the change of W in the hold that ended [J].

        W = E - V: energy received less energy stored in mass and drive.

        Args:
            lead: Commanded less measured position at the beginning of the hold [m or rad].
            commands: Ring buffer of the commands sent.
            moved: Displacement in the hold [m or rad].
        """
        if self.integral > 0.0:
            return self._gained_with_integral(lead, commands.sent(self.delay), moved)
        least = self._by_damping(commands.sent(self.delay), moved)
        for age in range(self.delay + 1, self.delay + self.losses + 1):
            least = min(least, self._by_damping(commands.sent(age), moved))
        return least

    def lost_unseen(self, commands: Commands) -> float:
        """Return a bound on the fall of the margin W in a hold without a sample, if the drive has no integral [J]."""
        square = largest_square(commands, self.delay, self.delay + self.losses)
        return 0.25 * self.gain * self.sample_time * square

    def _by_damping(self, command: float, moved: float) -> float:
        """Return the least change of the margin W by the loop's proportional gain c in a hold [J]: c D (D / T - r).

        D is known to one count, and c lies within its declared range.

        A torque at its limit F corresponds to a gain between F / abs(v - r) and c, which may change within the hold.
        The integral of v^2 - r v is then multiplied by the smallest such gain, and its negative part, at most
        r^2 T / 4, by c.
        """
        time, count = self.sample_time, self.count
        turn = 0.5 * command * time  # D of the least value
        nearest = turn if turn > moved - count else moved - count
        nearest = nearest if nearest < moved + count else moved + count
        power = nearest * (nearest / time - command)
        shortest = time * self.evenness
        apart = max(abs(moved / time - command), abs(moved / shortest - command))
        apart += 0.5 * self.acceleration * time + count / shortest
        if apart * self.gain > self.torque_limit:
            least = self.torque_limit / apart
            least = least if least < self.gain_least else self.gain_least
            loss = 0.25 * (self.gain - least) * command * command * time
            return (least if power > 0.0 else self.gain) * power - loss
        return (self.gain_least if power > 0.0 else self.gain) * power

    def _gained_with_integral(self, lead: float, command: float, moved: float) -> float:
        """Return the least change of the margin W over the hold for a drive with an integral, if no RPDO is lost [J].

        Minimum over v(t) with int v = D of int [c v^2 - c r v - f_I r], f_I = f_0 + k (r t - x):
        c D (D / T - r) - f_0 r T - k r^2 T^2 / 2 + k r D T / 2 - k^2 r^2 T^3 / 48c.
        """
        time, gain, least = self.sample_time, self.integral, self.gain_least
        change = self._by_damping(command, moved)
        change -= self._turned(lead, command * time)
        lag = 0.5 * command * time * (moved - command * time)
        change += (self.integral_least if lag > 0.0 else gain) * lag
        change -= 0.5 * gain * abs(command) * time * self.count
        return change - gain * gain * command * command * time * time * time / (48.0 * least)

    def _turned(self, lead: float, way: float) -> float:
        """Return the largest f_0 R, the integral's force times a commanded displacement R [J]."""
        product = lead * way
        share = self.integral if product > 0.0 else self.integral_least
        return share * product + self.integral * self.count * abs(way)

    def sequence_loss(self, lead: float, commands: Commands, holds: int, oldest: int) -> float:
        """Return a bound on the fall of W over `holds` consecutive commands, the first of age `oldest` [J]."""
        time, way, squares, shifts = self.sample_time, 0.0, 0.0, 0.0
        newest = commands.newest - oldest + holds - 1
        for place in range(newest, newest - holds, -1):  # from the last to the first; below 0 it wraps
            command = commands[place]
            squares += command * command * time
            step = command * time
            shifts += time * (way * way + way * step + step * step / 3.0)
            way += step
        loss, integral = 0.25 * self.gain * squares, self.integral
        if integral > 0.0:
            loss += self._turned(lead, way) + 0.25 * integral * way * way
            loss += integral * integral * shifts / (4.0 * self.gain_least)
        return loss

    def fastest(self, lead: float, commands: Commands, budget: float, sign: float) -> float:
        """Return the largest speed in a direction that is certified as the next command [m/s or rad/s].

        Args:
            lead: Lead at this SYNC [m or rad].
            commands: Ring buffer of the commands sent.
            budget: Sum of W and the energy allowance [J].
            sign: 1.0 or -1.0.
        """
        if self.integral == 0.0:
            return self._fastest_by_damping(commands, budget)
        time, gain, least, delay = self.sample_time, self.integral, self.gain_least, self.delay
        before = self.sequence_loss(lead, commands, delay, delay - 1)
        way, shift = 0.0, 0.0
        for age in range(delay):  # from the last under way to the first
            step = commands[commands.newest - age] * time
            shift += time * (2.0 * way + step)
            way += step
        square = 0.25 * time * self.gain + 0.25 * gain * time * time
        square += gain * gain * time * time * time * (1.0 / 3.0 + delay) / (4.0 * least)
        line = self._turned(lead, sign * time)
        line += sign * time * (0.5 * gain * way + gain * gain * shift / (4.0 * least))
        room = budget - before
        return hand_force_bound(room, line, square) if line * line + 4.0 * square * room > 0.0 else 0.0

    def _fastest_by_damping(self, commands: Commands, budget: float) -> float:
        """Return `fastest` for a drive without an integral, whose margin falls by c T / 4 times the sum of squares.

        Up to `losses` RPDOs in a row may be lost, so that in each queued hold the largest command that may act counts.
        The new command may act in 1 + losses holds; in the first of them a larger older command may act instead.
        """
        delay, losses = self.delay, self.losses
        left = 4.0 * budget / (self.gain * self.sample_time)
        if losses == 0:
            for age in range(delay):
                command = commands[commands.newest - age]
                left -= command * command
            return sqrt(left) if left > 0.0 else 0.0
        for age in range(delay):
            left -= largest_square(commands, age, age + losses)
        if left <= 0.0:
            return 0.0
        best = 0.0
        for own in range(1, losses + 2):  # holds in which the new one is the largest: the last `own` of them
            rest = left
            for hold in range(losses + 1 - own):
                rest -= largest_square(commands, 0, losses - 1 - hold)
            if rest > 0.0:
                best = max(best, _within(commands, sqrt(rest / own), own, losses))
        return best

    def loss_under_way(self, lead: float, commands: Commands) -> float:
        """Return the most by which commands that can still act, the newest included, reduce W up to any SYNC [J]."""
        total, oldest = 0.0, self.delay
        if self.integral > 0.0:
            return max(0.0, *(self.sequence_loss(lead, commands, holds, oldest) for holds in range(1, oldest + 2)))
        if self.losses == 0:
            for age in range(self.delay + 1):
                command = commands[commands.newest - age]
                total += command * command
            return 0.25 * self.gain * self.sample_time * total
        for age in range(1, self.delay + 1):
            total += largest_square(commands, age, age + self.losses)
        for hold in range(self.losses + 1):
            total += largest_square(commands, 0, self.losses - hold)
        return 0.25 * self.gain * self.sample_time * total

    def loss_of_skip(self, lead: float, commands: Commands, skipped: int) -> float:
        """Return the most by which all queued commands reduce W if SYNCs are skipped and the oldest acts longer [J]."""
        holds = [self.delay] * skipped + [*range(self.delay, -1, -1)]
        acting = Commands(len(holds))
        for age in holds:
            acting.send(commands.sent(age))
        return replace(self, delay=self.delay + skipped).loss_under_way(lead, acting)


class GuardedAdmittanceParameters(Parameters):
    """Parameters of `guarded` for admittance displays: declared properties of drive and hand."""

    drive_mass: Annotated[float, quantity("kg", "kg*m^2", gt=0.0, le=1e6)]
    """Upper bound of the mass that the drive moves up to the sensor."""
    loop_gain: Annotated[float, quantity("N*s/m", "N*m*s/rad", gt=0.0, le=1e9)]
    """Upper bound of the gain of the drive's velocity loop: 2 pi f M for a bandwidth of f."""
    integral_gain: Annotated[float, quantity("N/m", "N*m/rad", ge=0.0, le=1e12)] = 0.0
    """Upper bound of the loop's integral gain; of a position loop: its gain times `loop_gain`. 0: no integral."""
    spread: Annotated[float, quantity("1", ge=0.0, lt=1.0)] = 0.2
    """The gains are at least (1 - spread) times the declared bounds; so is the mass if `drive_friction` is declared."""
    energy_allowance: Annotated[float, quantity("J", ge=0.0)] = 0.0
    """Energy that the display may give out beyond what it received: the promise becomes E >= -energy_allowance."""
    max_consecutive_losses: Annotated[int, quantity("count", ge=0, le=16)] = 0
    """Largest number of consecutive cycles without a new command at the drive that the certificate covers; only for a
    drive without an integral."""
    largest_hand_force: Annotated[float, quantity("N", "N*m", ge=0.0, le=1e6)] = 0.0
    """Upper bound of the force of the hand, in a group on each motor axis. It permits lighter masses, but the promise
    then holds for such hands only. Not with an integral. 0: not declared."""
    drive_friction: Annotated[float, quantity("N", "N*m", ge=0.0, le=1e6)] | None = None
    """Upper bound of the dry friction of the drive. Force and motion are then compared, and the rig stops if they
    disagree. None: they are not compared. Required with hand_stiffness; 0 for a drive without dry friction."""
    drive_damping: Annotated[float, quantity("N*s/m", "N*m*s/rad", ge=0.0, le=1e6)] = 0.0
    """Upper bound of the damping of the drive's bearings; used with drive_friction and hand_stiffness."""
    hand_stiffness: Annotated[float, quantity("N/m", "N*m/rad", ge=0.0, le=1e8)] = 0.0
    """Upper bound of the stiffness of sensor, grip and hand together. It permits lighter masses, but the promise then
    holds for such hands only. 0: not declared.

    The stiffness must be constant while the hand touches: a hand that stiffens by dK at a stretch x gives out
    dK x^2 / 2 more each time. Not with an integral, lost commands or jitter; the moving mass must then be at least
    (1 - spread) drive_mass.
    """
    hand_speed: Annotated[float, quantity("m/s", "rad/s", ge=0.0, le=1e3)] = 0.0
    """Upper bound of the speed of the arm behind the grip; with hand_stiffness."""
    hand_mass: Annotated[float, quantity("kg", "kg*m^2", ge=0.0, le=1e6)] = 0.0
    """Upper bound of the mass behind the sensor that is rigid with it; with hand_stiffness."""
    hand_damping: Annotated[float, quantity("N*s/m", "N*m*s/rad", ge=0.0, le=1e6)] = 0.0
    """Upper bound of the damping of the grip; with hand_stiffness."""


def loop_settings(parameters: GuardedAdmittanceParameters, properties: AdmittanceProperties) -> VelocityLoop:
    """Return the declared bounds of the velocity loop, for the longest duration of a hold, at which they are worst.

    Raises:
        ParameterError: Losses or a hand are declared with an integral, or the declaration of a hand is incomplete.
    """
    _require_what_a_hand_needs(parameters, properties)
    refused = {
        "max_consecutive_losses": "a command that is lost leaves the integral of the drive unknown",
        "largest_hand_force": "no proof covers such a hand with an integral",
        "hand_stiffness": "no proof covers such a hand with an integral",
    }
    for key, why in refused.items():
        if parameters.integral_gain and getattr(parameters, key):
            raise ParameterError(
                f"guarded: {key}: got {getattr(parameters, key)}, expected 0 with an integral_gain: {why}; "
                "leave it out, or declare a drive without an integral"
            )
    least, jitter = 1.0 - parameters.spread, properties.jitter
    return VelocityLoop(
        properties.longest_hold, properties.delay, parameters.max_consecutive_losses, parameters.drive_mass,
        parameters.loop_gain, parameters.loop_gain * least, parameters.integral_gain, parameters.integral_gain * least,
        properties.encoder_count, properties.torque_limit, properties.handle_acceleration,
        (1.0 - jitter) / (1.0 + jitter),
    )  # fmt: skip


def _require_what_a_hand_needs(parameters: GuardedAdmittanceParameters, properties: AdmittanceProperties) -> None:
    """Refuse an incomplete declaration of a hand as spring, damper and mass, and properties that its proof excludes."""
    if not parameters.hand_stiffness:
        for key in ("hand_speed", "hand_mass", "hand_damping"):
            if getattr(parameters, key):
                raise ParameterError(
                    f"guarded: {key}: got {getattr(parameters, key):g}, expected 0 without hand_stiffness, which "
                    "declares the hand; declare hand_stiffness too"
                )
        return
    if parameters.drive_friction is None:
        raise ParameterError(
            "guarded: drive_friction: got none with hand_stiffness, expected an upper bound, which the proof for such "
            "a hand needs; declare drive_friction and drive_damping"
        )
    why, losses = "the motion that the commands make must be known", parameters.max_consecutive_losses
    for key, value in {"max_consecutive_losses": losses, "sync_jitter": properties.jitter}.items():
        if value:
            raise ParameterError(
                f"guarded: {key}: got {value:g}, expected 0 with hand_stiffness: {why}; set it to 0 or leave out "
                "hand_stiffness"
            )
