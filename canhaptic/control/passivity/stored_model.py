"""The environment at a state whose energy is paid for: what `original` and `internal_dissipation` have in common.

They differ in how a hold changes the state. How a hold is opened, and which command follows from the state, is here.
"""

from canhaptic.control.balance import Certificate, EnergyBalance
from canhaptic.control.environments.environment import Environment
from canhaptic.control.passivity.controller import LoopProperties
from canhaptic.control.passivity.hold_account import Hold, HoldAccount
from canhaptic.control.passivity.storage import Account, Storage
from canhaptic.control.recovery import Alpha, damping_cap, modulated_damping
from canhaptic.control.velocity import DamperVelocity


class StoredModelParameters(DamperVelocity):
    """Velocity of the damper, and recovery of the surplus."""

    alpha: Alpha = 0.0
    """Modulated damping per joule of surplus (eq. 19), always with its unit; 0 leaves the surplus standing."""


class StoredModel:
    """Storage and books of one axis.

    Attributes:
        storage: State, velocity and stored energy.
    """

    __slots__ = ("_alpha", "_books", "_cap", "_damping", "_environment", "_stores", "_windowed", "storage")

    def __init__(self, environment: Environment, parameters: StoredModelParameters, loop: LoopProperties) -> None:
        self._environment = environment
        self._cap = cap = damping_cap(loop.delay, loop.moving_mass, loop.sample_time)
        self._alpha = parameters.alpha
        self._windowed = parameters.velocity == "windowed"
        self._stores = environment.linear_stiffness != 0.0
        self._damping = min(environment.damping, cap)
        self.storage = Storage(environment, loop.sample_time)
        self._books = HoldAccount(
            delay=loop.delay,
            sample_time=loop.sample_time,
            largest=loop.torque_limit,
            estimator=parameters.estimator(loop.sample_time, loop.encoder_count),
            certificate=Certificate.NONE.value,
        )

    def reset(self) -> None:
        """Forgets everything: nothing stored, no torque in flight, no last position."""
        self._books.reset()
        self.storage.reset()

    def open(self, position: float, torque_applied: float) -> tuple[Hold, bool] | None:
        """Returns the hold that ended and whether a contact was entered or left in it; None at the first position.

        Raises:
            ControlError: The position or torque is not finite.
        """
        hold = self._books.open(position, torque_applied)
        if hold is None:
            self.storage.begin(position)
            return None
        return hold, self.storage.follow(position, hold.displacement, hold.elapsed)

    def repeat(self) -> EnergyBalance:
        """Repeats the last command for want of a position, and books nothing."""
        return self._books.repeat()

    def dissipation(self, hold: Hold) -> float:
        """Returns T d v^2 of a hold with the velocity inside the torque that was applied in it [J] (eqs. 6, 18)."""
        damping = self._damping
        return hold.elapsed * hold.damper**2 / damping if damping else 0.0

    def close(self, hold: Hold, account: Account) -> EnergyBalance:
        """Sends spring, damper and the modulated damper of eq. 19, and returns the balance of the hold.

        Args:
            hold: As it was opened.
            account: What the algorithm did with it.
        """
        storage, books = self.storage, self._books
        state = storage.state
        if not storage.zone:
            return books.send(hold, account, (0.0, 0.0, 0.0), 0.0, state, storage.h_s)
        measured = self._windowed and not (self._stores and storage.deadlocked)
        rendered = self._damping
        damper, modulated = rendered * (hold.velocity if measured else storage.velocity), 0.0
        if self._alpha > 0.0:
            surplus = books.surplus_after(hold, account)[0]
            extra = modulated_damping(self._alpha, surplus, rendered, self._cap, hold.displacement, hold.elapsed)
            modulated = extra * hold.displacement / hold.elapsed
            rendered += extra
        efforts = self._environment.effort(state), damper, modulated
        return books.send(hold, account, efforts, rendered, state, storage.h_s)
