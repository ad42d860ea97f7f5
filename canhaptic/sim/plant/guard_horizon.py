"""Number of whole sample times in which torques within a limit cannot reach any guard of a mode.

With z = [x, u, 1] at the start of a hold, w = z without the torque, Phi the flow over T with the torque taken out and b
the change of x over T per unit torque, the starts of the holds are

    w(k) = Phi^k w(0) + sum over j < k of Phi^(k-1-j) b u(j),   |u| <= U.

So a guard c is at least c Phi^k w(0) - U (sum over j < k of |c Phi^j b| + |c_u|) at both ends of a hold, c_u its factor
of the torque. Inside a hold it is below neither end by more than slack * |y|, y the scaled rates of the state
(`guard_bounds.py`), and |y| has a bound of the same form. A hold with a positive remainder has no event and may
be taken in one step. The bound is strict up to rounding, for which a part of the largest value is taken off.
"""

from typing import Final

import numpy as np

from canhaptic.sim.plant.propagator import Array

HOLDS: Final = 64
"""Sample times that are looked ahead."""
_ROUNDING: Final = 1e-12  # of the largest row times the state


class GuardHorizon:
    """The bounds of one mode.

    Args:
        guards: Rows of the guards, shape (c, n).
        scaled: Rows of the scaled rates, shape (m, n), and
        slack: how far a guard may be from its chord over T, by unit of their length, shape (c,).
        flow: Flow over T under a held torque, the last component but one, shape (n, n).
    """

    def __init__(self, guards: Array, scaled: Array, slack: Array, flow: Array) -> None:
        free, push = flow.copy(), flow[:, -2].copy()
        free[-2], free[:, -2], push[-2] = 0.0, 0.0, 0.0
        rows, count = np.concatenate([guards, scaled]), len(guards)
        at_once, rows = np.abs(rows[:, -2]), rows.copy()
        rows[:, -2] = 0.0
        powers, reach = [rows], [at_once]
        for _ in range(HOLDS):
            reach.append(reach[-1] + np.abs(powers[-1] @ push))
            powers.append(powers[-1] @ free)
        all_powers, all_reach = np.array(powers), np.array(reach)
        norms = np.linalg.norm(all_powers[:, :count], axis=2).max(axis=0, initial=0.0)
        self._count, self._slack, self._rounding = count, slack, _ROUNDING * norms
        self._values = all_powers[:, :count].reshape(-1, rows.shape[1])
        self._rates = all_powers[:-1, count:].reshape(-1, rows.shape[1])
        self._reach = all_reach[1:, :count]
        self._speed = np.linalg.norm(all_reach[:-1, count:], axis=1)

    def holds(self, state: Array, largest: float) -> int:
        """Number of whole sample times from `state` on without an event under torques within +-`largest`."""
        values = self._values.dot(state).reshape(HOLDS + 1, self._count)
        rates = self._rates.dot(state).reshape(HOLDS, -1)
        pace = np.sqrt((rates * rates).sum(axis=1)) + largest * self._speed
        lost = largest * self._reach + pace[:, None] * self._slack + self._rounding * float(np.linalg.norm(state))
        sure = (np.minimum(values[:-1], values[1:]) > lost).all(axis=1)
        return HOLDS if sure.all() else int(sure.argmin())
