"""Opening and closing the books of one hold: what came in, and what the next command is made of."""

from typing import NamedTuple

from canhaptic.control.balance import AT_REST, Branch, EnergyBalance, interaction_energy
from canhaptic.control.passivity.in_flight import CommandsInFlight
from canhaptic.control.passivity.storage import Account
from canhaptic.control.velocity import AdaptiveWindow

_HELD = Branch.HELD.value


class Hold(NamedTuple):
    """One hold that ended; efforts are those inside the torque applied in it."""

    displacement: float  # [m or rad]
    damper: float  # effort of the model's damper [N or N*m]
    h_i: float  # [J]
    h_pas: float  # [J]
    elapsed: float  # [s]; more than one sample time where positions were lost
    velocity: float  # measured: of this hold, or from the estimator [m/s or rad/s]


class HoldAccount:
    """The surplus of one axis and its commands in flight.

    Attributes:
        h_dis: Surplus still to be dissipated [J].
    """

    __slots__ = (
        "_certificate",
        "_estimator",
        "_in_flight",
        "_last",
        "_sample_time",
        "h_dis",
    )

    def __init__(
        self,
        *,
        delay: int,
        sample_time: float,
        certificate: int,
        estimator: AdaptiveWindow | None = None,
        largest: float | None = None,
    ) -> None:
        """Opens the books of one axis.

        Args:
            delay: Whole holds between computation and action.
            sample_time: [s].
            certificate: What the algorithm promises (`Certificate`).
            estimator: Of the velocity that the damper uses; None for that of the last hold.
            largest: Largest torque that limiter and drive let act [N or N*m]; None: any.
        """
        self._in_flight = CommandsInFlight(delay, largest)
        self._sample_time = sample_time
        self._certificate = certificate
        self._estimator = estimator
        self.reset()

    def reset(self) -> None:
        """No surplus, no torque in flight, no last position."""
        self._in_flight.reset()
        self._last = AT_REST
        self.h_dis = 0.0

    def open(self, position: float, torque_applied: float) -> Hold | None:
        """Returns the hold that ended, or None at the first position.

        Raises:
            ControlError: The position or torque is not finite.
        """
        in_flight, estimator = self._in_flight, self._estimator
        ended = in_flight.ended_hold(position, torque_applied)
        if ended is None:
            self.h_dis = 0.0
            if estimator is not None:
                estimator.restart(position)
            return None
        displacement, damper, modulated = ended
        h_i = interaction_energy(torque_applied, displacement)
        elapsed = self._sample_time
        if in_flight.holds > 1:
            elapsed *= in_flight.holds
            h_i -= in_flight.uncertainty
        velocity = displacement / elapsed
        if estimator is not None:
            if in_flight.holds > 1:
                estimator.restart(position)
            else:
                velocity = estimator.update(position)
        return Hold(displacement, damper, h_i, modulated * displacement, elapsed, velocity)

    def repeat(self) -> EnergyBalance:
        """Repeats the last command for want of a position, and books nothing."""
        self._in_flight.lose_hold()
        return self._last._replace(
            branch=_HELD, h_i=0.0, h_pas=0.0, h_m=0.0, h_r=0.0, gen=0.0, deficit=0.0, leak=0.0, paid=0.0
        )

    @property
    def torques_in_flight(self) -> tuple[float, ...]:
        """Torques computed earlier whose hold has not ended [N or N*m], the next to act first."""
        return self._in_flight.torques

    def send(
        self,
        hold: Hold,
        account: Account,
        efforts: tuple[float, float, float],
        rendered: float,
        state: float,
        h_s: float,
    ) -> EnergyBalance:
        """Sends a command of given efforts (spring, damper, modulated) and returns the balance of the hold.

        Args:
            hold: As it was opened.
            account: What the algorithm did with it.
            efforts: Inside the command [N or N*m].
            rendered: Total damping inside the command [N*s/m or N*m*s/rad].
            state: Displacement of the storage [m or rad].
            h_s: Energy stored there [J].
        """
        h_i, h_pas = hold.h_i, hold.h_pas
        branch, h_r, gen, deficit, leak = account
        self.h_dis, paid = self.surplus_after(hold, account)
        spring, damper, modulated = efforts
        torque = -spring - damper - modulated
        self._in_flight.send(torque, damper, modulated)
        self._last = balance = EnergyBalance(
            torque,
            h_i,
            h_pas,
            h_i - h_pas,
            h_r,
            h_s,
            self.h_dis,
            gen,
            deficit,
            leak,
            paid,
            branch,
            rendered,
            self._certificate,
            state,
        )
        return balance

    def surplus_after(self, hold: Hold, account: Account) -> tuple[float, float]:
        """Returns (surplus, part of the leak that paid for it) after a hold [J]."""
        _, _, gen, deficit, leak = account
        surplus = self.h_dis + gen + deficit - hold.h_pas
        paid = min(leak, surplus) if leak > 0.0 and surplus > 0.0 else 0.0
        return surplus - paid, paid
