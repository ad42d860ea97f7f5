"""One axis of a guarded admittance display: its energy account, its commands and its drive.

By the force at most `by_force` came in; by encoder and commands, E - V is at least
`by_encoder` (see `velocity_loop`), and V is not negative. If the encoder proves more energy than the force, one of them
is wrong. So is one if the force contradicts the momentum (`momentum_check`).
"""

from typing import Final

from canhaptic.control.admittance import velocity_loop
from canhaptic.control.admittance.admittance_environment import AdmittanceAxis, AdmittanceEnvironment
from canhaptic.control.admittance.declared_hand import DeclaredHand, HeardForce, LargestForce
from canhaptic.control.admittance.late_margin import LateMargin
from canhaptic.control.admittance.momentum_check import MovedHold, momentum_check
from canhaptic.control.admittance.port import AdmittanceProperties, BookedHold
from canhaptic.control.admittance.velocity_loop import GuardedAdmittanceParameters
from canhaptic.kernels import new

ROUNDING: Final = 1e-9
"""Largest difference by rounding between two sums of the same energy [J]."""


class GuardedAxis(AdmittanceAxis):
    """Energy account, commands and drive of one axis of a guarded display.

    Args:
        environment: Environment of the axis.
        parameters: Declared properties of the drive.
        properties: Declared properties of the axis.

    Attributes:
        loop: Declared velocity loop of the drive.
        drive: Motion of the drive.
        force: Certificate for a hand of bounded force.
        declared: Certificate for a hand of declared impedance.
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
        self.force = LargestForce(parameters.largest_hand_force, self.loop)
        self.declared = DeclaredHand(parameters, self.loop, properties)
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

    def heard(self, origin: float, force: float, *, at_limit: bool) -> HeardForce:
        """Return the force that was booked last.

        Args:
            origin: Position to which energy was booked before [m or rad].
            force: Force there [N or N*m].
            at_limit: Whether the torque may have been at its limit.
        """
        port, acted = self.port, self.commands.sent(self.declared.holds)
        return new(HeardForce, (port.origin - origin, acted, port.force, port.force - force, at_limit))

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
        acted, uncertainty = commands.sent(age), 0.0
        for older in range(age + 1, age + self.loop.losses + 1):
            uncertainty = max(uncertainty, abs(commands.sent(older) - acted))
        found = self._check.take(MovedHold(hold.moved, acted, uncertainty, self.drive.lead), force)
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
