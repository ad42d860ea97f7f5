"""Opening and closing the books of one hold: what came in, and what the next command is made of."""

from typing import NamedTuple

from canhaptic.haptics.balance import EnergyBalance
from canhaptic.haptics.passivity.in_flight import CommandsInFlight
from canhaptic.haptics.passivity.storage import Account
from canhaptic.haptics.port import interaction_energy
from canhaptic.haptics.recovery import modulated_damping


class Hold(NamedTuple):
    """One hold that ended; efforts are those inside the torque applied in it."""

    displacement: float  # [m or rad]
    damper: float  # effort of the model's damper [N or N*m]
    h_i: float  # [J]
    h_pas: float  # [J]


class Books:
    """The surplus of one axis, its modulated damper and its commands in flight.

    Attributes:
        h_dis: Surplus still to be dissipated [J].
    """

    __slots__ = ("_alpha", "_cap", "_certificate", "_damping", "_in_flight", "_sample_time", "h_dis")

    def __init__(
        self, *, delay: int, sample_time: float, damping: float, damping_cap: float, alpha: float, certificate: int
    ) -> None:
        self._in_flight = CommandsInFlight(delay)
        self._sample_time = sample_time
        self._damping = damping
        self._cap = damping_cap
        self._alpha = alpha
        self._certificate = certificate
        self.reset()

    def reset(self) -> None:
        """No surplus, no torque in flight, no last position."""
        self._in_flight.reset()
        self.h_dis = 0.0

    def open(self, position: float, torque_applied: float) -> Hold | None:
        """Returns the hold that ended, or None at the first position.

        Raises:
            ControlError: The position or torque is not finite.
        """
        ended = self._in_flight.ended_hold(position, torque_applied)
        if ended is None:
            self.h_dis = 0.0
            return None
        displacement, damper, modulated = ended
        return Hold(displacement, damper, interaction_energy(torque_applied, displacement), modulated * displacement)

    def close(
        self, hold: Hold, account: Account, contact: bool, spring: float, velocity: float, state: float, h_s: float
    ) -> EnergyBalance:
        """Sends the next command and returns the balance of the hold.

        Args:
            hold: As it was opened.
            account: What the algorithm did with it.
            contact: Whether the next command carries a torque.
            spring: Effort of the storage [N or N*m].
            velocity: Of the model's damper [m/s or rad/s].
            state: Displacement of the storage [m or rad].
            h_s: Energy stored there [J].
        """
        displacement, _, h_i, h_pas = hold
        branch, h_r, gen, deficit, leak = account
        surplus = self.h_dis + gen + deficit - h_pas
        paid = min(leak, surplus) if leak > 0.0 and surplus > 0.0 else 0.0
        self.h_dis = surplus = surplus - paid
        torque = damper = modulated = rendered = 0.0
        if contact:
            rendered = self._damping
            damper = rendered * velocity
            if surplus > 0.0 and self._alpha > 0.0:
                extra = modulated_damping(self._alpha, surplus, rendered, self._cap, displacement, self._sample_time)
                modulated = extra * displacement / self._sample_time
                rendered += extra
            torque = -spring - damper - modulated
        self._in_flight.send(torque, damper, modulated)
        return EnergyBalance(
            torque,
            h_i,
            h_pas,
            h_i - h_pas,
            h_r,
            h_s,
            surplus,
            gen,
            deficit,
            leak,
            paid,
            branch,
            rendered,
            self._certificate,
            state,
        )
