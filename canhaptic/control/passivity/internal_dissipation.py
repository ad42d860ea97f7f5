"""`internal_dissipation`: the paper. Dissipation is found a posteriori, with the state change that balances it (eq. 8).

Flow of one step (Fig. 6): out of contact - free, or exit; in contact without stored energy - the deadlock, left by a
first-order start (eq. 14); else the exact solution (eqs. 15-17), or without one the approximate solution (eq. 18).
Surplus energy is recovered by the modulated damper (eq. 19).

Where the printed equations are departed from, and why:

- eq. 18 takes the state on the side of the contact; printed it is positive, where contact has x < 0.
- eq. 16 is solved for the root nearest zero, which is the printed one and, sticking, the other (`root`).
- eq. 15 is computed with the damper effort that was inside the torque applied in that very hold. Without delay this is
  the printed one; with delay the printed one is unstable.
- a motion that reverses would make H_R of eq. 15 negative, dissipation that gives energy: solved again without it.
- eq. 14 takes the velocity from the displacement, and only once the user pushes inward: switched on deep inside a wall,
  x / T is no velocity. A store emptied inside the contact is the same deadlock, left in the same way.
- the state never crosses to the other side of the contact: there is no tension spring behind a wall.
- the hold in which the contact ends, and those whose torque was still under way, are booked; what is left is leaked.

Kept as printed: every start creates k x^2 / 2, and the state creeps away from the true penetration under tremor.
"""

import math
from typing import ClassVar, Final

from canhaptic.control.balance import AT_REST, Branch, EnergyBalance
from canhaptic.control.environments.environment import Environment
from canhaptic.control.passivity.controller import LoopProperties
from canhaptic.control.passivity.hold_account import Hold
from canhaptic.control.passivity.root import solve_balance, solve_balance_nonlinear
from canhaptic.control.passivity.storage import UNTOUCHED, Account
from canhaptic.control.passivity.stored_model import StoredModel, StoredModelParameters
from canhaptic.units import Parameters

_ROUNDING: Final = 2.5e-16  # of the stored energy: what a difference of two energies can resolve
_EXACT, _STICKY = Branch.EXACT.value, Branch.STICKY.value


class InternalDissipationParameters(StoredModelParameters):
    """What the paper leaves to choose."""


class InternalDissipation:
    """The paper's algorithm for one axis."""

    parameters_type: ClassVar[type[Parameters]] = InternalDissipationParameters

    def __init__(
        self, environment: Environment, parameters: InternalDissipationParameters, loop: LoopProperties
    ) -> None:
        self._environment = environment
        self._stiffness = environment.linear_stiffness
        self._delay = loop.delay
        self._model = StoredModel(environment, parameters, loop)
        self._storage = self._model.storage
        self.reset()

    def reset(self) -> None:
        """Forgets everything: nothing stored, no torque in flight, no last position."""
        self._model.reset()
        self._blind = 0

    def step(self, position: float, torque_applied: float) -> EnergyBalance:
        """Books the hold that ended; see `Controller.step`."""
        opened = self._model.open(position, torque_applied)
        if opened is None:
            self._blind = 0
            return AT_REST
        hold, changed = opened
        storage = self._storage
        if storage.zone:
            account = self._touch(hold, changed)
        elif changed or hold.h_i != 0.0:
            account = storage.leave(self._exchange(hold))
        else:
            account = UNTOUCHED
        return self._model.close(hold, account)

    def hold(self) -> EnergyBalance:
        """Repeats the last command for want of a position; see `Controller.hold`."""
        return self._model.repeat()

    def _touch(self, hold: Hold, entered: bool) -> Account:
        """Books a hold that ended in contact.

        After a start the user does not feel a torque before `delay` more holds have ended. Until then nothing can be
        exchanged, and the first-order approximation goes on.
        """
        storage = self._storage
        fresh = entered or storage.deadlocked
        if fresh or self._blind:
            if entered or storage.pushed_inward(hold.displacement):
                self._blind = self._delay if fresh else self._blind - 1
                return storage.start(storage.entered_by(hold.displacement), hold.h_i - hold.h_pas)
            self._blind = 0
        return self._exchange(hold)

    def _exchange(self, hold: Hold) -> Account:
        """Solves eq. 8 for the state change and takes it; eq. 18 where there is no solution."""
        storage, damper = self._storage, hold.damper
        h_m = hold.h_i - hold.h_pas
        change = self._solve(hold.displacement, damper, h_m)
        if change is not None and damper * change < 0.0:
            damper = 0.0
            change = self._solve(hold.displacement, 0.0, h_m)
        if change is None:
            return storage.approximate(self._model.dissipation(hold), h_m)
        furthest = 2.0 * abs(hold.displacement)
        limited = h_m > 0.0 and (abs(change) > furthest or self._stiffness is None)
        if limited and abs(change) > furthest:
            change = math.copysign(furthest, change)
        branch = _STICKY if h_m > 0.0 and change * storage.state < 0.0 else _EXACT
        h_r, leak = storage.move(change, damper * change, h_m, limited)
        return branch, h_r, 0.0, 0.0, leak

    def _solve(self, displacement: float, damper: float, h_m: float) -> float | None:
        """Returns the state change of eq. 8 [m or rad], or None (eq. 17)."""
        state, stiffness = self._storage.state, self._stiffness
        if stiffness is not None:
            return solve_balance(stiffness, stiffness * state + damper, h_m, displacement)
        environment, stored = self._environment, self._storage.h_s

        def gain(change: float) -> float:
            return environment.stored_energy(state + change) - stored + damper * change

        def slope(change: float) -> float:
            return environment.effort(state + change) + damper

        return solve_balance_nonlinear(gain, slope, h_m, 2.0 * displacement, _ROUNDING * stored)
