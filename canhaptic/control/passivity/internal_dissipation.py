"""`internal_dissipation`: the paper's algorithm. Dissipation follows from the state change that balances it (eq. 8).

Flow of one step (Fig. 6): out of contact - free, or exit; in contact without stored energy - the deadlock, left by a
first-order start (eq. 14); else the exact solution (eqs. 15-17), or without one the approximate solution (eq. 18).
Surplus energy is recovered by the modulated damper (eq. 19).

Departures from the printed equations, and their reasons:

- eq. 18 takes the state on the side of the contact; the printed sign is positive, where contact has x < 0.
- eq. 16 is solved for the root nearest zero: the printed one or, when sticking, the other (`root`).
- eq. 15 is computed with the damper effort that was inside the torque applied in that very hold. Without delay this is
  the printed one; with delay the printed one is unstable.
- a motion that reverses would make H_R of eq. 15 negative, dissipation that gives energy: it is solved without it.
- eq. 14 takes the velocity from the displacement, and only once the user pushes inward: switched on deep inside a wall,
  x / T is not a velocity. A store emptied inside the contact is the same deadlock, left in the same way.
- the state never crosses to the other side of the contact: there is no tension spring behind a wall.
- the hold in which the contact ends, and those whose torque was still queued, are booked; the rest is leaked.

Kept as printed: every start creates k x^2 / 2, and the state creeps away from the true penetration under tremor.
"""

from dataclasses import dataclass
from math import copysign, isnan
from typing import Any, Final

from canhaptic.control.balance import Branch
from canhaptic.control.environments.environment import Environment
from canhaptic.control.passivity.hold_account import Hold, HoldAccount
from canhaptic.control.passivity.stepped import SteppedController
from canhaptic.control.passivity.stored_model import (
    Balance,
    Storage,
    StoredModelParameters,
    StoredModelSettings,
    StoredModelState,
    approximate,
    dissipation,
    entered_by,
    is_deadlocked,
    move,
    pushed_inward,
    solve_balance,
    solve_balance_nonlinear,
    start,
    stored_model_kernel,
)
from canhaptic.kernels import new

_ROUNDING: Final = 2.5e-16  # of the stored energy: what a difference of two energies can resolve
_EXACT, _STICKY = Branch.EXACT.value, Branch.STICKY.value


class InternalDissipationParameters(StoredModelParameters):
    """Parameters that the paper does not fix."""


@dataclass(slots=True)
class _InternalDissipationState(StoredModelState):
    """State kept from SYNC to SYNC."""

    blind: int = 0  # holds until the first torque after a start is felt


def touch(
    environment: Environment,
    settings: StoredModelSettings[Any],
    state: _InternalDissipationState,
    hold: Hold,
    entered: bool,
) -> HoldAccount:
    """Account for a hold that ended in contact.

    After a start the user does not feel a torque before `delay` more holds have ended. Until then no energy can be
    exchanged, and the first-order approximation continues.
    """
    storage, displacement = state.storage, hold.displacement
    fresh = entered or is_deadlocked(storage)
    if fresh or state.blind:
        if entered or pushed_inward(environment, storage, displacement):
            state.blind = settings.hold.delay if fresh else state.blind - 1
            change = entered_by(environment, storage, displacement)
            return start(environment, storage, change, hold.elapsed, hold.h_i - hold.h_pas)
        state.blind = 0
    return exchange(environment, settings, storage, hold)


def exchange(environment: Environment, settings: StoredModelSettings[Any], storage: Storage, hold: Hold) -> HoldAccount:
    """Change the state by the solution of eq. 8, or by eq. 18 where there is none."""
    damper, h_m = hold.damper, hold.h_i - hold.h_pas
    change = solve(environment, settings, storage, hold.displacement, damper, h_m)
    if damper * change < 0.0:
        damper = 0.0
        change = solve(environment, settings, storage, hold.displacement, 0.0, h_m)
    if isnan(change):
        return approximate(environment, storage, hold.elapsed, dissipation(settings, hold), h_m)
    furthest = 2.0 * abs(hold.displacement)
    limited = h_m > 0.0 and (abs(change) > furthest or not settings.is_linear)
    if limited and abs(change) > furthest:
        change = copysign(furthest, change)
    branch = _STICKY if h_m > 0.0 and change * storage.state < 0.0 else _EXACT
    h_r, leak = move(environment, storage, change, hold.elapsed, damper * change, h_m, limited)
    return new(HoldAccount, (branch, h_r, 0.0, 0.0, leak))


def solve(
    environment: Environment, settings: StoredModelSettings[Any], storage: Storage, displacement: float, damper: float,
    h_m: float,
) -> float:  # fmt: skip
    """Return the state change of eq. 8 [m or rad], or NaN (eq. 17)."""
    if settings.is_linear:
        stiffness = settings.stiffness
        return solve_balance(stiffness, stiffness * storage.state + damper, h_m, displacement)
    old = Balance(storage.state, storage.h_s, damper)
    return solve_balance_nonlinear(environment, old, h_m, 2.0 * displacement, _ROUNDING * storage.h_s)


class InternalDissipation(SteppedController):
    """The paper's algorithm for one axis."""

    parameters_type = InternalDissipationParameters
    kernel = stored_model_kernel(_InternalDissipationState, touch, exchange)
