"""The sums behind the figures of one run, gathered while it runs: memory does not grow with cycles.

Written for one axis and floats. The batch form is made from this source. `canhaptic.study.figures` defines what each
sum is for.
"""

from canhaptic.control.balance import Branch, EnergyBalance
from canhaptic.control.environments.environment import Environment

_FREE, _START, _EXACT, _STICKY, _FALLBACK, _DEPLETED, _EXIT = (branch.value for branch in list(Branch)[:7])


class Meter:
    """Running sums and extremes of one axis; energies in [J]. Its attributes are what `figures.ALL` names."""

    def __init__(
        self, environment: Environment, last_from: float = 0.0, damping_per_time: float = 0.0, friction: float = 0.0
    ) -> None:
        """Begins.

        Args:
            environment: That is rendered.
            last_from: SYNC with which the last part of the run begins (`canhaptic.study.figures.last_rows`).
            damping_per_time: b / T of the device [N/m or N*m/rad].
            friction: Coulomb friction of the device in motion [N or N*m].
        """
        self._environment, self._last_from = environment, last_from
        self._relaxes = environment.relaxes
        self._damping_per_time, self._friction = damping_per_time, friction
        self.true_position = self.lost = self.least_covered = 0.0
        self.interaction = self.least_interaction = self.margin = 0.0
        self.believed = self.dissipated = self.believed_margin = self.believed_error = self.surplus = 0.0
        self.torque = self.torque_peak = self.variation = 0.0
        self.contacts = self.damping = self.damping_most = 0.0
        self.damping_least = float("inf")
        self.state = self.force = self.asked = 0.0
        self.highest, self.lowest = -float("inf"), float("inf")
        self.diverged = self.cycles = self.certificate = 0.0
        self.free = self.start = self.exact = self.sticky = self.fallback = self.depleted = self.exit = 0.0
        self.position_squares = self.position_worst = self.force_squares = self.force_worst = 0.0
        self.last_highest, self.last_lowest = -float("inf"), float("inf")
        self.last_force = self.last_state = self.last_asked = self.last = 0.0

    def take(
        self, position: float, true_position: float, torque: float, interaction: float, balance: EnergyBalance
    ) -> None:
        """Takes one SYNC.

        Args:
            position: As the controller saw it [m or rad].
            true_position: [m or rad].
            torque: Applied in the hold that ended [N or N*m].
            interaction: True energy that came in since the start [J].
            balance: What the controller booked.
        """
        self.cycles += 1.0
        self.highest, self.lowest = max(self.highest, true_position), min(self.lowest, true_position)
        self.interaction = interaction
        self.least_interaction = min(self.least_interaction, interaction)
        moved = true_position - self.true_position if self.cycles > 1.0 else 0.0
        self.true_position = true_position
        self.lost += self._damping_per_time * (moved * moved) + self._friction * abs(moved)
        self.least_covered = min(self.least_covered, interaction + self.lost)
        believed = self.believed = self.believed + balance.h_i
        dissipated = self.dissipated = self.dissipated + balance.h_r
        self.margin = min(self.margin, interaction - dissipated)
        self.believed_margin = min(self.believed_margin, believed - dissipated)
        self.believed_error = max(self.believed_error, abs(believed - interaction))
        self.surplus = balance.h_dis
        self.torque_peak = max(self.torque_peak, abs(torque))
        self.variation += abs(torque - self.torque)
        self.torque = torque
        if balance.branch != _FREE and balance.branch != _EXIT:  # noqa: PLR1714 - `in` would search
            self._in_contact(position, torque, balance.damping_rendered)
        self.certificate = max(self.certificate, balance.certificate)
        self._count(balance.branch)
        if self.cycles > self._last_from:
            self._in_last_part(true_position, torque)

    def compare(self, position: float, torque: float, continuous_position: float, continuous_torque: float) -> None:
        """Takes one SYNC beside that of the continuous environment.

        Args:
            position: The true one [m or rad].
            torque: Applied in the hold that ended [N or N*m].
            continuous_position: [m or rad].
            continuous_torque: Its mean over the hold that ended [N or N*m].
        """
        error = position - continuous_position
        self.position_squares += error * error
        self.position_worst = max(self.position_worst, abs(error))
        error = torque - continuous_torque
        self.force_squares += error * error
        self.force_worst = max(self.force_worst, abs(error))

    def _count(self, branch: int) -> None:
        self.free += 1.0 if branch == _FREE else 0.0
        self.start += 1.0 if branch == _START else 0.0
        self.exact += 1.0 if branch == _EXACT else 0.0
        self.sticky += 1.0 if branch == _STICKY else 0.0
        self.fallback += 1.0 if branch == _FALLBACK else 0.0
        self.depleted += 1.0 if branch == _DEPLETED else 0.0
        self.exit += 1.0 if branch == _EXIT else 0.0

    def _in_last_part(self, true_position: float, torque: float) -> None:
        self.last += 1.0
        self.last_highest, self.last_lowest = (
            max(self.last_highest, true_position),
            min(self.last_lowest, true_position),
        )
        if not self._relaxes:
            self.last_force -= torque
            if self._environment.contact(true_position):
                state = self._environment.true_state(true_position, 0.0, 0.0)
                self.last_state += state
                self.last_asked += self._environment.effort(state)

    def _in_contact(self, position: float, torque: float, rendered: float) -> None:
        self.contacts += 1.0
        self.damping += rendered
        self.damping_least = min(self.damping_least, rendered)
        self.damping_most = max(self.damping_most, rendered)
        if not self._relaxes:
            state = self._environment.true_state(position, 0.0, 0.0)
            self.force -= torque
            self.state += state
            self.asked += self._environment.effort(state)
