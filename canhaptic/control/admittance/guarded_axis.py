"""One axis of a guarded display: the velocity loop of its drive, and its force against its motion."""

from canhaptic.control.admittance.admittance_environment import AdmittanceAxis, AdmittanceEnvironment
from canhaptic.control.admittance.force_evidence import (
    ROUNDING,
    LateMargin,
    contradiction,
    momentum_check,
    moved_hold,
)
from canhaptic.control.admittance.port import AdmittanceProperties, BookedHold
from canhaptic.control.admittance.velocity_loop import (
    GuardedAdmittanceParameters,
    LoopState,
    gained,
    loop_settings,
    loss_of_skip,
    loss_under_way,
    lost_unseen,
    reserve,
)


class GuardedAxis(AdmittanceAxis):
    """Port, commands and drive of one axis.

    Args:
        environment: Environment of the axis.
        parameters: Declared properties of the drive.
        properties: Declared properties of the axis.

    Attributes:
        loop: Declared velocity loop of the drive.
        drive: Its motion.
        leads: Its leads at the SYNCs whose forces have not come [m or rad].
        by_encoder: E - V by encoder and commands alone, at least [J].
        by_force: E by the force, at most [J].

    Raises:
        ParameterError: Losses or a hand are declared where their proof does not hold.
    """

    def __init__(
        self,
        environment: AdmittanceEnvironment,
        parameters: GuardedAdmittanceParameters,
        properties: AdmittanceProperties,
    ) -> None:
        self.loop, self.drive, latency = loop_settings(parameters, properties), LoopState(), properties.latency
        kept = self.loop.delay + self.loop.losses + 2 + (latency if parameters.hand_stiffness > 0.0 else 0)
        super().__init__(environment, properties, kept, self.loop.mass / self.loop.gain_least)
        self.leads, self.by_encoder, self.by_force = [0.0] * (latency + 1), 0.0, 0.0
        self._margin, self._check = LateMargin(latency), momentum_check(parameters, self.properties, self.loop)

    def begin(self, position: float, force: float) -> None:
        """Take the first sample."""
        super().begin(position, force)
        if self._check is not None:
            self._check.begin(position, force, 0.0)

    def take(self, position: float, force: float) -> tuple[BookedHold, float]:
        """Book the hold that ended; return it, and a lower bound on the change of the margin in it [J]."""
        missed, loop = self.port.missed, self.loop
        hold = self.port.book(position, force)
        if not missed:
            change = gained(loop, self.drive.lead, self.commands, hold.moved)
        else:  # with an integral all is deducted by now
            change = 0.0 if loop.integral > 0.0 else -lost_unseen(loop, self.commands)
        self.drive.lead += self.acted() - hold.moved
        self.drive.velocity, self.drive.holds = hold.moved / hold.elapsed, missed + 1
        if hold.is_booked:
            if self.by_force == 0.0:  # the handle may have moved already
                fastest = hold.speed + self.properties.handle_acceleration * hold.elapsed
                self.by_encoder -= reserve(loop, 0.0, fastest)
            self.by_force += hold.most
        return hold, change

    def unseen(self) -> float:
        """Lower bound on the change of the margin in a hold without a sample [J]."""
        if self.loop.integral == 0.0:
            return -lost_unseen(self.loop, self.commands)
        return 0.0 if self.port.missed else -self.used()

    def change_of_skip(self, skipped: int) -> tuple[float, float]:
        """Return the change of the margin in the first and in each further hold where SYNCs are skipped [J]."""
        if self.loop.integral > 0.0:
            return -loss_of_skip(self.loop, self.drive.lead, self.commands, skipped), 0.0
        lost = -lost_unseen(self.loop, self.commands)
        return lost, lost

    def let_pass(self) -> None:
        """Count a hold without a sample."""
        self.drive.lead += self.acted()
        self.port.missed += 1

    def fall(self, change: float) -> None:
        """Apply a lower bound on the change of E - V in the hold that ended [J], and record the lead of this SYNC."""
        self.by_encoder += change
        self._margin.fall(change, 0.0)
        self.leads[self._margin.place] = self.drive.lead

    def contradiction(self, of: str, hold: BookedHold, force: float, *, is_first: bool) -> str:
        """Reason why force and motion cannot both be right, or "". Call it at every SYNC, after `send`.

        Args:
            of: The sensor.
            hold: The hold as it was booked.
            force: Received force [N or N*m].
            is_first: Whether samples were lost before this one.
        """
        if self._margin.known_then(self.by_encoder) > self.by_force + ROUNDING:  # more may have come in since
            return contradiction(of, self.by_force, self.by_encoder)
        if self._check is None:
            return ""
        if is_first:
            self._check.begin(self.port.position, force, self.drive.lead)
            return ""
        found = self._check.take(moved_hold(self.loop, self.commands, hold.moved, self.drive.lead), force)
        return "" if found is None else found.text(of)

    def used(self) -> float:
        """Largest loss of the margin by all queued commands [J]."""
        return loss_under_way(self.loop, self.drive.lead, self.commands)

    def acted(self) -> float:
        """Displacement commanded in the hold that ended [m or rad]."""
        return self.commands.sent(self.loop.delay) * self.properties.sample_time

    def reserve(self, speed: float) -> float:
        """Return the largest V at a largest speed [J]."""
        return reserve(self.loop, self.drive.lead, speed)
