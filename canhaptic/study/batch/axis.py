"""One axis between its encoder and its torque, with a meter: what happens at every SYNC, for one axis and floats.

The order and the rounding are those of `direct_rig.DirectRig` and `canhaptic.study.loop.render`. The batch
form is made from this source.
"""

from canhaptic.control.balance import EnergyBalance
from canhaptic.control.environments.environment import Environment
from canhaptic.control.passivity.controller import Controller
from canhaptic.study.batch.meter import Meter


class SampledAxis:
    """Encoder, controller, limit, quantum and delay of one axis.

    Args:
        controller: At rest.
        environment: That it renders.
        delay: Whole holds between computing a torque and its hold, 0 or 1.
        counts_per_unit: Of the encoder; None for an ideal one.
        torque_quantum: Step of the command; None for an ideal one [N or N*m].
        torque_limit: Of the drive; None for none [N or N*m].
        furthest: Distance from the origin that counts as divergence [m or rad].
        last_from: SYNC with which the last part of the run begins.
        damping_per_time: b / T of the device, for the meter [N/m or N*m/rad].
        friction: Coulomb friction of the device, for the meter [N or N*m].

    Attributes:
        meter: The figures so far.
        held: Torque to hold until the next SYNC [N or N*m].
        out: Whether the axis diverged; its figures are then no longer to be trusted.
    """

    def __init__(
        self,
        controller: Controller,
        environment: Environment,
        *,
        delay: int,
        counts_per_unit: float | None,
        torque_quantum: float | None,
        torque_limit: float | None,
        furthest: float,
        last_from: float = 0.0,
        damping_per_time: float = 0.0,
        friction: float = 0.0,
    ) -> None:
        self._controller = controller
        self._delay, self._furthest = delay, furthest
        self._counts_per_unit, self._torque_quantum, self._torque_limit = counts_per_unit, torque_quantum, torque_limit
        self.meter = Meter(environment, last_from, damping_per_time, friction)
        self.held = self._waiting = self._interaction = self._true_before = 0.0
        self.out = False

    def sync(self, true_position: float, continuous_position: float, continuous_torque: float) -> None:
        """Takes a SYNC of a plant on which nothing but the torque held acts on the motor's side of the port.

        Args:
            true_position: [m or rad].
            continuous_position: Of the axis in the continuous environment [m or rad].
            continuous_torque: Of that, its mean over the hold that ended [N or N*m].
        """
        self.meter.compare(true_position, self.held, continuous_position, continuous_torque)
        self._interaction -= self.held * (true_position - self._true_before)
        self._true_before = true_position
        self.sync_with(true_position, true_position, self._interaction)

    def sync_with(self, encoder_position: float, true_position: float, interaction: float) -> None:
        """Takes a SYNC.

        Args:
            encoder_position: Before its counts [m or rad].
            true_position: [m or rad].
            interaction: True energy that came in since the start [J].
        """
        position, held = self._measured(encoder_position), self.held
        balance = self._controller.step(position, held)
        self.meter.take(position, true_position, held, interaction, balance)
        self.out = not -self._furthest < true_position < self._furthest
        command = self._command(balance)
        if self._delay:
            self.held, self._waiting = self._waiting, command
        else:
            self.held = command

    def _measured(self, position: float) -> float:
        counts_per_unit = self._counts_per_unit
        if counts_per_unit is None:
            return position
        return round(position * counts_per_unit) * (1.0 / counts_per_unit)

    def _command(self, balance: EnergyBalance) -> float:
        torque, limit, quantum = balance.torque, self._torque_limit, self._torque_quantum
        if limit is not None and abs(torque) > limit:
            torque = limit if torque > 0.0 else -limit
        return torque if quantum is None else round(torque / quantum) * quantum
