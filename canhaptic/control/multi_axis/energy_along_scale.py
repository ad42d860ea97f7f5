"""The energy of a network along a line of states, as the scalar balance of a scaled step needs it."""

import math
from collections.abc import Sequence
from typing import Final

from canhaptic.control.multi_axis.step_scaling import ScaledHold, StepScaling, solve_scale
from canhaptic.control.passivity.root import solve_balance
from canhaptic.control.port_hamiltonian.discrete_gradient import NetworkTables, discrete_gradient, extension, gradient
from canhaptic.control.port_hamiltonian.user_energy import UserEnergies

_FURTHEST: Final = 2.0
"""Largest share of a step, in either direction; what more energy would need is left over."""
_ROUNDING: Final = 1e-15


class EnergyAlongScale:
    """H(x + l s) - H(x) for one x and s, without cancellation: l s . e_dg(x, x + l s)."""

    def __init__(
        self, tables: NetworkTables, user: UserEnergies | None, state: Sequence[float], step: Sequence[float]
    ) -> None:
        """Keeps state and step; neither is changed."""
        self._tables, self._user = tables, user
        self._state, self._step = list(state), list(step)
        n = len(self._state)
        self._moved, self._efforts, self._slopes = [0.0] * n, [0.0] * n, [0.0] * n

    def taken(self, share: float, loss: float) -> ScaledHold:
        """Returns the energy that a share of the step takes up, l L included, and its slope [J]."""
        moved, efforts, step = self._moved, self._efforts, self._step
        for i, s in enumerate(step):
            moved[i] = share * s
        discrete_gradient(self._tables, self._state, moved, efforts, self._slopes)
        if self._user is not None:
            self._user.add_discrete_gradient(self._state, moved, efforts)
        energy = loss * share
        for e, m in zip(efforts, moved, strict=True):
            energy += e * m
        for i, x in enumerate(self._state):
            moved[i] += x
        gradient(self._tables, moved, efforts)
        if self._user is not None:
            self._user.add_gradient(moved, efforts)
        slope = loss
        for e, s in zip(efforts, step, strict=True):
            slope += e * s
        return ScaledHold(energy, slope)

    def stiffness(self) -> float | None:
        """Returns s . H'' s [J] where the energy is quadratic along the line as far as its storages stay engaged."""
        tables, total = self._tables, 0.0
        if self._user is not None:
            return None
        for i, s in enumerate(self._step):
            if s == 0.0 or tables.stiffness[i] == tables.hardening[i] == 0.0:
                continue
            x = self._state[i]
            if tables.hardening[i] != 0.0:
                return None
            inside_edges = tables.lower[i] < x < tables.upper[i]  # at an edge: emptied, and touched all the same
            if inside_edges and extension(tables, i, x) == 0.0:
                if extension(tables, i, x + _FURTHEST * s) or extension(tables, i, x - _FURTHEST * s):
                    return None
                continue
            total += tables.stiffness[i] * s * s
        if tables.coupled:
            for s, row in zip(self._step, tables.quadratic, strict=True):
                total += s * sum([q * other for q, other in zip(row, self._step, strict=True)])
        return total

    def solve(self, energy: float, loss: float, limit: float = _FURTHEST) -> StepScaling:
        """Returns the share nearest 0 that takes up an energy [J] together with a loss [J] in proportion to it."""
        stiffness = self.stiffness()
        if stiffness is None:
            size = abs(energy) + abs(loss)
            return solve_scale(lambda share: self.taken(share, loss), energy, limit, _ROUNDING * size)
        length = math.sqrt(sum([s * s for s in self._step]))  # along a unit step: of one state, eq. 16 itself
        if length == 0.0:
            return StepScaling(0.0, energy >= 0.0, 1)
        change = solve_balance(
            stiffness / (length * length), self.taken(0.0, loss).slope / length, energy, length
        )  # fmt: skip
        if math.isnan(change):
            return StepScaling(0.0, False, 1)
        share = change / length
        if abs(share) > limit and energy > 0.0:
            return StepScaling(limit if share > 0.0 else -limit, True, 1)
        return StepScaling(share, True, 1)
